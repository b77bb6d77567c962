"""Triangle meshes as GLB and OBJ, for programs that know no splats.

A .glb has the axes of the GLB files of splats (turned half around z, so that y is up in a world of
COLMAP); an .obj has those of a .ply. Colors: linear ``COLOR_0`` in a .glb, three more numbers of a
vertex in an .obj, as MeshLab and Blender read them.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

import numpy as np

from gaga_core.arrays import AnyArray, FloatArray, IntArray, UInt8Array, check_shape
from gaga_core.color import linear_of_srgb
from gaga_core.io.files import atomic_write
from gaga_core.io.splats.glb import glb_head


class MeshFile(StrEnum):
    """Kinds of files of meshes."""

    GLB = "glb"
    OBJ = "obj"

    @property
    def suffix(self) -> str:
        """Suffix of a file of this kind."""
        return f".{self}"


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """Triangles that face outwards counter-clockwise.

    Raises ``ValueError`` when shapes disagree.
    """

    vertices: FloatArray  # (V, 3) axes and units of a .ply
    faces: IntArray  # (F, 3) rows of ``vertices``
    colors: UInt8Array | None = None  # (V, 3) sRGB

    def __post_init__(self) -> None:
        check_shape("vertices", self.vertices, ("V", 3), np.float32)
        check_shape("faces", self.faces, ("F", 3), np.int32)
        if self.colors is not None:
            check_shape("colors", self.colors, (len(self.vertices), 3), np.uint8)

    def moved(self, origin: AnyArray, scale: float) -> "TriangleMesh":
        """The mesh from ``origin`` (3,), ``scale`` times as large."""
        vertices = (self.vertices.astype(np.float64) - origin) * scale
        return replace(self, vertices=vertices.astype(np.float32))

    def turned(self, rotation: AnyArray) -> "TriangleMesh":
        """The mesh turned about the origin by ``rotation`` (3, 3)."""
        vertices = self.vertices.astype(np.float64) @ np.asarray(rotation, np.float64).T
        return replace(self, vertices=np.ascontiguousarray(vertices, np.float32))


def write_mesh(path: Path, mesh: TriangleMesh, kind: MeshFile, name: str) -> None:
    """Write ``mesh``, called ``name`` in the file; ``GagaError`` where it cannot be written."""
    content = _glb(mesh, name) if kind is MeshFile.GLB else _obj(mesh, name)
    with atomic_write(path) as temporary:
        temporary.write_bytes(content)


def _glb(mesh: TriangleMesh, name: str) -> bytes:
    columns: dict[str, AnyArray] = {"POSITION": mesh.vertices * np.array([-1, -1, 1], np.float32)}
    if mesh.colors is not None:
        columns["COLOR_0"] = linear_of_srgb(mesh.colors / np.float32(255)).astype(np.float32)
    primitive = {
        "attributes": dict(zip(columns, range(len(columns)), strict=True)),
        "indices": len(columns),
        "material": 0,
    }
    columns["indices"] = mesh.faces.astype(np.uint32).reshape(-1, 1)
    described = {
        "nodes": [{"mesh": 0, "name": name}],
        "meshes": [{"primitives": [primitive], "name": name}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}}],
    }
    numbers = (v.astype(v.dtype.newbyteorder("<")).tobytes() for v in columns.values())
    return glb_head(described, columns) + b"".join(numbers)


def _obj(mesh: TriangleMesh, name: str) -> bytes:
    plain = " ".join(name.split()) or "mesh"
    rows = mesh.vertices.astype(np.float64)
    form = "v %.7g %.7g %.7g"
    if mesh.colors is not None:
        rows = np.hstack([rows, mesh.colors / 255.0])
        form += " %.4f %.4f %.4f"
    lines = [f"o {plain}", *(form % tuple(row) for row in rows.tolist())]
    lines += ["f %d %d %d" % tuple(row) for row in (mesh.faces + 1).tolist()]  # noqa: UP031
    return ("\n".join(lines) + "\n").encode()
