"""How much groups have of what a single word says: a color, being floor or wall."""

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.query import lexicon as lex
from gaga_core.query.colors import HUES, NAMES, kinship
from gaga_core.query.grammar import words_of
from gaga_core.query.group_facts import GroupFacts

_NOT_IN_BROWN = ("brown", "yellow", "gold")  # brown is the shade of all other warm colors
_MIXED = 0.5  # of all other colors together against the greatest of them


def color_scores(facts: GroupFacts, color: str) -> DoubleArray:
    """How much groups (G,) have a color, one of `colors.NAMES`, 0..1.

    By the share of it in what is seen, and how typical of it that is; less when another color, or
    a mixture of many, prevails. For hues only hues compete: neutral parts of an object do not
    change its hue.
    """
    kin = kinship(color)
    share = 0.6 * facts.colors @ kin + 0.4 * facts.vivid @ kin
    rivals = [n for n in (HUES if color in HUES else NAMES) if n != color]
    rivals = [n for n in rivals if kin[NAMES.index(n)] < 0.3]
    if color not in _NOT_IN_BROWN:
        rivals = [n for n in rivals if n != "brown"]
    columns = [NAMES.index(n) for n in rivals]
    others = 0.6 * facts.colors[:, columns] + 0.4 * facts.vivid[:, columns]
    rival = np.maximum(others.max(axis=1), _MIXED * others.sum(axis=1))
    prevails = np.clip(share / np.maximum(rival, 1e-9), 0, 1) ** 3
    result: DoubleArray = (1 - np.exp(-share / 0.22)) * (0.25 + 0.75 * prevails)
    return result


def presence(facts: GroupFacts, color: str) -> DoubleArray:
    """How surely groups (G,) have some of a color at all: an eighth of what is seen is plenty."""
    result: DoubleArray = np.clip(facts.colors @ kinship(color) / 0.125, 0, 1)
    return result


def background_scores(noun: str, facts: GroupFacts) -> DoubleArray | None:
    """Background groups (G,) that a noun means where nobody has named them: the floor, the walls,
    the table that everything stands on. None for any other noun, or without background."""
    words = set(words_of(noun))
    behind: BoolArray = facts.background
    if not behind.any():
        return None
    level = facts.height < 0.5 * facts.extents[:, 1]
    lowest = facts.lo[:, 2] <= facts.lo[behind, 2].min() + 0.5 * facts.height
    if words & lex.GROUND_WORDS:
        score = np.where(level, 1.0, 0.6) * np.where(lowest, 1.0, 0.8)
    elif words & lex.TABLE_WORDS:
        score = np.where(level & (facts.ids > 0), 1.0, 0.4) * np.where(lowest, 0.8, 1.0)
    elif words & lex.WALL_WORDS:
        score = np.where(level, 0.3, 1.0)
    elif words & lex.BACKGROUND_WORDS:
        score = np.ones(len(facts))
    else:
        return None
    return np.where(behind, score, 0.0)
