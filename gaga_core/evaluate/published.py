"""Figures that the paper prints (its tables of section 5 and the supplement), in percent.

Replica and ScanNet are means over the scenes, counted with void as a label of both sides (the
published evaluation code). The paper's groups come from masks of SAM or EntitySeg.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class PublishedScores:
    """One row of a published table."""

    method: str
    masks: str
    values: tuple[float, ...]  # in the order of the protocol's metrics


PROMPT_METRICS = ("mIoU", "mBIoU")

INSTANCE: Mapping[str, tuple[PublishedScores, ...]] = {
    "replica": (
        PublishedScores("Gaga", "SAM", (46.21, 39.53, 50.62)),
        PublishedScores("Gaga", "EntitySeg", (41.45, 59.74, 45.59)),
        PublishedScores("Gaussian Grouping", "SAM", (21.76, 25.00, 19.72)),
        PublishedScores("Gaussian Grouping", "EntitySeg", (35.90, 14.07, 31.57)),
    ),
    "scannet": (
        PublishedScores("Gaga", "SAM", (45.06, 22.88, 51.02)),
        PublishedScores("Gaga", "EntitySeg", (43.08, 35.46, 49.73)),
    ),
}

# IoU by the share of the train views, by masks.
SPARSE_IOU: Mapping[str, Mapping[str, Mapping[float, float]]] = {
    "replica": {
        "SAM": {1.0: 46.21, 0.3: 42.53, 0.2: 42.14, 0.1: 39.06, 0.05: 31.87},
        "EntitySeg": {1.0: 41.45, 0.3: 40.40, 0.2: 39.00, 0.1: 35.92, 0.05: 29.67},
    }
}

# By scene; one figure less where a data set has no boundary IoU.
PROMPTS: Mapping[str, Mapping[str, tuple[float, ...]]] = {
    "lerf-mask": {
        "figurines": (92.3, 90.8),
        "ramen": (72.0, 63.3),
        "teatime": (71.2, 68.4),
    },
    "3d-ovs": {
        "bed": (97.4,),
        "bench": (94.4,),
        "room": (92.5,),
        "sofa": (91.0,),
        "lawn": (97.1,),
    },
}
