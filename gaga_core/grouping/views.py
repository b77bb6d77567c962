"""The views that take part in an association, and their label maps."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, check_shape
from gaga_core.camera import Camera, natural_order
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.gate import (
    GateConfig,
    ViewMasks,
    depth_bounds,
    front_bounds,
    gaussians_of_masks,
    open_bounds,
    patches_of_masks,
)
from gaga_core.grouping.memory_bank import MemoryBank, Preset, groups_of_masks
from gaga_core.grouping.robust.surface_points import DepthMaps
from gaga_core.grouping.votes import Votes, VoteSums, associated_labels
from gaga_core.masks import MaskSet, resize_labels
from gaga_core.progress import Stage
from gaga_core.raster.base import Rasterizer, SpatialChunks

# Pixels: at this size masks are made by default (`pipeline.settings`); depths in between tell no
# more, and finer masks of other programs are taken at it.
LARGEST = 1600


def views_as_masked(
    cameras: Sequence[Camera], masks: MaskSet, preset: Preset
) -> tuple[Camera, ...]:
    """`views_with_masks`, no larger than `LARGEST` but for the paper and its released code."""
    views = views_with_masks(cameras, masks)
    return tuple(view.at_most(LARGEST) for view in views) if preset == "robust" else views


def views_with_masks(cameras: Sequence[Camera], masks: MaskSet) -> tuple[Camera, ...]:
    """The cameras that have masks, in `camera.natural_order` of their names.

    Raises ``GagaError`` if there are none.
    """
    where = f" in {masks.source}" if masks.source else ""
    if len(masks) == 0:
        raise GagaError(f"There are no masks{where}. Make masks, or choose another mask folder.")
    views = [camera for camera in cameras if camera.name in masks]
    if not views:
        raise GagaError(
            f"None of the {len(cameras)} photos has masks{where}. "
            "Name each mask file like its photo, or choose another mask folder."
        )
    return tuple(sorted(views, key=lambda camera: natural_order(camera.name)))


def load_further(masks: MaskSet, camera: Camera) -> list[IntArray]:
    """Label maps of a view at other levels of detail, dense, at the camera's size."""
    maps = masks.further.get(camera.name, tuple)()
    fitting = (resize_labels(labels, camera.width, camera.height) for labels in maps)
    return [ViewMasks.of(labels).labels for labels in fitting if labels.size]


def has_further(masks: MaskSet, cameras: Sequence[Camera]) -> bool:
    """Whether a view has label maps at other levels of detail."""
    return any(len(masks.further.get(camera.name, tuple)()) > 0 for camera in cameras)


def load_labels(masks: MaskSet, camera: Camera) -> tuple[IntArray, bool]:
    """Label map of a view at the camera's size, and whether it had to be resized (nearest)."""
    labels = masks.loaders[camera.name]()
    check_shape(f"mask {camera.name}", labels, ("H", "W"), np.int32)
    if labels.size == 0:
        raise GagaError(f"The mask of {camera.name} is empty. Make the masks again.")
    fitting = resize_labels(labels, camera.width, camera.height)
    return fitting, labels.shape != fitting.shape


# --- The depth gate of section 3.2 over many views: each view's depth map is rendered once.


# "none": no gate, the ablation "all Gaussians"; "front": that of the released code, in patches.
DepthKind = Literal["expected", "median", "none", "front"]


@dataclass(frozen=True, eq=False)
class GatedViews:
    """Views with their masks, and the depths that each mask accepts once `render` has found them.

    Of a depth map only the interval of each mask stays; label maps are loaded when they are needed.
    """

    gaussians: Gaussians
    views: Sequence[Camera]  # all with masks
    masks: MaskSet
    gate: GateConfig
    depth: DepthKind
    chunks: SpatialChunks | None = None  # of the Gaussians: finds those that a view may show
    bounds: dict[str, DoubleArray] = field(default_factory=dict)  # by view: (M + 1, 2) of its masks
    # ... with depth "front" (C + 1, 2) of their pieces
    resized: set[str] = field(default_factory=set)  # views whose maps had another size
    ids: dict[str, IntArray] = field(default_factory=dict)  # by view: of its masks, where loaded

    def render(
        self, camera: Camera, rasterizer: Rasterizer, depths: DepthMaps | None = None
    ) -> None:
        """Splat the depth map of a view and find the accepted depths of its masks.

        ``depths`` keeps the depth map, too.
        """
        masks = self.masks_of(camera)
        if self.depth == "none":
            self.bounds[camera.name] = open_bounds(masks)
            return
        if self.depth == "front":
            pieces, _ = patches_of_masks(masks, self.gate.patches)
            rows = None if self.chunks is None else self.chunks.in_view(camera)
            bounds = front_bounds(self.gaussians.means, camera, pieces, self.gate.front, rows)
            self.bounds[camera.name] = bounds
            return
        # Only depth is wanted: one channel is cheaper than a color from spherical harmonics.
        channels = np.zeros((len(self.gaussians), 1), np.float32)
        frame = rasterizer.render(self.gaussians, camera, channels=channels)
        depth = frame.median_depth if self.depth == "median" else frame.expected_depth
        if depths is not None:
            depths.add(camera.name, depth, frame.alpha, self.gate.alpha_min)
        self.bounds[camera.name] = depth_bounds(masks, depth, frame.alpha, self.gate)

    def rendered(
        self, camera: Camera, rasterizer: Rasterizer, depths: DepthMaps | None = None
    ) -> tuple[ViewMasks, IntArray]:
        """`gaussians_of`, after `render` where the view has not been rendered yet."""
        if camera.name not in self.bounds:
            self.render(camera, rasterizer, depths)
        return self.gaussians_of(camera)

    def masks_of(self, camera: Camera) -> ViewMasks:
        """The masks of a view, ids made dense."""
        labels, is_resized = load_labels(self.masks, camera)
        if is_resized:
            self.resized.add(camera.name)
        masks = ViewMasks.of(labels)
        self.ids[camera.name] = masks.ids
        return masks

    def ids_of(self, camera: Camera) -> IntArray:
        """The id (M + 1,) that each mask of a view has in the file, as `masks_of` has them."""
        return self.ids[camera.name] if camera.name in self.ids else self.masks_of(camera).ids

    def gaussians_of(
        self, camera: Camera, means: FloatArray | None = None
    ) -> tuple[ViewMasks, IntArray]:
        """The masks of a view, and the mask (N,) that each Gaussian lies behind, 0 = none: G(m).

        ``means`` (K, 3): of these centres only. The view must have been rendered.
        """
        masks = self.masks_of(camera)
        bounds, rows = self.bounds[camera.name], None
        if means is None:
            rows = None if self.chunks is None else self.chunks.in_view(camera)
            means = self.gaussians.means
        if self.depth == "front":
            pieces, mask_of_piece = patches_of_masks(masks, self.gate.patches)
            return masks, mask_of_piece[gaussians_of_masks(means, camera, pieces, bounds, rows)]
        return masks, gaussians_of_masks(means, camera, masks, bounds, rows)

    def only(self, views: Sequence[Camera]) -> "GatedViews":
        """Some of the views; what is known and becomes known of them is shared."""
        return replace(self, views=views)

    def notes(self, n_cameras: int, *, wants_levels: bool) -> tuple[str, ...]:
        """Sentences for the user about the views, of ``n_cameras`` that there are."""
        n_views, notes = len(self.views), []
        if wants_levels and not self.masks.are_regions and not has_further(self.masks, self.views):
            notes.append("These masks have no levels: the detail has no effect.")
        if n_views < n_cameras:
            notes.append(
                f"{n_cameras - n_views} of {n_cameras} photos have no masks and took no part."
            )
        if self.resized:
            notes.append(
                f"The masks of {len(self.resized)} of {n_views} photos had another size than the "
                "photo; they were resized."
            )
        return tuple(notes)


def vote_with_bank(
    gated: GatedViews,
    bank: MemoryBank,
    rasterizer: Rasterizer,
    histogram_bytes: int,
    sums: VoteSums | None = None,
) -> Stage[Votes]:
    """Labels per Gaussian by vote of the masks, each for the group that ``bank`` has it in; with
    ``sums`` they are added to those."""
    groups = groups_of_masks(bank, [camera.name for camera in gated.views])

    def label_map(camera: Camera) -> IntArray:
        return associated_labels(load_labels(gated.masks, camera)[0], groups[camera.name])

    sums = sums or VoteSums.empty(len(gated.gaussians), bank.n_groups, histogram_bytes)
    yield from sums.add_stage(gated.gaussians, gated.views, label_map, rasterizer)
    return sums.votes()
