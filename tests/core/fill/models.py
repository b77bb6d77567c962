"""Small inpainting models, saved as LaMa is published: TorchScript of an image and a mask."""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import torch
from torch import Tensor

from gaga_core.fill import inpaint


class Red(torch.nn.Module):
    """Paints red, and half of it what it must not touch."""

    def forward(self, image: Tensor, mask: Tensor) -> Tensor:
        red = torch.zeros_like(image)
        red[:, 0] = 1.0
        return torch.where(mask > 0.5, red, 0.5 * image)


class Mean(torch.nn.Module):
    """Paints the mean of what is known, and takes nothing but what LaMa takes."""

    def forward(self, image: Tensor, mask: Tensor) -> Tensor:
        if image.size(2) % 8 != 0 or image.size(3) % 8 != 0 or mask.size(1) != 1:
            raise RuntimeError("sides that 8 divides are expected")
        known = 1 - mask
        mean = (image * known).sum(dim=[2, 3], keepdim=True) / known.sum()
        return image * known + mean * mask


class NotANumber(torch.nn.Module):
    def forward(self, image: Tensor, mask: Tensor) -> Tensor:
        return image / torch.zeros_like(mask)


class Half(torch.nn.Module):
    """Returns a picture of half the size."""

    def forward(self, image: Tensor, mask: Tensor) -> Tensor:
        return image[:, :, ::2, ::2]


class Bytes(torch.nn.Module):
    """Returns colors of 0 to 255."""

    def forward(self, image: Tensor, mask: Tensor) -> Tensor:
        return torch.full_like(image, 255.0)


class Pair(torch.nn.Module):
    def forward(self, image: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        return image, mask


class Endless(torch.nn.Module):
    def forward(self, image: Tensor, mask: Tensor) -> Tensor:
        n = 1
        while n > 0:
            n = n % 7 + 1
        return image


class ImageOnly(torch.nn.Module):
    def forward(self, image: Tensor) -> Tensor:
        return image


def saved(model: torch.nn.Module, path: Path) -> Path:
    """The file ``path`` with ``model``."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # the form of published models stays
        torch.jit.script(model).save(str(path))  # type: ignore[no-untyped-call]
    return path


@contextmanager
def no_torch() -> Iterator[None]:
    """As on a machine without PyTorch."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "torch", None)
        inpaint.why_no_model.cache_clear()
        yield
    inpaint.why_no_model.cache_clear()
