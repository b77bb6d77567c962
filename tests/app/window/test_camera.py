"""The camera in the window: the view cube, the swipe line, a film and a picture saved by hand."""

from pathlib import Path

import numpy as np
import pytest
from imageio_ffmpeg import count_frames_and_secs
from imgui_bundle import ImVec2
from PIL import Image

from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_studio.features import camera, commands, export
from gaga_studio.session.view import PhotoCompareMode
from tests.app.window.driver import KEY, Driver, drive

pytestmark = pytest.mark.window


def test_cube_compare_film_and_picture(display: str, scene_folder: Path, tmp_path: Path) -> None:
    film, picture = tmp_path / "film.mp4", tmp_path / "picture.png"
    photos = tmp_path / "photos.mp4"

    def walk(d: Driver) -> None:
        s = d.session
        before = s.rig.camera(*d.size).forward
        d.click("Viewport/View cube")  # its middle: what looks at the eye most
        d.settle()
        after = s.rig.camera(*d.size).forward
        assert np.abs(after - before).max() > 1e-3
        local = s.rig.cube[2]
        assert np.sort(np.abs(local))[:2].max() < 1e-2 or np.abs(local).min() < 1e-2
        d.engine.mouse_drag_with_delta(ImVec2(30, 0))
        assert np.abs(s.rig.camera(*d.size).forward - after).max() > 0.05
        forward = s.rig.camera(*d.size).forward
        d.drag_picture((d.size[0] * 0.3, d.size[1] * 0.4), (40, 0))  # the picture has its own drags
        assert np.abs(s.rig.camera(*d.size).forward - forward).max() > 0.05

        d.menu("Camera/Swipe between photo and picture")
        d.settle()
        assert s.view.compare is PhotoCompareMode.SWIPE
        d.engine.mouse_move("//Viewport/Swipe line")
        d.engine.mouse_drag_with_delta(ImVec2(-60, 0))
        assert s.view.swipe < 0.48
        commands.run("camera.swipe", s)

        d.keys(KEY.k)
        s.rig.orbit(100, 0)
        d.keys(KEY.k)
        assert len(camera.path_of(s).keyframes) == 2
        d.studio.ui.film.width, d.studio.ui.film.height = 64, 48
        d.studio.ui.film.fps = 5.0
        d.menu("Camera/Save film…")
        d.click("Save film/###Save film…")
        d.answer_path(film)
        d.settle()
        d.menu("Camera/Save film…")  # through the photos: half a second each
        d.click("Save film/Way/###Through the photos")
        d.studio.ui.film.seconds = 0.4
        d.click("Save film/###Save film…")
        d.answer_path(photos)
        d.settle()
        d.menu("File/Save picture…")
        d.click("Save picture/###Save picture…")
        d.answer_path(picture)
        d.settle()
        commands.run("view.rings", s)  # only OpenGL draws these
        export.save_picture(s, tmp_path / "rings.png", (80, 60), transparent=True)
        d.settle()

    drive(walk, path=scene_folder, size=(1000, 640))
    assert film.stat().st_size > 500
    n_frames, _ = count_frames_and_secs(str(photos))
    assert n_frames == 2 * len(open_scene_folder(scene_folder).image_paths) > 0
    with Image.open(picture) as saved:
        assert saved.size == (64, 48)
        assert np.asarray(saved).std() > 5
    with Image.open(tmp_path / "rings.png") as saved:
        assert saved.mode == "RGBA"
        assert np.asarray(saved)[..., 3].max() > 100
