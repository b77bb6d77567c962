"""Mask2Former-like models of transformers: a set of queries, each with a mask and class scores.

The loadable relatives of EntitySeg (CropFormer), whose masks the paper uses: Mask2Former,
MaskFormer and EoMT. Classes are used for confidence only; what comes out is class-agnostic.
"""

import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import msgspec
import numpy as np
import torch
from PIL import Image
from torch import Tensor
from torch.nn import Module
from torch.nn.functional import interpolate

from gaga_core.arrays import BoolArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.io.json_file import read_foreign_json
from gaga_core.progress import Progress, Stage
from gaga_core.segmentation.base import MaskMaker, ScoredMasks, scored_masks
from gaga_core.segmentation.loading import load_folder, normalized
from gaga_core.segmentation.settings import UniversalConfig

if TYPE_CHECKING:
    from transformers import PreTrainedModel

_STAGE = "Segment"
_Side = Annotated[int, msgspec.Meta(ge=1, le=65_536)]  # pixels
_MANY = 24  # masks scaled up between two steps


@dataclass(frozen=True)
class Preparation:
    """How a model wants its pictures, as preprocessor_config.json says."""

    shortest: int = 800  # pixels of the shorter side, unless the longer gets more than `longest`
    longest: int = 1333
    fixed: tuple[int, int] | None = None  # height and width instead
    divisor: int = 32  # height and width are rounded up to multiples of this
    square: int = 0  # side of the black square that the picture is laid into; 0 = none
    mean: tuple[float, ...] = (0.485, 0.456, 0.406)
    std: tuple[float, ...] = (0.229, 0.224, 0.225)


@dataclass(frozen=True, eq=False)
class Queries:
    """Answer of a model to one picture."""

    probabilities: Tensor  # (Q, C) of each class, without "no object"
    logits: Tensor  # (Q, h, w) of the masks; h x w shows the picture and nothing else


def load_universal(folder: Path, config: UniversalConfig, device: torch.device) -> MaskMaker:
    """What makes masks with the model in ``folder``; ``GagaError`` as `load_folder`."""
    model = load_folder("universal", folder)
    settings = cast("PreTrainedModel", model).config
    size = getattr(settings, "image_size", 0)
    side = int(size if isinstance(size, int) else size[0])
    preparation = read_preparation(folder, str(settings.model_type), side)
    return partial(_masks, model.to(device), preparation, config)


def _masks(
    model: Module, preparation: Preparation, config: UniversalConfig, image: UInt8Array
) -> Stage[ScoredMasks]:
    yield Progress(_STAGE, 0, 2, "look at the picture")
    queries = ask(model, preparation, image)
    yield Progress(_STAGE, 1, 2, "choose masks")
    height, width = image.shape[:2]
    if config.kind == "panoptic":
        return panoptic_masks(queries, height, width, config)
    return (yield from entity_masks(queries, height, width, config))


def read_preparation(folder: Path, kind: str, image_size: int = 0) -> Preparation:
    """How the model of type ``kind`` in ``folder`` wants its pictures; the published way without a
    preprocessor_config.json. ``image_size`` is the only one that EoMT takes.
    """
    path = folder / "preprocessor_config.json"
    try:
        content = read_foreign_json(path, _Preprocessor) if path.is_file() else _Preprocessor()
    except GagaError as error:
        raise GagaError(f"{path} is damaged. Copy the model's folder again.") from error
    preparation = _preparation(content)
    if kind.startswith("eomt"):
        side = image_size or 640
        return Preparation(side, side, None, 1, side, preparation.mean, preparation.std)
    return preparation


class _Size(msgspec.Struct, frozen=True):
    height: _Side | None = None
    width: _Side | None = None
    shortest_edge: _Side | None = None
    longest_edge: _Side | None = None


class _Preprocessor(msgspec.Struct, frozen=True):
    """What is read of preprocessor_config.json; None = as published."""

    size: _Side | _Size | None = None
    max_size: _Side | None = None
    size_divisor: int | None = None
    size_divisibility: int | None = None
    image_mean: list[float] | float | None = None
    image_std: list[float] | float | None = None


def _preparation(content: _Preprocessor) -> Preparation:
    default, size = Preparation(), content.size
    if isinstance(size, int):
        size = _Size(shortest_edge=size, longest_edge=content.max_size)
    size = size or _Size()
    fixed = None
    if size.height is not None and size.width is not None:
        fixed = size.height, size.width
    divisor = content.size_divisor
    if divisor is None:
        divisor = content.size_divisibility
    mean, std = content.image_mean, content.image_std
    return Preparation(
        shortest=size.shortest_edge or default.shortest,
        longest=size.longest_edge or default.longest,
        fixed=fixed,
        divisor=divisor if divisor is not None and divisor > 0 else default.divisor,
        mean=tuple(mean) if isinstance(mean, list) else default.mean,
        std=tuple(std) if isinstance(std, list) else default.std,
    )


def prepared_size(height: int, width: int, preparation: Preparation) -> tuple[int, int]:
    """Height and width at which a picture is shown to the model."""
    if preparation.fixed is not None:
        new_h, new_w = preparation.fixed
    else:
        scale = preparation.shortest / min(height, width)
        scale = min(scale, preparation.longest / max(height, width))
        new_h, new_w = max(1, round(height * scale)), max(1, round(width * scale))
    step = preparation.divisor
    return math.ceil(new_h / step) * step, math.ceil(new_w / step) * step


@torch.inference_mode()
def ask(model: Module, preparation: Preparation, image: UInt8Array) -> Queries:
    """The answer of ``model`` to ``image`` (H, W, 3)."""
    height, width = prepared_size(image.shape[0], image.shape[1], preparation)
    side = preparation.square
    if side:
        canvas = np.zeros((side, side, 3), np.uint8)
        resized = Image.fromarray(image).resize((width, height), Image.Resampling.BILINEAR)
        canvas[:height, :width] = np.asarray(resized)
        pixels = normalized(canvas, side, side, preparation.mean, preparation.std)
    else:
        pixels = normalized(image, width, height, preparation.mean, preparation.std)
    parameter = next(model.parameters())
    out = model(pixel_values=pixels.to(parameter.device, parameter.dtype))
    probabilities = out.class_queries_logits[0].float().softmax(dim=-1)[:, :-1]
    logits = out.masks_queries_logits[0].float()
    if side:
        rows, columns = (
            max(1, round(n * inner / side))
            for n, inner in zip(logits.shape[1:], (height, width), strict=True)
        )
        logits = logits[:, :rows, :columns]
    return Queries(probabilities, logits)


def entity_masks(
    queries: Queries, height: int, width: int, config: UniversalConfig
) -> Stage[ScoredMasks]:
    """Every query a mask of its own, whatever its class; duplicates are left out.

    The score is the best class's probability times the mean mask probability inside the mask, as
    Mask2Former and EntitySeg score instances.
    """
    best = queries.probabilities.max(dim=1).values
    inside = queries.logits > 0
    quality = (queries.logits.sigmoid() * inside).flatten(1).sum(1)
    scores = best * quality / inside.flatten(1).sum(1).clamp(min=1)
    order = torch.argsort(scores, descending=True, stable=True)
    order = order[(scores[order] >= config.min_score) & inside.flatten(1).any(1)[order]]
    order = order[_distinct(inside[order].flatten(1).float(), config.max_overlap)]
    masks: list[BoolArray] = []
    for start in range(0, len(order), _MANY):
        yield Progress(_STAGE, len(order) + start, 2 * len(order), f"{len(order)} masks")
        chosen = order[start : start + _MANY]
        masks.extend((_scaled(queries.logits[chosen], height, width) > 0).cpu().numpy())
    return scored_masks(masks, scores[order].cpu().numpy(), height, width)


@torch.inference_mode()
def panoptic_masks(
    queries: Queries, height: int, width: int, config: UniversalConfig
) -> ScoredMasks:
    """Each pixel to the query of greatest score times mask probability (Cheng 2021, section 3.4).

    A query stays when it wins more than ``min_visible`` of its own mask. No classes are fused.
    """
    scores = queries.probabilities.max(dim=1).values
    kept = torch.nonzero(scores > config.min_score).flatten()
    if len(kept) == 0:
        return scored_masks([], [], height, width)
    # One at a time: all queries at the size of a photo would take gigabytes.
    top = torch.zeros((height, width), device=scores.device)
    winner = torch.full((height, width), -1, dtype=torch.int32, device=scores.device)
    areas = []
    for i, query in enumerate(kept.tolist()):
        probability = _scaled(queries.logits[query : query + 1], height, width)[0].sigmoid()
        areas.append(int((probability >= 0.5).sum()))
        weighed = probability * scores[query]
        ahead = weighed > top
        winner[ahead] = i
        top = torch.maximum(top, weighed)
    masks: list[BoolArray] = []
    values: list[float] = []
    for i, query in enumerate(kept.tolist()):
        mask = winner == i
        won = int(mask.sum())
        if won > 0 and areas[i] > 0 and won > config.min_visible * areas[i]:
            masks.append(mask.cpu().numpy())
            values.append(float(scores[query]))
    return scored_masks(masks, values, height, width)


def _distinct(masks: Tensor, max_iou: float) -> Tensor:
    """Which of the masks (k, P), the best first, no better one overlaps by more: (k,) bool."""
    inter = masks @ masks.T
    areas = masks.sum(1)
    iou = inter / (areas[:, None] + areas[None] - inter).clamp(min=1)
    alive = torch.ones(len(masks), dtype=torch.bool, device=masks.device)
    for i in range(len(masks)):
        if bool(alive[i]):
            alive[i + 1 :] &= iou[i, i + 1 :] <= max_iou
    return alive


def _scaled(logits: Tensor, height: int, width: int) -> Tensor:
    return interpolate(logits[:, None], (height, width), mode="bilinear", align_corners=False)[:, 0]
