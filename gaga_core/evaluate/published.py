"""Figures that the paper prints, in percent, each with the table that it stands in.

Tables are called by what they compare. Replica and ScanNet are means over the scenes, counted with
void as a label of both sides (the published evaluation code). The paper's groups come from masks of
SAM or EntitySeg. What is not here is not known to us with certainty, and is left out.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from gaga_core.io.splits import FRAMES, NAMES, OVS3D, SCANNET_FOLDERS, SCANNET_LISTS

SAM_PROMPTS = "64 points a side, predicted IoU 0.7"  # of the published masks of SAM ViT-H
INSTANCE_METRICS = ("IoU", "P", "R")
PROMPT_METRICS = ("mIoU", "mBIoU")


@dataclass(frozen=True)
class PublishedScores:
    """One row of a published table."""

    method: str
    masks: str
    values: tuple[float, ...]  # in the order of the protocol's metrics
    table: str = ""  # of the paper: what it compares


@dataclass(frozen=True)
class PublishedProtocol:
    """The conditions under which a data set's figures were published."""

    truths: tuple[str, ...]  # names of the truth (`io.datasets`)
    splits: tuple[str, ...]  # rules of the split (`io.splits`)
    masks: tuple[str, ...] = ("sam", "entityseg")  # who made the masks
    queries: bool = False  # prompts are answered by boxes of a detector, and masks of SAM in them


_REPLICA, _SCANNET = "comparison on Replica", "comparison on ScanNet"

INSTANCE: Mapping[str, tuple[PublishedScores, ...]] = {
    "replica": (
        PublishedScores("Gaga", "SAM", (46.21, 39.53, 50.62), _REPLICA),
        PublishedScores("Gaga", "EntitySeg", (41.45, 59.74, 45.59), _REPLICA),
        PublishedScores("Gaussian Grouping", "SAM", (21.76, 25.00, 19.72), _REPLICA),
        PublishedScores("Gaussian Grouping", "EntitySeg", (35.90, 14.07, 31.57), _REPLICA),
    ),
    "scannet": (
        PublishedScores("Gaga", "SAM", (45.06, 22.88, 51.02), _SCANNET),
        PublishedScores("Gaga", "EntitySeg", (43.08, 35.46, 49.73), _SCANNET),
    ),
}

# IoU by the share of the train views, by masks; the table "few views of Replica".
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

_ABLATION = "ablation on Replica"
# By the variant of `evaluate.compare` that is the same thing; two rows have none there.
ABLATION: Mapping[str, PublishedScores] = {
    "lifting": PublishedScores("linear assignment", "SAM", (1.92, 1.54, 0.58), _ABLATION),
    "sam2": PublishedScores("SAM 2 tracks", "SAM 2", (11.75, 1.45, 1.43), _ABLATION),
    "none": PublishedScores("no association", "SAM", (8.81, 3.19, 2.16), _ABLATION),
    "gaussian-grouping": PublishedScores("video tracker", "SAM", (21.76, 25.00, 19.72), _ABLATION),
    "all-gaussians": PublishedScores(
        "memory bank, all Gaussians", "SAM", (42.30, 40.48, 46.51), _ABLATION
    ),
    "paper": PublishedScores("memory bank", "SAM", (46.21, 39.53, 50.62), _ABLATION),
    "paper-sam2": PublishedScores("memory bank", "SAM 2", (49.05, 30.46, 53.37), _ABLATION),
    "per-frame": PublishedScores(
        "SAM in each frame (upper bound)", "SAM", (60.89, 57.07, 67.16), _ABLATION
    ),
}

THRESHOLD_TABLE = "overlap threshold on LERF-Mask"
# mIoU by the overlap threshold, by scene of LERF-Mask.
THRESHOLD_MIOU: Mapping[float, Mapping[str, float]] = {
    0.01: {"figurines": 79.6, "ramen": 72.0, "teatime": 71.2},
    0.05: {"figurines": 91.4, "ramen": 72.3, "teatime": 70.2},
    0.1: {"figurines": 92.3, "ramen": 72.0, "teatime": 71.2},
    0.2: {"figurines": 85.8, "ramen": 51.3, "teatime": 71.7},
    0.3: {"figurines": 85.7, "ramen": 45.6, "teatime": 71.6},
}

PROTOCOLS: Mapping[str, PublishedProtocol] = {
    # 180 train and 180 test views of each of Semantic-NeRF's scenes.
    "replica": PublishedProtocol(("semantic_instance",), (NAMES, FRAMES)),
    # The paper has seven of the scenes that DM-NeRF selects, and elsewhere fourteen of ScanNet.
    "scannet": PublishedProtocol(("ins_full",), (SCANNET_LISTS, SCANNET_FOLDERS)),
    "lerf-mask": PublishedProtocol(("test_mask",), ("images_train",), queries=True),
    "3d-ovs": PublishedProtocol(("segmentations",), (OVS3D,), queries=True),
}
