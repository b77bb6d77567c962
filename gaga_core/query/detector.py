"""Boxes of a phrase in a picture: Grounding DINO and OWLv2, from a local folder."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np
from PIL import Image

from gaga_core.arrays import FloatArray, UInt8Array
from gaga_core.query.model_files import load_model

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
    """What a detector found."""

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
