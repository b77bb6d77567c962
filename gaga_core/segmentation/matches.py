"""Matches between two photos by a learned model: EfficientLoFTR (Wang 2024), without a detector.

It finds what photos share where their angles or shine are too much for SIFT. Its matches are
verified by two-view geometry as all others are.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np
from PIL import Image

from gaga_core.arrays import DoubleArray, FloatArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.segmentation.models.weights import model_type_of

if TYPE_CHECKING:
    import torch

    from gaga_core.segmentation.settings import Device

_TYPE = "efficientloftr"
_STEP = 32  # pixels: sides of a picture are multiples of this, by the strides of the network
_GRAY = np.array([0.2989, 0.5870, 0.1140], np.float32)  # of the model's own preprocessing (NTSC)


@dataclass(frozen=True, eq=False)
class PairMatches:
    """What two photos share."""

    first: DoubleArray  # (M, 2) pixels of the first photo, the middle of the first pixel at 0.5
    second: DoubleArray  # (M, 2)
    scores: FloatArray  # (M,) 0..1


class _Network(Protocol):
    device: "torch.device"

    def __call__(self, *, pixel_values: "torch.Tensor") -> "_Output": ...


class _Output(Protocol):
    matches: "torch.Tensor"  # (1, 2, N) -1 = none
    matching_scores: "torch.Tensor"  # (1, 2, N)
    keypoints: "torch.Tensor"  # (1, 2, N, 2) shares of width and height


@dataclass(frozen=True, eq=False)
class Matcher:
    """A model that was loaded."""

    network: _Network
    side: int  # longest side, pixels, at which it looks at photos

    def match(self, first: UInt8Array, second: UInt8Array) -> PairMatches:
        """Match two pictures (H, W, 3); the second is looked at in the size of the first."""
        import torch

        height, width = first.shape[:2]
        times = min(self.side / max(height, width), 1.0)
        size = [max(round(n * times / _STEP), 2) * _STEP for n in (width, height)]
        looks = [np.asarray(Image.fromarray(p).resize(size), np.float32) for p in (first, second)]
        gray = np.stack([look @ _GRAY / 255 for look in looks])[None, :, None]
        pixels = torch.from_numpy(np.repeat(gray.astype(np.float32), 3, axis=2))
        with torch.inference_mode():
            found = self.network(pixel_values=pixels.to(self.network.device))
        scores = found.matching_scores[0].float().cpu().numpy()
        is_match = ((scores > 0) & (found.matches[0].cpu().numpy() > -1)).all(axis=0)
        places = found.keypoints[0].double().cpu().numpy()[:, is_match]
        sizes = [picture.shape[1::-1] for picture in (first, second)]
        return PairMatches(places[0] * sizes[0], places[1] * sizes[1], scores[0, is_match])


def load_matcher(folder: Path, side: int, device: "Device" = "auto") -> Matcher:
    """The EfficientLoFTR in ``folder`` (as transformers saves it).

    Raises ``GagaError`` when transformers is missing, or the folder holds no such model.
    """
    # Loaded with the first model: torch and transformers take seconds.
    from gaga_core.segmentation.loading import choose_device, load_folder

    if (found := model_type_of(folder)) != _TYPE:
        raise GagaError(
            f"The model in {folder} is of type {found or 'unknown'}, which matches no photos here. "
            "Choose an EfficientLoFTR model."
        )
    model = load_folder("keypoint_matches", folder).to(choose_device(device))
    _align(cast(_Scored, model))
    return Matcher(cast(_Network, model), side)


class _Scored(Protocol):
    _get_matches_from_scores: Callable[["torch.Tensor"], tuple["torch.Tensor", "torch.Tensor"]]


def _align(model: _Scored) -> None:
    """Make both rows of the model's coarse matches speak of the same pairs.

    In transformers 5 row 0 is by cells of the second photo and row 1 by cells of the first, while
    the refinement takes them side by side and joins cells that do not match.
    """
    import torch

    by_cell = model._get_matches_from_scores

    def pairs(scores: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        indices, sure = by_cell(scores)
        second = indices[:, 1]  # (1, N) of each cell of the first photo
        cells = torch.arange(second.shape[1], device=second.device).expand_as(second)
        first = torch.where(second >= 0, cells, -1)
        return torch.stack([first, second], dim=1), sure[:, 1:].expand_as(sure)

    model._get_matches_from_scores = pairs
