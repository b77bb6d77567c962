"""What of the window can be tested without one: launching, keys, search, projections."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_studio.__main__ import display_problem, library_problem, parse
from gaga_studio.features.commands import COMMANDS, MENUS, all_menus, new_session
from gaga_studio.ui.dialogs import preferences
from gaga_studio.ui.dialogs.sheets import keys_with, matching
from gaga_studio.ui.panels import inspector
from gaga_studio.ui.viewport.gizmo import projection
from tests.app.folders import write_scene
from tests.scenes import orbit_cameras


def test_the_command_line() -> None:
    assert parse([]).path is None
    assert parse(["scene", "--demo"]).path == Path("scene")
    assert parse(["--demo"]).demo


def test_no_display_is_one_sentence_and_status_1() -> None:
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    command = [sys.executable, "-X", "importtime", "-m", "gaga_studio"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    said = [line for line in done.stderr.splitlines() if not line.startswith("import time:")]
    if sys.platform.startswith("linux"):
        assert done.returncode == 1
        assert len(said) == 1
        assert "needs a display" in said[0]
        assert "imgui_bundle" not in done.stderr, "nothing heavy is imported before"


def test_a_display_that_cannot_be_reached() -> None:
    if not sys.platform.startswith("linux"):
        pytest.skip("DISPLAY is of X11")
    environment = os.environ | {"DISPLAY": ":4711"}
    environment.pop("WAYLAND_DISPLAY", None)
    command = [sys.executable, "-m", "gaga_studio"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "could not reach the display" in done.stderr
    assert "Traceback" not in done.stderr


def test_missing_libraries_are_named() -> None:
    error = ImportError("libX11.so.6: cannot open shared object file")
    assert "apt-get install" in library_problem(error)
    assert display_problem("darwin", {}) == ""


def test_every_shortcut_is_a_key() -> None:
    keys = preferences.all_keys()
    assert {"Z", "F1", "Delete", "/", "1"} <= set(keys)


def test_the_palette_finds_by_any_word() -> None:
    wanted = {
        "edit.undo": ("undo", "undo history"),
        "view.history": ("history", "versions"),
        "edit.recolor": ("recolor", "colour", "paint"),
        "edit.delete": ("delete", "remove", "erase"),
        "edit.duplicate": ("copy", "duplicate"),
        "file.save_as": ("save as",),
        "object.hide": ("hide",),
        "object.show_all": ("show", "unhide"),
        "edit.restore": ("restore", "undelete"),
        "view.home": ("reset view",),
        "tool.measure": ("measure l",),  # not those with the letter somewhere
        "file.export_objects": ("export obj",),
        "camera.split_groups": ("split view", "side by side"),
        "edit.preferences": ("blender", "blender keys"),
        "file.export_scene": ("blender", "unity", "unreal"),
        "tool.set_scale": ("measure",),
    }
    for id_, typed in wanted.items():
        assert all(id_ in [c.id for c in matching(text)[:4]] for text in typed), id_
    for text in ("undo", "measure", "delete", "fill", "rename"):
        assert matching(text)[0].id.endswith(f".{text}"), "what is so called before all else"
    possible = matching("split", is_available=lambda c: c.id == "camera.split_before")
    first = ["object.split", "camera.split_before"]  # the one of that name, then what can be done
    assert [c.id for c in possible[:2]] == first
    assert matching("models...")[:1] == matching("Models…")[:1] == matching("models")[:1] != []
    assert matching("no such thing") == []
    assert len(matching("")) == len(COMMANDS)


def test_the_sheet_of_keys_finds_a_key_by_what_it_does_and_back() -> None:
    session = new_session()
    found = {text: keys_with(text, session) for text in ("", "ctrl+z", "erase", "orbit", "no such")}
    assert found[""].keys() - {"Mouse"} <= MENUS.keys()
    assert ("Ctrl+Z", "Undo") in found["ctrl+z"]["Edit"]
    assert [title for rows in found["erase"].values() for _, title in rows][:1] == ["Delete"]
    assert {keys for keys, _ in found["orbit"]["Mouse"]} == {"Drag", "Middle drag"}
    assert found["no such"] == {}
    assert keys_with("fly", session)["Mouse"][0][0] == "W A S D, Q, E"
    session.settings = replace(session.settings, keys="blender")
    assert keys_with("fly", session)["Mouse"][0][0].startswith("V, then"), "they are commands there"


def test_the_palette_finds_panels() -> None:
    menus = all_menus(new_session())
    first = {
        text: matching(text, menus)[0].id
        for text in ("inspector", "outliner", "memory bank", "bookmarks", "history", "film strip")
    }
    assert list(first.values()) == [
        *("panel.inspector", "panel.objects", "panel.memory_bank", "panel.bookmarks"),
        *("view.history", "panel.views"),
    ]


def test_the_handles_see_the_pixels_of_the_camera() -> None:
    camera = orbit_cameras(3, width=320, height=200)[1]
    points = np.random.default_rng(0).normal(0, 0.3, (50, 3))
    expected, _ = camera.project(points)
    gl_from_world = np.diag([1, -1, -1, 1]) @ camera.cam_from_world
    clip = np.c_[points, np.ones(50)] @ (projection(camera, 0.01, 100.0) @ gl_from_world).T
    ndc = clip[:, :3] / clip[:, 3:]
    pixels = np.c_[(ndc[:, 0] + 1) / 2 * 320, (1 - ndc[:, 1]) / 2 * 200]
    np.testing.assert_allclose(pixels, expected, atol=1e-9)
    assert (np.abs(ndc[:, 2]) < 1).all()


# --- What starting the program imports.


def run(*arguments: str, **environment: str) -> "subprocess.CompletedProcess[str]":
    env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    return subprocess.run(
        [sys.executable, *arguments],
        env=env | environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_help_needs_no_display_and_no_heavy_import(option: str) -> None:
    done = run("-X", "importtime", "-m", "gaga_studio", option)
    assert done.returncode == 0
    assert "gaga-studio" in done.stdout
    for heavy in ("numpy", "imgui_bundle", "numba", "torch"):
        assert f"| {heavy}\n" not in done.stderr.replace("|   ", "| ")


def test_opening_editing_and_saving_import_neither_torch_nor_transformers(tmp_path: Path) -> None:
    write_scene(tmp_path / "scene", n_objects=2)
    code = f"""
import sys
from pathlib import Path
import gaga_studio.studio
assert "scipy.optimize" not in sys.modules, "only the errors of a view need it"
from gaga_studio.features.find import association
from gaga_studio.features.commands import new_session
from gaga_studio.session.session import Session
session = new_session()
session.open(Path({str(tmp_path / "scene")!r}))
session.jobs.wait()
session.tick(0.1)
assert session.scene is not None
association.associate(session)
session.jobs.wait()
session.tick(0.1)
session.save()
session.jobs.wait()
loaded = [name for name in ("torch", "transformers", "pycolmap") if name in sys.modules]
assert not loaded, loaded
"""
    done = run("-c", code, GAGA_HOME=str(tmp_path / "home"))
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("form", ["%.1f°", "%.3f m", "%.3f"])
def test_numbers_of_the_inspector_are_no_minus_zero(form: str) -> None:
    for value in (-0.0, -1e-7, -0.0004, -0.04, 0.0, -0.06, 3.25, -12.0):
        told, exact = form % inspector.as_shown(form, value), form % value
        assert told == (exact.removeprefix("-") if float(exact.strip("°m ")) == 0 else exact)
