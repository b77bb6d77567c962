"""Color words: which of fourteen names a color has, and how typical of it the color is.

A name is a handful of prototypes in CIE Lab, in light and in shade, since the colors of splats
have the light baked in; a color belongs to the names of its nearest prototypes, softly. The eleven
basic terms are Berlin and Kay's (1969), with turquoise, gold and beige added. What people call
grey green, greenish grey and the like is of the color survey of xkcd (Munroe 2010).
"""

from functools import cache

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, FloatArray
from gaga_core.color import lab_from_rgb

LEVELS = 32  # steps of a channel in the table of all colors
_SOFTNESS = 5.0  # Lab units between prototypes within which a color has both names
_LIGHTNESS_WEIGHT = 0.55  # shade changes lightness more than it changes the name

# sRGB prototypes; the first of each name is its focal color.
_PROTOTYPES: dict[str, tuple[str, ...]] = {
    name: tuple(codes.split())
    for name, codes in {
        "red": "d81e1e a01218 6e0c10 ff3b30 c0322b 8c2020 400808",
        "orange": "f57c14 d05a10 ff9a2e b5521a e88c30 e8713a 93380d c83e10 e34a18",
        "yellow": "f7dc1c d8b41a fff04a b09612 e0c83c 8a760e cfe01e b0c020 62540a 4c4204",
        "green": "2a9a34 1c6a28 6abf3a 124518 7a9a3a 5a7a4a 3f5a2a 9ad07a "
        "96ae8d 86a17d 77926f 82a67d 789b73",  # greenish grey ... grey green
        "turquoise": "22b5b0 2f6f7d 18807c 70d8d0 12504e",
        "blue": "1e56c8 16389a 3a86e0 0e2468 6a9ae0 3c5c9c 2e4560 9cc0ec "
        "1010f0 1010a0 4c4cf4 04047a 08085c "
        "5e819d 6b8ba4 3f829d 647d8e",  # greyish, grey and dirty blue
        "purple": "7a2aa8 56208a a05ad0 3a1460 7a4a7c b48ad8 62304f 7a4a5c 523040 8228e6 5c10b4",
        "pink": "f06aa8 f4a8c0 e04a8a c8708c f8c8d4 ec9aa6 b05070",
        "brown": "7a4a20 5a3418 9a6a3a 3c2410 6b4a30 8a5a40 b98450",
        "beige": "e2cfa6 d0b88c f0e2c4 b8a27a c8a878",
        "gold": "c8981e a87a18 d9a441",
        "grey": "808080 a0a0a0 606060 b8b8b8 484848 909a9a 9a948c 6c6a66",
        "black": "101010 000000 202020 1c1a22 242018 2c2c2c",
        "white": "f8f8f8 ffffff e4e4e4 f4f0e8 e8eef4 d4d4d4",
    }.items()
}
NAMES = tuple(_PROTOTYPES)
HUES = tuple(name for name in NAMES if name not in ("grey", "black", "white", "beige"))
# Other words for a name.
ALIASES: dict[str, str] = {
    "gray": "grey", "silver": "grey", "violet": "purple", "lilac": "purple", "magenta": "pink",
    "teal": "turquoise", "cyan": "turquoise", "golden": "gold", "cream": "beige", "tan": "beige",
    "crimson": "red", "scarlet": "red", "maroon": "red", "navy": "blue", "lime": "green",
    "olive": "green", "ochre": "gold", "mustard-colored": "gold", "reddish": "red",
    "bluish": "blue", "greenish": "green", "yellowish": "yellow", "brownish": "brown",
    "pinkish": "pink", "greyish": "grey", "grayish": "grey", "whitish": "white",
    "blackish": "black", "orangish": "orange", "purplish": "purple",
}  # fmt: skip
# What a user who names the first color also accepts of the second.
_KIN: dict[str, dict[str, float]] = {
    "yellow": {"gold": 0.7},
    "gold": {"yellow": 0.4},
    "brown": {"beige": 0.3},
    "blue": {"turquoise": 0.4},
    "green": {"turquoise": 0.25},
    "purple": {"pink": 0.15},
    "white": {"grey": 0.4},  # in shade
}


def color_of_word(word: str) -> str | None:
    """The color name that ``word`` (lower case) means, None if it is no color word."""
    return word if word in _PROTOTYPES else ALIASES.get(word)


def name_weights(rgb: AnyArray) -> FloatArray:
    """Share of each of `NAMES` (..., 14) in a color (..., 3) in 0..1; they add up to 1."""
    lab = _weighted(lab_from_rgb(rgb))
    distance = np.empty((*lab.shape[:-1], len(NAMES)))
    for k, name in enumerate(NAMES):
        gap = lab[..., None, :] - _weighted(lab_from_rgb(_rgb_of(_PROTOTYPES[name])))
        distance[..., k] = np.linalg.norm(gap, axis=-1).min(axis=-1)
    nearest = distance.min(axis=-1, keepdims=True)
    weight = np.exp(-(distance - nearest) / _SOFTNESS)
    return (weight / weight.sum(axis=-1, keepdims=True)).astype(np.float32)


def typicality(rgb: AnyArray) -> FloatArray:
    """How good an example of each of `NAMES` (..., 14) a color (..., 3) is, 0..1.

    Saturated colors are the better examples of hues (chroma against that of the focal color);
    for brown, beige, grey, black and white every color that has the name is as good.
    """
    lab = lab_from_rgb(rgb)
    chroma = np.hypot(lab[..., 1], lab[..., 2])
    result = np.ones((*chroma.shape, len(NAMES)), np.float32)
    for k, name in enumerate(NAMES):
        if name in HUES and name != "brown":
            focal = lab_from_rgb(_rgb_of(_PROTOTYPES[name][:1]))[0]
            result[..., k] = np.clip(chroma / np.hypot(focal[1], focal[2]), 0, 1)
    return result


@cache
def color_table() -> FloatArray:
    """Shares and typical shares (LEVELS^3, 28) of all colors; row = (r LEVELS + g) LEVELS + b."""
    steps = (np.arange(LEVELS) + 0.5) / LEVELS
    rgb = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    share = name_weights(rgb)
    table: FloatArray = np.concatenate([share, share * typicality(rgb)], axis=1)
    return np.ascontiguousarray(table, np.float32)


def kinship(name: str) -> FloatArray:
    """Weight (14,) with which each of `NAMES` counts for ``name``."""
    weights = np.zeros(len(NAMES), np.float32)
    weights[NAMES.index(name)] = 1
    for other, value in _KIN.get(name, {}).items():
        weights[NAMES.index(other)] = value
    return weights


def _rgb_of(codes: tuple[str, ...]) -> DoubleArray:
    rows = [[int(code[i : i + 2], 16) / 255 for i in (0, 2, 4)] for code in codes]
    return np.array(rows, np.float64)


def _weighted(lab: DoubleArray) -> DoubleArray:
    return lab * np.array([_LIGHTNESS_WEIGHT, 1, 1])
