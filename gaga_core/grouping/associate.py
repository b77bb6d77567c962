"""Mask association (section 3.2): inconsistent 2D masks of all views -> groups of Gaussians."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal, get_args

import numpy as np

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.gate import GateConfig
from gaga_core.grouping.memory_bank import (
    MemoryBank,
    Preset,
    add_view,
    groups_of_masks,
    views_per_group,
)
from gaga_core.grouping.robust.consensus import ConsensusConfig, consensus_stage, merged_masks
from gaga_core.grouping.robust.label_masks import (
    decide_masks,
    divided_labels,
    fill_unseen,
    voting_labels,
)
from gaga_core.grouping.robust.surface_graph import SurfaceConfig, follow_surfaces
from gaga_core.grouping.robust.surface_points import DepthMaps, PointTables, point_tables
from gaga_core.grouping.surfaces.given import levels_around_stage
from gaga_core.grouping.surfaces.objects import HierarchyConfig, objects_stage
from gaga_core.grouping.views import (
    DepthKind,
    GatedViews,
    has_further,
    load_further,
    views_as_masked,
    vote_with_bank,
)
from gaga_core.grouping.votes import HISTOGRAM_BYTES, Votes, VoteSums
from gaga_core.masks import MaskSet
from gaga_core.progress import Progress, Stage, part
from gaga_core.raster import for_many_views
from gaga_core.raster.base import Rasterizer, SpatialChunks

STAGE = "Associate masks"
PRESETS: tuple[Preset, ...] = get_args(Preset)
Order = Literal["name", "string", "coverage"]


@dataclass(frozen=True)
class AssociateConfig:
    """Settings of the association; the defaults are the paper's (section 3.2)."""

    preset: Preset = "paper"  # where the other values come from
    threshold: float = 0.1  # least overlap to join a group (`memory_bank.overlap_of`)
    depth: DepthKind = "expected"  # of a pixel; "none" is the ablation "all Gaussians"
    order: Order = "name"  # by the numbers in names, or their characters; or widest views first
    gate: GateConfig = field(default_factory=GateConfig)
    consensus: ConsensusConfig | None = None  # groups by the views' consensus (beyond the paper)
    fill_unseen: bool = False  # hidden Gaussians take the gate's votes, then their neighbours'
    surfaces: SurfaceConfig | None = None  # ... or with few views what the surfaces say
    hierarchy: HierarchyConfig | None = None  # how regions that no model made become objects
    histogram_bytes: int = HISTOGRAM_BYTES  # memory for the vote of labels per Gaussian

    def __post_init__(self) -> None:
        if self.preset not in PRESETS:
            raise ValueError(f"preset: {self.preset!r} is none of {PRESETS}")
        if not 0 < self.threshold <= 1:
            raise ValueError(f"threshold: {self.threshold} is not in (0, 1]")
        if self.depth not in get_args(DepthKind):
            raise ValueError(f"depth: {self.depth!r} is none of {get_args(DepthKind)}")
        if self.order not in get_args(Order):
            raise ValueError(f"order: {self.order!r} is none of {get_args(Order)}")
        if self.consensus is not None and self.depth in ("none", "front"):
            raise ValueError("consensus: needs a depth, 'expected' or 'median'")
        if self.consensus is None and (self.fill_unseen or self.surfaces is not None):
            raise ValueError("fill_unseen and surfaces: need the consensus")
        if self.hierarchy is not None and self.depth != "median":
            raise ValueError("hierarchy: needs the depth 'median'")
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
        if preset == "released":
            return AssociateConfig(preset="released", depth="front", order="string")
        if preset == "robust":
            return AssociateConfig(
                preset="robust",
                depth="median",
                order="coverage",
                gate=GateConfig(iqr_floor=0.02, guard_near=True),
                consensus=ConsensusConfig(),
                fill_unseen=True,
                surfaces=SurfaceConfig(),
                hierarchy=HierarchyConfig(),
            )
        raise GagaError(f"There is no preset {preset!r}. Choose one of {', '.join(PRESETS)}.")

    def at_detail(self, detail: float | None) -> "AssociateConfig":
        """The same with another level of objects, 0 coarse .. 1 fine; None changes nothing.

        Raises ``GagaError`` when the preset has no levels or the number is no detail.
        """
        if detail is None:
            return self
        if self.hierarchy is None:
            raise GagaError(f"The preset {self.preset} has no levels of detail. Choose robust.")
        if not 0 <= detail <= 1:
            raise GagaError(f"The detail must be between 0 and 1, not {detail}.")
        return replace(self, hierarchy=replace(self.hierarchy, detail=detail))


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
    weight: FloatArray | None = None  # (N,) of all votes; None where surfaces decided

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


class _Task:
    """An association that runs: what all of its steps read."""

    def __init__(
        self, gated: GatedViews, rasterizer: Rasterizer, config: AssociateConfig, n_cameras: int
    ) -> None:
        self.gated = gated
        self.gaussians, self.views, self.masks = gated.gaussians, gated.views, gated.masks
        self.names = tuple(camera.name for camera in gated.views)
        self.rasterizer = rasterizer
        self.config = config
        self.n_cameras = n_cameras  # with masks or without
        keeps_depths = config.consensus is not None or config.hierarchy is not None
        self.depths = DepthMaps(gated.views) if keeps_depths else None


def associate_stage(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    masks: MaskSet,
    rasterizer: Rasterizer,
    config: AssociateConfig | None = None,
) -> Stage[Association]:
    """Associate the masks of ``cameras`` through the memory bank, then label every Gaussian.

    Preset "paper": views in the order of their names, the first one that has masks opens the bank.
    Each view costs one depth map and one pass over the Gaussians; masks are loaded one view at a
    time. Labels come from a vote of the associated masks with blending weights. Preset "released"
    follows the published code where it differs (docs/method.md lists where). Preset "robust"
    adds what `AssociateConfig` says. Where no model made the masks, it finds objects by their
    surfaces (`grouping.surfaces`), and the bank has levels of detail. The progress after a view
    carries a `BankSnapshot`.
    Raises ``GagaError`` when there is nothing to associate.
    """
    config = config or AssociateConfig()
    views = views_as_masked(cameras, masks, config.preset)
    if len(gaussians) == 0:
        raise GagaError("The model holds no Gaussians. Choose another .ply file.")
    chunks = SpatialChunks.of(gaussians)
    gated = GatedViews(gaussians, views, masks, config.gate, config.depth, chunks)
    task = _Task(gated, for_many_views(rasterizer, chunks), config, len(cameras))
    if masks.are_regions and config.hierarchy is not None and task.depths is not None:
        return (yield from _by_surfaces(task, config.hierarchy, task.depths))
    if config.consensus is None or task.depths is None:
        return (yield from _by_memory_bank(task))
    return (yield from _by_consensus(task, config.consensus, task.depths))


def _by_memory_bank(task: _Task) -> Stage[Association]:
    """The paper: the memory bank decides each mask once, view after view."""
    n_parts = 2 + (task.config.order == "coverage")
    # Section 3.2, "Gaussians of a mask" and "Memory bank": depth gate, then overlap, mask by mask.
    bank = yield from _first_bank(task, n_parts)
    # Fig. 2: every mask shows its group's id. Pixels vote for the Gaussians that they show; one
    # that no mask shows keeps the group that the bank has it in.
    vote = vote_with_bank(task.gated, bank, task.rasterizer, task.config.histogram_bytes)
    votes = yield from part(vote, n_parts - 1, n_parts, STAGE)
    labels = np.where(votes.labels > 0, votes.labels, np.maximum(bank.group, 0))
    return _association(task, bank, labels, votes.confidence, votes.weight)


def _by_consensus(task: _Task, consensus: ConsensusConfig, depths: DepthMaps) -> Stage[Association]:
    """Beyond the paper: all views decide together which group each mask belongs to.

    The memory bank is filled as in the paper, so that every mask has its decision in the log and a
    live observer sees groups from the first view on; then the consensus replaces the decisions.
    """
    hierarchy = task.config.hierarchy if has_further(task.masks, task.views) else None
    n_parts = 5 + (task.config.order == "coverage") + task.config.fill_unseen
    n_parts += hierarchy is not None
    parts = iter(range(1 + (task.config.order == "coverage"), n_parts))
    # 1. The paper's bank, the views with the widest coverage first.
    first_bank = yield from _first_bank(task, n_parts)
    # 2. Points on the surfaces are clustered by how many views show them in one mask; each mask
    #    takes the group of most of its points.
    stage = consensus_stage(task.views, task.gated.masks_of, depths, consensus)
    tables = yield from part(stage, next(parts), n_parts, STAGE)
    decided = _decided(task, first_bank, tables)
    del first_bank  # its log is as long as the new one
    # 3. Masks of one group vote for Gaussians.
    sums = VoteSums.empty(len(task.gaussians), tables.width - 1, task.config.histogram_bytes)
    vote = _vote_by_points(task, consensus, tables, sums)
    votes = yield from part(vote, next(parts), n_parts, STAGE)
    # 4. Masks that hold several groups vote, too, divided by the labels that there are now.
    divide = next(parts)
    if any(len(merged_masks(table, consensus)) > 0 for table in tables):
        again = _vote_by_points(task, consensus, tables, sums, votes.labels)
        votes = yield from part(again, divide, n_parts, STAGE)
    # 5. Gaussians that no mask labels: what the gate or the surfaces say of them.
    labels = votes.labels
    if task.config.fill_unseen:
        hidden = _with_hidden(task, decided, labels)
        labels = yield from part(hidden, next(parts), n_parts, STAGE)
    # The votes say who owns what, not who came first.
    bank = replace(
        decided,
        group=np.where(labels > 0, labels, np.int32(-1)),
        n_groups=max(decided.n_groups, int(labels.max(initial=0))),
    )
    # 6. What these groups consist of and are parts of, where masks contain each other.
    if hierarchy is not None:
        around = levels_around_stage(task.gated, bank, depths, hierarchy)
        bank = yield from part(around, n_parts - 1, n_parts, STAGE)
    labels = np.maximum(bank.group, 0)
    return _association(task, bank, labels, votes.confidence, votes.weight)


def _by_surfaces(task: _Task, config: HierarchyConfig, depths: DepthMaps) -> Stage[Association]:
    """Beyond the paper: regions that no model made and the shape of the surface decide together.

    The memory bank is filled first, as in `_by_consensus`; each mask then takes the group of most
    of the samples that it shows.
    """
    n_parts = 2 + (task.config.order == "coverage")
    first_bank = yield from _first_bank(task, n_parts)
    further = partial(load_further, task.masks)
    stage = objects_stage(task.gaussians, task.views, task.gated.masks_of, further, depths, config)
    found = yield from part(stage, n_parts - 1, n_parts, STAGE)
    levels = found.levels
    labels = levels.labels[levels.chosen]
    sizes = [len(task.gated.ids_of(camera)) for camera in task.views]
    decided = _decided(task, first_bank, point_tables(found.regions, found.groups, sizes))
    bank = replace(
        decided,
        group=np.where(labels > 0, labels, np.int32(-1)),
        n_groups=max(decided.n_groups, int(labels.max(initial=0))),
        levels=levels,
    )
    return _association(task, bank, labels, found.confidence)


def _association(
    task: _Task,
    bank: MemoryBank,
    labels: IntArray,
    confidence: FloatArray,
    weight: FloatArray | None = None,
) -> Association:
    hierarchy = task.config.hierarchy
    return Association(
        bank=bank,
        labels=labels,
        confidence=confidence,
        mask_groups=groups_of_masks(bank, task.names),
        views_per_group=views_per_group(bank),
        notes=task.gated.notes(
            task.n_cameras, wants_levels=hierarchy is not None and hierarchy.detail is not None
        ),
        weight=weight,
    )


# --- steps of both paths


def _first_bank(task: _Task, n_parts: int) -> Stage[MemoryBank]:
    """The paper's memory bank after all views, by name, or those with most Gaussians behind their
    masks first (which is part 0 of the progress)."""
    order, by_name = in_order(task.views, task.config), task.config.order != "coverage"
    if not by_name:
        order = yield from part(_widest_first(task), 0, n_parts, STAGE)
    bank = MemoryBank.empty(len(task.gaussians), task.config.preset)
    filled = fill_bank(
        task.gated, bank, order, task.rasterizer, task.config.threshold, STAGE, task.depths
    )
    return (yield from part(filled, 0 if by_name else 1, n_parts, STAGE))


def in_order(views: Sequence[Camera], config: AssociateConfig) -> tuple[Camera, ...]:
    """Views, which are in the order of the numbers in their names, as ``config`` orders names."""
    by_string = config.order == "string"
    return tuple(sorted(views, key=lambda camera: camera.name) if by_string else views)


def _widest_first(task: _Task) -> Stage[tuple[Camera, ...]]:
    coverage = {}
    for i, camera in enumerate(task.views):
        mask_of = task.gated.rendered(camera, task.rasterizer, task.depths)[1]
        coverage[camera.name] = int((mask_of > 0).sum())
        yield Progress(STAGE, i + 1, len(task.views), f"coverage of {camera.name}")
    return tuple(sorted(task.views, key=lambda camera: -coverage[camera.name]))


def fill_bank(
    gated: GatedViews,
    bank: MemoryBank,
    order: Sequence[Camera],
    rasterizer: Rasterizer,
    threshold: float,
    title: str,  # of the progress
    depths: DepthMaps | None = None,  # of views that are rendered are kept here
) -> Stage[MemoryBank]:
    """The memory bank after some more views in this order (section 3.2); each step carries a
    `BankSnapshot`."""
    for i, camera in enumerate(order):
        masks, mask_of = gated.rendered(camera, rasterizer, depths)
        bank, _ = add_view(bank, camera.name, masks.ids, mask_of, threshold)
        snapshot = BankSnapshot(camera.name, bank, bank.n_groups)
        yield Progress(title, i + 1, len(order), f"{camera.name}: {bank.n_groups} groups", snapshot)
    return bank


def _decided(task: _Task, bank: MemoryBank, tables: PointTables) -> MemoryBank:
    """The bank with each mask in the group of most of the points that it shows."""
    ids = [task.gated.ids_of(camera) for camera in task.views]
    return decide_masks(bank, task.names, tables, ids)


# --- steps of the consensus alone


def _vote_by_points(
    task: _Task,
    consensus: ConsensusConfig,
    tables: PointTables,  # points of each group in each mask
    sums: VoteSums,  # added to
    first: IntArray | None = None,  # (N,) labels by which merged masks are divided
) -> Stage[Votes]:
    """Labels per Gaussian by vote of the masks with their points' groups: at first of those with
    one group, then, with ``first``, of the merged ones too."""
    place = {name: v for v, name in enumerate(task.names)}

    def label_map(camera: Camera) -> IntArray:
        table, masks = tables[place[camera.name]], task.gated.masks_of(camera)
        merged = merged_masks(table, consensus)
        if first is None:
            return voting_labels(masks, table, merged)
        if len(merged) == 0:
            return np.zeros_like(masks.labels)
        shown = task.rasterizer.label_splat(task.gaussians, camera, first).labels
        return divided_labels(masks, table, merged, shown)

    yield from sums.add_stage(task.gaussians, task.views, label_map, task.rasterizer)
    return sums.votes()


def _with_hidden(task: _Task, bank: MemoryBank, labels: IntArray) -> Stage[IntArray]:
    """Labels (N,) in which Gaussians that no mask labels have one; of few views with new groups."""
    surfaces = task.config.surfaces_of_few(len(task.views))
    if surfaces is not None:
        return follow_surfaces(
            task.gaussians, task.views, task.masks, labels, task.rasterizer, surfaces
        )
    groups = groups_of_masks(bank, task.names)
    return fill_unseen(
        task.gaussians, task.views, task.masks, task.gated.bounds, groups, bank.n_groups, labels
    )
