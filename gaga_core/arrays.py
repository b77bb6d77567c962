"""Array types and the one shape check that public functions use."""

from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]
DoubleArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]
LongArray = npt.NDArray[np.int64]
UInt8Array = npt.NDArray[np.uint8]
UInt16Array = npt.NDArray[np.uint16]
UInt32Array = npt.NDArray[np.uint32]
UInt64Array = npt.NDArray[np.uint64]
BoolArray = npt.NDArray[np.bool_]
AnyArray = npt.NDArray[Any]
MOST_GROUP = (1 << 24) - 1  # the highest id of a group: panoptic pictures hold ids in three bytes


def check_shape(
    name: str, array: AnyArray, shape: tuple[int | str, ...], dtype: npt.DTypeLike | None = None
) -> None:
    """Raise ``ValueError`` unless ``array`` has this shape (a str is any length) and dtype.

    Example: ``check_shape("means", means, ("N", 3), np.float32)``.
    """
    fits = array.ndim == len(shape) and all(
        isinstance(want, str) or want == got for want, got in zip(shape, array.shape, strict=True)
    )
    if fits and (dtype is None or array.dtype == np.dtype(dtype)):
        return
    wanted = "(" + ", ".join(str(s) for s in shape) + ("," if len(shape) == 1 else "") + ")"
    kind = "" if dtype is None else f" {np.dtype(dtype).name}"
    raise ValueError(f"{name}: expected {wanted}{kind}, got {array.shape} {array.dtype}")


def frozen(array: AnyArray) -> AnyArray:
    """Return ``array`` marked read-only (in place): frozen dataclasses hold such arrays."""
    array.flags.writeable = False
    return array
