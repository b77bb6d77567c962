"""Models in the window without a window: terms first, then the download, then masks."""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from gaga_core.segmentation.models.catalogue import known_model
from gaga_studio.features import commands
from gaga_studio.features.find import masks
from gaga_studio.features.find.masks import ModelsState
from gaga_studio.session.notices import Request
from gaga_studio.session.session import Session
from tests.core.models.hub_server import Hub, fresh_models, serve

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
