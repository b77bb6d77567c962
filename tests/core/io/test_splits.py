"""Which views are trained on and which are tested: the same for every command and the window."""

import json
from pathlib import Path

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.io.datasets import open_dataset
from gaga_core.io.files import read_names
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.folder.splits import (
    EVERY_8TH,
    SCANNET_FOLDERS,
    SCANNET_LISTS,
    carry_split,
    split_views,
)
from gaga_core.pipeline.reconstruct import train_scene
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.progress import run_stage
from tests.datasets import LAYOUTS, gaga_replica, gaga_scannet, lerf_mask, write_photo

NAMES = [f"{k}.png" for k in range(20)]


def write_split(root: Path, train: list[str], test: list[str]) -> None:
    (root / "split.json").write_text(json.dumps({"train": train, "test": test}))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_scene_folder_and_a_data_set_agree(layout: str, tmp_path: Path) -> None:
    """The window, reconstruct and run open the folder; the benchmark opens the data set."""
    name, write = LAYOUTS[layout]
    names = write(tmp_path / "room")
    (scene,) = open_dataset(name, tmp_path).scenes
    found = split_views(tmp_path / "room", names.values())
    assert set(found.test) == set(scene.folder.test)
    assert set(found.train) == set(scene.folder.train)
    assert not set(found.test) & set(found.train)
    assert found.rule == scene.folder.split
    if layout in ("Replica, Gaga", "LERF-Mask"):
        opened = open_scene_folder(tmp_path / "room")
        assert (opened.test, opened.train, opened.split) == (found.test, found.train, found.rule)


def test_without_a_split_every_8th_by_alphabet_is_a_test_view(tmp_path: Path) -> None:
    found = split_views(tmp_path, NAMES)
    assert set(found.test) == set(sorted(NAMES)[::8])
    assert set(found.train) == set(NAMES) - set(found.test)
    assert found.rule == EVERY_8TH
    assert split_views(tmp_path, ["a.png"]).train == ("a.png",)


def test_lists_of_scannet_as_numpy_writes_them_and_one_alone(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "test_split.txt", [3, 12])
    found = split_views(tmp_path, NAMES)
    assert found.test == ("3.png", "12.png")
    assert set(found.train) == set(NAMES) - set(found.test)
    (tmp_path / "train_split.txt").write_text("0\n5.png\n99\n12\n")
    both = split_views(tmp_path, NAMES)
    assert both.train == ("0.png", "5.png")  # 12 is tested, so it is not trained on
    assert both.unknown == ("99",)
    assert both.rule == SCANNET_LISTS


def test_folders_of_dm_nerf_decide_where_the_lists_are_gone(tmp_path: Path) -> None:
    names = gaga_scannet(tmp_path / "scene0000_00")
    for part in ("train", "test"):
        (tmp_path / "scene0000_00" / f"{part}_split.txt").unlink()
    opened = open_scene_folder(tmp_path / "scene0000_00")
    assert opened.test == (names[2], names[6])
    assert opened.split == SCANNET_FOLDERS


def test_split_json_wins_and_a_view_in_both_lists_is_tested(tmp_path: Path) -> None:
    gaga_replica(tmp_path)
    write_split(tmp_path, ["train_rgb_0000", "test_rgb_0001"], ["test_rgb_0001.png", "gone"])
    opened = open_scene_folder(tmp_path)
    assert opened.train == ("train_rgb_0000.png",)
    assert opened.test == ("test_rgb_0001.png",)
    write_split(tmp_path, ["", "/", ".."], [])
    assert split_views(tmp_path, NAMES).unknown == ("", "/", "..")
    (tmp_path / "split.json").write_text("[]")
    with pytest.raises(GagaError, match=r"split\.json"):
        split_views(tmp_path, NAMES)


def test_names_part_views_only_where_both_kinds_are_there(tmp_path: Path) -> None:
    assert split_views(tmp_path, ["train_station.png", "a.png"]).rule == EVERY_8TH
    found = split_views(tmp_path, ["train/0.png", "test/0.png", "b.png"])
    assert (found.train, found.test) == (("train/0.png",), ("test/0.png",))


def test_a_list_that_is_too_long_is_not_cut(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("ä\n" * (1 << 20))
    with pytest.raises(GagaError, match="too much for a list"):
        read_names(tmp_path / "a.txt")


def test_a_scene_made_of_published_photos_keeps_their_split(tmp_path: Path) -> None:
    names = lerf_mask(tmp_path / "figurines")
    scene = tmp_path / "scene"
    gaga_replica(scene)  # any photos of the same split would do
    carry_split(tmp_path / "figurines" / "images", scene)
    assert split_views(scene, names.values()).test == (names[2], names[4], names[6])
    (scene / "split.json").unlink()
    carry_split(scene / "images", tmp_path / "other")  # names go along by themselves
    assert not (tmp_path / "other").exists()


def test_nothing_of_a_test_photo_reaches_the_splats(tmp_path: Path) -> None:
    """Replica as Gaga publishes it: other test photos give the same splats, bit for bit."""
    found = []
    for seed in (0, 1):
        root = tmp_path / str(seed)
        names = gaga_replica(root, masks=False)
        for name in (name for name in names.values() if name.startswith("test")):
            noise = np.random.default_rng(seed).integers(0, 256, (60, 80, 3), np.uint8)
            write_photo(root / "images" / name, noise)
        config = ReconstructConfig(quality="draft", iterations=3, max_side=64, max_splats=1000)
        found.append(run_stage(train_scene(open_scene_folder(root), config)))
    assert np.array_equal(found[0].means, found[1].means)
    assert np.array_equal(found[0].sh, found[1].sh)
