"""Photos of all kinds come out upright, 8-bit, unique; what cannot be used is named."""

import json
import shutil
import struct
import subprocess
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image, ImageFilter

from gaga_core.errors import GagaError
from gaga_core.io.images import read_rgb
from gaga_core.io.splats.splat_files import write_splats
from gaga_core.pipeline.reconstruct import look_at_photos, reconstruct_scene, source_of
from gaga_core.placing.photos import (
    LooksIndex,
    PhotoSet,
    exif_focal,
    list_photos,
    panorama_views,
    prepare_photos,
    read_photo_set,
    sharpness,
    unread_kinds,
)
from gaga_core.placing.video import extract_frames, extract_moving_frames, shows_all_directions
from gaga_core.progress import run_stage
from tests.core.placing.photo_scenes import photograph, walk_cameras
from tests.scenes import random_gaussians


def noise(seed: int, width: int = 96, height: int = 64) -> Image.Image:
    rng = np.random.default_rng(seed)
    small = Image.fromarray(rng.integers(0, 256, (8, 12, 3), dtype=np.uint8))
    return small.resize((width, height), Image.Resampling.BICUBIC)


def prepared(folder: Path, target: Path, longest_side: int = 400) -> PhotoSet:
    stage = prepare_photos(list_photos(folder), target, root=folder, longest_side=longest_side)
    return run_stage(stage)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with three good photos."""
    made = tmp_path / "photos"
    made.mkdir()
    for i in range(3):
        noise(i).save(made / f"good{i}.jpg", quality=95)
    return made


def test_every_kind_becomes_upright_8_bit_rgb(folder: Path, tmp_path: Path) -> None:
    turned = noise(10)
    exif = Image.Exif()
    exif[0x0112] = 6  # to be shown turned by a quarter
    turned.save(folder / "turned.jpg", exif=exif, quality=95)
    seen = noise(11).convert("RGBA")
    seen.putalpha(255)
    seen.save(folder / "alpha.png")
    deep = np.asarray(noise(12).convert("L"), np.uint16) * 257
    Image.fromarray(deep).save(folder / "deep.png")
    noise(13).convert("CMYK").save(folder / "print.jpg", quality=95)
    noise(14).convert("L").save(folder / "gray.jpg", quality=95)
    noise(15, 900, 600).save(folder / "large.jpg", quality=95)
    found = prepared(folder, tmp_path / "out")
    assert len(found.photos) == 9
    assert found.notes == ()
    sizes = {photo.name: (photo.width, photo.height) for photo in found.photos}
    assert sizes["turned.jpg"] == (64, 96)
    assert sizes["large.jpg"] == (400, 267)
    for photo in found.photos:
        with Image.open(tmp_path / "out" / photo.name) as image:
            assert image.mode == "RGB"
            assert image.size == (photo.width, photo.height)
            assert image.getexif().get(0x0112, 1) == 1
        before = read_rgb(Path(photo.source), 400).astype(float)
        after = read_rgb(tmp_path / "out" / photo.name).astype(float)
        if before.shape == after.shape:
            assert np.abs(before - after).mean() < 3, photo.name
    deep_again = read_rgb(tmp_path / "out" / "deep.png")[:, :, 0]
    assert np.array_equal(deep_again, (deep / 257).astype(np.uint8))


def test_what_cannot_be_used_is_named(folder: Path, tmp_path: Path) -> None:
    (folder / "words.jpg").write_text("no picture")
    cut = (folder / "good0.jpg").read_bytes()
    (folder / "cut.jpg").write_bytes(cut[: len(cut) // 2])
    Image.open(folder / "good1.jpg").save(folder / "lossless_copy.png")
    (folder / "phone.jxl").write_bytes(b"JXL ")
    (folder / ".hidden.jpg").write_text("no picture")
    noise(7, 16, 12).save(folder / "thumbnail.png")
    found = prepared(folder, tmp_path / "out")
    assert [photo.name for photo in found.photos] == ["good0.jpg", "good1.jpg", "good2.jpg"]
    said = " ".join(found.notes)
    for name in ("words.jpg", "cut.jpg", "thumbnail.png", "lossless_copy.png"):
        assert name in said
    assert ".hidden" not in said
    assert "phone.jxl" in unread_kinds(folder)[0]


@pytest.mark.parametrize("n", [1, 2])
def test_too_few_photos_are_told(n: int, tmp_path: Path) -> None:
    folder = tmp_path / "few"
    folder.mkdir()
    for i in range(n):  # the same photo, twice
        noise(0).save(folder / f"{i}.jpg")
    with pytest.raises(GagaError, match=r"1 usable photo\b.*at least 3") as caught:
        prepared(folder, tmp_path / "out")
    assert ("1.jpg" in str(caught.value)) == (n == 2)


@pytest.mark.parametrize("share", [0.75, 0.83, 0.9])
def test_a_smaller_copy_is_a_copy_at_any_size(tmp_path: Path, share: float) -> None:
    """Pixels that are not shared out evenly make no difference; a step aside does."""
    cameras = walk_cameras(80)[40:46]
    looked = LooksIndex()
    for camera in cameras:
        assert not looked.has_like(photograph(camera))
    for k, camera in enumerate(cameras):
        photo, path = Image.fromarray(photograph(camera)), tmp_path / f"{k}.jpg"
        small = photo.resize((int(photo.width * share), int(photo.height * share)))
        small.save(path, quality=70)
        assert looked.has_like(read_rgb(path))


def test_broken_photos_are_to_be_copied_again_not_taken_again(tmp_path: Path) -> None:
    folder = tmp_path / "broken"
    folder.mkdir()
    for i in range(3):
        (folder / f"{i}.jpg").write_bytes(b"cut off")
    with pytest.raises(GagaError, match=r"3 photos could not be read.* again, or take more"):
        prepared(folder, tmp_path / "out")


def test_photos_of_kinds_that_are_not_read_are_told(tmp_path: Path) -> None:
    """A folder straight from a phone: not "no scene folder", and not "take more photos"."""
    folder = tmp_path / "phone"
    folder.mkdir()
    for i in range(5):
        (folder / f"IMG_{i}.JXL").write_bytes(b"JXL ")
    assert source_of(folder) == (folder, tmp_path / "phone-scene")
    with pytest.raises(GagaError, match=r"5 photos are of a kind.*save as JPEG.*IMG_0\.JXL"):
        look_at_photos(folder)
    with pytest.raises(GagaError, match=r"0 usable photos.*save as JPEG") as caught:
        run_stage(reconstruct_scene(folder, tmp_path / "scene"))
    assert "Take more photos" not in str(caught.value)
    assert not (tmp_path / "scene").exists()


def test_a_folder_of_another_program_is_left_as_it_is(folder: Path, tmp_path: Path) -> None:
    """Its pictures were replaced by others without distortion, to which its poses do not fit."""
    other = tmp_path / "fox"
    images = other / "images"
    shutil.copytree(folder, images)
    assert source_of(other) == (None, other)
    assert source_of(images) == (images, other / "fox-images-scene")
    frames = [{"file_path": f"images/good{i}.jpg", "transform_matrix": _pose(i)} for i in range(3)]
    lens = {"w": 96, "h": 64, "fl_x": 90, "fl_y": 90, "cx": 48, "cy": 32, "frames": frames}
    (other / "transforms.json").write_text(json.dumps(lens), encoding="utf-8")
    found = look_at_photos(other)
    assert found is not None
    assert found.poses
    assert (found.photos, found.scene) == (images, tmp_path / "fox-scene")
    assert source_of(images) == (images, tmp_path / "fox-scene"), "whichever of both is chosen"


def _pose(i: int) -> list[list[float]]:
    return [[1, 0, 0, i], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


def test_the_photos_of_a_scene_open_it(folder: Path, tmp_path: Path) -> None:
    """They were said to have no splats."""
    scene = tmp_path / "scene"
    shutil.copytree(folder, scene / "images")
    (scene / ".gaga-reconstruct").mkdir()
    assert source_of(scene / "images") == (None, scene)
    write_splats(scene / "point_cloud.ply", random_gaussians(3))
    found = look_at_photos(scene / "images")
    assert found is not None
    assert found.scene == scene
    assert look_at_photos(scene) is None


def test_names_are_unique_whatever_the_folders_and_suffixes(folder: Path, tmp_path: Path) -> None:
    for i, name in enumerate(("a/x.jpg", "b/x.jpg", "a_x.png", "A x.JPG")):
        (folder / name).parent.mkdir(exist_ok=True)
        noise(20 + i).save(folder / name, format="PNG" if name.endswith("png") else "JPEG")
    found = prepared(folder, tmp_path / "out")
    stems = [Path(photo.name).stem.lower() for photo in found.photos]
    assert len(set(stems)) == len(stems) == 7
    assert all((tmp_path / "out" / photo.name).is_file() for photo in found.photos)


def test_sizes_and_focal_lengths_make_cameras(folder: Path, tmp_path: Path) -> None:
    noise(30, 120, 64).save(folder / "wide.jpg")
    tele = Image.Exif()
    tele.get_ifd(0x8769)[41989] = 100
    noise(31).save(folder / "tele.jpg", exif=tele)
    found = prepared(folder, tmp_path / "out", longest_side=96)
    groups = [sorted(photo.name for photo in group) for group in found.cameras()]
    assert sorted(groups) == [["good0.jpg", "good1.jpg", "good2.jpg"], ["tele.jpg"], ["wide.jpg"]]
    text = tmp_path / "set.json"
    text.write_text(json.dumps(found.to_json()))
    assert read_photo_set(text) == found


def test_a_photo_of_a_few_rows_keeps_one(folder: Path, tmp_path: Path) -> None:
    noise(32, 19_200, 64).save(folder / "line.png")
    found = prepared(folder, tmp_path / "out", longest_side=96)
    line = next(photo for photo in found.photos if Path(photo.source).name == "line.png")
    assert (line.width, line.height) == (96, 1)


def test_the_focal_length_of_exif_is_in_pixels(tmp_path: Path) -> None:
    path = tmp_path / "p.jpg"
    exif = Image.Exif()
    exif.get_ifd(0x8769)[41989] = 36  # of a 36 x 24 mm picture, so as long as it is wide
    noise(0, 300, 200).save(path, exif=exif)
    assert exif_focal(path, 300, 200) == pytest.approx(300, rel=1e-3)
    exif = Image.Exif()
    tags = exif.get_ifd(0x8769)
    tags[37386], tags[41486], tags[41488] = 10.0, 300.0, 3  # 10 mm, 300 pixels a centimetre
    noise(0, 300, 200).save(path, exif=exif)
    assert exif_focal(path, 300, 200) == pytest.approx(300, rel=1e-3)
    noise(0).save(path)
    assert exif_focal(path, 96, 64) is None


def test_a_video_gives_its_sharpest_frames(tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    sharp = [1, 5, 6, 11]  # one of each three
    for i, camera in enumerate(walk_cameras(12)):
        image = Image.fromarray(photograph(camera))
        if i not in sharp:
            image = image.filter(ImageFilter.GaussianBlur(3))
        image.save(frames / f"{i:03d}.png")
    video = tmp_path / "walk.mp4"
    subprocess.run(
        [
            *(imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-framerate", "6"),
            *("-i", str(frames / "%03d.png"), "-crf", "12", "-pix_fmt", "yuv420p", str(video)),
        ],
        check=True,
    )
    kept = run_stage(extract_frames(video, tmp_path / "out", fps=2.0, longest_side=160))
    assert [path.name for path in kept] == [f"frame_{i:05d}.jpg" for i in range(1, 5)]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [p.name for p in kept]
    for path, i in zip(kept, sharp, strict=True):
        picture = read_rgb(path)
        assert picture.shape == (120, 160, 3)
        truth = np.asarray(Image.open(frames / f"{i:03d}.png").resize((160, 120)), np.float64)
        assert np.abs(picture - truth).mean() < 25
        blurred = np.asarray(Image.fromarray(picture).filter(ImageFilter.GaussianBlur(1)))
        assert sharpness(picture) > 1.5 * sharpness(blurred)


def test_a_film_of_360_degrees_says_so(tmp_path: Path) -> None:
    """As in Spherical Video 1: a box in the track."""
    film = tmp_path / "film.mp4"
    colors = ["-f", "lavfi", "-i", "testsrc=size=128x64:rate=5:duration=1"]
    subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", *colors, str(film)], check=True)
    assert not run_stage(shows_all_directions(film))
    keys = {"Spherical": "true", "Stitched": "true", "StitchingSoftware": "x"}
    keys["ProjectionType"] = "equirectangular"
    text = "".join(f"<GSpherical:{k}>{v}</GSpherical:{k}>" for k, v in keys.items()).encode()
    kind = b"uuid" + bytes.fromhex("ffcc8263f8554a938814587a02521fdd")
    box = struct.pack(">I", 4 + len(kind) + len(text)) + kind + text
    data = film.read_bytes()
    for name in (b"moov", b"trak"):
        at = data.index(name) - 4
        (size,) = struct.unpack(">I", data[at : at + 4])
        data = data[:at] + struct.pack(">I", size + len(box)) + data[at + 4 :]
    end = at + size
    film.write_bytes(data[:end] + box + data[end:])
    assert run_stage(shows_all_directions(film))


def test_no_video_is_told(tmp_path: Path) -> None:
    video = tmp_path / "words.mp4"
    video.write_text("no video")
    with pytest.raises(GagaError, match="cannot be read as a video"):
        run_stage(extract_moving_frames(video, tmp_path / "out", longest_side=160))
    assert not (tmp_path / "out").exists()


def test_a_photo_of_360_degrees_is_cut_into_views_that_show_what_is_there(tmp_path: Path) -> None:
    """Each direction has its color; a view shows it where a pinhole camera does."""
    height = 256
    v, u = np.mgrid[0:height, 0 : 2 * height] + 0.5
    yaw, pitch = (u / height - 1) * np.pi, (v / height - 0.5) * np.pi
    towards = np.stack(
        [np.cos(pitch) * np.sin(yaw), np.sin(pitch), np.cos(pitch) * np.cos(yaw)], axis=2
    )
    picture = np.round(127.5 + 127.5 * towards).astype(np.uint8)
    views = list(panorama_views(picture, 128))
    centres = [(view[63:65, 63:65].reshape(-1, 3).mean(axis=0) - 127.5) / 127.5 for view in views]
    assert np.abs(centres[0] - [0, 0, 1]).max() < 0.02  # straight ahead
    assert np.abs(centres[1] - [1, 0, 0]).max() < 0.02  # to the right
    for view, ahead in zip(views, centres, strict=True):
        # 45 degrees right of the middle at the right edge: the same turn in every view.
        edge = (view[63:65, -1].mean(axis=0) - 127.5) / 127.5
        assert abs(float(edge @ ahead) - np.cos(np.radians(45))) < 0.03
        down = (view[-1, 63:65].mean(axis=0) - view[0, 63:65].mean(axis=0))[1]
        assert down > 0
    xmp = b'<x xmlns:GPano="a" GPano:ProjectionType="equirectangular"/>'
    folder = tmp_path / "round"
    folder.mkdir()
    Image.fromarray(picture).save(folder / "a.jpg", xmp=xmp, quality=95)
    Image.fromarray(picture[:, ::-1]).save(folder / "b.jpg", quality=95)  # nothing says so
    found = prepared(folder, tmp_path / "out")
    assert len(found.photos) == len(views) + 1
    assert {photo.focal for photo in found.photos if photo.name != "b.jpg"} == {64.0}
    assert "360 degrees" in " ".join(found.notes)
    (folder / "b.jpg").unlink()
    made = look_at_photos(folder)
    assert made is not None
    assert (made.n_photos, made.n_views, made.size) == (1, len(views), (128, 128))
