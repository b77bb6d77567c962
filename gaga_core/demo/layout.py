"""What stands where: the list of objects of the demo, in the order of their ids."""

from gaga_core.demo import books, food, furniture, plants, tableware
from gaga_core.demo.furniture import TABLE_TOP
from gaga_core.demo.patches import Coordinates, pose
from gaga_core.demo.room import BACK, LEFT
from gaga_core.demo.surface import Item, Part, moved
from gaga_core.demo.textures import rgb

TEAL, MUSTARD, RUST = rgb("2f6f7d"), rgb("d9a441"), rgb("b9553a")
NAVY, SAGE, PLUM = rgb("2e4560"), rgb("8a9a6b"), rgb("7a4a5c")
_SHELF = (-0.30, BACK - 0.012, 1.42)


def items() -> list[Item]:
    """All objects; the first is the table."""
    return [*_furniture(), *_breakfast(), *_fruit(), *_left_end(), *_shelf()]


def _item(name: str, found: list[Part], at: Coordinates, yaw: float = 0.0, **turn: float) -> Item:
    return Item(name, tuple(found), pose(at, yaw=yaw, **turn))


def _on_table(name: str, found: list[Part], x: float, y: float, yaw: float = 0.0) -> Item:
    return _item(name, found, (x, y, TABLE_TOP + 0.001), yaw)


def _furniture() -> list[Item]:
    dusk = furniture.landscape(rgb("eeb98a"), rgb("7f9db0"), 3)
    dawn = furniture.landscape(rgb("f0d9a8"), rgb("c98a7a"), 11)
    walnut = rgb("6b4a30")
    return [
        _item("table", furniture.table(), (0, 0, 0)),
        _item("rug", furniture.rug(), (0.05, -0.15, 0.001)),
        _item("chair", furniture.chair(TEAL), (1.13, 0.10, 0.014), 116),
        _item("chair", furniture.chair(TEAL), (-1.03, 0.08, 0.014), -97),
        _item(
            "picture of hills at dusk",
            furniture.picture(0.62, 0.46, dusk, walnut),
            (0.78, BACK - 0.016, 1.50),
        ),
        _item(
            "picture of hills at dawn",
            furniture.picture(0.40, 0.52, dawn, walnut),
            (LEFT + 0.016, -0.15, 1.42),
            90,
        ),
        _item("wall clock", furniture.clock(), (1.46, BACK - 0.002, 1.62)),
        _item("plant pot", plants.pot(rgb("c07a55")), (1.42, 0.82, 0.001)),
        _item("rubber plant", plants.rubber_plant(), (1.42, 0.82, 0.26)),
    ]


def _breakfast() -> list[Item]:
    mug = tableware.mug(TEAL) + tableware.tea(0.0372, 0.078)
    plate = tableware.plate(rgb("f4ecdb"), TEAL)
    pink = food.doughnut(rgb("ec9aa6"), 1)
    return [
        _on_table("table runner", furniture.runner(0.46, 0.86, 0.004), 0.02, 0.0),
        _on_table("teapot", tableware.teapot(RUST), -0.15, 0.03, 12),
        _on_table("mug", mug, -0.27, -0.19, -150),
        _on_table("mug", mug, 0.03, -0.15, -35),
        _on_table("mug", mug, 0.64, -0.04, -70),
        _on_table("plate", plate, 0.17, -0.29),
        _on_table("plate", plate, 0.49, -0.27),
        _item("doughnut", pink, (0.17, -0.29, TABLE_TOP + 0.013), 20),
        _item("doughnut", food.doughnut(rgb("5b3622"), 5), (0.49, -0.27, TABLE_TOP + 0.013), 70),
        _on_table("vase", tableware.vase(rgb("4f6f86")), 0.10, 0.21),
        _item("flowers", plants.bouquet(), (0.10, 0.21, TABLE_TOP + 0.225)),
        _on_table("oil bottle", tableware.bottle(rgb("3f5a2a")), 0.64, 0.27),
        _on_table("candle", tableware.candle(rgb("f1e6cc"), 0.13), -0.29, 0.17),
        _on_table("candle", tableware.candle(rgb("f1e6cc"), 0.13), -0.22, 0.31),
    ]


def _fruit() -> list[Item]:
    x, y, z = 0.40, 0.05, TABLE_TOP
    red = food.apple(rgb("c0322b"), rgb("e9b84a"), 2)
    green = food.apple(rgb("b9a83a"), rgb("9dbb4a"), 7)
    return [
        _on_table("fruit bowl", tableware.bowl(NAVY), x, y),
        _item("apple", red, (x - 0.062, y - 0.045, z + 0.044), 30, tilt=12),
        _item("apple", red, (x - 0.050, y + 0.058, z + 0.046), 200, tilt=-9),
        _item("green apple", green, (x + 0.058, y + 0.060, z + 0.046), 80, roll=14),
        _item("orange", food.orange(1), (x + 0.045, y - 0.052, z + 0.046), 10, roll=20),
        _item("orange", food.orange(1), (x + 0.002, y + 0.004, z + 0.090), 120, tilt=-15),
        _item("lemon", food.lemon(3), (x - 0.26, y + 0.12, z + 0.001), 35),
        _item("bananas", food.bananas(), (x - 0.02, y + 0.30, z + 0.003), -12),
    ]


def _left_end() -> list[Item]:
    x, y, z = -0.53, -0.17, TABLE_TOP + 0.001
    die = books.die(rgb("f3ecdc"), rgb("8e2f2a"))
    return [
        _on_table("table lamp", tableware_lamp(), -0.54, 0.22),
        _item("book", books.book((0.17, 0.24, 0.036), PLUM, books.GOLD, 1), (x, y, z), 78),
        _item(
            "book",
            books.book((0.155, 0.22, 0.028), SAGE, rgb("efe3c8"), 2),
            (x + 0.01, y, z + 0.036),
            98,
        ),
        _item(
            "book", books.book((0.13, 0.19, 0.024), MUSTARD, NAVY, 3), (x, y + 0.005, z + 0.064), 70
        ),
        _on_table("die", die, -0.30, -0.345, 25),
        _item("die", moved(die, pose((0, 0, 0.036), roll=90)), (-0.225, -0.34, z - 0.018), 60),
    ]


def tableware_lamp() -> list[Part]:
    """The lamp of the table, in the colors of the room."""
    return furniture.lamp(TEAL, rgb("f3dfb8"))


def _shelf() -> list[Item]:
    x, y, z = _SHELF
    found = [_item("wall shelf", furniture.shelf(), _SHELF)]
    row = [
        ((0.15, 0.215, 0.034), NAVY, books.GOLD),
        ((0.14, 0.23, 0.026), RUST, rgb("efe3c8")),
        ((0.15, 0.205, 0.040), TEAL, rgb("efe3c8")),
        ((0.13, 0.19, 0.024), MUSTARD, NAVY),
    ]
    at = x - 0.42
    for k, (size, cloth, accent) in enumerate(row):
        upright = books.book(size, cloth, accent, 10 + k)
        where = (at, y - 0.018 - size[0] / 2, z + 0.001 + size[1] / 2)
        found.append(_item("book", upright, where, 90, roll=90))
        at += size[2] + 0.003
    small = plants.pot(rgb("e6dcc6"), 0.29)
    found += [
        _item("small pot", small, (x - 0.17, y - 0.10, z + 0.001)),
        _item("cactus", plants.cactus(), (x - 0.17, y - 0.10, z + 0.074)),
        _item("globe", books.globe(), (x + 0.08, y - 0.105, z + 0.001), 200),
    ]
    for dx, dz, yaw, color in ((0.25, 0, 8, RUST), (0.315, 0, -6, TEAL), (0.28, 0.05, 22, MUSTARD)):
        name = "toy block"
        found.append(_item(name, books.block(color), (x + dx, y - 0.09, z + 0.001 + dz), yaw))
    return found
