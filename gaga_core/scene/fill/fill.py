"""Find what a removed object hid, and make the splats and colors that fill it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.edits.values import joined
from gaga_core.scene.fill.config import FillConfig
from gaga_core.scene.fill.inpaint import Inpainter
from gaga_core.scene.fill.views import seen_stage
from gaga_core.scene.fill.work import Work
from gaga_core.scene.index_set import sorted_indices
from gaga_core.scene.objects import group_name
from gaga_core.scene.scene import Scene, State

_STAGE = "Fill the hole"
_VISIBLE = 1.02  # factor of a color from which on it is changed


@dataclass(frozen=True, eq=False)
class Filling:
    """What filling changes. Nothing is changed yet."""

    removed: LongArray  # (R,) rows of the object
    unseen: LongArray  # (U,) rows that no view ever saw and that the object hid
    splats: Gaussians  # (F,) new, world
    labels: IntArray  # (F,) their groups: those of the surfaces that they continue
    stained: LongArray  # (S,) rows to be lightened
    gains: FloatArray  # (S, 3) by these factors
    lighten: bool  # whether stains were looked for
    is_refused: bool  # a hole was found and left open: its filling hardly shows, or does harm
    model: str = ""  # name of the inpainting model's file; "" = colors continue the surroundings

    def __bool__(self) -> bool:
        return len(self.splats) > 0 or len(self.stained) > 0 or len(self.unseen) > 0


def fillable(scene: Scene) -> LongArray:
    """Splats (K,) whose place can be filled: the selected ones, else all that were deleted.

    Raises ``GagaError`` when there are none.
    """
    chosen = np.flatnonzero(scene.has(State.SELECTED))
    chosen = chosen if len(chosen) else np.flatnonzero(scene.has(State.DELETED))
    if len(chosen) == 0:
        raise GagaError("Nothing is selected, and nothing was deleted. Select an object first.")
    return chosen


def fill_title(scene: Scene, indices: AnyArray) -> str:
    """What the edit is called in the history."""
    if scene.has(State.DELETED)[indices].all():
        return "Fill what was deleted"
    groups = np.unique(scene.labels[indices])
    if len(groups) == 1 and groups[0]:
        return f"Delete and fill {group_name(scene, int(groups[0]))}"
    return "Delete and fill"


def fill_stage(
    scene: Scene,
    indices: AnyArray,
    cameras: Sequence[Camera],
    rasterizer: Rasterizer,
    config: FillConfig | None = None,
) -> Stage[Filling]:
    """Find what the splats ``indices`` (K,) hide from ``cameras``, and what would fill it.

    Deleted splats may be among them: what they left is filled. Locked ones that they hid stay.
    Without cameras that show the object, views from all around it are taken. Raises ``GagaError``
    when an inpainting model is asked for that cannot be used.
    """
    settings = FillConfig() if config is None else config
    if not settings.model:
        return (yield from _filled(scene, indices, cameras, rasterizer, settings, None))
    with Inpainter(Path(settings.model), settings.model_sha256) as model:
        yield from model.loaded_stage()
        return (yield from _filled(scene, indices, cameras, rasterizer, settings, model))


def _filled(
    scene: Scene,
    indices: AnyArray,
    cameras: Sequence[Camera],
    rasterizer: Rasterizer,
    settings: FillConfig,
    inpainter: Inpainter | None,
) -> Stage[Filling]:
    """`fill_stage`; ``inpainter`` colors what is filled, None: the surroundings do."""
    chosen = np.zeros(len(scene), np.bool_)
    chosen[sorted_indices(indices, len(scene))] = True
    # What has no place in space is never drawn: it hides nothing.
    is_there = np.isfinite(scene.gaussians.means).all(axis=1)
    rows = np.flatnonzero((scene.visible | chosen) & is_there)
    labels = scene.labels[rows]
    gaussians = yield from bake_stage(scene, indices=rows)
    is_object = chosen[rows]
    if not is_object.any():
        return _nothing(np.flatnonzero(chosen), gaussians, settings)
    made = _made(scene)[rows] & ~is_object
    seen = yield from seen_stage(gaussians, is_object, cameras, rasterizer, settings, made)
    work = Work(gaussians, labels, is_object, seen, rasterizer, settings)
    work.inpainter = inpainter
    work.locked |= (scene.state[rows] & np.uint8(State.LOCKED)) != 0
    parts = _apart(gaussians.means.astype(np.float64), is_object, labels, settings.reach)
    for i, part in enumerate(parts):
        yield Progress(_STAGE, i, len(parts))
        yield from work.fill(part)
    stained = np.flatnonzero((work.gain > _VISIBLE).any(axis=1) & ~work.dropped)
    splats = gaussians.take(np.zeros(0, np.int64))
    for piece in work.made:
        splats = joined(splats, piece)
    return Filling(
        removed=np.flatnonzero(chosen),
        unseen=rows[work.dropped],
        splats=splats,
        labels=np.concatenate([np.zeros(0, np.int32), *work.groups]),
        stained=rows[stained],
        gains=work.gain[stained].astype(np.float32),
        lighten=settings.lighten,
        is_refused=work.is_refused,
        model=inpainter.name if inpainter is not None and len(splats) else "",
    )


def _nothing(removed: LongArray, gaussians: Gaussians, config: FillConfig) -> Filling:
    """The removal alone, of rows (R,)."""
    none = np.zeros(0, np.int64)
    splats, labels = gaussians.take(none), np.zeros(0, np.int32)
    gain = np.zeros((0, 3), np.float32)
    return Filling(removed, none, splats, labels, none, gain, config.lighten, is_refused=False)


def _made(scene: Scene) -> BoolArray:
    """Splats (N,) of the scene that an edit made, an earlier filling for example."""
    result = np.zeros(len(scene), np.bool_)
    for item in scene.added:
        if item.is_made:
            result |= (scene.source >= item.first) & (scene.source < item.first + item.n)
    return result


def _apart(
    points: DoubleArray, is_object: BoolArray, labels: IntArray, reach: float
) -> list[BoolArray]:
    """The object's splats (N,) in parts that do not touch one another's surroundings."""
    boxes: list[tuple[DoubleArray, DoubleArray, BoolArray]] = []
    for label in np.unique(labels[is_object]):
        part = is_object & (labels == label)
        lo, hi = points[part].min(axis=0), points[part].max(axis=0)
        margin = reach * float((hi - lo).max())
        lo, hi = lo - margin, hi + margin
        while True:
            near = [k for k, box in enumerate(boxes) if ((box[0] < hi) & (lo < box[1])).all()]
            if not near:
                break
            for k in reversed(near):
                other = boxes.pop(k)
                lo, hi = np.minimum(lo, other[0]), np.maximum(hi, other[1])
                part = part | other[2]
        boxes.append((lo, hi, part))
    return [part for _, _, part in boxes]
