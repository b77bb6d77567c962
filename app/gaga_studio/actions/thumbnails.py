"""Pictures of single objects for the list: the object alone, on neutral ground, as large as fits.

A request is a key that names what the picture shows, and a function for the image store's thread.
The digest of the object's splats is part of the key, so a picture that was drawn before is shown
again after an undo. Digests are measured in parallel (`actions.search`): until they are those of
the present scene, the former picture stays and nothing new is drawn.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at
from gaga_core.scene.bake import bake
from gaga_core.scene.objects import ObjectTable, group_indices
from gaga_core.scene.scene import Scene
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session

SIDE, LARGE = 96, 320  # pixels, in the list and in its tooltip
GROUND = 112  # grey behind the object: dark and bright things stand out from it
_MOST = 60_000  # splats that are drawn
_FILLS = 0.9  # share of the side that the object takes
_EDGE = 1.0  # percent of the splats that may lie outside on each side
_INNER, _AROUND = 6.0, 0.25  # percent outside the inner part; room around it, of its extent
_STEEP = 0.45  # best elevation of the view, radians over the ground: three-quarter
_FAR = 0.15  # how much the distance of a camera counts against its elevation

Load = Callable[[], UInt8Array]


def request(
    session: Session, table: ObjectTable, row: int, side: int = SIDE
) -> tuple[str, Load | None] | None:
    """Return key and loader of the picture of a row of the list; None if there is none yet.

    Without a loader only a picture that was drawn before can be shown.
    """
    document = session.document
    group = int(table.ids[row])
    if document is None or group == 0:
        return None
    if session.live is not None and not session.live.keeps_ids:
        return None
    digest = document.search.digest_of(group)
    if digest is None:
        return None
    key = f"object {digest:x} {side}"
    if not _may_draw(session, document):
        return key, None
    scene = replace(document.scene)  # columns are never written in place: a snapshot
    return key, partial(_drawn, scene, group, _View.of(session, table, row), side)


def _may_draw(session: Session, document: Document) -> bool:
    """Whether digests are those of the scene, and nothing goes on that drawing would delay."""
    is_busy = session.is_previewing or session.live is not None or session.rig.is_moving
    # A quiet job may compile what this needs.
    return not is_busy and session.jobs.quiet is None and document.search.is_measured


@dataclass(frozen=True, eq=False)
class _View:
    """From where an object is drawn."""

    centre: DoubleArray  # (3,) world
    radius: float
    towards: DoubleArray  # (3,) unit, from the object to the eye
    up: DoubleArray  # (3,) unit

    @staticmethod
    def of(session: Session, table: ObjectTable, row: int) -> "_View":
        """A little from above, where a photo was taken; from any side without photos."""
        up = np.asarray(session.rig.up, np.float64)
        centre = table.centre[row]
        extent = np.linalg.norm(table.hi[row] - table.lo[row]) / 2
        radius = float(max(min(table.radius[row] * 1.2, extent), 1e-6))
        return _View(centre, radius, _towards(session, centre, up), up)

    def camera(self, side: int) -> Camera:
        """A picture that holds all of the object."""
        focal = 1.6 * side
        eye = self.centre + 6 * self.radius * self.towards
        K = np.array([[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1.0]])
        return Camera(K, look_at(eye, self.centre, self.up), side, side, "thumbnail")


def _towards(session: Session, centre: DoubleArray, up: DoubleArray) -> DoubleArray:
    """Direction (3,) to the camera of the photos that sees the object best."""
    if not session.cameras:
        side = np.cross(up, [0.0, 0.0, 1.0] if abs(up[2]) < 0.9 else [1.0, 0.0, 0.0])
        front = np.cross(side, up)
        direction = side / np.linalg.norm(side) + front / np.linalg.norm(front) + 0.7 * up
        result: DoubleArray = direction / np.linalg.norm(direction)
        return result
    away = np.stack([camera.position for camera in session.cameras]) - centre
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    away = away / distance[:, None]
    elevation = np.arcsin(np.clip(away @ up, -1, 1))
    cost = np.abs(elevation - _STEEP) + _FAR * distance / np.median(distance)
    best: DoubleArray = away[int(cost.argmin())]
    return best


def _drawn(scene: Scene, group: int, view: _View, side: int) -> UInt8Array:
    """The object (side, side, 3) and nothing else."""
    from gaga_core.raster.cpu import CpuRasterizer  # numba is a good part of the launch time

    rows = group_indices(scene, group)
    if len(rows) == 0:
        raise GagaError("The object has no splats.")
    splats = bake(scene, indices=rows[:: -(-len(rows) // _MOST)])
    ground = np.full(3, GROUND / 255, np.float32)
    frame = CpuRasterizer().render(splats, _tight(view.camera(side), splats), background=ground)
    return np.rint(np.clip(frame.image, 0, 1) * 255).astype(np.uint8)


def _tight(camera: Camera, splats: Gaussians) -> Camera:
    """``camera`` with the focal length and the centre at which the splats fill the picture."""
    pixels, depth = camera.project(splats.means.astype(np.float64))
    shown = pixels[np.isfinite(pixels).all(axis=1) & (depth > 0) & (_opacity(splats) > 0.1)]
    if len(shown) == 0:
        return camera
    low, inner_low, inner_high, high = np.percentile(
        shown, [_EDGE, _INNER, 100 - _INNER, 100 - _EDGE], axis=0
    )
    reach = _AROUND * (inner_high - inner_low)  # strays are farther away than this
    low, high = np.maximum(low, inner_low - reach), np.minimum(high, inner_high + reach)
    zoom = _FILLS * camera.width / max(float((high - low).max()), 1e-6)
    K = camera.K.copy()
    K[:2] *= zoom
    K[:2, 2] += camera.width / 2 - zoom * (low + high) / 2
    return replace(camera, K=K)


def _opacity(splats: Gaussians) -> FloatArray:
    result: FloatArray = (1 / (1 + np.exp(-splats.logit_opacities))).astype(np.float32)
    return result
