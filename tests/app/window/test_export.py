"""Export objects in the window: the form is chosen, what it loses is said, then files appear."""

import json
from pathlib import Path

import pytest

from gaga_core.io.splat_files import SplatFormat, read_splats
from gaga_studio.actions import selection
from tests.app.folders import write_scene
from tests.app.window.driver import KEY, Driver, drive

pytestmark = pytest.mark.window


@pytest.mark.parametrize("size", [(800, 500), (1280, 800)], ids=str)
def test_objects_go_into_files_of_the_form_that_was_chosen(
    display: str, tmp_path: Path, size: tuple[int, int]
) -> None:
    write_scene(tmp_path / "balls")

    def to_sheet(d: Driver) -> None:
        d.menu("File/###Export objects…")
        d.frames(3)

    def to_folder(d: Driver, form: str, folder: Path) -> None:
        d.click(f"Export objects/###{form}")
        d.click("Export objects/###Export objects…")
        d.frames(3)
        dialog = d.studio.ui.files.dialog
        assert dialog is not None
        assert d.studio.ui.export.form.suffix in dialog.title
        dialog._text = str(folder)
        d.frames(2)
        d.click("###File dialog/Export")
        d.frames(3)

    def walk(d: Driver) -> None:
        session = d.session
        d.click("**/###Find objects")
        d.settle()
        n = int((session.objects().ids > 0).sum())
        to_sheet(d)
        d.keys(KEY.escape)
        assert not d.exists("Export objects/###SPZ")
        to_sheet(d)
        to_folder(d, "SPZ", tmp_path / "spz")
        assert not (tmp_path / "spz").exists(), "nothing before the answer"
        assert "rounded" in session.pending_question.text  # type: ignore[union-attr]
        d.click("Question/###Cancel")
        d.settle()
        assert not (tmp_path / "spz").exists()
        for form, kind in (
            ("SPZ", SplatFormat.SPZ),
            ("Compressed PLY", SplatFormat.COMPRESSED_PLY),
        ):
            to_sheet(d)
            to_folder(d, form, tmp_path / kind)
            d.click("Question/###Export")
            d.settle()
            listed = json.loads((tmp_path / kind / "groups.json").read_text())["groups"]
            assert len(listed) == n
            for entry in listed:
                assert entry["file"].endswith(kind.suffix)
                assert len(read_splats(tmp_path / kind / entry["file"])) == entry["count"]
        selection.select_groups(session, (int(session.objects().ids[1]),))
        to_sheet(d)
        to_folder(d, "PLY", tmp_path / "ply")
        d.settle()
        assert session.pending_question is None
        assert len(list((tmp_path / "ply").glob("*.ply"))) == 1

    drive(walk, path=tmp_path / "balls", size=size)
