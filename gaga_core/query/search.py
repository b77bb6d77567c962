"""Search by words alone: names, colors, sizes, places. No model, no index: the box always works.

A text is parsed into a phrase (`grammar`); every trait and relation scores all groups 0..1, and the
product ranks them; a superlative then orders those that fit. What was understood is said back.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.query import grammar as lex
from gaga_core.query.colors import HUES, NAMES, kinship
from gaga_core.query.grammar import Phrase, Relation, Scale, Superlative, Trait, parse, words_of
from gaga_core.query.group_facts import GroupFacts
from gaga_core.query.spatial_relations import Sight, canonical_view, measure, relation_score, sight

# --- Say what a search understood, in one plain sentence.


_CURE = "name it, or index the scene with a model."
_HINT = "Try a name, a color, a size or a place."


def sentence_of(
    phrase: Phrase,
    *,
    n_fit: int,
    unknown: Sequence[str],
    view: str,
    has_view: bool,
    aside: bool,
) -> str:
    """What ``phrase`` was taken for, how many groups fit, and the words that meant nothing here.

    ``aside``: a superlative of size left out what counts as background or support.
    """
    lost = list(dict.fromkeys(unknown))
    said = _said(phrase, lost, n_fit)
    if said:
        best = phrase.superlative.scale if phrase.superlative else None
        if aside and best is not None and best in lex.BULKY and n_fit:
            said += ", background and supports aside"
        said += f", as seen from {view}." if view and _uses_view(phrase) and n_fit else "."
    notes = []
    if lost:
        nouns = [word for word in lost if not set(word.split()) <= lex.VOCABULARY]
        rest = [word for word in lost if word not in nouns]
        if nouns:
            notes.append(f"Nothing here is called {_quoted(nouns)}: {_CURE}")
        if rest:
            notes.append(f"Not understood: {_quoted(rest)}.")
        notes += [] if said else [_HINT]
    if _uses_view(phrase) and not has_view:
        notes.append("Places need a view.")
    if not said and not lost:
        notes.append(f"Nothing to look for. {_HINT}")
    return " ".join(filter(None, [said, *notes]))


def _said(phrase: Phrase, lost: list[str], n_fit: int) -> str:
    """The clause without its full stop; empty when nothing was understood."""
    traits = [t for t in phrase.traits if t.words[0] not in lost]
    relations = [
        r
        for r in phrase.relations
        if r.word not in lost
        and not any(t.words[0] in lost for anchor in r.anchors for t in anchor.traits)
    ]
    superlative = phrase.superlative
    if superlative is not None and superlative.word in lost:
        superlative = None
    if not (traits or relations or superlative):
        return ""
    adjectives = " ".join(_adjective(t) for t in traits if t.kind != "noun" and not t.negated)
    nouns = [t for t in traits if t.kind == "noun"]
    called = " ".join(f"{'not ' * t.negated}called “{t.words[0]}”" for t in nouns)
    where = " and ".join(
        f"{r.word} " + " and ".join(f"the {_anchor(a)}" for a in r.anchors) for r in relations
    )
    denied = [_adjective(t) for t in traits if t.kind != "noun" and t.negated]
    but = " and ".join(f"{'is' if n_fit == 1 else 'are'} not {words}" for words in denied)
    but = f"that {but}" if but else ""
    things = "object" if n_fit in (0, 1) else "objects"
    thing = " ".join(filter(None, [adjectives, things, called, where, but]))
    if n_fit == 0:
        return f"No {thing} for sure"
    if superlative is None:
        return f"{n_fit} {thing}"
    rank = next((w for w, k in lex.ORDINALS.items() if k == superlative.rank > 1), "")
    word = superlative.word
    if superlative.scale and not word.endswith(("est", "most")):
        word = lex.CALLED.get(superlative.scale, word)
    best = f"{rank} {word}".strip()
    if n_fit == 1:
        return f"The only {thing}"
    return f"The {best} of the {n_fit} {thing}"


def _quoted(words: Sequence[str]) -> str:
    return ", ".join(f"“{word}”" for word in words)


def _adjective(trait: Trait) -> str:
    return (" and " if trait.together else " or ").join(trait.words)


def _anchor(phrase: Phrase) -> str:
    best = phrase.superlative.word if phrase.superlative else ""
    adjectives = " ".join(_adjective(t) for t in phrase.traits if t.kind != "noun")
    nouns = " ".join(t.words[0] for t in phrase.traits if t.kind == "noun")
    return " ".join(filter(None, [best, adjectives, nouns or "one"]))


def _uses_view(phrase: Phrase) -> bool:
    scales = [t.scale for t in phrase.traits if t.scale]
    if phrase.superlative and phrase.superlative.scale:
        scales.append(phrase.superlative.scale)
    anchored = any(_uses_view(a) for r in phrase.relations for a in r.anchors)
    views = any(r.kind in lex.VIEW_RELATIONS for r in phrase.relations)
    return anchored or views or any(s.measure in lex.VIEW_MEASURES for s in scales)


# --- Score groups by a single word: a color, being floor or wall.


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
    return (1 - np.exp(-share / 0.22)) * (0.25 + 0.75 * prevails)


def presence(facts: GroupFacts, color: str) -> DoubleArray:
    """How surely groups (G,) have some of a color at all: an eighth of what is seen is plenty."""
    return np.clip(facts.colors @ kinship(color) / 0.125, 0, 1)


def background_scores(noun: str, facts: GroupFacts) -> DoubleArray | None:
    """Background groups (G,) that a noun means where they are unnamed: the floor, the walls,
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


# --- Which group a noun means: names that people gave, matched as people type them.


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
    """Data that a search reads."""

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
    phrase = parse(text, known)
    if phrase.is_empty and known.intersection(words_of(text)):  # a name such as "Second"
        phrase = Phrase((Trait("noun", (text.strip().lower(),)),))
    return _answer(phrase, around)


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
            called = [color in words_of(text) for text in around.described]
            if called and not trait.together:
                score = np.where(called, np.maximum(score, FITS), score)
        return score
    return _noun_scores(trait.words[0], around)


def _told_apart(part: DoubleArray, called: DoubleArray) -> DoubleArray:
    """Scores of a color raised so that the best of those that are called so fits, if it has some
    of the color at all."""
    fits = called >= FITS
    top = float(part[fits].max(initial=0))
    if not _SOME <= top < _TELLS:
        return part
    return np.minimum(part * (_TELLS / top), 1)


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
    return [
        (int(row), float(base[row] / top))
        for row in rows[np.argsort(-base[rows], kind="stable")][:8]
    ]


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
    return np.where(fits, np.where(part >= top, 1.0, 0.49 * part / top), 0.0)
