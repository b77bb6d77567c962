"""What has been done to the splats of each node of level 0."""

from gaga_core.arrays import BoolArray, IntArray, UInt8Array
from gaga_core.kernels import kernel


@kernel
def leaf_facts(
    order: IntArray,  # (N,) rows
    state: UInt8Array,
    placement: IntArray,
    bits: int,  # of a state byte that count
    unseen: int,  # those of them that hide a splat
    node: int,  # splats of a node
    mixed: BoolArray,  # (K,) out: splats differ in state or placement
    torn: BoolArray,  # (K,) out: some are hidden and some not, or they were placed differently
    states: UInt8Array,  # (K,) out: bits of the first splat
    found: IntArray,  # (K, C) out: different placements
    n_found: IntArray,  # (K,) out; C + 1 = more than C
    start: int,
    stop: int,
) -> None:
    """Facts of the nodes start..stop."""
    n, most = order.shape[0], found.shape[1]
    for k in range(start, stop):
        first = order[k * node]
        mixed[k] = torn[k] = False
        states[k] = state[first] & bits
        found[k, 0] = placement[first]
        n_found[k] = 1
        last = placement[first]
        for j in range(k * node, min((k + 1) * node, n)):
            row = order[j]
            if state[row] & bits != states[k]:
                mixed[k] = True
                torn[k] |= (state[row] ^ states[k]) & unseen != 0
            p = placement[row]
            if p == last:
                continue
            last = p
            mixed[k] = torn[k] = True
            is_known = False
            for c in range(min(n_found[k], most)):
                is_known |= found[k, c] == p
            if not is_known:
                if n_found[k] < most:
                    found[k, n_found[k]] = p
                n_found[k] = min(n_found[k] + 1, most + 1)
