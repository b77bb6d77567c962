"""Words for unnamed groups: "red box, large", "blue object behind".

Color, shape and size are measured; a place and at last a number tell apart what would be called
the same. A description that is still true stays as it is when other groups come and go, and what a
thing is does not change with where a person puts it.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray
from gaga_core.camera import Camera
from gaga_core.query.colors import HUES, NAMES
from gaga_core.query.group_facts import GroupFacts
from gaga_core.query.spatial_relations import canonical_view, sight
from gaga_core.scene.scene import Scene, State

# --- Shape words that were measured: flat, long, tall, box-like, round.
# The first three are ratios of extents. Of the others a sample of splats is looked at: on a box
# the largest of the three normalized coordinates is the same everywhere, on a ball the distance
# from the middle is, on a can that stands the larger of height and distance from the axis;
# whichever varies least, and clearly so, gives the word.


Shape = Literal["flat", "long", "tall", "box", "round", ""]

_FLAT, _FLAT_WIDTH = 0.2, 0.4  # thinnest and middle extent of flat objects, shares of the longest
_LONG = 0.35  # middle extent of long objects
_UPRIGHT = 0.8  # height of long objects that stand, share of the longest side
_SAMPLE = 300  # splats of a group that are sampled
_FEWEST = 60
_TURNS = 6  # about the vertical, within a quarter turn, that a box is tried at
_EDGE = 94  # percentile of a coordinate at which a side lies
_VARIES = 0.2  # most that a norm varies (deviation over mean) on a surface
_CLEARLY, _CLEARLY_BOX = 0.86, 0.7  # of another norm's variation
_SOLID = 0.55  # thinnest extent of a ball


def shapes_of(scene: Scene, facts: GroupFacts) -> tuple[Shape, ...]:
    """The shape word of each group of ``facts``, "" where none was measured."""
    longest = np.maximum(facts.extents[:, 0], 1e-12)
    middle, thin = facts.extents[:, 1] / longest, facts.extents[:, 2] / longest
    order = np.argsort(scene.labels, kind="stable")
    starts = np.searchsorted(scene.labels[order], facts.ids)
    ends = np.searchsorted(scene.labels[order], facts.ids, "right")
    words: list[Shape] = []
    for row, (start, end) in enumerate(zip(starts, ends, strict=True)):
        if middle[row] < _LONG:
            upright = facts.height[row] > _UPRIGHT * float((facts.hi - facts.lo)[row].max())
            words.append("tall" if upright else "long")
        elif thin[row] < _FLAT and middle[row] > _FLAT_WIDTH:
            words.append("flat")
        else:
            chosen = order[start:end]
            points = _upright(scene, facts, row, chosen[:: -(-len(chosen) // _SAMPLE)])
            words.append(_body(points, float(thin[row])))
    return tuple(words)


def _upright(scene: Scene, facts: GroupFacts, row: int, splats: AnyArray) -> DoubleArray:
    """Positions (K, 3) in the upright frame of those of ``splats`` that are in the group's box."""
    there = splats[(scene.state[splats] & np.uint8(State.DELETED)) == 0]
    matrix = facts.frame @ scene.placements.matrix[scene.placement[there]]
    means = scene.gaussians.means[there]
    points = np.einsum("kij,kj->ki", matrix[:, :, :3], means) + matrix[:, :, 3]
    inside = ((points >= facts.lo[row]) & (points <= facts.hi[row])).all(axis=1)
    return points[inside]


def _body(points: DoubleArray, thin: float) -> Shape:
    if len(points) < _FEWEST:
        return ""
    own = _normalized(points)
    ball = _variation(np.linalg.norm(own, axis=1))
    can = _variation(np.maximum(np.linalg.norm(own[:, :2], axis=1), np.abs(own[:, 2])))
    box = np.inf
    for turn in np.arange(_TURNS) * np.pi / 2 / _TURNS:
        c, s = np.cos(turn), np.sin(turn)
        turned = _normalized(points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]))
        box = min(box, _variation(np.abs(turned).max(axis=1)))
    if box < _VARIES and box < _CLEARLY_BOX * min(ball, can):
        return "box"
    curved = min(ball, can) if thin > _SOLID else can
    return "round" if curved < _VARIES and curved < _CLEARLY * box else ""


def _normalized(points: DoubleArray) -> DoubleArray:
    """Coordinates that are -1 and 1 at the sides."""
    low, high = np.percentile(points, [100 - _EDGE, _EDGE], axis=0)
    return (2 * points - low - high) / np.maximum(high - low, 1e-12)


def _variation(values: DoubleArray) -> float:
    return float(values.std() / max(float(values.mean()), 1e-12))


_LARGE, _SMALL = 2.2, 0.45  # sizes against the median of the objects
_LEADS = 0.25  # share of the foremost color below which an object of many hues is "colorful"
_HUE, _MANY_HUES = 0.09, 4  # share of a hue that counts, and how many of them are many
_WHITE = 0.27  # of the grey: so much white, and the grey is its shade
_MOSTLY = 0.5  # share of both from which on an object is called white
_BESIDES_GREY = 0.32  # of both: so much of a hue tells more, as on a can with a label
_SIDE = 0.3  # share of the objects at each end that are left, right, behind, in front
_TOLD_SIDE = 0.5  # the same to tell apart what would be called the same
_STILL_SIDE = 0.6  # for words that were given before: others move, come and go
_FEWEST_PLACED = 4  # objects in the view from which on there are sides
_NOUNS: dict[Shape, str] = {"box": "box", "round": "round object", "flat": "flat object",
                            "long": "long object", "tall": "tall object", "": "object"}  # fmt: skip
_NUMBER = re.compile(r" \d+$")


@dataclass(frozen=True)
class _Said:
    """Facts of a group."""

    what: str  # "red box, large"
    place: str  # "behind"; "" = nowhere in particular
    sides: Mapping[str, float]  # places that are not wrong, and how many are farther there, 0..1
    still: tuple[str, ...] = ()  # other words for `what` that are true: with and without its size

    def at(self, place: str, what: str = "") -> str:
        """The words with a place."""
        what = what or self.what
        return f"{what}{' ' if ',' not in what else ', '}{place}"

    def fits(self, text: str) -> bool:
        """Whether ``text``, perhaps with a number, is still true."""
        words = _NUMBER.sub("", text)
        return any(
            words == what or any(words == self.at(side, what) for side in self.sides)
            for what in (self.what, *self.still)
        )


def describe_groups(
    scene: Scene,
    facts: GroupFacts,
    cameras: Sequence[Camera] = (),
    kept: Mapping[int, str] | None = None,
    came: tuple[Scene, GroupFacts] | None = None,
) -> dict[int, str]:
    """Descriptions by group of all groups of ``facts`` that have no name; no two are equal, nor
    equal to a name. 0 (no group) has none.

    ``kept`` are descriptions of an earlier state: they stay where they are still true. Left and
    behind are meant from the train view that sees most; without ``cameras`` there are no places.
    ``came`` are the scene before anything was moved or deleted and its facts, with these groups and
    maybe others: what things are is read there, and where they are here.
    """
    said = {
        int(group): one
        for group, one in zip(
            facts.ids, _said(*(came or (scene, facts)), facts, cameras), strict=True
        )
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
    sides = [s for s, rank in one.sides.items() if rank < _TOLD_SIDE]
    first = [s for s in sides if all(one.sides[s] <= o.sides.get(s, 1.0) for o in alike)]
    places = [one.place] * bool(one.place) + sorted(first, key=one.sides.__getitem__)
    free = (text for text in map(one.at, places) if text not in used)
    return next(free, one.at(one.place) if one.place else one.what)


def _unique(text: str, used: set[str]) -> str:
    name, k = text, 1
    while name in used:
        k += 1
        name = f"{text} {k}"
    return name


def _said(
    scene: Scene, facts: GroupFacts, now: GroupFacts, cameras: Sequence[Camera]
) -> list[_Said]:
    """What ``scene`` and its ``facts`` say that groups are, and facts ``now`` where they are; one
    for each group of ``now``."""
    objects = ~facts.background & (facts.ids > 0)
    median = float(np.median(facts.size[objects])) if objects.any() else 1.0
    shares, shapes = facts.size / max(median, 1e-12), shapes_of(scene, facts)
    rows = np.searchsorted(facts.ids, now.ids)
    places = _places(now, canonical_view(facts, cameras), objects[rows])
    said = []
    for row, ends, size_now in zip(rows, places, now.size, strict=True):
        color, share_now = _color(facts, row), size_now / max(median, 1e-12)
        if not objects[row]:
            what = _support(facts, row) if facts.ids[row] > 0 else "rest"
            said.append(_Said(f"{color} {what}", "", {}))
            continue
        if color == "grey":
            color = _besides_grey(facts, row)
        word, smaller = _size_word(shares[row]), min(shares[row], share_now) < 1
        larger = max(shares[row], share_now) > 1
        if _size_word(share_now) != word:  # of one that was scaled
            word = ""
        base = f"{color} {_NOUNS[shapes[row]]}"
        still = (base, *[f"{base}, small"] * (not larger), *[f"{base}, large"] * (not smaller))
        side = min(ends, key=lambda name: ends[name], default="")
        place = side if side and ends[side] < _SIDE else ""
        sides = {name: rank for name, rank in ends.items() if rank < _STILL_SIDE}
        said.append(_Said(base + word, place, sides, still))
    return said


def _size_word(share: float) -> str:
    return ", large" if share > _LARGE else ", small" if share < _SMALL else ""


def _color(facts: GroupFacts, row: int) -> str:
    """The foremost color as it shows from outside, or "colorful"."""
    share = facts.colors[row]
    best = int(share.argmax())
    hues = [facts.colors[row, NAMES.index(n)] for n in HUES if n not in ("brown", "gold")]
    if share[best] < _LEADS and sum(hue > _HUE for hue in hues) >= _MANY_HUES:
        return "colorful"
    return NAMES[best]


def _besides_grey(facts: GroupFacts, row: int) -> str:
    """What people call an object that is mostly grey: "white" in shade, or the hue that
    tells more of it; else "grey"."""
    share = dict(zip(NAMES, facts.colors[row].tolist(), strict=True))
    both = share["grey"] + share["white"]
    shaded = max(_WHITE * share["grey"], share["black"])  # with more black it is dark in the light
    if share["white"] > shaded and both > _MOSTLY:
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


def _places(facts: GroupFacts, camera: Camera | None, objects: BoolArray) -> list[dict[str, float]]:
    """Share of the objects that are farther to each side than each group (G,); {} without sides."""
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
    ranks = values.argsort(kind="stable").argsort()
    return ranks / max(len(values) - 1, 1)
