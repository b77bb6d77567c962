"""A generated kind of scene of what is hard to tell apart: contents, rows and things on legs.

Two tables in the demo's empty room; on them bowls with fruit and rows of upright books, next to
them chairs. Fruit touches the bowl and other fruit, books of a row touch along their covers, and a
chair has legs, a seat and a back. Nothing here took part in any choice of a threshold.
"""

import numpy as np

from tools.demo import objects
from tools.demo.objects import plain, rgb
from tools.demo.shapes import ALL_FACES, Item, Material, box, pose

_CLOTH = ("2e4560", "b9553a", "2f6f7d", "d9a441", "8a9a6b", "7a4a5c")
_CHAIRS = ((-0.05, -0.45, 160.0), (1.0, -0.55, -150.0))  # x, y, yaw
_FRUIT_UP = 0.046  # height of their centres in the bowl


def contents_items(rng: np.random.Generator) -> list[Item]:
    """The objects of one scene: 2 tables, 2 chairs, 4 bowls with fruit, 4 rows of books."""
    found = [
        Item("chair", tuple(objects.chair(rgb(_CLOTH[k]))), pose((x, y, 0.001), yaw=yaw))
        for k, (x, y, yaw) in enumerate(_CHAIRS)
    ]
    for x, y in ((-0.85, 0.35), (0.65, 0.4)):
        height = rng.uniform(0.4, 0.6)
        wood = box((1.1, 0.9, height), 0.01, Material(plain((0.6, 0.55, 0.5))), {ALL_FACES: 0.011})
        found.append(Item("table", tuple(wood), pose((x, y, height / 2))))
        for dx, dy in ((-0.32, -0.22), (0.3, -0.2)):
            found += _bowl(x + dx, y + dy, height + 0.001, rng)
        for dx in (-0.45, 0.05):
            found += _row(x + dx, y + 0.25, height + 0.001, rng)
    return found


def _bowl(x: float, y: float, z: float, rng: np.random.Generator) -> list[Item]:
    """A bowl with three or four apples and oranges around its middle."""
    n, start = int(rng.integers(3, 5)), rng.uniform(0, 360)
    color = rgb(str(rng.choice(_CLOTH)))
    found = [Item("bowl", tuple(objects.bowl(color)), pose((x, y, z)))]
    for k in range(n):
        angle = np.radians(start + 360 * k / n)
        at = (x + 0.066 * np.cos(angle), y + 0.066 * np.sin(angle), z + _FRUIT_UP)
        is_apple = rng.random() < 0.5
        fruit = objects.apple(rgb("c0322b"), rgb("e9b84a"), k) if is_apple else objects.orange(k)
        name = "apple" if is_apple else "orange"
        found.append(Item(name, tuple(fruit), pose(at, yaw=rng.uniform(0, 360))))
    return found


def _row(x: float, y: float, z: float, rng: np.random.Generator) -> list[Item]:
    """Four to six upright books, next to each other along x, spines to the front."""
    found = []
    for cloth in rng.permutation(_CLOTH)[: int(rng.integers(4, 7))]:
        size = (rng.uniform(0.13, 0.17), rng.uniform(0.19, 0.25), rng.uniform(0.028, 0.05))
        bound = objects.book(size, rgb(str(cloth)), objects.GOLD, int(rng.integers(100)))
        at = (x, y, z + size[1] / 2)
        found.append(Item("book", tuple(bound), pose(at, yaw=90, roll=90)))
        x += size[2] + 0.003
    return found
