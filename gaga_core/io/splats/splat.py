"""The .splat format of antimatter15: 32 bytes a splat, no header, no view-dependent color.

Position and size are float32 x 3, then color and opacity as 4 bytes, then the quaternion wxyz as
4 bytes, ``b = 128 q + 128``.
"""

from pathlib import Path

import numpy as np

from gaga_core.color import SH_C0
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write, open_file
from gaga_core.io.splats.packing import (
    bytes_of_logits,
    dc_of_bytes,
    logits_of_bytes,
    logs_of_sizes,
    parts_of,
    reading,
    room_for,
    splat_reader,
    splat_writer,
    to_bytes,
    unit_quats,
    writing,
)
from gaga_core.progress import Stage

_ROW = np.dtype([("xyz", "<f4", 3), ("size", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
_SMALLEST = 1e-30  # a size of 0 has no logarithm


@splat_reader
def read_splat_stage(path: Path) -> Stage[Gaussians]:
    """Read a .splat file with progress.

    Nothing in the file says what it is: one whose length is not a multiple of 32, or whose numbers
    make no sense, is refused with ``GagaError``.
    """
    size = path.stat().st_size
    if size == 0:
        raise GagaError(f"{path.name} is empty (0 bytes). Choose another file.")
    if size % _ROW.itemsize:
        raise GagaError(
            f"{path.name} is truncated or no .splat file: it is not made of 32-byte records. "
            "Copy or export it again."
        )
    n = size // _ROW.itemsize
    out = room_for(path, n, 1)
    with open_file(path) as file:
        for part in parts_of(n):
            yield reading(path, part.start, n)
            block = file.read((part.stop - part.start) * _ROW.itemsize)
            if len(block) != (part.stop - part.start) * _ROW.itemsize:
                raise GagaError(f"{path.name} became shorter while it was read. Copy it again.")
            rows = np.frombuffer(block, _ROW)
            out.means[part] = rows["xyz"]
            out.log_scales[part] = logs_of_sizes(rows["size"], _SMALLEST)
            out.sh[part, 0] = dc_of_bytes(rows["rgba"][:, :3])
            out.logit_opacities[part] = logits_of_bytes(rows["rgba"][:, 3])
            out.quats[part] = unit_quats((rows["quat"].astype(np.float32) - 128) / 128)
    yield reading(path, n, n)
    return out


@splat_writer
def write_splat_stage(path: Path, gaussians: Gaussians) -> Stage[None]:
    """Write a .splat file with progress; nothing is left when it fails."""
    n = len(gaussians)
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        for part in parts_of(n):
            yield writing(path, part.start, n)
            rows = np.empty(part.stop - part.start, _ROW)
            rows["xyz"] = gaussians.means[part]
            with np.errstate(over="ignore"):
                rows["size"] = np.exp(gaussians.log_scales[part])
            rows["rgba"][:, :3] = to_bytes((gaussians.sh[part, 0] * SH_C0 + 0.5) * 255)
            rows["rgba"][:, 3] = bytes_of_logits(gaussians.logit_opacities[part])
            rows["quat"] = to_bytes(unit_quats(gaussians.quats[part]) * 128 + 128)
            file.write(rows.data)
    yield writing(path, n, n)
