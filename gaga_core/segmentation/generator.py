"""Masks of everything in a picture from a model that is prompted with points.

Segment Anything's automatic generation (Kirillov et al., ICCV 2023, appendix B "Automatic mask
generation"), in the paper's order: crops; in each crop a grid of points; of each point three masks;
filters by predicted IoU and stability; masks that the crop's edge cuts; non-maximum suppression
inside a crop and then among crops; small masks. Settings have the names of Segment Anything's own
generator. This code needs no torchvision, filters at the model's own resolution so that only
survivors are scaled up, and can be stopped between two batches.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, UInt8Array
from gaga_core.progress import Progress, Stage
from gaga_core.segmentation.base import ScoredMasks
from gaga_core.segmentation.settings import GeneratorConfig

_UPSCALE_AT_ONCE = 8  # masks
_EDGE = 20.0  # pixels from a crop's inner edge at which a mask counts as cut
_STAGE = "Segment"


@dataclass(frozen=True, eq=False)
class Encoded:
    """A picture that the model has encoded, ready for points."""

    # points (n, 2) x, y in pixels of the picture -> logits (n, 3, h, w), predicted IoU (n, 3)
    decode: Callable[[FloatArray], tuple[Tensor, Tensor]]
    upscale: Callable[[Tensor], Tensor]  # logits (k, h, w) -> (k, H, W) at the picture's size
    shown: tuple[float, float]  # share of the logits' height and width that shows the picture
    # points (n, 2) and which of them are on the object (n,) -> logits (3, h, w), predicted IoU (3,)
    prompt: Callable[[FloatArray, BoolArray], tuple[Tensor, Tensor]]
    boxes: Callable[[FloatArray], Tensor]  # (n, 4) x0 y0 x1 y1 pixels -> logits (n, h, w)


Encoder = Callable[[UInt8Array], Encoded]


@dataclass(frozen=True)
class _Window:
    """A part of the picture that is processed by itself."""

    x0: int
    y0: int
    x1: int
    y1: int
    layer: int


@dataclass(frozen=True, eq=False)
class _Found:
    """Candidates of a window at the model's resolution."""

    logits: Tensor  # (k, h, w)
    scores: Tensor  # (k,)
    boxes: Tensor  # (k, 4) x0 y0 x1 y1 pixels of the window


def generate(
    encode: Encoder, image: UInt8Array, config: GeneratorConfig | None = None
) -> Stage[ScoredMasks]:
    """All masks of ``image`` (H, W, 3) RGB, the best first; the same at every call.

    Progress counts points; closing the generator stops between two batches.
    """
    config = config or GeneratorConfig()
    height, width = image.shape[:2]
    # Crops: the whole picture, then overlapping parts of it.
    windows = crop_windows(height, width, config)
    totals = [config.points_in(window.layer) ** 2 for window in windows]
    done = 0
    parts = []
    for window, n_points in zip(windows, totals, strict=True):
        yield Progress(_STAGE, done, sum(totals), "look at the picture")
        encoded = encode(np.ascontiguousarray(image[window.y0 : window.y1, window.x0 : window.x1]))
        # A regular grid of foreground points, sparser in smaller crops.
        points = point_grid(config.points_in(window.layer)) * (
            window.x1 - window.x0,
            window.y1 - window.y0,
        )
        found = []
        for start in range(0, n_points, config.points_per_batch):
            now, total = done + start, sum(totals)
            yield Progress(_STAGE, now, total, f"{now} of {total} points")
            batch = points[start : start + config.points_per_batch].astype(np.float32)
            found.append(_candidates(encoded, batch, window, (height, width), config))
        parts.append(_survivors(encoded, found, window, (height, width), config))
        done += n_points
        del encoded
    yield Progress(_STAGE, done, sum(totals), f"{sum(len(p) for p in parts)} masks")
    return _merge(parts, windows, config)


def point_grid(n: int) -> DoubleArray:
    """Points (n n, 2) x, y in 0..1 at the centres of an n x n grid, row by row."""
    centres = (np.arange(n) + 0.5) / n
    x, y = np.meshgrid(centres, centres)
    return np.stack([x.ravel(), y.ravel()], axis=1)


def crop_windows(height: int, width: int, config: GeneratorConfig) -> list[_Window]:
    """The whole picture, then 2 x 2, 4 x 4, ... crops that overlap."""
    windows = [_Window(0, 0, width, height, 0)]
    for layer in range(1, config.crop_layers + 1):
        n = 2**layer
        overlap = int(config.crop_overlap * min(height, width) * 2 / n)
        crop_w, crop_h = (-(-(overlap * (n - 1) + side) // n) for side in (width, height))
        for row in range(n):
            for column in range(n):
                x0, y0 = (crop_w - overlap) * column, (crop_h - overlap) * row
                if x0 < width and y0 < height:
                    x1, y1 = min(x0 + crop_w, width), min(y0 + crop_h, height)
                    windows.append(_Window(x0, y0, x1, y1, layer))
    return windows


def non_maximum_suppression(boxes: Tensor, scores: Tensor, max_iou: float) -> Tensor:
    """Indices of the boxes (k, 4) that no better-scored box overlaps by more, the best first."""
    order = torch.argsort(scores, descending=True, stable=True)
    x0, y0, x1, y1 = boxes[order].unbind(1)
    areas = (x1 - x0).clamp(min=0) * (y1 - y0).clamp(min=0)
    alive = torch.ones(len(order), dtype=torch.bool, device=boxes.device)
    for i in range(len(order)):
        if not bool(alive[i]):
            continue
        w = torch.minimum(x1[i], x1[i + 1 :]) - torch.maximum(x0[i], x0[i + 1 :])
        h = torch.minimum(y1[i], y1[i + 1 :]) - torch.maximum(y0[i], y0[i + 1 :])
        inter = w.clamp(min=0) * h.clamp(min=0)
        alive[i + 1 :] &= inter <= max_iou * (areas[i] + areas[i + 1 :] - inter)
    return order[alive]


@torch.inference_mode()
def _candidates(
    encoded: Encoded,
    points: FloatArray,
    window: _Window,
    size: tuple[int, int],
    config: GeneratorConfig,
) -> _Found:
    """Masks of a batch of points that pass the filters, still at the model's resolution."""
    # Three masks of each point (whole, part, subpart), each with the IoU that the model predicts.
    logits, scores = encoded.decode(points)
    logits, scores = logits.flatten(0, 1).float(), scores.flatten().float()
    # Confident masks: predicted IoU.
    good = scores >= config.pred_iou_thresh
    logits, scores = logits[good], scores[good]
    # Stable masks: IoU of the mask cut at logits +offset and -offset; the one lies in the other.
    h, w = logits.shape[-2:]
    rows, columns = (max(1, round(n * s)) for n, s in zip((h, w), encoded.shown, strict=True))
    seen = logits[:, :rows, :columns]
    tight = (seen > config.stability_score_offset).flatten(1).sum(1)
    wide = (seen > -config.stability_score_offset).flatten(1).sum(1)
    inside = seen > 0
    # Empty masks go here; small ones after scaling up, as a pixel here is several of the picture.
    good = (tight >= config.stability_score_thresh * wide) & inside.flatten(1).any(1)
    logits, scores, inside = logits[good], scores[good], inside[good]
    scale = torch.tensor(
        [(window.x1 - window.x0) / columns, (window.y1 - window.y0) / rows] * 2,
        device=logits.device,
    )
    boxes = boxes_of(inside) * scale
    # Masks that the crop's edge cuts are whole in another crop.
    good = ~_is_cut(boxes, window, size)
    return _Found(logits[good], scores[good], boxes[good])


def boxes_of(masks: Tensor) -> Tensor:
    """Bounding boxes (k, 4) x0 y0 x1 y1 (x1, y1 outside) of masks (k, h, w), none of them empty."""
    rows, columns = masks.any(2).to(torch.uint8), masks.any(1).to(torch.uint8)
    if len(masks) == 0:
        return torch.zeros((0, 4), device=masks.device)
    x0, y0 = columns.argmax(1), rows.argmax(1)
    x1 = columns.shape[1] - columns.flip(1).argmax(1)
    y1 = rows.shape[1] - rows.flip(1).argmax(1)
    return torch.stack([x0, y0, x1, y1], dim=1).float()


def _is_cut(boxes: Tensor, window: _Window, size: tuple[int, int]) -> Tensor:
    """Whether a mask reaches an edge of its window (k,) that is not one of the picture."""
    height, width = size
    cut = torch.zeros(len(boxes), dtype=torch.bool, device=boxes.device)
    if window.x0 > 0:
        cut |= boxes[:, 0] <= _EDGE
    if window.y0 > 0:
        cut |= boxes[:, 1] <= _EDGE
    if window.x1 < width:
        cut |= boxes[:, 2] >= window.x1 - window.x0 - _EDGE
    if window.y1 < height:
        cut |= boxes[:, 3] >= window.y1 - window.y0 - _EDGE
    return cut


@torch.inference_mode()
def _survivors(
    encoded: Encoded,
    found: list[_Found],
    window: _Window,
    size: tuple[int, int],
    config: GeneratorConfig,
) -> ScoredMasks:
    """The masks of a window without duplicates, at the picture's size and place."""
    logits = torch.cat([part.logits for part in found])
    scores = torch.cat([part.scores for part in found])
    boxes = torch.cat([part.boxes for part in found])
    # Duplicates inside a crop: non-maximum suppression of boxes, by predicted IoU.
    kept = non_maximum_suppression(boxes, scores, config.box_nms_thresh)
    # Survivors at the picture's size, without small ones.
    least = max(1.0, config.min_area * size[0] * size[1])
    places: list[tuple[int, int, int, int]] = []
    crops: list[BoolArray] = []
    values: list[float] = []
    for start in range(0, len(kept), _UPSCALE_AT_ONCE):
        chosen = kept[start : start + _UPSCALE_AT_ONCE]
        masks = (encoded.upscale(logits[chosen]) > 0).cpu().numpy()
        for mask, score in zip(masks, scores[chosen].tolist(), strict=True):
            if np.count_nonzero(mask) < least:
                continue
            rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
            x0, y0, x1, y1 = columns[0], rows[0], columns[-1] + 1, rows[-1] + 1
            places.append((x0 + window.x0, y0 + window.y0, x1 + window.x0, y1 + window.y0))
            crops.append(mask[y0:y1, x0:x1].copy())
            values.append(score)
    boxes_ = np.array(places, np.int32).reshape(-1, 4)
    return ScoredMasks(*size, boxes_, tuple(crops), np.array(values, np.float32))


def _merge(
    parts: list[ScoredMasks], windows: list[_Window], config: GeneratorConfig
) -> ScoredMasks:
    """One set of masks; of duplicates in several windows that of the smallest window stays."""
    if len(parts) == 1:
        return parts[0]
    boxes = np.concatenate([part.boxes for part in parts])
    areas = [(w.x1 - w.x0) * (w.y1 - w.y0) for w in windows]
    nearness = np.repeat(1.0 / np.array(areas), [len(part) for part in parts])
    kept = non_maximum_suppression(
        torch.from_numpy(boxes).float(), torch.from_numpy(nearness), config.box_nms_thresh
    ).numpy()
    scores = np.concatenate([part.scores for part in parts])
    order = kept[np.argsort(-scores[kept], kind="stable")]
    crops = [crop for part in parts for crop in part.crops]
    whole = (parts[0].height, parts[0].width)
    return ScoredMasks(*whole, boxes[order], tuple(crops[i] for i in order), scores[order])
