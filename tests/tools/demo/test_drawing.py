"""The program that draws the demo scene: repeatable, true to its truth, a segmenter's faults."""

import json
from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from gaga_core.arrays import AnyArray, DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.color import sh_basis
from gaga_core.io.cameras.colmap import read_colmap
from gaga_core.io.files import assets
from gaga_core.io.images import read_rgb
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.io.splats.splat_files import read_splats
from gaga_core.raster import choose
from tools.demo.lighting import Lights, bake, cone, lit_share
from tools.demo.make import VERSION, DemoConfig, make_demo
from tools.demo.objects import BACK, LEFT
from tools.demo.scene import (
    OVERVIEW,
    Faults,
    Model,
    build,
    items,
    photo_cameras,
    posed,
    room_parts,
    segmenter_masks,
)
from tools.demo.shapes import (
    Item,
    Material,
    Patch,
    Surface,
    cover,
    ellipsoid,
    lay_discs,
    moved,
    outline,
    parts,
    pose,
    rectangle,
    rod,
    rounded_box,
    tube,
)

_ASSET = assets() / "demo"
SHIPPED = DemoConfig()
SMALL = DemoConfig(n_splats=12_000, n_views=5, width=160, height=120)


@pytest.fixture(scope="module")
def model() -> Model:
    """The model of the demo that ships, with its truth."""
    return build(SHIPPED.n_splats, SHIPPED.seed)


def _contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    (tmp_path / "b" / "old").mkdir(parents=True)  # what was there is replaced
    one, two = (_contents(make_demo(tmp_path / name, SMALL)) for name in "ab")
    assert one == two
    parts_of = [{Path(name).parts[:-1] for name in names} for names in (one, _contents(_ASSET))]
    assert parts_of[0] == parts_of[1]


def test_another_seed_gives_another_scene(model: Model) -> None:
    other = build(SMALL.n_splats, 1)
    assert other.names == model.names
    n = min(len(other.labels), len(model.labels))
    assert not np.array_equal(other.gaussians.means[:n], model.gaussians.means[:n])


def test_what_ships_is_what_the_program_draws(model: Model) -> None:
    """Else `make demo` was forgotten. Splats are rounded, photos compressed; processors differ."""
    stamp = json.loads((_ASSET / "demo.json").read_text())
    assert stamp == {"version": VERSION, **asdict(SHIPPED)}
    objects = json.loads((_ASSET / "objects.json").read_text())["objects"]
    assert tuple(entry["name"] for entry in objects) == model.names
    stored = read_splats(_ASSET / "point_cloud.sog")
    np.testing.assert_allclose(stored.means, model.gaussians.means, atol=2e-4)
    view = read_colmap(_ASSET / "sparse" / "0").cameras[2]
    photo = read_rgb(_ASSET / "images" / view.name).astype(np.float64) / 255
    drawn, rounded = (
        np.clip(choose("cpu").render(splats, view).image, 0, 1)
        for splats in (model.gaussians, stored)
    )
    assert _psnr(drawn, photo) > 33  # JPEG alone is about 35 dB
    assert _psnr(drawn, rounded) > 50
    splat = choose("cpu").label_splat(stored, view, model.labels).labels
    truth = read_labels(_ASSET / "gt" / "instance" / view.name.replace(".jpg", ".png"))
    assert np.mean(splat == truth) > 0.999


def _psnr(a: AnyArray, b: AnyArray) -> float:
    return float(-10 * np.log10(np.mean((a - b) ** 2)))


def test_many_objects_and_identical_ones() -> None:
    found = items()
    assert len(found) >= 25
    assert found[0].name == "table"
    twins = [name for name, n in Counter(item.name for item in found).items() if n > 1]
    assert {"mug", "chair", "plate", "candle", "die"} <= set(twins)
    rng = np.random.default_rng(0)
    mugs = [cover(item, 1, 2.0, rng) for item in found if item.name == "mug"]
    own = [item.matrix for item in found if item.name == "mug"]
    sizes = [
        np.ptp((m.points - at[:, 3]) @ at[:, :3], axis=0) for m, at in zip(mugs, own, strict=True)
    ]
    np.testing.assert_allclose(sizes, np.tile(sizes[0], (len(sizes), 1)), atol=0.004)


def test_cameras_stand_in_the_open_side_and_see_the_table() -> None:
    cameras = photo_cameras(40, (640, 480), np.random.default_rng(0))
    assert len({camera.name for camera in cameras}) == 40
    for camera in cameras:
        x, y, z = camera.position
        assert x > LEFT + 0.2
        assert y < BACK - 0.2
        assert z > 0.8
        pixel, depth = camera.project(np.array([[0.0, 0.0, 0.74]]))
        assert depth[0] > 0.8
        assert 0 < pixel[0, 0] < 640
        assert 0 < pixel[0, 1] < 480


# --- masks ------------------------------------------------------------------------------------


def _grid_truth() -> tuple[IntArray, Camera]:
    """Twelve touching squares, 40 px each, on a wall."""
    truth = np.zeros((240, 320), np.int32)
    truth[60:180, 80:240] = np.kron(np.arange(1, 13).reshape(3, 4), np.ones((40, 40)))
    return truth, posed((0.0, -1.0, 1.2), (0.0, 1.0, 1.2), 50.0, (320, 240))


def test_faults_come_as_often_as_they_should() -> None:
    truth, camera = _grid_truth()
    n_split = n_missed = n_merged = n = 0
    for seed in range(40):
        masks = segmenter_masks(truth, camera, np.random.default_rng(seed))
        inside = [masks[truth == k] for k in range(1, 13)]
        main = [int(np.bincount(m).argmax()) for m in inside]
        for k, (ids, own) in enumerate(zip(inside, main, strict=True)):
            n += 1
            share = np.sort(np.bincount(ids)[1:])[::-1] / len(ids)
            n_missed += own == 0
            n_split += own != 0 and len(share) > 1 and share[1] > 0.15
            n_merged += own != 0 and own in main[:k] + main[k + 1 :]
    assert 0.12 < n_split / n < 0.40
    assert 0.05 < n_missed / n < 0.18
    assert 0.06 < n_merged / n < 0.35


def test_ids_mean_nothing_from_view_to_view() -> None:
    truth, camera = _grid_truth()
    faultless = Faults(split=0, merge=0, miss=0)
    views = [segmenter_masks(truth, camera, np.random.default_rng(k), faultless) for k in range(6)]
    for k in range(1, 13):
        ids = {int(np.bincount(masks[truth == k]).argmax()) for masks in views}
        assert len(ids) > 2
        assert 0 not in ids


def test_edges_move_inwards_by_one_pixel_or_outwards_by_two() -> None:
    truth = np.zeros((120, 160), np.int32)
    truth[30:90, 40:120] = 1
    nowhere = posed((0.0, 0.0, 9.0), (0.0, 0.0, 20.0), 50.0, (160, 120))
    faultless = Faults(split=0, merge=0, miss=0)
    masks = segmenter_masks(truth, nowhere, np.random.default_rng(3), faultless)
    found = masks > 0
    inner = ndimage.binary_erosion(truth == 1)
    outer = ndimage.binary_dilation(truth == 1, iterations=2)
    assert not np.any(inner & ~found)
    assert not np.any(found & ~outer)
    assert np.any(found & (truth == 0))
    assert np.any(~found & (truth == 1))


def test_floor_and_walls_are_segments_too() -> None:
    eye, target, fov = OVERVIEW
    camera = posed(eye, target, fov, (160, 120))
    shown = room_parts(camera)
    assert set(np.unique(shown)) == {1, 2, 3}
    places = [(1, (0.0, 0.9, 0.0)), (2, (0.3, BACK, 1.2)), (3, (LEFT, 0.9, 1.1))]
    for part, place in places:
        u, v = camera.project(np.array([place]))[0][0].astype(int)
        assert shown[v, u] == part
    empty = np.zeros((120, 160), np.int32)
    assert segmenter_masks(empty, camera, np.random.default_rng(0)).max() >= 2


# --- discs and light --------------------------------------------------------------------------


def test_an_outline_is_in_thousandths() -> None:
    assert outline("0 -46, 12.5 3.5") == [(0, -0.046), (0.0125, 0.0035)]


@pytest.mark.parametrize(
    ("patch", "area"),
    [
        (rectangle((0, 0, 0), (2, 0, 0), (0, 1, 0)), 2.0),
        (ellipsoid((0.5, 0.5, 0.5)), np.pi),
        (tube([(0, 0, 0), (0, 0, 1), (0, 0, 2)], [0.2, 0.2, 0.2]), 0.8 * np.pi),
        (rounded_box((1, 1, 1), 0.1, "+z")[0], 0.97),
    ],
)
def test_discs_tile_their_patch(patch: Patch, area: float) -> None:
    rng = np.random.default_rng(0)
    discs = lay_discs(patch, (0.06, 0.06), rng)
    assert np.prod(discs.sizes, axis=1).sum() == pytest.approx(area, rel=0.08)
    np.testing.assert_allclose(np.linalg.norm(discs.normals, axis=1), 1, atol=1e-6)
    there = patch.position(rng.random(800), rng.random(800))
    gap = np.linalg.norm(there[:, None] - discs.points[None], axis=2).min(axis=1)
    assert gap.max() < 0.06  # no hole a splat could not close


@pytest.mark.parametrize(
    "patch",
    [
        ellipsoid((0.3, 0.4, 0.5)),
        rod([(0, 0, -0.3), (0, 0, 0.3)], [0.2, 0.2]),
        *rounded_box((0.8, 0.6, 0.7), 0.1),
    ],
)
def test_normals_point_outwards(patch: Patch) -> None:
    discs = lay_discs(patch, (0.05, 0.05), np.random.default_rng(0))
    assert np.mean((discs.normals * discs.points).sum(axis=1) > 0) > 0.995


def test_a_plate_shades_what_is_under_it() -> None:
    side = np.linspace(-0.2, 0.2, 80)
    x, y = np.meshgrid(side, side)
    plate = np.stack([x.ravel(), y.ravel(), np.full(x.size, 1.0)], axis=1).astype(np.float32)
    points = np.array([[0, 0, 0], [0.1, 0.1, 0.9], [0.4, 0, 0], [0, 0, 1.1]], np.float32)
    up = np.array([0.0, 0.0, 1.0])
    lit = lit_share(points, plate, up, 0.01, np.random.default_rng(0))
    np.testing.assert_array_equal(lit, [0, 0, 1, 1])


def test_a_cone_is_as_wide_as_asked() -> None:
    axis = np.array([0.6, 0.0, 0.8])
    rays = cone(axis, 0.1, 50)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1)
    angles = np.arccos(np.clip(rays @ axis, -1, 1))
    assert 0.09 < angles.max() <= 0.1
    np.testing.assert_allclose(rays.mean(axis=0), axis, atol=0.01)


def _tile(gloss: float) -> Surface:
    """One disc on the table's height that mirrors the sun towards the front left."""
    key, viewer = Lights().key, np.array([-0.5, -0.87, 0.45]) / np.linalg.norm([0.5, 0.87, 0.45])
    normal = (key + viewer) / np.linalg.norm(key + viewer)
    tangent = np.cross(normal, [0.0, 1.0, 0.0])
    return Surface(
        points=np.array([[0.05, 0.0, 0.95]]),
        normals=normal[None],
        tangents=(tangent / np.linalg.norm(tangent))[None],
        sizes=np.full((1, 2), 0.01),
        albedo=np.full((1, 3), 0.3),
        finish=np.array([[gloss, 40.0, 0.0, 0.0]]),
        labels=np.ones(1, np.int32),
    )


def test_glaze_shines_towards_the_mirrored_viewer_only() -> None:
    def color(surface: Surface, view: DoubleArray) -> float:
        sh = bake(surface, Lights(), np.random.default_rng(0))
        return float(0.5 + sh_basis(-view[None], 2)[0] @ sh[0, :, 1])

    mirrored = np.array([-0.456, -0.794, 0.411])
    aside = np.array([0.9, 0.1, 0.42])
    matt, glazed = _tile(0.0), _tile(1.0)
    assert color(matt, mirrored) == pytest.approx(color(matt, aside))
    assert color(glazed, mirrored) > color(glazed, aside) + 0.1


def test_basis_has_the_signs_that_the_rasterizer_uses(model: Model) -> None:
    chosen = int(np.argmax(np.abs(model.gaussians.sh[:, 1:]).sum(axis=(1, 2))))
    splat = model.gaussians.take(np.array([chosen], np.int32))
    splat = replace(splat, logit_opacities=np.full(1, 9.0, np.float32))
    target = splat.means[0].astype(np.float64)
    eye = target + np.array([0.3, -0.7, 0.4])
    camera = posed(tuple(eye), tuple(target), 30.0, (33, 33))
    frame = choose("cpu").render(splat, camera)
    towards = (target - eye) / np.linalg.norm(target - eye)
    expected = 0.5 + sh_basis(towards[None], 2)[0] @ splat.sh[0]
    np.testing.assert_allclose(frame.image[16, 16] / frame.alpha[16, 16], expected, atol=2e-3)


def test_a_moved_part_keeps_its_paint() -> None:
    """Textures are solid and belong to the object: a part looks the same wherever it stands."""
    ramp = Material(lambda discs: 0.5 + discs.points)
    part = parts([rectangle((0, 0, 0), (0.4, 0, 0), (0, 0.3, 0))], ramp, 0.05)
    turned = moved(moved(part, pose((1, 2, 3), yaw=77)), pose((5, 5, 5), tilt=30))
    a, b = (
        cover(Item("x", tuple(p), pose((9, 0, 0), roll=20)), 1, 1.0, np.random.default_rng(0))
        for p in (part, turned)
    )
    np.testing.assert_allclose(a.albedo, b.albedo, atol=1e-6)
    assert np.ptp(a.albedo[:, 0]) > 0.3


def test_settings_that_make_no_scene_are_a_wrong_call() -> None:
    with pytest.raises(ValueError, match="too little"):
        DemoConfig(n_views=1)
