"""Names for groups from a list of nouns, by the index; unsure ones stay without.

The similarity of a group to all nouns is made a distribution; a noun must have enough of it, and
clearly more than the next one. What a noun is like in general is taken off first: some nouns are
near to every crop.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray
from gaga_core.query.index import GroupIndex, TextVectors
from gaga_core.query.nouns import NOUNS

_MANY = 8  # groups of which a mean says something about the noun, not about them


@dataclass(frozen=True)
class NameConfig:
    """When a group is named."""

    sharpness: float = 100.0  # of the distribution over nouns, per unit of cosine (CLIP's own)
    least: float = 0.30  # share that the best noun must have
    margin: float = 1.6  # times the share of the next
    own: float = 0.5  # how much of a noun's mean over all groups is taken off

    def __post_init__(self) -> None:
        if not (0 < self.least < 1 and self.margin >= 1 and 0 <= self.own <= 1):
            raise ValueError(f"names: out of range: {self}")


def suggest_names(
    index: GroupIndex,
    nouns: Sequence[str],
    vectors: FloatArray,
    *,
    taken: Mapping[int, str] | None = None,
    config: NameConfig | None = None,
) -> dict[int, str]:
    """Names by group for those that are sure; ``taken`` are names that people gave, kept as is.

    ``vectors`` (W, D) belong to ``nouns``. Groups of one noun are told apart by a number: "mug",
    "mug 2".
    """
    config = config or NameConfig()
    taken = taken or {}
    best, sure = _best_nouns(index.vectors, vectors, config)
    used = {name.casefold() for name in taken.values()}
    names: dict[int, str] = {}
    for group, noun, certain in zip(index.groups, best, sure, strict=True):
        if not certain or int(group) in taken or group <= 0:
            continue
        name, k = nouns[noun], 1
        while name.casefold() in used:
            k += 1
            name = f"{nouns[noun]} {k}"
        used.add(name.casefold())
        names[int(group)] = name
    return names


def name_by_nouns(
    index: GroupIndex,
    texts: TextVectors,
    *,
    taken: Mapping[int, str] | None = None,
    nouns: Sequence[str] = NOUNS,
    config: NameConfig | None = None,
) -> dict[int, str]:
    """`suggest_names` with our own list; the nouns' vectors are made once and kept by ``texts``."""
    return suggest_names(index, nouns, texts.nouns(nouns), taken=taken, config=config)


def _best_nouns(
    groups: FloatArray, nouns: FloatArray, config: NameConfig
) -> tuple[list[int], list[bool]]:
    if len(groups) == 0 or len(nouns) == 0:
        return [0] * len(groups), [False] * len(groups)
    likeness: DoubleArray = (groups @ nouns.T).astype(np.float64)
    seen = np.abs(groups).max(axis=1) > 0
    if seen.sum() >= _MANY:
        mean = likeness[seen].mean(axis=0)
        likeness = likeness - config.own * (mean - mean.mean())
    weight = np.exp(config.sharpness * (likeness - likeness.max(axis=1, keepdims=True)))
    share = np.sort(weight / weight.sum(axis=1, keepdims=True), axis=1)
    second = share[:, -2] if share.shape[1] > 1 else np.zeros(len(share))
    sure = seen & (share[:, -1] >= config.least) & (share[:, -1] >= config.margin * second)
    return likeness.argmax(axis=1).tolist(), sure.tolist()
