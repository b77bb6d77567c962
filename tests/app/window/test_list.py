"""The object list in the window: words as names, the folded background, partial selections."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaga_core.arrays import UInt8Array
from gaga_core.scene import edits
from gaga_core.scene.objects import group_indices
from gaga_studio.features import objects, selection
from gaga_studio.features.find.search import SearchState
from gaga_studio.session.settings import load_settings
from tests.app.folders import write_scene
from tests.app.window.driver import Driver, drive

pytestmark = pytest.mark.window


def test_the_list_can_be_read(display: str, grouped_scene: Path, tmp_path: Path) -> None:
    folder = tmp_path / "table"
    shutil.copytree(grouped_scene, folder)

    def walk(d: Driver) -> None:
        session, document = d.session, d.session.need()
        d.until(
            lambda: document.feature(SearchState).described is not None, "objects are described"
        )
        d.settle()
        _words_stay(d)
        _background_folds(d)

        row = "Objects/**/object 2/##row"
        some = group_indices(document.scene, 2)
        d.on_main(lambda: document.select(some[: len(some) // 3]))
        d.settle()
        assert session.selected_groups() == (2,)
        partial = _pixels(d, row, tmp_path)
        d.on_main(lambda: document.select(some))
        d.settle()
        whole = _pixels(d, row, tmp_path)
        d.on_main(lambda: document.select(some[:0]))
        d.settle()
        none = _pixels(d, row, tmp_path)
        blue = [float(np.median(shown[..., 2])) for shown in (none, partial, whole)]
        assert blue[0] < blue[1] < blue[2]  # half-lit

    drive(walk, path=folder, size=(1280, 720))


def test_the_row_of_what_is_selected_is_seen_whole(display: str, tmp_path: Path) -> None:
    """At the end of a list of which few rows fit, too."""
    n = 24

    def walk(d: Driver) -> None:
        document = d.session.need()
        every = np.arange(len(document.scene))
        d.on_main(
            lambda: document.do(
                edits.set_labels(document.scene, every, (every % n + 1).astype(np.int32), "x")
            )
        )
        d.settle()
        for group in (n - 1, 2, n // 2):
            d.on_main(lambda group=group: selection.select_groups(d.session, (group,)))  # type: ignore[misc]
            d.frames(4)
            info = d.engine.item_info(f"//Objects/**/object {group}/##row")
            row, seen = info.rect_full, info.rect_clipped
            assert row.max.y - row.min.y == seen.max.y - seen.min.y > 10, group

    write_scene(tmp_path / "balls", masks=False)
    drive(walk, path=tmp_path / "balls", size=(800, 500))


def _pixels(d: Driver, ref: str, folder: Path) -> UInt8Array:
    """What the window shows of an item."""
    d.move_to(4, 4)
    d.capture(folder / "window.png")
    rect = d.engine.item_info(f"//{ref}").rect_full
    left, top, right, bottom = (round(x) for x in (*rect.min, *rect.max))
    with Image.open(folder / "window.png") as image:
        return np.asarray(image.convert("RGB"))[top:bottom, left:right]


def _words_stay(d: Driver) -> None:
    session, document = d.session, d.session.need()
    before = dict(document.scene.described)
    assert set(before) == {int(g) for g in session.objects().ids if g > 0}
    assert not any(name.startswith("group") for name in session.objects().names[1:])
    found = document.feature(SearchState).described
    assert d.on_main(lambda: objects.rename(session, 3, "lamp"))
    d.until(lambda: document.name_of(3) == "lamp", "the name is shown")
    d.on_main(lambda: selection.select_groups(session, (4,)))
    assert d.on_main(lambda: objects.delete(session))
    d.until(
        lambda: document.feature(SearchState).described is not found, "objects are described again"
    )
    after = document.scene.described
    assert {g: after[g] for g in after} == {g: before[g] for g in before if g not in (3, 4)}


def _background_folds(d: Driver) -> None:
    document = d.session.need()
    found = document.feature(SearchState).described
    assert found is not None
    behind = found.description.background
    assert behind
    row = f"Objects/**/object {min(behind)}/##row"
    assert not d.exists(row)
    d.click("Objects/**/##background")
    d.frames()
    assert d.exists(row)
    assert not load_settings()[0].folds_background
    d.click("Objects/**/##background")
    d.frames()
    assert not d.exists(row)
