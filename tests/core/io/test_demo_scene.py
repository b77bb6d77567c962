"""The demo scene that the packages carry: small, whole, copied at once or not at all."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.io.cameras.colmap import count_points
from gaga_core.io.demo_scene import STAMP, copy_demo_stage, ensure_demo, is_complete
from gaga_core.io.files import assets
from gaga_core.io.folder.scene_folder import SceneFolder, open_scene_folder
from gaga_core.io.images import read_rgb
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.progress import run_stage

_MOST_BYTES = 6_000_000


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy, as `gaga demo` makes it."""
    return run_stage(copy_demo_stage(tmp_path_factory.mktemp("demo") / "scene"))


@pytest.fixture
def own(demo: Path, tmp_path: Path) -> Iterator[Path]:
    """A copy that a test may damage."""
    yield run_stage(ensure_demo(tmp_path / "scene"))
    assert [path.name for path in tmp_path.iterdir()] == ["scene"], "nothing is left next to it"


@pytest.fixture(scope="module")
def scene(demo: Path) -> SceneFolder:
    """That copy, as stages see it."""
    return open_scene_folder(demo)


def test_the_asset_is_small() -> None:
    sizes = [path.stat().st_size for path in (assets() / "demo").rglob("*") if path.is_file()]
    assert sum(sizes) <= _MOST_BYTES


def test_a_copy_has_everything_that_a_scene_needs(demo: Path, scene: SceneFolder) -> None:
    names = [f"view_{k:03d}.jpg" for k in range(40)]
    assert [camera.name for camera in scene.cameras] == names == list(scene.image_paths)
    assert scene.model_path == demo / "point_cloud.ply"
    assert (scene.split, len(scene.train), len(scene.test)) == ("split.json", 35, 5)
    assert count_points(demo / "sparse" / "0") == 8000
    objects = json.loads((demo / "objects.json").read_text())["objects"]
    seen: set[int] = set()
    for camera in scene.cameras:
        size = (camera.height, camera.width)
        assert read_rgb(scene.require_image(camera.name)).shape == (*size, 3)
        label_map = f"{Path(camera.name).stem}.png"
        masks = read_labels(scene.mask_folders["sim"] / label_map)
        truth = read_labels(demo / "gt" / "instance" / label_map)
        assert masks.shape == truth.shape == size
        assert masks.max() > 20
        seen |= set(np.unique(truth).tolist())
    assert seen == {0} | {entry["id"] for entry in objects}
    assert len(objects) == 48


@pytest.mark.parametrize("steps", [1, 100])
def test_a_cancelled_copy_leaves_nothing(tmp_path: Path, steps: int) -> None:
    stage = copy_demo_stage(tmp_path / "new" / "scene")
    for _ in range(steps):
        next(stage)
    stage.close()
    assert list(tmp_path.iterdir()) == []


def test_a_whole_copy_is_left_alone(demo: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in demo.rglob("*")}
    assert list(ensure_demo(demo)) == []
    assert {path: path.stat().st_mtime_ns for path in demo.rglob("*")} == before


@pytest.mark.parametrize("missing", ["images/view_001.jpg", "point_cloud.ply", STAMP])
def test_what_is_not_whole_is_noticed(own: Path, missing: str) -> None:
    assert is_complete(own)
    (own / missing).unlink()
    assert not is_complete(own)


def test_an_older_version_is_replaced_and_own_work_kept(own: Path) -> None:
    (own / "gaga").mkdir()
    (own / "gaga" / "project.json").write_text("{}")
    (own / "gaga-before").mkdir()
    (own / "gaga-before" / "project.json").write_text("of a version before")
    (own / "edited.ply").write_bytes(b"mine")
    stamp = json.loads((own / STAMP).read_text())
    (own / STAMP).write_text(json.dumps(stamp | {"version": stamp["version"] - 1}))
    (own / "split.json").write_text("{}")
    assert not is_complete(own)
    run_stage(ensure_demo(own))
    assert is_complete(own)
    assert json.loads((own / "split.json").read_text()) != {}
    assert (own / "edited.ply").read_bytes() == b"mine"
    kept = [own / name / "project.json" for name in ("gaga-before", "gaga-before-2")]
    assert [path.read_text() for path in kept] == ["of a version before", "{}"]
    assert not (own / "gaga").exists()


def test_a_folder_with_other_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(GagaError):
        run_stage(copy_demo_stage(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]
