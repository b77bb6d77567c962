"""The public interface: edits go back bit for bit, exports open as they were, and notebooks."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import gaga_core
from gaga_core.arrays import AnyArray, IntArray, UInt8Array
from gaga_core.progress import Progress
from tests.app.folders import write_scene


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene folder of three balls on a floor, whose masks are associated."""
    root = tmp_path_factory.mktemp("api") / "SCENE"
    write_scene(root, n_objects=3)
    assert len(gaga_core.find_objects(root).objects) >= 3
    return root


@pytest.fixture
def scene(folder: Path) -> gaga_core.Scene:
    return gaga_core.open(folder)


def state(scene: gaga_core.Scene) -> list[bytes]:
    """Everything that an edit can change."""
    data = scene.project.scene
    placed = data.placements
    columns: list[AnyArray] = [data.labels, data.state, data.placement, placed.matrix, placed.color]
    gaussians = data.gaussians
    columns += [gaussians.means, gaussians.sh, gaussians.logit_opacities, gaussians.quats]
    return [column.tobytes() for column in columns] + [repr(sorted(data.names.items())).encode()]


def test_importing_is_light_and_all_names_are_there() -> None:
    code = (
        "import sys, gaga_core; heavy = {'numpy', 'numba', 'torch', 'rich'} & set(sys.modules);"
        "assert not heavy, heavy; [getattr(gaga_core, name) for name in gaga_core.__all__];"
        "assert 'torch' not in sys.modules; assert set(gaga_core.__all__) <= set(dir(gaga_core))"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    with pytest.raises(AttributeError):
        gaga_core.nothing_of_this_name  # noqa: B018


@pytest.mark.parametrize(
    "edit",
    [
        lambda thing: thing.recolor((0.9, 0.1, 0.1)),
        lambda thing: thing.move((0.1, -0.2, 0.3)),
        lambda thing: thing.rotate((0, 0, 1), 30),
        lambda thing: thing.scale(1.5),
        lambda thing: thing.delete(),
        lambda thing: thing.isolate(),
        lambda thing: thing.rename("globe"),
        lambda thing: thing.duplicate((0.5, 0, 0)),
    ],
    ids=["recolor", "move", "rotate", "scale", "delete", "isolate", "rename", "duplicate"],
)
def test_undo_restores_bit_for_bit(
    scene: gaga_core.Scene, edit: Callable[[gaga_core.SceneObject], object]
) -> None:
    before = state(scene)
    edit(scene.objects[1])
    after = state(scene)
    assert after != before
    assert scene.undo()
    assert state(scene) == before
    assert scene.redo()
    assert state(scene) == after


def test_an_edited_export_opens_as_it_was(scene: gaga_core.Scene, tmp_path: Path) -> None:
    scene.objects[1].recolor((0.9, 0.1, 0.1))
    scene.objects[1].move((0, 0, 0.5))
    scene.objects[2].delete()
    again = gaga_core.open(scene.export(tmp_path / "edited.ply"))
    assert 2 not in again.objects
    assert {g: len(thing) for g, thing in again.objects.items()} == {
        g: len(thing) for g, thing in scene.objects.items()
    }
    np.testing.assert_allclose(again.objects[1].color, (0.9, 0.1, 0.1), atol=0.02)
    camera = scene.views[0]
    np.testing.assert_allclose(
        scene.render(camera).astype(int), again.render(camera).astype(int), atol=1
    )
    alone = gaga_core.open(scene.objects[1].export(tmp_path / "one.ply"))
    assert len(alone) == len(scene.objects[1])
    manifest = scene.export_objects(tmp_path / "objects")
    assert set(gaga_core.open(manifest).objects) == set(scene.objects)


def test_a_saved_scene_opens_as_it_was(folder: Path, tmp_path: Path) -> None:
    scene = gaga_core.open(folder / "point_cloud.ply")
    scene.click([("0", 240, 240)], name="thing")
    again = gaga_core.open(scene.save(tmp_path / "saved.gaga"))
    assert state(again)[:3] == state(scene)[:3]
    assert again.objects["thing"].id == scene.objects["thing"].id


def test_objects_are_found_by_id_name_and_words(scene: gaga_core.Scene) -> None:
    scene.objects[2].rename("globe")
    assert scene.objects["Globe"].id == 2
    (largest,) = scene.query("largest")[:1]
    assert scene.objects["largest"].id == largest.id
    for wrong in (999, "no such thing anywhere"):
        with pytest.raises(KeyError):
            scene.objects[wrong]


def test_a_notebook_shows_a_picture_and_a_table(scene: gaga_core.Scene) -> None:
    scene.objects[1].rename("<b>globe</b>")
    shown = scene._repr_html_()
    assert "data:image/png;base64," in shown
    assert "&lt;b&gt;globe&lt;/b&gt;" in shown
    assert scene._repr_png_().startswith(b"\x89PNG")
    assert scene.objects[1]._repr_png_().startswith(b"\x89PNG")
    assert scene.render(0, "groups").shape == scene.render().shape


def test_masks_of_a_function_become_objects(folder: Path, tmp_path: Path) -> None:
    told: list[Progress] = []

    def bright(image: UInt8Array) -> IntArray:
        return np.array(image.mean(axis=2) > 100, np.int32)

    made = gaga_core.segment(folder, bright, on_progress=told.append)
    assert made == folder / "masks" / "bright"
    assert told[-1].done == told[-1].total
    (tmp_path / "none").mkdir()
    with pytest.raises(gaga_core.GagaError):
        gaga_core.find_objects(folder, masks=tmp_path / "none")
