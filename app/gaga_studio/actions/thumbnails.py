"""Pictures of single objects for the list: cut out of the best photo, else drawn alone.

A request is a key that names what the picture shows, and a function for the image store's thread.
An object that its masks made is shown in the photo whose mask holds most of its splats; one that a
person made, and every object of a scene without photos, is drawn small from its splats.
"""

import hashlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from gaga_core.arrays import DoubleArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.geometry import look_at
from gaga_core.grouping.memory_bank import Decision
from gaga_core.io.images import read_rgb
from gaga_core.masks import Loader, resize_labels
from gaga_core.query.crops import Shown, cut_out, shown_groups
from gaga_core.scene.bake import bake
from gaga_core.scene.objects import ObjectTable, group_indices
from gaga_core.scene.scene import Scene
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session

SIDE = 96  # pixels
_TRIED = 3  # photos that are compared
_HELD = 0.6  # share of an object's splats that its masks must have given it
_MOST = 60_000  # splats that are drawn
_BACK = 46  # grey behind an object that is drawn alone

Load = Callable[[], UInt8Array]


def request(session: Session, table: ObjectTable, row: int) -> tuple[str, Load] | None:
    """Return key and loader of the picture of a row of the list; None if there is none yet."""
    document = session.document
    group = int(table.ids[row])
    if document is None or group == 0:
        return None
    if session.live is not None and not session.live.keeps_ids:
        return None
    photos = _photos(session, document, group)
    if photos:
        names = [f"{path} {sorted(masks)}" for path, _, masks in photos]
        return f"crop {session.masks.source} {names}", partial(_cropped, photos)
    if session.is_previewing or session.live is not None or session.jobs.quiet is not None:
        return None  # a quiet job may compile what this needs
    key = f"alone {group} {_mark(document, table, row)}"
    scene = replace(document.scene)  # columns are never written in place: a snapshot
    view = _ObjectView.of(session, table, row)
    return key, partial(_alone, scene, group, view)


# --- out of a photo

Photo = tuple[Path, Loader, frozenset[int]]  # its file, its label map, the masks of the object


def _photos(session: Session, document: Document, group: int) -> tuple[Photo, ...]:
    """Return the photos to try, those with most of the object's splats behind its masks."""
    folder = document.project.folder
    if folder is None or document.read.held_by_masks().get(group, 0.0) < _HELD:
        return ()
    views: dict[str, list[Decision]] = {}
    for decision in document.read.decisions(group, None):
        views.setdefault(decision.view, []).append(decision)
    known = [v for v in views if v in folder.image_paths and v in session.masks]
    known.sort(key=lambda view: (-sum(d.n_gaussians for d in views[view]), view))
    return tuple(
        (folder.image_paths[v], session.masks.loaders[v], frozenset(d.mask for d in views[v]))
        for v in known[:_TRIED]
    )


def _cropped(photos: tuple[Photo, ...]) -> UInt8Array:
    """The object (SIDE, SIDE, 3) where it shows best, its surroundings dimmed."""
    found: list[tuple[Shown, UInt8Array]] = []
    for i, (_, load, masks) in enumerate(photos):
        labels = load()
        own = np.isin(labels, np.array(sorted(masks))).astype(np.uint8)
        found += [(one, own) for one in shown_groups(i, own.astype(np.int32))]
    if not found:
        raise GagaError("The object is too small in its photos.")
    best, own = max(found, key=lambda pair: pair[0].score)
    height, width = own.shape
    left, top, right, bottom = best.box
    zoom = min(1.0, 1.3 * SIDE / max(right - left, bottom - top))
    picture = read_rgb(photos[best.view][0], max(round(zoom * max(height, width)), SIDE))
    small = resize_labels(own.astype(np.int32), picture.shape[1], picture.shape[0])
    again = shown_groups(best.view, small)
    if not again:
        raise GagaError("The object is too small in its photos.")
    return cut_out(picture, small, again[0], SIDE)[1]


# --- alone


class _ObjectView:
    """From where an object is drawn alone."""

    def __init__(self, centre: DoubleArray, radius: float, towards: DoubleArray, up: DoubleArray):
        self.centre, self.radius, self.towards, self.up = centre, radius, towards, up

    @staticmethod
    def of(session: Session, table: ObjectTable, row: int) -> "_ObjectView":
        """From the middle of the photos' cameras, else from a little above."""
        up = np.asarray(session.rig.up, np.float64)
        centre = table.centre[row]
        side = np.cross(up, [0.0, 0.0, 1.0] if abs(up[2]) < 0.9 else [1.0, 0.0, 0.0])
        towards = side / np.linalg.norm(side) + 0.6 * up
        if session.cameras:
            eyes = np.mean([camera.position for camera in session.cameras], axis=0)
            away = centre - eyes
            # Around the scene the cameras' middle is inside it: look from outside and above.
            flat = away - (away @ up) * up
            if np.linalg.norm(flat) > 1e-6:
                towards = flat / np.linalg.norm(flat) + 0.6 * up
        extent = np.linalg.norm(table.hi[row] - table.lo[row]) / 2
        radius = float(max(min(table.radius[row] * 1.2, extent), 1e-6))
        return _ObjectView(centre, radius, towards, up)

    def camera(self) -> Camera:
        """A picture that the object fills."""
        focal = 1.6 * SIDE
        distance = self.radius * 3.4
        eye = self.centre + distance * self.towards / np.linalg.norm(self.towards)
        K = np.array([[focal, 0, SIDE / 2], [0, focal, SIDE / 2], [0, 0, 1.0]])
        return Camera(K, look_at(eye, self.centre, self.up), SIDE, SIDE, "thumbnail")


def _alone(scene: Scene, group: int, view: _ObjectView) -> UInt8Array:
    """The object (SIDE, SIDE, 3) and nothing else."""
    from gaga_core.raster.cpu import CpuRasterizer  # numba is a good part of the launch time

    rows = group_indices(scene, group)
    if len(rows) == 0:
        raise GagaError("The object has no splats.")
    step = -(-len(rows) // _MOST)
    splats = bake(scene, indices=rows[::step])
    behind = np.full(3, _BACK / 255, np.float32)
    frame = CpuRasterizer().render(splats, view.camera(), background=behind)
    return np.rint(np.clip(frame.image, 0, 1) * 255).astype(np.uint8)


def _mark(document: Document, table: ObjectTable, row: int) -> str:
    """Return a digest of an object: positions, count and colors of its splats."""
    where = np.concatenate([table.centre[row], table.lo[row], table.hi[row]])
    content = [where.tobytes(), str(table.counts[row]).encode()]
    content += [document.scene.placements.color.tobytes()]
    content += [document.scene.placements.opacity.tobytes()]
    return hashlib.blake2b(b"".join(content), digest_size=8).hexdigest()
