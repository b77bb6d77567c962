"""Loss, SSIM and PSNR against plain float64 versions."""

import numpy as np
import pytest
import torch

from gaga_core.arrays import AnyArray, FloatArray
from gaga_core.training.losses import photometric, psnr, ssim


def pictures(height: int, width: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(height)
    smooth = np.sin(np.arange(height)[:, None, None] / 3) * np.cos(np.arange(width)[:, None] / 5)
    target = np.clip(0.5 + 0.4 * smooth + rng.normal(0, 0.05, (height, width, 3)), 0, 1)
    image = target + rng.normal(0, 0.1, target.shape)
    return image.astype(np.float32), target.astype(np.float32)


def plain_ssim(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Mean SSIM of (H, W, 3) by one 2D convolution per map."""
    taps = torch.exp(-((torch.arange(11, dtype=torch.float64) - 5) ** 2) / (2 * 1.5**2))
    window = (taps[:, None] * taps / taps.sum() ** 2).expand(3, 1, 11, 11)

    def blur(x: torch.Tensor) -> torch.Tensor:
        planes = x.permute(2, 0, 1)[None]
        return torch.nn.functional.conv2d(planes, window, padding=5, groups=3)[0]

    ma, mb = blur(a), blur(b)
    aa, bb, ab = blur(a * a) - ma**2, blur(b * b) - mb**2, blur(a * b) - ma * mb
    top = (2 * ma * mb + 0.01**2) * (2 * ab + 0.03**2)
    return (top / ((ma**2 + mb**2 + 0.01**2) * (aa + bb + 0.03**2))).mean()


def as_double(image: AnyArray) -> torch.Tensor:
    return torch.tensor(image.astype(np.float64), requires_grad=True)


# Wider than a strip of the kernel, higher than a piece of work, smaller than the window.
@pytest.mark.parametrize(
    ("height", "width"), [(37, 51), (70, 170), (12, 530), (3, 4), (1, 1), (33, 75)]
)
@pytest.mark.parametrize("dissimilarity", [0.2, 0.0, 1.0])
def test_loss_and_gradient_are_those_of_torch(
    height: int, width: int, dissimilarity: float
) -> None:
    image, target = pictures(height, width)
    value, gradient = photometric(image, target, dissimilarity)
    a, b = as_double(image), as_double(target)
    apart = (a - b).abs().mean()
    want = (1 - dissimilarity) * apart + dissimilarity * (1 - plain_ssim(a, b))
    want.backward()  # type: ignore[no-untyped-call]
    assert a.grad is not None
    assert value == pytest.approx(want.item(), abs=1e-6)
    size = a.grad.norm().item()
    assert np.linalg.norm(gradient - a.grad.numpy()) <= 1e-5 * size


def test_ssim_is_one_for_equal_pictures_and_symmetric() -> None:
    image, target = pictures(48, 64)
    assert ssim(target, target) == pytest.approx(1, abs=1e-5)
    assert ssim(image, target) == pytest.approx(ssim(target, image), abs=1e-6)
    assert ssim(image, target) == pytest.approx(
        plain_ssim(as_double(image), as_double(target)).item(), abs=1e-6
    )
    value, gradient = photometric(target, target)
    assert value == pytest.approx(0, abs=1e-6)
    assert np.abs(gradient).max() < 1e-6


def test_psnr() -> None:
    target = np.full((4, 5, 3), 0.5, np.float32)
    assert psnr(target + np.float32(0.1), target) == pytest.approx(20, abs=1e-4)
    assert psnr(target, target) == float("inf")


def test_threads_and_layout_do_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    image, target = pictures(100, 90)
    monkeypatch.setenv("GAGA_THREADS", "1")
    want = photometric(image, target)
    monkeypatch.setenv("GAGA_THREADS", "5")
    for a, b in ((image, target), (np.asfortranarray(image), target[::-1][::-1])):
        value, gradient = photometric(a, b)
        assert value == want[0]
        np.testing.assert_array_equal(gradient, want[1])


def test_wrong_shapes_name_the_argument() -> None:
    image, target = pictures(8, 9)
    with pytest.raises(ValueError, match="image"):
        photometric(image[..., 0], target)
    with pytest.raises(ValueError, match="target"):
        photometric(image, target[:, 1:])
    with pytest.raises(ValueError, match="target"):
        psnr(image, target[1:])
