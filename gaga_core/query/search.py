"""Search by words alone: names, colors, sizes, places. No model, no index: the box is never dead.

A text is parsed into a phrase (`grammar`); every trait and relation scores all groups 0..1, and the
product ranks them; a superlative then orders those that fit. What was understood is said back.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.query.answer_text import sentence_of
from gaga_core.query.attributes import background_scores, color_scores, presence
from gaga_core.query.grammar import Phrase, Relation, Superlative, Trait, parse, words_of
from gaga_core.query.group_facts import GroupFacts
from gaga_core.query.lexicon import Scale
from gaga_core.query.name_matching import name_scores
from gaga_core.query.spatial_relations import Sight, canonical_view, measure, relation_score, sight

FITS = 0.5  # a group that scores this is one of those meant
_SHOWN = 0.05  # groups under this are not in an answer
_NAMED = 0.6  # under this a name is none of those meant
_DESCRIBED = 0.8  # worth of a word of a description
_ENDS = ("nearest", "farthest")  # relations that mean one group
_SOME, _TELLS = 0.1, 0.75  # a color scored the first among groups of a name is raised to the second
_ALMOST = 0.9  # an anchor that fits this much less well than the best is one of several

NounScorer = Callable[[str], DoubleArray | None]  # text -> (G,) 0..1: an index of pictures


@dataclass(frozen=True, eq=False)
class Answer:
    """Groups that a search found, the best first."""

    groups: IntArray  # (K,)
    scores: FloatArray  # (K,) 0..1
    sentence: str  # what was understood, in one plain sentence
    unknown: tuple[str, ...] = ()  # words that were not understood
    n_meant: int = 0  # of the groups, how many fit; the others come near


@dataclass(frozen=True, eq=False)
class Searched:
    """What a search looks at."""

    facts: GroupFacts
    names: tuple[str, ...]  # by row of facts
    seen: Sight | None  # None: no view to take places from
    view: str = ""  # which view that is, for the sentence
    look_up: NounScorer | None = None
    described: tuple[str, ...] = ()  # by row of facts, "" where there is none


def search_words(
    text: str,
    facts: GroupFacts,
    names: Mapping[int, str],
    *,
    described: Mapping[int, str] | None = None,
    camera: Camera | None = None,
    cameras: Sequence[Camera] = (),
    look_up: NounScorer | None = None,
) -> Answer:
    """Rank the groups of ``facts`` by what ``text`` says.

    ``names`` are those that people gave, by group; ``described`` are words for other groups, which
    answer what neither a name nor ``look_up`` does ("box"). Places are those of ``camera``;
    without one, of the train view that sees most (`canonical_view` of ``cameras``). ``look_up``
    scores nouns that are in no name; without it they are reported as not understood.
    """
    view = camera or canonical_view(facts, cameras)
    shown = tuple(names.get(int(g), f"group {g}" if g else "") for g in facts.ids)
    seen = None if view is None else sight(facts, view)
    by = "" if view is None else ("this view" if camera is not None else view.name)
    known = frozenset(word for name in shown for word in words_of(name))
    words = tuple((described or {}).get(int(g), "") for g in facts.ids)
    around = Searched(facts, shown, seen, by, look_up, words)
    return _answer(parse(text, known), around)


def _answer(phrase: Phrase, around: Searched) -> Answer:
    unknown: list[str] = []
    base, understood = _phrase_scores(phrase, around, unknown)
    scores, best = base, None
    if phrase.superlative is not None and understood:
        scores, best = _ordered(phrase.superlative, base, around, unknown)
    order = np.lexsort((around.facts.ids, -scores))
    order = order[scores[order] >= _SHOWN]
    if not understood:
        order = order[:0]
    meant = int((base >= FITS).sum())
    if best is not None:
        meant = min(meant, 1)
    sentence = sentence_of(
        phrase,
        n_fit=int((base >= FITS).sum()) if understood else 0,
        unknown=unknown,
        view=around.view,
        has_view=around.seen is not None,
        aside=bool((around.facts.background & (around.facts.ids > 0)).any()),
    )
    return Answer(
        around.facts.ids[order],
        scores[order].astype(np.float32),
        sentence,
        tuple(dict.fromkeys(unknown)),
        min(meant, len(order)),
    )


def _phrase_scores(
    phrase: Phrase, around: Searched, unknown: list[str]
) -> tuple[DoubleArray, bool]:
    """Scores (G,) of all but the superlative, and whether anything was understood."""
    score, understood = _absolute(phrase, around, unknown)
    # "closest to the mug" means one of those that fit all else, so it comes last.
    for relation in sorted(phrase.relations, key=lambda r: r.kind in _ENDS):
        part = _relation_scores(relation, around, unknown)
        if part is not None:
            understood = True
            score = _end(score, part) if relation.kind in _ENDS else score * part
    for trait in phrase.traits:
        if trait.scale is not None:
            graded = _graded(trait, trait.scale, score, around)
            if graded is None:
                unknown.append(trait.words[0])
                continue
            understood = True
            score = score * graded
    return score, understood or phrase.superlative is not None


def _absolute(phrase: Phrase, around: Searched, unknown: list[str]) -> tuple[DoubleArray, bool]:
    """Scores (G,) by nouns and colors, and whether there were any that are known.

    Nouns come first: among what they mean, a color tells apart ("the pink doughnut"). Floors,
    walls and what is in no group score only where a noun means them.
    """
    allowed = ~around.facts.background
    score = np.ones(len(around.facts))
    called: DoubleArray | None = None
    understood = False
    for trait in sorted(phrase.traits, key=lambda t: t.kind != "noun"):
        part = None if trait.scale else _trait_score(trait, around)
        if part is None:
            unknown += [] if trait.scale else trait.words[:1]
            continue
        understood = True
        if trait.negated:
            part = 1 - part
        elif trait.kind == "noun":
            allowed |= part >= FITS
            called = score * part
        elif called is not None:
            part = _told_apart(part, called)
        score = score * part
    return np.where(allowed, score, 0), understood


def _trait_score(trait: Trait, around: Searched) -> DoubleArray | None:
    if trait.kind == "color":
        parts = np.stack([color_scores(around.facts, color) for color in trait.words])
        if trait.together:
            n = len(parts)
            shares = np.stack([presence(around.facts, color) for color in trait.words])
            score: DoubleArray = shares.prod(axis=0) ** (1 / n)
        else:
            score = parts.max(axis=0)
        for color in trait.words:  # "orange" is a fruit too, "green apple" a name
            score = np.maximum(score, _own_names(color, around))
        return score
    return _noun_scores(trait.words[0], around)


def _told_apart(part: DoubleArray, called: DoubleArray) -> DoubleArray:
    """Scores of a color raised so that the best of those that are called so fits, if it has some
    of the color at all."""
    fits = called >= FITS
    top = float(part[fits].max(initial=0))
    if not _SOME <= top < _TELLS:
        return part
    result: DoubleArray = np.minimum(part * (_TELLS / top), 1)
    return result


def _own_names(word: str, around: Searched) -> DoubleArray:
    scores = name_scores(word, around.names)
    return np.where(scores >= _NAMED, scores, 0)


def _noun_scores(noun: str, around: Searched) -> DoubleArray | None:
    """Groups (G,) that a noun means: by name, by the index, or as floor and walls."""
    named = _own_names(noun, around)
    if (named >= 0.8).any():
        return named
    looked = around.look_up(noun) if around.look_up is not None else None
    if looked is not None:
        return np.maximum(named, looked)
    if named.any():
        return named
    described = name_scores(noun, around.described) if around.described else named
    if (described >= _NAMED).any():
        return np.where(described >= _NAMED, np.maximum(described, _DESCRIBED), 0)
    return background_scores(noun, around.facts)


def _graded(trait: Trait, scale: Scale, base: DoubleArray, around: Searched) -> DoubleArray | None:
    """ "Big" (G,): rank among the groups that fit otherwise, among all objects when none does."""
    values = measure(around.facts, scale.measure, around.seen)
    if values is None:
        return None
    fits = (base >= FITS) & np.isfinite(values)
    if not fits.any():
        fits = ~around.facts.background & np.isfinite(values)
    if fits.sum() <= 1:
        return np.where(np.isfinite(values), 1.0, 0.0)
    signed = scale.sign * values
    among = np.sort(signed[fits])
    below = np.searchsorted(among, signed, "left") + np.searchsorted(among, signed, "right")
    result: DoubleArray = np.where(np.isfinite(values), below / (2 * len(among)), 0.0)
    return 1 - result if trait.negated else result


def _relation_scores(
    relation: Relation, around: Searched, unknown: list[str]
) -> DoubleArray | None:
    """Scores (G,) of a relation to whichever of its anchors serves a group best."""
    rows: list[list[tuple[int, float]]] = []
    for anchor in relation.anchors:
        found = _anchors(anchor, around, unknown)
        if not found:
            return None
        rows.append(found)
    if relation.kind == "between" and len(rows) == 1:  # "between the mugs"
        rows = [rows[0], rows[0]]
    best: DoubleArray | None = None
    for first, weight in rows[0]:
        for second, other in rows[1] if len(rows) > 1 else [(first, 1.0)]:
            if len(rows) > 1 and first == second:
                continue
            score = relation_score(around.facts, relation.kind, (first, second), around.seen)
            if score is None:
                unknown.append(relation.word)
                return None
            score = score * min(weight, other)
            score[[first, second]] = 0
            best = score if best is None else np.maximum(best, score)
    return best


def _anchors(phrase: Phrase, around: Searched, unknown: list[str]) -> list[tuple[int, float]]:
    """Rows that an anchor means, with how well they fit relative to the best."""
    base, understood = _phrase_scores(phrase, around, unknown)
    if phrase.superlative is not None and understood:
        base, _ = _ordered(phrase.superlative, base, around, unknown)
    if not understood or not (base >= 0.3).any():
        if understood:
            unknown.append(" ".join(word for trait in phrase.traits for word in trait.words))
        return []
    top = float(base.max())
    rows = np.flatnonzero(base >= _ALMOST * top)
    return [(int(row), float(base[row] / top)) for row in rows[np.argsort(-base[rows])][:8]]


def _ordered(
    superlative: Superlative, base: DoubleArray, around: Searched, unknown: list[str]
) -> tuple[DoubleArray, int | None]:
    """Scores with those that fit in the order of the superlative, and the row of the best."""
    if superlative.scale is None:
        values: DoubleArray | None = color_scores(around.facts, superlative.color)
        sign = 1
    else:
        values = measure(around.facts, superlative.scale.measure, around.seen)
        sign = superlative.scale.sign
    if values is None:
        unknown.append(superlative.word)
        return base, None
    enough = min(FITS, 0.7 * float(base.max(initial=0)))
    rows = np.flatnonzero((base >= max(enough, _SHOWN)) & np.isfinite(values))
    scores = base * 0.3
    if len(rows) == 0:
        return scores, None
    rows = rows[np.argsort(-sign * values[rows], kind="stable")]
    span = max(float(np.ptp(values[rows])), 1e-12)
    scores[rows] = 0.35 + 0.65 * (1 - np.abs(values[rows] - values[rows[0]]) / span)
    wanted = superlative.rank - 1
    if 0 < wanted < len(rows):
        scores[rows[:wanted]] *= 0.5
        scores[rows[wanted]] = 1.0
        scores[rows[wanted + 1 :]] *= 0.6
    return scores, int(rows[min(wanted, len(rows) - 1)])


def _end(base: DoubleArray, part: DoubleArray) -> DoubleArray:
    """Scores in which only the group of greatest ``part`` among those that fit still fits."""
    fits = (base >= min(FITS, 0.7 * float(base.max(initial=0)))) & (base > 0)
    top = float(part[fits].max(initial=0))
    if top <= 0:
        return base * 0
    result: DoubleArray = np.where(fits, np.where(part >= top, 1.0, 0.49 * part / top), 0.0)
    return result
