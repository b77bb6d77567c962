"""Objects as parts (a patch, how it is finished), and all their discs as columns."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.demo.patches import Patch, placed
from gaga_core.demo.sampling import Discs, lay_discs

Paint = Callable[[Discs], DoubleArray]  # -> (N, 3) gamma-space albedo 0..1


@dataclass(frozen=True)
class Material:
    """What a part looks like."""

    paint: Paint
    gloss: float = 0.0  # 0 matt .. 1 wet glaze
    shine: float = 40.0  # exponent of the highlight: how small it is
    glow: float = 0.0  # light of its own, times albedo
    soft: float = 0.0  # 0..1 light that comes through (leaves, cloth, wax)


@dataclass(frozen=True)
class Part:
    """A patch with its finish; ``step`` is the distance of its discs along u and along v."""

    patch: Patch
    finish: Material
    step: tuple[float, float]


@dataclass(frozen=True)
class Item:
    """An object: name, parts in its own frame, placement (3, 4) in the room."""

    name: str
    parts: tuple[Part, ...]
    matrix: DoubleArray  # (3, 4)


@dataclass(frozen=True, eq=False)
class Surface:
    """Discs of many parts, world frame."""

    points: DoubleArray  # (N, 3)
    normals: DoubleArray  # (N, 3)
    tangents: DoubleArray  # (N, 3)
    sizes: DoubleArray  # (N, 2)
    albedo: DoubleArray  # (N, 3) gamma space
    finish: DoubleArray  # (N, 4) gloss, shine, glow, soft
    labels: IntArray  # (N,) object id, 0 = room

    def __len__(self) -> int:
        return len(self.points)


def parts(
    patches: Sequence[Patch], finish: Material, step: float | tuple[float, float]
) -> list[Part]:
    """Several patches of one finish."""
    both = (step, step) if isinstance(step, float) else step
    return [Part(patch, finish, both) for patch in patches]


def moved(group: Sequence[Part], matrix: DoubleArray) -> list[Part]:
    """Parts moved inside their object's frame; paints keep seeing the unmoved points."""
    return [
        replace(
            part,
            patch=placed(part.patch, matrix),
            finish=replace(part.finish, paint=_unmoved(part.finish.paint, matrix)),
        )
        for part in group
    ]


def cover(item: Item, label: int, coarseness: float, rng: np.random.Generator) -> Surface:
    """Discs of one object in the room; ``coarseness`` scales all its steps."""
    found = [_cover_part(part, item.matrix, label, coarseness, rng) for part in item.parts]
    return joined(found)


def joined(surfaces: Sequence[Surface]) -> Surface:
    """All discs, in order."""
    names = [field.name for field in fields(Surface)]
    return Surface(**{n: np.concatenate([getattr(s, n) for s in surfaces]) for n in names})


def _cover_part(
    part: Part, matrix: DoubleArray, label: int, coarseness: float, rng: np.random.Generator
) -> Surface:
    scale = float(np.cbrt(np.linalg.det(matrix[:, :3])))
    step = (part.step[0] * coarseness / scale, part.step[1] * coarseness / scale)
    discs = lay_discs(part.patch, step, rng)
    turn = matrix[:, :3] / scale
    finish = part.finish
    row = np.array([finish.gloss, finish.shine, finish.glow, finish.soft])
    return Surface(
        points=discs.points @ matrix[:, :3].T + matrix[:, 3],
        normals=discs.normals @ turn.T,
        tangents=discs.tangents @ turn.T,
        sizes=discs.sizes * scale,
        albedo=np.clip(finish.paint(discs), 0.0, 1.0),
        finish=np.tile(row, (len(discs), 1)),
        labels=np.full(len(discs), label, np.int32),
    )


def _unmoved(paint: Paint, matrix: DoubleArray) -> Paint:
    inverse = np.linalg.inv(matrix[:, :3])

    def painted(discs: Discs) -> DoubleArray:
        local = (discs.points - matrix[:, 3]) @ inverse.T
        return paint(replace(discs, points=local))

    return painted
