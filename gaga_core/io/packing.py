"""What the compact splat formats share: opacities in a byte, quaternions in three parts, room.

A unit quaternion is known by its three smaller parts once the largest one is positive; the
formats differ in how they round the three, and in the order of the four.
"""

import numpy as np

from gaga_core.arrays import AnyArray, FloatArray, LongArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians

CHUNK = 1 << 16  # splats worked on at once
_LONGEST = 1e18  # of a part of a quaternion: its square is a float32
_EDGE = 1e-6  # opacities of exactly 0 and 1 have no finite logit
_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
_OPACITIES = np.clip(np.arange(256) / 255, _EDGE, 1 - _EDGE)
_LOGITS = np.log(_OPACITIES / (1 - _OPACITIES)).astype(np.float32)


def room_for(n: int, n_sh: int, name: str) -> Gaussians:
    """Gaussians of ``n`` splats to be filled in; ``GagaError`` when memory does not hold them."""
    try:
        return Gaussians(
            means=np.empty((n, 3), np.float32),
            quats=np.empty((n, 4), np.float32),
            log_scales=np.empty((n, 3), np.float32),
            logit_opacities=np.empty(n, np.float32),
            sh=np.empty((n, n_sh, 3), np.float32),
        )
    except (MemoryError, ValueError, OverflowError) as error:
        raise GagaError(
            f"{name} says that it holds {n:,} splats, more than fit into memory. Split it, or "
            "get it again."
        ) from error


def logits_of_bytes(opacities: UInt8Array) -> FloatArray:
    """Logits of opacities 0..255; the two ends become 1e-6 and 1 - 1e-6."""
    result: FloatArray = _LOGITS[opacities]
    return result


def bytes_of_logits(logits: FloatArray) -> UInt8Array:
    """Opacities 0..255, rounded."""
    with np.errstate(over="ignore"):
        return to_bytes(255 / (1 + np.exp(-logits.astype(np.float32))))


def to_bytes(values: AnyArray) -> UInt8Array:
    """Rounded to 0..255, clipped."""
    result: UInt8Array = np.clip(np.rint(values), 0, 255).astype(np.uint8)
    return result


def unit_quats(quats: AnyArray) -> FloatArray:
    """Quaternions (N, 4) wxyz of length 1; one of length 0 becomes the identity.

    One that is not finite, or so long that its length is not, becomes NaN: readers drop its row.
    """
    sane = np.abs(quats).max(axis=1, initial=0) < _LONGEST  # False for NaN
    inside = quats if sane.all() else np.where(sane[:, None], quats, np.float32(0))
    length = np.linalg.norm(inside, axis=1, keepdims=True)
    result: FloatArray = (inside / np.where(length > 0, length, 1)).astype(np.float32)
    result[length[:, 0] == 0, 0] = 1
    result[~sane] = np.nan
    return result


def three_of_quats(quats: FloatArray) -> tuple[LongArray, FloatArray]:
    """Place (N,) of the largest part of unit quaternions (N, 4), and the other three in order.

    The three are those of the quaternion whose largest part is positive: within sqrt(1/2).
    """
    largest = np.abs(quats).argmax(axis=1)
    top = np.take_along_axis(quats, largest[:, None], 1)
    three = np.take_along_axis(quats, _OTHERS[largest], 1)
    return largest, np.where(top < 0, -three, three)


def quats_of_three(largest: AnyArray, three: AnyArray) -> FloatArray:
    """The way back from `three_of_quats`: quaternions (N, 4)."""
    quats = np.empty((len(three), 4), np.float32)
    np.put_along_axis(quats, _OTHERS[largest], three, 1)
    rest = np.sqrt(np.maximum(1 - (three * three).sum(axis=1), 0))
    np.put_along_axis(quats, np.asarray(largest, np.int64)[:, None], rest[:, None], 1)
    return quats


def morton_order(means: FloatArray) -> LongArray:
    """Rows along a Z curve of 21 bits an axis; what is not finite comes where it falls."""
    low, high = means.min(axis=0), means.max(axis=0)
    span = np.where(high > low, high - low, 1).astype(np.float64)
    codes = np.zeros(len(means), np.uint64)
    for axis in range(3):
        with np.errstate(invalid="ignore"):
            cells = (means[:, axis].astype(np.float64) - low[axis]) / span[axis] * ((1 << 21) - 1)
        codes |= _spread(np.nan_to_num(cells, nan=0).astype(np.uint64)) << np.uint64(axis)
    result: LongArray = np.argsort(codes, kind="stable")
    return result


def _spread(cells: AnyArray) -> AnyArray:
    """Bits of 21-bit numbers, two zeros between each (Morton's interleaving)."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        cells = (cells | (cells << np.uint64(shift))) & np.uint64(mask)
    return cells
