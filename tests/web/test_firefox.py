"""A page in Firefox: the picture of the renderer, and a click that selects as in the window."""

import io
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.scene.selection.picking import pick
from gaga_core.training.losses import psnr
from tests.display import xvfb
from tests.web.conftest import DARK, Exported
from tests.web.firefox import Firefox, firefox

_SIZE = (704, 230)  # pixels of the page
_SETTLED = "canvas[data-settled]"


@pytest.mark.skipif("GAGA_TEST_FIREFOX" not in os.environ, reason="on demand: make test-browsers")
def test_a_page_in_firefox(exported: Exported, tmp_path: Path) -> None:
    program = firefox()
    if program is None or shutil.which("Xvfb") is None:
        pytest.skip("no Firefox and Xvfb on this machine: install firefox-esr and xvfb")
    with xvfb() as display, Firefox(program, display, tmp_path, _SIZE) as browser:
        browser.open(exported.path)
        browser.wait_for(_SETTLED)
        box = "document.getElementById('picture').getBoundingClientRect().toJSON()"
        x, y, width, height = (round(browser.run(box)[k]) for k in ("x", "y", "width", "height"))
        browser.run("document.getElementById('views').style.visibility = 'hidden'")
        shown = np.asarray(Image.open(io.BytesIO(browser.picture())).convert("RGB"), np.float32)
        camera = exported.shot.camera(width, height)
        gaussians, labels = exported.scene.gaussians, exported.scene.labels
        rendered = CpuRasterizer().render(gaussians, camera, background=DARK).image
        assert psnr(shown[y : y + height, x : x + width] / np.float32(255), rendered) > 36
        middle = gaussians.means[labels == 3].mean(axis=0, dtype=np.float64)
        u, v = camera.project(middle[None])[0][0]
        hit = pick(exported.scene, camera, u, v)
        assert hit is not None
        browser.click(x + u, y + v)
        chosen = "document.querySelector('#list li.selected')?.dataset.id"
        assert int(browser.run(chosen)) == hit.group
        assert browser.run("document.getElementById('card-name').innerText") == "red ball"
