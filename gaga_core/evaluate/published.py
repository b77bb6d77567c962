"""Figures that the paper prints, in percent, each with its table.

Tables are called by what they compare. Replica and ScanNet are means over the scenes, counted with
void as a label of both sides (the published evaluation code). The paper's groups come from masks of
SAM or EntitySeg. Figures that are not known with certainty are left out.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.camera import natural_order
from gaga_core.errors import GagaError
from gaga_core.io.datasets import DATASETS
from gaga_core.io.folder.splits import FRAMES, NAMES, OVS3D, SCANNET_FOLDERS, SCANNET_LISTS

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
# By the variant of `evaluate.compare` that is the same thing.
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
    "rendered": PublishedScores(
        "SAM in each rendered frame (upper bound)", "SAM", (60.89, 57.07, 67.16), _ABLATION
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
    "scannet": PublishedProtocol(("ins_full",), (SCANNET_LISTS, SCANNET_FOLDERS)),
    "lerf-mask": PublishedProtocol(("test_mask",), ("images_train",), queries=True),
    "3d-ovs": PublishedProtocol(("segmentations",), (OVS3D,), queries=True),
}


# --- The sparse-view protocol (supplement): fewer train views, and what that costs.


def sparse_views(names: Sequence[str], share: float, seed: int) -> tuple[str, ...]:
    """A random ``share`` of the views, at least one, by name.

    The same seed gives nested choices: the views of 5 % are among those of 10 %, so the shares of
    one seed differ only in what was left out. Raises ``GagaError`` when a share is not in (0, 1].
    """
    if not 0 < share <= 1:
        raise GagaError(f"A share of {share} of the views cannot be taken. Choose one in (0, 1].")
    ordered = sorted(names, key=natural_order)
    n = min(len(ordered), max(1, round(share * len(ordered))))
    chosen = np.random.default_rng(seed).permutation(len(ordered))[:n]
    return tuple(ordered[i] for i in np.sort(chosen))


def iou_drop(iou_all: float, iou_sparse: float) -> float:
    """IoU drop = (IoU100 - IoUx) / IoU100; 0 when there was nothing to lose."""
    return (iou_all - iou_sparse) / iou_all if iou_all > 0 else 0.0


def drop_start(masks: str) -> float:
    """IoU in percent from which the paper's drops start: that of ScanNet with these masks."""
    rows = INSTANCE["scannet"]
    return next(r.values[0] for r in rows if (r.method, r.masks) == ("Gaga", masks))


def published_drop(dataset: str, masks: str, share: float) -> float:
    """IoU drop as the paper prints it (5.61 % for Replica, SAM, 30 %), see `drop_start`."""
    return iou_drop(drop_start(masks), SPARSE_IOU[dataset][masks][share])


# --- Under which conditions a scene was scored, and where they are not those of the paper.
# A figure next to a published one says that both were measured the same way. Where that is not so,
# `departures` names it, and the tables print the published figures apart.


MADE_ELSEWHERE = "made elsewhere"  # in the place of a model: masks without a record of it
PUBLISHED_RULE = "boxes of a detector, masks of SAM in them"  # how prompts were answered


@dataclass(frozen=True)
class Conditions:
    """Conditions under which one scene was scored."""

    split: str = ""  # rule that parted the views
    n_train: int = 0
    n_test: int = 0  # of them scored: those with a truth
    truth: str = ""
    masks: str = ""  # folder of the 2D masks, and who made them; "" where predictions are given
    splats: str = ""  # where they are from; "" likewise
    queries: str = ""  # how text prompts were answered; "" without prompts


def departures(dataset: str, scene: str, of: Conditions) -> tuple[str, ...]:
    """Differences from the published conditions, a phrase each; none for unpublished data sets."""
    published = PROTOCOLS.get(dataset)
    if published is None:
        return ()
    found = []
    if of.split not in published.splits:
        found.append(f"split of {scene}: {of.split}")
    if of.truth not in published.truths:
        found.append(f"truth of {scene}: {of.truth}, not {' or '.join(published.truths)}")
    if of.masks and not _are_of(published.masks, of.masks):
        found.append(f"masks of {scene}: {of.masks}, not SAM ViT-H's or EntitySeg's")
    elif "points a side" in of.masks and SAM_PROMPTS not in of.masks:
        found.append(f"masks of {scene}: {of.masks}, not {SAM_PROMPTS}")
    if published.queries and of.queries and not of.queries.startswith(PUBLISHED_RULE):
        found.append(f"queries: {of.queries}, not {PUBLISHED_RULE}")
    return tuple(found)


def _are_of(segmenters: Sequence[str], masks: str) -> bool:
    """Whether one of ``segmenters`` made ``masks``, "folder (model)", as far as that is said.

    Where the model is not known, the name of the folder decides. A name counts as a whole word, and
    SAM 2, SAM 3, SAM-HQ and SAM with a smaller encoder than ViT-H are other models.
    """
    folder, _, model = masks.removesuffix(")").partition(" (")
    name = folder if model in ("", MADE_ELSEWHERE) else model
    words = "|".join(map(re.escape, segmenters))
    found = re.search(rf"(?i)(?<![a-z0-9])({words})(?![a-z0-9]|[ _-]*(hq|\d))", name)
    return bool(found) and not re.search(r"(?i)vit[ _-]*[bl](?![a-z0-9])", name)


def absent_scenes(dataset: str, scenes: Sequence[str]) -> tuple[str, ...]:
    """The published scenes of a data set that are not among ``scenes``."""
    return tuple(name for name in DATASETS[dataset].scenes if name not in scenes)


def sentences(
    dataset: str, scenes: Sequence[tuple[str, Conditions]], *, is_further: bool = False
) -> list[str]:
    """Conditions that every table of a data set states; of further scenes no published ones."""
    if not scenes:
        return []
    found = []
    for title, name in (("Split", "split"), ("Truth", "truth"), ("Masks", "masks")):
        found += _each(title, [(scene, str(getattr(of, name))) for scene, of in scenes])
    known = DATASETS[dataset].scenes
    names = [scene for scene, _ in scenes]
    absent = absent_scenes(dataset, names)
    if known and not is_further:
        text = f"Scenes: {len(known) - len(absent)} of the {len(known)} of the published means"
        more = [name for name in names if name not in known]
        without = f", without {', '.join(absent)}" if absent else ""
        found.append(f"{text}{without}{', and ' + ', '.join(more) if more else ''}.")
    found += _each("Splats", [(scene, of.splats) for scene, of in scenes])
    found += _each("Queries", [(scene, of.queries) for scene, of in scenes])
    return found


def _each(title: str, values: Sequence[tuple[str, str]]) -> list[str]:
    """One sentence, or one for each group of scenes that differ."""
    distinct = list(dict.fromkeys(value for _, value in values if value))
    if len(distinct) == 1 and all(value for _, value in values):
        return [f"{title}: {distinct[0]}."]
    return [
        f"{title}: {value} ({', '.join(scene for scene, own in values if own == value)})."
        for value in distinct
    ]
