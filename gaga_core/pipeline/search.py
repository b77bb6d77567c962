"""Asking a scene: by words, by an index of pictures, by a detector in a view.

The functions on a `Scene` serve the window live; those on a `Project` also know where its index
lies: ``index.npz`` (vectors and thumbnails) and ``index_texts.npz`` in the folder of our work.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.votes import splat_groups
from gaga_core.io.images import read_rgb
from gaga_core.progress import Progress, Stage
from gaga_core.query.auto_names import name_by_nouns
from gaga_core.query.descriptions import describe_groups
from gaga_core.query.detector import DetectConfig, Detector, vote_boxes
from gaga_core.query.embed import Embedder
from gaga_core.query.group_facts import GroupFacts, facts_of, group_digests, group_facts
from gaga_core.query.index import (
    GroupIndex,
    IndexedViews,
    TextVectors,
    index_stage,
    load_index,
    n_stale,
    relevancy,
    save_index,
)
from gaga_core.query.search import Answer, NounScorer, search_words
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.edits.placement import as_it_came
from gaga_core.scene.objects import object_table
from gaga_core.scene.project import Project
from gaga_core.scene.scene import Scene, State

INDEX_FILE = "index.npz"
TEXTS_FILE = "index_texts.npz"
MAX_VIEWS = 64  # views rendered for an index, spread evenly
LONGEST_SIDE = 640  # pixels of such a view


@dataclass(frozen=True, eq=False)
class Pictures:
    """How an index knows texts: its groups, and the vectors of texts by the same model."""

    index: GroupIndex
    texts: TextVectors


def search(
    scene: Scene,
    text: str,
    *,
    cameras: Sequence[Camera] = (),
    camera: Camera | None = None,
    pictures: Pictures | None = None,
) -> Answer:
    """Groups of ``scene`` that ``text`` means, ranked (`query.words.search_words`).

    ``cameras`` are the train views: they say which way is up and, without ``camera`` (what the
    person sees), from where left and right are meant. ``pictures`` resolve nouns that are in no
    name. What was measured of the groups is kept until the scene changes.
    """
    facts = facts_of(scene, cameras)
    look_up = None if pictures is None else noun_scorer(facts.ids, pictures)
    return search_words(
        text,
        facts,
        scene.names,
        described=scene.described,
        camera=camera,
        cameras=cameras,
        look_up=look_up,
    )


def search_stage(
    scene: Scene,
    text: str,
    *,
    cameras: Sequence[Camera] = (),
    camera: Camera | None = None,
    pictures: Pictures | None = None,
) -> Stage[Answer]:
    """`search` as a stage: what comes before the first answer (loading a model) takes a while."""
    yield Progress("Search", 0, 1, text)
    return search(scene, text, cameras=cameras, camera=camera, pictures=pictures)


def noun_scorer(ids: IntArray, pictures: Pictures) -> NounScorer:
    """Scores (G,) of the groups ``ids`` for a noun, by the index; groups not in it score 0."""
    index, texts = pictures.index, pictures.texts
    at = np.searchsorted(index.groups, ids)
    at = np.minimum(at, max(len(index) - 1, 0))
    known = np.zeros(len(ids), np.bool_) if len(index) == 0 else index.groups[at] == ids

    def score(noun: str) -> DoubleArray | None:
        if not known.any():
            return None
        found = relevancy(index, texts.nouns([noun])[0], texts.anything())
        return np.where(known, found[at], 0.0)

    return score


def find_in_view(
    scene: Scene,
    views: Sequence[Camera],
    text: str,
    detector: Detector,
    *,
    rasterizer: Rasterizer | None = None,
) -> Stage[Answer]:
    """Groups whose picture in ``views`` (one, as a rule) the detector's boxes of ``text`` mean.

    Several views vote, weighted by the detector's scores.
    """
    if not views:
        raise ValueError("views: expected at least one camera")
    engine, config = rasterizer or choose(), DetectConfig()
    gaussians, labels = yield from _shown(scene)
    votes = []
    n_boxes = 0
    for i, camera in enumerate(views):
        yield Progress("Find in view", i, len(views), camera.name)
        boxes = detector.detect(_rendered(engine, gaussians, camera), text, config)
        n_boxes += len(boxes)
        votes.append((splat_groups(engine, gaussians, camera, labels), boxes))
    found = vote_boxes(votes)
    where = views[0].name or "this view"
    where = where if len(views) == 1 else f"{len(views)} views"
    if n_boxes == 0:
        sentence = f"The detector finds no “{text}” in {where}."
    else:
        plural = "group" if len(found.groups) == 1 else "groups"
        sentence = f"{len(found.groups)} {plural} in the detector's boxes of “{text}” in {where}."
    meant = int((found.scores >= 0.5).sum())
    return Answer(found.groups, found.scores, sentence, n_meant=meant)


def index_scene(
    scene: Scene,
    cameras: Sequence[Camera],
    embedder: Embedder,
    *,
    previous: GroupIndex | None = None,
    photo_of: Callable[[Camera], UInt8Array] | None = None,
    rasterizer: Rasterizer | None = None,
) -> Stage[GroupIndex]:
    """Index all groups of ``scene`` that ``previous`` does not know.

    ``photo_of`` gives the photo (H, W, 3) of a (resized) camera; used as long as nothing was moved
    or recolored, else and by default the splats are rendered.
    """
    groups, digests = group_digests(scene)
    if len(groups) == 0:
        raise GagaError("There are no groups to index yet. Associate the masks first.")
    if not cameras:
        raise GagaError("An index needs the views of a scene folder. Open that instead of a .ply.")
    engine = rasterizer or choose()
    gaussians, labels = yield from _shown(scene)
    edited = bool(scene.placement.any()) or len(gaussians) != len(scene)
    photos = None if edited else photo_of

    def picture_of(camera: Camera) -> UInt8Array:
        return photos(camera) if photos else _rendered(engine, gaussians, camera)

    def labels_of(camera: Camera) -> IntArray:
        return splat_groups(engine, gaussians, camera, labels)

    seen = [camera.at_most(LONGEST_SIDE) for camera in _spread(cameras, MAX_VIEWS)]
    views = IndexedViews(seen, labels_of, picture_of)
    stage = index_stage(groups, digests, views, embedder, previous=previous)
    return (yield from stage)


def refresh_index(project: Project, embedder: Embedder) -> Stage[GroupIndex]:
    """`index_scene` for a project, kept in its folder; only what changed is indexed again.

    A damaged index is built again. The file is replaced at the end: cancelling keeps the last one.
    """
    path = work_of(project) / INDEX_FILE
    try:
        previous = load_index(path)
    except GagaError:
        previous = None
    folder = project.folder
    cameras = train_views(project)

    def photo_of(camera: Camera) -> UInt8Array:
        assert folder is not None
        picture = Image.fromarray(read_rgb(folder.require_image(camera.name)))
        return np.asarray(picture.resize((camera.width, camera.height), Image.Resampling.BICUBIC))

    have = folder is not None and all(camera.name in folder.image_paths for camera in cameras)
    index = yield from index_scene(
        project.scene,
        cameras,
        embedder,
        previous=previous,
        photo_of=photo_of if have else None,
    )
    save_index(path, index)
    return index


def pictures_of(project: Project, load: Callable[[], Embedder]) -> Pictures | None:
    """The index that a project has, with texts by ``load``'s model; None when there is none.

    ``load`` is called when a text is new to the index, so that known texts need no model.
    """
    work = work_of(project)
    index = load_index(work / INDEX_FILE)
    if index is None:
        return None
    texts = TextVectors(index.model, load, work / TEXTS_FILE, index.vectors.shape[1])
    return Pictures(index, texts)


def stale_groups(scene: Scene, index: GroupIndex | None) -> int:
    """How many groups of ``scene`` an index does not know as they are now."""
    return n_stale(index, group_digests(scene)[1])


def suggested_names(scene: Scene, pictures: Pictures) -> dict[int, str]:
    """Names for the groups without one that the index is sure of; see `query.names`."""
    found = name_by_nouns(pictures.index, pictures.texts, taken=scene.names)
    live = set(np.unique(scene.labels).tolist())
    return {group: name for group, name in found.items() if group in live}


def train_views(project: Project) -> tuple[Camera, ...]:
    """The train views of a project's folder, all when none are set apart; () for a lone .ply."""
    folder = project.placed_folder
    if folder is None:
        return ()
    wanted = set(folder.train)
    return tuple(c for c in folder.cameras if not wanted or c.name in wanted)


def work_of(project: Project) -> Path:
    """Path of a project's index."""
    return project.saves_to


def _shown(scene: Scene) -> Stage[tuple[Gaussians, IntArray]]:
    """Visible splats as they stand, and their groups."""
    visible = np.flatnonzero(scene.visible)
    gaussians = yield from bake_stage(scene, indices=visible)
    return gaussians, scene.labels[visible]


def _rendered(engine: Rasterizer, gaussians: Gaussians, camera: Camera) -> UInt8Array:
    image: FloatArray = np.clip(engine.render(gaussians, camera).image, 0, 1)
    return np.rint(image * 255).astype(np.uint8)


def _spread(cameras: Sequence[Camera], n: int) -> list[Camera]:
    """At most ``n`` of ``cameras``, evenly spaced in their order."""
    if len(cameras) <= n:
        return list(cameras)
    return [cameras[i] for i in np.linspace(0, len(cameras) - 1, n).round().astype(int)]


# --- Words for the unnamed groups of a scene, and which of them are background.


_FLAT, _SUPPORT = 0.2, 5.0  # a flat group this many times the median size carries or surrounds


@dataclass(frozen=True)
class Description:
    """Findings about the groups of a scene."""

    words: Mapping[int, str]  # by group, of those without a name
    background: frozenset[int]  # groups that are what objects stand on, hang on, or lie before


def describe(
    scene: Scene,
    facts: GroupFacts,
    cameras: Sequence[Camera] = (),
    kept: Mapping[int, str] | None = None,
) -> Description:
    """Describe the groups of ``scene`` by ``facts`` that were measured of it.

    See `query.descriptions`. Background are what the facts call so, what the association found to
    surround the scene, and large flat groups: a bottle that a person makes large and moves to the
    wall is no wall, and stays what it is when the wall is deleted, so all is told from the scene as
    its files came.
    """
    now, home = facts, _before_edits(scene)
    if home is not scene:
        came = group_facts(home, cameras)
        facts = came if np.isin(now.ids, came.ids).all() else now
    objects = ~facts.background
    median = float(np.median(facts.size[objects])) if objects.any() else 0.0
    flat = facts.extents[:, 2] < _FLAT * facts.extents[:, 0]
    behind = facts.background | (flat & (facts.size > _SUPPORT * median) & (median > 0))
    levels = None if scene.bank is None else scene.bank.levels
    if levels is not None and levels.background:
        behind = behind | (facts.ids == levels.background)
    said = home if facts is not now else scene, replace(facts, background=behind)
    return Description(
        describe_groups(scene, now, cameras, kept, said),
        frozenset(facts.ids[behind & (facts.ids > 0) & np.isin(facts.ids, now.ids)].tolist()),
    )


def _before_edits(scene: Scene) -> Scene:
    """``scene`` as its files came, with the groups that are deleted whole; itself if it is so."""
    home, deleted = as_it_came(scene), scene.has(State.DELETED)
    n_live = np.bincount(scene.labels[~deleted], minlength=int(scene.labels.max(initial=0)) + 1)
    back = deleted & (scene.labels > 0) & (n_live[scene.labels] == 0)
    if not back.any():
        return home
    state = np.where(back, scene.state & ~np.uint8(State.DELETED), scene.state)
    return replace(home, state=state)


def describe_project(project: Project) -> Description:
    """Describe the groups of ``project``; its scene calls them so from then on."""
    cameras = train_views(project)
    scene = project.scene
    found = describe(scene, facts_of(scene, cameras), cameras, kept=scene.described)
    scene.described = dict(found.words)
    return found


def list_objects(project: Project) -> list[dict[str, object]]:
    """Plain values of each group.

    Id, name, is it a person's, splats, folder, the listed group that it lies under (0 = none), and
    whether it is background.
    """
    if not (project.scene.labels > 0).any():
        return []
    found, table = describe_project(project), object_table(project.scene)
    order, listed = project.scene.folders, frozenset(table.ids.tolist())
    return [
        {
            "group": int(group),
            "name": name,
            "named": int(group) in project.scene.names,
            "splats": int(count),
            "folder": order.places.get(int(group), ""),
            "parent": order.nearest(int(group), listed),
            "background": int(group) in found.background,
        }
        for group, name, count in zip(table.ids, table.names, table.counts, strict=True)
        if group > 0
    ]
