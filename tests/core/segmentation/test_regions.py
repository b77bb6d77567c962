"""The weights-free regions: laws on pictures of known parts, and what photos give."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from gaga_core.arrays import AnyArray, BoolArray, FloatArray, IntArray, UInt8Array
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.images import read_rgb
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.io.splats.ply import read_ply_stage
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.segmentation import regions_kernels as kernels
from gaga_core.segmentation.regions import RegionsConfig, regions, regions_at

H, W = 120, 160
_ROWS, _COLUMNS = np.mgrid[:H, :W]


def _disc(radius: float = 30.0) -> BoolArray:
    inside: BoolArray = np.hypot(_ROWS - 60, _COLUMNS - 80) < radius
    return inside


def _painted(
    inside: BoolArray,
    on: tuple[int, int, int] = (190, 60, 50),
    off: tuple[int, int, int] = (70, 110, 160),
    grain: float = 0.0,
) -> UInt8Array:
    """A shape of one color on another, with grain of this many gray levels."""
    image = np.where(inside[..., None], np.array(on), np.array(off)).astype(np.float64)
    image += np.random.default_rng(0).normal(0, grain, image.shape) if grain else 0.0
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _busy(seed: int = 3) -> UInt8Array:
    """A picture with many shapes and grain."""
    rng = np.random.default_rng(seed)
    image = np.full((H, W, 3), 128.0)
    for _ in range(25):
        y, x, r = rng.uniform(0, H), rng.uniform(0, W), rng.uniform(5, 30)
        image[(_ROWS - y) ** 2 + (_COLUMNS - x) ** 2 < r * r] = rng.uniform(20, 235, 3)
    return np.clip(image + rng.normal(0, 6, image.shape), 0, 255).astype(np.uint8)


def _best_ious(true: IntArray, found: IntArray) -> list[float]:
    """IoU of each true id > 0 with the region that covers it best."""
    best = []
    for k in np.unique(true[true > 0]):
        inside = true == k
        ious = [
            np.count_nonzero(inside & (found == r)) / np.count_nonzero(inside | (found == r))
            for r in np.unique(found[inside])
            if r > 0
        ]
        best.append(max(ious, default=0.0))
    return best


def _pair_agreement(a: IntArray, b: IntArray) -> float:
    """Share of pixels whose region in ``a`` has one counterpart in ``b`` (greatest overlap)."""
    joint = np.bincount(a.ravel() * np.int64(b.max() + 1) + b.ravel())
    joint = np.pad(joint, (0, -len(joint) % (int(b.max()) + 1))).reshape(-1, int(b.max()) + 1)
    return float(joint.max(axis=1).sum() / a.size)


@pytest.mark.parametrize("seed", [0, 1])
def test_ids_are_dense_and_every_pixel_has_one(seed: int) -> None:
    labels = regions(_busy(seed))
    assert labels.shape == (H, W)
    assert labels.dtype == np.int32
    ids = np.unique(labels)
    np.testing.assert_array_equal(ids, np.arange(1, len(ids) + 1))
    assert len(ids) > 3
    assert all(ndimage.label(labels == k)[1] == 1 for k in ids), "every region is of one piece"


def test_the_same_picture_gives_the_same_regions_however_it_lies_in_memory() -> None:
    image = _busy()
    depth = np.where(_disc(), 2.0, 3.0).astype(np.float32)
    before = image.copy(), depth.copy()
    first = regions(image, depth)
    for given, then in zip((image, depth), before, strict=True):
        np.testing.assert_array_equal(given, then)
    np.testing.assert_array_equal(first, regions(image.copy(), depth.copy()))
    np.testing.assert_array_equal(
        first, regions(np.asfortranarray(image), np.asfortranarray(depth))
    )
    flipped = np.ascontiguousarray(image[:, ::-1])
    np.testing.assert_array_equal(first, regions(flipped[:, ::-1], depth))


@pytest.mark.parametrize("turn", [np.fliplr, np.flipud, np.transpose])
def test_a_mirrored_picture_has_mirrored_regions(turn: object) -> None:
    def turned(a: UInt8Array) -> UInt8Array:
        if turn is np.transpose:
            return np.ascontiguousarray(np.swapaxes(a, 0, 1))
        return np.ascontiguousarray(np.fliplr(a) if turn is np.fliplr else np.flipud(a))

    image = _busy()
    straight = regions(image)
    back = turned(regions(turned(image)))  # type: ignore[arg-type]
    assert _pair_agreement(straight, back) > 0.9  # type: ignore[arg-type]
    assert _pair_agreement(back, straight) > 0.9  # type: ignore[arg-type]


@pytest.mark.parametrize("grain", [0.0, 6.0])
def test_two_colors_are_two_regions(grain: float) -> None:
    inside = _disc()
    labels = regions(_painted(inside, grain=grain))
    assert labels.max() == 2
    on, off = labels[60, 80], labels[0, 0]
    wrong = np.count_nonzero((labels == on) != inside) + np.count_nonzero((labels == off) == inside)
    assert wrong <= (0 if grain == 0 else 40)


@pytest.mark.parametrize(
    ("times", "colors"), [(1, ((200,) * 3, (60,) * 3)), (12, ((190, 60, 50), (70, 110, 160)))]
)
def test_grays_and_large_photos_are_split_at_their_contours(
    times: int, colors: tuple[tuple[int, int, int], tuple[int, int, int]]
) -> None:
    inside = np.kron(_disc(), np.ones((times, times), np.bool_))
    labels = regions(_painted(inside, *colors))
    assert labels.shape == inside.shape
    assert labels.max() == 2
    ious = _best_ious(np.where(inside, 1, 2).astype(np.int32), labels)
    assert min(ious) > (0.98 if times > 1 else 0.9999)


def test_texture_does_not_tear_a_shape() -> None:
    """A chequered disc of two reds on striped blue: gentle grain, few crumbs, no halves."""
    inside = _disc(34)
    checks = (_ROWS // 2 + _COLUMNS // 2) % 2 == 0
    stripes = (_ROWS // 3) % 2 == 0
    image = np.zeros((H, W, 3), np.uint8)
    image[inside] = np.where(checks[inside][:, None], (195, 60, 50), (170, 50, 45))
    image[~inside] = np.where(stripes[~inside][:, None], (60, 90, 170), (68, 100, 180))
    labels = regions(image)
    assert min(_best_ious(np.where(inside, 1, 2).astype(np.int32), labels)) > 0.8


def _plane(slope: float = 0.004) -> FloatArray:
    """Depth of a tilted plane: its inverse is linear in the picture."""
    depth: FloatArray = (1 / (0.25 + slope * _ROWS)).astype(np.float32)
    return depth


def test_depth_parts_what_color_does_not() -> None:
    """Two discs of one color overlap in the picture, one well in front of the other."""
    image = np.full((H, W, 3), 150, np.uint8)
    front = (_ROWS - 60) ** 2 + (_COLUMNS - 60) ** 2 < 28**2
    behind = ((_ROWS - 60) ** 2 + (_COLUMNS - 100) ** 2 < 28**2) & ~front
    depth = np.where(front, 1.0, np.where(behind, 1.5, 3.0)).astype(np.float32)
    true = (front + 2 * behind).astype(np.int32)
    assert regions(image).max() == 1
    assert min(_best_ious(true, regions(image, depth))) > 0.85


def test_a_thing_on_a_floor_of_its_color_is_parted_at_the_crease() -> None:
    """An upright wall of the floor's color meets it without any step in depth."""
    image = np.full((H, W, 3), 150, np.uint8)
    floor = 0.1 + 0.004 * _ROWS
    inverse = np.where(_ROWS < 70, floor[70, 0] + 0.0 * _ROWS, floor)
    labels = regions(image, (1 / inverse).astype(np.float32))
    true = np.where(_ROWS < 70, 1, 2).astype(np.int32)
    assert min(_best_ious(true, labels)) > 0.85


def test_depth_that_shows_nothing_changes_nothing() -> None:
    nothing = np.zeros((H, W), np.float32)
    np.testing.assert_array_equal(regions(_busy(), nothing), regions(_busy()))


def test_a_plane_gives_no_reason_to_part_it() -> None:
    assert regions(np.full((H, W, 3), 90, np.uint8), _plane()).max() == 1


def test_unit_of_depth_does_not_matter() -> None:
    image, depth = _busy(), np.where(_disc(), 2.0, _plane()).astype(np.float32)
    np.testing.assert_array_equal(regions(image, depth), regions(image, depth * 1024))


def test_normals_part_two_walls_of_a_corner_and_not_two_sides_of_a_box() -> None:
    """Camera frame, towards the camera: in a corner the walls face each other."""
    image, lean = np.full((H, W, 3), 150, np.uint8), np.float32(np.sqrt(0.5))
    corner = np.zeros((H, W, 3), np.float32)
    corner[..., 0] = np.where(_COLUMNS < 80, lean, -lean)
    corner[..., 2] = -lean
    true = np.where(_COLUMNS < 80, 1, 2).astype(np.int32)
    flat = np.full((H, W), 2.0, np.float32)
    for depth in (None, flat):
        assert min(_best_ious(true, regions(image, depth, corner))) > 0.85
        assert regions(image, depth, corner * np.array([-1, 1, 1], np.float32)).max() == 1
    upright = np.ascontiguousarray(np.swapaxes(corner[..., [1, 0, 2]], 0, 1))
    labels = regions(np.full((W, H, 3), 150, np.uint8), None, upright)
    assert min(_best_ious(np.ascontiguousarray(true.T), labels)) > 0.85


def test_none_only_where_asked() -> None:
    image, depth = _busy(), np.full((H, W), 2.0, np.float32)
    depth[:30], depth[30:40], depth[40:45] = 0, np.nan, np.inf
    assert regions(image, depth).min() == 1
    labels = regions(image, depth, config=RegionsConfig(none_without_depth=True))
    np.testing.assert_array_equal(labels == 0, _ROWS < 45)
    np.testing.assert_array_equal(np.unique(labels), np.arange(labels.max() + 1))


def test_more_detail_gives_more_regions_each_within_one_of_the_coarser() -> None:
    """Merging goes on from where the finer one ended, so that the slider never shuffles."""
    image = _busy()
    maps = [regions(image, config=RegionsConfig(detail=d)) for d in (0.4, 1.0, 2.5)]
    counts = [int(labels.max()) for labels in maps]
    assert counts[0] < counts[1] < counts[2]
    for coarse, fine in pairwise(maps):
        assert len(np.unique(fine * 10_000 + coarse)) == fine.max()


def test_several_levels_at_once_are_those_of_the_settings() -> None:
    image = _busy()
    for steps in ((1.0,), (2.0, 0.5, 1.0)):
        maps = regions_at(steps, image, config=RegionsConfig(detail=1.5))
        for step, labels in zip(steps, maps, strict=True):
            alone = regions(image, config=RegionsConfig(detail=1.5 * step))
            assert np.array_equal(labels, alone)


@pytest.mark.parametrize(
    "shape", [(1, 1), (1, 50), (50, 1), (2, 3), (7, 300), (30, 2000), (1500, 2000)]
)
def test_any_size_will_do(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    height, width = shape
    image = rng.integers(0, 255, (-(-height // 50), -(-width // 50), 3), dtype=np.uint8)
    image = np.ascontiguousarray(np.kron(image, np.ones((50, 50, 1), np.uint8))[:height, :width])
    labels = regions(image, rng.uniform(1, 1.1, shape).astype(np.float32))
    assert labels.shape == shape
    np.testing.assert_array_equal(np.unique(labels), np.arange(1, labels.max() + 1))


@pytest.mark.parametrize(
    "wrong",
    [{"detail": 0.0}, {"detail": float("nan")}, {"width": 3}, {"flat": 1.5}, {"mean": -1.0}],
)
def test_settings_out_of_range_are_named(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        RegionsConfig(**wrong)  # type: ignore[arg-type]


_IMAGE, _DEPTH = np.zeros((H, W, 3), np.uint8), np.ones((H, W), np.float32)


@pytest.mark.parametrize(
    ("named", "wrong"),
    [
        ("image", (_IMAGE[..., 0],)),
        ("image", (_IMAGE.astype(np.float32),)),
        ("depth", (_IMAGE, _DEPTH[:, 1:])),
        ("depth", (_IMAGE, _DEPTH.astype(np.float64))),
        ("normals", (_IMAGE, None, _DEPTH)),
    ],
)
def test_wrong_calls_are_named_and_nothing_gives_nothing(
    named: str, wrong: tuple[AnyArray, ...]
) -> None:
    with pytest.raises(ValueError, match=named):
        regions(*wrong)  # type: ignore[arg-type]
    assert regions(_IMAGE[:0]).shape == (0, W)


@pytest.mark.parametrize(("with_depth", "bar"), [(False, 0.63), (True, 0.70)])
def test_ycb_table_reaches_the_bar(with_depth: bool, bar: float, ycb_table: Path) -> None:
    """Mean best IoU of the 15 objects on every eighth photo, none of which settings were fitted
    to: those were the even ones."""
    folder = open_scene_folder(ycb_table)
    gaussians = run_stage(read_ply_stage(folder.model_path)) if folder.model_path else None
    best: list[float] = []
    for camera in folder.cameras[1::8]:
        depth = None
        if with_depth:
            assert gaussians is not None
            nothing = np.zeros((len(gaussians), 1), np.float32)
            depth = choose("cpu").render(gaussians, camera, channels=nothing).median_depth
        labels = regions(read_rgb(folder.require_image(camera.name)), depth)
        true = read_labels(ycb_table / "gt" / "instance" / f"{Path(camera.name).stem}.png")
        best += _best_ious(np.where(true == 1, 0, true), labels)
    assert np.mean(best) >= bar


@pytest.mark.parametrize("seed", range(3))
def test_pieces_merge_in_the_order_of_their_costs(seed: int) -> None:
    """Against all pairs, asked again before every merge."""
    rng = np.random.default_rng(seed)
    pieces = np.kron(np.arange(30).reshape(5, 6), np.ones((4, 4), np.int64)).astype(np.int32)
    cues = rng.random((2, *pieces.shape), np.float32)
    area, color = np.full(30, 16, np.float32), 16 * rng.random((30, 3), np.float32)
    histogram = rng.integers(0, 9, (30, 4)).astype(np.float32)
    weights = np.array([0.8, 16.0, 0.4, 0.36, 0.4, 35.0])
    most = 49 + 49
    sides, length = np.empty((most, 2), np.int32), np.zeros(most, np.float32)
    strength, first = np.zeros((most, 2), np.float32), np.full(30, -1, np.int32)
    ends = np.empty(2 * most, np.int32)
    n = kernels.add_borders(pieces, cues, sides, length, strength, first, ends)
    assert n == 5 * 5 + 4 * 6
    borders = {
        frozenset(pair): (length[e], strength[e].copy())
        for e, pair in enumerate(sides[:n].tolist())
    }
    joined, (costs, common) = np.empty((29, 2), np.int32), np.zeros((2, 29), np.float32)
    made = kernels.merge_all(
        area.copy(),
        color.copy(),
        histogram.copy(),
        sides[:n],
        length[:n],
        strength[:n],
        first,
        ends[: 2 * n],
        weights,
        joined,
        costs,
        common,
    )
    assert made == 29

    def cost(pair: frozenset[int]) -> float:
        a, b = sorted(pair)
        one, of_pair = np.array([borders[pair][0]]), borders[pair][1][None]
        return kernels.cost_of(a, b, 0, area, color, histogram, one, of_pair, weights, 480.0)

    for step, (a, b) in enumerate(joined.tolist()):
        cheapest = min(borders, key=cost)
        assert {a, b} == cheapest
        assert costs[step] == pytest.approx(cost(cheapest), rel=1e-4)
        assert common[step] == borders.pop(cheapest)[0]
        for values in (area, color, histogram):
            values[a] += values[b]
        for pair in [pair for pair in borders if b in pair]:
            gone, into = borders.pop(pair), pair - {b} | {a}
            known = borders.get(into, (0, np.zeros(2, np.float32)))
            borders[into] = known[0] + gone[0], known[1] + gone[1]
