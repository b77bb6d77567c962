"""What the views say about the splats, kept so that a repair need not draw every view again.

Depth pictures are the dear part of an association. What remains of them here is small: the accepted
depths of each mask, and (for the view consensus) the mask that each surface point shows in a view.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import AssociateConfig
from gaga_core.grouping.gate import ViewMasks, depth_bounds, gaussians_of_masks, open_bounds
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.grouping.robust.surface_points import DepthMaps, masks_of_points, sample_points
from gaga_core.grouping.views import load_labels, views_with_masks
from gaga_core.masks import MaskSet
from gaga_core.progress import Progress, Stage, part
from gaga_core.raster.base import Rasterizer

STAGE = "Look at the views"


@dataclass(frozen=True, eq=False)
class Evidence:
    """The views of an association with their masks. Filled by `gather_stage`; the rest is fixed."""

    gaussians: Gaussians
    views: tuple[Camera, ...]  # with masks, by name
    masks: MaskSet
    config: AssociateConfig
    bounds: dict[str, DoubleArray] = field(default_factory=dict)  # accepted depths of the masks
    points: list[IntArray] = field(default_factory=list)  # one (S, V): mask of a point in a view

    @staticmethod
    def of(
        gaussians: Gaussians,
        cameras: Sequence[Camera],
        masks: MaskSet,
        config: AssociateConfig,
    ) -> "Evidence":
        """Nothing gathered yet. Raises ``GagaError`` when no view has masks."""
        return Evidence(gaussians, views_with_masks(cameras, masks), masks, config)

    def camera(self, view: str) -> Camera:
        """The camera of a view; ``GagaError`` when it has no masks."""
        for camera in self.views:
            if camera.name == view:
                return camera
        raise GagaError(f"{view} has no masks any more. Choose the masks that were associated.")

    def masks_of(self, camera: Camera) -> ViewMasks:
        """The masks of a view, ids made dense."""
        return ViewMasks.of(load_labels(self.masks, camera)[0])

    def gaussians_of(
        self, camera: Camera, means: FloatArray | None = None
    ) -> tuple[ViewMasks, IntArray]:
        """The masks of a view and the one (N,) that each splat lies behind, 0 = none.

        ``means`` (K, 3): of these centres only. Needs `gather_stage`.
        """
        masks = self.masks_of(camera)
        centres = self.gaussians.means if means is None else means
        return masks, gaussians_of_masks(centres, camera, masks, self.bounds[camera.name])


def preset_of(bank: MemoryBank) -> str:
    """The preset that made a bank: "paper" takes the views by name, "robust" the widest first."""
    views = list(dict.fromkeys(decision.view for decision in bank.log))
    return "paper" if views == sorted(views) else "robust"


def gather_stage(
    evidence: Evidence, rasterizer: Rasterizer, *, only_bounds: bool = False
) -> Stage[None]:
    """Fill in what is missing: one depth picture a view, once. Cancelled, it keeps what it has.

    ``only_bounds``: the points of the surfaces are not wanted.
    """
    consensus = None if only_bounds else evidence.config.consensus
    wants_points = consensus is not None and not evidence.points
    missing = [c for c in evidence.views if wants_points or c.name not in evidence.bounds]
    n_parts = 3 if wants_points else 1
    depths = DepthMaps.for_views(evidence.views)
    yield from part(_bounds(evidence, missing, rasterizer, depths), 0, n_parts, STAGE)
    if consensus is None or not wants_points:
        return
    sample = sample_points(
        evidence.views,
        evidence.masks_of,
        depths,
        consensus.per_mask,
        consensus.max_points,
    )
    points = yield from part(sample, 1, n_parts, STAGE)
    shown = masks_of_points(points, evidence.views, evidence.masks_of, depths)
    evidence.points.append((yield from part(shown, 2, n_parts, STAGE)))


def _bounds(
    evidence: Evidence, views: Sequence[Camera], rasterizer: Rasterizer, depths: DepthMaps
) -> Stage[None]:
    config = evidence.config
    channels = np.zeros((len(evidence.gaussians), 1), np.float32)
    draw = partial(rasterizer.render, evidence.gaussians, channels=channels)
    for i, camera in enumerate(views):
        yield Progress(STAGE, i, len(views), camera.name)
        masks = evidence.masks_of(camera)
        if config.depth == "none":
            evidence.bounds[camera.name] = open_bounds(masks)
            continue
        frame = draw(camera)
        depth = frame.median_depth if config.depth == "median" else frame.expected_depth
        if config.consensus is not None:
            depths.add(camera.name, depth, frame.alpha, config.gate.alpha_min)
        evidence.bounds[camera.name] = depth_bounds(masks, depth, frame.alpha, config.gate)


def with_views(evidence: Evidence, views: Sequence[Camera]) -> Evidence:
    """The same, of some of its views; what was gathered of bounds is shared."""
    return replace(evidence, views=tuple(views), points=[])
