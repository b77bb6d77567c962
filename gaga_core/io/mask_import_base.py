"""What the readers of other programs' masks share."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from gaga_core.arrays import BoolArray, IntArray

SCORE_KEYS = ("score", "predicted_iou", "iou_preds", "iou", "confidence", "scores", "pred_scores")


@dataclass(frozen=True, eq=False)
class MaskList:
    """Masks of one picture; they are decoded one by one, when iterated over."""

    height: int
    width: int
    masks: Iterable[BoolArray]  # M of (H, W)
    scores: tuple[float, ...]  # M; 1 where the file has none


ImportedMasks = IntArray | MaskList  # a label map (H, W) int32, 0 = none, or masks that may overlap


@dataclass(frozen=True, eq=False)
class MaskSource:
    """What was recognised, and how to read each view."""

    form: str  # "label maps", "SAM lists", ...
    said: str  # one sentence for people
    views: Mapping[str, Callable[[], ImportedMasks]]  # by `view_key` or number of the view
    name: str = "imported"  # a good name for the masks
    keeps_covered: bool = False  # of lists: published without the rule that drops covered masks
