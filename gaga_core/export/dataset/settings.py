"""Settings of a data set of new views.

This module is light: the command reads it to explain its options.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from gaga_core.errors import GagaError
from gaga_core.settings import check_limits, setting

Form = Literal["coco", "yolo", "bop"]
FORMS: tuple[Form, ...] = ("coco", "yolo", "bop")
MOST_PHOTOS = 160  # whose depth says what was seen


@dataclass(frozen=True)
class DatasetConfig:
    """Settings of the pictures of one scene."""

    views: int = setting(500, "Pictures of a scene", least=1, most=100_000)
    """Pictures of each scene."""
    width: int = setting(640, "Width", "pixels", least=32, most=4096)
    """Width of a picture in pixels; its focal length is that of the photos, as wide as they are."""
    height: int = setting(480, "Height", "pixels", least=32, most=4096)
    """Height of a picture in pixels."""
    coverage: float = setting(0.8, "Least share seen by photos", least=0.0, most=1.0)
    """Share of a picture that photos must have shown from about the same side and distance: what
    they did not show may be wrong. It is a share of what photos show of each other, where they are
    few."""
    closer: float = setting(0.4, "Closer views", least=0.0, most=1.0)
    """Share of the pictures that look at one object, from closer than photos; the others look at
    what a photo looked at, from about as far."""
    moved: float = setting(0.5, "Objects elsewhere", least=0.0, most=1.0)
    """Share of the pictures in which objects stand elsewhere on what carries them."""
    removed: float = setting(0.2, "Objects removed", least=0.0, most=1.0)
    """Share of the pictures in which an object is gone."""
    lights: float = setting(0.25, "Other light", least=0.0, most=1.0)
    """Share of the pictures in another light: brightness, contrast and color temperature."""
    views_each: int = setting(10, "Pictures of a placement", least=1, most=10_000)
    """Pictures of one placement of the objects."""
    validation: float = setting(0.2, "Placements for validation", least=0.0, most=0.9)
    """Share of the placements kept for validation. The scene as it is always is for training."""
    fill: bool = setting(True, "Fill what objects hid")
    """Fill what a removed or moved object hid where it stood: seconds for each object, once."""
    seed: int = setting(0, "Seed", least=0, most=1_000_000)
    """Equal seeds give equal pictures."""

    def __post_init__(self) -> None:
        check_limits(self)
        for name in ("coverage", "closer", "moved", "removed", "lights", "validation"):
            if not 0 <= getattr(self, name) <= 1:
                raise GagaError(f"--{name} is a share: a number from 0 to 1.")


def varies(config: DatasetConfig, index: int) -> tuple[bool, bool]:
    """Whether objects stand elsewhere in placement ``index``, and whether one is gone."""
    moves = _takes_turn(config.moved, index)
    return moves, _takes_turn(config.removed, index, shift=0.5)


def validates(config: DatasetConfig, index: int) -> bool:
    """Whether ``index``, of the placements in which something is changed, is for validation."""
    share = config.validation
    return _ceil(share * (index + 1)) > _ceil(share * index)


@lru_cache(maxsize=8)
def planned(config: DatasetConfig) -> tuple[int, int]:
    """Number of placements, and of the pictures of those for validation, before any is made.

    Those in which nothing is changed are one; two changed ones are rarely the same.
    """
    n_changed = n_pictures = n_same = 0
    for first in range(0, config.views, config.views_each):
        if not any(varies(config, first // config.views_each)):
            n_same = 1
            continue
        if validates(config, n_changed):
            n_pictures += min(config.views_each, config.views - first)
        n_changed += 1
    return n_changed + n_same, n_pictures


def _takes_turn(share: float, index: int, shift: float = 0.0) -> bool:
    """Whether number ``index`` is one of those that make ``share`` of any first ones."""
    return int(share * (index + 1) + shift) > int(share * index + shift)


def _ceil(value: float) -> int:
    return math.ceil(round(value, 9))


def forms_of(text: str) -> tuple[Form, ...]:
    """The formats of "coco,yolo"; ``GagaError`` for another word, or for none."""
    words = [word.strip().lower() for word in text.split(",") if word.strip()]
    found = tuple(form for form in FORMS if form in words)
    if not found or len(found) < len(set(words)):
        raise GagaError(f"--to {text}: choose of {', '.join(FORMS)}, with commas between.")
    return found
