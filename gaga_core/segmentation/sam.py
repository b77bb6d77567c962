"""Segment Anything models of transformers: SAM, SAM-HQ, SAM 2 and 2.1, the tracker of SAM 3.

Pictures are prepared here with pillow, since the image processors of transformers need torchvision
for most of these models.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np
import torch
from torch import Tensor
from torch.nn import Module
from torch.nn.functional import interpolate, pad

from gaga_core.arrays import BoolArray, FloatArray, UInt8Array, check_shape
from gaga_core.errors import GagaError
from gaga_core.segmentation.base import MaskMaker
from gaga_core.segmentation.generator import Encoded, Encoder, generate
from gaga_core.segmentation.loading import normalized
from gaga_core.segmentation.settings import GeneratorConfig

if TYPE_CHECKING:
    from transformers import PreTrainedModel


_IMAGENET = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
_HALF = ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5))
_PADDED = ("sam", "sam_hq")  # longest side to the model's, rest filled; the others are stretched


def load_sam(
    load: Callable[[], Module], generator: GeneratorConfig, device: torch.device
) -> MaskMaker:
    """What makes masks with the model that ``load`` reads; progress counts points."""
    return partial(generate, sam_encoder(load().to(device)), config=generator)


def sam_encoder(module: Module) -> Encoder:
    """How a model of this family encodes a picture. ``GagaError`` for other models."""
    model = cast("PreTrainedModel", module)
    kind = str(model.config.model_type)
    if not kind.startswith("sam"):
        raise GagaError(f"A model of type {kind} is no Segment Anything model. Choose another one.")
    side = _side(model.config.prompt_encoder_config.image_size)
    mean, std = _HALF if kind.startswith("sam3") else _IMAGENET
    is_padded = kind in _PADDED

    @torch.inference_mode()
    def encode(image: UInt8Array) -> Encoded:
        height, width = image.shape[:2]
        inner_h, inner_w = fitted(height, width, side) if is_padded else (side, side)
        pixels = normalized(image, inner_w, inner_h, mean, std)
        pixels = pad(pixels, (0, side - inner_w, 0, side - inner_h))
        parameter = next(model.parameters())
        found = _embed(model, pixels.to(parameter.device, parameter.dtype), kind)
        scale = torch.tensor([inner_w / width, inner_h / height])

        def placed(corners: FloatArray) -> Tensor:
            """Points (..., 2) or boxes (..., 4) of the picture as the model takes them."""
            at = torch.from_numpy(corners) * scale.repeat(corners.shape[-1] // 2)
            return at[None].to(parameter.device, parameter.dtype)

        @torch.inference_mode()
        def decode(points: FloatArray) -> tuple[Tensor, Tensor]:
            at = placed(points[:, None])
            ones = torch.ones(at.shape[:3], dtype=torch.long, device=parameter.device)
            out = model(input_points=at, input_labels=ones, multimask_output=True, **found)
            return out.pred_masks[0], out.iou_scores[0]

        @torch.inference_mode()
        def prompt(points: FloatArray, is_on: BoolArray) -> tuple[Tensor, Tensor]:
            signs = torch.from_numpy(is_on.astype(np.int64))[None, None].to(parameter.device)
            out = model(
                input_points=placed(points[None]),
                input_labels=signs,
                multimask_output=True,
                **found,
            )
            return out.pred_masks[0, 0], out.iou_scores[0, 0]

        @torch.inference_mode()
        def boxes(corners: FloatArray) -> Tensor:
            out = model(input_boxes=placed(corners), multimask_output=False, **found)
            return cast(Tensor, out.pred_masks[0, :, 0])

        def upscale(logits: Tensor) -> Tensor:
            values = logits[:, None]
            if is_padded:
                values = _bilinear(values, side, side)[..., :inner_h, :inner_w]
            return _bilinear(values, height, width)[:, 0]

        return Encoded(decode, upscale, (inner_h / side, inner_w / side), prompt, boxes)

    return encode


def fitted(height: int, width: int, longest: int) -> tuple[int, int]:
    """Height and width with ``longest`` as the longer side, as SAM rounds them."""
    scale = longest / max(height, width)
    return max(1, int(height * scale + 0.5)), max(1, int(width * scale + 0.5))


def _embed(model: "PreTrainedModel", pixels: Tensor, kind: str) -> dict[str, Tensor | list[Tensor]]:
    """What the model's decoder needs of the picture, by argument name."""
    embed = cast("Callable[[Tensor], list[Tensor]]", model.get_image_embeddings)
    found = embed(pixels)
    if kind == "sam_hq":
        return {"image_embeddings": found[0], "intermediate_embeddings": found[1]}
    return {"image_embeddings": found}


def _bilinear(values: Tensor, height: int, width: int) -> Tensor:
    return interpolate(values, (height, width), mode="bilinear", align_corners=False)


def _side(size: int | list[int] | tuple[int, int]) -> int:
    return size if isinstance(size, int) else int(size[0])


# --- Segment one object with a Segment Anything model: points on it and off it -> masks.


@dataclass(frozen=True, eq=False)
class Candidates:
    """Masks of one object (whole, part, subpart), the best first."""

    masks: BoolArray  # (k, H, W)
    scores: FloatArray  # (k,) IoU that the model predicts


class Prompter(Protocol):
    """Segments one object of a picture."""

    def __call__(self, image: UInt8Array, points: FloatArray, is_on: BoolArray) -> Candidates:
        """Masks in ``image`` (H, W, 3) of the object at ``points`` (n, 2) x, y in pixels, of which
        ``is_on`` (n,) are on it and the others off it; at least one is on it."""
        ...


class SamPrompter:
    """The model is loaded at the first call."""

    def __init__(self, load: Callable[[], Module], device: torch.device) -> None:
        self._load, self._device = load, device
        self._model: Module | None = None

    def __call__(self, image: UInt8Array, points: FloatArray, is_on: BoolArray) -> Candidates:
        """Ask the model. ``ValueError`` for wrong shapes and without a point on the object."""
        check_shape("image", image, ("H", "W", 3), np.uint8)
        check_shape("points", points, (len(is_on), 2), np.float32)
        if not is_on.any():
            raise ValueError("is_on: expected at least one point on the object")
        encoded = self._encoded(image)
        logits, scores = encoded.prompt(points, is_on)
        order = torch.argsort(scores, descending=True, stable=True)
        masks = encoded.upscale(logits[order].float()) > 0
        return Candidates(masks.cpu().numpy(), scores[order].float().cpu().numpy())

    def in_boxes(self, image: UInt8Array, corners: FloatArray) -> BoolArray:
        """Masks (n, H, W) of the objects in boxes (n, 4) left, top, right, bottom, pixels of
        ``image`` (H, W, 3): the single mask that the model gives a box."""
        check_shape("image", image, ("H", "W", 3), np.uint8)
        check_shape("corners", corners, ("n", 4), np.float32)
        if len(corners) == 0:
            return np.zeros((0, *image.shape[:2]), np.bool_)
        encoded = self._encoded(image)
        return (encoded.upscale(encoded.boxes(corners).float()) > 0).cpu().numpy()

    def _encoded(self, image: UInt8Array) -> Encoded:
        if self._model is None:
            self._model = self._load().to(self._device)
        return sam_encoder(self._model)(image)
