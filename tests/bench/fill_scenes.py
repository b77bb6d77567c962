"""Scenes drawn by a seed, each with one object whose place is to be filled, and the true empty one.

Supports: a square table, the rim of a round one, a dish and a mound (both curved), the corner of a
room. Paints: plain, wood, cloth, checks, stripes, speckles. Objects have the shapes of the YCB set:
boxes, cans, balls, bottles, bowls, mugs; some more stand next to the one that is removed. Splats
are even or rough, as a training leaves them: off their surface, of uneven sizes and opacities.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from tests.bench.fill_cases import FillCase, trained
from tools.demo import objects
from tools.demo.lighting import Lights, bake
from tools.demo.objects import fractal, mix, noise, plain, weave, wood
from tools.demo.scene import gaussians_of, posed
from tools.demo.shapes import (
    Discs,
    Item,
    Material,
    Paint,
    Part,
    Patch,
    Surface,
    cover,
    ellipsoid,
    joined,
    moved,
    pose,
    rectangle,
    revolve,
    rounded_box,
)

Support = Literal["table", "rim", "dish", "mound", "corner"]
_SIZE = (320, 240)
_TOP = 0.45  # height of a support
_N_OTHERS = 3
_Profile = Callable[[float], float]  # height of the support at a distance from its middle


def drawn_case(seed: int, n_splats: int = 25_000) -> FillCase:
    """The scene of a seed; supports take turns, everything else is drawn from the seed."""
    support = get_args(Support)[seed % len(get_args(Support))]
    rng = np.random.default_rng((seed, 40))
    ground, height = _SUPPORTS[support](rng)
    names, things = _things(support, height, rng)
    surface = _covered([*ground, *things], n_splats, seed)
    first = len(ground) + 1
    rest = surface.take(surface.labels != first)
    roughness = float(rng.choice([0.0, 0.12, 0.25]))
    whole = _splats(surface, seed, roughness)
    cameras = _cameras(support, rng)
    test = cameras[2::5]
    train = tuple(camera for camera in cameras if camera not in test)
    kept = trained(whole, surface.labels == first, train)
    # The same chance for the same splats: only light and the object differ.
    truth = _splats(surface, seed, roughness, lit=rest).take(surface.labels != first)
    name = f"{support} {seed}: {names[0]}" + (", rough" if roughness else "")
    return FillCase(name, whole.take(kept), surface.labels[kept], first, truth, train, test)


def _covered(things: list[Item], n_splats: int, seed: int) -> Surface:
    """Discs of the things, labelled 1.., about ``n_splats`` of them."""
    rng = np.random.default_rng((seed, 41))
    probe = sum(len(cover(item, 1, 3.0, rng)) for item in things)
    coarseness = 3.0 * (probe / n_splats) ** (1 / 1.9)
    return joined([cover(item, k, coarseness, rng) for k, item in enumerate(things, start=1)])


def _splats(
    surface: Surface, seed: int, roughness: float, *, lit: Surface | None = None
) -> Gaussians:
    """Splats of all discs; with ``lit``, some of the discs, the light is as if only these were
    there: the others stay dark."""
    light_of = surface if lit is None else lit
    light = bake(light_of, Lights(), np.random.default_rng((seed, 42)))
    sh = light
    if lit is not None:
        there = np.isin(surface.labels, np.unique(lit.labels))
        sh = np.zeros((len(surface), *light.shape[1:]), np.float32)
        sh[there] = light
    exact = gaussians_of(surface, sh, np.random.default_rng((seed, 43)))
    rng = np.random.default_rng((seed, 44))
    n = len(surface)
    step = np.exp(exact.log_scales[:, :2]).mean(axis=1)[:, None]
    moved = exact.means + roughness * step * rng.normal(size=(n, 3))
    sizes = exact.log_scales + 1.5 * roughness * rng.normal(size=(n, 3))
    logits = exact.logit_opacities - 6 * roughness * rng.random(n)
    return replace(
        exact,
        means=moved.astype(np.float32),
        log_scales=sizes.astype(np.float32),
        logit_opacities=logits.astype(np.float32),
    )


# --- supports -------------------------------------------------------------------------------------


def _table(rng: np.random.Generator) -> tuple[list[Item], _Profile]:
    half = rng.uniform(0.45, 0.6)
    slab = rounded_box((2 * half, 2 * half, 0.05), 0.01)
    paint = Material(_paint(rng), gloss=float(rng.choice([0.0, 0.2])), shine=14.0)
    top = tuple(Part(patch, paint, (0.012, 0.012)) for patch in slab)
    return [
        Item("table", top, pose((0, 0, _TOP - 0.025), yaw=float(rng.uniform(0, 90)))),
        _floor(rng),
    ], lambda _: _TOP


def _rim(rng: np.random.Generator) -> tuple[list[Item], _Profile]:
    radius = rng.uniform(0.42, 0.5)
    profile = [(0.0, -0.05), (radius, -0.05), (radius, 0.0), (0.0, 0.0)]
    paint = Material(_paint(rng))
    top = Part(revolve(profile, smooth=False), paint, (0.012, 0.012))
    return [Item("table", (top,), pose((0, 0, _TOP))), _floor(rng)], lambda _: _TOP


def _curved(rng: np.random.Generator, sign: float) -> tuple[list[Item], _Profile]:
    radius, depth = 0.6, sign * rng.uniform(0.06, 0.12)

    def height(r: float) -> float:
        return _TOP + depth * min((r / radius) ** 2, 1.0)

    profile = [(r, height(r) - _TOP) for r in np.linspace(radius, 0, 12)]
    part = Part(revolve(profile), Material(_paint(rng)), (0.012, 0.012))
    return [Item("dish", (part,), pose((0, 0, _TOP))), _floor(rng)], height


def _corner(rng: np.random.Generator) -> tuple[list[Item], _Profile]:
    low, size, tall = -0.35, 1.1, 0.8
    step = (0.014, 0.014)
    floor = rectangle((low, low, 0), (size, 0, 0), (0, size, 0))
    left = rectangle((low, low, 0), (0, size, 0), (0, 0, tall))
    back = rectangle((low, low, 0), (0, 0, tall), (size, 0, 0))
    patches: list[tuple[Patch, ...]] = [(floor,), (left,), (back,)]
    if rng.random() < 0.5:  # the walls, or all three, are one group
        patches = [(floor,), (left, back)] if rng.random() < 0.5 else [(floor, left, back)]
    place = pose((0, 0, _TOP), yaw=150)  # open to the light
    found = []
    for group in patches:
        parts = tuple(Part(patch, Material(_paint(rng)), step) for patch in group)
        found.append(Item("wall", parts, place))
    return found, lambda _: _TOP


def _floor(rng: np.random.Generator) -> Item:
    patch = rectangle((-1.2, -1.2, 0), (2.4, 0, 0), (0, 2.4, 0))
    return Item("floor", (Part(patch, Material(_paint(rng)), (0.05, 0.05)),), pose())


_SUPPORTS: Mapping[Support, Callable[[np.random.Generator], tuple[list[Item], _Profile]]] = {
    "table": _table,
    "rim": _rim,
    "dish": lambda rng: _curved(rng, 1.0),
    "mound": lambda rng: _curved(rng, -1.0),
    "corner": _corner,
}


# --- things ---------------------------------------------------------------------------------------


def _things(
    support: Support, height: _Profile, rng: np.random.Generator
) -> tuple[list[str], list[Item]]:
    """The object to remove, and others apart from it."""
    names: list[str] = []
    found: list[Item] = []
    places: list[tuple[float, float, float]] = []  # x, y, radius
    while len(found) < 1 + _N_OTHERS:
        name, parts, radius = _thing(rng)
        x, y = _place(support, radius, rng)
        if found and any(np.hypot(x - a, y - b) < radius + r + 0.04 for a, b, r in places):
            continue
        foot = height(float(np.hypot(x, y))) + 0.001
        found.append(Item(name, parts, pose((x, y, foot), yaw=float(rng.uniform(0, 360)))))
        names.append(name)
        places.append((x, y, radius))
    return names, found


def _place(support: Support, radius: float, rng: np.random.Generator) -> tuple[float, float]:
    if support == "corner":
        x, y = rng.uniform(-0.34 + radius, 0.45, 2) if rng.random() < 0.5 else (-0.34 + radius,) * 2
        angle = np.radians(150)  # as the corner is turned
        x, y = x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)
        return float(x), float(y)
    far = rng.uniform(0.28, 0.42) if support == "rim" else 0.36 * np.sqrt(rng.random())
    angle = rng.uniform(0, 2 * np.pi)
    return float(far * np.cos(angle)), float(far * np.sin(angle))


def _thing(rng: np.random.Generator) -> tuple[str, tuple[Part, ...], float]:
    """Name, parts with the foot at z = 0, and radius of its foot."""
    kind = str(rng.choice(["box", "can", "ball", "bottle", "bowl", "mug"]))
    a, b, tall = rng.uniform((0.07, 0.05, 0.09), (0.13, 0.10, 0.26))
    paint = Material(_paint(rng, scale=0.3))
    step = (0.010, 0.010)
    if kind == "box":
        patches = rounded_box((2 * a, 2 * b, tall), 0.006)
        up = [replace(p, position=_raised(p, tall / 2)) for p in patches]
        return kind, tuple(Part(p, paint, step) for p in up), float(np.hypot(a, b))
    if kind == "ball":
        patch = ellipsoid((a, a, a), (0, 0, a))
        return kind, (Part(patch, paint, step),), float(a)
    if kind in ("bowl", "mug"):
        color = tuple(rng.uniform(0.2, 0.9, 3))
        made = objects.bowl(color) if kind == "bowl" else objects.mug(color)
        made = moved(made, pose(scale=1.4))
        reach = max(
            float(np.hypot(*cover(Item("", (p,), pose()), 1, 4.0, rng).points[:, :2].T).max())
            for p in made
        )
        return kind, tuple(made), reach
    wall = [(0.0, 0.0), (b, 0.0), (b, tall), (0.0, tall)]
    if kind == "bottle":
        wall = [(0, 0), (b, 0), (b, 0.6 * tall), (0.4 * b, 0.8 * tall), (0.4 * b, tall), (0, tall)]
    return kind, (Part(revolve(wall, smooth=False), paint, step),), float(b)


def _raised(patch: Patch, by: float) -> Callable[[DoubleArray, DoubleArray], DoubleArray]:
    def position(u: DoubleArray, v: DoubleArray) -> DoubleArray:
        return patch.position(u, v) + np.array([0, 0, by])

    return position


# --- paints ---------------------------------------------------------------------------------------


def _paint(rng: np.random.Generator, scale: float = 1.0) -> Paint:
    """Any paint; ``scale`` of its pattern."""
    light, dark = rng.uniform(0.45, 0.9, 3), rng.uniform(0.15, 0.6, 3)
    seed, size = int(rng.integers(1000)), scale * float(rng.uniform(0.06, 0.16))
    kind = str(rng.choice(["plain", "wood", "cloth", "checks", "stripes", "speckles"]))
    if kind == "plain":
        return plain(tuple(light), mottle=0.05, scale=0.1, seed=seed)
    if kind == "wood":
        return wood(tuple(light), tuple(dark), axis=int(rng.integers(2)), seed=seed)
    if kind == "cloth":
        return weave(plain(tuple(light), mottle=0.08, scale=0.05, seed=seed), thread=0.04)
    turn = rng.uniform(0, np.pi)

    def pattern(d: Discs) -> DoubleArray:
        along = d.points @ np.array([np.cos(turn), np.sin(turn), 0.3])
        across = d.points @ np.array([-np.sin(turn), np.cos(turn), 0.3])
        if kind == "speckles":
            return mix(light, dark, (noise(d.points / 0.025, seed) - 0.55) * 4)
        cell = np.floor(along / size)
        if kind == "checks":
            cell = cell + np.floor(across / size)
        shade = 0.9 + 0.2 * fractal(d.points / 0.05, 2, seed)
        return mix(light, dark, cell % 2 == 1) * shade[:, None]

    return pattern


def _cameras(support: Support, rng: np.random.Generator) -> tuple[Camera, ...]:
    """From all sides, or of a corner from its open side."""
    n, turn = 25, rng.uniform(0, 360)
    found = []
    for k in range(n):
        azimuth = turn + 360 * k / n if support != "corner" else 195 + 70 * (k + 0.5) / n - 35
        elevation = np.radians(25 + 45 * ((k * 0.618) % 1.0))
        distance = rng.uniform(0.9, 1.3)
        flat = distance * np.cos(elevation)
        eye = (
            float(flat * np.cos(np.radians(azimuth))),
            float(flat * np.sin(np.radians(azimuth))),
            _TOP + float(distance * np.sin(elevation)),
        )
        aim = rng.uniform((-0.08, -0.08, _TOP), (0.08, 0.08, _TOP + 0.1))
        at = (float(aim[0]), float(aim[1]), float(aim[2]))
        found.append(posed(eye, at, 55.0, _SIZE, f"view_{k:03d}.jpg"))
    return tuple(found)
