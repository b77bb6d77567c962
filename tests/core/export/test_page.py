"""The page of a scene: what is on it, where it stands, and that it is what the file says."""

import base64
import hashlib
import io
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaga_core.arrays import DoubleArray
from gaga_core.camera import NEAR
from gaga_core.errors import GagaError
from gaga_core.export.export import export_objects_stage, export_scene_stage
from gaga_core.export.options import ExportOptions, PageContent
from gaga_core.io.splats.splat_files import SplatFormat, losses, write_splats
from gaga_core.io.splats.web_page import check_room
from gaga_core.progress import run_stage
from gaga_core.scene.camera_path import Bookmark, CameraPath, Keyframe, Shot
from gaga_core.scene.folders import Folders
from gaga_core.scene.scene import Scene, State
from tests.pages import page_data
from tests.scenes import objects_scene, random_gaussians

_MADE = objects_scene(3, 60, sh_degree=1)
_SHOTS = [Shot.of_camera(camera, 3.0) for camera in _MADE.cameras[:2]]


def scene() -> Scene:
    made = Scene.of(_MADE.gaussians, _MADE.labels)
    made.names[2] = "the </script> one"
    return made


def written(path: Path, options: ExportOptions, of: Scene | None = None) -> Path:
    run_stage(export_scene_stage(of or scene(), path, options=options))
    return path


def means_of(head: dict[str, list[float]], planes: bytes) -> DoubleArray:
    n = len(planes) // 6
    rows = np.frombuffer(planes, np.uint8).reshape(6, n).astype(np.float64)
    low, high = np.array(head["low"]), np.array(head["high"])
    logs = low + (rows[0::2] + 256 * rows[1::2]).T * (high - low) / 65535
    found: DoubleArray = np.sign(logs) * np.expm1(np.abs(logs))
    return found


def test_every_visible_object_is_listed_and_nothing_hidden_is_there(tmp_path: Path) -> None:
    made = scene()
    made.state[made.labels == 3] |= np.uint8(State.HIDDEN)
    made.folders = Folders.of(["Kitchen/Cups"], {1: "Kitchen/Cups"}, {3: 1, 2: 3})
    made.state[made.labels <= 1] |= np.uint8(State.LOCKED)
    made.state[np.flatnonzero(made.labels == 2)[0]] |= np.uint8(State.LOCKED)  # not all of it
    options = ExportOptions(up=(0, 0, 1), page=PageContent(background=frozenset({2, 3})))
    path = written(tmp_path / "a.html", options, made)
    page, columns = page_data(path)
    assert [item["folder"] for item in page["objects"]] == ["", "Kitchen/Cups", ""]
    assert [item["parent"] for item in page["objects"]] == [0, 0, 1], "3, between them, is hidden"
    assert [item["locked"] for item in page["objects"]] == [False, True, False]
    assert [item["background"] for item in page["objects"]] == [False, False, True]
    assert [(item["id"], item["count"]) for item in page["objects"]] == [(0, 180), (1, 60), (2, 60)]
    assert page["objects"][2]["name"] == "the </script> one"
    assert page["title"] == "a"
    planes = np.frombuffer(columns["labels"], np.uint8).reshape(2, -1).astype(int)
    places = planes[0] + 256 * planes[1]
    means = means_of(page["splats"], columns["means"])
    for k, item in enumerate(page["objects"][1:], start=1):
        np.testing.assert_allclose(means[places == k].mean(axis=0), item["centre"], atol=2e-4)
        reach = np.linalg.norm(means[places == k] - item["centre"], axis=1).max()
        assert 0.8 * reach < item["radius"] < 1.6 * reach
    picture = page["objects"][1]["picture"].removeprefix("data:image/webp;base64,")
    drawn = np.asarray(Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB"), int)
    color = 255 * np.clip(0.5 + 0.282 * made.gaussians.sh[made.labels == 1, 0].mean(axis=0), 0, 1)
    far = np.abs(drawn - 112).sum(axis=2)  # from the ground: few splats make a ball with holes
    assert drawn.shape == (96, 96, 3)
    np.testing.assert_allclose(np.median(drawn[far > 0.7 * far.max()], axis=0), color, atol=60)


def test_the_policy_allows_the_scripts_and_styles_that_are_there_alone(tmp_path: Path) -> None:
    text = written(tmp_path / "a.html", ExportOptions()).read_text(encoding="utf-8")
    policy = re.findall(r'Content-Security-Policy" content="([^"]*)"', text)[0]
    assert policy.startswith("default-src 'none';")
    assert "unsafe" not in policy
    assert "http" not in policy
    for kind, element in (("script", '<script type="module">'), ("style", "<style>")):
        content = text.split(element)[1].split(f"</{kind}>")[0]
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{digest}'" in policy
    assert text.index("Content-Security-Policy") < text.index("<style>") < text.index("<script")
    assert not re.findall(r"https?://", text), "no address that could be asked"
    json.loads(text.split('id="scene">')[1].split("</script>")[0])


@pytest.mark.parametrize("scale", [1.0, 2.5])
def test_views_move_with_what_is_written(tmp_path: Path, scale: float) -> None:
    """Every shot looks at the same thing, wherever the splats are put; a scale has no effect."""
    first, second = _SHOTS
    content = PageContent(
        title="Two views",
        bookmarks=(Bookmark("b", second, 4),),
        path=CameraPath((Keyframe(first), Keyframe(second, 3.0))),
        start=first,
    )
    options = ExportOptions(centre=True, up=(0, 0, 1), scale=scale, page=content)
    page, columns = page_data(written(tmp_path / "a.html", options))
    origin = options.origin(_MADE.gaussians.means)
    means = means_of(page["splats"], columns["means"])
    moved = _MADE.gaussians.means - origin
    np.testing.assert_allclose(means.min(axis=0), moved.min(axis=0), atol=1e-5)
    for row, shot in (
        (page["start"], first),
        (page["bookmarks"][0]["shot"], second),
        (page["path"]["shots"][0], first),
        (page["path"]["shots"][-1], second),
    ):
        eye = np.array(shot.eye) - origin
        np.testing.assert_allclose(row[:3], eye, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(np.abs(np.dot(row[3:7], shot.quat)), 1, atol=1e-5)
        np.testing.assert_allclose(row[7:], [shot.fov_x, shot.fov_y, 3.0], rtol=1e-5)
    assert (page["bookmarks"][0]["name"], page["bookmarks"][0]["key"]) == ("b", 4)
    assert page["path"]["seconds"] == 3.0
    assert len(page["path"]["shots"]) == 31
    assert page["title"] == "Two views"


def test_the_first_view_shows_all_of_a_scene_without_cameras(tmp_path: Path) -> None:
    for up in ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (0.6, 0.0, 0.8)):
        page, _ = page_data(written(tmp_path / "a.html", ExportOptions(up=up)))
        row = page["start"]
        shot = Shot((row[0], row[1], row[2]), tuple(row[3:7]), row[7], row[8], row[9])
        camera = shot.camera(400, 300)
        pixels, depth = camera.project(_MADE.gaussians.means.astype(np.float64))
        assert (depth > 0).all()
        inside = ((pixels > 0) & (pixels < [400, 300])).all(axis=1)
        assert inside.mean() > 0.97
        assert np.ptp(pixels[inside], axis=0).max() > 120, "and not from far away"
        assert camera.cam_from_world[1, :3] @ up < -0.8, "upright"


@pytest.mark.parametrize("lone", [False, True])
def test_a_tiny_scene_and_a_lone_splat_are_not_too_near_to_be_drawn(
    tmp_path: Path, lone: bool
) -> None:
    """Neither in the first view nor after *Go to*, which keeps to the radius of an object."""
    made = _MADE.gaussians.take(np.arange(len(_MADE.labels)))
    made.means[:] *= 1e-4
    made.log_scales[:] += np.log(1e-4)
    rows = np.flatnonzero(_MADE.labels == 1)[:1] if lone else np.arange(len(made))
    tiny = Scene.of(made.take(rows), _MADE.labels[rows])
    page, columns = page_data(written(tmp_path / "a.html", ExportOptions(up=(0, 0, 1)), tiny))
    row = page["start"]
    shot = Shot((row[0], row[1], row[2]), tuple(row[3:7]), row[7], row[8], row[9])
    pixels, depth = shot.camera(400, 300).project(means_of(page["splats"], columns["means"]))
    assert depth.min() > 10 * NEAR
    size = np.exp(max(page["splats"]["sizes"]))  # of the largest splat
    assert page["radius"] < 4 * size if lone else np.ptp(pixels, axis=0).max() > 120
    assert min(item["radius"] for item in page["objects"][1:]) > 2 * NEAR


def test_splats_without_a_place_or_size_are_left_out(tmp_path: Path) -> None:
    g = random_gaussians(300, seed=3, sh_degree=1)
    g.means[7, 1], g.log_scales[11, 0], g.logit_opacities[13] = np.nan, np.inf, np.nan
    g.sh[20, 2, 1], g.quats[21] = np.nan, np.nan
    write_splats(tmp_path / "a.html", g)
    page, columns = page_data(tmp_path / "a.html")
    assert page["splats"]["count"] == 297
    assert np.isfinite(means_of(page["splats"], columns["means"])).all()
    assert "NaN" not in json.dumps(page)
    g.means[:] = np.nan
    with pytest.raises(GagaError, match="nothing to write"):
        write_splats(tmp_path / "b.html", g)


def test_what_a_page_loses_is_told() -> None:
    g = replace(random_gaussians(20, sh_degree=4), comments=("antialiased 1",))
    said = " ".join(losses(g, SplatFormat.HTML))
    assert all(words in said for words in ("rounded", "degree 4", "opens a page as splats again"))
    assert "antialiased" not in said, "that is kept"


def test_pages_of_objects_share_an_origin_and_begin_with_the_object(tmp_path: Path) -> None:
    content = PageContent(title="room", start=_SHOTS[0])
    options = ExportOptions(centre=True, up=(0, 0, 1), page=content)
    form = SplatFormat.HTML
    run_stage(export_objects_stage(scene(), tmp_path, (1, 2), form=form, options=options))
    pages = [page_data(path)[0] for path in sorted(tmp_path.glob("*.html"))]
    assert [page["title"] for page in pages] == ["group 1", "the </script> one"]
    one, two = (page["objects"][1] for page in pages)
    apart = np.array(one["centre"]) - two["centre"]
    means = [_MADE.gaussians.means[_MADE.labels == k].mean(axis=0) for k in (1, 2)]
    np.testing.assert_allclose(apart, means[0] - means[1], atol=1e-4)
    for page, item in zip(pages, (one, two), strict=True):
        eye, distance = np.array(page["start"][:3]), page["start"][9]
        np.testing.assert_allclose(np.linalg.norm(eye - item["centre"]), distance, rtol=0.1)
        assert distance < 1.5, "it is near: the object fills the picture"


def test_too_many_objects_are_refused_before_anything_is_computed(tmp_path: Path) -> None:
    """65,535 objects fit; one more is refused at once, also next to splats of none."""
    check_room(65_535)
    with pytest.raises(GagaError, match="65,536"):
        check_room(65_536)
    labels = np.arange(65_537, dtype=np.int32)
    made = Scene.of(random_gaussians(len(labels)), labels)
    stage = export_scene_stage(made, tmp_path / "a.html")
    with pytest.raises(GagaError, match="at most 65,535 objects"):
        next(stage)
    made.state[:2] |= np.uint8(State.HIDDEN)
    assert next(export_scene_stage(made, tmp_path / "a.html")).done == 0
