"""Which way the axes of an SPZ file point: the extension that says so, and turning splats to ours.

Niantic's page says right, up, back (RUB); its own command and other programs store what a .ply
holds: right, down, front (RDF), which is ours. The extension ``SPZ_ADOBE_coordinate_system`` says
what a file holds; without it, a file is read as those programs do. See
github.com/nianticlabs/spz, extensions/README.md, and its issue 84.
"""

import struct
from dataclasses import replace
from typing import Literal

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import matrices_to_quats, multiply_quats
from gaga_core.sh_rotation import sh_rotation

# Numbers of the extension: where x, y and z point (left, right; up, down; front, back).
AXES = (
    *("", "LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"),
    *("LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU"),
)
# As which files that do not say it are read: as other programs write them, or as their page says.
SilentAxes = Literal["RDF", "RUB"]
OURS: SilentAxes = "RDF"
_RECORD = struct.Struct("<II")  # type, bytes that follow
_TYPE = 0xADBE0003
_UNSPECIFIED = "RUB"  # what the number 0 means: a file that has the extension but does not say
_DIRECTIONS = {
    **{"R": (1, 0, 0), "L": (-1, 0, 0)},
    **{"D": (0, 1, 0), "U": (0, -1, 0)},
    **{"F": (0, 0, 1), "B": (0, 0, -1)},
}


def extension() -> bytes:
    """The record that says that the axes are ours."""
    return _RECORD.pack(_TYPE, 4) + struct.pack("<I", AXES.index(OURS))


def axes_in(records: bytes, name: str) -> str:
    """The axes that the extensions of a file say, "" when they do not; unknown records are skipped.

    ``name`` is the file's, for the ``GagaError`` when the records are damaged.
    """
    at = 0
    while at + _RECORD.size <= len(records):
        kind, size = _RECORD.unpack_from(records, at)
        at += _RECORD.size
        if at + size > len(records):
            raise GagaError(f"{name} is damaged: its extensions do not fit. Export it again.")
        if kind == _TYPE and size == 4:
            (number,) = struct.unpack_from("<I", records, at)
            if number >= len(AXES):
                raise GagaError(f"{name} has axes of an unknown kind ({number}). Export it again.")
            return AXES[number] or _UNSPECIFIED
        at += size
    return ""


def axes_map(axes: str) -> DoubleArray:
    """The signed permutation (3, 3) that takes points of a file with these axes to ours."""
    return np.array([_DIRECTIONS[letter] for letter in axes], np.float64).T


def turned(gaussians: Gaussians, axes: str) -> Gaussians:
    """The splats of a file with these axes in ours: centres, rotations and SH; exact but for SH.

    Axes of the other hand mirror the scene, as they do in Niantic's library.
    """
    if axes in ("", OURS):
        return gaussians
    matrix = axes_map(axes)
    signs = np.diag(matrix)
    if np.array_equal(np.diag(signs), matrix):  # no axis takes another's place
        x, y, z = signs
        quats = gaussians.quats * np.array([1, y * z, x * z, x * y], np.float32)
    else:  # a mirror and a point reflection are a rotation, and ellipsoids do not tell them apart
        proper = matrix * np.sign(np.linalg.det(matrix))
        turn = matrices_to_quats(proper[None])
        quats = multiply_quats(turn, gaussians.quats.astype(np.float64)).astype(np.float32)
    bands = np.rint(sh_rotation(matrix, gaussians.sh_degree) * 1e12) / 1e12
    sh = np.einsum("st,ntc->nsc", bands, gaussians.sh.astype(np.float64), optimize=True)
    return replace(
        gaussians,
        means=np.ascontiguousarray(gaussians.means @ matrix.T.astype(np.float32)),
        quats=np.ascontiguousarray(quats),
        sh=np.ascontiguousarray(sh.astype(np.float32)),
    )
