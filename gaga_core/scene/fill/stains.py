"""Take the shadow of a removed object off the surface that it stood on."""

import numpy as np
from scipy import ndimage

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.color import LUMA
from gaga_core.scene.fill.chart import Chart
from gaga_core.scene.fill.smooth import blurred

_RIM = 4.0  # cells from the hole: a shadow is seen there
_SHADOW = 1.1  # usual factor there under which nothing is a shadow
_EVIDENCE = 3.0  # times darker than the surface varies: so much a shadow is at least
_DARKEST = 85  # percentile of how dark the surroundings are: so dark it is at least
_LEAST = 1.06  # gain under which nothing is changed
_MOST = 4.0
_BRIGHT = 85  # percentile of the surroundings: nothing is made brighter than that
_DARK = 0.02  # color that counts as black


def gains(chart: Chart) -> DoubleArray:
    """Factors (H, W, 3) by which known cells are too dark next to the hole; 1 elsewhere.

    Light on a surface is taken to be even over the chart but for a linear trend; the stain is
    what is darker than that, and hangs together with the hole. Texture is not: it is finer than
    the blur, or does not touch. There is no stain where the rim of the hole is hardly darker than
    the surface varies elsewhere.
    """
    ones = np.ones((*chart.shape, 3))
    if not chart.hole.any() or not chart.known.any():
        return ones
    size = np.sqrt(chart.hole.sum())
    low = blurred(np.maximum(chart.color, _DARK), chart.known.astype(float), max(1.2, size / 16))
    distance = ndimage.distance_transform_edt(~chart.hole)
    far = chart.known & (distance > 0.5 * size)
    if far.sum() < 30:
        return ones
    log = np.log(np.maximum(low, _DARK))
    light = _fitted(log, far)
    light = np.minimum(light, np.percentile(log[far], _BRIGHT, axis=0))
    ratio = np.exp(light - log)
    dark = (light - log) @ LUMA
    spread = 1.4826 * float(np.median(np.abs(dark[far] - np.median(dark[far]))))
    rim = chart.known & (distance > 1) & (distance <= _RIM)
    least = max(np.log(_SHADOW), _EVIDENCE * spread, np.percentile(dark[far], _DARKEST))
    if not rim.any() or np.median(dark[rim]) < least:
        return ones
    stained = chart.known & (ratio @ LUMA > max(_LEAST, np.exp(spread)))
    parts, _ = ndimage.label(stained | chart.hole)
    touched = np.unique(parts[chart.hole])
    stained &= np.isin(parts, touched)
    fade = np.clip(2.0 - distance / max(size, 1.0), 0, 1)[:, :, None]
    # A bright cell next to a dark one is not made brighter than the light allows.
    fine = blurred(np.maximum(chart.color, _DARK), chart.known.astype(float), 0.7)
    room = np.maximum(np.exp(light) / np.maximum(fine, _DARK), 1.0)
    result = np.clip(1 + (np.minimum(ratio, room) - 1) * fade, 1.0, _MOST)
    soft = ndimage.gaussian_filter(stained.astype(float), 1.0)[:, :, None]
    factors: DoubleArray = 1 + (result - 1) * soft
    return factors


def _fitted(log: DoubleArray, far: BoolArray) -> DoubleArray:
    """Linear trend of ``log`` (H, W, 3) over the cells ``far``, those of upper luminance first."""
    rows, columns = np.indices(far.shape) / max(far.shape)
    terms = np.stack([np.ones(far.shape), rows, columns], axis=2)
    use = far.copy()
    for _ in range(4):
        fit = np.linalg.lstsq(terms[use], log[use], rcond=None)[0]
        left = (log - terms @ fit) @ LUMA
        spread = left[use].std() + 1e-9
        use = far & (left > -spread) & (left < 2 * spread)
        if use.sum() < 30:
            break
    result: DoubleArray = terms @ fit
    return result
