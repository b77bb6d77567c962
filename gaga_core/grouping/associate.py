"""Mask association (section 3.2): inconsistent 2D masks of all views -> groups of Gaussians."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.gate import (
    GateConfig,
    ViewMasks,
    depth_bounds,
    gaussians_of_masks,
    open_bounds,
)
from gaga_core.grouping.memory_bank import MemoryBank, add_view, groups_of_masks, views_per_group
from gaga_core.grouping.robust.consensus import ConsensusConfig, consensus_stage, merged_masks
from gaga_core.grouping.robust.label_masks import decide_masks, fill_unseen, voting_labels
from gaga_core.grouping.robust.surface_points import DepthMaps
from gaga_core.grouping.robust.surface_refinement import SurfaceConfig, follow_surfaces
from gaga_core.grouping.views import load_labels, views_with_masks
from gaga_core.grouping.votes import HISTOGRAM_BYTES, Votes, associated_labels, vote_labels
from gaga_core.masks import MaskSet
from gaga_core.progress import Progress, Stage, part
from gaga_core.raster.base import Rasterizer

STAGE = "Associate masks"
PRESETS = ("paper", "robust")


@dataclass(frozen=True)
class AssociateConfig:
    """Settings of the association; the defaults are the paper's (section 3.2), to the letter."""

    preset: Literal["paper", "robust"] = "paper"  # where the other values come from
    threshold: float = 0.1  # least overlap #(G(m) and G_i) / #G(m) to join a group
    depth: Literal["expected", "median", "none"] = "expected"  # "none": ablation "all Gaussians"
    order: Literal["name", "coverage"] = "name"  # coverage: views with most Gaussians first
    gate: GateConfig = field(default_factory=GateConfig)
    consensus: ConsensusConfig | None = None  # groups by the views' consensus (beyond the paper)
    fill_unseen: bool = False  # hidden Gaussians take the gate's votes, then their neighbours'
    surfaces: SurfaceConfig | None = None  # ... or with few views what the surfaces say
    histogram_bytes: int = HISTOGRAM_BYTES  # memory for the vote of labels per Gaussian

    def __post_init__(self) -> None:
        if self.preset not in PRESETS:
            raise ValueError(f"preset: {self.preset!r} is none of {PRESETS}")
        if not 0 < self.threshold <= 1:
            raise ValueError(f"threshold: {self.threshold} is not in (0, 1]")
        if self.depth not in ("expected", "median", "none"):
            raise ValueError(f"depth: {self.depth!r} is none of 'expected', 'median', 'none'")
        if self.order not in ("name", "coverage"):
            raise ValueError(f"order: {self.order!r} is neither 'name' nor 'coverage'")
        if self.consensus is not None and self.depth == "none":
            raise ValueError("consensus: needs a depth, 'expected' or 'median'")
        if self.histogram_bytes < 1:
            raise ValueError("histogram_bytes: too small")

    def surfaces_of_few(self, n_views: int) -> SurfaceConfig | None:
        """How surfaces decide about labels of a scene with ``n_views``; None where masks do."""
        few = self.surfaces is not None and n_views <= self.surfaces.max_views
        return self.surfaces if few else None

    @staticmethod
    def of(preset: str) -> "AssociateConfig":
        """The settings of a preset by name."""
        if preset == "paper":
            return AssociateConfig()
        if preset == "robust":
            return AssociateConfig(
                preset="robust",
                depth="median",
                order="coverage",
                gate=GateConfig(iqr_floor=0.02, guard_near=True),
                consensus=ConsensusConfig(),
                fill_unseen=True,
                surfaces=SurfaceConfig(),
            )
        raise GagaError(f"There is no preset {preset!r}. Choose one of {', '.join(PRESETS)}.")


@dataclass(frozen=True, eq=False)
class BankSnapshot:
    """What a live observer sees after a view. The bank is a value of its own."""

    view: str
    bank: MemoryBank
    n_groups: int
    keeps_ids: bool = False  # groups are those of the bank that is being repaired


@dataclass(frozen=True, eq=False)
class Association:
    """Groups of a scene: who owns what, why, and what every mask became."""

    bank: MemoryBank
    labels: IntArray  # (N,) by vote; who no mask sees keeps the bank's group; 0 = none
    confidence: FloatArray  # (N,) share of the label in the vote; 0 where nothing was voted
    mask_groups: Mapping[str, IntArray]  # view name -> group of each mask id, 0 = none
    views_per_group: IntArray  # (G + 1,)
    notes: tuple[str, ...] = ()  # sentences for the user: masks that were resized, ...

    def to_json(self) -> dict[str, object]:
        """Figures for reports and machines."""
        return {
            "gaussians": len(self.labels),
            "labelled": int((self.labels > 0).sum()),
            "views": len(self.mask_groups),
            "masks": len(self.bank.log),
            "groups": self.bank.n_groups,
            "groups_with_gaussians": len(np.unique(self.labels[self.labels > 0])),
            "notes": list(self.notes),
        }


@dataclass(frozen=True, eq=False)
class _Task:
    """What all parts of an association read, and what they leave each other."""

    gaussians: Gaussians
    views: tuple[Camera, ...]  # with masks, by name
    masks: MaskSet
    rasterizer: Rasterizer
    config: AssociateConfig
    depths: DepthMaps  # of the views, filled as they are rendered
    bounds: dict[str, DoubleArray] = field(default_factory=dict)  # by view, once known
    resized: set[str] = field(default_factory=set)  # views whose masks did not fit


def associate_stage(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    masks: MaskSet,
    rasterizer: Rasterizer,
    config: AssociateConfig | None = None,
) -> Stage[Association]:
    """Associate the masks of ``cameras`` through the memory bank, then label every Gaussian.

    Preset "paper": views in the order of their names, the first one that has masks opens the bank.
    Each view costs one depth picture and one pass over the Gaussians; masks are loaded one view at
    a time. Labels come from a vote of the associated masks with blending weights. Preset "robust"
    adds what `AssociateConfig` says. The progress after a view carries a `BankSnapshot`.
    Raises ``GagaError`` when there is nothing to associate.
    """
    config = config or AssociateConfig()
    views = views_with_masks(cameras, masks)
    if len(gaussians) == 0:
        raise GagaError("The model holds no Gaussians. Choose another .ply file.")
    task = _Task(gaussians, views, masks, rasterizer, config, DepthMaps.for_views(views))
    n_parts = 2 + 3 * (config.consensus is not None) + (config.order == "coverage")
    n_parts += config.fill_unseen
    parts = iter(range(n_parts))
    order: Sequence[Camera] = views
    if config.order == "coverage":
        order = yield from part(_widest_first(task), next(parts), n_parts, STAGE)
    bank = yield from part(_fill_bank(task, order), next(parts), n_parts, STAGE)
    if config.consensus is None:
        votes = yield from part(_vote(task, bank), next(parts), n_parts, STAGE)
    else:
        stage = consensus_stage(views, partial(_view_masks, task), task.depths, config.consensus)
        tables = yield from part(stage, next(parts), n_parts, STAGE)
        points = dict(zip((camera.name for camera in views), tables, strict=True))
        ids = {camera.name: _view_masks(task, camera).ids for camera in views}
        bank = decide_masks(bank, points, ids)
        votes = yield from part(_consensus_vote(task, points), next(parts), n_parts, STAGE)
        split = next(parts)
        if any(len(merged_masks(table, config.consensus)) > 0 for table in tables):
            again = _consensus_vote(task, points, votes.labels)
            votes = yield from part(again, split, n_parts, STAGE)
    groups = groups_of_masks(bank, [camera.name for camera in views])
    labels = np.where(votes.labels > 0, votes.labels, np.maximum(bank.group, 0))
    if config.fill_unseen:
        hidden = _with_hidden(task, bank, groups, votes.labels)
        labels = yield from part(hidden, next(parts), n_parts, STAGE)
        bank = replace(bank, n_groups=max(bank.n_groups, int(labels.max(initial=0))))
    if config.consensus is not None:  # the votes say who owns what, not who came first
        bank = replace(bank, group=np.where(labels > 0, labels, np.int32(-1)))
    return Association(
        bank=bank,
        labels=labels,
        confidence=votes.confidence,
        mask_groups=groups,
        views_per_group=views_per_group(bank),
        notes=_notes(task, len(cameras)),
    )


def _widest_first(task: _Task) -> Stage[list[Camera]]:
    """The views by the number of Gaussians behind their masks, most first; fills the bounds."""
    coverage = {}
    for i, camera in enumerate(task.views):
        mask_of = _gaussians_of_view(task, camera)[1]
        coverage[camera.name] = int((mask_of > 0).sum())
        yield Progress(STAGE, i + 1, len(task.views), f"coverage of {camera.name}")
    return sorted(task.views, key=lambda camera: (-coverage[camera.name], camera.name))


def _fill_bank(task: _Task, order: Sequence[Camera]) -> Stage[MemoryBank]:
    """The memory bank after all views, taken in this order."""
    bank = MemoryBank.empty(len(task.gaussians))
    for i, camera in enumerate(order):
        masks, mask_of = _gaussians_of_view(task, camera)
        bank, _ = add_view(bank, camera.name, masks.ids, mask_of, task.config.threshold)
        snapshot = BankSnapshot(camera.name, bank, bank.n_groups)
        message = f"{camera.name}: {bank.n_groups} groups"
        yield Progress(STAGE, i + 1, len(order), message, snapshot)
    return bank


def _gaussians_of_view(task: _Task, camera: Camera) -> tuple[ViewMasks, IntArray]:
    """The masks of a view, and the mask (N,) that each Gaussian lies behind, 0 = none."""
    labels, resized = load_labels(task.masks, camera)
    if resized:
        task.resized.add(camera.name)
    masks = ViewMasks.of(labels)
    if camera.name not in task.bounds:
        task.bounds[camera.name] = _bounds(task, camera, masks)
    bounds = task.bounds[camera.name]
    return masks, gaussians_of_masks(task.gaussians.means, camera, masks, bounds)


def _bounds(task: _Task, camera: Camera, masks: ViewMasks) -> DoubleArray:
    """Accepted depths (M + 1, 2) of each mask, from the splatted depth map of the view."""
    config = task.config
    if config.depth == "none":
        return open_bounds(masks)
    # Only depth is wanted: one channel is cheaper than a color from spherical harmonics.
    channels = np.zeros((len(task.gaussians), 1), np.float32)
    frame = task.rasterizer.render(task.gaussians, camera, channels=channels)
    depth = frame.median_depth if config.depth == "median" else frame.expected_depth
    if config.consensus is not None:
        task.depths.add(camera.name, depth, frame.alpha, config.gate.alpha_min)
    return depth_bounds(masks, depth, frame.alpha, config.gate)


def _vote(task: _Task, bank: MemoryBank) -> Stage[Votes]:
    """Labels per Gaussian by vote of the associated masks."""
    groups = groups_of_masks(bank, [camera.name for camera in task.views])

    def label_map(camera: Camera) -> IntArray:
        return associated_labels(load_labels(task.masks, camera)[0], groups[camera.name])

    return vote_labels(
        task.gaussians,
        task.views,
        label_map,
        bank.n_groups,
        task.rasterizer,
        histogram_bytes=task.config.histogram_bytes,
    )


def _consensus_vote(
    task: _Task,
    tables: Mapping[str, LongArray],  # by view: (M + 1, G + 1) points of each group in each mask
    first: IntArray | None = None,  # (N,) labels by which merged masks are split; None = silent
) -> Stage[Votes]:
    """Labels per Gaussian by vote of the masks with their points' groups."""
    config = task.config.consensus or ConsensusConfig()

    def label_map(camera: Camera) -> IntArray:
        table, masks = tables[camera.name], _view_masks(task, camera)
        merged = merged_masks(table, config)
        shown = None
        if first is not None and len(merged) > 0:
            shown = task.rasterizer.label_splat(task.gaussians, camera, first).labels
        return voting_labels(masks, table, merged, shown)

    n_groups = next(iter(tables.values())).shape[1] - 1
    return vote_labels(
        task.gaussians,
        task.views,
        label_map,
        n_groups,
        task.rasterizer,
        histogram_bytes=task.config.histogram_bytes,
    )


def _with_hidden(
    task: _Task, bank: MemoryBank, groups: Mapping[str, IntArray], labels: IntArray
) -> Stage[IntArray]:
    """Labels (N,) in which Gaussians that no mask labels have one; of few views with new groups."""
    surfaces = task.config.surfaces_of_few(len(task.views))
    if surfaces is not None:
        by_shape = follow_surfaces(
            task.gaussians, task.views, task.masks, labels, task.rasterizer, surfaces
        )
        return (yield from by_shape)
    stage = fill_unseen(
        task.gaussians, task.views, task.masks, task.bounds, groups, bank.n_groups, labels
    )
    return (yield from stage)


def _view_masks(task: _Task, camera: Camera) -> ViewMasks:
    return ViewMasks.of(load_labels(task.masks, camera)[0])


def _notes(task: _Task, n_cameras: int) -> tuple[str, ...]:
    n_views, notes = len(task.views), []
    if n_views < n_cameras:
        notes.append(f"{n_cameras - n_views} of {n_cameras} views have no masks and took no part.")
    if task.resized:
        notes.append(
            f"The masks of {len(task.resized)} of {n_views} views had another size than the view; "
            "they were resized."
        )
    return tuple(notes)
