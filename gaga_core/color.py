"""Spherical harmonics of color, and the colors of groups."""

import colorsys

import numpy as np

from gaga_core.arrays import FloatArray, IntArray

SH_C0 = 0.28209479177387814  # Y_0^0; color = 0.5 + C0 * dc (3D Gaussian Splatting, Kerbl 2023)


def rgb_from_dc(dc: FloatArray) -> FloatArray:
    """Color (..., 3) of the degree-0 SH coefficient, not clipped."""
    result: FloatArray = (0.5 + SH_C0 * dc).astype(np.float32)
    return result


def dc_from_rgb(rgb: FloatArray) -> FloatArray:
    """Degree-0 SH coefficient (..., 3) of a color."""
    result: FloatArray = ((np.asarray(rgb) - 0.5) / SH_C0).astype(np.float32)
    return result


def group_palette(n_groups: int) -> FloatArray:
    """Colors (n_groups + 1, 3) of labels 0..n_groups: 0 is dark grey, the rest distinct.

    Stable by id: a group keeps its color when others come or go. Hue walks by the golden ratio;
    lightness and saturation cycle with coprime periods, so that neighbours in id also differ for
    eyes that do not tell hues apart.
    """
    golden = 0.618033988749895
    lightness = (0.62, 0.42, 0.74, 0.53)
    saturation = (0.78, 0.95, 0.62)
    colors = np.zeros((n_groups + 1, 3), np.float32)
    colors[0] = 0.22
    for i in range(1, n_groups + 1):
        hue = (0.57 + i * golden) % 1.0
        colors[i] = colorsys.hls_to_rgb(hue, lightness[i % 4], saturation[i % 3])
    return colors


def colorize_labels(labels: IntArray) -> FloatArray:
    """RGB picture (H, W, 3) of a label map (H, W)."""
    palette = group_palette(int(labels.max(initial=0)))
    result: FloatArray = palette[np.maximum(labels, 0)]
    return result
