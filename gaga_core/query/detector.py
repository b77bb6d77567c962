"""Boxes of a phrase in a picture: Grounding DINO and OWLv2, from a local folder."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np
from PIL import Image

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, UInt8Array, check_shape
from gaga_core.query.embed import load_model

if TYPE_CHECKING:
    import torch
    from transformers import BatchFeature

    from gaga_core.segmentation.settings import Device


_KINDS = ("grounding-dino", "owlv2", "owlvit")


@dataclass(frozen=True)
class DetectConfig:
    """Which boxes count."""

    box_threshold: float = 0.3  # score of a box (the reference's for Grounding DINO)
    text_threshold: float = 0.25  # of a word in it, Grounding DINO only


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes that a detector found."""

    corners: FloatArray  # (B, 4) left, top, right, bottom, pixels of the picture
    scores: FloatArray  # (B,) 0..1, falling

    def __len__(self) -> int:
        return len(self.scores)


class Detector(Protocol):
    """Finds what a phrase names in a picture."""

    def detect(self, picture: UInt8Array, phrase: str, config: DetectConfig) -> Boxes:
        """Boxes of ``phrase`` in a picture (H, W, 3)."""
        ...


class _Model(Protocol):
    device: "torch.device"

    def __call__(self, **given: "torch.Tensor") -> object: ...


class _Processor(Protocol):
    def __call__(
        self, *, images: Image.Image, text: str | list[list[str]], return_tensors: str
    ) -> "BatchFeature": ...

    def post_process_grounded_object_detection(
        self, outputs: object, *rest: object, threshold: float, **more: object
    ) -> list[dict[str, "torch.Tensor"]]: ...


@dataclass(frozen=True, eq=False)
class BoxModel:
    """A Grounding DINO or OWL model that was loaded."""

    model: _Model
    processor: _Processor
    kind: str

    def detect(self, picture: UInt8Array, phrase: str, config: DetectConfig) -> Boxes:
        """Boxes of ``phrase`` in a picture (H, W, 3) uint8, the best first."""
        import torch

        image = Image.fromarray(picture)
        size = [picture.shape[:2]]
        is_dino = self.kind == "grounding-dino"
        texts: str | list[list[str]] = [[f"a photo of a {phrase.lower().strip('. ')}"]]
        if is_dino:  # lower case, every phrase ends with a full stop
            texts = phrase.lower().strip().rstrip(".") + "."
        given = self.processor(images=image, text=texts, return_tensors="pt")
        given = given.to(self.model.device)
        with torch.inference_mode():
            outputs = self.model(**given)
        if is_dino:
            found = self.processor.post_process_grounded_object_detection(
                outputs,
                given["input_ids"],
                threshold=config.box_threshold,
                text_threshold=config.text_threshold,
                target_sizes=size,
            )[0]
        else:
            found = self.processor.post_process_grounded_object_detection(
                outputs, threshold=config.box_threshold, target_sizes=size
            )[0]
        return as_boxes(found["boxes"].cpu().numpy(), found["scores"].cpu().numpy(), size[0])


def load_detector(folder: Path, device: "Device" = "auto") -> BoxModel:
    """The detector in ``folder`` (as transformers saves them).

    Raises ``GagaError`` when transformers is missing, or the folder holds no such model.
    """
    found = load_model(
        folder,
        "text_boxes",
        _KINDS,
        "AutoProcessor",
        title="Grounding DINO or OWLv2",
        device=device,
    )
    return BoxModel(cast(_Model, found.network), cast(_Processor, found.companion), found.kind)


def as_boxes(
    corners: FloatArray | Sequence[Sequence[float]],
    scores: FloatArray | Sequence[float],
    size: tuple[int, int],
) -> Boxes:
    """Boxes clipped to a picture of ``size`` (height, width), the best first; empty ones go."""
    found = np.asarray(corners, np.float32).reshape(-1, 4)
    height, width = size
    found = np.clip(found, 0, np.array([width, height, width, height], np.float32))
    kept = np.flatnonzero((found[:, 2] > found[:, 0]) & (found[:, 3] > found[:, 1]))
    values = np.asarray(scores, np.float32).reshape(-1)
    order = kept[np.argsort(-values[kept], kind="stable")]
    return Boxes(np.ascontiguousarray(found[order]), np.ascontiguousarray(values[order]))


# --- From boxes in views to groups: "find in this view", and the LERF-Mask protocol.
# `contained` is the published way: on one view, every group of which more than 0.7 lies in what
# was detected. `vote_boxes` is ours: a box chooses the group that fills it best and lies in it,
# its centre counts, group 0 never wins, and several views vote, weighted by the detector's scores.


CONTAINED = 0.7  # share of a group's pixels inside (render_lerf_mask.py of Gaussian Grouping)
_PART = 0.15  # pixels of a box that a further group must have to be a part of what is meant
_CENTRE = 1.25  # what the group at a box's centre is worth more


@dataclass(frozen=True, eq=False)
class FoundGroups:
    """Groups that a phrase means."""

    groups: IntArray  # (K,) the best first
    scores: FloatArray  # (K,) 0..1


def contained(labels: IntArray, mask: BoolArray, share: float = CONTAINED) -> IntArray:
    """Groups (K,) of a label map (H, W) of which more than ``share`` lies in ``mask`` (H, W).

    The rule of the LERF-Mask protocol, there with the summed masks of all boxes; group 0 is none.
    """
    check_shape("mask", mask, labels.shape, np.bool_)
    ids, area, inside = _areas(labels, mask)
    return ids[(inside > share * area) & (ids > 0)]


def groups_of_box(labels: IntArray, corners: FloatArray) -> FoundGroups:
    """Groups that a box (4,) on a label map (H, W) means, scored 0..1.

    The best is the group of greatest inside / own area times (pixels in box / box)^(1/2), more at
    the box's centre. Further ones join when `CONTAINED` of them lies inside and they fill a good
    part of the box: an object in several groups.
    """
    rows, columns = _pixels(corners)
    mask = np.zeros(labels.shape, np.bool_)
    mask[rows, columns] = True
    ids, area, inside = _areas(labels, mask)
    n_box = max(int(mask.sum()), 1)
    share, filled = inside / area, inside / n_box
    score = share * np.sqrt(filled)
    centre = labels[_middle(rows, labels.shape[0]), _middle(columns, labels.shape[1])]
    score = np.where(ids == centre, np.minimum(_CENTRE * score, 1), score) * (ids > 0)
    if len(ids) == 0 or score.max() <= 0:
        return FoundGroups(np.zeros(0, np.int32), np.zeros(0, np.float32))
    best = int(score.argmax())
    meant = (share > CONTAINED) & (filled >= _PART) & (ids > 0)
    meant[best] = True
    order = np.flatnonzero(meant)
    order = order[np.argsort(-score[order], kind="stable")]
    return FoundGroups(ids[order], score[order].astype(np.float32))


def vote_boxes(views: Sequence[tuple[IntArray, Boxes]]) -> FoundGroups:
    """Groups that boxes in several views (label map (H, W), its boxes) mean together.

    A group's score is the mean, over the views that show it, of its best box's score times how
    well it fits that box, relative to the best group: 1 for that one.
    """
    total: dict[int, float] = {}
    n_shown: dict[int, int] = {}
    for labels, boxes in views:
        for group in np.unique(labels):
            n_shown[int(group)] = n_shown.get(int(group), 0) + 1
        best: dict[int, float] = {}
        for corners, weight in zip(boxes.corners, boxes.scores, strict=True):
            found = groups_of_box(labels, corners)
            for group, score in zip(found.groups, found.scores, strict=True):
                value = float(score) * float(weight)
                best[int(group)] = max(best.get(int(group), 0.0), value)
        for group, value in best.items():
            total[group] = total.get(group, 0.0) + value
    means = {group: value / n_shown[group] for group, value in total.items()}
    order = sorted(means, key=lambda group: (-means[group], group))
    top = means[order[0]] if order else 1.0
    scores = [means[group] / top if top > 0 else 0.0 for group in order]
    return FoundGroups(np.array(order, np.int32), np.array(scores, np.float32))


def _areas(labels: IntArray, mask: BoolArray) -> tuple[IntArray, DoubleArray, DoubleArray]:
    """Groups (K,) that ``mask`` touches, their pixels in all and inside."""
    ids = np.unique(labels[mask])
    inside = np.array([np.count_nonzero(labels[mask] == i) for i in ids], np.float64)
    area = np.array([np.count_nonzero(labels == i) for i in ids], np.float64)
    return ids.astype(np.int32), area, inside


def _pixels(corners: FloatArray) -> tuple[slice, slice]:
    """Rows and columns whose pixel centres lie in a box; at least one of each."""
    left, top, right, bottom = (float(v) for v in corners)
    x, y = int(np.ceil(left - 0.5)), int(np.ceil(top - 0.5))
    x_end, y_end = int(np.ceil(right - 0.5)), int(np.ceil(bottom - 0.5))
    return slice(max(y, 0), max(y_end, y + 1)), slice(max(x, 0), max(x_end, x + 1))


def _middle(part: slice, size: int) -> int:
    return min((int(part.start) + int(part.stop)) // 2, size - 1)
