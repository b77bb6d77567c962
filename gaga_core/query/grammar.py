"""From text to what it asks for: a small grammar of traits, one superlative, and relations.

    phrase    = (trait | superlative)* (relation anchor)*
    trait     = [not] color ["or" | "and" color] | [not] "big", "dark", ... | [not] noun
    anchor    = phrase without relations; "between" has two, joined by "and"

Any other word is a noun: part of a name, or what an index of pictures is asked for.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from difflib import SequenceMatcher
from typing import Literal

from gaga_core.query import lexicon as lex
from gaga_core.query.colors import color_of_word

_WORD = re.compile(r"[^\W_]+(?:['’-][^\W_]+)*")
_LONGEST_RUN = 5
_TYPO_LENGTH = 5  # shorter words are never taken for misspelt ones
_TYPO_RATIO = 0.83

TraitKind = Literal["color", "scale", "noun"]


@dataclass(frozen=True)
class Trait:
    """One condition: a color, an end of a measure, or a noun.

    Several colors are alternatives, or wanted at once when ``together``.
    """

    kind: TraitKind
    words: tuple[str, ...]  # colors by name; else the text
    negated: bool = False
    together: bool = False
    scale: lex.Scale | None = None


@dataclass(frozen=True)
class Superlative:
    """ "The second largest"."""

    word: str
    scale: lex.Scale | None  # None: the most of ``color``
    color: str = ""
    rank: int = 1


@dataclass(frozen=True)
class Relation:
    """ "Left of the bowl"."""

    word: str
    kind: str
    anchors: tuple["Phrase", ...]
    negated: bool = False


@dataclass(frozen=True)
class Phrase:
    """What is asked for."""

    traits: tuple[Trait, ...] = ()
    superlative: Superlative | None = None
    relations: tuple[Relation, ...] = ()

    @property
    def is_empty(self) -> bool:
        """Whether it says nothing at all."""
        return not (self.traits or self.superlative or self.relations)


@dataclass
class _Reader:
    """The words that are left to read."""

    words: list[str]
    at: int = 0
    lost: list[str] = field(default_factory=list)  # words that had nothing to belong to

    def run_of(self, table: Mapping[str, object]) -> str | None:
        """The longest run of words here that ``table`` knows."""
        for n in range(min(_LONGEST_RUN, len(self.words) - self.at), 0, -1):
            run = " ".join(self.words[self.at : self.at + n])
            if run in table:
                return run
        return None

    def skip(self, run: str) -> None:
        self.at += len(run.split())

    def peek(self, ahead: int = 0) -> str:
        at = self.at + ahead
        return self.words[at] if at < len(self.words) else ""


def parse(text: str, known: frozenset[str] = frozenset()) -> Phrase:
    """What ``text`` asks for. ``known`` are words (lower case) of names, never taken for typos."""
    words = [_spelt(word, known) for word in words_of(text)]
    reader = _Reader(words)
    head = _phrase(reader)
    relations: list[Relation] = []
    while reader.at < len(reader.words):
        relation = _relation(reader)
        if relation is None:
            break
        relations.append(relation)
    return replace(head, relations=tuple(relations))


def words_of(text: str) -> list[str]:
    """Words of a text, lower case; marks and underscores part them."""
    return _WORD.findall(text.lower().replace("’", "'"))


def _spelt(word: str, known: frozenset[str]) -> str:
    """``word``, or the word of the vocabulary that it is a misspelling of."""
    if word in lex.VOCABULARY or word in known or len(word) < _TYPO_LENGTH:
        return word
    near = [w for w in lex.VOCABULARY if w[0] == word[0] and len(w) >= _TYPO_LENGTH]
    scored = [(SequenceMatcher(None, word, w).ratio(), w) for w in near]
    best = max(scored, default=(0.0, word))
    return best[1] if best[0] >= _TYPO_RATIO and abs(len(best[1]) - len(word)) <= 1 else word


def _phrase(reader: _Reader, *, between: bool = False) -> Phrase:
    """Everything up to the next relation; with ``between`` also up to "and"."""
    traits: list[Trait] = []
    superlative: Superlative | None = None
    negated, rank, noun = False, 1, False
    while reader.at < len(reader.words):
        word = reader.peek()
        if _starts_relation(reader) or (between and word == "and"):
            break
        run = reader.run_of(lex.SUPERLATIVES) or reader.run_of(lex.COLOR_SUPERLATIVES)
        if word in lex.NEGATIONS:
            negated = True
        elif word in lex.ORDINALS:
            rank = lex.ORDINALS[word]
        elif run and superlative is None:
            color = lex.COLOR_SUPERLATIVES.get(run, "")
            superlative = Superlative(run, lex.SUPERLATIVES.get(run), color, rank)
            reader.skip(run)
            noun = False
            continue
        elif word not in lex.FILLERS and word not in ("and", "or"):
            trait = _trait(reader, negated=negated)
            if noun and trait.kind == "noun" and traits[-1].negated == trait.negated:
                traits[-1] = replace(traits[-1], words=(f"{traits[-1].words[0]} {trait.words[0]}",))
            else:
                traits.append(trait)
            noun, negated = trait.kind == "noun", False
            continue
        reader.at += 1
    return Phrase(_pruned(traits), superlative)


def _trait(reader: _Reader, *, negated: bool) -> Trait:
    word = reader.peek()
    reader.at += 1
    color = color_of_word(word)
    if color is not None:
        return _colors(reader, color, negated=negated)
    if word in lex.TRAITS:
        return Trait("scale", (word,), negated, scale=lex.TRAITS[word])
    return Trait("noun", (word,), negated)


def _colors(reader: _Reader, first: str, *, negated: bool) -> Trait:
    """A color and those joined to it: "red or yellow", "red and white"."""
    colors, together = [first], False
    while reader.peek() in ("and", "or", "") and color_of_word(reader.peek(1)) is not None:
        together |= reader.peek() == "and"
        colors.append(color_of_word(reader.peek(1)) or "")
        reader.at += 2
    return Trait("color", tuple(dict.fromkeys(colors)), negated, together)


def _relation(reader: _Reader) -> Relation | None:
    """The relation that begins here, with its anchors."""
    negated = False
    while reader.at < len(reader.words) and not _starts_relation(reader):
        reader.at += 1  # nothing of the kind is left behind by `_phrase`
    run = reader.run_of(lex.RELATIONS)
    if run is None:
        return None
    reader.skip(run)
    kind = lex.RELATIONS[run]
    anchors = [_phrase(reader, between=kind == "between")]
    if kind == "between" and reader.peek() == "and":
        reader.at += 1
        anchors.append(_phrase(reader))
    return Relation(run, kind, tuple(anchors), negated)


def _starts_relation(reader: _Reader) -> bool:
    run = reader.run_of(lex.RELATIONS)
    if run is None:
        return False
    longer = reader.run_of(lex.SUPERLATIVES)
    after = reader.peek(len(run.split()))
    if not after:  # nothing follows that it could relate to
        return False
    if longer and len(longer.split()) > len(run.split()):
        return False
    return run not in lex.NEED_ARTICLE or after in lex.ARTICLES


def _pruned(traits: list[Trait]) -> tuple[Trait, ...]:
    return tuple(dict.fromkeys(traits))
