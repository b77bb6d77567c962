"""The .splat format of antimatter15: 32 bytes a splat, no header, no view-dependent color.

Position and size are float32 x 3, then color and opacity as 4 bytes, then the quaternion wxyz as
4 bytes, ``b = 128 q + 128``.
"""

from pathlib import Path

import numpy as np

from gaga_core.arrays import AnyArray
from gaga_core.color import SH_C0
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write, explain_os_error
from gaga_core.io.splats.packing import (
    CHUNK,
    bytes_of_logits,
    logits_of_bytes,
    room_for,
    to_bytes,
    unit_quats,
)
from gaga_core.io.splats.ply import without_broken_rows
from gaga_core.progress import Progress, Stage

_ROW = np.dtype([("xyz", "<f4", 3), ("size", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
_SMALLEST = np.float32(1e-30)  # a size of 0 has no logarithm


def read_splat_stage(path: Path) -> Stage[Gaussians]:
    """Read a .splat file with progress.

    Nothing in the file says what it is: one whose length is not a multiple of 32, or whose numbers
    make no sense, is refused with ``GagaError``.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        if size == 0:
            raise GagaError(f"{path.name} is empty (0 bytes). Choose another file.")
        if size % _ROW.itemsize:
            raise GagaError(
                f"{path.name} is truncated or no .splat file: it is not made of 32-byte records. "
                "Copy or export it again."
            )
        n = size // _ROW.itemsize
        out = room_for(n, 1, path.name)
        with path.open("rb") as file:
            for start in range(0, n, CHUNK):
                yield Progress("Read splats", start, n, path.name)
                part = slice(start, min(start + CHUNK, n))
                block = file.read((part.stop - start) * _ROW.itemsize)
                if len(block) != (part.stop - start) * _ROW.itemsize:
                    raise GagaError(f"{path.name} became shorter while it was read. Copy it again.")
                _unpack(np.frombuffer(block, _ROW), part, out)
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    yield Progress("Read splats", n, n, path.name)
    return without_broken_rows(path, out)


def _unpack(rows: AnyArray, part: slice, out: Gaussians) -> None:
    out.means[part] = rows["xyz"]
    with np.errstate(invalid="ignore"):  # a negative size becomes NaN: a broken row
        out.log_scales[part] = np.log(np.where(rows["size"] == 0, _SMALLEST, rows["size"]))
    out.sh[part, 0] = (rows["rgba"][:, :3] / np.float32(255) - np.float32(0.5)) / SH_C0
    out.logit_opacities[part] = logits_of_bytes(rows["rgba"][:, 3])
    out.quats[part] = unit_quats((rows["quat"].astype(np.float32) - 128) / 128)


def write_splat_stage(path: Path, gaussians: Gaussians) -> Stage[None]:
    """Write a .splat file with progress; nothing is left when it fails."""
    n = len(gaussians)
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        for start in range(0, n, CHUNK):
            yield Progress("Write splats", start, n, path.name)
            part = slice(start, min(start + CHUNK, n))
            rows = np.empty(part.stop - start, _ROW)
            rows["xyz"] = gaussians.means[part]
            with np.errstate(over="ignore"):
                rows["size"] = np.exp(gaussians.log_scales[part])
            rows["rgba"][:, :3] = to_bytes((gaussians.sh[part, 0] * SH_C0 + 0.5) * 255)
            rows["rgba"][:, 3] = bytes_of_logits(gaussians.logit_opacities[part])
            rows["quat"] = to_bytes(unit_quats(gaussians.quats[part]) * 128 + 128)
            file.write(rows.data)
    yield Progress("Write splats", n, n, path.name)
