"""Labelled data of new views: the pictures of scenes, made again only where they are stale.

A picture's record says what it was made of. A run that was ended goes on where it was, and a scene
whose objects were renamed, merged or split has only those pictures made again that show them.
"""

import hashlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import msgspec
import numpy as np
from PIL import Image

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.color import rgb_from_dc
from gaga_core.errors import GagaError, counted
from gaga_core.export.dataset.arrange import Arrangement, Hole, Item, Room, composed, items_of
from gaga_core.export.dataset.formats import (
    DATASET_FILE,
    SceneObject,
    SceneSet,
    Source,
    is_model_of,
    model_box,
    read_dataset_file,
    tables,
    write_forms_stage,
    write_model,
    write_tables,
)
from gaga_core.export.dataset.page import PAGE, write_page_stage
from gaga_core.export.dataset.records import (
    RECORD_VERSION,
    SPLITS,
    Record,
    Split,
    depth_scale,
    object_poses,
    read_record,
    shown_objects,
    write_picture,
)
from gaga_core.export.dataset.records import draw as draw_picture
from gaga_core.export.dataset.settings import (
    FORMS,
    MOST_PHOTOS,
    DatasetConfig,
    Form,
    planned,
    validates,
    varies,
)
from gaga_core.export.dataset.views import (
    ALIKE,
    CLOSER,
    TRIES,
    Photos,
    judged,
    lens,
    number_of,
    photos_stage,
    proposal,
    rng_of,
)
from gaga_core.export.export import as_step, exported_indices
from gaga_core.export.solids import MeshConfig, proxy_mesh_stage
from gaga_core.fill.fill import fill_stage
from gaga_core.fill.surfaces import FillConfig
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write, safe_name
from gaga_core.io.folder.lock import lock_folder
from gaga_core.io.folder.staging import staging_folder
from gaga_core.io.images import read_rgb
from gaga_core.io.json_file import read_json
from gaga_core.io.meshes import TriangleMesh
from gaga_core.pipeline.executors import SceneTask, answers_of
from gaga_core.pipeline.search import describe_project
from gaga_core.pipeline.settings import EngineConfig
from gaga_core.progress import Progress, Stage, part, portion
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer, SpatialChunks
from gaga_core.raster.cpu.rasterizer import CpuRasterizer, Labelled
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.objects import group_name
from gaga_core.scene.orientation import up_of_moved
from gaga_core.scene.project import Project, open_path_stage
from gaga_core.scene.tint import Grade, grade_affine

_STAGE = "Make pictures"
# Shares of processor time, 12 pictures of the demo: of the pictures in all, and of the labels in
# what is written after them.
_PICTURES, _FORMS = 0.96, 0.7
_AS_IT_IS = "as-it-is"  # placement of the scene without changes
_NOTHING = "Photos do not cover any of these views. Lower --coverage, or take more photos."
_MODEL_VOXELS = 64  # of a model of BOP, along its longest side
_PICTURES_OF_MODEL = 2  # that take as long: 0.42 and 0.24 s of the processor in the demo
_PICTURES_OF_HOLE = 80  # that take as long as to fill one: 0.1 and 8.6 s of the processor
_EACH = 4e-7  # seconds of a picture of 640 x 480 on two cores, a splat: in the demo
_TOUCHED = 2  # objects that are elsewhere or gone in a placement, about
_AHEAD = 2  # pictures that wait to be written while the next one is drawn
_FILL_VIEWS = 24  # photos that a hole is judged by
_CLEAR = 0.05  # alpha of a pixel that shows the background alone
# Of another light: gain, saturation, brightness and color temperature as photo editors have them.
_GAIN, _SATURATION, _BRIGHTER, _WARMER = (0.7, 1.25), (0.75, 1.2), 0.06, 0.5
_EMPTY = 0.02  # share of a photo without splats from which on its color there is the background's


@dataclass(frozen=True, eq=False)
class _Base:
    """A scene as it is, and all that its pictures are drawn from."""

    name: str
    project: Project
    gaussians: Gaussians
    labels: IntArray  # (N,)
    shown: IntArray  # (N,) their rows in the scene
    cameras: tuple[Camera, ...]
    items: tuple[Item, ...]
    digests: Mapping[int, str]  # by group, background too
    room: Room
    photos: Photos
    background: FloatArray  # (3,)
    content: str  # digest of the splats

    @property
    def objects(self) -> IntArray:
        """Groups (G,) that are objects, ascending."""
        return np.array([item.group for item in self.items], np.int32)


@dataclass(frozen=True, eq=False)
class DatasetReport:
    """The written data set."""

    folder: Path
    pictures: int
    made: int  # in this run
    kept: int  # of earlier runs, not stale
    left_out: int  # views that photos do not cover
    classes: int
    objects: int
    by_split: Mapping[str, int]
    notes: tuple[str, ...]
    failed: tuple[str, ...] = ()  # scenes, with why

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        plain = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return plain | {
            **{"folder": str(self.folder), "page": str(self.folder / PAGE)},
            **{"by_split": dict(self.by_split), "notes": list(self.notes)},
            "failed": list(self.failed),
        }


def usual_seconds(
    config: DatasetConfig, forms: Sequence[Form], n_splats: int, n_objects: int
) -> float:
    """Seconds that a new data set of one scene usually takes on two cores."""
    n_pictures = config.views * config.width * config.height / (640 * 480)
    if config.fill:
        n_pictures += _PICTURES_OF_HOLE * min(_TOUCHED * (planned(config)[0] - 1), n_objects)
    if "bop" in forms:
        n_pictures += _PICTURES_OF_MODEL * n_objects
    return _EACH * n_splats * n_pictures


def dataset_stage(
    scenes: Sequence[Path | Project],
    out: Path,
    config: DatasetConfig | None = None,
    forms: Sequence[Form] = FORMS,
    engine: EngineConfig | None = None,
    *,
    rasterizer: Rasterizer | None = None,
) -> Stage[DatasetReport]:
    """Make the data set of ``scenes`` in ``out``, or complete the one that is there.

    images, ids and depth / <split> / <name>, records/<name>.json, dataset.json, index.html and the
    files of ``forms``. Scenes of earlier runs stay in it. ``engine``: whose workers make the
    pictures of many scenes that lie in paths; None: one scene after the other, here. A scene that
    fails there does not stop the others. Raises ``GagaError`` for a folder that holds other things,
    and for a scene without photos' cameras or without objects.
    """
    config, failed = config or DatasetConfig(), tuple[str, ...]()
    with _opened(out):
        paths = [_path_of(scene) for scene in scenes]
        names = scene_names(out, paths)
        if engine is None:
            n = len(scenes)
            for i, (scene, name) in enumerate(zip(scenes, names, strict=True)):
                stage = pictures_stage(scene, out, name, config, forms, rasterizer=rasterizer)
                stage = part(stage, i, n, _STAGE, prefix=f"{name}: ")
                yield from portion(stage, 0, _PICTURES, _STAGE)
        else:
            by_path = dict(zip(paths, names, strict=True))
            work = PicturesWork(out.absolute(), by_path, config, tuple(forms))
            answers = _by_workers(paths, names, work, engine)
            failed = yield from portion(answers, 0, _PICTURES, _STAGE)
        rest = _tables_stage(out, config, forms, names, failed)
        return (yield from portion(rest, _PICTURES, 1, _STAGE))


@dataclass(frozen=True)
class PicturesWork:
    """The pictures of each scene of a data set, as executors run it."""

    out: Path
    names: Mapping[Path, str]  # of scenes by path
    config: DatasetConfig
    forms: tuple[Form, ...] = FORMS

    def stage_of(self, folder: Path, photos: Path | None) -> Stage[tuple[str, ...]]:
        """`pictures_stage` of one of the scenes."""
        del photos
        yield from pictures_stage(folder, self.out, self.names[folder], self.config, self.forms)
        return ("pictures",)


def _by_workers(
    paths: Sequence[Path], names: Sequence[str], work: PicturesWork, engine: EngineConfig
) -> Stage[tuple[str, ...]]:
    """Run ``work`` on an engine; a sentence on each scene that failed."""
    tasks = [SceneTask(name, path) for name, path in zip(names, paths, strict=True)]
    failed, done = list[str](), 0
    with (
        staging_folder(work.out) as starts,
        closing(answers_of(tasks, work, engine, starts)) as answers,
    ):
        yield Progress(_STAGE, 0, len(tasks), "start the workers")
        for outcome in answers:
            message = ""
            if outcome is not None:
                done += 1
                message = f"{outcome.scene}: {outcome.failed or 'complete'}"
                failed += [message] if outcome.failed else []
            yield Progress(_STAGE, done, len(tasks), message)
    return tuple(failed)


def scene_names(out: Path, paths: Sequence[Path]) -> tuple[str, ...]:
    """The name of each scene in the data set; the same one in every run."""
    known = {(out / name).resolve(): one for one in _scene_files(out) for name in [one.source]}
    by_source = {str(path): one.scene for path, one in known.items()}
    used, names = set(by_source.values()), list[str]()
    for path in paths:
        source = str(path.resolve())
        if source not in by_source:
            stem = safe_name(path.resolve().name.removesuffix(path.suffix) or "scene")
            name, n = stem, 1
            while name in used:
                n += 1
                name = f"{stem}-{n}"
            by_source[source] = name
            used.add(name)
        names.append(by_source[source])
    return tuple(names)


def _path_of(scene: Path | Project) -> Path:
    return scene.absolute() if isinstance(scene, Path) else scene.source


@contextmanager
def _opened(out: Path) -> Iterator[None]:
    """Hold the lock of a data set's folder; ``GagaError`` when it holds other things."""
    if out.exists() and not out.is_dir():
        raise GagaError(f"{out} is a file. Choose a folder for the data set.")
    is_ours = (out / DATASET_FILE).is_file()
    if out.is_dir() and not is_ours and any(path.name[0] != "." for path in out.iterdir()):
        raise GagaError(f"{out} holds other files. Choose an empty or a new folder.")
    with lock_folder(out):
        if not is_ours:  # a run that was ended is known by it
            write_tables(out, read_dataset_file(out))
        yield


def _scene_files(out: Path) -> list[SceneSet]:
    """What the data set says of each scene, by name."""
    cure = "Remove it, and run the command again."
    return [read_json(path, SceneSet, cure) for path in sorted((out / "scenes").glob("*.json"))]


# --- The pictures of one scene.


def pictures_stage(
    scene: Path | Project,
    out: Path,
    name: str,
    config: DatasetConfig,
    forms: Sequence[Form] = FORMS,
    *,
    rasterizer: Rasterizer | None = None,
) -> Stage[SceneSet]:
    """Make the pictures of one scene that are missing or stale, and write scenes/<name>.json.

    BOP alone has models of the objects, so only where it is one of ``forms`` they are made.
    """
    # One share for all: pictures and holes, then models, by how many pictures take as long.
    begin = Progress(_STAGE, 0, config.views, "photos")
    project = scene
    if isinstance(project, Path):
        project = yield from as_step(begin, open_path_stage(project))
    engine = rasterizer or choose()
    base = yield from as_step(begin, _base_stage(project, name, engine))
    n_models = len(base.items) if "bop" in forms else 0
    arrangements = list[Arrangement]()
    for index in range(-(-config.views // config.views_each)):
        yield begin
        moves, removes = varies(config, index)
        arrangements.append(base.room.arranged(config.seed, index, moves=moves, removes=removes))
    touched = {group for one in arrangements for group in one.touched} if config.fill else set()
    filled = config.views + _PICTURES_OF_HOLE * len(touched)
    total = filled + _PICTURES_OF_MODEL * n_models
    holes: dict[int, Hole] = {}
    passed = set[int]()  # groups whose holes are filled, or were not needed
    splits: dict[str, Split] = {_AS_IT_IS: "train"}
    names, left_out, made = list[str](), 0, 0
    with _Writer() as writer:
        for index, arrangement in enumerate(arrangements):
            series = _Series(base, arrangement, index, config, splits)
            first = index * config.views_each
            painter: _Painter | None = None
            for k in range(min(config.views_each, config.views - first)):
                view = series.name(k)
                done = first + k + _PICTURES_OF_HOLE * len(passed)
                yield (step := Progress(_STAGE, done, total, view))
                record = series.fresh(out, k)
                if record is None:
                    if painter is None:
                        groups = arrangement.touched if config.fill else ()
                        yield from _holes_stage(base, groups, engine, holes, passed, step)
                        painter = _Painter(series, holes)
                    record, drawn = painter.picture(k)
                    made += not record.is_left_out
                    writer.put(partial(_finished, out, record, drawn, series.poses))
                left_out += record.is_left_out
                names += [] if record.is_left_out else [view]
                passed |= touched.intersection(arrangement.touched)
    if n_models:
        yield from _models_stage(out, base, total)
    yield Progress(_STAGE, total, total)
    return _write_scene(out, base, names, (made, left_out), is_varied=len(splits) > 1)


def _base_stage(project: Project, name: str, engine: Rasterizer) -> Stage[_Base]:
    """Bake the scene and look at its objects, their supports and its photos."""
    folder, scene = project.placed_folder, project.scene
    if folder is None or project.folder is None or not folder.cameras:
        raise GagaError(
            f"{name} has no photos: their cameras say where new views may stand. Name a scene "
            "folder instead of a file of splats."
        )
    shown = exported_indices(scene)
    behind = describe_project(project).background
    groups = np.setdiff1d(scene.labels[shown], [0, *behind]).astype(np.int32)
    if len(groups) == 0:
        raise GagaError(f"{name} has no visible objects to label. Find objects first.")
    gaussians = yield from bake_stage(scene, indices=shown)
    labels, cameras = scene.labels[shown], project.training_views
    items = items_of(gaussians, labels, groups)
    every = items_of(gaussians, labels, np.unique(labels).astype(np.int32), least=1)
    kinds = {item.group for item in items}
    digests = {item.group: f"{item.digest}{'' if item.group in kinds else 'b'}" for item in every}
    up = up_of_moved(project.folder.cameras, folder.cameras)
    views = cameras[:: max(1, len(cameras) // MOST_PHOTOS)]
    photos = yield from photos_stage(gaussians, views, up, engine)
    return _Base(
        name=name,
        project=project,
        gaussians=gaussians,
        labels=labels,
        shown=shown,
        cameras=cameras,
        items=items,
        digests=digests,
        room=Room.of(gaussians, labels, items, up),
        photos=photos,
        background=_background(project, photos),
        content=_content(gaussians),
    )


def _content(gaussians: Gaussians) -> str:
    digest = hashlib.blake2b(digest_size=16)
    for column in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        digest.update(np.ascontiguousarray(getattr(gaussians, column)).data)
    return digest.hexdigest()


def _background(project: Project, photos: Photos) -> FloatArray:
    """Mean color (3,) of the photos where there are no splats; black where there always are."""
    assert project.folder is not None
    total, n, n_all = np.zeros(3), 0, 0
    for camera, alpha in zip(photos.cameras, photos.alphas, strict=True):
        path = project.folder.image_paths.get(camera.name)
        n_all += alpha.size
        empty = alpha < _CLEAR
        if path is None or not empty.any():
            continue
        photo = Image.fromarray(read_rgb(path, max(camera.width, camera.height)))
        pixels = np.asarray(photo.resize((camera.width, camera.height)))[empty]
        total, n = total + pixels.sum(axis=0), n + len(pixels)
    if n < _EMPTY * n_all:
        return np.zeros(3, np.float32)
    return (total / (255 * n)).astype(np.float32)


@dataclass(frozen=True, eq=False)
class _Series:
    """The pictures of one arrangement of a scene."""

    base: _Base
    arrangement: Arrangement
    index: int
    config: DatasetConfig
    splits: dict[str, Split]  # of the placements so far: this one is added

    def __post_init__(self) -> None:
        is_kept = validates(self.config, len(self.splits) - 1)
        self.splits.setdefault(self.placement, "val" if is_kept else "train")

    @cached_property
    def placement(self) -> str:
        """Equal for all arrangements in which everything stands alike."""
        still = self.arrangement.is_as_it_is
        return _AS_IT_IS if still else self.arrangement.digest()

    @property
    def split(self) -> Split:
        """Which of the two all its pictures are for."""
        return self.splits[self.placement]

    def name(self, k: int) -> str:
        """Name of picture k."""
        return f"{self.base.name}-{self.index:04d}-{k:03d}"

    @cached_property
    def poses(self) -> dict[int, DoubleArray]:
        """world_from_object (4, 4) of all objects that are there."""
        there = [i for i in self.base.items if i.group not in self.arrangement.removed]
        return object_poses({i.group: i.centre for i in there}, self.arrangement.motions)

    @cached_property
    def _common(self) -> tuple[object, ...]:
        """What decides all of its pictures."""
        config, base = self.config, self.base
        touched = [(g, base.digests[g]) for g in self.arrangement.touched]
        # How a hole is filled depends on what all splats around it belong to.
        filled = sorted(base.digests.items()) if touched and config.fill else ()
        settings = (config.width, config.height, config.coverage, config.fill, config.seed)
        return (
            RECORD_VERSION,
            base.content,
            base.photos.digest,
            self.placement,
            self.split,
            touched,
            filled,
            settings,
        )

    def looks_at(self, k: int) -> tuple[DoubleArray, tuple[float, float]]:
        """The point (3,), world, that picture k looks at, and from how far of the photos' way."""
        own = self.config.seed, self.index, k
        if number_of(*own, "thing") % 1000 < 1000 * self.config.closer and self.poses:
            group = min(self.poses, key=lambda g: number_of(*own, g))
            return np.asarray(self.poses[group][:3, 3]), CLOSER
        points = self.base.photos.looked_at
        return np.asarray(points[number_of(*own) % len(points)]), ALIKE

    def light(self, k: int) -> DoubleArray:
        """The affine map (3, 4) of the colors of picture k."""
        rng = rng_of(self.config.seed, self.index, k, "light")
        if rng.random() >= self.config.lights:
            return np.eye(3, 4)
        tint = rng.uniform(*_GAIN) * np.ones(3)
        grade = Grade(
            tint=(float(tint[0]), float(tint[1]), float(tint[2])),
            temperature=float(rng.uniform(-_WARMER, _WARMER)),
            saturation=float(rng.uniform(*_SATURATION)),
            brightness=float(rng.uniform(-_BRIGHTER, _BRIGHTER)),
        )
        return grade_affine(grade)

    def key(self, k: int) -> str:
        """Digest of all that decides picture k but which splats the objects in it have."""
        target, closer = self.looks_at(k)
        view = np.round(target, 9).tolist(), closer
        own = (*self._common, view, self.light(k).tolist(), k)
        return hashlib.blake2b(repr(own).encode(), digest_size=16).hexdigest()

    def fresh(self, out: Path, k: int) -> Record | None:
        """The record of picture k of an earlier run; None where there is none or it is stale."""
        found = read_record(out, self.name(k))
        if found is None or found.key != self.key(k):
            return None
        now = self.base.digests
        is_same = all(now.get(int(group)) == was for group, was in found.digests.items())
        return found if is_same else None


class _Painter:
    """Draws the pictures of a series."""

    def __init__(self, series: _Series, holes: Mapping[int, Hole]) -> None:
        base, found = series.base, series.arrangement
        mine = [holes[group] for group in found.touched if group in holes]
        self.series = series
        self.gaussians, self.labels = composed(base.gaussians, base.labels, base.items, found, mine)
        self.engine = CpuRasterizer(SpatialChunks.of(self.gaussians))  # labels are drawn by it

    def picture(self, k: int) -> tuple[Record, Labelled | None]:
        """Picture k, or a record that says that photos do not cover any of its views."""
        series, base, config = self.series, self.series.base, self.series.config
        size = (config.width, config.height)
        K, drawn, share = lens(base.cameras, *size), None, 0.0
        rng, motions = rng_of(config.seed, series.index, k, "view"), series.arrangement.motions
        (target, closer), enough = series.looks_at(k), config.coverage * base.photos.usual
        for attempt in range(TRIES):
            camera = proposal(base.photos, K, size, target, rng, attempt, closer)
            drawn = self.draw(camera)
            share = judged(base.photos, camera, drawn, motions)
            if share >= enough:
                break
            drawn = None
        return self.recorded(k, camera, share, drawn), drawn

    def draw(self, camera: Camera) -> Labelled:
        """What a camera sees, with its labels."""
        base = self.series.base
        return draw_picture(
            self.engine, self.gaussians, camera, self.labels, base.objects, base.background
        )

    def recorded(self, k: int, camera: Camera, share: float, drawn: Labelled | None) -> Record:
        """The record of picture k, still without its objects; None: it is left out."""
        series, base = self.series, self.series.base
        digests: dict[str, str] = {}
        if drawn is not None:
            groups = np.flatnonzero(np.bincount(drawn.outlines.labels.ravel())).tolist()
            told = {*groups, *drawn.outlines.objects.tolist(), 0} & set(base.digests)
            digests = {str(group): base.digests[group] for group in sorted(told)}
        return Record(
            version=RECORD_VERSION,
            key=series.key(k),
            digests=digests,
            name=series.name(k),
            scene=base.name,
            placement=series.placement,
            split=series.split,
            width=camera.width,
            height=camera.height,
            K=camera.K.ravel().tolist(),
            cam_from_world=camera.cam_from_world.ravel().tolist(),
            depth_scale=1.0 if drawn is None else depth_scale(drawn),
            coverage=round(share, 4),
            light=series.light(k).ravel().tolist(),
            objects=[],
            is_left_out=drawn is None,
        )


def _finished(
    out: Path, record: Record, drawn: Labelled | None, poses: Mapping[int, DoubleArray]
) -> None:
    """Work out the labels of a drawn picture, and write it."""
    if drawn is not None:
        shown = shown_objects(drawn.outlines, poses, record.camera)
        record = msgspec.structs.replace(record, objects=shown)
    write_picture(out, record, drawn)


class _Writer:
    """Works out and writes pictures while the next ones are drawn; a few wait at most."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="gaga-write")
        self._waiting = deque[Future[None]]()

    def put(self, work: Callable[[], None]) -> None:
        """Do ``work`` soon; raises what went wrong with earlier work."""
        while len(self._waiting) >= _AHEAD:
            self._waiting.popleft().result()
        self._waiting.append(self._pool.submit(work))

    def __enter__(self) -> "_Writer":
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self._pool.shutdown(wait=True)
        while self._waiting and kind is None:
            self._waiting.popleft().result()


def _holes_stage(
    base: _Base,
    groups: Sequence[int],
    engine: Rasterizer,
    holes: dict[int, Hole],
    passed: set[int],
    step: Progress,
) -> Stage[None]:
    """Find what fills the places of ``groups``, that are gone or elsewhere, each once, as a part of
    ``step``, which counts those that ``passed``."""
    for group in groups:
        if group in holes:
            continue
        item = next(item for item in base.items if item.group == group)
        stage = fill_stage(
            base.project.scene,
            base.shown[item.splats],
            base.cameras,
            engine,
            FillConfig(most_views=_FILL_VIEWS),
        )
        width = 0 if group in passed else _PICTURES_OF_HOLE
        found = yield from as_step(step, stage, width)
        step = replace(step, done=step.done + width)
        rows = np.searchsorted(base.shown, found.unseen)
        stained = np.searchsorted(base.shown, found.stained)
        holes[group] = Hole(rows, found.splats, found.labels, stained, found.gains)


def _model_path(out: Path, base: _Base, item: Item) -> Path:
    return out / "models" / base.name / f"{item.group}.ply"


def _models_stage(out: Path, base: _Base, total: int) -> Stage[None]:
    """Write the closed surface of each object, in its frame; its splats' centres if it has none."""
    config, up = MeshConfig(_MODEL_VOXELS), base.room.upright[2]
    for k, item in enumerate(base.items):
        path = _model_path(out, base, item)
        note = f"{_MODEL_VOXELS} voxels of {base.content} {item.digest}"
        if is_model_of(path, note):
            continue
        name = group_name(base.project.scene, item.group)
        left = _PICTURES_OF_MODEL * (len(base.items) - k)
        step = Progress(_STAGE, total - left, total, name)
        yield step
        own = base.gaussians.take(item.splats)
        stage = proxy_mesh_stage(own, choose("cpu"), up=up, config=config, is_soft=True)
        try:
            mesh = yield from as_step(step, stage, _PICTURES_OF_MODEL)
        except GagaError:  # too few splats, or nearly transparent ones
            colors = np.rint(255 * np.clip(rgb_from_dc(own.sh[:, 0]), 0, 1)).astype(np.uint8)
            mesh = TriangleMesh(own.means, np.zeros((0, 3), np.int32), colors)
        write_model(path, mesh.moved(item.centre, 1.0), note)


def _box_of(out: Path, base: _Base, item: Item) -> tuple[DoubleArray, DoubleArray]:
    """Lowest and highest corner (3,) of an object's model, or of its splats, in its frame."""
    path = _model_path(out, base, item)
    if path.is_file():
        return model_box(path)
    points = base.gaussians.means[item.splats] - item.centre
    return points.min(axis=0), points.max(axis=0)


def _write_scene(
    out: Path, base: _Base, names: list[str], counts: tuple[int, int], *, is_varied: bool
) -> SceneSet:
    """Write scenes/<name>.json."""
    scene, objects = base.project.scene, []
    for item in base.items:
        lo, hi = _box_of(out, base, item)
        values = [list(map(float, v)) for v in (item.centre, lo, hi)]
        objects.append(SceneObject(item.group, group_name(scene, item.group), *values))
    notes = []
    if not base.room.supports:
        notes.append(f"{base.name}: no object stands on a plane, so all stay where they are.")
    elif not is_varied:
        notes.append(f"{base.name}: one placement only, so none of it is for validation.")
    if not scene.frame.is_metric:
        notes.append(f"{base.name} has no scale: lengths are in its own units (Set scale).")
    made, left_out = counts
    if left_out:
        are = "which is" if left_out == 1 else "which are"
        views = counted(left_out, "view")
        notes.append(f"{base.name}: photos do not cover {views}, {are} left out.")
    one = SceneSet(
        scene=base.name,
        source=str(_path_of(base.project).resolve()),
        is_metric=scene.frame.is_metric,
        names=names,
        made=made,
        left_out=left_out,
        objects=objects,
        notes=notes,
    )
    with atomic_write(out / "scenes" / f"{base.name}.json") as temporary:
        temporary.write_bytes(msgspec.json.encode(one))
    return one


# --- The tables of all scenes.


def _tables_stage(
    out: Path,
    config: DatasetConfig,
    forms: Sequence[Form],
    now: Sequence[str],
    failed: tuple[str, ...],
) -> Stage[DatasetReport]:
    """Write dataset.json, the formats and the page; remove pictures that belong to no scene."""
    scenes = _scene_files(out)
    if not any(scene.names for scene in scenes):
        raise GagaError(" ".join(failed) or _NOTHING)
    source = Source(out, scenes, tables(read_dataset_file(out), scenes))
    _remove_others(out, {name for scene in scenes for name in scene.names})
    # First, so that ids stay even when the rest is cancelled.
    write_tables(out, source.tables)
    yield from portion(write_forms_stage(source, forms), 0, _FORMS, _STAGE)
    notes = tuple(note for scene in scenes for note in scene.notes)
    yield from portion(write_page_stage(source, notes), _FORMS, 1, _STAGE)
    by_split: dict[str, int] = dict.fromkeys(SPLITS, 0)
    for record in source.records():
        by_split[record.split] += 1
    names = [scene.scene for scene in scenes]
    made = sum(s.made for s in scenes if s.scene in now)
    settings: dict[str, object] = asdict(config)
    whole = msgspec.structs.replace(
        source.tables, pictures=dict(by_split), scenes=names, settings=settings
    )
    write_tables(out, whole)
    return DatasetReport(
        folder=out,
        pictures=len(source),
        made=made,
        kept=len(source) - made,
        left_out=sum(scene.left_out for scene in scenes),
        classes=len(whole.classes),
        objects=len(whole.objects),
        by_split=by_split,
        notes=notes,
        failed=failed,
    )


def _remove_others(out: Path, names: set[str]) -> None:
    """Remove files of pictures that no scene lists any more, or lists for the other split."""
    for kind in ("images", "ids", "depth"):
        for path in (out / kind).glob("*/*"):
            split = path.parent.name
            record = read_record(out, path.stem) if path.stem in names else None
            if path.suffix in (".jpg", ".png") and (record is None or record.split != split):
                path.unlink(missing_ok=True)
