"""The sheet Find objects with its folded switches, the lift, and the identity view."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_studio.features.commands import command
from gaga_studio.features.find.association import FindOptions, FindState
from gaga_studio.session.settings import Settings
from gaga_studio.session.view import Mode
from tests.app.window.driver import Driver, drive

pytestmark = pytest.mark.window


def test_objects_are_found_as_published(
    display: str, scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAGA_HOME", str(tmp_path / "home"))

    def walk(d: Driver) -> None:
        session = d.session
        few = FindOptions(threshold=0.2, lift=session.feature(FindState).options.lift.switched(12))
        session.feature(FindState).options = replace(few)
        d.menu("Find/###Find objects with settings…")
        d.click("Find objects/Preset/###Paper")
        assert session.settings.preset == "paper"
        d.click("Find objects/**/Memory bank (section 3.2)")
        d.click("Find objects/**/Identity encodings (section 3.3)")
        assert session.feature(FindState).options == few  # what is shown is not changed
        d.click("Find objects/###Find")
        d.settle()
        assert command("object.labels_identities").is_on(session)  # type: ignore[misc]
        assert session.need().history.undo_title == "Lift groups to identities"
        plain = d.pixels().astype(int)
        d.menu("View/###Identity encodings")
        assert session.view.mode is Mode.IDENTITY
        assert np.abs(d.pixels().astype(int) - plain).mean() > 5
        d.menu("Find/###Labels by votes")
        assert command("object.labels_votes").is_on(session)  # type: ignore[misc]

    drive(walk, path=scene_folder, settings=Settings(first_steps_done=True))
