"""Align two captures by their splats alone, where photos are missing: by drawn pictures of both.

Each is drawn from where its photos were taken, or from all around where no cameras are known; the
pictures are matched as photos are. Features of drawn surfaces have a scale of their own, which
features of bare geometry lack: two scans rarely have the same units.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gaga_core.io.images import write_rgb
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.captures.alignment import Capture
from gaga_core.scene.orientation import guess_up, views_around
from gaga_core.scene.selection.bounds import robust_box

STAGE = "Draw the surfaces"
_SIDE = 640  # pixels of a picture
_MOST = 24  # pictures of a capture
_RINGS = ((-35.0, 6), (5.0, 9), (40.0, 9))  # elevation in degrees, views around
_FIELD, _ROOM = np.radians(50.0), 0.8  # field of view, and how far it is filled


def drawn_stage(capture: Capture, folder: Path, rasterizer: Rasterizer) -> Stage[Capture]:
    """``capture`` with drawn pictures in ``folder`` instead of photos."""
    assert capture.scene is not None
    gaussians = yield from bake_stage(capture.scene)
    views = capture.cameras
    if views:
        chosen = np.linspace(0, len(views) - 1, min(len(views), _MOST)).round().astype(int)
        views = tuple(views[i].at_most(_SIDE) for i in chosen)
    else:
        box, up = robust_box(gaussians.means, 0.98), guess_up(gaussians)
        views = views_around(box, up, _RINGS, side=_SIDE, field=_FIELD, room=_ROOM)
    folder.mkdir(parents=True)
    named = [replace(view, name=f"{i:03d}.png") for i, view in enumerate(views)]
    for i, view in enumerate(named):
        yield Progress(STAGE, i, len(named))
        write_rgb(folder / view.name, rasterizer.render(gaussians, view).image)
    return replace(
        capture, cameras=tuple(named), photos={view.name: folder / view.name for view in named}
    )
