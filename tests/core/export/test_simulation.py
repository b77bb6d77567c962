"""Bodies for simulators: mass of known solids, convex parts that hold, files that load."""

import json
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial import ConvexHull, cKDTree

from gaga_core.arrays import DoubleArray
from gaga_core.cli.main import main
from gaga_core.export.simulation.bodies import (
    Body,
    Box,
    Plane,
    Static,
    World,
    body_stage,
    closed_on,
    convex_parts,
    lies_in,
    mass_properties,
    parts_of,
    support_of,
    upright_place,
    without,
)
from gaga_core.export.simulation.export import STEP as BODIES
from gaga_core.export.simulation.export import (
    SimulationExport,
    export_simulation_stage,
    unit_sentence,
    world_stage,
)
from gaga_core.export.simulation.falling import fall
from gaga_core.export.simulation.mjcf import mjcf_of, static_urdf_of, urdf_of
from gaga_core.export.simulation.settings import SimulationConfig
from gaga_core.export.solids import STEP, MeshConfig
from gaga_core.io.meshes import TriangleMesh
from gaga_core.io.splats.glb import placed
from gaga_core.io.splats.splat_files import read_splats, write_splats
from gaga_core.progress import Progress, run_stage, threaded_stage
from gaga_core.scene.bake import bake
from gaga_core.scene.edits import duplicate
from gaga_core.scene.scene import Scene
from tests.scenes import box_on_table, random_gaussians
from tests.usd_files import complaints

trimesh = pytest.importorskip("trimesh")
for _package in ("coacd", "manifold3d", "mujoco"):
    pytest.importorskip(_package, reason=f"{_package} is not installed")
_CONFIG = SimulationConfig(parts=16, concavity=0.05)


def _mesh(solid: Any) -> TriangleMesh:
    vertices = np.ascontiguousarray(solid.vertices, np.float32)
    return TriangleMesh(vertices, np.ascontiguousarray(solid.faces, np.int32))


def _cup() -> TriangleMesh:
    """A tube of 40 mm inside and 60 mm height with a floor of 10 mm, 5 mm thick."""
    import manifold3d

    outer = manifold3d.Manifold.cylinder(0.06, 0.025, circular_segments=32)
    inner = manifold3d.Manifold.cylinder(0.06, 0.02, circular_segments=32).translate((0, 0, 0.01))
    found = (outer - inner).to_mesh()
    corners = np.ascontiguousarray(found.vert_properties[:, :3], np.float32)
    return TriangleMesh(corners, np.ascontiguousarray(found.tri_verts, np.int32))


def _body(mesh: TriangleMesh, config: SimulationConfig, at: tuple[float, float, float]) -> Body:
    return Body(
        id=1,
        name="cup",
        stem="cup",
        position=np.array(at),
        gaussians=random_gaussians(5),
        mesh=mesh,
        parts=convex_parts(mesh, config),
        properties=mass_properties(mesh, config.density, None),
        underside="as seen",
    )


def _world(*bodies: Body) -> World:
    floor = Box(np.array([0, 0, -0.05]), np.eye(3), np.array([1, 1, 0.05]))
    return World(tuple(bodies), Static(None, (floor,)), is_metric=True, config=_CONFIG)


def test_mass_centre_and_inertia_are_those_of_the_solid() -> None:
    """A box of 0.1 x 0.2 x 0.3 m, turned and moved; a typed mass takes the place of density."""
    sides = np.array([0.1, 0.2, 0.3])
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])
    turn[:3, 3] = 1, -2, 3
    mesh = _mesh(trimesh.creation.box(sides, transform=turn))
    found = mass_properties(mesh, 800.0, None)
    assert found.mass == pytest.approx(800 * sides.prod(), rel=1e-5)
    assert np.allclose(found.centre, [1, -2, 3], atol=1e-5)
    squares = sides**2
    moments = np.diag(found.mass / 12 * (squares.sum() - squares))
    assert np.allclose(found.inertia, turn[:3, :3] @ moments @ turn[:3, :3].T, rtol=1e-3, atol=1e-6)
    typed = mass_properties(mesh, 800.0, 2.0)
    assert typed.mass == pytest.approx(2)
    assert np.allclose(typed.inertia / found.inertia, 2 / found.mass, rtol=1e-4)


def test_the_underside_is_cut_at_its_support() -> None:
    """A ball that ends 4 mm under its support, and one that ends 4 mm over it: both stand."""
    for lift in (-0.004, 0.004):
        ball = trimesh.creation.icosphere(4, 0.05)
        ball.apply_translation([0, 0, 0.05 + lift])
        closed, stands = closed_on(_mesh(ball), Plane(np.zeros(3), np.array([0, 0, 1.0])), 0.001)
        solid = trimesh.Trimesh(closed.vertices, closed.faces, process=False)
        assert stands
        assert solid.is_watertight
        assert solid.bounds[0, 2] == pytest.approx(0, abs=1e-6)
        floor = np.abs(closed.vertices[:, 2]) < 1e-6
        assert floor.sum() > 3


def test_a_support_is_found_under_an_object_and_not_beside_a_wall() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform([-0.05, -0.05, 0.0], [0.05, 0.05, 0.1], (500, 3))
    table = np.column_stack([rng.uniform(-0.3, 0.3, (4000, 2)), rng.normal(0, 0.0005, 4000)])
    wall = np.column_stack([np.full(4000, 0.08), rng.uniform(-0.3, 0.3, (4000, 2))])
    plane = support_of(points, table)
    assert plane is not None
    assert plane.normal[2] > 0.999
    assert abs(plane.heights(np.zeros((1, 3)))[0]) < 0.001
    assert support_of(points, wall) is None
    assert support_of(points, table[:10]) is None
    above = np.array([0.0, 0.0, 0.5])
    shelf = table[table[:, 0] < -0.05] + above  # next to what hangs in the air
    hanging = points + above
    assert support_of(hanging, shelf) is None
    few = shelf[:40]
    assert len(few) == 40
    assert support_of(hanging, few) is None, "few splats next to it, neither"
    for height in (0.1, 0.3, 0.45, 0.49, 0.5, 0.6):
        for dense in (1, 6):
            raised = np.repeat(shelf, dense, axis=0) + np.array([0, 0, height - 0.5])
            found = support_of(hanging, np.concatenate([raised, table]))
            assert found is not None
            assert abs(found.heights(np.zeros((1, 3)))[0]) < 0.001, "it falls on the table"
    corner = table[(table[:, 0] < 0.04) & (table[:, 1] < 0.04)]  # it overhangs at two edges
    assert support_of(points, corner) is not None


def _ball() -> Body:
    sphere = _mesh(trimesh.creation.icosphere(2, 0.015))
    return replace(_body(sphere, replace(_CONFIG, parts=1), (0, 0, 0.09)), stem="ball")


def _ball_rests_at(config: SimulationConfig) -> DoubleArray:
    """Where a ball of 30 mm is that was let fall into the cup, 2 s later."""
    places = list(fall(_world(_body(_cup(), config, (0, 0, 0)), _ball()), seconds=2.0))
    assert len(places) == 61
    found: DoubleArray = places[-1][1, :3, 3]
    return found


def test_a_ball_stays_in_a_cup_of_parts_and_not_on_one_hull() -> None:
    inside = _ball_rests_at(_CONFIG)
    assert inside[2] < 0.045
    assert np.linalg.norm(inside[:2]) < 0.02
    outside = _ball_rests_at(replace(_CONFIG, parts=1))
    assert outside[2] > 0.06 or np.linalg.norm(outside[:2]) > 0.02


def test_a_vessel_is_hollow_where_something_lies_in_it() -> None:
    """A cylinder that photos could not see into, and the ball in it: it is there alone."""
    full = _mesh(trimesh.creation.cylinder(0.05, 0.06))  # to z = 30 mm
    ball = trimesh.creation.icosphere(3, 0.03)
    ball.apply_translation([0, 0, 0.015])
    vertices, inside = full.vertices.astype(np.float64), np.array(ball.vertices)
    assert lies_in(inside, vertices)
    assert not lies_in(vertices, inside)
    assert not lies_in(inside + np.array([0, 0, 0.045]), vertices)  # it stands on it
    gap = 0.001
    hollow = without(full, [inside], gap)
    from_middle = np.linalg.norm(hollow.vertices - ball.center_mass, axis=1)
    assert from_middle.min() == pytest.approx(0.03 + gap, rel=0.01)
    height = 0.03 + gap + 0.015  # of the cap of the ball that is in the cylinder
    cap = np.pi * height**2 * (3 * (0.03 + gap) - height) / 3
    less = mass_properties(full, 1, None).volume - mass_properties(hollow, 1, None).volume
    assert less == pytest.approx(cap, rel=0.01)
    assert without(full, [], gap).faces.shape == full.faces.shape


def test_what_lies_in_a_vessel_is_where_no_part_of_the_vessel_is_and_rests_there() -> None:
    """A ball sunk into a box of few coarse parts, which alone would reach into it."""
    import manifold3d

    box = box_on_table()
    ball = trimesh.creation.icosphere(4, 0.022).vertices + np.array([0, 0.1, 0])  # the box's top
    splats = box.take(np.append(np.arange(len(box)), np.arange(len(ball))))
    splats.means[len(box) :] = ball * [1, -1, -1]
    splats.extra["group"][len(box) :] = 3
    config = replace(_CONFIG, parts=4, concavity=0.3)
    how = SimulationExport(config=config, mesh=MeshConfig(voxels=32), up=(0, -1, 0))
    world = run_stage(world_stage(Scene.of(splats, splats.extra["group"]), how, (1, 3)))
    vessel, held = world.bodies
    assert vessel.holds == (held.name,)

    def solids(body: Body) -> list[Any]:
        hull = manifold3d.Manifold.hull_points
        return [hull((part.vertices + body.position).astype(np.float64)) for part in body.parts]

    least = 1e-6 * held.properties.volume  # what float32 tells
    assert all((a ^ b).volume() < least for a in solids(vessel) for b in solids(held))
    assert sum(solid.volume() for solid in solids(vessel)) > 0.5 * vessel.properties.volume
    *_, last = fall(world, 2.0)
    assert np.abs(last[1, :3, 3] - held.position).max() < 0.002
    assert np.trace(last[1, :3, :3]) > 1 + 2 * np.cos(np.radians(1))


@pytest.mark.parametrize("tilt", [0.0, 0.1])
def test_bodies_have_a_foot_under_their_centre_of_mass(tilt: float) -> None:
    """Also a cone on its tip and a slanted prism: nothing is under the support, and what is on it
    reaches as far around the centre of mass as a tenth of the size."""
    normal = np.array([np.sin(tilt), 0, np.cos(tilt)])
    plane = Plane(np.array([0.01, 0.02, 0.0]), normal)
    cone = trimesh.creation.cone(0.05, 0.1)
    cone.vertices *= [1, -1, -1]
    prism = trimesh.creation.box((0.06, 0.05, 0.12))
    prism.vertices[:, 0] += 0.6 * (prism.vertices[:, 2] + 0.06)
    for solid in (cone, prism):
        mesh = _mesh(solid)
        low = plane.heights(mesh.vertices.astype(np.float64)).min()
        mesh, stands = closed_on(mesh.moved(low * normal, 1.0), plane, 0.001)
        assert stands
        parts = parts_of(mesh, plane, 0.002, replace(_CONFIG, parts=4))
        corners = np.concatenate([part.vertices for part in parts]).astype(np.float64)
        heights = plane.heights(corners)
        assert heights.min() == pytest.approx(0, abs=1e-6)
        on_it = corners[heights < 1e-5]
        middle = mass_properties(mesh, 1.0, None).centre
        wide = 0.099 * np.ptp(mesh.vertices, axis=0).max()
        for x, y in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            hull = ConvexHull(on_it[:, :2])
            spot = middle[:2] + wide * np.array([x, y])
            assert (hull.equations[:, :2] @ spot + hull.equations[:, 2] < 1e-6).all()


def test_a_box_rests_where_it_stood() -> None:
    mesh = _mesh(trimesh.creation.box((0.1, 0.06, 0.2)).apply_translation([0, 0, 0.1]))
    *_, last = fall(_world(_body(mesh, _CONFIG, (0.2, 0.1, 0))), seconds=2.0)
    assert np.abs(last[0, :3, 3] - [0.2, 0.1, 0]).max() < 1e-3
    assert np.abs(last[0, :3, :3] - np.eye(3)).max() < 1e-2


def test_a_cancel_does_not_wait_for_the_search_for_convex_parts() -> None:
    """It is one call of a library, and another one does not run next to it."""
    release, turn = threading.Event(), threading.Lock()
    waiting = Progress("Find convex parts", 0, 1)
    first = threaded_stage(waiting, release.wait, turn)
    assert next(first) == waiting
    first.close()  # returns, though nothing lets it go on
    begun = threading.Event()
    second = threaded_stage(waiting, begun.set, turn)
    assert next(second) == waiting
    assert not begun.is_set()
    second.close()
    third = threaded_stage(waiting, lambda: 3, turn)
    assert next(third) == waiting
    release.set()
    assert run_stage(third) == 3
    assert not begun.is_set(), "what was cancelled before its turn is not done"
    with pytest.raises(ZeroDivisionError):
        run_stage(threaded_stage(waiting, lambda: 1 // 0, turn))


def test_a_body_can_be_cancelled_between_any_two_views() -> None:
    stage = body_stage(random_gaussians(400), None, _CONFIG, MeshConfig(32), None, 500.0)
    steps = list[Progress]()
    run_stage(stage, steps.append)
    views = [step for step in steps if step.stage == STEP]
    assert [step.done for step in views] == list(range(views[-1].total + 1))
    assert views[-1].total > 2 * len({step.message for step in views if step.message})


def test_urdf_and_mjcf_say_mass_and_parts() -> None:
    body = _body(_cup(), _CONFIG, (0, 0, 0))
    assert urdf_of(body, 0.5).count("<collision>") == len(body.parts) > 1
    text = mjcf_of(_world(body), {"cup": "splats/cup.ply"})
    assert f'mass="{body.properties.mass:.9g}"' in text
    assert 'data="splats/cup.ply"' in text


def test_what_is_not_chosen_stays_in_the_way() -> None:
    """The box next to the chosen one is an obstacle where it stands; the table is a support."""
    box = box_on_table()
    splats = box.take(np.append(np.arange(len(box)), np.arange(3000)))  # the box once more
    splats.means[len(box) :, 0] += 0.12
    labels = splats.extra["group"]
    labels[len(box) :] = 3
    how = SimulationExport(
        config=replace(_CONFIG, parts=1), mesh=MeshConfig(voxels=32), up=(0, -1, 0)
    )
    steps = list[Progress]()
    world = run_stage(world_stage(Scene.of(splats, labels), how, (1,)), steps.append)
    shares = [step.done / step.total for step in steps if step.stage == BODIES]
    assert shares == sorted(shares)
    assert len({share for share in shares if 0 < share < 1}) > 4, "the bar moves within a body"
    assert [body.id for body in world.bodies] == [1]
    assert len(world.static.boxes) == 1
    ground = world.static.ground
    assert ground is not None
    own = placed(splats.take(np.flatnonzero(labels == 3)), upright_place(how.up, 1.0)).means
    rows = ground.mesh().vertices
    apart = np.abs(rows[:, :2] - own[:, :2].mean(axis=0)).max(axis=1)
    assert np.median(rows[apart < 0.02, 2]) > own[:, 2].max() - 0.01
    assert rows[apart > 0.1, 2].max() < own[:, 2].min() + 0.01
    (still,) = list(fall(world, 2.0))[-1]
    assert np.abs(still[:3, 3] - world.bodies[0].position).max() < 0.005
    over = np.array([*own[:, :2].mean(axis=0), own[:, 2].max() + 0.02])
    ball = replace(_ball(), position=over)
    (fallen,) = list(fall(replace(world, bodies=(ball,)), 0.5))[-1]
    assert abs(fallen[2, 3] - own[:, 2].max()) < 0.02  # on the other box
    assert "static-ground" in mjcf_of(world, {})
    described = ElementTree.fromstring(static_urdf_of(world))
    assert len(described.findall(".//collision")) == 2


def test_the_command_writes_what_simulators_load(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import mujoco

    pytest.importorskip("pxr.UsdVol", reason="usd-core is not installed")
    from pxr import Usd, UsdPhysics

    table_scene, out = tmp_path / "scene.ply", tmp_path / "out"
    write_splats(table_scene, box_on_table())
    call = ["export", str(table_scene), "--out", str(out), "--what", "simulation", "--only", "1"]
    assert main([*call, "--voxels", "40", "--parts", "4", "--mass", "1=0.4"]) == 0
    assert unit_sentence(is_metric=False) in " ".join(capsys.readouterr().err.split())
    told = json.loads((out / "simulation.json").read_text())
    (thing,) = told["objects"]
    assert thing["mass"] == pytest.approx(0.4)
    edge = 0.0035  # m that round splats of 2.5 mm show beyond their centres
    volume = (0.08 + 2 * edge) * (0.1 + edge) * (0.06 + 2 * edge)
    assert thing["volume"] == pytest.approx(volume, rel=0.2)
    assert thing["underside"] == "assumed flat"
    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    assert model.nbody == 2
    assert model.body_mass[1] == pytest.approx(0.4)
    data = mujoco.MjData(model)
    start = data.qpos.copy()
    while data.time < 2:
        mujoco.mj_step(model, data)
    assert np.abs(data.qpos - start)[:3].max() < 0.005
    assert complaints(out / "scene.usd") == []
    stage = Usd.Stage.Open(str(out / "scene.usd"))
    rigid = [p for p in stage.Traverse() if p.HasAPI(UsdPhysics.RigidBodyAPI)]
    assert [p.GetCustomDataByKey("gaga:group") for p in rigid] == [1]
    assert UsdPhysics.MassAPI(rigid[0]).GetMassAttr().Get() == pytest.approx(0.4)
    assert len(read_splats(out / "scene.usd")) == len(read_splats(table_scene))
    assert main([*call, "--to", "urdf", "--voxels", "24", "--parts", "1"]) == 0
    assert {path.name for path in out.glob("*.urdf")} == {
        "static.urdf",
        f"{Path(thing['splats']).stem}.urdf",
    }


def test_a_copy_is_the_same_body_at_another_place(tmp_path: Path) -> None:
    """A duplicate, turned and moved: shared meshes and a reference, read back where it stands."""
    pytest.importorskip("pxr.UsdVol", reason="usd-core is not installed")
    import mujoco
    from pxr import Usd

    scene = Scene.of(box_on_table(), box_on_table().extra["group"])
    motion = np.array([[0, 0, 1.0, 0.2], [0, 1, 0, 0], [-1, 0, 0, 0.1]])  # about the vertical
    edit = duplicate(scene, np.flatnonzero(scene.labels == 1), motion)
    assert edit is not None
    edit.apply(scene)
    config = replace(_CONFIG, parts=2)
    how = SimulationExport(config=config, mesh=MeshConfig(voxels=32), up=(0, -1, 0))
    new = int(scene.labels[-1])
    _, world = run_stage(export_simulation_stage(scene, tmp_path, how, (1, new)))
    first, copy = world.bodies
    assert (copy.id, copy.copy_of) == (new, first.stem)
    told = json.loads((tmp_path / "simulation.json").read_text())["objects"]
    assert told[1]["splats"] == told[0]["splats"]
    stage = Usd.Stage.Open(str(tmp_path / "scene.usd"))
    assert complaints(tmp_path / "scene.usd") == []
    prims = [
        stage.GetPrimAtPath(f"/World/objects/{b.stem.replace('-', '_')}") for b in world.bodies
    ]
    assert prims[1].HasAuthoredReferences()
    assert [p.GetCustomDataByKey("gaga:group") for p in prims] == [1, new]
    n_stored = len(stage.GetRootLayer().GetObjectAtPath(f"{prims[0].GetPath()}").nameChildren)
    assert n_stored == 3
    assert not stage.GetRootLayer().GetObjectAtPath(str(prims[1].GetPath())).nameChildren
    # As the scene has it, in the axes of a .ply: every splat of the copy, where it is.
    back = read_splats(tmp_path / "scene.usd").means
    shown = bake(scene).means
    assert len(back) == len(shown)
    place = upright_place(how.up, 1.0)
    there = shown @ place[:3, :3].T
    down = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # of z up
    assert np.max(cKDTree(back).query(there @ down.T)[0]) < 1e-5
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    assert model.nbody == 3
    assert model.nmesh == len(first.parts) + 1
    assert model.body_mass[1] == model.body_mass[2]
    *_, last = fall(world, 1.0)
    assert np.abs(last[1, :3, :3] - copy.turn).max() < 0.05
