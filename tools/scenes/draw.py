"""From an arrangement to splats: surfaces as flat discs with light in them, clean or with noise."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.color import dc_from_rgb
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import matrices_to_quats
from tools.scenes.arrange import Arrangement, Block

_LEAST, _MOST = 1500, 6000  # splats of an object
_PER_AREA = 90_000  # splats per square metre of an object, between these
_GROUND = 20_000  # splats of the surroundings
_SPREAD = 0.75  # standard deviation, in distances to the next splat
_THIN = 0.12  # of it: across the surface
_SHADOW = 0.005  # metres of a cell of the map of shadows


@dataclass(frozen=True, eq=False)
class Discs:
    """Points of surfaces: all (N, 3) but sizes and labels (N,)."""

    points: DoubleArray
    normals: DoubleArray
    colors: DoubleArray  # 0..1
    sizes: DoubleArray  # metres to the next
    labels: IntArray  # object 1.., then furniture; 0 = the room


@dataclass(frozen=True, eq=False)
class Look:
    """What the surroundings look like, and from where light comes."""

    colors: DoubleArray  # (blocks, 2, 3)
    prints: DoubleArray  # (blocks, 2) waves per metre; 0 = plain
    styles: IntArray  # (blocks,) 0 plain, 1 checks, 2 stripes, 3 cloudy
    clouds: DoubleArray  # (256, 256) mean 0
    light: DoubleArray  # (3,) unit, towards it

    @staticmethod
    def drawn(n: int, rng: np.random.Generator) -> "Look":
        """A look for ``n`` blocks."""
        base = rng.uniform(0.2, 0.85, (n, 1)) * (1 + rng.normal(0, 0.12, (n, 3)))
        second = np.clip(
            base + rng.normal(0, 0.18, (n, 1)) + rng.normal(0, 0.07, (n, 3)), 0.05, 0.95
        )
        clouds = sum(
            ndimage.gaussian_filter(rng.normal(size=(256, 256)), s, mode="wrap") * s
            for s in (1, 2, 4, 8, 16)
        )
        light = np.array([*rng.uniform(-0.7, 0.7, 2), 1.0])
        return Look(
            np.stack([np.clip(base, 0.05, 0.95), second], axis=1),
            rng.uniform(3, 30, (n, 2)),
            rng.integers(0, 4, n).astype(np.int32),
            np.asarray(clouds / np.std(clouds)),
            light / np.linalg.norm(light),
        )


def discs(found: Arrangement, look: Look, factor: float, rng: np.random.Generator) -> Discs:
    """Surfaces of the arrangement with ``factor`` times the usual number of discs."""
    parts = []
    for k, thing in enumerate(found.objects):
        area = thing.mesh.area
        n = int(factor * np.clip(area * _PER_AREA, _LEAST, _MOST))
        points, normals, colors = thing.mesh.sample(n, rng)
        place = found.rest.places[k]
        parts.append(
            Discs(
                points @ place[:3, :3].T + place[:3, 3],
                normals @ place[:3, :3].T,
                colors,
                np.full(n, np.sqrt(area / n)),
                np.full(n, k + 1, np.int32),
            )
        )
    objects = _joined(parts)
    for b, side in _ground(found.blocks, objects.points, look, factor, rng):
        piece = found.blocks[b].furniture
        label = len(found.objects) + piece if piece else 0
        parts.append(replace(side, labels=np.full(len(side.labels), label, np.int32)))
    return _lit(_joined(parts), objects.points, look)


def _joined(parts: list[Discs]) -> Discs:
    names = ("points", "normals", "colors", "sizes", "labels")
    return Discs(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))


def _ground(
    blocks: tuple[Block, ...],
    things: DoubleArray,
    look: Look,
    factor: float,
    rng: np.random.Generator,
) -> list[tuple[int, Discs]]:
    """Sides of the blocks that can be seen, with the index of the block: finer near the things."""
    sides = []
    for b, block in enumerate(blocks):
        low, high = np.array(block.low), np.array(block.high)
        for axis in range(3):
            for sign in (-1, 1):
                if axis == 2 and sign < 0:
                    continue
                u, v = [k for k in range(3) if k != axis]
                sides.append((b, axis, sign, u, v, low, high))
    middle = things.mean(axis=0)
    reach = np.linalg.norm(things - middle, axis=1).max() + 0.1

    def weight(points: DoubleArray) -> DoubleArray:
        away = np.linalg.norm(points - middle, axis=1) / reach
        return 1 / np.maximum(away, 1) ** 2

    found, trial = [], []
    for b, axis, sign, u, v, low, high in sides:
        area = (high[u] - low[u]) * (high[v] - low[v])
        n = int(4000 + 60_000 * factor * min(area, 4))
        at = np.empty((n, 3))
        at[:, u] = rng.uniform(low[u], high[u], n)
        at[:, v] = rng.uniform(low[v], high[v], n)
        at[:, axis] = high[axis] if sign > 0 else low[axis]
        w = weight(at) * area / n
        trial.append((b, axis, sign, u, v, at, w))
    scale = _GROUND * factor / sum(float(w.sum()) for *_, w in trial)
    for b, axis, sign, u, v, drawn, w in trial:
        at = drawn[rng.random(len(drawn)) < w * scale]
        density = weight(at) * scale
        normals = np.zeros_like(at)
        normals[:, axis] = sign
        colors = _printed(b, at[:, u], at[:, v], look)
        most = np.sqrt(1 / density)
        found.append((b, Discs(at, normals, colors, most, np.zeros(len(at), np.int32))))
    return found


def _printed(b: int, u: DoubleArray, v: DoubleArray, look: Look) -> DoubleArray:
    """Colors (N, 3) of block ``b`` at ``u``, ``v`` (N,) in metres."""
    fu = look.prints[b, 0]
    style = look.styles[b]
    cells = look.clouds[
        (u * 220).astype(int) % 256, (v * (60 if style == 2 else 220)).astype(int) % 256
    ]
    if style == 1:
        share = ((np.floor(u * fu) + np.floor(v * fu)) % 2).astype(float)
    elif style == 2:
        share = 0.5 + 0.5 * np.sin(2 * np.pi * fu * u + cells * 0.4)
    elif style == 3:
        share = np.clip(0.5 + 0.4 * cells, 0, 1)
    else:
        share = np.zeros(len(u))
    one, two = look.colors[b]
    mixed = one + share[:, None] * (two - one)
    return np.clip(mixed * (1 + 0.05 * cells[:, None]), 0, 1)


def _lit(surface: Discs, things: DoubleArray, look: Look) -> Discs:
    """With light from one side, softer from the sky, and shadows on what lies below things."""
    facing = np.clip(surface.normals @ look.light, 0, 1)
    sky = 0.5 + 0.5 * surface.normals[:, 2]
    low = np.array([-1.0, -1.0])
    n = int(2.0 / _SHADOW)

    def cells(points: DoubleArray) -> IntArray:
        flat = points[:, :2] - look.light[:2] / look.light[2] * points[:, 2:]
        return np.clip((flat - low) / _SHADOW, 0, n - 1).astype(np.int32)

    def blurred(at: IntArray, sigma: float, gain: float) -> DoubleArray:
        counts = np.zeros((n, n))
        counts[at[:, 0], at[:, 1]] = 1
        solid = ndimage.binary_closing(counts > 0, iterations=3).astype(float)
        return gain * ndimage.gaussian_filter(solid, sigma)

    cast = blurred(cells(things), 2.0, 0.75)
    under = things[things[:, 2] < 0.05]
    foot = np.clip((under[:, :2] - low) / _SHADOW, 0, n - 1).astype(np.int32)
    contact = blurred(foot, 4.0, 0.5) if len(foot) else np.zeros((n, n))
    on_top = np.arange(len(surface.labels)) >= len(things)  # what comes after the objects
    on_top &= (surface.normals[:, 2] > 0.5) & (np.abs(surface.points[:, 2]) < 0.01)
    at = cells(surface.points)
    shade, near = np.zeros(len(on_top)), np.zeros(len(on_top))
    shade[on_top] = cast[at[on_top, 0], at[on_top, 1]]
    near[on_top] = contact[at[on_top, 0], at[on_top, 1]]
    light = 0.62 * facing * (1 - shade) + 0.28 + 0.2 * sky * (1 - near)
    return replace(surface, colors=np.clip(surface.colors * light[:, None], 0, 1))


def gaussians_of(
    surface: Discs, strength: float, rng: np.random.Generator
) -> tuple[Gaussians, IntArray]:
    """Flat splats and their labels (N,); at a strength of 0 clean, at 1 as a short training
    leaves them: off the surface, of odd sizes and colors, with floaters."""
    n = len(surface.labels)
    normals = surface.normals + strength * 0.2 * rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0, 1]], [[1.0, 0, 0]])
    tangents = np.cross(helper, normals)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    axes = np.stack([tangents, np.cross(normals, tangents), normals], axis=2)
    wide = _SPREAD * surface.sizes
    off = strength * rng.normal(0, 1, n) * np.minimum(wide, 0.004)
    logs = np.log(wide[:, None] * np.array([1, 1, _THIN]))
    logs += strength * rng.normal(0, 0.3, (n, 3))
    points = surface.points + surface.normals * off[:, None]
    opacity = 4.0 + strength * (rng.normal(0, 1.3, n) - 1.0)
    sh = np.zeros((n, 4, 3))
    colors = surface.colors + strength * rng.normal(0, 0.025, (n, 3))
    sh[:, 0] = dc_from_rgb(colors.astype(np.float32))
    sh[:, 1:] = strength * rng.normal(0, 0.04, (n, 3, 3))
    labels = surface.labels
    floaters = rng.choice(n, int(0.004 * strength * n), replace=False)
    points[floaters] += rng.normal(0, 0.06, (len(floaters), 3))
    opacity[floaters] = rng.normal(-1.5, 0.7, len(floaters))
    labels = labels.copy()
    labels[floaters] = 0
    made = Gaussians(
        means=points.astype(np.float32),
        quats=matrices_to_quats(axes).astype(np.float32),
        log_scales=logs.astype(np.float32),
        logit_opacities=opacity.astype(np.float32),
        sh=np.ascontiguousarray(sh, np.float32),
    )
    return made, labels
