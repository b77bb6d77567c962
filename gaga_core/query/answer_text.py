"""One plain sentence of what a search understood."""

from collections.abc import Sequence

from gaga_core.query import lexicon as lex
from gaga_core.query.grammar import Phrase, Relation, Trait

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

    ``aside``: there are floors or walls that a superlative of size left out.
    """
    lost = list(dict.fromkeys(unknown))
    said = _said(phrase, lost, n_fit)
    if said:
        best = phrase.superlative.scale if phrase.superlative else None
        if aside and best is not None and best in lex.BULKY and n_fit:
            said += ", floor and walls aside"
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
    relations = [r for r in phrase.relations if r.word not in lost and _kept(r, lost)]
    superlative = phrase.superlative
    if superlative is not None and superlative.word in lost:
        superlative = None
    if not (traits or relations or superlative):
        return ""
    adjectives = " ".join(_adjective(t) for t in traits if t.kind != "noun" and not t.negated)
    called = " ".join(_called(t) for t in traits if t.kind == "noun")
    where = " and ".join(_where(r) for r in relations)
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
    joint = " and " if trait.together else " or "
    return joint.join(trait.words)


def _called(trait: Trait) -> str:
    return ("not " if trait.negated else "") + f"called “{trait.words[0]}”"


def _where(relation: Relation) -> str:
    return f"{relation.word} " + " and ".join(f"the {_anchor(a)}" for a in relation.anchors)


def _anchor(phrase: Phrase) -> str:
    best = phrase.superlative.word if phrase.superlative else ""
    adjectives = " ".join(_adjective(t) for t in phrase.traits if t.kind != "noun")
    nouns = " ".join(t.words[0] for t in phrase.traits if t.kind == "noun")
    return " ".join(filter(None, [best, adjectives, nouns or "one"]))


def _kept(relation: Relation, lost: list[str]) -> bool:
    return not any(t.words[0] in lost for a in relation.anchors for t in a.traits)


def _uses_view(phrase: Phrase) -> bool:
    scales = [t.scale for t in phrase.traits if t.scale]
    if phrase.superlative and phrase.superlative.scale:
        scales.append(phrase.superlative.scale)
    anchored = any(_uses_view(a) for r in phrase.relations for a in r.anchors)
    views = any(r.kind in lex.VIEW_RELATIONS for r in phrase.relations)
    return anchored or views or any(s.measure in lex.VIEW_MEASURES for s in scales)
