"""From photos without masks to a found and selected object, by mouse and keys."""

import os
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from imgui_bundle import imgui
from PIL import Image

from gaga_core import kernels as kernels_of_numba
from gaga_core.arrays import FloatArray
from gaga_core.io.cameras.transforms_json import write_transforms_json
from gaga_core.pipeline import compile_kernels
from gaga_core.pipeline.place import WORKSPACE
from gaga_core.pipeline.reconstruct import BACKGROUND, CHECKPOINT, STEPS
from gaga_core.pipeline.settings import GroupSettings, IdentitySettings
from gaga_core.progress import Progress, Stage
from gaga_core.segmentation.models.catalogue import known_model
from gaga_core.training.checkpoint import splats_of
from gaga_studio.features import reconstruction
from gaga_studio.features.commands import command
from gaga_studio.features.find.association import FindState
from gaga_studio.features.find.click_object import ClickState
from gaga_studio.features.find.masks import ModelsState
from gaga_studio.features.find.search import SearchState
from gaga_studio.features.reconstruction import TITLE, ReconstructionPlan, found_text
from gaga_studio.session.jobs import Job
from gaga_studio.session.rates import KnownRates
from gaga_studio.session.settings import Settings
from gaga_studio.session.view import Mode
from gaga_studio.ui.chrome import status
from tests.app.folders import write_scene
from tests.app.window.driver import KEY, Driver, drive
from tests.color_oracle import ColorOracle
from tests.core.placing.photo_scenes import write_photos
from tests.core.segmentation.models.hub_server import Hub, fresh_models, serve
from tests.scenes import objects_scene

pytestmark = pytest.mark.window


def test_from_photos_to_regions_objects_and_a_found_one(display: str, tmp_path: Path) -> None:
    folder = tmp_path / "balls"
    write_scene(folder, masks=False)

    def test(d: Driver) -> None:
        _try_one(d)
        assert not (folder / "masks").exists()
        d.click("**/###Make masks")
        d.settle()
        assert d.session.provider == "regions"
        d.click("**/###Find objects")
        d.settle()
        _find_green(d)

    drive(test, path=folder)


def _try_one(d: Driver) -> None:
    """The dialog, one photo to look at before all."""
    d.menu("Find/###Make masks…")
    dialog = d.studio.ui.scene.masks
    d.click("**/###Try on one photo")
    d.until(lambda: dialog.preview is not None, "one photo is done")
    assert dialog.preview is not None
    assert dialog.preview.n_masks > 4
    d.keys(KEY.escape)


def _find_green(d: Driver) -> None:
    """Ctrl+F, a color, the arrow, Enter, Shift+Enter, Escape."""
    document = d.session.need()
    search = document.feature(SearchState)
    d.keys(KEY.mod_ctrl, KEY.f)
    d.engine.key_chars("green")
    d.until(lambda: len(search.meant) >= 2, "the green balls are found")
    d.keys(KEY.down_arrow)
    assert search.at == 1
    d.keys(KEY.enter)
    assert d.session.selected_groups() == (search.hits[1].group,)
    d.keys(KEY.mod_ctrl, KEY.f)
    d.keys(KEY.mod_shift, KEY.enter)
    assert set(d.session.selected_groups()) == set(search.meant)
    d.keys(KEY.mod_ctrl, KEY.f)
    d.keys(KEY.escape)
    assert search.text == ""
    assert len(search.hits) == 0, "the list is back"


# --- The sheet of models, by mouse: terms, consent, progress, here, removed.

TINY = known_model("sam2.1-tiny")


def test_get_asks_downloads_and_remove_asks(
    display: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = fresh_models(tmp_path, monkeypatch)
    repository = tmp_path / "repository"
    repository.mkdir()
    (repository / "config.json").write_text('{"model_type": "sam2"}')
    (repository / "model.safetensors").write_bytes(bytes(100_000))

    def walk(d: Driver) -> None:
        d.session.change_settings(replace(d.session.settings, hub_mirror=hub.url))
        d.menu("Find/###Models…")
        d.click(f"**/{TINY.name}/###Get")
        d.until(lambda: d.session.feature(ModelsState).offered is not None, "the terms are there")
        d.frames(3)
        assert hub.downloads() == []
        d.click("**/###Accept")
        d.until((folder / TINY.name / "model.lock.json").is_file, "it is here")
        d.settle()
        d.click(f"**/{TINY.name}/###Remove")
        assert (folder / TINY.name).is_dir()
        d.click("**/###Delete")
        d.until(lambda: not (folder / TINY.name).exists(), "it is gone")
        d.click("Models/###Close")

    with serve(Hub({TINY.hub: repository})) as hub:
        drive(walk)


# --- The tool Object with a model, by mouse: chosen in the tool's row, asked at a click.

_TINY = "sam2.1-tiny"


def test_a_click_asks_the_model_that_is_chosen(
    display: str, scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = fresh_models(tmp_path, monkeypatch) / _TINY
    folder.mkdir(parents=True)
    (folder / "config.json").write_text('{"model_type": "sam2"}')
    (folder / "model.safetensors").write_bytes(bytes(8))
    angle = 2 * np.pi / 5
    ball = 0.9 * np.array([np.cos(angle), np.sin(angle), 0.0])

    def walk(d: Driver) -> None:
        d.session.feature(ModelsState).prompters[_TINY] = ColorOracle(
            objects_scene(5, 220, n_cameras=8)
        )
        d.click("**/###Select an object by clicks")
        d.settle()
        scene = d.scene
        d.click_picture(*d.project(ball))
        assert not d.session.need().feature(ClickState).is_asking  # as the settings say
        d.click("**/###Model of the clicks")
        d.click("**/###SAM 2.1 Hiera tiny")
        d.settle()
        entries = [entry.title for entry in d.history.entries()]
        assert entries == ["Click an object", "Ask SAM 2.1 Hiera tiny"]
        assert d.session.settings.click_model == _TINY
        away = scene.gaussians.means[d.session.selected_indices()] - ball
        assert (np.linalg.norm(away, axis=1) < 0.4).mean() > 0.9

    settings = Settings(first_steps_done=True, click_model="none")
    drive(walk, path=scene_folder, size=(1100, 600), settings=settings)


# --- The sheet Find objects with its folded switches, the lift, and the identity view.


@pytest.mark.parametrize("preset", ["Paper", "Released"])
def test_objects_are_found_as_published(
    display: str, scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, preset: str
) -> None:
    monkeypatch.setenv("GAGA_HOME", str(tmp_path / "home"))

    def walk(d: Driver) -> None:
        session = d.session
        state = session.feature(FindState)
        state.groups, state.identities = GroupSettings(threshold=0.2), IdentitySettings(12)
        few = replace(state)
        d.menu("Find/###Find objects with settings…")
        d.click(f"Find objects/Preset/###{preset}")
        assert session.settings.preset == preset.lower()
        d.click("Find objects/**/Memory bank (section 3.2)")
        d.click("Find objects/**/Identity encodings (section 3.3)")
        assert state == few  # what is shown is not changed
        _capture(d, f"find-{preset.lower()}")
        d.click("Find objects/###Find")
        d.settle()
        assert command("object.labels_identities").is_on(session)  # type: ignore[misc]
        assert session.need().history.undo_title == "Lift groups to identities"
        bank = d.scene.bank
        assert bank is not None
        assert bank.preset == preset.lower()
        _capture(d, f"found-{preset.lower()}")
        plain = d.pixels().astype(int)
        d.command("Identity encodings")
        assert session.view.mode is Mode.IDENTITY
        assert np.abs(d.pixels().astype(int) - plain).mean() > 5
        d.menu("Find/###Labels by votes")
        assert command("object.labels_votes").is_on(session)  # type: ignore[misc]

    drive(walk, path=scene_folder, settings=Settings(first_steps_done=True))


# --- A person opens photos, makes splats of them and sees them grow; then stops and goes on.


def _capture(d: Driver, name: str) -> None:
    """Keep a picture of the window where somebody wants to look at it."""
    folder = os.environ.get("GAGA_CAPTURES")
    if folder:
        d.capture_now(Path(folder) / f"{name}.png")


def test_poses_next_to_photos_are_named_and_their_use_is_chosen(
    display: str, tmp_path: Path
) -> None:
    images = tmp_path / "shots" / "images"
    cameras = write_photos(images, 4)
    paths = {camera.name: images / camera.name for camera in cameras}
    write_transforms_json(tmp_path / "shots" / "transforms.json", cameras, paths)

    def walk(d: Driver) -> None:
        found = d.session.photos
        assert found is not None
        assert "transforms.json: poses of 4 photos" in found_text(found)
        d.click("**/###Settings…")
        d.click("**/More")

        def chosen() -> str:
            plan = d.studio.ui.plan.plan
            return "" if plan is None else plan.config.poses

        assert chosen() == "refine"
        d.click("**/###Use as they are")
        assert chosen() == "keep"
        _capture(d, "poses")
        d.click("**/###Choose masks")
        d.answer_path(tmp_path)
        d.frames(4)
        assert d.studio.ui.plan.plan is not None
        assert d.studio.ui.plan.plan.config.foreground == str(tmp_path), "back in the sheet"
        d.click("Make splats/**/###Choose masks")
        assert d.studio.ui.files.dialog is not None
        d.keys(KEY.escape)
        assert d.exists("**/###Use as they are"), "also where no folder was chosen"

    drive(walk, path=tmp_path / "shots", settings=Settings(first_steps_done=True))


def test_photos_become_splats_before_the_eyes(
    display: str, tmp_path: Path, placed_photos: Path
) -> None:
    scene = tmp_path / "room"
    shutil.copytree(placed_photos, scene)
    (scene / "foreground").mkdir()
    for photo in (scene / "images").iterdir():  # the upper edge is background
        mask = Image.new("L", (320, 240), 255)
        mask.paste(0, (0, 0, 320, 60))
        mask.save(scene / "foreground" / f"{photo.stem}.png")

    def walk(d: Driver) -> None:
        session = d.session
        assert session.photos is not None
        assert d.exists("**/###Make splats")
        _capture(d, "photos")
        images = d.studio.images
        assert images is not None
        d.focus("Views")
        d.until(lambda: len(images._textures) > 1, "the photos are there as pictures")
        d.click("**/###Settings…")
        _capture(d, "simple sheet")
        assert not d.exists("**/##Iterations"), "the rest is under More"
        d.click("**/###Good")
        assert d.studio.ui.plan.plan is not None
        assert d.studio.ui.plan.plan.config.quality == "standard"
        d.click("**/###Quick look")
        d.click("**/More")
        d.type_into("**/##Iterations", "20000")
        d.type_into("**/##Longest side, pixels", "160")
        _capture(d, "sheet")
        assert isinstance(d.studio.ui.plan.plan, ReconstructionPlan)
        assert d.studio.ui.plan.plan.config.iterations == 20_000
        d.click("**/###Start")
        d.until(lambda: session.shown is not None, "splats are shown")
        training = session.training
        assert training is not None
        first = training.scene
        d.until(lambda: training.update is not None and training.update.iteration > 40, "steps")
        viewport = d.studio.viewport
        assert viewport is not None
        d.until(lambda: d.on_main(viewport.read_pixels).std() > 5, "the picture shows them")
        assert viewport.buffers.scene is first
        eye = session.rig.eye
        d.drag_picture((300, 250), (60, 10))
        assert (session.rig.eye != eye).any(), "the camera moves while they train"
        d.until(
            lambda: any("cut out" in key and t for key, t in images._textures.items()),
            "what is left out is seen",
        )
        _capture(d, "training")
        d.focus("Views")
        d.click("**/View 001.jpg")  # as photos of a scene
        place = next(c.position for c in training.cameras if c.name == "001.jpg")
        d.until(lambda: np.allclose(session.rig.eye, place, atol=1e-4), "the photo's camera")
        d.keys(KEY.mod_ctrl, KEY.s)  # there is nothing to save yet, and that is said
        tool = d.studio.picture.controller.tool(session)
        assert status.status_text(session, tool) == session.jobs.why_busy
        for size, scale in (((800, 500), 2.0), ((1000, 640), 1.0)):
            large = replace(session.settings, ui_scale=scale)
            d.on_main(partial(session.change_settings, large))
            d.resize(*size)
            d.frames(10)
            area = d.studio.ui.area
            assert 0 < area.live_bottom - area.top <= area.height / 2 or scale == 1
            assert d.exists("**/###Stop here")
        d.click("**/###Cancel")
        d.until(lambda: session.jobs.running is None, "the training stops")
        d.frames(4)
        assert session.photos is not None
        assert session.photos.iteration > 0
        _capture(d, "stopped")
        assert session.shown is not None, "they can still be looked at"
        d.click("**/###Continue")
        goes_on(d, session.photos.iteration, session.shown.gaussians.means)
        d.click("**/###Back to the photos")
        assert session.shown is None
        stopped = splats_of(scene / WORKSPACE / CHECKPOINT)
        assert stopped is not None
        d.click("**/###Make splats")  # goes on from the file
        goes_on(d, session.photos.iteration, stopped.means)
        n_shown = len(session.shown)
        d.click("**/###Keep these splats")
        d.settle()
        assert session.document is not None
        assert abs(len(d.scene) - n_shown) <= 1
        assert len(session.cameras) == 6
        eye, going_on = session.rig.eye, reconstruction.stopped_training_of(session)
        assert going_on is not None
        kept = d.scene.gaussians.means
        d.menu("File/###Go on training")
        np.testing.assert_array_equal(session.rig.eye, eye)
        goes_on(d, going_on.iteration, kept)

    def goes_on(d: Driver, done: int, kept: FloatArray) -> None:
        """Its splats stay in the picture until there are newer ones; then it is cancelled."""

        def has_newer() -> bool:
            training, shown = d.session.training, d.session.shown
            update = None if training is None else training.update
            is_newer = update is not None and update.iteration > done
            if shown is not None:
                assert is_newer or np.array_equal(shown.gaussians.means, kept)
                assert np.ptp(shown.gaussians.logit_opacities) > 0, "as of points"
                were_shown.append(not is_newer)
            return is_newer

        were_shown: list[bool] = []
        d.until(has_newer, "it goes on")
        assert any(were_shown)
        d.click("**/###Cancel")
        d.until(lambda: d.session.jobs.running is None, "the training stops")
        d.frames(4)

    drive(walk, path=scene, size=(1000, 640))


def test_one_bar_for_all_steps_from_the_kernels_on(
    display: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the rows of the window. Kernels are prepared until both jobs that do so have shown it."""
    rows: list[tuple[Job, str]] = []
    is_seen, text_of = Event(), status.job_text

    def kernels(*_parts: str) -> Stage[None]:
        while not is_seen.wait(0.01):
            yield Progress("Prepare kernels", 79, 100, "of pictures")

    def seen(job: Job) -> str:
        rows.append((job, text_of(job)))
        if job.stage == TITLE and "Prepare kernels" in job.message:
            is_seen.set()
        return rows[-1][1]

    monkeypatch.setattr(kernels_of_numba, "is_compiled", lambda *_: False)
    monkeypatch.setattr(compile_kernels, "is_compiled", lambda *_: False)
    monkeypatch.setattr(compile_kernels, "warm_up_stage", kernels)
    monkeypatch.setattr(status, "job_text", seen)
    write_photos(tmp_path / "shots", 6)

    def walk(d: Driver) -> None:
        before = d.session.rates.rates
        d.click("**/###Settings…")
        d.click("**/More")
        d.type_into("**/##Iterations", "30")
        d.type_into("**/##Longest side, pixels", "96")
        assert rows[-1][1] == "Prepare kernels  79 %", "nothing else runs yet"
        d.click("**/###Start")
        d.until(lambda: d.session.document is not None, "the splats are open")
        own = [(job, text) for job, text in rows if job.stage == TITLE]
        prepared = [one for one in own if "Prepare kernels" in one[0].message]
        assert prepared
        assert all("%" in text for _, text in prepared), "they are a part of it"
        shares = [job.fraction for job, _ in own if job.fraction >= 0]
        assert shares == sorted(shares)
        assert shares[0] < 0.2
        assert shares[-1] > 0.7
        assert all("%" in text and text.endswith("left") for job, text in own if job.fraction >= 0)
        # These photos have no background to look for.
        rates = d.session.rates.rates
        assert rates != before
        assert KnownRates().rates == rates, "they are kept"
        assert set(rates) | {BACKGROUND} >= set(STEPS)

    settings = Settings(first_steps_done=True)
    drive(walk, path=tmp_path / "shots", settings=settings, size=(1000, 640), patience_s=300)


def test_why_a_model_is_not_got_is_said_in_the_sheet(
    display: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The notice stood behind it; in a low window names of models were cut to nothing."""
    fresh_models(tmp_path, monkeypatch)
    shown, draw = list[str](), imgui.text_unformatted

    def noted(text: str) -> None:
        shown.append(text.replace("\n", " "))
        draw(text)

    monkeypatch.setattr(imgui, "text_unformatted", noted)

    def walk(d: Driver) -> None:
        d.session.change_settings(replace(d.session.settings, hub_mirror="http://127.0.0.1:9"))
        d.menu("Find/###Models…")
        d.frames(3)
        assert any(TINY.title in text for text in shown)
        d.click(f"**/{TINY.name}/###Get")
        d.until(lambda: bool(d.session.feature(ModelsState).problem), "it is told")
        shown.clear()
        d.frames(3)
        assert any("cannot be reached" in text for text in shown)
        assert not d.session.notices
        d.click("**/###All models")
        d.frames(3)
        assert d.exists(f"**/{TINY.name}/###Get")
        d.click("Models/###Close")

    drive(walk, size=(800, 500), settings=Settings(first_steps_done=True, ui_scale=2.0))
