"""Rows of a .ply out of the columns of a model: half the time of one numpy copy a column."""

from gaga_core.arrays import FloatArray
from gaga_core.kernels import exact_kernel


@exact_kernel
def pack_rows(
    means: FloatArray,
    sh: FloatArray,
    logit_opacities: FloatArray,
    log_scales: FloatArray,
    quats: FloatArray,
    points: FloatArray,
    values: FloatArray,
) -> None:
    """Fill ``points`` (B, 3), x y z, and ``values`` (B, 3 * S + 8) of the same rows.

    Values: SH DC, the other SH channel by channel, opacity, scales, quaternion. ``sh`` is (B, S, 3)
    with the color last. All float32, bit for bit.
    """
    n_rest = sh.shape[1] - 1
    for i in range(len(means)):
        for k in range(3):
            points[i, k] = means[i, k]
            values[i, k] = sh[i, 0, k]
        at = 3
        for channel in range(3):
            for k in range(n_rest):
                values[i, at + k] = sh[i, 1 + k, channel]
            at += n_rest
        values[i, at] = logit_opacities[i]
        for k in range(3):
            values[i, at + 1 + k] = log_scales[i, k]
        for k in range(4):
            values[i, at + 4 + k] = quats[i, k]
