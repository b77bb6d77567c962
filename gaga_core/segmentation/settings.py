"""Settings of the model providers, free of torch so that panels and commands may show them."""

from dataclasses import dataclass, replace
from typing import Literal

from gaga_core.settings import setting

Device = Literal["auto", "cpu", "cuda", "mps"]
Profile = Literal["default", "paper"]
_SAM_KINDS = ("sam", "sam_hq")


@dataclass(frozen=True)
class GeneratorConfig:
    """How a model that is prompted with points finds everything in a picture."""

    points_per_side: int = setting(32, "Points along each side", least=4, most=64)
    """Points along each side of the grid; time grows with the square. 1..128."""
    points_per_batch: int = 64
    """Points decoded at once: memory, and how soon a cancel acts; same masks. 1..1024."""
    pred_iou_thresh: float = setting(0.80, "Least quality", least=0.0, most=1.0)
    """Least quality that the model predicts for its own mask. 0..1."""
    stability_score_thresh: float = setting(0.92, "Least stability", least=0.0, most=1.0)
    """Least IoU of the mask cut a little tighter and a little wider. 0..1."""
    stability_score_offset: float = 1.0
    """How much tighter and wider, in logits. 0.1..5."""
    box_nms_thresh: float = 0.70
    """IoU of two masks' boxes above which the worse one is a duplicate. 0..1."""
    min_area: float = 0.0002
    """Least area of a mask as a share of the picture. 0..1."""
    crop_layers: int = setting(0, "Closer looks", least=0, most=3)
    """Also process 4, 16, ... overlapping crops, for small objects; takes longer. 0..3."""
    crop_overlap: float = 0.34
    """Overlap of neighbouring crops of the first layer, as a share of the shorter side. 0..0.9."""
    crop_point_divisor: int = 2
    """Each layer's crops have the grid of the layer before divided by this. 1..8."""

    def __post_init__(self) -> None:
        whole = {"points_per_side": 1, "points_per_batch": 1, "crop_layers": 0}
        for name, least in {**whole, "crop_point_divisor": 1}.items():
            if getattr(self, name) < least:
                raise ValueError(f"{name}: expected at least {least}, got {getattr(self, name)}")
        if not 0 <= self.crop_overlap < 1 or self.stability_score_offset <= 0:
            raise ValueError(f"crop_overlap or stability_score_offset out of range: {self}")

    @staticmethod
    def of(kind: str, *, on_gpu: bool) -> "GeneratorConfig":
        """The defaults for a model type of transformers ("sam", "sam2", ...) and a device.

        Thresholds are those published with each model. On the processor, where decoding points is
        what takes the time, a quarter of the points, in batches that let a cancel act soon.
        """
        config = GeneratorConfig()
        if kind in _SAM_KINDS:
            config = replace(config, pred_iou_thresh=0.88, stability_score_thresh=0.95)
        return config if on_gpu else replace(config, points_per_side=16, points_per_batch=4)

    @staticmethod
    def of_paper(*, on_gpu: bool) -> "GeneratorConfig":
        """The published settings of the paper (its released configuration), for any model.

        64 points a side, predicted IoU at least 0.7; the rest as Segment Anything has it. Takes
        sixteen times as long as the default on a processor.
        """
        config = GeneratorConfig(
            points_per_side=64,
            pred_iou_thresh=0.7,
            stability_score_thresh=0.95,
            box_nms_thresh=0.7,
            min_area=0.0,
        )
        return config if on_gpu else replace(config, points_per_batch=4)

    def points_in(self, layer: int) -> int:
        """Points along each side in a crop of ``layer``; 0 is the whole picture."""
        divisor: int = self.crop_point_divisor**layer
        return max(1, self.points_per_side // divisor)


@dataclass(frozen=True)
class UniversalConfig:
    """How the queries of a Mask2Former-like model become masks."""

    kind: Literal["entity", "panoptic"] = "entity"
    """entity: every query is a mask of its own, whatever its class, as EntitySeg does. panoptic:
    each pixel goes to the one query that explains it best."""
    min_score: float = setting(0.5, "Least confidence", least=0.0, most=1.0)
    """Least confidence of a query: its class probability (entity: times the mean mask probability
    inside its mask). 0..1."""
    min_visible: float = 0.8
    """panoptic: share of its own mask that a query must win to stay. 0..1."""
    max_overlap: float = setting(0.7, "Most overlap", least=0.1, most=1.0)
    """entity: IoU of two masks above which the less confident is a duplicate. 0..1."""
