"""The antialiased (mip) look: one model in the fast rasterizer, the readable one, and picking."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.gaussians import Gaussians
from gaga_core.raster import choose
from gaga_core.raster.reference import ReferenceRasterizer
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.by_screen import pick
from tests.scenes import orbit_cameras, random_gaussians

CAMERA = orbit_cameras(1, width=48, height=36)[0]


def _mip(n: int = 300) -> Gaussians:
    """Most splats are smaller than a pixel."""
    gaussians = random_gaussians(n, sh_degree=1)
    logs = gaussians.log_scales - np.float32(1.0)
    return replace(gaussians, log_scales=logs, comments=("SplatRenderMode: mip",))


def test_the_fast_rasterizer_agrees_with_the_reference() -> None:
    fast, exact = (r.render(_mip(), CAMERA) for r in (choose("cpu"), ReferenceRasterizer()))
    assert np.abs(fast.image - exact.image).max() < 2e-3
    assert np.abs(fast.alpha - exact.alpha).max() < 2e-3


def test_the_look_is_another_picture_and_a_thinner_one() -> None:
    plain = choose("cpu").render(replace(_mip(), comments=()), CAMERA)
    mip = choose("cpu").render(_mip(), CAMERA)
    assert mip.alpha.mean() < 0.8 * plain.alpha.mean()
    assert (mip.alpha <= plain.alpha + 1e-4).mean() > 0.99
    large = replace(_mip(), log_scales=np.full((300, 3), -0.5, np.float32))  # they do not care
    plain = choose("cpu").render(replace(large, comments=()), CAMERA)
    assert np.abs(choose("cpu").render(large, CAMERA).image - plain.image).max() < 0.02


@pytest.mark.parametrize("override", [None, False, True])
def test_picking_sees_the_picture_of_its_look(override: bool | None) -> None:
    gaussians = replace(_mip(4000), comments=()) if override else _mip(4000)
    shown = replace(gaussians, comments=() if override is False else ("antialiased 1",))
    pixels = np.arange(0, CAMERA.width * CAMERA.height, 37)
    rows = choose("cpu").weights(shown, CAMERA, pixels)
    for k, pixel in enumerate(pixels):
        v, u = divmod(int(pixel), CAMERA.width)
        found = pick(Scene.of(gaussians), CAMERA, u + 0.5, v + 0.5, antialiased=override)
        wanted = rows.indices[rows.indptr[k] : rows.indptr[k + 1]]
        got = found.indices if found is not None else np.zeros(0, np.int32)
        weights = found.weights if found is not None else np.zeros(0)
        clear = got[weights > 1e-3]  # the rest may fall on either side of 1/255
        assert np.isin(clear, wanted).all()
        assert len(np.setdiff1d(wanted, got)) <= 1


def test_the_look_is_said_once_and_other_comments_stay() -> None:
    gaussians = replace(_mip(4), comments=("made by hand", "antialiased: 1"))
    classic = gaussians.with_antialiasing(False)
    assert (classic.comments, classic.is_antialiased) == (("made by hand",), False)
    again = classic.with_antialiasing(True)
    assert again.is_antialiased
    assert again.with_antialiasing(True) is again
    assert again.with_antialiasing(False).comments == classic.comments


def test_what_is_sent_to_gsplat_has_the_look() -> None:
    import torch

    from gaga_core.raster.cuda.rasterizer import project_rows
    from gaga_core.raster.reference import blend

    gaussians = _mip(60)
    found = project_rows(gaussians, slice(None), CAMERA, torch.device("cpu"))
    opacities = dict(zip(found.index.tolist(), found.opacities.tolist(), strict=True))
    plain = 1 / (1 + np.exp(-gaussians.logit_opacities.astype(np.float64)))
    assert all(opacities[i] < 0.999 * plain[i] for i in opacities)
    # The first splat of a pixel is drawn with its alpha: the look's opacity where it is opaque.
    alone = {
        i: next(blend(gaussians.take(np.array([i])), CAMERA))[2].max() for i in list(opacities)[:20]
    }
    assert all(w <= opacities[i] + 1e-6 for i, w in alone.items())
    close = [w / opacities[i] for i, w in alone.items() if w > 0]
    assert max(close) > 0.95
