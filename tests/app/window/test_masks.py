"""From photos without masks to a found and selected object, by mouse and keys."""

from pathlib import Path

import pytest

from gaga_studio.features.find.search import SearchState
from tests.app.folders import write_scene
from tests.app.window.driver import KEY, Driver, drive

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
    document = d.session.document
    assert document is not None
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
