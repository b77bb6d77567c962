"""Meshes of objects whose shape is known: within a voxel, closed, and inside their solids."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray
from gaga_core.errors import GagaError
from gaga_core.export.simulation.bodies import mass_properties
from gaga_core.export.solids import (
    MOST_TRIANGLES,
    MeshConfig,
    box_mesh,
    convex_collider,
    proxy_mesh_stage,
)
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import matrices_to_quats, quats_to_matrices
from gaga_core.io.meshes import MeshFile, TriangleMesh, write_mesh
from gaga_core.io.splats.glb import Buffers
from gaga_core.io.splats.packing import joined_splats
from gaga_core.io.splats.splat_files import read_splats_stage
from gaga_core.progress import run_stage
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.scene.orientation import views_around
from gaga_core.scene.selection.bounds import oriented_box
from gaga_core.training.stereo import DepthView

trimesh = pytest.importorskip("trimesh")
_VOXELS = 32
_TURN = quats_to_matrices(np.array([[0.9, 0.2, -0.3, 0.25]]))[0]
_SIDES = np.array([1.0, 0.7, 0.5])


def _surfels(points: DoubleArray, normals: DoubleArray, size: float, rgb: DoubleArray) -> Gaussians:
    """Opaque discs on a surface."""
    side = np.cross(normals, [0.31, 0.53, 0.79])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    axes = np.stack([side, np.cross(normals, side), normals], axis=2)
    n = len(points)
    return Gaussians(
        means=points.astype(np.float32),
        quats=matrices_to_quats(axes).astype(np.float32),
        log_scales=np.tile(np.log([size, size, size / 20]), (n, 1)).astype(np.float32),
        logit_opacities=np.full(n, 4, np.float32),
        sh=((rgb[:, None, :] - 0.5) / 0.28209479).astype(np.float32),
    )


def _sphere() -> Gaussians:
    """Radius 1; red above, blue below."""
    out = np.random.default_rng(0).normal(size=(6000, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    rgb = np.where(out[:, 2:] > 0, [[0.9, 0.2, 0.1]], [[0.1, 0.2, 0.9]])
    return _surfels(out, out, 0.035, rgb)


def _box(open_below: bool) -> Gaussians:
    """Sides 1 x 0.7 x 0.5, turned; with ``open_below`` upright and without its bottom."""
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.5, 0.5, (9000, 3))
    face = rng.integers(0, 6, 9000)
    rows = np.arange(9000)
    points[rows, face // 2] = face % 2 - 0.5
    normals = np.zeros((9000, 3))
    normals[rows, face // 2] = 2 * (face % 2) - 1
    kept = face != 4 if open_below else face >= 0
    points, normals = points[kept] * _SIDES, normals[kept]
    if not open_below:
        points, normals = points @ _TURN.T, normals @ _TURN.T
    return _surfels(points, normals, 0.02, np.full((len(points), 3), 0.5))


def _meshed(gaussians: Gaussians) -> TriangleMesh:
    stage = proxy_mesh_stage(gaussians, CpuRasterizer(), config=MeshConfig(_VOXELS))
    return run_stage(stage)


def _solid(mesh: TriangleMesh) -> Any:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


@pytest.fixture(scope="module")
def sphere() -> TriangleMesh:
    return _meshed(_sphere())


def test_a_sphere_is_meshed_within_a_voxel_closed_and_in_its_colors(sphere: TriangleMesh) -> None:
    voxel = 2 / _VOXELS
    radius = np.linalg.norm(sphere.vertices, axis=1)
    assert np.abs(radius - 1).max() < voxel
    solid = _solid(sphere)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.volume == pytest.approx(4 / 3 * np.pi, rel=0.06), "triangles face outwards"
    assert sphere.colors is not None
    red = sphere.colors[sphere.vertices[:, 2] > 0.2].astype(float)
    blue = sphere.colors[(sphere.vertices[:, 2] < -0.2) & (sphere.vertices[:, 2] > -0.6)]
    assert np.abs(red.mean(axis=0) / 255 - [0.9, 0.2, 0.1]).max() < 0.05
    assert np.abs(blue.mean(axis=0) / 255 - [0.1, 0.2, 0.9]).max() < 0.08


@pytest.mark.parametrize("open_below", [False, True])
def test_a_box_is_meshed_within_a_voxel_and_an_open_bottom_is_closed(open_below: bool) -> None:
    mesh = _meshed(_box(open_below))
    places = mesh.vertices.astype(float) @ (np.eye(3) if open_below else _TURN)
    extent = np.ptp((_box(open_below).means), axis=0).max()
    voxel = extent / _VOXELS
    beyond = np.abs(places) - _SIDES / 2
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=1)
    inside = np.where(beyond.max(axis=1) < 0, -beyond.max(axis=1), 0)
    assert outside.max() < np.sqrt(3) * voxel, "along the diagonal of a corner"
    # Of an open bottom no more than the outline of its edge is seen.
    assert np.quantile(outside + inside, 0.95) < (1.5 if open_below else 1.0) * voxel
    solid = _solid(mesh)
    assert solid.is_watertight
    assert 0.95 < solid.volume / _SIDES.prod() < 1.2, "up to half a voxel too large"


def test_solids_contain_the_mesh_and_are_small(sphere: TriangleMesh) -> None:
    points = sphere.vertices.astype(np.float64)
    hull = convex_collider(points)
    assert len(hull.faces) <= MOST_TRIANGLES < len(sphere.faces)
    solid = _solid(hull)
    assert solid.is_watertight
    assert solid.is_convex
    assert _solid(sphere).volume < solid.volume < 1.15 * _solid(sphere).volume
    _contains(hull, points)
    long = points * [1, 8, 2] @ _TURN.T
    wrapped = convex_collider(long)
    assert _solid(wrapped).volume < 1.15 * 16 * _solid(sphere).volume, "long things, too"
    _contains(wrapped, long)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3.0)])
    cube = convex_collider(np.vstack([corners, corners.mean(axis=0)[None]]))
    assert len(cube.faces) == 12
    assert len(cube.vertices) == 8
    box = oriented_box(points, share=1.0)
    assert box is not None
    _contains(box_mesh(box), points)
    with pytest.raises(GagaError, match="flat"):
        convex_collider(np.zeros((9, 3)))


@pytest.mark.parametrize("mirror", [1, -1])
def test_the_box_of_one_splat_or_of_some_on_a_plane_is_a_solid(mirror: int) -> None:
    flat = np.array([[0, 0, 5], [2, 0, 5], [2, 1, 5], [0, 1, 5.0]]) * [mirror, 1, 1]
    for points in (flat, flat[:2], flat[:1], np.repeat(flat[:1], 9, axis=0)):
        box = oriented_box(points, share=1.0)
        assert box is not None
        mesh = box_mesh(box)
        assert len(np.unique(mesh.vertices, axis=0)) == 8
        assert _solid(mesh).volume > 0, "the faces look outwards"
        _contains(mesh, points)


def _contains(solid: TriangleMesh, points: DoubleArray) -> None:
    a, b, c = (solid.vertices[solid.faces[:, k]].astype(np.float64) for k in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    normals, a = normals[lengths > 1e-12] / lengths[lengths > 1e-12, None], a[lengths > 1e-12]
    height = points @ normals.T - (a * normals).sum(axis=1)
    assert height.max() < 1e-5 * np.ptp(points), "outside of a face"


@pytest.mark.parametrize("kind", list(MeshFile))
def test_another_program_reads_the_same_mesh(
    sphere: TriangleMesh, kind: MeshFile, tmp_path: Path
) -> None:
    path = tmp_path / f"mesh{kind.suffix}"
    write_mesh(path, sphere, kind, "a  cup\nwith a name")
    back = trimesh.load(path, force="mesh", process=False)
    turn = [-1, -1, 1] if kind is MeshFile.GLB else [1, 1, 1]
    assert back.vertices.shape == sphere.vertices.shape
    assert np.allclose(back.vertices * turn, sphere.vertices, atol=1e-5)
    assert np.array_equal(back.faces, sphere.faces)
    assert back.volume > 0
    assert sphere.colors is not None
    wanted = sphere.colors / 255
    if kind is MeshFile.OBJ:
        shown = np.asarray(back.visual.vertex_colors)[:, :3] / 255
    else:  # colors of glTF are linear; trimesh leaves them out next to a material
        shown = Buffers.of(path.read_bytes(), path).accessor(1, 3)
        wanted = np.where(wanted <= 0.04045, wanted / 12.92, ((wanted + 0.055) / 1.055) ** 2.4)
    assert np.abs(shown - wanted).max() < 0.02


def test_a_mesh_that_is_opened_is_called_one_and_names_the_splats_next_to_it(
    sphere: TriangleMesh, tmp_path: Path
) -> None:
    path = tmp_path / "cup.glb"
    write_mesh(path, sphere, MeshFile.GLB, "cup")
    for file, cure in (
        ("groups.json", "Export the object as splats"),
        ("a.ply", "Export the object as splats"),
        ("cup.spz", "Try cup.spz next to it"),
    ):
        (tmp_path / file).touch()
        with pytest.raises(GagaError, match=rf"cup.glb is a mesh of triangles, .*\. {cure}"):
            run_stage(read_splats_stage(path))


def test_a_mesh_has_about_as_many_triangles_as_are_asked_for() -> None:
    whole, fewer = (
        run_stage(proxy_mesh_stage(_sphere(), CpuRasterizer(), config=MeshConfig(48, n)))
        for n in (0, 3000)
    )
    assert len(whole.faces) > 6000
    assert 2700 < len(fewer.faces) < 3300
    edges = np.sort(fewer.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all(), "it stays closed"
    for corner in (np.min, np.max):
        assert np.allclose(corner(fewer.vertices, 0), corner(whole.vertices, 0), atol=0.05)


def test_what_has_no_surface_is_one_sentence() -> None:
    splats = _sphere().take(np.arange(3))
    with pytest.raises(GagaError, match="few splats"):
        _meshed(splats)
    clear = _sphere()
    clear.logit_opacities[:] = -9
    with pytest.raises(GagaError, match="transparent"):
        _meshed(clear)


def _tube(radius: float, low: float, high: float, floor: float, reach: float) -> Gaussians:
    """The wall of an upright cylinder, and a level ring from 0 or ``reach`` to it at ``floor``."""
    rng = np.random.default_rng(3)
    angle, z = rng.uniform(0, 2 * np.pi, 5000), rng.uniform(low, high, 5000)
    out = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(5000)])
    ring = np.sqrt(rng.uniform(reach**2, radius**2, 3000))[:, None] * out[:3000]
    points = np.vstack([radius * out + [0, 0, 1] * z[:, None], ring + np.array([0, 0, floor])])
    normals = np.vstack([out, np.tile([0.0, 0, 1], (3000, 1))])
    return _surfels(points, normals, 0.02, np.full((8000, 3), 0.5))


def test_what_photos_saw_through_is_empty() -> None:
    """A vessel whose mouth splats close: photos of the open one carve it, one wrong depth not."""
    closed = joined_splats([_tube(0.5, 0, 0.8, 0.8, 0), _tube(0.5, 0, 0.8, 0, 0)], Path())
    is_open = joined_splats([_tube(0.5, 0, 0.8, 0.8, 0.4), _tube(0.4, 0.3, 0.8, 0.3, 0)], Path())
    box = np.array([-0.5, -0.5, 0.0]), np.array([0.5, 0.5, 0.8])
    up, engine = np.array([0.0, 0, 1]), CpuRasterizer()
    cameras = views_around(box, up, [(60.0, 10)], side=160, field=0.6, room=1.2)
    seen = [DepthView(c, engine.render(is_open, c).median_depth.astype(float)) for c in cameras]
    wrong = engine.render(closed, cameras[0]).median_depth.astype(float)
    wrong[79:82, 79:82] += 0.5

    def volume(photos: list[DepthView]) -> float:
        stage = proxy_mesh_stage(closed, engine, config=MeshConfig(voxels=48), photos=photos)
        return mass_properties(run_stage(stage), 1.0, None).volume

    full, cavity = np.pi * 0.5**2 * 0.8, np.pi * 0.4**2 * 0.5
    assert volume([]) == pytest.approx(full, rel=0.15)
    # Nearer to the wall than a voxel and what depths are unsure of, nothing is cut.
    assert full - 1.1 * cavity < volume(seen) < full - 0.5 * cavity
    assert volume([DepthView(cameras[0], wrong)]) == pytest.approx(volume([]), rel=0.01)
