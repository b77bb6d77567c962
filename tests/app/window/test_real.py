"""Real scenes through the window: scanned objects on a table, and a garden."""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.io.masks.label_maps import read_labels, write_labels
from gaga_core.io.splats.ply import read_ply
from gaga_core.scene.scene import State
from gaga_studio.features import export, selection, transform
from gaga_studio.features.camera import go_to_view
from gaga_studio.features.find import association
from gaga_studio.session.settings import Settings
from tests.app.window.driver import KEY, Driver, drive

pytestmark = [pytest.mark.window, pytest.mark.slow]


def linked(source: Path, target: Path, *names: str) -> Path:
    """A scene folder of links, so that nothing is written next to the real files."""
    target.mkdir()
    for name in names:
        (target / name).symlink_to(source / name)
    return target


def test_the_table_from_masks_to_an_edited_file(
    display: str, ycb_table: Path, tmp_path: Path
) -> None:
    names = ("images", "sparse", "masks", "point_cloud.ply", "split.json")
    folder = linked(ycb_table, tmp_path / "table", *names)
    target = tmp_path / "edited.ply"
    view = 8  # a test view: no mask of it was used
    truth = read_labels(ycb_table / "gt" / "instance" / "008.png")
    seen: dict[str, int] = {}

    def walk(d: Driver) -> None:
        association.associate(d.session, preset="paper")
        d.settle()
        go_to_view(d.session, view)
        d.settle()
        camera = d.session.cameras[view]
        scene = d.session.scene
        assert scene is not None
        groups = [_click_object(d, truth, camera, int(i)) for i in np.unique(truth) if i > 1]
        assert len(set(groups)) == len(groups), "every object is a group of its own"
        assert 0 not in groups
        d.click("Inspector/###Isolate")
        assert set(np.unique(scene.labels[scene.visible])) == {groups[-1]}
        d.keys(KEY.mod_shift, KEY.h)
        transform.recolor(d.session, (0.9, 0.1, 0.1))
        transform.move(d.session, np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.1]]))
        selection.select_groups(d.session, (groups[0],), "set")
        d.engine.item_click("//Viewport/##picture", 2)
        d.keys(KEY.delete)
        n = int(scene.has(State.DELETED).sum())
        assert n == int((scene.labels == groups[0]).sum())
        d.keys(KEY.mod_ctrl, KEY.z)
        assert not scene.has(State.DELETED).any()
        d.keys(KEY.mod_ctrl, KEY.mod_shift, KEY.z)
        d.menu("File/###Export scene…")
        d.export_to(target)
        d.settle()
        seen["left"] = len(scene) - n
        d.keys(KEY.mod_ctrl, KEY.s)
        d.settle()

    drive(walk, path=folder, settings=Settings(preset="paper", identities="none"))
    assert len(read_ply(target)) == seen["left"]

    def reopened(d: Driver) -> None:
        assert d.session.scene is not None
        assert int(d.session.scene.visible.sum()) == seen["left"]

    drive(reopened, path=folder)


def _click_object(d: Driver, truth: IntArray, camera: Camera, object_id: int) -> int:
    """Click the middle of a true object in the picture; the group that is selected."""
    rows, columns = np.nonzero(truth == object_id)
    middle = np.argmin((rows - np.median(rows)) ** 2 + (columns - np.median(columns)) ** 2)
    # The picture's field of view differs from the photo's: go through a ray of the photo.
    point = camera.unproject(columns[middle] + 0.5, rows[middle] + 0.5, 1.0)
    d.click_picture(*d.project(point))
    d.settle()
    chosen = d.session.selected_groups()
    return chosen[0] if chosen else 0


def test_the_garden_is_viewed_clicked_and_exported(
    display: str, garden: Path, tmp_path: Path
) -> None:
    folder = linked(garden, tmp_path / "garden", "images", "sparse", "point_cloud.ply")
    (folder / "masks" / "blocks").mkdir(parents=True)
    # A stand-in for a segmenter: every photo in four by four blocks, numbered from its own start.
    blocks = np.kron(np.arange(1, 17).reshape(4, 4), np.ones((128, 128))).astype(np.int32)
    for i, photo in enumerate(sorted((garden / "images").iterdir())[1:60:6]):
        write_labels(folder / "masks" / "blocks" / f"{photo.stem}.png", (blocks + i) % 16 + 1)
    target = tmp_path / "part.ply"
    count: list[int] = []

    def walk(d: Driver) -> None:
        assert d.pixels().std() > 20, "the garden is on the screen"
        association.associate(d.session, preset="paper")
        d.settle()
        width, height = d.size
        d.click_picture(width / 2, height * 0.6)
        assert d.session.selected_groups()
        count.append(len(d.session.selected_indices()))
        export.export(d.session, "selected", target)
        d.settle()

    drive(walk, path=folder)
    assert len(read_ply(target)) == count[0]
