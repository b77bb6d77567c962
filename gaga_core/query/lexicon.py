"""The words that a search understands without any model.

Each table says what a word, or a run of words, means; `grammar` takes the longest run that fits.
A measure is a number by group (`measures`); its sign says which end the word means.
"""

from dataclasses import dataclass

from gaga_core.query.colors import ALIASES, NAMES


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
    "most left": Scale("right", -1), "most right": Scale("right", 1),
    "far left": Scale("right", -1), "far right": Scale("right", 1),
    "furthest left": Scale("right", -1), "furthest right": Scale("right", 1),
    "farthest left": Scale("right", -1), "farthest right": Scale("right", 1),
    "furthest away": Scale("depth", 1), "farthest away": Scale("depth", 1),
    "most distant": Scale("depth", 1), "most colorful": Scale("colorfulness", 1),
    "most colourful": Scale("colorfulness", 1),
    "on the left": Scale("right", -1), "on the right": Scale("right", 1),
    "on the far left": Scale("right", -1), "on the far right": Scale("right", 1),
    "to the left": Scale("right", -1), "to the right": Scale("right", 1),
    "at the left": Scale("right", -1), "at the right": Scale("right", 1),
    "in the middle": Scale("middle", 1), "in the centre": Scale("middle", 1),
    "in the center": Scale("middle", 1), "in the front": Scale("depth", -1),
    "at the front": Scale("depth", -1), "in front": Scale("depth", -1),
    "in the back": Scale("depth", 1), "at the back": Scale("depth", 1),
    "in the foreground": Scale("depth", -1), "at the top": Scale("top", 1),
    "at the bottom": Scale("top", -1), "on the left side": Scale("right", -1),
    "on the right side": Scale("right", 1),
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
    "multi-colored": Scale("colorfulness", 1), "multi-coloured": Scale("colorfulness", 1),
    "many-colored": Scale("colorfulness", 1), "many-coloured": Scale("colorfulness", 1),
}  # fmt: skip
# "left of X": where a group is, seen from another.
RELATIONS: dict[str, str] = {
    "left of": "left", "to the left of": "left", "on the left of": "left",
    "to the left side of": "left", "on the left side of": "left",
    "right of": "right", "to the right of": "right", "on the right of": "right",
    "on the right side of": "right",
    "behind": "behind", "in back of": "behind", "at the back of": "behind",
    "in front of": "before", "before": "before",
    "above": "above", "over": "above", "higher than": "above",
    "below": "below", "under": "below", "underneath": "below", "beneath": "below",
    "lower than": "below",
    "on top of": "on", "on": "on", "upon": "on", "atop": "on", "standing on": "on",
    "lying on": "on", "sitting on": "on", "resting on": "on",
    "in": "inside", "inside": "inside", "inside of": "inside", "within": "inside",
    "next to": "near", "beside": "near", "near": "near", "by": "near", "close to": "near",
    "near to": "near", "around": "near", "at": "near", "nearby": "near",
    "nearest to": "nearest", "closest to": "nearest", "nearest": "nearest", "closest": "nearest",
    "farthest from": "farthest", "furthest from": "farthest",
    "far from": "away", "away from": "away", "far away from": "away",
    "between": "between", "in between": "between",
    "larger than": "+size", "bigger than": "+size", "smaller than": "-size",
    "taller than": "+height", "shorter than": "-height", "longer than": "+length",
    "wider than": "+width", "narrower than": "-width", "thicker than": "+thickness",
    "thinner than": "-thickness", "nearer than": "-depth", "closer than": "-depth",
    "farther than": "+depth", "further than": "+depth", "darker than": "-lightness",
    "brighter than": "+lightness", "lighter than": "+lightness",
}  # fmt: skip
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
