"""Places of points along a Hilbert curve: neighbours on the curve are neighbours in space."""

import numpy as np

from gaga_core.arrays import FloatArray
from gaga_core.kernels import exact_kernel

BITS = 21  # an axis: three of them fit into 63 bits


@exact_kernel
def hilbert_keys(
    means: FloatArray,  # (N, 3)
    centre: FloatArray,  # (3,)
    half: float,  # half the side of the cube that most points lie in
    keys: np.ndarray,  # (N,) uint64 out
    start: int,
    stop: int,
) -> None:
    """Hilbert keys of rows start..stop (Skilling 2004, Programming the Hilbert curve).

    The cube takes half of the curve's range on each axis; what lies outside is drawn in by
    2 - 1 / x, so that far points keep their order (the contraction of Barron 2022, axis by axis).
    """
    top = np.uint32(1 << (BITS - 1))
    most = float((1 << BITS) - 1)
    x = np.empty(3, np.uint32)
    for i in range(start, stop):
        for a in range(3):
            u = (float(means[i, a]) - float(centre[a])) / half
            if u > 1.0:
                u = 2.0 - 1.0 / u
            elif u < -1.0:
                u = -2.0 - 1.0 / u
            x[a] = np.uint32(min(max((u + 2.0) * 0.25, 0.0), 1.0) * most)
        q = top
        while q > 1:
            p = np.uint32(q - 1)
            for a in range(3):
                if x[a] & q:
                    x[0] ^= p
                else:
                    t = (x[0] ^ x[a]) & p
                    x[0] ^= t
                    x[a] ^= t
            q >>= np.uint32(1)
        x[1] ^= x[0]
        x[2] ^= x[1]
        t = np.uint32(0)
        q = top
        while q > 1:
            if x[2] & q:
                t ^= np.uint32(q - 1)
            q >>= np.uint32(1)
        key = np.uint64(0)
        for a in range(3):
            x[a] ^= t
        for b in range(BITS - 1, -1, -1):
            for a in range(3):
                bit = (x[a] >> np.uint32(b)) & np.uint32(1)
                key = (key << np.uint64(1)) | np.uint64(bit)
        keys[i] = key
