"""Boxes, areas and run lengths of all objects of a picture, straight from its labels and bits."""

from gaga_core.arrays import IntArray, LongArray, UInt8Array, UInt64Array
from gaga_core.kernels import kernel


@kernel
def tally_objects(
    starts: LongArray,  # (R + 1,) where runs of the picture begin, column by column, and its end
    labels: IntArray,  # (R,) seen label of each run
    bits: UInt64Array,  # (R, words) bit k % 64 of word k // 64: object k
    height: int,  # no run goes over the end of a column
    rows: IntArray,  # object k of each label, -1 = none
    seen: LongArray,  # (K, 5) area, top, left, bottom, right: zeros, then H, W, 0, 0
    whole: LongArray,  # (K, 5)
) -> None:
    """Count the pixels of each object, seen and whole, and the box around them."""
    n_runs, n_words = bits.shape
    for i in range(n_runs):
        x = starts[i] // height
        start, stop = starts[i] - x * height, starts[i + 1] - x * height
        for word in range(n_words):
            left, k = bits[i, word], 64 * word
            while left:
                while not left & 1:
                    left >>= 1
                    k += 1
                _count(whole[k], x, start, stop)
                left >>= 1
                k += 1
        k = rows[labels[i]]
        if k >= 0:
            _count(seen[k], x, start, stop)


@kernel
def _count(row: LongArray, x: int, start: int, stop: int) -> None:
    row[0] += stop - start
    row[1], row[2] = min(row[1], start), min(row[2], x)
    row[3], row[4] = max(row[3], stop), max(row[4], x + 1)


@kernel
def run_lengths(
    starts: LongArray,  # (R + 1,) as in `tally_objects`
    labels: IntArray,  # (R,)
    bits: UInt64Array,  # (R, words)
    label: int,  # >= 0: pixels of that label; -1: of object k
    k: int,
    first: int,  # the mask is in the runs ``first`` to ``last``
    last: int,
    text: UInt8Array,  # room for the answer
) -> int:
    """COCO's compressed run lengths of one mask into ``text``; how many characters."""
    word, bit = k // 64, k % 64
    before_last, before, n_runs, n = 0, 0, 0, 0
    run, value = starts[first], False
    for i in range(first, last):
        here = labels[i] == label if label >= 0 else bool(bits[i, word] >> bit & 1)
        if here != value:
            before_last, before, n_runs, n = _put(text, n, run, before_last, before, n_runs)
            run, value = 0, here
        run += starts[i + 1] - starts[i]
    if value and last < len(labels):
        before_last, before, n_runs, n = _put(text, n, run, before_last, before, n_runs)
        run = 0
    run += starts[-1] - starts[last]
    if run > 0 or n_runs == 0:
        _, _, _, n = _put(text, n, run, before_last, before, n_runs)
    return n


@kernel
def _put(
    text: UInt8Array, n: int, run: int, before_last: int, last: int, n_runs: int
) -> tuple[int, int, int, int]:
    """Append a count as `io.masks.coco.compress_counts` does; the new state."""
    value = run - before_last if n_runs > 2 else run
    while True:
        digit = value & 0x1F
        value >>= 5
        more = value != -1 if digit & 0x10 else value != 0
        text[n] = digit + (0x20 if more else 0) + 48
        n += 1
        if not more:
            break
    return last, run, n_runs + 1, n
