"""Add splats and an export that loses something, by the menu and the window's own dialogs."""

from pathlib import Path

import pytest

from gaga_core.io.splats.splat_files import SplatFormat, write_splats
from tests.app.window.driver import Driver, drive
from tests.scenes import objects_scene, random_gaussians

pytestmark = pytest.mark.window


def test_add_splats_and_export_them_small(display: str, tmp_path: Path) -> None:
    write_splats(tmp_path / "balls.ply", objects_scene().gaussians)
    write_splats(
        tmp_path / "chair.spz", random_gaussians(300, sh_degree=1, extent=0.4), SplatFormat.SPZ
    )

    def walk(d: Driver) -> None:
        session = d.session
        n = len(session.need().scene)
        before = d.pixels()
        d.menu("File/Add splats…")
        d.frames(3)
        dialog = d.studio.ui.files.dialog
        assert dialog is not None
        assert ".spz" in dialog.suffixes

        def choose(path: Path) -> None:
            shown = d.studio.ui.files.dialog
            assert shown is not None
            shown._text = str(path)
            d.frames(2)

        choose(tmp_path / "chair.spz")
        d.click("###File dialog/Add")
        d.settle()
        assert len(session.need().scene) == n + 300
        assert (d.pixels() != before).any()

        d.menu("File/Export scene…")
        d.export_to(tmp_path / "small.splat")
        d.settle()
        assert (tmp_path / "small.splat").stat().st_size == 32 * (n + 300)

    drive(walk, path=tmp_path / "balls.ply")
