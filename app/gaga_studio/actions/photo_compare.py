"""Compare a photo with the picture, at the photo's own camera."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaga_core.arrays import FloatArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.scene.scene import Scene
from gaga_studio.actions import navigation
from gaga_studio.session.session import Session
from gaga_studio.session.view_state import PhotoCompareMode

SIDE = 1024  # longest side of the difference, pixels
_GAIN = 4.0  # of the difference: a quarter of the range is white


@dataclass(frozen=True)
class PhotoPlacement:
    """Where a photo lies over the picture: its corner and size in pixels of the picture."""

    x: float
    y: float
    width: float
    height: float


def set_mode(session: Session, mode: PhotoCompareMode) -> None:
    """Compare in this way, or stop when it is on already; fly to a photo first."""
    view = session.view
    view.compare = PhotoCompareMode.OFF if view.compare is mode else mode
    if view.compare is not PhotoCompareMode.OFF and compared(session) is None:
        go_to_a_photo(session)


def hold(session: Session) -> None:
    """Lay the photo over the picture until the keys are released."""
    if compared(session) is None:
        go_to_a_photo(session)
    session.view.holds_photo = True


def compared(session: Session) -> Camera | None:
    """Return the camera of the photo that the view shows exactly; None elsewhere."""
    index = session.active_view
    if index is None or index >= len(session.cameras):
        return None
    if session.rig.is_moving:
        return None
    camera, here = session.cameras[index], session.rig.shot().camera(1, 1)
    scale = max(session.rig.radius, 1e-9)
    apart = np.abs(here.cam_from_world - camera.cam_from_world)
    is_there = apart[:3, :3].max() < 1e-6 and apart[:3, 3].max() < 1e-6 * scale
    return camera if is_there else None


def place(photo: Camera, view: Camera) -> PhotoPlacement:
    """Return where the photo lies in the picture of ``view``, which has the same pose.

    Exact for any principal point and for pixels that are not square.
    """
    sx, sy = view.K[0, 0] / photo.K[0, 0], view.K[1, 1] / photo.K[1, 1]
    x = float(view.K[0, 2] - sx * photo.K[0, 2])
    y = float(view.K[1, 2] - sy * photo.K[1, 2])
    return PhotoPlacement(x, y, float(sx * photo.width), float(sy * photo.height))


def difference(
    scene: Scene, camera: Camera, photo: Path, *, side: int = SIDE
) -> tuple[UInt8Array, float]:
    """Return |photo - picture| as a heat map (H, W, 3), and its mean, 0..1.

    The picture is of the whole scene as it is, drawn by the best rasterizer here at the photo's
    exact camera, over black; slow enough to want a thread.
    """
    from gaga_core.io.images import read_rgb
    from gaga_core.raster import choose
    from gaga_core.scene.bake import bake

    seen = read_rgb(photo, side)
    height, width = seen.shape[:2]
    frame = choose().render(bake(scene), camera.resized(width, height))
    apart = np.abs(np.clip(frame.image, 0, 1) - seen / np.float32(255))
    return _heat(apart.mean(axis=2) * _GAIN), float(apart.mean())


def snapshot(scene: Scene) -> Scene:
    """Return the scene as it is now: edits replace columns, they never write into them."""
    return replace(scene)


def content_mark(scene: Scene) -> str:
    """Return a key that changes when the picture does."""
    r = scene.revision
    return f"{r.splats} {r.state} {r.placement} {r.placements}"


def _heat(amount: FloatArray) -> UInt8Array:
    """Black, violet, red, yellow, white (H, W, 3) for 0..1 (H, W)."""
    stops = np.array([[0, 0, 0], [70, 20, 110], [200, 40, 60], [255, 190, 60], [255, 255, 255]])
    at = np.linspace(0, 1, len(stops))
    t = np.clip(amount, 0, 1)
    return np.stack([np.interp(t, at, stops[:, c]) for c in range(3)], axis=2).astype(np.uint8)


def go_to_a_photo(session: Session) -> None:
    """Go to the active photo, or the nearest one, at once."""
    index = session.active_view
    if index is None:
        eye = session.rig.eye
        index = int(np.argmin([np.linalg.norm(c.position - eye) for c in session.cameras]))
    navigation.go_to_view(session, index)
    session.rig.go_to(session.cameras[index], animated=False)
