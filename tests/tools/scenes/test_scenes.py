"""The program that drops scanned objects: repeatable, at rest, split by object, true to labels."""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.io.splats.splat_files import read_splats
from gaga_core.raster import choose
from tests.bench.figures import data_folder

pytest.importorskip("mujoco", reason="MuJoCo is not installed: the extra `tools`")
from tools.scenes.arrange import KINDS, Kind, arrange
from tools.scenes.draw import Look, discs
from tools.scenes.make import SceneConfig, make_scene
from tools.scenes.scans import held_out, scan_names

_SCANS = data_folder("ycb_meshes")
_OVERLAP = 0.005  # metres that hulls of things at rest may run into each other
_SMALL = SceneConfig(3, "train", "touching", 160, 120, views=9)
pytestmark = pytest.mark.skipif(not _SCANS.is_dir(), reason="no scans here (GAGA_TEST_DATA)")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes") / "one"
    assert make_scene(folder, _SCANS, _SMALL)
    return folder


def _contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_the_same_seed_gives_the_same_bytes_and_is_made_once(scene: Path, tmp_path: Path) -> None:
    assert make_scene(tmp_path / "two", _SCANS, _SMALL)
    assert _contents(scene) == _contents(tmp_path / "two")
    assert not make_scene(scene, _SCANS, _SMALL)


@pytest.mark.parametrize("kind", KINDS)
def test_things_rest_on_something_and_not_in_each_other(kind: Kind) -> None:
    found = arrange(_SCANS, "train", kind, np.random.default_rng(5))
    assert found.objects
    assert all(found.rest.touches)
    assert found.rest.deepest < _OVERLAP
    rng = np.random.default_rng(6)
    drawn = discs(found, Look.drawn(len(found.blocks), rng), 0.1, rng)
    for k, (thing, place) in enumerate(zip(found.objects, found.rest.places, strict=True), 1):
        corners = np.concatenate(thing.body.pieces) @ place[:3, :3].T + place[:3, 3]
        points = drawn.points[drawn.labels == k]  # drawn where physics left it
        assert (points > corners.min(axis=0) - 1e-6).all()
        assert (points < corners.max(axis=0) + 1e-6).all()


def test_objects_kept_back_appear_in_test_scenes_alone() -> None:
    everything = scan_names(_SCANS, "test")
    kept_back = set(held_out(everything))
    assert len(kept_back) == 12
    for split in ("train", "val"):
        assert set(scan_names(_SCANS, split)) == set(everything) - kept_back


def test_truth_agrees_with_the_labels_of_splats(scene: Path) -> None:
    folder = open_scene_folder(scene)
    splats = read_splats(scene / "point_cloud.ply")
    labels = np.load(scene / "gt" / "splat_labels.npy")
    for camera in folder.cameras[:3]:
        truth = read_labels(scene / "gt" / "instance" / f"{Path(camera.name).stem}.png")
        shown = choose("cpu").label_splat(splats, camera, labels).labels
        both, either = (truth > 0) & (truth == shown), (truth > 0) | (shown > 0)
        assert both.sum() > 0.8 * either.sum() > 0


def test_a_folder_without_scans_is_refused_in_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(GagaError, match="holds no scans"):
        make_scene(tmp_path / "scene", tmp_path, _SMALL)
