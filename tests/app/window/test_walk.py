"""The main job in the window, from a scene folder to an edited .ply, by mouse and keys."""

from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import ImVec2, imgui

from gaga_core.arrays import BoolArray, DoubleArray, UInt8Array
from gaga_core.color import rgb_from_dc
from gaga_core.io.splats.ply import read_ply
from gaga_core.scene.scene import State
from gaga_studio.features.find import association
from gaga_studio.session.view import ToolName
from tests.app.folders import write_scene
from tests.app.window.driver import KEY, Driver, drive

pytestmark = pytest.mark.window


def test_from_masks_to_an_edited_file(display: str, tmp_path: Path) -> None:
    folder, target = tmp_path / "balls", tmp_path / "edited.ply"
    made = write_scene(folder)
    walk = _Walk(made.gaussians.means.astype(np.float64), made.labels)

    def first(d: Driver) -> None:
        walk.associate(d)
        walk.select_by_click(d)
        walk.isolate_and_show(d)
        walk.recolor(d)
        walk.move_by_number(d)
        walk.move_by_handle(d)
        walk.duplicate_and_delete(d)
        walk.undo_and_redo_everything(d)
        walk.export(d, target)
        walk.save(d)

    drive(first, path=folder)
    walk.check_file(target)
    drive(walk.check_reopened, path=folder)


class _Walk:
    """What the person has done so far."""

    def __init__(self, means: DoubleArray, labels: np.ndarray) -> None:
        self.means, self.labels = means, labels
        self.ball = int(labels.max())  # the true ball that is edited
        self.group = 0
        self.centre = means[labels == self.ball].mean(axis=0)
        self.final: DoubleArray = np.zeros((0, 3))  # visible centres at the end

    def associate(self, d: Driver) -> None:
        assert association.stage_offer(d.session) is not None
        d.click("**/###Find objects")
        d.until(lambda: d.session.live is not None, "the bank is shown while it grows")
        d.settle()
        assert int(d.session.scene.labels.max()) == 6  # type: ignore[union-attr]
        assert association.stage_offer(d.session) is None

    def select_by_click(self, d: Driver) -> None:
        before = d.pixels()
        d.click_picture(*d.project(self.centre))
        self.group = d.session.focus
        assert self.group > 0
        assert d.session.selected_groups() == (self.group,)
        inside = self.labels == self.ball
        chosen = np.zeros(len(inside), bool)
        chosen[d.session.selected_indices()] = True
        assert (chosen & inside).sum() / (chosen | inside).sum() > 0.9
        assert not np.array_equal(before, d.pixels()), "the selection has an outline"

    def isolate_and_show(self, d: Driver) -> None:
        before = d.pixels()
        d.click("Inspector/###Isolate")
        alone = d.pixels()
        assert _background(alone).mean() > _background(before).mean() + 0.1
        d.keys(KEY.mod_shift, KEY.h)
        np.testing.assert_array_equal(d.pixels(), before)

    def recolor(self, d: Driver) -> None:
        d.click("Inspector/Properties/Color")
        d.frames()
        d.type_into("$FOCUSED/##Picker/##hex/##Text", "#F02010")
        d.keys(KEY.escape)
        assert _count_red(d.pixels()) > 300
        assert d.session.history.undo_title.startswith("Recolor")  # type: ignore[union-attr]

    def move_by_number(self, d: Driver) -> None:
        before, box = self._centre(d), d.session.document.selected_box()  # type: ignore[union-attr]
        wanted = (box[0][2] + box[1][2]) / 2 + 0.4  # type: ignore[index]
        d.type_into("Inspector/Properties/##Position Z", f"{wanted:.3f}")
        np.testing.assert_allclose(self._centre(d) - before, [0, 0, 0.4], atol=2e-3)
        moved, n_entries = self._centre(d), d.session.history.cursor  # type: ignore[union-attr]
        d.engine.mouse_move("Inspector/Properties/##Position Z")
        d.engine.mouse_down(0)
        d.engine.mouse_move_to_pos(imgui.get_io().mouse_pos + ImVec2(60, 0))
        d.frames()
        assert d.session.history.is_previewing  # type: ignore[union-attr]
        d.keys(KEY.escape)
        d.frames()
        assert not d.session.history.is_previewing  # type: ignore[union-attr]
        d.engine.mouse_up(0)
        d.frames()
        np.testing.assert_allclose(self._centre(d), moved)
        assert d.session.history.cursor == n_entries  # type: ignore[union-attr]

    def move_by_handle(self, d: Driver) -> None:
        d.keys(KEY._1)
        assert d.tool() is ToolName.MOVE
        before = self._centre(d)
        n_entries = d.session.history.cursor  # type: ignore[union-attr]
        box = d.session.document.selected_box()  # type: ignore[union-attr]
        u, v = d.project((box[0] + box[1]) / 2)  # type: ignore[index]
        d.settle()
        d.drag_picture((u, v - 40), (0, -30))  # the arrow of the z axis points up here
        moved = self._centre(d) - before
        assert moved[2] > 0.02
        assert np.abs(moved[:2]).max() < 1e-6
        assert d.session.history.cursor == n_entries + 1  # type: ignore[union-attr]
        d.keys(KEY.escape)
        assert d.tool() is ToolName.PICK

    def duplicate_and_delete(self, d: Driver) -> None:
        n = len(d.session.scene)  # type: ignore[arg-type]
        n_chosen = len(d.session.selected_indices())
        d.click("Inspector/###Duplicate")
        assert len(d.session.scene) == n + n_chosen  # type: ignore[arg-type]
        d.engine.item_click("//Viewport/##picture", 2)  # no text field has the keyboard
        d.keys(KEY.delete)
        assert int(d.session.scene.has(State.DELETED).sum()) == n_chosen  # type: ignore[union-attr]

    def undo_and_redo_everything(self, d: Driver) -> None:
        after, final = d.pixels(), self._visible(d)
        history = d.session.history
        assert history is not None
        n = history.cursor
        for _ in range(n):
            d.keys(KEY.mod_ctrl, KEY.z)
        assert history.cursor == 0
        assert int(d.session.scene.labels.max()) == 0  # type: ignore[union-attr]
        assert d.session.scene.visible.all()  # type: ignore[union-attr]
        np.testing.assert_allclose(self._visible(d), self.means, atol=1e-6)
        for _ in range(n):
            d.keys(KEY.mod_ctrl, KEY.mod_shift, KEY.z)
        assert history.cursor == n
        np.testing.assert_array_equal(self._visible(d), final)
        np.testing.assert_array_equal(d.pixels(), after)
        self.final = final

    def export(self, d: Driver, target: Path) -> None:
        d.menu("File/###Export scene…")
        d.export_to(target)
        d.settle()
        assert target.is_file(), [notice.text for notice in d.session.notices]

    def save(self, d: Driver) -> None:
        assert d.session.unsaved
        d.keys(KEY.mod_ctrl, KEY.s)
        d.settle()
        assert not d.session.unsaved

    def check_file(self, target: Path) -> None:
        """The file says what was on the screen."""
        exported = read_ply(target)
        np.testing.assert_allclose(_sorted(exported.means), _sorted(self.final), atol=1e-5)
        rgb = rgb_from_dc(exported.sh[:, 0])
        red = (rgb[:, 0] > 0.7) & (rgb[:, 1] < 0.35) & (rgb[:, 2] < 0.35)
        assert red.sum() > 150
        assert exported.means[red][:, 2].mean() > 0.3

    def check_reopened(self, d: Driver) -> None:
        np.testing.assert_allclose(_sorted(self._visible(d)), _sorted(self.final), atol=1e-6)
        assert int(d.session.scene.labels.max()) >= 6  # type: ignore[union-attr]
        assert d.session.decisions(self.group)
        assert _count_red(d.pixels()) > 300

    def _visible(self, d: Driver) -> DoubleArray:
        """Centres (K, 3) of what is visible, placements applied."""
        scene = d.session.scene
        assert scene is not None
        matrix = scene.placements.matrix[scene.placement]
        means = scene.gaussians.means.astype(np.float64)
        world = np.einsum("nij,nj->ni", matrix[:, :, :3], means) + matrix[:, :, 3]
        result: DoubleArray = world[scene.visible]
        return result

    def _centre(self, d: Driver) -> DoubleArray:
        table = d.session.objects()
        row = table.row(self.group)
        assert row is not None
        result: DoubleArray = table.centre[row].copy()
        return result


def _background(picture: UInt8Array) -> BoolArray:
    result: BoolArray = np.abs(picture.astype(int) - np.array([28, 28, 31])).max(axis=2) <= 4
    return result


def _count_red(picture: UInt8Array) -> int:
    rgb = picture.astype(int)
    return int(((rgb[..., 0] > 150) & (rgb[..., 1] < 90) & (rgb[..., 2] < 90)).sum())


def _sorted(points: np.ndarray) -> np.ndarray:
    rounded = np.round(points.astype(np.float64), 4)
    return points[np.lexsort(rounded.T)]
