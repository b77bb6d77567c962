"""The shares that the words of a task tell."""

from collections.abc import Sequence

from gaga_core.progress import Progress


def shares(heard: Sequence[Progress]) -> list[float]:
    """Every share 0..1 that was told; words that know none say nothing."""
    return [min(word.done / word.total, 1.0) for word in heard if word.total > 0]


def falls(heard: Sequence[Progress]) -> list[str]:
    """Where the share that a task told became less."""
    known = [word for word in heard if word.total > 0]
    said = [f"{w.stage} {s:.3f} ({w.message})" for w, s in zip(known, shares(known), strict=True)]
    pairs = zip(shares(known), shares(known)[1:], said, said[1:], strict=False)
    return [f"{a} -> {b}" for former, share, a, b in pairs if share < former - 1e-9]
