"""What an object stands on: flat, under all of it, and wider than its foot."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaga_core.arrays import DoubleArray
from gaga_core.grouping.surfaces.surfels import support_of

_N = 3000  # samples of each part
Part = tuple[DoubleArray, DoubleArray]  # points (K, 3), normals (K, 3)


def _disc(radius: float, height: float, inner: float = 0.0, up: float = 1.0) -> Part:
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, _N)
    way = np.sqrt(rng.uniform(inner**2, radius**2, _N))
    points = np.stack([way * np.cos(angle), way * np.sin(angle), np.full(_N, height)], axis=1)
    return points, np.tile([0.0, 0, up], (_N, 1))


def _wall(radius: float, low: float, high: float, outwards: float = 1.0) -> Part:
    rng = np.random.default_rng(1)
    angle = rng.uniform(0, 2 * np.pi, _N)
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return radius * out + [0, 0, 1] * rng.uniform(low, high, (_N, 1)), outwards * out


def _can(low: float = 0.0, radius: float = 0.3) -> list[Part]:
    """What is seen of one that stands: no photo shows its lower end."""
    return [_wall(radius, low, low + 0.8), _disc(radius, low + 0.8)]


def _found(parts: list[Part], turn: DoubleArray | None = None) -> DoubleArray:
    """The share of each part that is the support."""
    turn = np.eye(3) if turn is None else turn
    points, normals = (np.concatenate(rows) @ turn.T for rows in zip(*parts, strict=True))
    noise = np.random.default_rng(2).normal(0, 0.002, points.shape)
    return support_of(points + noise, normals).reshape(len(parts), _N).mean(axis=1)


@pytest.mark.parametrize("n", [32, 60, 299])
@pytest.mark.parametrize("seed", range(5))
def test_few_samples_and_strips_are_no_support_and_no_error(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, normals = rng.normal(size=(2, n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    support_of(points, normals)
    points[: n // 4, 1:], normals[: n // 4] = -2.0, (0, 0, 1)  # a straight edge
    assert not support_of(points, normals)[: n // 4].all()


@pytest.mark.parametrize("seed", range(5))
def test_a_plate_is_what_a_can_stands_on_however_it_lies(seed: int) -> None:
    plate = _disc(0.8, 0.0, inner=0.3)
    share = _found([plate, *_can()], Rotation.random(rng=np.random.default_rng(seed)).as_matrix())
    assert share[0] > 0.97
    assert share[1] < 0.1
    assert share[2] == 0


def test_the_rim_of_a_plate_goes_with_it() -> None:
    share = _found([_disc(0.8, 0.0, inner=0.3), _wall(0.8, -0.2, 0.0), *_can()])
    assert share[:2].min() > 0.75  # the upper end of the rim is as high as the plate
    assert share[2:].max() < 0.1


def test_so_is_one_with_several_objects_up_to_its_edge() -> None:
    cans = []
    for angle in np.arange(6) * np.pi / 3:
        place = 0.6 * np.array([np.cos(angle), np.sin(angle), 0])
        cans += [(points + place, normals) for points, normals in _can(0, 0.15)]
    share = _found([_disc(0.8, 0.0), *cans])
    assert share[0] > 0.97
    assert share[1:].max() < 0.15


@pytest.mark.parametrize(
    "parts",
    [
        _can(),
        [*_can(), _disc(0.6, 0.8, inner=0.3), *_can(0.81)],  # a shelf half way up
        [_disc(0.6, 0.3), _wall(0.62, -0.4, 0.25), _wall(0.2, 0.3, 0.34)],  # a crumb on a drum
        [_disc(0.3, 0.0), _wall(0.3, 0.0, 0.6, -1.0), _wall(0.31, -0.01, 0.6)],  # a cup
        [_disc(0.6, 0.5), _disc(0.6, 0.45, up=-1.0), _wall(0.4, 0.0, 0.45)],  # a table
    ],
    ids=["alone", "with a shelf", "drum", "cup", "table"],
)
def test_parts_of_an_object_are_no_support(parts: list[Part]) -> None:
    assert _found(parts).max() == 0
