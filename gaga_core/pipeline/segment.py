"""2D masks of the views of a scene folder, by any provider: SCENE/masks/<provider>/<stem>.png.

Masks of photos in a subfolder of images/ lie in one of its name (`io.masks.view_key`).

Every finished view is written at once and recorded with a key of photo, model and settings, so a
second run, or one after a cancel, makes only what is missing. Maps of other settings are kept in
SCENE/gaga/cache/masks under the same keys and come back without work.
"""

import hashlib
import json
import shutil
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import label as connected

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError, counted
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write, explain_os_error
from gaga_core.io.folder.scene_folder import SceneFolder, read_model, select_views
from gaga_core.io.images import read_rgb
from gaga_core.io.json_file import read_json
from gaga_core.io.masks.label_maps import (
    RECORD,
    MaskRecord,
    label_files_of,
    read_labels,
    view_key,
    write_labels,
)
from gaga_core.masks import resize_labels
from gaga_core.pipeline.settings import SegmentConfig
from gaga_core.progress import Progress, Stage, part, portion
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer
from gaga_core.segmentation.base import ModelProvider, Picture, Provider, fingerprint_of
from gaga_core.segmentation.regions import RegionsProvider

# --- In which order photos are segmented: those that tell most first, so that a run may stop
# early.
# A photo tells what it shows and no photo before it has shown. Gaussians that it shows count in
# full the first time, half the second, a quarter the third: a greedy cover of the scene, several
# times over, since an object is found by the views that agree on it.


_MOST = 20_000  # Gaussians that are sampled
_CELLS = 64  # of the coarse depth picture along its width
_BEHIND = 1.08  # times the nearest depth of a cell: as far as that a Gaussian is seen
_LEAST_LOGIT = -0.85  # opacity 0.3: fainter ones hide nothing and are not counted
_FADE = 0.5  # what a Gaussian counts the next time


def coverage_order(gaussians: Gaussians, cameras: Sequence[Camera]) -> Stage[IntArray]:
    """Indices (V,) of ``cameras``, the photo that tells most first; of equals the first by index.

    Uses some of the Gaussians, evenly taken, and a coarse depth picture for what hides them: a
    guess that is good enough for an order. Frames: world for the Gaussians, as the cameras say.
    """
    opaque = np.flatnonzero(gaussians.logit_opacities > _LEAST_LOGIT)
    chosen = opaque[:: max(1, -(-len(opaque) // _MOST))]
    points = gaussians.means[chosen].astype(np.float64)
    sees = np.zeros((len(cameras), len(points)), np.bool_)
    for i, camera in enumerate(cameras):
        yield Progress("Order the photos", i, len(cameras), camera.name)
        sees[i] = visible(points, camera)
    return greedy_cover(sees)


def visible(points: DoubleArray, camera: Camera) -> BoolArray:
    """Which points (N, 3) world the photo shows (N,), by a coarse depth picture."""
    pixels, depth = camera.project(points)
    scale = _CELLS / camera.width
    rows = max(1, round(camera.height * scale))
    inside = (depth > 0) & (pixels >= 0).all(axis=1)
    inside &= (pixels[:, 0] < camera.width) & (pixels[:, 1] < camera.height)
    index = np.flatnonzero(inside)
    column = np.minimum((pixels[index, 0] * scale).astype(np.int64), _CELLS - 1)
    row = np.minimum((pixels[index, 1] * scale).astype(np.int64), rows - 1)
    cell = row * _CELLS + column
    nearest = np.full(rows * _CELLS, np.inf)
    np.minimum.at(nearest, cell, depth[index])
    shown = np.zeros(len(points), np.bool_)
    shown[index] = depth[index] <= _BEHIND * nearest[cell]
    return shown


def greedy_cover(sees: BoolArray) -> IntArray:
    """Order (V,) of the rows of ``sees`` (V, N): each adds most to those before it."""
    left = list(range(len(sees)))
    weight = np.ones(sees.shape[1], np.float32)
    order: list[int] = []
    while left:
        gains = sees[left] @ weight
        best = left.pop(int(np.argmax(gains)))
        order.append(best)
        weight[sees[best]] *= _FADE
    return np.array(order, np.int32)


STAGE = "Make masks"
_VERSION = 1
_WITH_LEVELS = 2  # of the keys of models' masks, since wholes and parts are written next to them
_BLOCK = 1 << 24  # bytes hashed between two steps
_FOREIGN = ""  # in place of the key of a map that was not made here


@dataclass(frozen=True)
class SegmentReport:
    """Result of a segmentation."""

    provider: str
    folder: Path  # of the label maps
    made: tuple[str, ...]  # views whose masks were computed
    kept: tuple[str, ...]  # views that had theirs, or got them back from the cache
    failed: dict[str, str] = field(default_factory=dict)  # view name -> why it has none
    n_masks: int = 0  # in all views
    seconds: float = 0.0
    left: tuple[str, ...] = ()  # views that were not begun when the time was up
    flat: tuple[str, ...] = ()  # of the kept ones, those made before wholes and parts were written
    foreign: tuple[str, ...] = ()  # views whose maps were not made here, and stay

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the user."""
        failed = tuple(f"No masks for {name}: {reason}" for name, reason in self.failed.items())
        if self.flat:
            text = f"The masks of {len(self.flat)} photos are from an earlier version and have no"
            failed += (f"{text} levels of detail. Only gaga masks --redo makes them again.",)
        if n := len(self.foreign):
            failed += (f"{counted(n, 'photo')} had masks that were not made here; they stay.",)
        if not self.left:
            return failed
        n_done = len(self.made) + len(self.kept)
        stopped = f"The time was up after {n_done} photos; {len(self.left)} have no masks yet."
        return (*failed, f"{stopped} Run the same command to continue.")

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        return {
            "provider": self.provider,
            "folder": str(self.folder),
            "views_made": len(self.made),
            "views_kept": len(self.kept),
            "views_failed": dict(self.failed),
            "views_left": len(self.left),
            "views_without_levels": len(self.flat),
            "views_not_made_here": len(self.foreign),
            "masks": self.n_masks,
            "seconds": round(self.seconds, 2),
        }


@dataclass(frozen=True)
class ViewDone:
    """Payload of the progress after a view: its label map is in its place."""

    folder: Path  # of the label maps
    view: str


@dataclass(eq=False)
class _Cues:
    """The scene's splats, read when the first view asks for its depth."""

    folder: SceneFolder
    rasterizer: Rasterizer | None
    model_id: str  # hash of the file; "" = no depth
    gaussians: Gaussians | None = None

    def depth(self, camera: Camera, width: int, height: int) -> Stage[FloatArray | None]:
        """Median depth (height, width) of the view, camera frame; None without splats."""
        if not self.model_id:
            return None
        gaussians = yield from self.splats()
        engine = self.rasterizer = self.rasterizer or choose()
        # Only depth is wanted: one channel is cheaper than a color from spherical harmonics.
        channels = np.zeros((len(gaussians), 1), np.float32)
        frame = engine.render(gaussians, camera.resized(width, height), channels=channels)
        return frame.median_depth

    def splats(self) -> Stage[Gaussians]:
        """The splats, read once."""
        if self.gaussians is None:
            self.gaussians = yield from read_model(self.folder)
        return self.gaussians


def segment_scene(
    folder: SceneFolder,
    provider: Provider,
    *,
    views: str | Sequence[str] = "train",
    name: str = "",
    redo: bool = False,
    config: SegmentConfig | None = None,
    rasterizer: Rasterizer | None = None,
) -> Stage[SegmentReport]:
    """Write a label map (uint16 PNG) of each of ``views`` (train, test, all, or names).

    ``name`` is the folder in SCENE/masks, the provider's own name by default; ``redo`` makes
    everything again. Photos that cannot be read are named in the report, the others are done.
    Label maps in the folder that were not made here stay as they are, and the others are made.
    A cancel keeps the finished views and never leaves half a file. Raises ``GagaError`` when no
    view could be done, or when all of them have maps that were not made here.
    """
    config = config or SegmentConfig()
    start = time.perf_counter()
    cameras = select_views(folder, views)
    target = folder.root / "masks" / (name or provider.name)
    record = _read_record(target, folder)
    cameras, foreign = _without_foreign(target, cameras, record)
    wants_depth = config.use_depth and "depth" in provider.cues and folder.model_path is not None
    cues = _Cues(folder, rasterizer, (yield from _model_id(folder)) if wants_depth else "")
    by_coverage = config.order == "coverage" or (config.order == "auto" and provider.card.source)
    if by_coverage and folder.model_path is not None:
        order = yield from portion(_by_coverage(cues, cameras), 0, 0, STAGE)
        cameras = tuple(cameras[i] for i in order)
    done = _Done()
    for i, camera in enumerate(cameras):
        if done.made and 0 < config.stop_after <= time.perf_counter() - start:
            break
        view = view_key(camera.name)
        yield Progress(STAGE, i, len(cameras), camera.name + done.time_left(len(cameras) - i))
        try:
            keys = _keys(folder, camera, provider, config, cues)
            path = target / f"{view}.png"
            cache, former = folder.work / "cache" / "masks", record.get(view, "")
            kept = (key for key in keys if not redo and _is_in_place(path, key, former, cache))
            if key := next(kept, ""):
                done.keep(camera.name, is_flat=key != keys[0])
            else:
                key, began = keys[0], time.perf_counter()
                stage = _label_maps(folder, camera, provider, config, cues)
                maps = yield from part(stage, i, len(cameras), STAGE, prefix=f"{camera.name}: ")
                write_labels(cache / f"{key}.png", *maps)
                _take(cache / f"{key}.png", path)
                done.make(camera.name, time.perf_counter() - began)
        except _PhotoError as error:
            done.failed[camera.name] = str(error)
            continue
        if record.get(view) != key:
            record[view] = key
            _write_record(target, provider, record, config)
        yield Progress(STAGE, i + 1, len(cameras), camera.name, ViewDone(target, camera.name))
    if not done.names:
        raise GagaError(next(iter(done.failed.values())))
    text = f"{len(done.made)} made, {len(done.kept)} kept"
    yield Progress(STAGE, len(cameras), len(cameras), text)
    return SegmentReport(
        provider.name,
        target,
        tuple(done.made),
        tuple(done.kept),
        done.failed,
        sum(
            int((np.bincount(read_labels(target / f"{view_key(name)}.png").ravel())[1:] > 0).sum())
            for name in done.names
        ),
        time.perf_counter() - start,
        tuple(c.name for c in cameras if c.name not in {*done.names, *done.failed}),
        tuple(done.flat),
        foreign,
    )


def _without_foreign(
    target: Path, cameras: Sequence[Camera], record: dict[str, str]
) -> tuple[tuple[Camera, ...], tuple[str, ...]]:
    """The cameras whose maps are made here, and the names of the others."""
    marked = [c.name for c in cameras if record.get(view_key(c.name)) == _FOREIGN]
    foreign = tuple(label_files_of(target, marked, record)) if marked else ()
    if foreign and len(foreign) == len(cameras):
        raise GagaError(
            f"{target} holds label maps that were not made here. "
            "Choose another name for the new ones, or move that folder away."
        )
    return tuple(c for c in cameras if c.name not in foreign), foreign


def _by_coverage(cues: _Cues, cameras: Sequence[Camera]) -> Stage[IntArray]:
    return (yield from coverage_order((yield from cues.splats()), cameras))


@dataclass
class _Done:
    """The views so far."""

    made: list[str] = field(default_factory=list)
    kept: list[str] = field(default_factory=list)
    flat: list[str] = field(default_factory=list)  # of those kept
    failed: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0  # of those that were made

    def keep(self, name: str, *, is_flat: bool) -> None:
        """A view had its masks; ``is_flat``: without levels of detail."""
        self.kept.append(name)
        if is_flat:
            self.flat.append(name)

    def make(self, name: str, seconds: float) -> None:
        """The masks of a view were made."""
        self.made.append(name)
        self.seconds += seconds

    @property
    def names(self) -> list[str]:
        """Those that have masks."""
        return [*self.made, *self.kept]

    def time_left(self, n_left: int) -> str:
        """ " · about 3 min left", once a view has shown how long one takes."""
        if not self.made:
            return ""
        left = self.seconds / len(self.made) * n_left
        return f" · about {left / 60:.0f} min left" if left >= 90 else f" · about {left:.0f} s left"


_HALF = 127  # level above which a mask of the foreground shows the object


class _PhotoError(GagaError):
    """A photo that is missing or damaged: its view goes without masks."""


def _label_maps(
    folder: SceneFolder,
    camera: Camera,
    provider: Provider,
    config: SegmentConfig,
    cues: _Cues,
) -> Stage[tuple[IntArray, Sequence[IntArray]]]:
    """Label map at the size of the photo, or at the longest side that is wanted; and those at other
    levels of detail, at the size of the work, where the provider has some."""
    try:
        image = read_rgb(folder.image_paths[camera.name], config.longest_side)
    except GagaError as error:
        raise _PhotoError(str(error)) from error
    height, width = image.shape[:2]
    if 0 < provider.work_width < width:
        work = (provider.work_width, max(1, round(height * provider.work_width / width)))
        image = np.array(Image.fromarray(image).resize(work, Image.Resampling.BOX))
    depth = yield from cues.depth(camera, image.shape[1], image.shape[0])
    further: Sequence[IntArray] = ()
    if isinstance(provider, RegionsProvider | ModelProvider):
        labels, *further = yield from provider.label_maps(Picture(image, depth))
    else:
        labels = yield from provider.label_map(Picture(image, depth))
    mask = folder.foreground.get(camera.name)
    if mask is not None and isinstance(provider, RegionsProvider):
        labels, *further = _before_background(mask, (labels, *further))
    return resize_labels(labels, width, height), further


def _before_background(mask: Path, maps: Sequence[IntArray]) -> list[IntArray]:
    """Regions without those of the background that training left out; at the coarsest level of
    detail they are the silhouettes of the objects before it."""
    height, width = maps[0].shape
    kept = resize_labels((read_rgb(mask)[..., 0] > _HALF).astype(np.int32), width, height)
    found = [np.where(kept > 0, labels, 0) for labels in maps]
    return [found[0], connected(kept)[0].astype(np.int32), *found[2:]]


def _keys(
    folder: SceneFolder,
    camera: Camera,
    provider: Provider,
    config: SegmentConfig,
    cues: _Cues,
) -> tuple[str, ...]:
    """Hash of all that a view's label map depends on; of a model also the one that it had before
    wholes and parts were written."""
    if camera.name not in folder.image_paths:
        raise _PhotoError(
            f"The photo {camera.name} is not in {folder.root / 'images'}. Put it back."
        )
    path = folder.image_paths[camera.name]
    try:
        photo = hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise _PhotoError(explain_os_error(error, path)) from error
    seen: list[object] = []
    mask = folder.foreground.get(camera.name)
    if mask is not None and isinstance(provider, RegionsProvider):
        seen = [hashlib.sha256(mask.read_bytes()).hexdigest()]
    if cues.model_id:
        pose = [camera.K.tolist(), camera.cam_from_world.tolist(), camera.width, camera.height]
        seen += [cues.model_id, pose]
    parts = (photo, provider.fingerprint(), config.longest_side, seen)
    first = fingerprint_of(_VERSION, *parts)
    if isinstance(provider, ModelProvider):
        return fingerprint_of(_WITH_LEVELS, *parts), first
    return (first,)


def _model_id(folder: SceneFolder) -> Stage[str]:
    """Hash of the file of splats."""
    path = folder.model_path
    if path is None:
        return ""
    digest = hashlib.sha256()
    try:
        with path.open("rb") as stream:
            while block := stream.read(_BLOCK):
                digest.update(block)
                yield Progress(STAGE, 0, 0, f"look at {path.name}")
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    return digest.hexdigest()


def _is_in_place(path: Path, key: str, recorded: str, cache: Path) -> bool:
    """Whether the map of ``key`` is in its place, put there from the cache if need be."""
    if recorded == key and path.is_file():
        return True  # also when it was edited by hand since
    cached = cache / f"{key}.png"
    if not cached.is_file():
        return False
    _take(cached, path)
    return True


def _take(cached: Path, path: Path) -> None:
    """Put a map of the cache into its place."""
    with atomic_write(path) as temporary:
        shutil.copyfile(cached, temporary)


def _read_record(target: Path, folder: SceneFolder) -> dict[str, str]:
    """Key of each view's map, by `view_key`; `_FOREIGN` for maps that were not made here."""
    path = target / RECORD
    try:
        return dict(read_json(path, MaskRecord, "").views)
    except GagaError:
        if path.is_file() or not target.is_dir():
            return {}  # damaged: every view is made, or comes from the cache
        names = [camera.name for camera in folder.cameras]
        return {view_key(name): _FOREIGN for name in label_files_of(target, names)}


def _write_record(
    target: Path, provider: Provider, views: dict[str, str], config: SegmentConfig
) -> None:
    content = {
        "version": _VERSION,
        "provider": provider.name,
        **asdict(provider.card),
        "fingerprint": provider.fingerprint(),
        "longest_side": config.longest_side,
        "use_depth": config.use_depth,
        "views": dict(sorted(views.items())),
    }
    with atomic_write(target / RECORD) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
