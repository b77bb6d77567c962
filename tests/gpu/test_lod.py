"""Level of detail in the picture: near the whole scene's, and exact where splats were edited."""

import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaga_core.arrays import UInt8Array
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at
from gaga_core.progress import run_stage
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.lod.build import build_lod_stage
from gaga_core.scene.lod.cut import hidden_nodes
from gaga_core.scene.lod.tree import NODE, LodTree, level_file
from gaga_core.scene.scene import Scene
from gaga_studio.gpu import lod_view
from gaga_studio.gpu.lod_view import NodePool, NodeReader, ReadNode
from gaga_studio.gpu.viewport import Overlays, Viewport
from gaga_studio.session.view import Mode, ViewState
from tests.scenes import objects_scene, orbit_cameras, random_gaussians

CAMERAS = orbit_cameras(12, width=160, height=120, radius=2.6)
ALL = ViewState(lod_budget=200_000)
FEW = ViewState(lod_budget=14_000)


@dataclass(frozen=True)
class Large:
    scene: Scene
    tree: LodTree


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Large:
    synthetic = objects_scene(6, 4_000, sh_degree=1)
    small = synthetic.gaussians.log_scales - np.float32(0.6)
    gaussians = replace(synthetic.gaussians, log_scales=small)
    folder = tmp_path_factory.mktemp("model") / "lod"
    tree = run_stage(build_lod_stage(gaussians, folder, "digest"))
    return Large(Scene.of(gaussians, synthetic.labels), tree)


@pytest.fixture
def large(made: Large) -> Large:
    """The scene as opened: edits of another test are not there."""
    return Large(Scene.of(made.scene.gaussians, made.scene.labels), made.tree)


@pytest.fixture
def whole(gl: Any) -> Iterator[Viewport]:
    """A viewport that draws every splat."""
    viewport = Viewport(gl)
    yield viewport
    viewport.release()


def picture(
    viewport: Viewport,
    scene: Scene,
    view: ViewState = ALL,
    camera: int = 0,
    overlays: Overlays | None = None,
) -> UInt8Array:
    viewport.draw(scene, CAMERAS[camera], view, overlays or Overlays(), wait=True)
    assert viewport.settled
    return viewport.read_pixels()


def difference(a: UInt8Array, b: UInt8Array) -> float:
    return float(np.abs(a.astype(np.float64) - b).mean())


@pytest.mark.parametrize(
    "mode", [Mode.COLOR, Mode.GROUPS, Mode.DEPTH, Mode.CENTRES, Mode.CONFIDENCE]
)
def test_with_budget_for_all_it_is_the_whole_picture(
    viewport: Viewport, whole: Viewport, large: Large, mode: Mode
) -> None:
    large.scene.confidence = np.arange(len(large.scene)).astype(np.uint8)
    viewport.use_tree(large.tree)
    near = replace(ALL, mode=mode)
    close = replace(CAMERAS[0], K=CAMERAS[0].K * np.array([[9.0], [9.0], [1.0]]))
    for one in (viewport, whole):
        one.draw(large.scene, close, near, wait=True)
    assert difference(viewport.read_pixels(), whole.read_pixels()) < 0.02


def test_within_a_budget_the_picture_is_nearer_than_a_thinned_one(
    viewport: Viewport, whole: Viewport, large: Large
) -> None:
    viewport.use_tree(large.tree)
    for budget in (16_000, 4_000):
        few = replace(ALL, lod_budget=budget)
        for camera in range(2):
            fine = picture(whole, large.scene, camera=camera)
            found = difference(picture(viewport, large.scene, few, camera), fine)
            as_many = replace(ALL, splat_budget=viewport.n_in_cut)
            assert found < difference(picture(whole, large.scene, as_many, camera), fine)


def nearer(step: int) -> Camera:
    pose = CAMERAS[0].cam_from_world.copy()
    pose[2, 3] -= 0.24 * step
    return replace(CAMERAS[0], cam_from_world=pose)


def turned(step: int) -> Camera:
    """Half a turn at once: what was behind the camera fills the picture."""
    eye = np.array([0.4, 0.2, 0.5])
    aim = eye + np.array([(-1.0) ** step, 0.05 * step, -0.2])
    return replace(CAMERAS[0], cam_from_world=look_at(eye, aim, np.array([0, 0, 1.0])))


@pytest.mark.parametrize("camera_of", [nearer, turned])
def test_a_motion_does_not_pop(
    viewport: Viewport, large: Large, camera_of: Callable[[int], Camera]
) -> None:
    viewport.use_tree(large.tree)
    viewport.draw(large.scene, camera_of(0), FEW, wait=True)
    before = viewport.read_pixels()
    for step in range(1, 5):
        camera = camera_of(step)
        # The same camera by the former cut, then with the swaps of one frame after the other.
        viewport.draw(large.scene, camera, FEW)
        viewport.finish_order()
        last = None
        while True:
            viewport.draw(large.scene, camera, FEW)
            viewport.finish_order()
            now = viewport.read_pixels()
            if last is not None:
                assert difference(now, last) <= 1.0
            last = now
            if viewport.settled:
                break
    assert difference(before, now) > 1.0


@pytest.mark.parametrize("limit", ["_MOST_SWAPS", "_MOST_CHANGE"])
def test_one_frame_replaces_few_nodes(
    viewport: Viewport, large: Large, monkeypatch: pytest.MonkeyPatch, limit: str
) -> None:
    monkeypatch.setattr(lod_view, limit, {"_MOST_SWAPS": 1, "_MOST_CHANGE": 0.0}[limit])
    viewport.use_tree(large.tree)
    close = replace(CAMERAS[0], K=CAMERAS[0].K * np.array([[4.0], [4.0], [1.0]]))
    viewport.draw(large.scene, close, FEW, wait=True)
    sizes = [viewport.n_in_cut]
    viewport.draw(large.scene, CAMERAS[0], FEW)
    for _ in range(300):
        viewport.finish_order()
        sizes += [viewport.n_in_cut] if viewport.n_in_cut != sizes[-1] else []
        if viewport.settled:
            break
        time.sleep(0.005)  # the reader's thread
        viewport.draw(large.scene, CAMERAS[0], FEW)
    assert len(sizes) > 3
    assert np.abs(np.diff(sizes)).max() <= 3 * NODE


def behind_a_wall() -> Gaussians:
    """A cloud of splats, and an opaque wall before it: as many again, side by side."""
    across = np.stack(np.meshgrid(np.linspace(-1.8, 1.8, 200), np.linspace(-1.5, 1.5, 200)), 2)
    wall = np.insert(across.reshape(-1, 2), 1, 0.0, axis=1)
    cloud = np.random.default_rng(0).uniform((-0.8, 2, -0.8), (0.8, 4, 0.8), (40_000, 3))
    splats = random_gaussians(80_000)
    splats.means[:] = np.concatenate([wall, cloud])
    splats.log_scales[:] = np.log(0.018)
    splats.logit_opacities[:] = 4
    splats.sh[:] = np.sin(2 * splats.means)[:, None]  # alike where depths are the same
    return splats


def test_what_is_hidden_is_drawn_coarser_and_no_picture_shows_it(
    viewport: Viewport, whole: Viewport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = Scene.of(behind_a_wall())
    tree = run_stage(build_lod_stage(scene.gaussians, tmp_path / "lod", ""))
    viewport.use_tree(tree)
    whole.use_tree(tree)
    look = hidden_nodes
    K = np.array([[160.0, 0, 80], [0, 160, 60], [0, 0, 1]])
    for x in (0.0, 0.05, 0.1):  # a camera that moves before the wall
        eye = np.array([x, -3.0, 0])
        pose = look_at(eye, eye + np.array([0, 1.0, 0]), np.array([0, 0, 1.0]))
        camera = Camera(K, pose, 160, 120, "")
        for view, is_hidden in ((ALL, True), (replace(ALL, mode=Mode.CENTRES), False)):
            monkeypatch.setattr(lod_view, "hidden_nodes", look)
            viewport.draw(scene, camera, view, wait=True)
            monkeypatch.setattr(lod_view, "hidden_nodes", lambda boxes, *_: boxes[:, 0] > np.inf)
            whole.draw(scene, camera, view, wait=True)
            assert difference(viewport.read_pixels(), whole.read_pixels()) < 1.0
            assert (viewport.n_in_cut < 0.9 * len(scene)) == is_hidden


def test_slots_stay_until_a_later_order_is_drawn(viewport: Viewport, large: Large) -> None:
    tree, scene = large.tree, large.scene
    pool = NodePool(3, tree.n_nodes, scene)
    viewport.buffers.open_pool(pool.scene, (-20.0, 20.0))
    reader = NodeReader(tree, scene.gaussians, (-20.0, 20.0))
    reader.ask([0, 1])
    nodes: list[ReadNode] = []
    while len(nodes) < 2:
        reader.wait()
        nodes += reader.take(2)
    reader.release()
    assert pool.overlaid("labels", scene.labels) is not None
    for slot, read in enumerate(nodes):
        pool.write(slot, read, scene, viewport.buffers)
        part = slice(slot * NODE, slot * NODE + len(read.rows))
        overlaid = pool.overlaid("labels", scene.labels)
        assert overlaid is not None
        assert np.array_equal(overlaid[part], scene.labels[read.rows])
    none = np.zeros(0, np.int32)
    pool.sort_job(np.array([0], np.int32), 5)
    assert 0 not in pool.free_slots(none, 5)  # it is being sorted
    pool.sort_job(np.array([1], np.int32), 6)
    assert 0 not in pool.free_slots(none, 5)  # the picture still shows it
    assert sorted(pool.free_slots(none, 6)) == [0, 2]
    assert pool.free_slots(np.array([0], np.int32), 6) == [2]


def test_a_scene_at_rest_is_not_drawn_again(viewport: Viewport, large: Large) -> None:
    viewport.use_tree(large.tree)
    picture(viewport, large.scene, FEW)
    n = viewport.n_draws
    for _ in range(5):
        viewport.draw(large.scene, CAMERAS[0], FEW)
    assert viewport.n_draws == n


def test_edits_are_drawn_as_in_the_whole_picture(
    viewport: Viewport, whole: Viewport, large: Large
) -> None:
    scene, history = large.scene, History(large.scene)
    viewport.use_tree(large.tree)
    groups = replace(ALL, mode=Mode.GROUPS)

    def check() -> None:
        assert difference(picture(viewport, scene, groups), picture(whole, scene, groups)) < 0.6

    check()
    first, second = (np.flatnonzero(scene.labels == group) for group in (1, 2))
    half = first[scene.gaussians.means[first, 2] > 0]
    history.do(edits.hide(scene, half))
    check()
    matrix = np.eye(3, 4)
    matrix[2, 3] = 0.5
    history.do(edits.transform(scene, second, matrix))
    check()
    history.do(edits.select(scene, second, "set"))
    history.do(edits.duplicate(scene, np.flatnonzero(scene.labels == 3)))
    check()
    history.do(edits.delete(scene, np.flatnonzero(scene.labels == 4)))
    check()
    while history.undo() is not None:
        pass
    check()


def test_hidden_splats_leave_no_trace_of_their_merged_ones(
    viewport: Viewport, whole: Viewport, large: Large
) -> None:
    scene = large.scene
    viewport.use_tree(large.tree)
    picture(viewport, scene, FEW)
    history = History(scene)
    history.do(edits.hide(scene, np.flatnonzero(scene.labels > 0)))
    assert difference(picture(viewport, scene, FEW), picture(whole, scene)) < 3.5
    history.do(edits.hide(scene, np.arange(len(scene))))
    assert len(np.unique(picture(viewport, scene, FEW).reshape(-1, 3), axis=0)) == 1


def test_partly_hidden_and_moved_nodes_are_merged_again(
    viewport: Viewport, whole: Viewport, large: Large
) -> None:
    scene, history = large.scene, History(large.scene)
    viewport.use_tree(large.tree)
    few = replace(FEW, lod_budget=5_000)  # too few for the splats themselves
    coarse = difference(picture(viewport, scene, few), picture(whole, scene))
    some = np.random.default_rng(0).permutation(len(scene))
    history.do(edits.hide(scene, some[: len(some) * 3 // 4]))
    assert difference(picture(viewport, scene, few), picture(whole, scene)) < 2 * coarse
    matrix = np.eye(3, 4)
    matrix[2, 3] = 0.6
    history.do(edits.transform(scene, np.flatnonzero(scene.labels == 2), matrix))
    assert difference(picture(viewport, scene, few), picture(whole, scene)) < 2 * coarse
    while history.undo() is not None:
        pass
    assert difference(picture(viewport, scene, few), picture(whole, scene)) < 1.1 * coarse


def test_labels_and_tints_of_overlays_are_those_of_the_splats(
    viewport: Viewport, whole: Viewport, large: Large
) -> None:
    viewport.use_tree(large.tree)
    groups = replace(ALL, mode=Mode.GROUPS)
    close = replace(CAMERAS[0], K=CAMERAS[0].K * np.array([[9.0], [9.0], [1.0]]))
    labels = (7 - large.scene.labels).astype(np.int32)
    tint = np.zeros((len(labels), 4), np.uint8)
    tint[large.scene.labels == 2] = (255, 0, 0, 200)
    for overlays in (Overlays(labels=labels), Overlays(tint=tint)):
        found = picture(viewport, large.scene, groups, overlays=overlays)
        assert difference(found, picture(whole, large.scene, groups, overlays=overlays)) < 0.6
    few = replace(FEW, mode=Mode.GROUPS, lod_budget=9_000)
    for overlays in (Overlays(labels=labels), Overlays(tint=tint)):
        viewport.draw(large.scene, CAMERAS[6], few, overlays, wait=True)
        for one in (viewport, whole):  # nodes that come now have these labels, too
            one.draw(large.scene, close, few, overlays, wait=True)
        assert difference(viewport.read_pixels(), whole.read_pixels()) < 0.6


def test_the_pool_does_not_grow(viewport: Viewport, large: Large) -> None:
    viewport.use_tree(large.tree)
    picture(viewport, large.scene, FEW)
    size = viewport.nbytes
    for camera in range(len(CAMERAS)):
        picture(viewport, large.scene, FEW, camera)
        assert viewport.nbytes == size


def test_what_moves_is_drawn_with_fewer_of_the_cut(viewport: Viewport, large: Large) -> None:
    viewport.use_tree(large.tree)
    picture(viewport, large.scene, FEW)
    thin = picture(viewport, large.scene, replace(FEW, splat_budget=3_000))
    assert 1.0 < difference(thin, picture(viewport, large.scene, FEW)) < 25


def test_no_picture_waits_for_a_reader_that_failed(viewport: Viewport, large: Large) -> None:
    """Of whatever it failed: here of rows that the scene does not have."""
    beyond = large.tree.order + np.int32(len(large.tree))
    viewport.use_tree(replace(large.tree, order=beyond))
    viewport.draw(large.scene, CAMERAS[0], ALL, Overlays(), wait=True)
    assert viewport.settled
    assert "out of bounds" in str(viewport.lod_error)


def test_a_damaged_file_ends_refining_and_is_told(
    viewport: Viewport, large: Large, tmp_path: Path
) -> None:
    shutil.copytree(large.tree.folder, tmp_path / "lod")
    (tmp_path / "lod" / level_file(2)).write_bytes(b"")
    viewport.use_tree(replace(large.tree, folder=tmp_path / "lod"))
    viewport.draw(large.scene, CAMERAS[0], FEW, wait=True)
    assert viewport.lod_error is not None
    assert "truncated" in str(viewport.lod_error)


def test_a_scene_that_is_drawn_whole_counts_as_a_whole(viewport: Viewport, large: Large) -> None:
    """Splats were added for which the budget has no room next to a cut."""
    scene = large.scene
    n = len(scene)
    few = replace(FEW, lod_budget=200)
    viewport.use_tree(large.tree)
    assert viewport.n_in_picture(None, few) == 0
    assert viewport.n_in_picture(scene, few) == 200
    copies = edits.duplicate(scene, np.arange(1000))
    assert copies is not None
    History(scene).do(copies)
    viewport.draw(scene, CAMERAS[0], few, Overlays(), wait=True)
    assert viewport.n_in_cut == 0
    assert viewport.n_in_picture(scene, few) == n + 1000
