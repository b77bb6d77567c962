"""A Segment Anything model that is asked for one thing: points on it and off it -> masks."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch.nn import Module

from gaga_core.arrays import BoolArray, FloatArray, UInt8Array, check_shape
from gaga_core.segmentation.generator import Encoded
from gaga_core.segmentation.sam import sam_encoder


@dataclass(frozen=True, eq=False)
class Candidates:
    """Masks of one thing (whole, part, subpart), the best first."""

    masks: BoolArray  # (k, H, W)
    scores: FloatArray  # (k,) IoU that the model predicts


class Prompter(Protocol):
    """Asked for a thing in a picture."""

    def __call__(self, image: UInt8Array, points: FloatArray, is_on: BoolArray) -> Candidates:
        """Masks in ``image`` (H, W, 3) of the thing at ``points`` (n, 2) x, y in pixels, of which
        ``is_on`` (n,) are on it and the others off it; at least one is on it."""
        ...


class SamPrompter:
    """The model is loaded at the first call."""

    def __init__(self, load: Callable[[], Module], device: torch.device) -> None:
        self._load, self._device = load, device
        self._model: Module | None = None

    def __call__(self, image: UInt8Array, points: FloatArray, is_on: BoolArray) -> Candidates:
        """Ask the model. ``ValueError`` for wrong shapes and without a point on the thing."""
        check_shape("image", image, ("H", "W", 3), np.uint8)
        check_shape("points", points, (len(is_on), 2), np.float32)
        if not is_on.any():
            raise ValueError("is_on: expected at least one point on the thing")
        encoded = self._encoded(image)
        logits, scores = encoded.prompt(points, is_on)
        order = torch.argsort(scores, descending=True, stable=True)
        masks = encoded.upscale(logits[order].float()) > 0
        return Candidates(masks.cpu().numpy(), scores[order].float().cpu().numpy())

    def in_boxes(self, image: UInt8Array, corners: FloatArray) -> BoolArray:
        """Masks (n, H, W) of the things in boxes (n, 4) left, top, right, bottom, pixels of
        ``image`` (H, W, 3): the single mask that the model gives a box."""
        check_shape("image", image, ("H", "W", 3), np.uint8)
        check_shape("corners", corners, ("n", 4), np.float32)
        if len(corners) == 0:
            return np.zeros((0, *image.shape[:2]), np.bool_)
        encoded = self._encoded(image)
        masks: BoolArray = (encoded.upscale(encoded.boxes(corners).float()) > 0).cpu().numpy()
        return masks

    def _encoded(self, image: UInt8Array) -> Encoded:
        if self._model is None:
            self._model = self._load().to(self._device)
        return sam_encoder(self._model)(image)
