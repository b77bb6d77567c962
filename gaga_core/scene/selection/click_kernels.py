"""Which splats the samples of the surfaces around them make chosen."""

from gaga_core.arrays import BoolArray, FloatArray, IntArray
from gaga_core.kernels import kernel


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
