"""The main job in the window, from a scene folder to an edited .ply, by mouse and keys."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import ImVec2, imgui

from gaga_core.arrays import BoolArray, DoubleArray, IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.color import rgb_from_dc
from gaga_core.io.masks.label_maps import read_labels, write_labels
from gaga_core.io.splats.ply import read_ply
from gaga_core.io.splats.splat_files import read_splats
from gaga_core.pipeline.compile_kernels import usual_seconds
from gaga_core.progress import run_stage
from gaga_core.scene.project import open_path_stage
from gaga_core.scene.scene import State
from gaga_studio.features import export, selection, transform
from gaga_studio.features.camera import go_to_view
from gaga_studio.features.find import association
from gaga_studio.session import rates
from gaga_studio.session.rates import KnownRates
from gaga_studio.session.settings import Settings
from gaga_studio.session.view import ToolName
from tests.app.folders import write_scene
from tests.app.window.driver import KEY, Driver, drive

pytestmark = pytest.mark.window


def test_from_masks_to_an_edited_file(
    display: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rates, "_TELLING_S", 0.0)  # of so small a scene, too
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
        offer, name = (
            association.stage_offer(d.session),
            f"Find objects, {d.session.settings.preset}",
        )
        before = d.session.rates.of(name)
        assert offer is not None
        usual = offer.seconds / before - usual_seconds("window", "grouping")
        d.click("**/###Find objects")
        d.until(lambda: d.session.live is not None, "the bank is shown while it grows")
        d.settle()
        assert int(d.scene.labels.max()) == 6
        assert association.stage_offer(d.session) is None
        d.keys(KEY.mod_ctrl, KEY.z)
        again = association.stage_offer(d.session)
        assert again is not None
        rate = KnownRates().rates[name]
        assert again.seconds == pytest.approx(usual * rate), "as it was here"
        assert rate != before
        d.keys(KEY.mod_ctrl, KEY.mod_shift, KEY.z)

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
        _color_red(d)
        assert _count_red(d.pixels()) > 300
        assert d.history.undo_title.startswith("Recolor")

    def move_by_number(self, d: Driver) -> None:
        before, wanted = self._centre(d), self._middle(d)[2] + 0.4
        d.type_into("Inspector/Properties/##Position Z", f"{wanted:.3f}")
        np.testing.assert_allclose(self._centre(d) - before, [0, 0, 0.4], atol=2e-3)
        moved, n_entries = self._centre(d), d.history.cursor
        d.engine.mouse_move("Inspector/Properties/##Position Z")
        d.engine.mouse_down(0)
        d.engine.mouse_move_to_pos(imgui.get_io().mouse_pos + ImVec2(60, 0))
        d.frames()
        for keys in ((KEY.h,), (KEY.delete,), (KEY.mod_ctrl, KEY.d), (KEY.mod_ctrl, KEY.z)):
            d.keys(*keys)
            assert d.history.is_previewing, "what is held is neither hidden nor undone"
        assert d.history.cursor == n_entries
        d.keys(KEY.escape)
        assert not d.history.is_previewing
        d.engine.mouse_up(0)
        d.frames()
        np.testing.assert_allclose(self._centre(d), moved)
        assert d.history.cursor == n_entries

    def move_by_handle(self, d: Driver) -> None:
        d.keys(KEY._1)
        assert d.tool() is ToolName.MOVE
        before = self._centre(d)
        n_entries = d.history.cursor
        u, v = d.project(self._middle(d))
        d.settle()
        d.drag_picture((u, v - 40), (0, -30))  # the arrow of the z axis points up here
        moved = self._centre(d) - before
        assert moved[2] > 0.02
        assert np.abs(moved[:2]).max() < 1e-6
        assert d.history.cursor == n_entries + 1
        d.keys(KEY.escape)
        assert d.tool() is ToolName.PICK

    def duplicate_and_delete(self, d: Driver) -> None:
        n = len(d.scene)
        n_chosen = len(d.session.selected_indices())
        d.click("Inspector/###Duplicate")
        assert len(d.scene) == n + n_chosen
        d.engine.item_click("//Viewport/##picture", 2)  # no text field has the keyboard
        d.keys(KEY.delete)
        assert int(d.scene.has(State.DELETED).sum()) == n_chosen

    def undo_and_redo_everything(self, d: Driver) -> None:
        after, final = d.pixels(), self._visible(d)
        history = d.history
        n = history.cursor
        for _ in range(n):
            d.keys(KEY.mod_ctrl, KEY.z)
        assert history.cursor == 0
        assert int(d.scene.labels.max()) == 0
        assert d.scene.visible.all()
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
        assert int(d.scene.labels.max()) >= 6
        assert d.session.decisions(self.group)
        assert _count_red(d.pixels()) > 300

    def _visible(self, d: Driver) -> DoubleArray:
        """Centres (K, 3) of what is visible, placements applied."""
        scene = d.scene
        matrix = scene.placements.matrix[scene.placement]
        means = scene.gaussians.means.astype(np.float64)
        world = np.einsum("nij,nj->ni", matrix[:, :, :3], means) + matrix[:, :, 3]
        result: DoubleArray = world[scene.visible]
        return result

    def _middle(self, d: Driver) -> DoubleArray:
        """Of the box of the selection (3,)."""
        box = d.session.need().selected_box()
        assert box is not None
        return (box[0] + box[1]) / 2

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


def test_the_main_job_in_six_clicks_then_in_another_window_and_theme(
    display: str, tmp_path: Path
) -> None:
    """From the first screen to a file, as the guide's film shows it; then recolored as well."""
    made = write_scene(tmp_path / "balls")
    means = made.gaussians.means.astype(np.float64)

    def walk(d: Driver) -> None:
        session, n_clicks = d.session, 0

        def click(ref: str) -> None:
            nonlocal n_clicks
            n_clicks += 1
            d.click(ref)
            d.settle()

        ball = int(made.labels.max())
        click("Viewport/###Recent 0")
        click("**/###Find objects")
        d.click_picture(*d.project(means[made.labels == ball].mean(axis=0)))
        n_clicks += 1
        click("Inspector/###Isolate")
        click("Inspector/###Export…")
        written = Path(d.studio.ui.export.path).expanduser()
        assert not written.exists()
        click("Export/###Export now")
        assert n_clicks == 6
        inside = np.isin(np.arange(len(made.labels)), session.selected_indices())
        truth = made.labels == ball
        assert (inside & truth).sum() / (inside | truth).sum() > 0.9
        assert len(read_splats(written)) == inside.sum()
        assert d.exists("**/###Show in folder")
        again(d, 5, tmp_path / "light.ply")

    def again(d: Driver, ball: int, target: Path) -> None:
        d.session.notices = ()
        d.keys(KEY.mod_shift, KEY.h)
        assert d.pixels()[0, 0].max() < 64
        d.session.change_settings(replace(d.session.settings, theme="light"))
        assert d.pixels()[0, 0].min() > 192  # where no background was chosen
        d.resize(800, 500)
        d.settle()
        d.click_picture(*d.project(means[made.labels == ball].mean(axis=0)))
        assert len(d.session.selected_groups()) == 1
        _color_red(d)
        d.click("Inspector/###Isolate")
        d.menu("File/###Export scene…")
        d.export_to(target)
        d.settle()
        inside = (made.labels == ball).sum()
        written = read_ply(target)
        assert abs(len(written.means) - inside) < 0.15 * inside
        mean = rgb_from_dc(written.sh[:, 0]).mean(axis=0)
        np.testing.assert_allclose(mean, [0.94, 0.13, 0.06], atol=0.08)

    settings = Settings(first_steps_done=True, recent=(str(tmp_path / "balls"),))
    drive(walk, settings=settings, size=(1280, 720))


def _color_red(d: Driver) -> None:
    d.click("Inspector/Properties/Color")
    d.type_into("$FOCUSED/##Picker/##hex/##Text", "#F02010")
    d.keys(KEY.escape)


# --- Real scenes through the window: scanned objects on a table, and a garden.


def linked(source: Path, target: Path, *names: str) -> Path:
    """A scene folder of links, so that nothing is written next to the real files."""
    target.mkdir()
    for name in names:
        (target / name).symlink_to(source / name)
    return target


@pytest.mark.slow
def test_the_table_from_masks_to_an_edited_file(
    display: str, ycb_table: Path, tmp_path: Path
) -> None:
    """With the masks of every fifth photo: all of them take six times as long."""
    names = ("images", "sparse", "masks", "point_cloud.ply")
    folder = linked(ycb_table, tmp_path / "table", *names)
    photos = sorted(path.name for path in (ycb_table / "images").iterdir())
    train = [name for name in photos[::5] if name != "008.jpg"]
    split = {"train": train, "test": [name for name in photos if name not in train]}
    (folder / "split.json").write_text(json.dumps(split))
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
        scene = d.scene
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

    again = run_stage(open_path_stage(folder)).scene
    assert int(again.visible.sum()) == seen["left"]


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


@pytest.mark.slow
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
