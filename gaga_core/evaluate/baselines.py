"""Baselines of the paper's ablation that need no other network.

Each baseline gives every mask of every view a group, as the bank does; `label_gaussians` then
labels the Gaussians by the same vote for all, or `train_groups` trains identities in the same way
for all, so that only the association differs. ("All Gaussians" is the bank itself without the depth
gate: ``AssociateConfig(depth="none")``.)
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_matrix

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.gate import GateConfig, ViewMasks, depth_bounds, gaussians_of_masks
from gaga_core.grouping.views import load_labels, views_with_masks
from gaga_core.grouping.votes import LabelMap, associated_labels, vote_labels
from gaga_core.identity.field import Identity, IdentityField
from gaga_core.identity.rows import Batch, RowConfig, sample_rows, view_batches
from gaga_core.identity.train import PaperConfig, train_identity
from gaga_core.identity.training_step import (
    IdentityGradients,
    IdentityRates,
    Training,
    adam_step,
    batch_of_step,
    cross_entropy,
    start_from_zeros,
)
from gaga_core.masks import Loader, MaskSet
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer

if TYPE_CHECKING:
    from gaga_core.segmentation.video_tracks import Follow

# --- Panoptic Lifting's way to consistent labels: linear assignment inside the training.
# Masks of a view have ids of their own. In every step the masks of one view are assigned
# one-to-one to the classes of the layer so that their mean probability is greatest (Hungarian
# algorithm), and the cross-entropy is taken with these labels (Siddiqui et al., CVPR 2023, section
# 3.3). Nothing else ties the views to one another. The paper's ablation calls it linear
# assignment.


STAGE = "Linear assignment"


@dataclass(frozen=True)
class LiftingConfig:
    """Settings of the training; those of the paper's identity training where both have one."""

    iterations: int = 10_000
    slots: float = 2.0  # classes, x the masks of the view that has most
    rates: IdentityRates = field(default_factory=IdentityRates)
    rows: RowConfig = field(default_factory=RowConfig)

    def __post_init__(self) -> None:
        if self.iterations < 1 or self.slots < 1:
            raise ValueError("iterations, slots: must be at least 1")


def lift_by_assignment(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    label_map: LabelMap,  # ids of each view's own masks, 0 = none
    rasterizer: Rasterizer,
    config: LiftingConfig | None = None,
) -> Stage[Identity]:
    """Train encodings on masks whose ids do not agree between views.

    Labels are the argmax of the layer on each Gaussian's own encoding. Raises ``GagaError`` when no
    view has masks.
    """
    config = config or LiftingConfig()
    views = yield from sample_rows(gaussians, cameras, label_map, rasterizer, config.rows)
    batches = view_batches(views, len(gaussians))
    most = max(len(np.unique(batch.labels)) for batch in batches)
    training = start_from_zeros(len(gaussians), round(config.slots * most), config.rows.seed)
    gradients = IdentityGradients.zeros(training)
    for step in range(config.iterations):
        batch = batches[batch_of_step(step, len(batches), config.rows.seed)]
        matched = replace(batch, labels=assigned(training, batch))
        gradients.clear()
        fit = cross_entropy(training, matched, gradients)
        adam_step(training, gradients, config.rates)
        message = f"{100 * fit.accuracy:.1f} % of pixels right"
        yield Progress(STAGE, step + 1, config.iterations, message)
    found = training.field()
    labels, confidence = found.classify(found.encodings)
    return Identity(found, labels, confidence, "lifting")


def assigned(training: Training, batch: Batch) -> IntArray:
    """The class (P,) of each pixel's mask: masks and classes 1..K are paired one-to-one so that
    the sum of the masks' mean probabilities is greatest."""
    ids, place = np.unique(batch.labels, return_inverse=True)
    found = training.field()
    chance = found.probabilities(batch.rows.multiply(found.encodings))
    share = (1 / np.bincount(place)[place]).astype(np.float32)
    mean = csr_matrix((share, (place, np.arange(len(place)))), (len(ids), len(place)))
    of_mask: FloatArray = mean @ chance  # (M, K + 1) over each mask's pixels
    of_mask[:, 0] = -1.0  # class 0 is "none"
    if ids[0] == 0:  # trained as "none" where void takes part
        of_mask[0] = -1.0
        of_mask[0, 0] = 2.0
    rows, columns = linear_sum_assignment(of_mask, maximize=True)
    classes = np.zeros(len(of_mask), np.int32)
    classes[rows] = columns
    return classes[place]


COVERED = 0.5  # share of a mask that a track must cover, else the mask begins a track of its own
TRACK_IOU = 0.3  # least overlap at which a tracker keeps an id (SORT, Bewley et al. 2016)


@dataclass(frozen=True, eq=False)
class MaskGroups:
    """The group of each mask: view name -> (ids + 1,) indexed by mask id, 0 = none."""

    groups: Mapping[str, IntArray]
    n_groups: int
    void: int = 0  # the group that stands for void in the vote; its Gaussians end up without one


@dataclass(frozen=True, eq=False)
class Inputs:
    """Input of a baseline."""

    gaussians: Gaussians
    views: tuple[Camera, ...]  # with masks, by name
    masks: MaskSet
    rasterizer: Rasterizer

    @staticmethod
    def of(
        gaussians: Gaussians, cameras: Sequence[Camera], masks: MaskSet, rasterizer: Rasterizer
    ) -> "Inputs":
        """Inputs of those ``cameras`` that have masks; ``GagaError`` when none has."""
        return Inputs(gaussians, views_with_masks(cameras, masks), masks, rasterizer)


def no_association(inputs: Inputs) -> Stage[MaskGroups]:
    """The ids of each view as they are: mask 3 of one view and mask 3 of another are one group."""
    groups, n_groups = {}, 0
    for i, camera in enumerate(inputs.views):
        yield Progress("No association", i, len(inputs.views), camera.name)
        top = int(load_labels(inputs.masks, camera)[0].max(initial=0))
        groups[camera.name] = np.arange(top + 1, dtype=np.int32)
        n_groups = max(n_groups, top)
    return MaskGroups(groups, n_groups)


def chained_3d_iou(inputs: Inputs) -> Stage[MaskGroups]:
    """One-to-one pairs of masks of consecutive views, by the Gaussians that they share.

    The masks of a view, as sets of Gaussians behind the paper's depth gate, are paired with those
    of the view before so that the summed IoU is greatest; a mask without a partner opens a group.
    Older views are forgotten. A baseline of ours: the paper's linear assignment is `lifting`.
    """

    def regions(camera: Camera, masks: ViewMasks) -> IntArray:
        channels = np.zeros((len(inputs.gaussians), 1), np.float32)
        frame = inputs.rasterizer.render(inputs.gaussians, camera, channels=channels)
        bounds = depth_bounds(masks, frame.expected_depth, frame.alpha, GateConfig())
        return gaussians_of_masks(inputs.gaussians.means, camera, masks, bounds)

    return (yield from _chained("Chain 3D IoU", inputs, regions, 0.0))


def lifting(inputs: Inputs, iterations: int) -> Stage[Identity]:
    """Linear assignment as Panoptic Lifting does it, inside the training of identities."""

    def label_map(camera: Camera) -> IntArray:
        return load_labels(inputs.masks, camera)[0]

    config = LiftingConfig(iterations=iterations)
    return (
        yield from lift_by_assignment(
            inputs.gaussians, inputs.views, label_map, inputs.rasterizer, config
        )
    )


def overlap_tracker(inputs: Inputs) -> Stage[MaskGroups]:
    """A tracker in the picture plane: pairs of neighbouring frames by the IoU of their pixels.

    A stand-in for the video trackers of the ablation: it knows no motion and no 3D, so it holds
    where neighbouring views by name are close.
    """

    def regions(camera: Camera, masks: ViewMasks) -> IntArray:
        return masks.labels.ravel()

    return (yield from _chained("Track overlaps", inputs, regions, TRACK_IOU))


def video_tracks(
    inputs: Inputs, photo_of: Callable[[Camera], UInt8Array], follow: "Follow"
) -> Stage[MaskGroups]:
    """Tracks of a video model: each mask takes the track that covers most of it.

    The masks of the first view are followed through all later ones, by name. Where a view has masks
    that no track covers, they are followed from there on. Photos of a collection are no film: the
    ablation shows what that costs.
    """
    tracks = yield from _tracks(inputs, photo_of, follow)
    groups: dict[str, IntArray] = {}
    n_groups = 0
    for camera in inputs.views:
        masks = ViewMasks.of(load_labels(inputs.masks, camera)[0])
        shown = ViewMasks.of(tracks[camera.name])
        table = _joint(masks.labels.ravel(), shown.labels.ravel(), len(masks), len(shown))
        covered = table[:, 1:].sum(axis=1) > 0
        own = np.zeros(len(masks) + 1, np.int32)
        if len(shown):
            own = np.where(covered, shown.ids[table[:, 1:].argmax(axis=1) + 1], 0)
        groups[camera.name] = np.zeros(int(masks.ids.max()) + 1, np.int32)
        groups[camera.name][masks.ids[1:]] = own[1:]
        n_groups = max(n_groups, int(tracks[camera.name].max(initial=0)))
    return MaskGroups(groups, n_groups)


def _tracks(
    inputs: Inputs, photo_of: Callable[[Camera], UInt8Array], follow: "Follow"
) -> Stage[dict[str, IntArray]]:
    """Track ids (H, W) of every view, 0 = none; earlier tracks lie on top."""
    views = inputs.views
    shown = {c.name: np.zeros((c.height, c.width), np.int32) for c in views}
    n_tracks = 0
    for first, camera in enumerate(views):
        labels = load_labels(inputs.masks, camera)[0]
        ids = [int(m) for m in np.unique(labels[labels > 0])]
        new = [m for m in ids if (shown[camera.name][labels == m] > 0).mean() < COVERED]
        if not new:
            continue
        masks = np.stack([labels == m for m in new])
        rest = [view for view in views[first:] if view.width == camera.width]
        rest = [view for view in rest if view.height == camera.height]
        for i, found in enumerate(follow([photo_of(view) for view in rest], masks)):
            yield Progress("Follow masks", first, len(views), f"{len(new)} from {camera.name}")
            at = shown[rest[i].name]
            free = at == 0
            for k, mask in enumerate(masks if i == 0 else found):
                at[mask & free] = n_tracks + 1 + k
        n_tracks += len(new)
    return shown


def true_masks(inputs: Inputs, truth: MaskSet) -> Stage[MaskGroups]:
    """Upper bound of any association: each mask takes the true label of most of its pixels.

    Views without a true map take no part. Void votes like an object, else the Gaussians around an
    object would have only its votes.
    """
    tops = [int(load().max(initial=0)) for load in truth.loaders.values()]
    groups, void = {}, max(tops, default=0) + 1
    for i, camera in enumerate(inputs.views):
        yield Progress("Match masks to truth", i, len(inputs.views), camera.name)
        if camera.name not in truth:
            groups[camera.name] = np.zeros(1, np.int32)
            continue
        true = truth.load(camera.name, camera.width, camera.height)
        masks = ViewMasks.of(load_labels(inputs.masks, camera)[0])
        names = ViewMasks.of(true)
        table = _joint(masks.labels.ravel(), names.labels.ravel(), len(masks), len(names))
        of_mask = np.zeros(int(masks.ids.max()) + 1, np.int32)
        label = names.ids[table[1:].argmax(axis=1)]
        of_mask[masks.ids[1:]] = np.where(label > 0, label, void)
        groups[camera.name] = of_mask
    return MaskGroups(groups, void, void)


def true_maps(truth: MaskSet) -> MaskSet:
    """The true maps as masks, void among them (ids are one higher): what perfect masks would be."""

    def shifted(load: Loader) -> IntArray:
        return load() + np.int32(1)

    loaders = {name: partial(shifted, load) for name, load in truth.loaders.items()}
    return MaskSet(loaders, truth.source)


def match_frame(labels: IntArray, true: IntArray) -> IntArray:
    """Per-frame upper bound: the masks (H, W) of one frame under the true labels they fit best.

    One-to-one by IoU. Masks that are left over take ids above every true one, from the top of the
    frame's list, so that extra masks cost precision but not once a frame.
    """
    masks, names = ViewMasks.of(labels), ViewMasks.of(true)
    iou = _iou(_joint(masks.labels.ravel(), names.labels.ravel(), len(masks), len(names)))
    new_id = np.zeros(len(masks) + 1, np.int32)
    for m, t in _pairs(iou, 0.0):
        new_id[m] = names.ids[t]
    left = np.flatnonzero(new_id[1:] == 0) + 1
    new_id[left] = 1_000_000 + np.arange(len(left))
    return new_id[masks.labels]


def given_tracks(inputs: Inputs) -> Stage[MaskGroups]:
    """Masks whose ids agree between views already, as a video tracker gives them."""
    return no_association(inputs)


def train_groups(inputs: Inputs, groups: MaskGroups, config: PaperConfig) -> Stage[IdentityField]:
    """Identities trained on the associated masks, as the published method trains its own."""

    def label_map(camera: Camera) -> IntArray:
        labels = load_labels(inputs.masks, camera)[0]
        return associated_labels(labels, groups.groups[camera.name])

    identity, _ = yield from train_identity(
        inputs.gaussians, groups.n_groups, inputs.views, label_map, inputs.rasterizer, config
    )
    return identity.field


def label_gaussians(inputs: Inputs, groups: MaskGroups) -> Stage[IntArray]:
    """Labels (N,) by vote of the associated masks (section 3.3 in closed form); 0 = none."""

    def label_map(camera: Camera) -> IntArray:
        labels = load_labels(inputs.masks, camera)[0]
        return associated_labels(labels, groups.groups[camera.name])

    votes = yield from vote_labels(
        inputs.gaussians, inputs.views, label_map, groups.n_groups, inputs.rasterizer
    )
    return np.where(votes.labels == groups.void, np.int32(0), votes.labels)


def _chained(
    title: str,
    inputs: Inputs,
    regions: Callable[[Camera, ViewMasks], IntArray],  # mask 1..M of each item, 0 = none
    least_iou: float,
) -> Stage[MaskGroups]:
    """Carry groups from each view to the next by one-to-one pairs of IoU above ``least_iou``."""
    groups: dict[str, IntArray] = {}
    n_groups = 0
    before, before_groups = np.zeros(0, np.int32), np.zeros(1, np.int32)
    for i, camera in enumerate(inputs.views):
        yield Progress(title, i, len(inputs.views), camera.name)
        masks = ViewMasks.of(load_labels(inputs.masks, camera)[0])
        now = regions(camera, masks)
        of_mask = np.zeros(len(masks) + 1, np.int32)
        if len(before) == len(now):
            table = _joint(now, before, len(masks), len(before_groups) - 1)
            for m, old in _pairs(_iou(table), least_iou):
                of_mask[m] = before_groups[old]
        new = np.flatnonzero(of_mask[1:] == 0) + 1
        of_mask[new] = n_groups + 1 + np.arange(len(new))
        n_groups += len(new)
        before, before_groups = now, of_mask
        groups[camera.name] = np.zeros(int(masks.ids.max()) + 1, np.int32)
        groups[camera.name][masks.ids] = of_mask
    return MaskGroups(groups, n_groups)


def _joint(a: IntArray, b: IntArray, n_a: int, n_b: int) -> LongArray:
    """Counts (n_a + 1, n_b + 1) of items that are i in ``a`` and j in ``b``."""
    cells = a.astype(np.int64) * (n_b + 1) + b
    return np.bincount(cells, minlength=(n_a + 1) * (n_b + 1)).reshape(n_a + 1, n_b + 1)


def _iou(table: LongArray) -> DoubleArray:
    """IoU of every pair of a joint table; row and column 0 mean "none" and are 0."""
    union = table.sum(axis=1)[:, None] + table.sum(axis=0)[None, :] - table
    iou: DoubleArray = table / np.maximum(union, 1)
    iou[0], iou[:, 0] = 0, 0
    return iou


def _pairs(iou: DoubleArray, least: float) -> list[tuple[int, int]]:
    """One-to-one pairs of rows and columns with the greatest summed IoU, those above ``least``."""
    rows, columns = linear_sum_assignment(iou, maximize=True)
    found = zip(rows.tolist(), columns.tolist(), strict=True)
    return [(r, c) for r, c in found if r > 0 and c > 0 and iou[r, c] > least]
