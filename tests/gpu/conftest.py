"""A viewport on the display-less context, and the measure that pictures are compared by."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.raster import choose
from gaga_core.scene.scene import Scene
from gaga_studio.gpu.viewport import Viewport
from gaga_studio.session.view import ViewState

BACKGROUND = (0.2, 0.1, 0.05)
Errors = Callable[[Scene, Gaussians, Camera], float]


@pytest.fixture
def viewport(gl: Any) -> Iterator[Viewport]:
    made = Viewport(gl)
    yield made
    made.release()
    assert gl.error == "GL_NO_ERROR"


@pytest.fixture
def mean_error(viewport: Viewport) -> Errors:
    """Mean difference, in 1/255, of a drawn scene and the CPU's picture of ``expected``."""

    def measure(scene: Scene, expected: Gaussians, camera: Camera) -> float:
        viewport.draw(scene, camera, ViewState(background=BACKGROUND), wait=True)
        assert viewport.settled
        frame = choose("cpu").render(expected, camera, background=np.array(BACKGROUND))
        difference = np.clip(frame.image, 0, 1) * 255 - viewport.read_pixels()
        return float(np.abs(difference).mean())

    return measure
