"""Which group a noun means: names that people gave, matched as people type them."""

from collections.abc import Sequence
from difflib import SequenceMatcher

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.query.grammar import words_of

_SAME_STEM = 0.97  # plural and singular
_PREFIX = (3, 0.85)  # letters that a beginning must have, and what it is worth
_ALIKE = 0.78  # how alike letters must be to be a misspelling
_MISSPELT = 0.9  # what a misspelling is worth at most
_WHOLE = 0.25  # what naming all of a name's words is worth


def name_scores(noun: str, names: Sequence[str]) -> DoubleArray:
    """How well each name (G,) fits ``noun``, 0..1: exact, plural, beginning, misspelt.

    Every word of the noun must fit a word of the name; a name with more words fits a little less,
    unless the noun is its last one ("lamp" in "table lamp").
    """
    wanted = words_of(noun)
    result = np.zeros(len(names))
    if not wanted:
        return result
    for i, name in enumerate(names):
        words = words_of(name)
        if words and not any(word[:1].isdigit() for word in wanted):
            words = [word for word in words if not word.isdigit()] or words
        if not words:
            continue
        fits = np.array([[_alike(w, n) for n in words] for w in wanted])
        weakest = float(fits.max(axis=1).min())
        covered = float(fits.max(axis=0).mean())
        head = float(fits[-1, -1])
        result[i] = weakest * (1 - _WHOLE * (1 - max(covered, 0.6 * head)))
    return result


def stem(word: str) -> str:
    """``word`` without the ending of an English plural."""
    for ending, instead in (("ies", "y"), ("ves", "f"), ("sses", "ss"), ("oes", "o")):
        if len(word) > len(ending) + 1 and word.endswith(ending):
            return word[: -len(ending)] + instead
    if word.endswith(("ches", "shes", "xes")):
        return word[:-2]
    if len(word) > 3 and word.endswith("s") and not word.endswith(("ss", "us")):
        return word[:-1]
    return word


def _alike(wanted: str, word: str) -> float:
    if wanted == word:
        return 1.0
    if wanted.isdigit() or word.isdigit():
        return float(wanted.lstrip("0") == word.lstrip("0"))
    if stem(wanted) == stem(word):
        return _SAME_STEM
    n, worth = _PREFIX
    if len(wanted) >= n and word.startswith(wanted):
        return worth
    ratio = SequenceMatcher(None, stem(wanted), stem(word)).ratio()
    return _MISSPELT * ratio if ratio >= _ALIKE and len(wanted) > n else 0.0
