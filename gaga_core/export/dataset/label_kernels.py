"""Boxes, areas and run lengths of all objects of a picture, straight from its labels and bits."""

from gaga_core.arrays import IntArray, LongArray, UInt8Array, UInt64Array
from gaga_core.kernels import kernel


@kernel
def tally_objects(
    labels: IntArray,  # (W, H) seen label, column by column
    bits: UInt64Array,  # (W, H, words) bit k % 64 of word k // 64: object k
    rows: IntArray,  # object k of each label, -1 = none
    seen: LongArray,  # (K, 5) area, top, left, bottom, right: zeros, then H, W, 0, 0
    whole: LongArray,  # (K, 5)
) -> None:
    """Count the pixels of each object, seen and whole, and the box around them.

    What is the same along a column is counted at once.
    """
    width, height, n_words = bits.shape
    for x in range(width):
        start = 0
        for y in range(1, height + 1):
            if y < height and labels[x, y] == labels[x, start]:
                is_same = True
                for word in range(n_words):
                    is_same &= bits[x, y, word] == bits[x, start, word]
                if is_same:
                    continue
            for word in range(n_words):
                left, k = bits[x, start, word], 64 * word
                while left:
                    while not left & 1:
                        left >>= 1
                        k += 1
                    _count(whole[k], x, start, y)
                    left >>= 1
                    k += 1
            k = rows[labels[x, start]]
            if k >= 0:
                _count(seen[k], x, start, y)
            start = y


@kernel
def _count(row: LongArray, x: int, start: int, stop: int) -> None:
    row[0] += stop - start
    row[1], row[2] = min(row[1], start), min(row[2], x)
    row[3], row[4] = max(row[3], stop), max(row[4], x + 1)


@kernel
def run_lengths(
    labels: IntArray,  # (W, H)
    bits: UInt64Array,  # (W, H, words)
    label: int,  # >= 0: pixels of that label; -1: of object k
    k: int,
    box: LongArray,  # (5,) of `tally_objects`
    text: UInt8Array,  # room for the answer
) -> int:
    """COCO's compressed run lengths of one mask into ``text``; how many characters."""
    width, height, _ = bits.shape
    word, bit = k // 64, k % 64
    before_last, last, n_runs, n = 0, 0, 0, 0
    run, value = box[2] * height, False  # down the columns; the ones left of the box are empty
    for x in range(box[2], box[4]):
        run += box[1]
        if value and box[1] > 0:
            before_last, last, n_runs, n = _put(text, n, run - box[1], before_last, last, n_runs)
            run, value = box[1], False
        for y in range(box[1], box[3]):
            here = labels[x, y] == label if label >= 0 else bool(bits[x, y, word] >> bit & 1)
            if here != value:
                before_last, last, n_runs, n = _put(text, n, run, before_last, last, n_runs)
                run, value = 0, here
            run += 1
        if value and box[3] < height:
            before_last, last, n_runs, n = _put(text, n, run, before_last, last, n_runs)
            run, value = 0, False
        run += height - box[3]
    if value and box[4] < width:
        before_last, last, n_runs, n = _put(text, n, run, before_last, last, n_runs)
        run = 0
    run += (width - box[4]) * height
    if run > 0 or n_runs == 0:
        _, _, _, n = _put(text, n, run, before_last, last, n_runs)
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
