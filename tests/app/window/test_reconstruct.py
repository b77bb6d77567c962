"""A person opens photos, makes splats of them and sees them grow; then stops and goes on."""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from gaga_core.pipeline.reconstruct import reconstruct_scene
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.progress import run_stage
from gaga_studio.actions.reconstruction import ReconstructionPlan
from tests.app.window.driver import Driver, drive
from tests.core.reconstruct.photo_scenes import write_photos

pytestmark = pytest.mark.window
_SMALL = ReconstructConfig(max_side=160)


def _capture(d: Driver, name: str) -> None:
    """Keep a picture of the window where somebody wants to look at it."""
    folder = os.environ.get("GAGA_CAPTURES")
    if folder:
        d.capture_now(Path(folder) / f"{name}.png")


def test_photos_become_splats_before_the_eyes(display: str, tmp_path: Path) -> None:
    scene = tmp_path / "room"
    write_photos(scene / "images", 6)
    run_stage(reconstruct_scene(None, scene, replace(_SMALL, only="sfm")))

    def walk(d: Driver) -> None:
        session = d.session
        assert session.photos is not None
        assert d.exists("**/###Make splats")
        _capture(d, "photos")
        d.click("**/###Settings…")
        d.frames(4)
        d.type_into("**/##Iterations", "20000")
        d.type_into("**/##Longest side, pixels", "160")
        _capture(d, "sheet")
        assert isinstance(d.studio.ui.plan.plan, ReconstructionPlan)
        assert d.studio.ui.plan.plan.config.iterations == 20_000
        d.click("**/###Start")
        d.until(lambda: session.shown is not None, "splats are shown")
        training = session.training
        assert training is not None
        first = training.scene
        d.until(lambda: training.update is not None and training.update.iteration > 40, "steps")
        d.frames(5)
        viewport = d.studio.viewport
        assert viewport is not None
        assert viewport.buffers.scene is first
        pixels = d.on_main(viewport.read_pixels)
        assert pixels.std() > 5, "the picture shows them"
        eye = session.rig.eye
        d.drag_picture((300, 250), (60, 10))
        assert (session.rig.eye != eye).any(), "the camera moves while they train"
        _capture(d, "training")
        d.click("**/###Cancel")
        d.until(lambda: session.jobs.running is None, "the training stops")
        d.frames(4)
        assert session.photos is not None
        assert session.photos.iteration > 0
        _capture(d, "stopped")

    drive(walk, path=scene, size=(1000, 640))
