"""Where splats' centres are drawn, and which of them a stroke covers."""

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray, UInt8Array
from gaga_core.kernels import kernel


@kernel
def project_centres(
    means: FloatArray,  # (N, 3) file
    state: UInt8Array,  # (N,)
    unwanted: int,  # state bits that take a splat out
    placement: IntArray,  # (N,)
    poses: DoubleArray,  # (P, 3, 4) cam_from_file of each placement
    lens: DoubleArray,  # (4,) fx, fy, cx, cy
    surface: FloatArray,  # (H, W) median depth, or (0, 0): through everything
    slack: float,  # how far behind the surface still counts, relative
    near: float,
    width: int,
    height: int,
    pixel: IntArray,  # (N,) out: row * width + column, -1 = not to be selected here
    start: int,
    stop: int,
) -> None:
    """The pixel of each splat's centre."""
    for i in range(start, stop):
        pixel[i] = -1
        if state[i] & unwanted:
            continue
        m = poses[placement[i]]
        x, y, z = float(means[i, 0]), float(means[i, 1]), float(means[i, 2])
        depth = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        if not depth > near:
            continue
        u = lens[0] * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / depth + lens[2]
        v = lens[1] * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / depth + lens[3]
        if not (u >= 0.0 and v >= 0.0 and u < width and v < height):
            continue
        row, column = int(v), int(u)
        # Median depth 0: the pixel never became half opaque, so nothing there hides anything.
        if surface.size > 0:
            front = surface[row, column]
            if front != 0.0 and depth > front * (1.0 + slack):
                continue
        pixel[i] = row * width + column


@kernel
def covered(
    pixel: IntArray,  # (N,)
    mask: BoolArray,  # (H * W,)
    rows: IntArray,  # (N,) out: each chunk's rows packed at its start
    counts: LongArray,  # (C,) out: how many
    chunk: int,
    start: int,
    stop: int,
) -> None:
    """The splats whose pixel is set in ``mask``."""
    n = start
    for i in range(start, stop):
        at = pixel[i]
        if at >= 0 and mask[at]:
            rows[n] = i
            n += 1
    counts[start // chunk] = n - start


# --- Which splats the samples of the surfaces around them make chosen.


@kernel
def vote_of_samples(
    nearest: IntArray,  # (N, k) samples
    weights: FloatArray,  # (N, k) sum to 1
    chosen: BoolArray,  # (S,)
    result: BoolArray,  # (N,) out
    start: int,
    stop: int,
) -> None:
    """A splat is chosen when samples of more than half of the weight are."""
    for i in range(start, stop):
        total = 0.0
        for k in range(nearest.shape[1]):
            if chosen[nearest[i, k]]:
                total += weights[i, k]
        result[i] = total > 0.5
