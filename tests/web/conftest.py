"""A headless Chromium, one for all tests of web pages."""

import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gaga_core.export.export import export_scene_stage
from gaga_core.export.options import ExportOptions, PageContent
from gaga_core.progress import run_stage
from gaga_core.scene.camera_path import Bookmark, CameraPath, Keyframe, Shot
from gaga_core.scene.folders import Folders
from gaga_core.scene.scene import Scene, State
from tests.scenes import objects_scene

if TYPE_CHECKING:
    from playwright.sync_api import Browser

_NAMES = ("chromium", "chromium-browser", "google-chrome")
# Drawn by the processor: the same pictures on every machine.
FLAGS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
if hasattr(os, "geteuid") and os.geteuid() == 0:
    FLAGS.append("--no-sandbox")  # which Chromium has for others than root alone
DARK = np.array([26, 27, 31], np.float32) / 255  # background of page.css
HOSTILE = '<script>document.title = "owned"</script><img src=x onerror="document.title=1"></script>'


@dataclass(frozen=True, eq=False)
class Exported:
    """A scene and the page that was made of it."""

    scene: Scene
    shot: Shot  # of the first view
    behind: Shot  # of the second bookmark, where the path ends
    path: Path


def chromium() -> str | None:
    """The program, None where there is none."""
    return next((found for name in _NAMES if (found := shutil.which(name))), None)


@pytest.fixture(scope="session")
def browser() -> "Iterator[Browser]":
    program = chromium()
    if program is None:
        pytest.skip("no Chromium on this machine: install the package chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=program, args=FLAGS)
        yield launched
        launched.close()


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Exported:
    """Six balls on a floor with view-dependent color; two have names that attack the page.

    Two lie in a folder in a folder, one lies under another, one is locked, one is background. So is
    the one above another, which is listed in spite of that.
    """
    made = objects_scene(6, 160, sh_degree=2)
    scene = Scene.of(made.gaussians, made.labels)
    scene.names.update(
        {1: HOSTILE, 2: "Crème\u2028 brûlée", 3: "red ball", 4: "\ud800 & {{style}}"}
    )
    scene.folders = Folders.of(["Toys/<b>Balls"], {2: "Toys/<b>Balls", 3: "Toys/<b>Balls"}, {5: 1})
    scene.state[scene.labels == 4] |= np.uint8(State.LOCKED)
    first, second = (Shot.of_camera(made.cameras[k], 3.4) for k in (0, 3))
    content = PageContent(
        title=f"{HOSTILE} {{{{script}}}} {os.fsdecode(bytes([0xE9]))}",
        bookmarks=(Bookmark(HOSTILE, first, 1), Bookmark("from behind", second, 2)),
        path=CameraPath((Keyframe(first), Keyframe(second, 0.4))),
        cameras=made.cameras,
        background=frozenset({1, 6}),
    )
    path = tmp_path_factory.mktemp("page") / "balls.html"
    run_stage(export_scene_stage(scene, path, options=ExportOptions(page=content)))
    return Exported(scene, first, second, path)
