"""Gradients of the reference in torch, by automatic differentiation."""

import numpy as np
import torch

from gaga_core.arrays import DoubleArray, FloatArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from tests import torch_reference

BACKGROUND = np.array([0.2, 0.5, 0.7])


def autograd(
    gaussians: Gaussians, camera: Camera, by_image: FloatArray, by_alpha: FloatArray
) -> dict[str, DoubleArray]:
    """Gradients of all columns, and of the centres ("shift"), by the float64 reference."""
    leaves = torch_reference.parameters(gaussians)
    image, alpha = torch_reference.render(
        leaves, camera, BACKGROUND, antialiased=gaussians.is_antialiased
    )
    total = (image * torch.tensor(by_image)).sum() + (alpha * torch.tensor(by_alpha)).sum()
    total.backward()  # type: ignore[no-untyped-call]
    return {name: torch_reference.gradient(leaf) for name, leaf in leaves.items()}
