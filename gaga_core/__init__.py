"""gaga_core: Gaga (TMLR 2026) on numpy and numba, usable without a window.

Conventions, project-wide
-------------------------
Letters   N splats, K chosen splats, V views, H x W pixels, M masks of a view, G groups, D identity
          channels, S spherical-harmonics coefficients per color channel.
Axes      OpenCV: x right, y down, z forward, in the camera; the world is the scene's own frame.
Frames    are in the names: ``cam_from_world`` maps world points into the camera.
Pixels    column u, row v; the centre of the first pixel is (0.5, 0.5).
Rotation  quaternions wxyz; radians everywhere but in texts for people.
Lengths   scene units (COLMAP's scale is arbitrary: never metres).
Labels    int32; 0 = none, groups are 1..G. In a memory bank -1 marks a free Gaussian.
Color     0..1, gamma space: splats are blended as they were trained.

The public interface is what this module names; it is loaded when it is first used. All other
modules are internal and may change::

    scene = gaga_core.open("SCENE")
    scene.objects["chair"].recolor((0.9, 0.1, 0.1))
    scene.export("edited.ply")
"""

import importlib
from typing import TYPE_CHECKING

from gaga_core.version import __version__

if TYPE_CHECKING:
    from gaga_core.api import (
        Objects,
        Scene,
        SceneObject,
        find_objects,
        lift,
        reconstruct,
        run,
        score,
        segment,
    )
    from gaga_core.api import open_scene as open
    from gaga_core.errors import GagaError
    from gaga_core.pipeline.settings import ReconstructConfig
    from gaga_core.progress import Progress

_INTERFACE = (
    *("Objects", "Scene", "SceneObject", "find_objects", "lift", "open", "reconstruct"),
    *("run", "score", "segment"),
)
_HOMES = dict.fromkeys(_INTERFACE, "gaga_core.api") | {
    "GagaError": "gaga_core.errors",
    "Progress": "gaga_core.progress",
    "ReconstructConfig": "gaga_core.pipeline.settings",
}
__all__ = [
    "GagaError",
    "Objects",
    "Progress",
    "ReconstructConfig",
    "Scene",
    "SceneObject",
    "__version__",
    "find_objects",
    "lift",
    "open",
    "reconstruct",
    "run",
    "score",
    "segment",
]


def __getattr__(name: str) -> object:
    """Load the interface when it is first asked for: numba takes most of a second."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), "open_scene" if name == "open" else name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
