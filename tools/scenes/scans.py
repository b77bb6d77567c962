"""Scanned objects: textured meshes of a folder, which of them judge only, and points on them."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.io.images import open_image
from gaga_core.io.splats.glb import Buffers

_EVERY = 5  # of the names in order, the first and every fifth after it appear in tests only
_SCALARS = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}  # glTF 2.0, 5.1.3


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh, in metres, with a texture."""

    vertices: DoubleArray  # (V, 3)
    faces: IntArray  # (F, 3)
    uv: DoubleArray  # (V, 2) 0..1, v down
    texture: DoubleArray  # (H, W, 3) 0..1

    @property
    def corners(self) -> DoubleArray:
        """The vertices (H, 3) of the convex hull."""
        return self.vertices[ConvexHull(self.vertices).vertices]

    @property
    def area(self) -> float:
        """Square metres."""
        return float(np.linalg.norm(self._crosses(), axis=1).sum() / 2)

    def _crosses(self) -> DoubleArray:
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.cross(b - a, c - a)

    def sample(
        self, n: int, rng: np.random.Generator
    ) -> tuple[DoubleArray, DoubleArray, DoubleArray]:
        """Points, unit normals and colors, (n, 3) each, spread evenly over the area."""
        crosses = self._crosses()
        twice = np.linalg.norm(crosses, axis=1)
        ends = np.cumsum(twice)
        # One draw in each n-th of the area: fewer gaps than where all are drawn from the whole.
        drawn = np.searchsorted(ends, (np.arange(n) + rng.random(n)) / n * ends[-1])
        face = np.minimum(drawn, len(twice) - 1)
        root, t = np.sqrt(rng.random(n)), rng.random(n)
        weights = np.stack([1 - root, root * (1 - t), root * t], axis=1)[:, :, None]
        points = (self.vertices[self.faces[face]] * weights).sum(axis=1)
        u, v = (self.uv[self.faces[face]] * weights).sum(axis=1).T
        height, width = self.texture.shape[:2]
        rows = np.clip(v * height, 0, height - 1).astype(int)
        columns = np.clip(u * width, 0, width - 1).astype(int)
        return points, crosses[face] / twice[face, None], self.texture[rows, columns]


@dataclass(frozen=True, eq=False)
class Scan:
    """A scanned object."""

    name: str
    mesh: Mesh
    mass: float  # kg


def held_out(names: list[str]) -> list[str]:
    """The names that only test scenes may show."""
    return sorted(names)[::_EVERY]


def scan_names(folder: Path, split: str) -> list[str]:
    """Names of the objects that scenes of ``split`` may show: in test scenes all.

    ``GagaError`` when the folder holds no scans.
    """
    names = sorted(path.stem for path in folder.glob("*.glb"))
    if not names or not (folder / "masses_kg.json").is_file():
        raise GagaError(f"{folder} holds no scans (.glb and masses_kg.json). Give it by --scans.")
    kept_back = set(held_out(names))
    return names if split == "test" else [name for name in names if name not in kept_back]


def read_scan(folder: Path, name: str) -> Scan:
    """Read ``NAME.glb``, one textured mesh, with its mass."""
    path = folder / f"{name}.glb"
    buffers = Buffers.of(path.read_bytes(), path)
    gltf = buffers.gltf
    primitive = gltf["meshes"][0]["primitives"][0]
    faces = _array(buffers, primitive["indices"]).reshape(-1, 3).astype(np.int32)
    vertices = _array(buffers, primitive["attributes"]["POSITION"]).astype(np.float64)
    uv = _array(buffers, primitive["attributes"]["TEXCOORD_0"]).astype(np.float64)
    content = bytes(buffers.view(gltf["images"][0]["bufferView"]))
    texture = np.asarray(open_image(path, content).convert("RGB"), np.float64) / 255
    masses: Mapping[str, float] = json.loads((folder / "masses_kg.json").read_text("utf-8"))
    sides = vertices[faces]
    solid = np.linalg.norm(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=1)
    return Scan(name, Mesh(vertices, faces[solid > 0], uv, texture), float(masses[name]))


def _array(buffers: Buffers, accessor: int) -> DoubleArray:
    """Values of a packed accessor, (count,) or (count, components)."""
    row = buffers.gltf["accessors"][accessor]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}[row["type"]]
    raw = bytes(buffers.view(row["bufferView"]))
    kind = np.dtype(_SCALARS[row["componentType"]])
    found = np.frombuffer(raw, kind, row["count"] * width, row.get("byteOffset", 0))
    return found if width == 1 else found.reshape(-1, width)
