"""Which solid stands for an object in an export, and making it."""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.mesh_files import MeshFile, TriangleMesh
from gaga_core.progress import Stage
from gaga_core.raster import choose
from gaga_core.scene.collider import box_mesh, convex_collider
from gaga_core.scene.proxy_mesh import MeshConfig, proxy_mesh_stage
from gaga_core.scene.selection.oriented_box import oriented_box

MESH_LOSS = (
    "A mesh is a solid of one color a vertex: transparency, fine detail and reflections are left "
    "out. An object without a surface gets no file."
)


class MeshForm(StrEnum):
    """What is written of an object in place of its splats."""

    MESH = "mesh"  # closed surface with colors
    COLLIDER = "collider"  # convex, at most 255 triangles
    BOX = "box"  # oriented


@dataclass(frozen=True)
class MeshExport:
    """A form of meshes, and the kind of file."""

    form: MeshForm = MeshForm.MESH
    file: MeshFile = MeshFile.GLB
    config: MeshConfig = field(default_factory=MeshConfig)

    @property
    def suffix(self) -> str:
        """What the files end in: those of splats and of other forms keep their names."""
        return f".{self.form}{self.file.suffix}"


def object_mesh_stage(
    gaussians: Gaussians, how: MeshExport, up: tuple[float, float, float]
) -> Stage[TriangleMesh]:
    """The solid of an object alone, ``gaussians`` (world); ``up`` is unit.

    A collider holds all of the mesh; of an object without a surface, all centres. Raises
    ``GagaError`` when there is no such solid.
    """
    if how.form is MeshForm.BOX:
        box = oriented_box(gaussians.means)
        if box is None:
            raise GagaError("An object without splats has no box.")
        return box_mesh(box)
    try:
        mesh = yield from proxy_mesh_stage(
            gaussians, choose(), up=np.array(up, np.float64), config=how.config
        )
    except GagaError:
        if how.form is MeshForm.MESH:
            raise
        return convex_collider(gaussians.means.astype(np.float64))
    if how.form is MeshForm.MESH:
        return mesh
    return convex_collider(mesh.vertices.astype(np.float64))
