"""From text to what it asks for: a small grammar of traits, one superlative, and relations.

    phrase    = (trait | superlative)* (relation anchor)*
    trait     = [not] color ["or" | "and" color] | [not] "big", "dark", ... | [not] noun
    anchor    = phrase without relations; "between" has two, joined by "and"

Any other word is a noun: part of a name, or what an index of pictures is asked for.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from difflib import SequenceMatcher
from typing import Literal

from gaga_core.query.colors import ALIASES, NAMES, color_of_word

# --- The words that a search understands without any model.
# Each table says what a word, or a run of words, means; `grammar` takes the longest run that fits.
# A measure is a number by group (`measures`); its sign says which end the word means.


@dataclass(frozen=True)
class Scale:
    """One end of a measure: +1 for more of it, -1 for less."""

    measure: str
    sign: int


def _both(measure: str, more: str, less: str) -> dict[str, Scale]:
    words = {word: Scale(measure, 1) for word in more.split()}
    return words | {word: Scale(measure, -1) for word in less.split()}


# "the largest": one group of all that fit.
SUPERLATIVES: dict[str, Scale] = {
    **_both("size", "largest biggest hugest greatest bulkiest", "smallest littlest tiniest"),
    **_both("height", "tallest", "shortest"),
    **_both("length", "longest", ""),
    **_both("width", "widest broadest", "narrowest slimmest"),
    **_both("thickness", "thickest fattest", "thinnest flattest"),
    **_both("roundness", "roundest", ""),
    **_both("top", "highest topmost uppermost top upper", "lowest bottommost bottom lower"),
    **_both("right", "rightmost right", "leftmost left"),
    **_both("depth", "farthest furthest back rearmost rear", "nearest closest foremost front"),
    **_both("middle", "middle central centre center centermost middlemost", ""),
    **_both("lightness", "brightest lightest palest", "darkest"),
    **_both("colorfulness", "colorfullest", "plainest"),
    **{
        run.format(side): Scale("right", sign)
        for run in ("most {}", "far {}", "furthest {}", "farthest {}", "on the {}", "to the {}",
                    "at the {}", "on the far {}", "on the {} side")
        for side, sign in (("left", -1), ("right", 1))
    },
    **dict.fromkeys(("furthest away", "farthest away", "most distant", "in the back",
                     "at the back"), Scale("depth", 1)),
    **dict.fromkeys(("in the front", "at the front", "in front", "in the foreground"),
                    Scale("depth", -1)),
    **dict.fromkeys(("in the middle", "in the centre", "in the center"), Scale("middle", 1)),
    **dict.fromkeys(("most colorful", "most colourful"), Scale("colorfulness", 1)),
    "at the top": Scale("top", 1), "at the bottom": Scale("top", -1),
}  # fmt: skip
# How an end of a measure is called in the sentence of an answer, where the word itself will not do.
CALLED: dict[Scale, str] = {
    Scale("right", -1): "leftmost", Scale("right", 1): "rightmost",
    Scale("depth", -1): "nearest", Scale("depth", 1): "farthest",
    Scale("top", 1): "topmost", Scale("top", -1): "lowest", Scale("middle", 1): "most central",
    Scale("colorfulness", 1): "most colorful",
}  # fmt: skip
BULKY = frozenset(  # floors and walls would win these
    Scale(measure, 1) for measure in ("size", "height", "length", "width", "thickness")
)
# "reddest": the most of a color.
COLOR_SUPERLATIVES: dict[str, str] = {
    "reddest": "red", "greenest": "green", "bluest": "blue", "yellowest": "yellow",
    "whitest": "white", "blackest": "black", "brownest": "brown", "pinkest": "pink",
    "greyest": "grey", "grayest": "grey",
}  # fmt: skip
# "big": more or less so, compared with the others that fit.
TRAITS: dict[str, Scale] = {
    **_both("size", "big large huge giant great bulky", "small little tiny mini miniature"),
    **_both("height", "tall", "short"),
    **_both("length", "long elongated", ""),
    **_both("width", "wide broad", "narrow slim"),
    **_both("thickness", "thick fat", "thin flat"),
    **_both("roundness", "round spherical", ""),
    **_both("top", "high", "low"),
    **_both("depth", "far distant", "close near"),
    **_both("lightness", "bright light pale", "dark"),
    **_both("colorfulness", "colorful colourful multicolored multicoloured", ""),
    **dict.fromkeys(("multi-colored", "multi-coloured", "many-colored", "many-coloured"),
                    Scale("colorfulness", 1)),
}  # fmt: skip
# "left of X": where a group is, seen from another.
RELATIONS: dict[str, str] = {
    run: kind
    for kind, runs in {
        "left": "left of, to the left of, on the left of, to the left side of, on the left side of",
        "right": "right of, to the right of, on the right of, on the right side of",
        "behind": "behind, in back of, at the back of",
        "before": "in front of, before",
        "above": "above, over, higher than",
        "below": "below, under, underneath, beneath, lower than",
        "on": "on top of, on, upon, atop, standing on, lying on, sitting on, resting on",
        "inside": "in, inside, inside of, within",
        "near": "next to, beside, near, by, close to, near to, around, at, nearby",
        "nearest": "nearest to, closest to, nearest, closest",
        "farthest": "farthest from, furthest from",
        "away": "far from, away from, far away from",
        "between": "between, in between",
        "+size": "larger than, bigger than",
        "-size": "smaller than",
        "+height": "taller than",
        "-height": "shorter than",
        "+length": "longer than",
        "+width": "wider than",
        "-width": "narrower than",
        "+thickness": "thicker than",
        "-thickness": "thinner than",
        "-depth": "nearer than, closer than",
        "+depth": "farther than, further than",
        "-lightness": "darker than",
        "+lightness": "brighter than, lighter than",
    }.items()
    for run in runs.split(", ")
}
# These are relations only before "the", "a", "to": else "nearest red" is a superlative.
NEED_ARTICLE = frozenset(("nearest", "closest", "near", "at", "by", "on", "in", "over"))
VIEW_RELATIONS = frozenset(("left", "right", "behind", "before", "-depth", "+depth"))
VIEW_MEASURES = frozenset(("right", "depth", "middle"))
ORDINALS = {
    "first": 1, "second": 2, "third": 3, "fourth": 4, "fifth": 5, "sixth": 6, "seventh": 7,
    "1st": 1, "2nd": 2, "3rd": 3, "4th": 4, "5th": 5,
}  # fmt: skip
NEGATIONS = frozenset(("not", "no", "non", "except", "isn't", "without", "neither", "nor"))
ARTICLES = frozenset(("the", "a", "an", "this", "that", "my", "his", "her", "its"))
_FILLERS = (
    "one ones object objects thing things item items of is are which what where who me i show find "
    "select please all every any each some it there their these those group's colored coloured "
    "color colour you can't see look for side piece most very quite rather really with being "
    "search get give want need looking in_ standing lying sitting placed located also than to from"
)
FILLERS = frozenset(_FILLERS.split()) | ARTICLES
# What floors and walls are called where nobody has named them.
GROUND_WORDS = frozenset(("floor", "ground", "carpet"))
TABLE_WORDS = frozenset(("table", "tabletop", "desk", "surface"))
WALL_WORDS = frozenset(("wall", "walls", "ceiling", "room", "sky"))
BACKGROUND_WORDS = frozenset(("background", "backdrop", "surroundings", "rest", "unassigned"))

COLOR_WORDS = frozenset((*NAMES, *ALIASES))
VOCABULARY = frozenset(
    word
    for table in (SUPERLATIVES, COLOR_SUPERLATIVES, TRAITS, RELATIONS, ORDINALS)
    for run in table
    for word in run.split()
) | (COLOR_WORDS | FILLERS | NEGATIONS)


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
    scale: Scale | None = None


@dataclass(frozen=True)
class Superlative:
    """ "The second largest"."""

    word: str
    scale: Scale | None  # None: the most of ``color``
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
    """A parsed request."""

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

    def run_of(self, table: Mapping[str, object]) -> str | None:
        """The longest run of words here that ``table`` knows."""
        for n in range(min(_LONGEST_RUN, len(self.words) - self.at), 0, -1):
            run = " ".join(self.words[self.at : self.at + n])
            if run in table:
                return run
        return None

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
    if word in VOCABULARY or word in known or len(word) < _TYPO_LENGTH:
        return word
    near = [w for w in VOCABULARY if w[0] == word[0] and len(w) >= _TYPO_LENGTH]
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
        run = reader.run_of(SUPERLATIVES) or reader.run_of(COLOR_SUPERLATIVES)
        if word in NEGATIONS:
            negated = True
        elif word in ORDINALS:
            rank = ORDINALS[word]
        elif run and superlative is None:
            color = COLOR_SUPERLATIVES.get(run, "")
            superlative = Superlative(run, SUPERLATIVES.get(run), color, rank)
            reader.at += len(run.split())
            noun = False
            continue
        elif word not in FILLERS and word not in ("and", "or"):
            trait = _trait(reader, negated=negated)
            if noun and trait.kind == "noun" and traits[-1].negated == trait.negated:
                traits[-1] = replace(traits[-1], words=(f"{traits[-1].words[0]} {trait.words[0]}",))
            else:
                traits.append(trait)
            noun, negated = trait.kind == "noun", False
            continue
        reader.at += 1
    return Phrase(tuple(dict.fromkeys(traits)), superlative)


def _trait(reader: _Reader, *, negated: bool) -> Trait:
    word = reader.peek()
    reader.at += 1
    color = color_of_word(word)
    if color is not None:
        return _colors(reader, color, negated=negated)
    if word in TRAITS:
        return Trait("scale", (word,), negated, scale=TRAITS[word])
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
    run = reader.run_of(RELATIONS)
    if run is None:
        return None
    reader.at += len(run.split())
    kind = RELATIONS[run]
    anchors = [_phrase(reader, between=kind == "between")]
    if kind == "between" and reader.peek() == "and":
        reader.at += 1
        anchors.append(_phrase(reader))
    return Relation(run, kind, tuple(anchors), negated)


def _starts_relation(reader: _Reader) -> bool:
    run = reader.run_of(RELATIONS)
    if run is None:
        return False
    longer = reader.run_of(SUPERLATIVES)
    after = reader.peek(len(run.split()))
    if not after:  # nothing follows that it could relate to
        return False
    if longer and len(longer.split()) > len(run.split()):
        return False
    return run not in NEED_ARTICLE or after in ARTICLES
