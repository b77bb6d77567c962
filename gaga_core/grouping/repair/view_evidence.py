"""Evidence of the views on the splats, kept so that a repair need not render every view again.

Depth maps are the expensive part of an association. What remains of them here is small: the
accepted depths of each mask, and (for the view consensus) the mask that each surface point shows in
a view.
"""

from collections.abc import Sequence

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import AssociateConfig
from gaga_core.grouping.gate import ViewMasks
from gaga_core.grouping.robust.surface_points import DepthMaps, masks_of_points, sample_points
from gaga_core.grouping.views import GatedViews, views_with_masks
from gaga_core.masks import MaskSet
from gaga_core.progress import Progress, Stage, part
from gaga_core.raster.base import Rasterizer

STAGE = "Look at the views"


class Evidence:
    """The views of an association with their masks, and what `gather_stage` found in them."""

    def __init__(self, gated: GatedViews, config: AssociateConfig) -> None:
        self.gated = gated
        self.config = config
        self.points: IntArray | None = None  # (S, V) mask that each surface point shows in a view
        self.gaussians, self.views, self.masks = gated.gaussians, gated.views, gated.masks
        self.bounds = gated.bounds  # by view: (M + 1, 2) accepted depths

    @staticmethod
    def of(
        gaussians: Gaussians,
        cameras: Sequence[Camera],
        masks: MaskSet,
        config: AssociateConfig,
    ) -> "Evidence":
        """Nothing gathered yet. Raises ``GagaError`` when no view has masks."""
        views = views_with_masks(cameras, masks)
        gated = GatedViews(gaussians, views, masks, config.gate, config.depth)
        return Evidence(gated, config)

    def camera(self, view: str) -> Camera:
        """The camera of a view; ``GagaError`` when it has no masks."""
        for camera in self.views:
            if camera.name == view:
                return camera
        raise GagaError(f"{view} no longer has masks. Choose the masks that were associated.")

    def masks_of(self, camera: Camera) -> ViewMasks:
        """The masks of a view, ids made dense."""
        return self.gated.masks_of(camera)

    def gaussians_of(
        self, camera: Camera, means: FloatArray | None = None
    ) -> tuple[ViewMasks, IntArray]:
        """The masks of a view and the one (N,) that each splat lies behind, 0 = none.

        ``means`` (K, 3): of these centres only. Needs `gather_stage`.
        """
        return self.gated.gaussians_of(camera, means)

    def only(self, views: Sequence[Camera]) -> "Evidence":
        """Of some of the views; accepted depths that are found for one are shared."""
        return Evidence(self.gated.only(views), self.config)


def gather_stage(
    evidence: Evidence, rasterizer: Rasterizer, *, only_bounds: bool = False
) -> Stage[None]:
    """Find what is missing: one depth map a view, once. Cancelled, it keeps what it has.

    ``only_bounds``: the points of the surfaces are not wanted.
    """
    consensus = None if only_bounds else evidence.config.consensus
    wants_points = consensus is not None and evidence.points is None
    missing = [c for c in evidence.views if wants_points or c.name not in evidence.bounds]
    n_parts = 3 if wants_points else 1
    depths = DepthMaps(evidence.views) if wants_points else None
    yield from part(_render(evidence, missing, rasterizer, depths), 0, n_parts, STAGE)
    if consensus is None or depths is None:
        return
    sample = sample_points(
        evidence.views,
        evidence.masks_of,
        depths,
        consensus.per_mask,
        consensus.point_limit(len(evidence.views)),
    )
    points = yield from part(sample, 1, n_parts, STAGE)
    shown = masks_of_points(points, evidence.views, evidence.masks_of, depths)
    evidence.points = yield from part(shown, 2, n_parts, STAGE)


def _render(
    evidence: Evidence, views: Sequence[Camera], rasterizer: Rasterizer, depths: DepthMaps | None
) -> Stage[None]:
    for i, camera in enumerate(views):
        yield Progress(STAGE, i, len(views), camera.name)
        evidence.gated.render(camera, rasterizer, depths)
