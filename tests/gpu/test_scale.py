"""What large scenes rest on: bytes a splat, rows that are appended alone, cheap first frames."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaga_core.export.export import export_scene_stage
from gaga_core.io.splats.ply import read_ply
from gaga_core.progress import run_stage
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.scene import Placements, Scene, State
from gaga_studio.gpu.buffers import SceneBuffers
from gaga_studio.gpu.viewport import Viewport
from gaga_studio.session.view import ViewState
from tests.gpu.conftest import Errors
from tests.scenes import objects_scene, orbit_cameras, random_gaussians

pytestmark = pytest.mark.gl
CAMERA = orbit_cameras(1, width=192, height=144)[0]
OTHER = orbit_cameras(5, width=192, height=144)[2]
VIEW = ViewState(background=(0.1, 0.2, 0.1))
TURN = np.array([[0.0, -1, 0, 0.1], [1, 0, 0, -0.2], [0, 0, 1, 0.3]])
RED = np.array([[0.5, 0.1, 0, 0.3], [0, 0.6, 0, 0], [0, 0, 0.4, 0.1]])


def _contents(buffers: SceneBuffers) -> dict[str, bytes]:
    """What the textures hold of the splats that there are."""
    found = {}
    for name, texture in buffers.textures():
        data = np.frombuffer(texture.read(alignment=1), np.uint8)
        layers = getattr(texture, "layers", 1)
        if name in ("u_palette", "u_placements"):
            found[name] = data.tobytes()
            continue
        texel = len(data) // (layers * texture.width * texture.height)
        rows = data.reshape(layers, -1, texel)[:, : buffers.n_splats]
        found[name] = rows.tobytes()
    return found


def _fresh(gl: Any, scene: Scene) -> dict[str, bytes]:
    buffers = SceneBuffers(gl)
    buffers.sync(scene)
    found = _contents(buffers)
    buffers.release()
    return found


def test_a_splat_of_degree_three_takes_at_most_120_bytes(viewport: Viewport) -> None:
    """Everything that grows with their number, depth order and projected splats included."""
    n = 2048 * 60
    scene = Scene.of(random_gaussians(n, sh_degree=3))
    viewport.draw(scene, CAMERA.resized(16, 12), VIEW, wait=True)
    tables = 2048 * 16 * 2  # palette and placements: their size does not depend on n
    assert viewport.nbytes - tables <= 120 * n


@pytest.mark.parametrize("sh_degree", [0, 3])
def test_duplicates_are_sent_alone_and_arrive_whole(gl: Any, sh_degree: int) -> None:
    """A walk of duplicates, undos and redos, some of them between two looks."""
    scene = Scene.of(random_gaussians(5000, sh_degree=sh_degree), np.ones(5000, np.int32))
    history, buffers = History(scene), SceneBuffers(gl)
    buffers.sync(scene)
    rng = np.random.default_rng(1)
    before = buffers._textures["means"]
    for step in range(12):
        for _ in range(int(rng.integers(1, 4))):
            move = int(rng.integers(5))
            if move < 3:
                rows = rng.permutation(len(scene))[: int(rng.integers(1, 900))]
                history.do(edits.duplicate(scene, rows, TURN if step % 2 else None))
            elif move == 3:
                history.undo()
            else:
                history.redo()
        buffers.sync(scene)
        assert _contents(buffers) == _fresh(gl, scene), step
    assert buffers._textures["means"] is not before  # it has grown
    buffers.release()


def test_files_of_any_degree_arrive_whole_and_leave_whole(gl: Any) -> None:
    """A walk of added files, undos and redos: the color of all rows widens and narrows."""
    gaussians = random_gaussians(3000, sh_degree=1)
    scene = Scene.of(gaussians, np.ones(3000, np.int32))
    history, buffers = History(scene), SceneBuffers(gl)
    buffers.sync(scene)
    rng = np.random.default_rng(2)
    degrees = set()
    for step in range(24):
        for _ in range(int(rng.integers(1, 3))):
            move = rng.random()
            if move < 0.4:
                # Rows of the scene: their sizes stay within what the card's steps cover.
                added = gaussians.take(rng.permutation(3000)[:400])
                n_sh = (int(rng.integers(4)) + 1) ** 2
                added = replace(added, sh=rng.random((400, n_sh, 3), np.float32))
                history.do(edits.append(scene, added, Path("a.ply"), "0"))
            elif move < 0.8:
                history.undo()
            else:
                history.redo()
        buffers.sync(scene)
        degrees.add(scene.gaussians.sh_degree)
        assert _contents(buffers) == _fresh(gl, scene), step
    assert degrees == {1, 2, 3}
    buffers.release()


def test_a_duplicate_does_not_send_the_scene_again(
    gl: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = Scene.of(random_gaussians(4000))
    history, buffers = History(scene), SceneBuffers(gl)
    buffers.sync(scene)
    sent: list[int] = []
    monkeypatch.setattr(
        buffers, "_send_gaussians", lambda gaussians, first: sent.append(len(gaussians) - first)
    )
    history.do(edits.duplicate(scene, np.arange(50)))
    buffers.sync(scene)
    history.undo()
    buffers.sync(scene)
    assert sent == [50, 0]
    buffers.release()


def test_splats_that_were_replaced_are_sent_again(gl: Any) -> None:
    scene = Scene.of(random_gaussians(3000))
    buffers = SceneBuffers(gl)
    buffers.sync(scene)
    scene.gaussians = random_gaussians(3000, seed=9)
    scene.revision.splats += 1  # without a word about what was kept
    buffers.sync(scene)
    assert _contents(buffers) == _fresh(gl, scene)
    buffers.release()


def test_more_placements_than_sixteen_bits_can_count(gl: Any) -> None:
    n = 70_000
    scene = Scene.of(random_gaussians(n))
    buffers = SceneBuffers(gl)
    buffers.sync(scene)
    scene.placements = Placements.identity(n)
    scene.placement = np.arange(n, dtype=np.int32)
    scene.revision.placement += 1
    scene.revision.placements += 1
    buffers.sync(scene)
    texture = buffers._textures["placement"]
    found = np.frombuffer(texture.read(alignment=1), np.uint32)[:n]
    assert np.array_equal(found, scene.placement)
    buffers.release()


def test_a_motion_begins_with_few_splats_while_their_order_is_the_old_one(
    viewport: Viewport, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = Scene.of(random_gaussians(3000))
    viewport.draw(scene, CAMERA, replace(VIEW, coarse_budget=200), wait=True)
    assert viewport._splats._n_order > 2000
    monkeypatch.setattr(viewport._sorter, "submit", lambda _: None)  # it has not come yet
    viewport.draw(scene, OTHER, replace(VIEW, splat_budget=200))
    assert 0 < viewport._splats._n_order <= 200
    assert not viewport.settled


def test_after_a_motion_the_full_picture_is_drawn_once(viewport: Viewport) -> None:
    """It waits for the order of all splats: not first with the few of the motion."""
    scene = Scene.of(random_gaussians(3000))
    viewport.draw(scene, CAMERA, VIEW, wait=True)
    full = viewport.read_pixels()
    coarse = replace(VIEW, splat_budget=200, resolution_scale=0.5)
    viewport.draw(scene, CAMERA, coarse, wait=True)
    drawn = viewport.n_draws
    viewport.draw(scene, CAMERA, VIEW)
    for _ in range(2000):
        if viewport.settled:
            break
        assert viewport.n_draws == drawn
        viewport._sorter.wait(viewport._ticket, timeout=0.01)
        viewport.draw(scene, CAMERA, VIEW)
    assert viewport.n_draws == drawn + 1
    assert np.array_equal(viewport.read_pixels(), full)


def test_what_was_exported_and_opened_again_is_the_picture_that_was_seen(
    viewport: Viewport, mean_error: Errors, tmp_path: Path
) -> None:
    """View-dependent color to degree 3, an object turned and recolored, one deleted."""
    synthetic = objects_scene(sh_degree=3)
    scene = Scene.of(synthetic.gaussians, synthetic.labels)
    history = History(scene)
    history.do(edits.transform(scene, scene.labels == 1, TURN))
    history.do(edits.recolor(scene, scene.labels == 1, RED))
    history.do(edits.delete(scene, scene.labels == 2))
    run_stage(export_scene_stage(scene, tmp_path / "edited.ply"))
    opened = read_ply(tmp_path / "edited.ply")
    assert scene.has(State.DELETED).any()
    for camera in (CAMERA, OTHER):
        viewport.draw(scene, camera, VIEW, wait=True)
        live = viewport.read_pixels().astype(int)
        viewport.draw(Scene.of(opened), camera, VIEW, wait=True)
        assert np.abs(viewport.read_pixels() - live).mean() < 0.5  # the promise is 1
        assert mean_error(scene, opened, camera) < 1  # the promise is 2


def test_a_third_of_the_splats_is_nearly_the_same_picture(viewport: Viewport) -> None:
    """They grow to stand for the others: no holes, no object that is gone."""
    scene = Scene.of(objects_scene(per_object=400).gaussians)
    viewport.draw(scene, CAMERA, VIEW, wait=True)
    full = viewport.read_pixels().astype(int)
    viewport.draw(scene, CAMERA, replace(VIEW, splat_budget=len(scene) // 3), wait=True)
    assert np.abs(viewport.read_pixels() - full).mean() < 5  # without growing: 9
