"""Objects that appear while masks are made, and what is used when the user stops."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from gaga_core.scene.scene import Scene
from gaga_studio.features.find import masks
from gaga_studio.features.find.masks import MaskRequest
from gaga_studio.session.session import Session

REQUEST = MaskRequest(use_depth=False)


@pytest.fixture
def bare(new_session: Callable[[], Session], scene_folder: Path) -> Session:
    """A session with a scene that has photos and no masks."""
    shutil.rmtree(scene_folder / "masks")
    session = new_session()
    session.open(scene_folder)
    assert session.jobs.wait()
    return session


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
    assert any(f"objects in {n} photos" in notice.text for notice in bare.notices)
    assert n_objects(bare.scene) > 1
    masks.make_live(bare, REQUEST)
    assert bare.jobs.running is not None
    assert bare.jobs.running.title == "Make masks", "objects that are there are not replaced"
    assert bare.jobs.wait()
