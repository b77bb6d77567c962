"""Words for groups that nobody has named: "red box, large", "blue thing behind".

Color, shape and size are measured; a place and at last a number tell apart what would be called
the same. A description that is still true stays as it is when other groups come and go.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.camera import Camera
from gaga_core.query.colors import HUES, NAMES
from gaga_core.query.group_facts import GroupFacts
from gaga_core.query.shapes import Shape, shapes_of
from gaga_core.query.spatial_relations import canonical_view, sight
from gaga_core.scene.scene import Scene

_LARGE, _SMALL = 2.2, 0.45  # sizes against the median of the objects
_LEADS = 0.25  # share of the foremost color below which a thing of many hues is "colorful"
_HUE, _MANY_HUES = 0.09, 4  # share of a hue that counts, and how many of them are many
_WHITE = 0.27  # of the grey: so much white, and the grey is its shade
_MOSTLY = 0.5  # share of both from which on a thing is called white
_BESIDES_GREY = 0.32  # of both: so much of a hue tells more, as on a can with a label
_SIDE = 0.3  # share of the objects at each end that are left, right, behind, in front
_STILL_SIDE = 0.5  # the same for words that were given before
_FEWEST_PLACED = 4  # objects in the view from which on there are sides
_NOUNS: dict[Shape, str] = {"box": "box", "round": "round thing", "flat": "flat thing",
                            "long": "long thing", "tall": "tall thing", "": "thing"}  # fmt: skip
_NUMBER = re.compile(r" \d+$")


@dataclass(frozen=True)
class _Said:
    """What is true of a group."""

    what: str  # "red box, large"
    place: str  # "behind"; "" = nowhere in particular
    sides: Mapping[str, float]  # places that are not wrong, and how many are farther there, 0..1

    def at(self, place: str) -> str:
        """The words with a place."""
        return f"{self.what}{' ' if ',' not in self.what else ', '}{place}"

    def fits(self, text: str) -> bool:
        """Whether ``text``, perhaps with a number, is still true."""
        words = _NUMBER.sub("", text)
        return words == self.what or any(words == self.at(side) for side in self.sides)


def describe_groups(
    scene: Scene,
    facts: GroupFacts,
    cameras: Sequence[Camera] = (),
    kept: Mapping[int, str] | None = None,
) -> dict[int, str]:
    """Descriptions by group of all groups of ``facts`` that have no name; no two are equal, nor
    equal to a name. 0 (no group) has none.

    ``kept`` are descriptions of an earlier state: they stay where they are still true. Left and
    behind are meant from the train view that sees most; without ``cameras`` there are no places.
    """
    said = {
        int(group): one
        for group, one in zip(facts.ids, _said(scene, facts, cameras), strict=True)
        if group > 0 and int(group) not in scene.names
    }
    used = {name.casefold() for name in scene.names.values()}
    found: dict[int, str] = {}
    for group, text in sorted((kept or {}).items()):
        if group in said and said[group].fits(text) and text not in used:
            found[group] = text
            used.add(text)
    alike: dict[str, list[_Said]] = {}
    for one in said.values():
        alike.setdefault(one.what, []).append(one)
    for group, one in said.items():
        if group not in found:
            found[group] = _unique(_told_apart(one, alike[one.what], used), used)
            used.add(found[group])
    return dict(sorted(found.items()))


def _told_apart(one: _Said, alike: Sequence[_Said], used: set[str]) -> str:
    """Words with the place where no other of those that are ``alike`` (it among them) is farther
    out; without such a place, with the one where it is."""
    if len(alike) == 1 or not one.sides:
        return one.what
    first = [s for s in one.sides if all(one.sides[s] <= o.sides.get(s, 1.0) for o in alike)]
    places = [one.place] * bool(one.place) + sorted(first, key=one.sides.__getitem__)
    free = (text for text in map(one.at, places) if text not in used)
    return next(free, one.at(one.place) if one.place else one.what)


def _unique(text: str, used: set[str]) -> str:
    name, k = text, 1
    while name in used:
        k += 1
        name = f"{text} {k}"
    return name


def _said(scene: Scene, facts: GroupFacts, cameras: Sequence[Camera]) -> list[_Said]:
    objects = ~facts.background & (facts.ids > 0)
    median = float(np.median(facts.size[objects])) if objects.any() else 1.0
    places = _places(facts, cameras, objects)
    shapes = shapes_of(scene, facts)
    said = []
    for row in range(len(facts)):
        color = _color(facts, row)
        if not objects[row]:
            what = _support(facts, row) if facts.ids[row] > 0 else "rest"
            said.append(_Said(f"{color} {what}", "", {}))
            continue
        if color == "grey":
            color = _besides_grey(facts, row)
        size = facts.size[row] / max(median, 1e-12)
        word = ", large" if size > _LARGE else ", small" if size < _SMALL else ""
        ends = places[row]
        side = min(ends, key=lambda name: ends[name], default="")
        place = side if side and ends[side] < _SIDE else ""
        sides = {name: rank for name, rank in ends.items() if rank < _STILL_SIDE}
        said.append(_Said(f"{color} {_NOUNS[shapes[row]]}{word}", place, sides))
    return said


def _color(facts: GroupFacts, row: int) -> str:
    """The foremost color as it shows from outside, or "colorful"."""
    share = 0.6 * facts.colors[row] + 0.4 * facts.vivid[row]
    best = int(share.argmax())
    hues = [facts.colors[row, NAMES.index(n)] for n in HUES if n not in ("brown", "gold")]
    if share[best] < _LEADS and sum(hue > _HUE for hue in hues) >= _MANY_HUES:
        return "colorful"
    return NAMES[best]


def _besides_grey(facts: GroupFacts, row: int) -> str:
    """What people call a thing that is grey for the most part: "white" in shade, or the hue that
    tells more of it; else "grey"."""
    share = dict(zip(NAMES, facts.colors[row].tolist(), strict=True))
    both = share["grey"] + share["white"]
    if share["white"] > _WHITE * share["grey"] and both > _MOSTLY:
        return "white"
    hue = max(HUES, key=share.__getitem__)
    return hue if share[hue] > _BESIDES_GREY * both else "grey"


def _support(facts: GroupFacts, row: int) -> str:
    """What a background group is: floor, wall, surface; scattered bits and the rest otherwise."""
    sides = (facts.hi - facts.lo)[row]
    behind = facts.background & (facts.ids > 0)
    if facts.extents[row, 2] > 0.3 * facts.extents[row, 0]:
        return "background"
    if sides[2] > 0.5 * facts.extents[row, 1]:
        return "wall"
    lowest = facts.lo[row, 2] <= facts.lo[behind, 2].min() + 0.05 * float(np.ptp(facts.hi[:, 2]))
    return "floor" if lowest else "surface"


def _places(
    facts: GroupFacts, cameras: Sequence[Camera], objects: BoolArray
) -> list[dict[str, float]]:
    """Share of the objects that are farther to each side than each group (G,); {} without sides."""
    camera = canonical_view(facts, cameras)
    places: list[dict[str, float]] = [{} for _ in range(len(facts))]
    if camera is None:
        return places
    seen = sight(facts, camera)
    rows = np.flatnonzero(objects & seen.inside)
    if len(rows) < _FEWEST_PLACED:
        return places
    across, away = _ranks(seen.u[rows]), _ranks(seen.depth[rows])
    for row, x, z in zip(rows, across, away, strict=True):
        places[row] = {"on the left": x, "on the right": 1 - x, "in front": z, "behind": 1 - z}
    return places


def _ranks(values: DoubleArray) -> DoubleArray:
    """Ranks in 0..1, ascending."""
    result: DoubleArray = values.argsort().argsort() / max(len(values) - 1, 1)
    return result
