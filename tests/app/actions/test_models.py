"""Models in the window without a window: terms first, then the download, then masks."""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from gaga_core.models.catalogue import known_model
from gaga_studio import commands
from gaga_studio.actions import live_objects, models
from gaga_studio.session.requests import Request
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
def shop(new_session: Callable[[], Session], hub: Hub) -> Session:
    """A session whose mirror is the hub."""
    session = new_session()
    session.change_settings(replace(session.settings, hub_mirror=hub.url))
    return session


def is_here(session: Session) -> bool:
    entry = session.models.entry(TINY.name)
    return entry is not None and entry.path is not None


def test_terms_come_first_and_consent_downloads(shop: Session, hub: Hub) -> None:
    models.refresh(shop)
    assert not is_here(shop)
    models.ask(shop, TINY)
    assert shop.jobs.wait()
    listing = shop.models.offered
    assert listing is not None
    assert (listing.size, listing.licence_name) == (200_022, "Apache-2.0")
    assert hub.downloads() == []
    models.decline(shop)
    models.accept(shop)
    assert shop.jobs.running is None, "nothing is offered any more"
    models.ask(shop, TINY)
    assert shop.jobs.wait()
    models.accept(shop)
    assert shop.jobs.wait()
    assert is_here(shop)
    models.ask_remove(shop, TINY)
    assert is_here(shop), "asked, not answered"
    models.remove_asked(shop)
    assert not is_here(shop)


def test_a_cancelled_download_is_told_as_partial(shop: Session, hub: Hub) -> None:
    hub.pause_s = 0.02
    models.ask(shop, TINY)
    assert shop.jobs.wait()
    models.accept(shop)
    while shop.jobs.running is not None and shop.jobs.running.fraction < 0.3:
        shop.jobs.poll()
    shop.jobs.cancel()
    assert shop.jobs.wait()
    entry = shop.models.entry(TINY.name)
    assert entry is not None
    assert entry.path is None
    assert entry.partial_bytes > 50_000


def test_offline_and_trouble_are_notices(shop: Session, hub: Hub) -> None:
    hub.status = 503
    models.ask(shop, TINY)
    assert shop.jobs.wait()
    assert shop.models.offered is None
    assert "answered 503" in shop.notices[-1].text
    hub.requests.clear()
    shop.change_settings(replace(shop.settings, works_offline=True))
    assert "offline" in models.why_not(shop)
    models.ask(shop, TINY)
    assert shop.jobs.wait()
    assert "offline" in shop.notices[-1].text
    assert hub.requests == []


def test_the_offer_names_size_and_time_and_asks_before(
    shop: Session, hub: Hub, scene_folder: Path
) -> None:
    shutil.rmtree(scene_folder / "masks")
    shop.open(scene_folder)
    assert shop.jobs.wait()
    title = commands.command("object.masks_model").title_now(shop)
    assert title.startswith("Make masks with SAM 2.1 Hiera tiny, 156 MB, about ")
    assert commands.run("object.masks_model", shop)
    assert shop.take_request() is Request.MODELS
    assert shop.jobs.wait()
    assert shop.models.offered is not None
    assert hub.downloads() == []
    models.accept(shop)
    while not is_here(shop):
        shop.jobs.poll()
    running = shop.jobs.running
    assert running is not None
    assert running.title == live_objects.TITLE, "that is what it was wanted for"
    shop.jobs.cancel()
    assert shop.jobs.wait()
    assert "MB" not in commands.command("object.masks_model").title_now(shop)
