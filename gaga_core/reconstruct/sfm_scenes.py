"""Photos of two scenes in one folder: which photos belong to which model.

A mapping that cannot join its models leaves several. Those that share matches are parts of one
scene that did not hold together; those that share none are scenes of their own.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gaga_core.arrays import LongArray
from gaga_core.reconstruct.sfm_checks import CheckConfig
from gaga_core.reconstruct.sfm_metrics import MeasureConfig, SfmFacts, pair_agreement

JOINED = "joined"  # folder of the models whose parts were joined, next to the models as they were
_LINK = 30  # verified matches of two photos that show the same place
_FEW_LINKS = 0.25  # links between two scenes at most, as a share of the smaller one's photos
_FEWEST = 5  # photos of a scene of its own


def scenes_of(models: Sequence[SfmFacts]) -> tuple[SfmFacts, ...]:
    """The models that are scenes of their own, largest first, each with its own photos only.

    ``models`` come from one mapping, largest first; all know all photos. A photo that no model
    holds belongs to the one that it has most matches with, or to the first.
    """
    first = models[0]
    chosen = [first]
    for model in models[1:]:
        if len(model.names) >= _FEWEST and all(_is_apart(model, other) for other in chosen):
            chosen.append(model)
    if len(chosen) == 1:
        return (first,)
    owner = _owners(chosen)
    return tuple(_only(model, owner == i) for i, model in enumerate(chosen))


def is_well_joined(joined: SfmFacts, parts: Sequence[SfmFacts]) -> bool:
    """Whether the photos of different ``parts`` agree with their poses in ``joined``.

    Only their verified matches are asked: those inside a part say nothing of how it was joined.
    The matches of a part are many, so a part that lies wrong can pass when all are asked.
    """
    of = {name: i for i, part in reversed(list(enumerate(parts))) for name in part.names}
    part = np.array([of[name] for name in joined.names])
    part_of_all = np.array([of.get(name, -1) for name in joined.all_names])
    across = part[joined.match_views[:, 0]] != part[joined.match_views[:, 1]]
    pairs_across = part_of_all[joined.pairs[:, 0]] != part_of_all[joined.pairs[:, 1]]
    between = replace(
        joined,
        match_views=joined.match_views[across],
        match_points=joined.match_points[across],
        match_rays=joined.match_rays[across],
        pairs=joined.pairs[pairs_across],
        pair_matches=joined.pair_matches[pairs_across],
    )
    share, n_pairs = pair_agreement(between, MeasureConfig())
    return n_pairs > 0 and share >= CheckConfig().agreeing[1]


def _is_apart(a: SfmFacts, b: SfmFacts) -> bool:
    in_a, in_b = (np.isin(np.array(a.all_names), np.array(m.names)) for m in (a, b))
    if (in_a & in_b).any():
        return False
    i, j = a.pairs[a.pair_matches >= _LINK].T
    links = (in_a[i] & in_b[j]) | (in_b[i] & in_a[j])
    return bool(links.sum() <= _FEW_LINKS * min(len(a.names), len(b.names)))


def _owners(scenes: Sequence[SfmFacts]) -> LongArray:
    """Index of the scene (A,) that each photo belongs to."""
    first = scenes[0]
    names = np.array(first.all_names)
    member = np.stack([np.isin(names, np.array(scene.names)) for scene in scenes], axis=1)
    votes = np.zeros(member.shape)
    for side, other in ((0, 1), (1, 0)):
        np.add.at(
            votes,
            first.pairs[:, side],
            member[first.pairs[:, other]] * first.pair_matches[:, None],
        )
    votes[member.any(axis=1)] = 0
    owner: LongArray = (votes + member).argmax(axis=1)
    return owner


def _only(facts: SfmFacts, mine: np.ndarray) -> SfmFacts:
    """``facts`` as if there were only the photos ``mine`` (A,)."""
    inside = mine[facts.pairs].all(axis=1)
    index = np.cumsum(mine) - 1
    return replace(
        facts,
        all_names=tuple(name for name, keep in zip(facts.all_names, mine, strict=True) if keep),
        pairs=index[facts.pairs[inside]].astype(np.int64),
        pair_matches=facts.pair_matches[inside],
        model_sizes=np.array([len(facts.names)], np.int64),
    )
