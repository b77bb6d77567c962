import json
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import ExifTags, Image

from gaga_core.arrays import DoubleArray
from gaga_core.errors import GagaError
from gaga_core.io.cameras.given import Lens
from gaga_core.io.cameras.poses import find_poses, format_of, read_poses
from gaga_core.placing.photos import list_photos
from tests.conftest import real_scene
from tests.core.io.pose_forms import FORMS, cameras, photos, rig_views


@pytest.mark.parametrize("program", FORMS)
def test_poses_of_each_program_are_read_as_they_are(tmp_path: Path, program: str) -> None:
    write, is_metric, up, has_centre = FORMS[program]
    folder = photos(tmp_path / "images")
    views = rig_views() if program == "COLMAP rig" else cameras()
    file = write(tmp_path, views)
    found = read_poses(file, folder)
    assert len(found.poses) == 10
    assert not found.missing
    centre = (31.25, 25.5) if has_centre else (32.0, 24.0)
    for pose, view in zip(found.poses, views, strict=True):
        assert pose.name.removeprefix("frame_") == view.name
        assert np.abs(pose.cam_from_world - view.cam_from_world).max() < 1e-6
        assert pose.lens is not None
        K = np.array([[70.5, 0, centre[0]], [0, 70.5, centre[1]], [0, 0, 1]])
        assert np.allclose(pose.lens.K, K)
    assert found.is_metric == is_metric
    assert (found.up is None) == (up is None)
    if found.up is not None and up is not None:
        assert np.allclose(np.array(found.up), np.array(up))
    # What lies next to the photos is found without a name.
    beside = find_poses(folder)
    if program not in ("COLMAP rig",):
        assert beside is not None
        assert beside.program == found.program


def test_the_lens_bends_as_opencv_has_it(tmp_path: Path) -> None:
    """Metashape and RealityScan count tangential distortion the other way round."""
    folder = photos(tmp_path / "images")
    lens = read_poses(FORMS["Metashape"][0](tmp_path, cameras()), folder).poses[0].lens
    assert lens == Lens("OPENCV", 64, 48, (70.5, 70.5, 31.25, 25.5, 0.01, 0.0, 0.003, 0.002))
    half = lens.resized(32, 24)
    assert half.params == (35.25, 35.25, 15.625, 12.75, 0.01, 0.0, 0.003, 0.002)


def test_one_sentence_names_the_files_of_what_is_wrong(tmp_path: Path) -> None:
    folder = photos(tmp_path / "images")
    file = FORMS["LLFF"][0](tmp_path, cameras()[:9])
    with pytest.raises(GagaError, match=r"poses_bounds\.npy has poses of 9 .* has 10 photos"):
        find_poses(folder)
    file.unlink()
    # Photos that are not there are told, and do not stop the others.
    file = FORMS["instant-ngp"][0](tmp_path, cameras())
    (folder / "00003.png").unlink()
    found = find_poses(folder)
    assert found is not None
    assert found.missing == ("images\\00003.png",)
    assert len(found.poses) == 9
    # Two programs that contradict each other.
    FORMS["Polycam"][0](tmp_path, rig_views())
    with pytest.raises(GagaError, match=r"transforms\.json .* and .*cameras .* --poses-from"):
        find_poses(folder)


def test_what_an_earlier_run_wrote_is_no_given_pose(tmp_path: Path) -> None:
    """Who removes a wrong placement wants another one."""
    folder = photos(tmp_path / "images")
    FORMS["3DGS"][0](tmp_path, cameras())
    assert find_poses(folder) is not None
    (tmp_path / "gaga").mkdir()
    (tmp_path / "gaga" / "report.json").write_text("{}")
    assert find_poses(folder) is None


def test_the_model_of_pictures_without_distortion_is_not_of_the_originals(tmp_path: Path) -> None:
    """Of a scene folder: images/ and sparse/ are without distortion, input/ is as it came."""
    originals = photos(tmp_path / "input")
    FORMS["COLMAP"][0](tmp_path, cameras())
    assert find_poses(originals) is not None
    pictures = photos(tmp_path / "images")
    assert find_poses(originals) is None
    assert find_poses(pictures) is not None


def test_two_files_that_agree_are_no_question(tmp_path: Path) -> None:
    folder = photos(tmp_path / "images")
    FORMS["instant-ngp"][0](tmp_path, cameras())
    FORMS["COLMAP"][0](tmp_path, cameras())
    assert find_poses(folder) is not None


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"w": 100}, "is about pictures of 100 x 48 pixels"),
        ({"fl_x": 0.0}, "focal length"),
        ({"fl_x": float("nan")}, "damaged"),
        ({"camera_model": "EQUIRECTANGULAR"}, "no lens that is read"),
        ({"applied_scale": 0}, "not usable"),
        ({"frames": [{"file_path": "00000.png", "transform_matrix": [[1, 2]]}]}, "damaged"),
        ({"frames": [{"file_path": "x.png", "transform_matrix": np.eye(4).tolist()}]}, "no photo"),
        (
            {"frames": 2 * [{"file_path": "00000.png", "transform_matrix": np.eye(4).tolist()}]},
            "two poses of",
        ),
        (
            {"frames": [{"file_path": "00000.png", "transform_matrix": np.ones((4, 4)).tolist()}]},
            "no rotation",
        ),
    ],
)
def test_a_broken_transforms_json_gets_its_sentence(
    tmp_path: Path, change: dict[str, object], sentence: str
) -> None:
    folder = photos(tmp_path / "images")
    file = FORMS["instant-ngp"][0](tmp_path, cameras())
    values = json.loads(file.read_text())
    file.write_text(json.dumps(values | change))
    with pytest.raises(GagaError, match=sentence):
        read_poses(file, folder)


@pytest.mark.parametrize("program", FORMS)
def test_a_file_that_ends_in_the_middle_is_refused(tmp_path: Path, program: str) -> None:
    """Or its remaining photos are read right: never a wrong pose, never another error."""
    folder = photos(tmp_path / "images")
    views = rig_views() if program == "COLMAP rig" else cameras()
    path = FORMS[program][0](tmp_path, views)
    truth = {view.name: view.cam_from_world for view in views}
    files = [path] if path.is_file() else sorted(p for p in path.iterdir() if p.suffix != ".png")
    victim = files[len(files) // 2]
    raw = victim.read_bytes()
    for share in (0.9, 0.5, 0.1):
        victim.write_bytes(raw[: int(len(raw) * share)])
        try:
            found = read_poses(path, folder)
        except GagaError:
            continue
        for pose in found.poses:
            want = truth[pose.name.removeprefix("frame_")]
            assert np.abs(pose.cam_from_world - want).max() < 1e-6


def test_names_are_found_in_folders_and_ambiguity_is_said(tmp_path: Path) -> None:
    for part in ("left", "right"):
        photos(tmp_path / "images" / part)
    file = FORMS["instant-ngp"][0](tmp_path, cameras())
    values = json.loads(file.read_text())
    with pytest.raises(GagaError, match=r"left/00000\.png or right/00000\.png"):
        read_poses(file, tmp_path / "images")
    for frame in values["frames"]:
        frame["file_path"] = "D:/shots/Left/" + Path(frame["file_path"].replace("\\", "/")).name
    file.write_text(json.dumps(values))
    found = read_poses(file, tmp_path / "images")
    assert [pose.name for pose in found.poses] == [f"left/{c.name}" for c in cameras()]


@pytest.mark.parametrize(("tag", "turns"), [(6, 1), (3, 2), (8, 3)])
def test_a_photo_that_its_tag_turns_is_seen_as_it_was(tmp_path: Path, tag: int, turns: int) -> None:
    """Programs that pass over the tag measure the pixels as they are stored."""
    view = cameras()[0]
    (tmp_path / "images").mkdir()
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = tag
    Image.new("RGB", (64, 48)).save(tmp_path / "images" / "00000.jpg", exif=exif)
    lens = {"w": 64, "h": 48, "fl_x": 70.5, "fl_y": 60.5, "cx": 31.25, "cy": 25.5}
    lens |= {"k1": 0.02, "k2": 0.01, "p1": 0.03, "p2": -0.05}
    matrix = (view.world_from_cam @ np.diag([1.0, -1, -1, 1])).tolist()
    frames = [{"file_path": "00000.jpg", "transform_matrix": matrix}]
    (tmp_path / "transforms.json").write_text(json.dumps(lens | {"frames": frames}))
    found = read_poses(tmp_path / "transforms.json", tmp_path / "images").poses[0]
    assert found.lens is not None
    point = view.world_from_cam @ np.array([0.2, -0.1, 1.0, 1.0])
    stored = Lens("OPENCV", 64, 48, (70.5, 60.5, 31.25, 25.5, 0.02, 0.01, 0.03, -0.05))
    u, v = _seen(stored, view.cam_from_world, point)
    size = [64.0, 48.0]
    for _ in range(turns):
        u, v, size = size[1] - v, u, size[::-1]
    assert (found.lens.width, found.lens.height) == tuple(size)
    assert np.allclose(_seen(found.lens, found.cam_from_world, point), (u, v))


def _seen(lens: Lens, cam_from_world: DoubleArray, point: DoubleArray) -> tuple[float, float]:
    camera = pycolmap.Camera(
        model=lens.model, width=lens.width, height=lens.height, params=lens.params
    )
    u, v = np.asarray(camera.img_from_cam((cam_from_world @ point)[:3])).tolist()
    return u, v


def test_map_coordinates_come_near_the_origin_by_whole_units(tmp_path: Path) -> None:
    folder, views = photos(tmp_path / "images"), cameras()
    file = FORMS["Pix4D"][0](tmp_path, views)
    near = read_poses(file, folder)
    lines = file.read_text().split("\n")
    for i, line in enumerate(lines):
        if line.endswith(" 64 48"):
            x, y, z = (float(v) for v in lines[i + 6].split())
            lines[i + 6] = f"{x + 500_000!r} {y + 5_000_000!r} {z!r}"
    file.write_text("\n".join(lines))
    far = read_poses(file, folder)
    assert "origin" in far.notes[0]
    shifts = [
        np.linalg.inv(a.cam_from_world)[:3, 3] - np.linalg.inv(b.cam_from_world)[:3, 3]
        for a, b in zip(far.poses, near.poses, strict=True)
    ]
    assert np.abs(shifts - np.round(shifts[0])).max() < 1e-6


def test_xml_with_entities_and_files_of_others_are_none(tmp_path: Path) -> None:
    folder = photos(tmp_path / "images")
    file = FORMS["Metashape"][0](tmp_path, cameras())
    file.write_text('<!DOCTYPE a [<!ENTITY b "c">]>' + file.read_text().split("?>")[1])
    with pytest.raises(GagaError, match="entities"):
        read_poses(file, folder)
    other = tmp_path / "notes.txt"
    other.write_text("camera, lens, 3")
    assert format_of(other) is None
    with pytest.raises(GagaError, match="Known are"):
        read_poses(other, folder)


def test_real_files_are_found(tmp_path: Path) -> None:
    fox = find_poses(real_scene("fox") / "images")
    assert fox is not None
    assert fox.poses[0].lens is not None
    assert fox.poses[0].lens.model == "OPENCV"


@pytest.mark.parametrize(
    "program", ["nerfstudio", "Polycam", "3D Scanner App", "Record3D", "Stray Scanner"]
)
def test_depth_and_confidence_lie_where_the_program_puts_them(tmp_path: Path, program: str) -> None:
    """And are no photos, wherever the folder of photos begins."""
    folder = photos(tmp_path / "images")
    file = FORMS[program][0](tmp_path, cameras())
    names = {"nerfstudio": "depth/{:05d}.png", "3D Scanner App": "images/depth_{:05d}.png"}
    names |= {"Polycam": "depth/{:05d}.png", "Record3D": "depth/{:05d}.exr"}
    names |= {"Stray Scanner": "depth/{:06d}.png"}
    sure = {
        "Stray Scanner": "confidence/{:06d}.png",
        "Polycam": "confidence/{:05d}.png",
        "3D Scanner App": "images/conf_{:05d}.png",
    }
    for pattern in (names[program], sure.get(program, "x_{}")):
        for i in range(10):
            path = tmp_path / pattern.format(i)
            path.parent.mkdir(exist_ok=True)
            Image.new("I;16", (8, 6), i).save(path, format="PNG")
    for root in (folder, tmp_path):
        found = read_poses(file, root)
        for i, pose in enumerate(found.poses):
            assert pose.depth is not None
            assert pose.depth.path == tmp_path / names[program].format(i)
            has_one = program in sure
            assert pose.depth.confidence == (
                tmp_path / sure[program].format(i) if has_one else None
            )
        assert "10 depth maps" in found.told
        assert len(list_photos(root)) == 10
