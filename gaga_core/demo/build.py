"""The demo's model: objects laid out, covered with discs, lit, turned into splats."""

from collections.abc import Container, Generator, Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.color import dc_from_rgb
from gaga_core.demo import room
from gaga_core.demo.layout import items
from gaga_core.demo.lighting import Lights, bake
from gaga_core.demo.splats import gaussians_of
from gaga_core.demo.surface import Surface, cover, joined
from gaga_core.gaussians import Gaussians
from gaga_core.progress import Progress

STAGE = "Make the demo scene"
_N_AT_ONE = 147_000  # splats at coarseness 1; their number falls with its square
_SHOWN_EVERY = 8  # objects from one picture of what is there to the next
_UNLIT = 0.85  # of the surface's own color, while there is no light
_FINE_EDGES = 1.9  # ... nearly: discs at bends and edges grow fewer more slowly


@dataclass(frozen=True, eq=False)
class Model:
    """Splats with the truth about them."""

    gaussians: Gaussians
    labels: IntArray  # (N,) object of each splat: 1.., 0 = floor and walls
    names: tuple[str, ...]  # of objects 1..
    steps: int  # progress steps that building took


def _unlit(surfaces: Sequence[Surface]) -> Gaussians:
    """What is there so far, in its own colors: something to see while the rest is made."""
    surface = joined(surfaces)
    sh = np.zeros((len(surface), 1, 3), np.float32)
    sh[:, 0] = dc_from_rgb((_UNLIT * surface.albedo).astype(np.float32))
    return gaussians_of(surface, sh, np.random.default_rng(0))  # a chance of its own


def build_stage(
    n_splats: int, seed: int, steps_after: int, *, without: Container[int] = ()
) -> Generator[Progress, None, Model]:
    """Build about ``n_splats`` splats; ``steps_after`` belong to the whole task's progress.

    Payloads are `Gaussians` so far, without light. ``without``: ids of objects to leave out; all
    others stand where they stand with them, in light that nothing of these keeps off.
    """
    rng = np.random.default_rng((seed, 0))
    coarseness = (_N_AT_ONE / n_splats) ** (1 / _FINE_EDGES)
    objects, lights = items(), Lights()
    rays = lights.sky_rays + lights.key_rays
    steps = len(objects) + 1 + rays
    total = steps + steps_after
    surfaces = [room.shell(coarseness, rng)]
    for k, item in enumerate(objects, start=1):
        so_far = _unlit(surfaces) if (k - 1) % _SHOWN_EVERY == 0 else None
        yield Progress(STAGE, k, total, item.name.capitalize(), so_far)
        surfaces.append(cover(item, k, coarseness, rng))
    surface = joined([part for k, part in enumerate(surfaces) if k not in without])
    lit = bake(surface, lights, rng)
    done = len(objects)
    while True:
        try:
            next(lit)
        except StopIteration as end:
            sh = end.value
            break
        done += 1
        so_far = _unlit(surfaces) if done == len(objects) + 1 else None
        yield Progress(STAGE, done, total, "Light", so_far)
    gaussians = gaussians_of(surface, sh, rng)
    return Model(gaussians, surface.labels, tuple(item.name for item in objects), steps)
