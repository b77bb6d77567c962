"""Masks from the window: made, tried, resumed, imported, chosen, exported; what is said of them."""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.io.masks.label_maps import RECORD, read_labels, write_labels
from gaga_core.pipeline.import_masks import import_masks
from gaga_core.progress import run_stage
from gaga_core.scene.scene import Scene
from gaga_core.segmentation.choose import ProviderEntry, ProviderSettings
from gaga_core.segmentation.models.catalogue import KNOWN, known_model
from gaga_core.segmentation.regions import RegionsConfig
from gaga_core.settings import setting_of
from gaga_studio.features import commands
from gaga_studio.features.find import association, masks
from gaga_studio.features.find.masks import MaskPreview, MaskRequest, ModelsState
from gaga_studio.session.notices import Request
from gaga_studio.session.session import Session
from tests.core.segmentation.models.hub_server import Hub, fresh_models, serve


@pytest.fixture
def bare(new_session: Callable[[], Session], scene_folder: Path) -> Session:
    """The small scene without any masks."""
    shutil.rmtree(scene_folder / "masks")
    return _opened(new_session, scene_folder)


def _opened(new_session: Callable[[], Session], folder: Path) -> Session:
    session = new_session()
    session.open(folder)
    assert session.jobs.wait()
    assert session.document is not None, session.notices
    return session


def _root(session: Session) -> Path:
    assert session.project is not None
    assert session.project.folder is not None
    return session.project.folder.root


def test_without_masks_the_offer_makes_regions_and_then_finds_objects(bare: Session) -> None:
    offer = association.stage_offer(bare)
    assert offer is not None
    assert offer.command == "object.masks_quick"
    assert offer.label.startswith("Make masks (now, without a model, about ")
    assert [command for _, command in offer.more] == ["object.masks_model", "object.masks"]
    masks.make(bare)
    assert bare.jobs.wait()
    assert bare.provider == "regions"
    n = len(masks.photos_of(bare, "train"))
    assert len(bare.masks) == n > 0
    n_tests = len(masks.photos_of(bare, "all")) - n
    assert n_tests > 0, "photos are held out"
    told = f" masks in {n} photos; {n_tests} more "
    (said,) = [notice.text for notice in bare.notices if told in notice.text]
    assert "for testing" in said
    offer = association.stage_offer(bare)
    assert offer is not None
    assert offer.command == "object.associate"
    association.associate(bare)
    assert bare.jobs.wait()
    assert bare.document is not None
    assert bare.document.read.has_groups()


def test_a_cancelled_run_keeps_what_is_done_and_goes_on_from_there(bare: Session) -> None:
    masks.make(bare, MaskRequest(use_depth=False))
    while bare.jobs.running is not None and bare.jobs.running.fraction < 0.3:
        bare.jobs.poll()
    bare.jobs.cancel()
    assert bare.jobs.wait()
    n = len(bare.masks)
    assert 0 < n < len(masks.photos_of(bare, "train"))
    assert bare.provider == "regions"
    assert any("continues there" in notice.text for notice in bare.notices)
    kept = {p.name: p.stat().st_mtime_ns for p in (_root(bare) / "masks/regions").glob("*.png")}
    masks.make(bare, MaskRequest(use_depth=False))
    assert bare.jobs.wait()
    assert len(bare.masks) == len(masks.photos_of(bare, "train"))
    after = {p.name: p.stat().st_mtime_ns for p in (_root(bare) / "masks/regions").glob("*.png")}
    assert {name: after[name] for name in kept} == kept


def test_the_other_photos_get_masks_as_those_that_are_there(bare: Session) -> None:
    """A cancelled run, whose settings were gone with the next start of the program."""
    settings = ProviderSettings(regions=RegionsConfig(detail=2.0))
    masks.make(bare, MaskRequest(settings=settings, use_depth=False))
    assert bare.jobs.wait()
    assert commands.command("object.masks_rest").enabled(bare) == "All training photos have masks."
    made = _root(bare) / "masks/regions"
    names = masks.photos_of(bare, "train")
    files = {name: made / f"{Path(name).stem}.png" for name in names}
    before = {name: path.read_bytes() for name, path in files.items()}
    record = (made / RECORD).read_bytes()
    for name in names[1:]:
        files[name].unlink()
    shutil.rmtree(_root(bare) / "gaga/cache")
    assert masks.choose(bare, "regions")
    offer = association.stage_offer(bare)
    assert offer is not None
    assert offer.more == (("", "object.masks_rest"),)
    n = len(names) - 1
    title = commands.command("object.masks_rest").title_now(bare)
    assert title == f"Make masks for the other {n} photos"
    assert commands.run("object.masks_rest", bare)
    assert bare.jobs.wait()
    assert {name: path.read_bytes() for name, path in files.items()} == before
    assert (made / RECORD).read_bytes() == record
    assert association.bare_photos(bare) == ()


def test_masks_that_a_person_added_are_not_mixed_with_regions(bare: Session) -> None:
    """Regions next to masks of whole objects would count as such."""
    own = _root(bare) / "masks/mine" / f"{Path(masks.photos_of(bare, 'train')[0]).stem}.png"
    write_labels(own, np.full((8, 8), 3, np.int32))
    bare.open(_root(bare))
    assert bare.jobs.wait()
    assert bare.provider == "mine"
    assert "no model is here" in commands.command("object.masks_rest").enabled(bare)
    masks.make_rest(bare)
    assert "no model is here" in bare.notices[-1].text
    assert bare.jobs.running is None
    assert [path.name for path in own.parent.iterdir()] == [own.name]


def test_a_preview_leaves_no_masks_and_is_what_the_run_gives(bare: Session) -> None:
    request = MaskRequest(settings=ProviderSettings(regions=RegionsConfig(detail=2.0)))
    view = masks.photos_of(bare, "train")[1]
    found: list[MaskPreview] = []
    masks.try_one(bare, request, view, found.append)
    assert bare.jobs.wait()
    (preview,) = found
    assert preview.seconds > 0
    assert preview.n_masks == len(np.unique(preview.labels[preview.labels > 0]))
    assert not (_root(bare) / "masks").exists()
    assert bare.provider == ""
    masks.make(bare, request)
    assert bare.jobs.wait()
    path = _root(bare) / "masks/regions" / f"{Path(view).stem}.png"
    np.testing.assert_array_equal(read_labels(path), preview.labels)


def test_where_masks_cannot_be_made_it_says_why(
    new_session: Callable[[], Session], scene_folder: Path, tmp_path: Path
) -> None:
    session = new_session()
    assert masks.no_photos(session) == "No scene is open."
    lone = tmp_path / "lone.ply"
    shutil.copyfile(scene_folder / "point_cloud.ply", lone)
    assert "no" in masks.no_photos(_opened(new_session, lone))
    shutil.rmtree(scene_folder / "images")
    shutil.rmtree(scene_folder / "masks")
    session = _opened(new_session, scene_folder)
    assert "Put them back" in masks.no_photos(session)
    offer = association.stage_offer(session)
    assert offer is not None
    assert not offer.command
    masks.make(session)
    assert session.jobs.running is None
    assert "Put them back" in session.notices[-1].text


# --- who can make them


def test_models_that_are_not_here_say_what_to_put_where(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("GAGA_MODELS", str(tmp_path / "models"))
    monkeypatch.setenv("HF_HOME", str(tmp_path / "hub"))
    entries = masks.providers()
    assert entries[0].name == "regions"
    assert {entry.name for entry in entries} >= {model.name for model in KNOWN}
    missing = [entry for entry in entries if not entry.is_available]
    assert len(missing) == len(KNOWN)
    assert not masks.has_model(entries)
    for entry in missing:
        assert str(tmp_path / "models") in entry.reason
        assert str(entry.megabytes) in entry.reason
        assert entry.licence in entry.reason
    assert str(tmp_path / "models") in masks.first_steps()


def test_every_slider_is_a_setting_that_takes_all_of_its_range(tmp_path: Path) -> None:
    for family, sliders in masks.SLIDERS.items():
        entry = _entry(tmp_path, family)
        assert masks.settings_family(entry) == family
        settings = ProviderSettings()
        for slider in sliders:
            part = masks.part_of(settings, slider, entry)
            low, high = setting_of(part, slider.field).range
            assert low <= getattr(part, slider.field) <= high
            for value in (low, high):
                settings = masks.with_value(settings, slider, entry, value)
                moved = getattr(masks.part_of(settings, slider, entry), slider.field)
                assert moved == pytest.approx(value)
            outside = masks.with_value(settings, slider, entry, high * 2 + 1)
            assert getattr(masks.part_of(outside, slider, entry), slider.field) == high


def _entry(folder: Path, family: str) -> ProviderEntry:
    if family == "regions":
        return ProviderEntry("regions", "", True, "", "regions")
    if not family:
        return ProviderEntry("sam-base", "", False, "gone", "known")
    place = folder / family
    place.mkdir()
    kind = "sam2" if family == "sam" else "mask2former"
    (place / "config.json").write_text(f'{{"model_type": "{kind}"}}', encoding="utf-8")
    (place / "model.safetensors").write_bytes(b"")
    return masks.entry_of(place)


# --- masks of other programs, several folders


def test_an_import_says_what_it_saw_and_asks_before(bare: Session, tmp_path: Path) -> None:
    source = tmp_path / "theirs"
    source.mkdir()
    for camera in bare.cameras:
        labels = np.zeros((camera.height, camera.width), np.int32)
        labels[: camera.height // 2] = 7
        write_labels(source / f"{Path(camera.name).stem}.png", labels)
    masks.import_from(bare, source)
    assert bare.jobs.wait()
    question = bare.pending_question
    assert question is not None
    assert question.choices == ("Import", "Cancel")
    bare.answer("Cancel")
    assert masks.mask_folders(bare) == ()
    for answer, provider in (("Import", "theirs"), ("Import as theirs 2", "theirs 2")):
        masks.import_from(bare, source)
        assert bare.jobs.wait()
        assert bare.pending_question is not None
        assert answer in bare.pending_question.choices
        bare.answer(answer)
        assert bare.jobs.wait()
        assert bare.provider == provider
        assert len(bare.masks) == len(bare.cameras)
    assert masks.mask_folders(bare) == ("theirs", "theirs 2")
    assert masks.choose(bare, "theirs")
    assert bare.provider == "theirs"


def test_an_import_counts_photos_without_masks_as_the_card_does(
    bare: Session, tmp_path: Path
) -> None:
    """It counted those for tests as well, and called them views."""
    assert bare.project is not None
    assert bare.project.folder is not None
    folder, source = bare.project.folder, tmp_path / "theirs"
    assert folder.test
    source.mkdir()
    name = f"{Path(folder.train[0]).stem}.png"
    write_labels(
        source / name, np.ones((folder.cameras[0].height, folder.cameras[0].width), np.int32)
    )
    report = run_stage(import_masks(folder, source))
    assert masks.choose(bare, report.name)
    assert report.without == association.bare_photos(bare)
    offer = association.stage_offer(bare)
    assert offer is not None
    n = len(report.without)
    assert f" {n} photos have no masks yet." in offer.reason
    assert report.notes()[-1].startswith(f"{n} photos for training got no masks (")


def test_what_is_no_mask_is_said_and_nothing_is_asked(bare: Session, tmp_path: Path) -> None:
    (tmp_path / "notes").mkdir()
    masks.import_from(bare, tmp_path / "notes")
    assert bare.jobs.wait()
    assert bare.pending_question is None
    assert bare.notices[-1].level == "error"


def test_a_mask_folder_that_is_gone_is_no_choice(session: Session) -> None:
    shutil.rmtree(_root(session) / "masks" / "made")
    before = session.masks
    assert not masks.choose(session, "made")
    assert "no longer here" in session.notices[-1].text
    assert session.masks is before


@pytest.mark.parametrize("form", ["png", "dataset", "coco"])
def test_masks_are_exported_in_every_form(
    associated: Session, tmp_path: Path, form: masks.MaskForm
) -> None:
    out = tmp_path / "out"
    masks.export(associated, form, out)
    assert associated.jobs.wait()
    assert associated.notices[-1].level == "info", associated.notices
    n = len(associated.cameras)
    if form == "coco":
        assert (out / "instances.json").is_file()
    else:
        folder = out if form == "png" else out / "labels"
        assert len(list(folder.glob("*.png"))) == n


REQUEST = MaskRequest(use_depth=False)


def n_objects(scene: Scene | None) -> int:
    assert scene is not None
    return len(set(scene.labels.tolist()) - {0})


def test_stopping_keeps_the_objects_so_far_as_one_edit(bare: Session) -> None:
    masks.make_live(bare, REQUEST)
    while bare.live is None:
        assert bare.jobs.running is not None
        bare.jobs.poll()
    assert n_objects(bare.scene) == 0, "the scene is not touched before the end"
    bare.jobs.cancel()
    assert bare.jobs.wait()
    assert bare.live is None
    assert 0 < len(bare.masks) < len(masks.photos_of(bare, "train"))
    assert n_objects(bare.scene) > 1
    bare.undo()
    assert n_objects(bare.scene) == 0
    assert bare.history is not None
    assert not bare.history.can_undo


def test_a_whole_run_ends_with_the_objects_of_all_photos(bare: Session) -> None:
    masks.make_live(bare, REQUEST)
    assert bare.jobs.wait()
    n = len(masks.photos_of(bare, "train"))
    assert len(bare.masks) == n
    assert any(notice.text.startswith("Found ") for notice in bare.notices)
    assert n_objects(bare.scene) > 1
    masks.make_live(bare, REQUEST)
    assert bare.jobs.running is not None
    assert bare.jobs.running.title == "Make masks", "objects that are there are not replaced"
    assert bare.jobs.wait()


TINY = known_model("sam2.1-tiny")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder of models."""
    return fresh_models(tmp_path, monkeypatch)


@pytest.fixture
def hub(folder: Path, tmp_path: Path) -> Iterator[Hub]:
    """A hub that has SAM 2.1 tiny, as far as its files go."""
    repository = tmp_path / "repository"
    repository.mkdir()
    (repository / "config.json").write_text('{"model_type": "sam2"}')
    (repository / "model.safetensors").write_bytes(bytes(200_000))
    with serve(Hub({TINY.hub: repository})) as served:
        yield served


@pytest.fixture
def with_hub(new_session: Callable[[], Session], hub: Hub) -> Session:
    """A session whose mirror is the hub."""
    session = new_session()
    session.change_settings(replace(session.settings, hub_mirror=hub.url))
    return session


def is_here(session: Session) -> bool:
    entry = session.feature(ModelsState).entry(TINY.name)
    return entry is not None and entry.path is not None


def test_terms_come_first_and_consent_downloads(with_hub: Session, hub: Hub) -> None:
    masks.refresh_models(with_hub)
    assert not is_here(with_hub)
    masks.ask_model(with_hub, TINY)
    assert with_hub.jobs.wait()
    listing = with_hub.feature(ModelsState).offered
    assert listing is not None
    assert (listing.size, listing.licence_name) == (200_022, "Apache-2.0")
    assert hub.downloads() == []
    masks.decline_model(with_hub)
    masks.accept_model(with_hub)
    assert with_hub.jobs.running is None, "nothing is offered any more"
    masks.ask_model(with_hub, TINY)
    assert with_hub.jobs.wait()
    masks.accept_model(with_hub)
    assert with_hub.jobs.wait()
    assert is_here(with_hub)
    masks.ask_remove_model(with_hub, TINY)
    assert is_here(with_hub), "asked, not answered"
    masks.remove_asked_model(with_hub)
    assert not is_here(with_hub)


def test_a_cancelled_download_is_told_as_partial(with_hub: Session, hub: Hub) -> None:
    hub.pause_s = 0.02
    masks.ask_model(with_hub, TINY)
    assert with_hub.jobs.wait()
    masks.accept_model(with_hub)
    while with_hub.jobs.running is not None and with_hub.jobs.running.fraction < 0.3:
        with_hub.jobs.poll()
    with_hub.jobs.cancel()
    assert with_hub.jobs.wait()
    entry = with_hub.feature(ModelsState).entry(TINY.name)
    assert entry is not None
    assert entry.path is None
    assert entry.partial_bytes > 50_000


def test_offline_and_trouble_are_notices(with_hub: Session, hub: Hub) -> None:
    hub.status = 503
    masks.ask_model(with_hub, TINY)
    assert with_hub.jobs.wait()
    assert with_hub.feature(ModelsState).offered is None
    assert "answered 503" in with_hub.notices[-1].text
    hub.requests.clear()
    with_hub.change_settings(replace(with_hub.settings, works_offline=True))
    assert "offline" in masks.why_no_download(with_hub)
    masks.ask_model(with_hub, TINY)
    assert with_hub.jobs.wait()
    assert "offline" in with_hub.notices[-1].text
    assert hub.requests == []


def test_the_offer_names_size_and_time_and_asks_before(
    with_hub: Session, hub: Hub, scene_folder: Path
) -> None:
    shutil.rmtree(scene_folder / "masks")
    with_hub.open(scene_folder)
    assert with_hub.jobs.wait()
    title = commands.command("object.masks_model").title_now(with_hub)
    assert title.startswith("Make masks with SAM 2.1 Hiera tiny, 156 MB, about ")
    assert commands.run("object.masks_model", with_hub)
    assert with_hub.take_request() is Request.MODELS
    assert with_hub.jobs.wait()
    assert with_hub.feature(ModelsState).offered is not None
    assert hub.downloads() == []
    masks.accept_model(with_hub)
    while not is_here(with_hub):
        with_hub.jobs.poll()
    running = with_hub.jobs.running
    assert running is not None
    assert running.title == masks.LIVE_TITLE, "that is what it was wanted for"
    with_hub.jobs.cancel()
    assert with_hub.jobs.wait()
    assert "MB" not in commands.command("object.masks_model").title_now(with_hub)
