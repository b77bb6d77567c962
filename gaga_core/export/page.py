"""The page of a scene: its objects with names and pictures, its bookmarks and its camera path."""

import io
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.export.options import ExportOptions, PageContent
from gaga_core.gaussians import Gaussians
from gaga_core.io.splats.web_page import (
    Page,
    PageObject,
    PagePath,
    ShotRow,
    first_view,
    no_object,
    splat_reach,
    write_page_stage,
)
from gaga_core.progress import Progress, Stage
from gaga_core.scene.camera_path import (
    Shot,
    carried_bookmarks,
    carried_path,
    carried_shot,
)
from gaga_core.scene.object_picture import MOST_DRAWN, object_picture, object_view
from gaga_core.scene.objects import group_colors, group_name
from gaga_core.scene.orientation import common_target
from gaga_core.scene.project import Project
from gaga_core.scene.scene import Scene, State

PICTURE = 96  # pixels of a side
_QUALITY = 82  # of WebP
_FPS, _MOST_SHOTS = 10.0, 900  # of a path; the page blends between
_LEAST_RADIUS = 0.1  # of a page's scene: what is nearer than NEAR (camera) is not drawn
_NEAREST = 0.05  # of the scene's radius: what a camera looks at is not nearer


def content_of(project: Project) -> PageContent:
    """Content of a page of a project in addition to its splats."""
    folder = project.placed_folder
    return PageContent(
        title=project.stem,
        bookmarks=carried_bookmarks(project.bookmarks, project.scene.frame.world),
        path=project.placed_film,
        cameras=folder.cameras if folder is not None else (),
    )


DRAWS = "Draw objects"


def write_scene_page_stage(
    scene: Scene,
    splats: IntArray,
    gaussians: Gaussians,
    path: Path,
    options: ExportOptions,
    origin: DoubleArray,
) -> Stage[None]:
    """Write the page of ``splats`` (K,) of ``scene``, baked as ``gaussians`` (K, world).

    ``origin`` (3,), world, becomes the origin of the page. Units of a page are its own: the scale
    of the options has no effect, and a tiny scene is enlarged.
    """
    start, radius = _start(options, gaussians)
    options = replace(options, scale=max(1.0, _LEAST_RADIUS / radius))
    ids, places = np.unique(np.append(scene.labels[splats], 0), return_inverse=True)
    groups = ids.astype(np.int32), places[:-1].astype(np.int32)
    objects: list[PageObject] = []
    # Groups all of whose splats are locked.
    free = scene.labels[splats[~scene.has(State.LOCKED)[splats]]]
    locked = set(np.setdiff1d(ids, free).tolist()) - {0}
    for entry in _objects(scene, gaussians, groups, options):
        yield Progress(DRAWS, len(objects), len(ids), entry.name)
        objects.append(replace(entry, is_locked=entry.id in locked))
    world = np.diag([options.scale] * 3 + [1.0])
    world[:3, 3] = -options.scale * origin
    for k, entry in enumerate(objects):
        x, y, z = (world[:3, :3] @ np.array(entry.centre) + world[:3, 3]).tolist()
        objects[k] = replace(entry, centre=(x, y, z), radius=entry.radius * options.scale)
    marks = carried_bookmarks(options.page.bookmarks, world)
    film, path_shown = carried_path(options.page.path, world), None
    if len(film.keyframes) > 1:
        n = int(np.clip(round(film.seconds * _FPS), 2, _MOST_SHOTS)) + 1
        shots = tuple(_row(film.shot(t)) for t in np.linspace(0, film.seconds, n).tolist())
        path_shown = PagePath(shots, film.seconds, film.is_closed)
    page = Page(
        title=options.page.title or path.stem,
        gaussians=options.applied(gaussians, origin),
        labels=groups[1],
        objects=tuple(objects),
        up=options.up,
        radius=radius * options.scale,
        start=_row(carried_shot(start, world)),
        bookmarks=tuple((mark.name, mark.key, _row(mark.shot)) for mark in marks),
        path=path_shown,
    )
    yield from write_page_stage(path, page)


def _objects(
    scene: Scene, gaussians: Gaussians, groups: tuple[IntArray, IntArray], options: ExportOptions
) -> Iterator[PageObject]:
    ids, places = groups
    if ids[0] != 0:
        raise GagaError("A group has a number below 0. Associate the masks again.")
    colors = group_colors(ids, scene.colors)
    order = np.argsort(places, kind="stable")
    starts = np.searchsorted(places[order], np.arange(len(ids)))
    up = np.asarray(options.up, np.float64)
    listed = {int(group): k for k, group in enumerate(ids) if group}
    for k, rows in enumerate(np.split(order, starts[1:])):
        if k == 0:
            yield no_object(len(rows))
            continue
        means = gaussians.means[rows].astype(np.float64)
        means = means[np.isfinite(means).all(axis=1)]
        centre, radius = _ball(means, splat_reach(gaussians.take(rows)))
        thin = gaussians.take(rows[:: max(-(-len(rows) // MOST_DRAWN), 1)])
        view = object_view(centre, radius, options.page.cameras, up)
        picture = io.BytesIO()
        pixels = Image.fromarray(object_picture(thin, view, PICTURE))
        pixels.save(picture, "WEBP", quality=_QUALITY, method=4)
        r, g, b = (float(part) for part in colors[k])
        parent = listed.get(scene.folders.nearest(int(ids[k]), listed), 0)
        x, y, z = (float(part) for part in centre)
        yield PageObject(
            id=int(ids[k]),
            name=group_name(scene, int(ids[k])),
            color=(r, g, b),
            count=len(rows),
            centre=(x, y, z),
            radius=radius,
            picture=picture.getvalue(),
            folder="" if parent else scene.folders.places.get(int(ids[k]), ""),
            parent=parent,
            is_background=int(ids[k]) in options.page.background,
        )


def _ball(means: DoubleArray, least: float) -> tuple[DoubleArray, float]:
    """Mean (3,), and a radius: twice the root mean square distance from it, not more than the
    extent, but at least ``least``."""
    if len(means) == 0:
        return np.zeros(3), 1e-6
    centre = means.mean(axis=0)
    spread = 2.4 * float(np.sqrt(((means - centre) ** 2).sum(axis=1).mean()))
    extent = float(np.linalg.norm(means.max(axis=0) - means.min(axis=0))) / 2
    return centre, max(min(spread, extent), least, 1e-6)


def _start(options: ExportOptions, gaussians: Gaussians) -> tuple[Shot, float]:
    """The first view, and the radius of the scene: what is wished, else a bookmark, a photo."""
    row, radius = first_view(gaussians, options.up)
    page = options.page
    if page.start is not None:
        return page.start, radius
    if page.bookmarks:
        return page.bookmarks[0].shot, radius
    if page.cameras:
        # The first photo; it looks at what all cameras look at.
        camera, target = page.cameras[0], common_target(page.cameras)
        depth = radius if target is None else float((target - camera.position) @ camera.forward)
        return Shot.of_camera(camera, depth if depth > _NEAREST * radius else radius), radius
    eye, quat = row[:3], row[3:7]
    return Shot(tuple(eye), tuple(quat), row[7], row[8], row[9]), radius  # type: ignore[arg-type]


def _row(shot: Shot) -> ShotRow:
    return (*shot.eye, *shot.quat, shot.fov_x, shot.fov_y, shot.distance)
