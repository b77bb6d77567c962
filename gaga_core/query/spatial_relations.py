"""Places of groups: measures in space and in a view, and relations between two groups."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.camera import NEAR, Camera
from gaga_core.color import lab_from_rgb
from gaga_core.query.colors import HUES, NAMES
from gaga_core.query.group_facts import GroupFacts

_NEAR_GAP = 1.0  # "next to": gap in sizes of the two at which the score has fallen to 1/e
_CENTRED = 0.7  # what lies over something with its middle does so to this part at least
_CLOSER = 0.15  # share of a relation's score that prefers what is close by


@dataclass(frozen=True, eq=False)
class Sight:
    """Groups as a camera sees them."""

    u: DoubleArray  # (G,) column of the centre, pixels
    v: DoubleArray  # (G,) row
    depth: DoubleArray  # (G,) along the viewing direction
    half_width: DoubleArray  # (G,) pixels, about
    inside: BoolArray  # (G,) the centre is in the picture
    middle: tuple[float, float]


def sight(facts: GroupFacts, camera: Camera) -> Sight:
    """Groups of ``facts`` in the picture of ``camera``; occlusion is not looked at."""
    pixels, depth = camera.project(facts.centre @ facts.frame)
    before = depth > NEAR
    u, v = pixels.T
    inside = before & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    axis = np.abs(facts.frame @ camera.cam_from_world[0, :3])  # the picture's x, upright frame
    across = 0.5 * (facts.hi - facts.lo) @ axis
    half_width = np.where(before, across * camera.K[0, 0] / np.maximum(depth, NEAR), np.inf)
    return Sight(u, v, depth, half_width, inside, (camera.width / 2, camera.height / 2))


def canonical_view(facts: GroupFacts, cameras: Sequence[Camera]) -> Camera | None:
    """The view that place words mean when nobody looks: of ``cameras``, the one in whose picture
    most objects have their centre, the first by name of equals. None without cameras."""
    best: tuple[int, Camera] | None = None
    for camera in sorted(cameras, key=lambda c: c.name):
        n = int((sight(facts, camera).inside & ~facts.background).sum())
        if best is None or n > best[0]:
            best = (n, camera)
    return None if best is None else best[1]


def measure(facts: GroupFacts, name: str, seen: Sight | None) -> DoubleArray | None:
    """Measure ``name`` (G,) of all groups; NaN where a group has none (out of the picture).

    None when it needs a view and there is none.
    """
    if name in _IN_SPACE:
        return _IN_SPACE[name](facts)
    if seen is None:
        return None
    away = np.hypot(seen.u - seen.middle[0], seen.v - seen.middle[1])
    values = {"right": seen.u, "depth": seen.depth, "middle": -away}[name]
    shown = seen.inside if (seen.inside & ~facts.background).any() else seen.depth > NEAR
    return np.where(shown, values, np.nan)


def _colorfulness(facts: GroupFacts) -> DoubleArray:
    """Number of hues, by entropy, times how much of the group has one."""
    hues = facts.vivid[:, [NAMES.index(name) for name in HUES if name != "brown"]]
    total = hues.sum(axis=1, keepdims=True)
    p = hues / np.maximum(total, 1e-12)
    entropy = -(p * np.log(np.maximum(p, 1e-12))).sum(axis=1)
    return np.exp(entropy) * total[:, 0]


_IN_SPACE: dict[str, Callable[[GroupFacts], DoubleArray]] = {
    "size": lambda f: f.size,
    "height": lambda f: f.height,
    "length": lambda f: f.extents[:, 0],
    "width": lambda f: np.hypot(*(f.hi - f.lo)[:, :2].T),
    "thickness": lambda f: f.extents[:, 2],
    "roundness": lambda f: f.extents[:, 2] / np.maximum(f.extents[:, 0], 1e-12),
    "top": lambda f: f.hi[:, 2],
    "lightness": lambda f: lab_from_rgb(f.rgb)[:, 0],
    "colorfulness": _colorfulness,
}


def relation_score(
    facts: GroupFacts, kind: str, anchors: Sequence[int], seen: Sight | None
) -> DoubleArray | None:
    """How well every group (G,) stands in a relation to the groups in rows ``anchors``, 0..1.

    One anchor, two for "between". None when the relation needs a view and there is none.
    """
    if kind == "between":
        return _between(facts, anchors[0], anchors[1])
    a = anchors[0]
    if kind[0] in "+-":
        values = measure(facts, kind[1:], seen)
        if values is None:
            return None
        more = values > values[a] if kind[0] == "+" else values < values[a]
        return np.where(more, 1.0, 0.0)
    if kind in _IN_VIEW:
        score, sign = _IN_VIEW[kind]
        return None if seen is None else _closer(facts, a, score(facts, a, seen, sign))
    return _IN_WORLD[kind](facts, a)


def _beside(facts: GroupFacts, a: int, seen: Sight, sign: int) -> DoubleArray:
    """Right (``sign`` 1) or left (-1) of it in the picture."""
    width = 0.5 * (seen.half_width + seen.half_width[a])
    return _ramp(sign * (seen.u - seen.u[a]), width) * seen.inside


def _beyond(facts: GroupFacts, a: int, seen: Sight, sign: int) -> DoubleArray:
    """Farther away (``sign`` 1) or nearer (-1), and not far next to it in the picture."""
    half = 0.5 * facts.size
    away = _ramp(sign * (seen.depth - seen.depth[a]), 0.5 * (half + half[a]))
    reach = 2 * (seen.half_width + seen.half_width[a])
    with np.errstate(invalid="ignore"):
        aside = np.nan_to_num(np.abs(seen.u - seen.u[a]) / reach)
    return away * np.exp(-(np.maximum(aside - 0.5, 0) ** 2) * 2) * seen.inside


_IN_VIEW = {
    "left": (_beside, -1), "right": (_beside, 1), "behind": (_beyond, 1), "before": (_beyond, -1),
}  # fmt: skip


def _closer(facts: GroupFacts, a: int, score: DoubleArray) -> DoubleArray:
    """``score``, a little higher for what is near the anchor."""
    return score * (1 - _CLOSER + _CLOSER * np.exp(-_gap(facts, a) / 3))


def _above(facts: GroupFacts, a: int) -> DoubleArray:
    higher = _ramp(facts.centre[:, 2] - facts.hi[a, 2], 0.5 * facts.height)
    return _closer(facts, a, np.maximum(higher, _on(facts, a)) * _overlap(facts, a))


def _below(facts: GroupFacts, a: int) -> DoubleArray:
    lower = _ramp(facts.lo[a, 2] - facts.centre[:, 2], 0.5 * facts.height)
    return _closer(facts, a, lower * _overlap(facts, a))


def _on(facts: GroupFacts, a: int) -> DoubleArray:
    """Its foot is about as high as the anchor's top (or lies inside it: a bowl carries too), and
    its middle is over it."""
    own = 0.5 * facts.height + 0.1 * facts.height[a]
    gap = np.maximum(np.abs(facts.lo[:, 2] - facts.hi[a, 2]) - 0.3 * own, 0)
    foot = np.exp(-gap / np.maximum(own, 1e-12))
    higher = facts.centre[:, 2] > facts.centre[a, 2]
    return np.where(higher, foot * _overlap(facts, a), 0.0)


def _inside(facts: GroupFacts, a: int) -> DoubleArray:
    """Its middle is inside the anchor's footprint, and its foot is under the anchor's rim."""
    held = (facts.lo[:, 2] < facts.hi[a, 2]) & (facts.hi[:, 2] > facts.lo[a, 2])
    smaller = facts.size < 2 * facts.size[a]
    return np.where(held & smaller, _overlap(facts, a), 0.0)


_IN_WORLD: dict[str, Callable[[GroupFacts, int], DoubleArray]] = {
    "above": _above, "below": _below, "on": _on, "inside": _inside,
    "near": lambda facts, a: np.exp(-((_gap(facts, a) / _NEAR_GAP) ** 2)),
    "nearest": lambda facts, a: 1 / (1 + _gap(facts, a)),
    "farthest": lambda facts, a: 1 - np.exp(-_gap(facts, a) / 4),
    "away": lambda facts, a: 1 - np.exp(-_gap(facts, a) / 4),
}  # fmt: skip


def _between(facts: GroupFacts, a: int, b: int) -> DoubleArray:
    """Its middle projects onto the line from one to the other, and it does not lie far off it."""
    line = facts.centre[b] - facts.centre[a]
    length = max(float(np.linalg.norm(line)), 1e-12)
    t = (facts.centre - facts.centre[a]) @ line / length**2
    off = np.linalg.norm(facts.centre - facts.centre[a] - t[:, None] * line, axis=1)
    along = np.clip(np.minimum(t, 1 - t) / 0.15, 0, 1)
    ends = facts.centre[[a, b], None, :2]
    under = ((facts.lo[:, :2] < ends) & (ends < facts.hi[:, :2])).all(axis=(0, 2))
    along = along * ~under  # what both stand on is not between them
    return along * np.exp(-((off / (0.35 * length + 0.5 * facts.size)) ** 2))


def _gap(facts: GroupFacts, a: int) -> DoubleArray:
    """Distance (G,) between boxes, in mean sizes of the two."""
    between = np.maximum(facts.lo - facts.hi[a], facts.lo[a] - facts.hi)
    apart = np.linalg.norm(np.maximum(between, 0), axis=1)
    size = np.minimum(facts.size, 2 * facts.size[a])
    return apart / np.maximum(0.5 * (size + facts.size[a]), 1e-12)


def _overlap(facts: GroupFacts, a: int) -> DoubleArray:
    """Share (G,) of a footprint that lies over the anchor's; `_CENTRED` at least where the middle
    does (flowers are wider than their vase)."""
    low = np.maximum(facts.lo[:, :2], facts.lo[a, :2])
    high = np.minimum(facts.hi[:, :2], facts.hi[a, :2])
    sides = np.maximum(facts.hi[:, :2] - facts.lo[:, :2], 1e-12)
    share = (np.maximum(high - low, 0) / sides).prod(axis=1)
    middle = facts.centre[:, :2]
    over = ((facts.lo[a, :2] < middle) & (middle < facts.hi[a, :2])).all(axis=1)
    return np.where(over, np.maximum(share, _CENTRED), share)


def _ramp(margin: DoubleArray, width: DoubleArray) -> DoubleArray:
    """0 up to no margin at all, 1 from a margin of ``width`` on."""
    with np.errstate(invalid="ignore"):
        result: DoubleArray = np.clip(np.nan_to_num(margin / np.maximum(width, 1e-12)), 0, 1)
    return result
