"""Kernel that keeps every Gaussian's own label while its encoding is fitted."""

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.identity.linear_kernels import D
from gaga_core.kernels import kernel


@kernel
def keep_labels(
    encodings: FloatArray,  # (N, D) changed in place
    codes: FloatArray,  # (K, D) unit length
    labels: IntArray,  # (N,)
    margin: float,  # least lead of the label's score
    start: int,
    stop: int,
) -> None:
    """Move encodings back towards their label's code until that code scores highest by a margin."""
    for i in range(start, stop):
        label = labels[i]
        e, own = encodings[i], codes[label]
        share = 1.0  # of the way from the code to the encoding
        for k in range(codes.shape[0]):
            if k == label:
                continue
            at_code, here = 0.0, 0.0  # lead of the label over k
            for c in range(D):
                lead = own[c] - codes[k, c]
                at_code += lead * own[c]
                here += lead * e[c]
            least = min(margin, 0.5 * at_code)
            if here < least:
                share = min(share, (at_code - least) / (at_code - here))
        if share < 1.0:
            for c in range(D):
                e[c] = own[c] + share * (e[c] - own[c])
