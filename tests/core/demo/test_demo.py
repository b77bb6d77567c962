"""The demo scene: repeatable, whole or absent, true to its own truth, with a segmenter's faults."""

import json
from collections import Counter
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.color import sh_basis
from gaga_core.demo import DemoConfig, ensure_demo, make_demo_stage, room
from gaga_core.demo import folder as demo_folder
from gaga_core.demo.build import Model, build_stage
from gaga_core.demo.cameras import OVERVIEW, photo_cameras, posed
from gaga_core.demo.layout import items
from gaga_core.demo.lighting import Lights, bake
from gaga_core.demo.masks import Faults, room_parts, segmenter_masks
from gaga_core.demo.patches import Patch, ellipsoid, pose, rectangle, rod, rounded_box, tube
from gaga_core.demo.sampling import lay_discs
from gaga_core.demo.shadow import cone, lit_share
from gaga_core.demo.surface import Item, Material, Surface, cover, moved, parts
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.cameras.colmap import read_colmap
from gaga_core.io.images import read_rgb
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.io.splats.ply import read_ply
from gaga_core.progress import Progress, run_stage
from gaga_core.raster import choose

SMALL = DemoConfig(n_splats=12_000, n_views=5, width=160, height=120)


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small demo, made once."""
    folder = tmp_path_factory.mktemp("demo") / "scene"
    return run_stage(make_demo_stage(folder, config=SMALL))


@pytest.fixture(scope="module")
def model() -> Model:
    """The model in that demo, with its truth."""
    return run_stage(build_stage(SMALL.n_splats, SMALL.seed, 0))


def _contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_the_same_seed_gives_the_same_bytes(demo: Path, tmp_path: Path) -> None:
    seen: list[Progress] = []
    again = run_stage(make_demo_stage(tmp_path / "again", config=SMALL), seen.append)
    assert _contents(again) == _contents(demo)
    assert all(a.done < b.done for a, b in pairwise(seen))
    assert {p.total for p in seen} == {seen[-1].done + 2}  # the photo begun, and writing the model


def test_splats_are_shown_while_the_rest_is_made(model: Model) -> None:
    """The first before any object is covered, each time more, at last all; where they will be."""
    stage = build_stage(SMALL.n_splats, SMALL.seed, 0)
    shown = [p.payload for p in stage if isinstance(p.payload, Gaussians)]
    assert len(shown) >= 6
    assert all(len(a) < len(b) for a, b in pairwise(shown))
    np.testing.assert_array_equal(shown[-1].means, model.gaussians.means)
    first = next(iter(build_stage(SMALL.n_splats, SMALL.seed, 0)))
    assert isinstance(first.payload, Gaussians)


def test_another_seed_gives_another_scene() -> None:
    other = run_stage(build_stage(3000, 1, 0))
    same = run_stage(build_stage(3000, 0, 0))
    n = min(len(other.labels), len(same.labels))
    assert not np.array_equal(other.gaussians.means[:n], same.gaussians.means[:n])


def test_the_folder_has_everything_a_scene_needs(demo: Path) -> None:
    names = [f"view_{k:03d}.jpg" for k in range(SMALL.n_views)]
    model = read_colmap(demo / "sparse" / "0")
    assert [view.name for view in model.cameras] == names
    assert len(model.points) > 1000
    split = json.loads((demo / "split.json").read_text())
    assert sorted(split["train"] + split["test"]) == names
    assert not set(split["train"]) & set(split["test"])
    assert split["test"]
    for name in names:
        assert read_rgb(demo / "images" / name).shape == (120, 160, 3)
        for kind in ("masks/sim", "gt/instance"):
            assert read_labels(demo / kind / name.replace(".jpg", ".png")).shape == (120, 160)
    assert demo_folder.is_complete(demo, SMALL)


def test_files_agree_with_each_other(demo: Path, model: Model) -> None:
    """The photo and the truth of a view come out of the stored model at the stored pose."""
    gaussians = read_ply(demo / "point_cloud.ply")
    view = read_colmap(demo / "sparse" / "0").cameras[2]
    photo = read_rgb(demo / "images" / view.name).astype(np.float64) / 255
    drawn = np.clip(choose("cpu").render(gaussians, view).image, 0, 1)
    assert -10 * np.log10(np.mean((drawn - photo) ** 2)) > 30  # jpeg alone is about 35 dB
    splat = choose("cpu").label_splat(gaussians, view, model.labels).labels
    truth = read_labels(demo / "gt" / "instance" / view.name.replace(".jpg", ".png"))
    assert np.mean(splat == truth) > 0.999


def test_truth_covers_every_object(demo: Path) -> None:
    objects = json.loads((demo / "objects.json").read_text())["objects"]
    assert [entry["id"] for entry in objects] == list(range(1, len(objects) + 1))
    seen: set[int] = set()
    for path in (demo / "gt" / "instance").glob("*.png"):
        seen |= set(np.unique(read_labels(path)).tolist())
    assert seen == {0} | {entry["id"] for entry in objects}


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
        assert x > room.LEFT + 0.2
        assert y < room.BACK - 0.2
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
    places = [(1, (0.0, 0.9, 0.0)), (2, (0.3, room.BACK, 1.2)), (3, (room.LEFT, 0.9, 1.1))]
    for part, place in places:
        u, v = camera.project(np.array([place]))[0][0].astype(int)
        assert shown[v, u] == part
    empty = np.zeros((120, 160), np.int32)
    assert segmenter_masks(empty, camera, np.random.default_rng(0)).max() >= 2


# --- discs and light --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("patch", "area"),
    [
        (rectangle((0, 0, 0), (2, 0, 0), (0, 1, 0)), 2.0),
        (ellipsoid((0.5, 0.5, 0.5)), np.pi),
        (tube([(0, 0, 0), (0, 0, 1), (0, 0, 2)], [0.2, 0.2, 0.2]), 0.8 * np.pi),
        (rounded_box((1, 1, 1), 0.1)["+z"], 0.97),
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
        *rounded_box((0.8, 0.6, 0.7), 0.1).values(),
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
        sh = run_stage(bake(surface, Lights(), np.random.default_rng(0)))
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


# --- whole or absent --------------------------------------------------------------------------


@pytest.mark.parametrize("steps", [1, 127])
def test_a_cancelled_demo_leaves_nothing(tmp_path: Path, steps: int) -> None:
    stage = make_demo_stage(tmp_path / "new" / "scene", config=SMALL)
    for _ in range(steps):
        next(stage)
    stage.close()
    assert list(tmp_path.iterdir()) == []


def test_a_whole_demo_is_left_alone(demo: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in demo.rglob("*")}
    assert list(ensure_demo(demo, config=SMALL)) == []
    assert {path: path.stat().st_mtime_ns for path in demo.rglob("*")} == before


def _copy(demo: Path, folder: Path) -> Path:
    for name, data in _contents(demo).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return folder


def test_what_is_not_whole_is_noticed(demo: Path, tmp_path: Path) -> None:
    assert not demo_folder.is_complete(tmp_path / "nowhere", SMALL)
    assert not demo_folder.is_complete(demo, replace(SMALL, seed=9))
    folder = _copy(demo, tmp_path / "scene")
    assert demo_folder.is_complete(folder, SMALL)
    (folder / "images" / "view_001.jpg").unlink()
    assert not demo_folder.is_complete(folder, SMALL)


def test_an_older_version_is_made_again_and_own_work_kept(
    demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = _copy(demo, tmp_path / "scene")
    (folder / "gaga").mkdir()
    (folder / "gaga" / "project.json").write_text("{}")
    (folder / "edited.ply").write_bytes(b"mine")
    monkeypatch.setattr(demo_folder, "VERSION", demo_folder.VERSION + 1)
    assert not demo_folder.is_complete(folder, SMALL)
    run_stage(ensure_demo(folder, config=SMALL))
    assert demo_folder.is_complete(folder, SMALL)
    assert (folder / "edited.ply").read_bytes() == b"mine"
    assert (folder / "gaga-before" / "project.json").read_text() == "{}"
    assert not (folder / "gaga").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["scene"]


def test_a_folder_with_other_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(GagaError, match="holds other files"):
        run_stage(make_demo_stage(tmp_path, config=SMALL))
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_settings_that_make_no_scene_are_a_wrong_call() -> None:
    with pytest.raises(ValueError, match="too little"):
        DemoConfig(n_views=1)
