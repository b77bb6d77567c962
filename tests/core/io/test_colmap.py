import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaga_core.errors import GagaError
from gaga_core.io.cameras.cameras_json import read_cameras_json, write_cameras_json
from gaga_core.io.cameras.colmap import LENS_MODELS, read_colmap
from gaga_core.io.folder.scene_folder import is_scene_folder, open_scene_folder
from gaga_core.io.splats.ply import write_ply
from gaga_core.placing.photos import PhotoSet
from gaga_core.placing.sfm import SfmConfig, run_step
from tests.conftest import real_scene
from tests.core.io.colmap_parts import bend, model_in
from tests.scenes import orbit_cameras, random_gaussians


def test_written_cameras_are_read_back(tmp_path: Path) -> None:
    model = read_colmap(model_in(tmp_path / "0"))
    assert len(model.cameras) == 10
    for got, want in zip(model.cameras, orbit_cameras(10), strict=True):
        assert got.name == want.name
        assert (got.width, got.height) == (want.width, want.height)
        assert np.allclose(got.K, want.K, atol=1e-12)
        assert np.allclose(got.cam_from_world, want.cam_from_world, atol=1e-9)
    assert np.allclose(model.points, 1)
    assert (model.point_colors == 9).all()


def test_models_are_read_without_pycolmap_and_photos_placed_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Linux on arm64 has no wheels of it."""
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    assert len(read_colmap(model_in(tmp_path / "0")).cameras) == 10
    with pytest.raises(GagaError, match=r"cameras\.json"):
        next(run_step("features", PhotoSet(()), tmp_path, SfmConfig()))


@pytest.mark.parametrize("lens", [name for name, _ in LENS_MODELS])
@pytest.mark.parametrize("kind", ["binary", "text"])
def test_what_pycolmap_writes_is_read_as_pycolmap_reads_it(
    tmp_path: Path, kind: str, lens: str
) -> None:
    """Every lens model, names and tracks of any length, colors, in both forms."""
    pycolmap = pytest.importorskip("pycolmap")
    wanted, names = pycolmap.Reconstruction(), ["b/é 1.jpg", "a.png", "photo_" * 40]
    rng = np.random.default_rng(5)
    camera = pycolmap.Camera.create_from_model_name(7, lens, 71.5, 64, 48)
    camera.params = np.round(rng.uniform(0.1, 60, len(camera.params)), 3)
    assert len(camera.params) == dict(LENS_MODELS)[lens]
    assert int(pycolmap.CameraModelId.__members__[lens]) == [n for n, _ in LENS_MODELS].index(lens)
    turns = Rotation.random(3, random_state=5).as_quat()
    wanted.add_camera_with_trivial_rig(camera)
    for i, name in enumerate(names):
        seen = [pycolmap.Point2D(rng.uniform(0, 40, 2)) for _ in range(4 * i)]
        image = pycolmap.Image(name=name, camera_id=7, image_id=9 - i, points2D=seen)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(turns[i]), rng.normal(size=3))
        wanted.add_image_with_trivial_frame(image, pose)
    for i in range(4):
        track = pycolmap.Track([pycolmap.TrackElement(7, i), pycolmap.TrackElement(8, i)][: i % 3])
        wanted.add_point3D(rng.normal(size=3), track, rng.integers(0, 256, 3).astype(np.uint8))
    getattr(wanted, f"write_{kind}")(str(tmp_path))
    if lens == "EQUIRECTANGULAR":
        with pytest.raises(GagaError, match="lens model EQUIRECTANGULAR"):
            read_colmap(tmp_path)
        return
    model = read_colmap(tmp_path)
    images = sorted(wanted.images.values(), key=lambda image: str(image.name))
    assert [view.name for view in model.cameras] == [image.name for image in images]
    for view, found, image in zip(model.cameras, model.lenses, images, strict=True):
        pose = image.cam_from_world().matrix()
        np.testing.assert_allclose(view.cam_from_world[:3], pose, atol=1e-12)
        np.testing.assert_array_equal(view.K, camera.calibration_matrix())
        assert (found.model, found.width, found.height) == (lens, 64, 48)
        np.testing.assert_array_equal(found.params, camera.params)
    points = [(*p.xyz.tolist(), *p.color.tolist()) for p in wanted.points3D.values()]
    read = zip(model.points.tolist(), model.point_colors.tolist(), strict=True)
    assert sorted((*xyz, *rgb) for xyz, rgb in read) == sorted(points)


@pytest.mark.parametrize("damage", ["truncate", "garbage", "gone"])
@pytest.mark.parametrize("name", ["cameras.txt", "images.txt"])
def test_damaged_models_are_one_sentence(tmp_path: Path, name: str, damage: str) -> None:
    folder = model_in(tmp_path / "0")
    path = folder / name
    if damage == "truncate":
        path.write_bytes(path.read_bytes()[:90])
    elif damage == "garbage":
        path.write_bytes(bytes(range(256)) * 9)
    else:
        path.unlink()
    with pytest.raises(GagaError) as caught:
        read_colmap(folder)
    assert "\n" not in str(caught.value)


def test_a_truncated_binary_model_is_refused(tmp_path: Path) -> None:
    source = real_scene("sceaux") / "sparse" / "0"
    for cut in ("images.bin", "points3D.bin"):
        folder = tmp_path / cut
        folder.mkdir()
        for file in source.iterdir():
            (folder / file.name).write_bytes(file.read_bytes())
        (folder / cut).write_bytes((source / cut).read_bytes()[:100])
        with pytest.raises(GagaError, match="cannot be read"):
            read_colmap(folder)


def test_distorted_cameras_are_used_and_named(caplog: pytest.LogCaptureFixture) -> None:
    model = read_colmap(real_scene("sceaux") / "sparse" / "0")
    assert len(model.cameras) == 11
    assert "SIMPLE_RADIAL" in caplog.text


def test_distorted_cameras_are_said_by_the_command(tmp_path: Path) -> None:
    bend(model_in(tmp_path / "sparse" / "0"))
    write_ply(tmp_path / "point_cloud.ply", random_gaussians(9))
    code = "import sys; from gaga_core.cli.main import main; sys.exit(main(sys.argv[1:]))"
    done = subprocess.run(
        [sys.executable, "-c", code, "info", tmp_path], capture_output=True, text=True, check=True
    )
    assert "has distorted cameras (OPENCV); their pinhole part is used." in done.stderr


def test_cameras_json_round_trip(tmp_path: Path) -> None:
    cameras = orbit_cameras(4)
    write_cameras_json(tmp_path / "cameras.json", cameras)
    for got, want in zip(read_cameras_json(tmp_path / "cameras.json"), cameras, strict=True):
        assert np.allclose(got.cam_from_world, want.cam_from_world, atol=1e-12)
        assert np.allclose(got.K, want.K)


def test_a_damaged_cameras_json_is_a_sentence(tmp_path: Path) -> None:
    path = tmp_path / "cameras.json"
    for text in ("{", "[1]", '[{"width": 3}]'):
        path.write_text(text)
        with pytest.raises(GagaError, match=r"cameras\.json"):
            read_cameras_json(path)


def test_a_training_without_colmap_has_the_cameras_of_its_json(tmp_path: Path) -> None:
    cameras = orbit_cameras(4)
    (tmp_path / "images").mkdir()
    for camera in cameras:
        (tmp_path / "images" / camera.name).write_bytes(b"not read here")
    trained = tmp_path / "point_cloud" / "iteration_7" / "point_cloud.ply"
    trained.parent.mkdir(parents=True)
    trained.write_bytes(b"nor this")
    write_cameras_json(tmp_path / "cameras.json", cameras[::-1])
    folder = open_scene_folder(tmp_path)
    assert [camera.name for camera in folder.cameras] == [Path(c.name).stem for c in cameras]
    assert np.allclose(folder.cameras[2].cam_from_world, cameras[2].cam_from_world)
    assert [folder.require_image(c.name).name for c in folder.cameras] == [c.name for c in cameras]
    assert len(folder.test) == 1
    # A COLMAP model knows the principal points too, and comes first.
    model_in(tmp_path / "sparse" / "0")
    assert {Path(c.name).suffix for c in open_scene_folder(tmp_path).cameras} != {""}


def scene_in(root: Path) -> Path:
    model_in(root / "sparse" / "0")
    (root / "images").mkdir()
    (root / "masks" / "sim").mkdir(parents=True)
    for camera in orbit_cameras(10):
        (root / "images" / camera.name).write_bytes(b"not read here")
        (root / "masks" / "sim" / camera.name).write_bytes(b"nor this")
    (root / "point_cloud.ply").write_bytes(b"nor this")
    return root


def test_a_scene_folder_says_what_it_holds(tmp_path: Path) -> None:
    folder = open_scene_folder(scene_in(tmp_path / "s"))
    assert folder.model_path == tmp_path / "s" / "point_cloud.ply"
    assert len(folder.cameras) == len(folder.image_paths) == 10
    assert list(folder.mask_folders) == ["sim"]
    assert folder.test == ("000.png", "008.png")
    assert set(folder.train) | set(folder.test) == {camera.name for camera in folder.cameras}
    assert not set(folder.train) & set(folder.test)


def test_a_folder_that_is_no_scene_says_what_is_missing(tmp_path: Path) -> None:
    assert not is_scene_folder(tmp_path)
    with pytest.raises(GagaError, match="does not exist"):
        open_scene_folder(tmp_path / "none")
    with pytest.raises(GagaError, match=r"is not a scene folder.*no photos"):
        open_scene_folder(tmp_path)
    for name in ("photos", "masks of mine"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "IMG_1.JPG").write_bytes(b"not read here")
    with pytest.raises(GagaError, match=r"masks of mine and photos in it hold pictures"):
        open_scene_folder(tmp_path)
    (tmp_path / "IMG_1.JPG").write_bytes(b"not read here")
    with pytest.raises(GagaError, match=r"holds photos, but no splats.*gaga run"):
        open_scene_folder(tmp_path)


def test_split_file_wins_and_a_damaged_one_is_named(tmp_path: Path) -> None:
    root = scene_in(tmp_path / "s")
    split = {"train": ["001.png", "gone.png"], "test": ["004.png"]}
    (root / "split.json").write_text(json.dumps(split))
    folder = open_scene_folder(root)
    assert (folder.train, folder.test) == (("001.png",), ("004.png",))
    (root / "split.json").write_text("[]")
    with pytest.raises(GagaError, match=r"split\.json"):
        open_scene_folder(root)


def test_the_newest_iteration_is_the_model(tmp_path: Path) -> None:
    root = scene_in(tmp_path / "s")
    (root / "point_cloud.ply").unlink()
    for i in (7000, 30000, 900):
        path = root / "point_cloud" / f"iteration_{i}" / "point_cloud.ply"
        path.parent.mkdir(parents=True)
        path.write_bytes(b"")
    folder = open_scene_folder(root)
    assert folder.model_path is not None
    assert folder.model_path.parent.name == "iteration_30000"


def test_photos_that_are_gone_do_not_keep_a_scene_closed(tmp_path: Path) -> None:
    root = scene_in(tmp_path / "s")
    for path in (root / "images").iterdir():
        path.unlink()
    folder = open_scene_folder(root)
    assert len(folder.cameras) == 10
    with pytest.raises(GagaError, match="10 of 10 photos"):
        folder.require_image("000.png")


def test_real_scenes_open(ycb_table: Path, garden: Path) -> None:
    table = open_scene_folder(ycb_table)
    assert (len(table.cameras), len(table.train), len(table.test)) == (64, 56, 8)
    assert len(table.image_paths) == 64
    assert len(open_scene_folder(garden).cameras) == 185
