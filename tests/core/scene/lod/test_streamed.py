"""Streamed SOG: written from a tree and read back; what other writers may do; what is damaged."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.splats.sog import LOD_META, read_sog_stage
from gaga_core.io.splats.splat_files import read_splats, read_splats_stage
from gaga_core.progress import Progress, run_stage
from gaga_core.scene.lod.build import build_lod_stage
from gaga_core.scene.lod.tree import LodTree, write_streamed_sog_stage
from tests.scenes import random_gaussians
from tests.shares import falls, shares

N = 40_000


@pytest.fixture(scope="module")
def opened() -> Gaussians:
    return random_gaussians(N)


@pytest.fixture(scope="module")
def tree(opened: Gaussians, tmp_path_factory: pytest.TempPathFactory) -> LodTree:
    folder = tmp_path_factory.mktemp("streamed") / "lod"
    return run_stage(build_lod_stage(opened, folder, "digest"))


@pytest.fixture(scope="module")
def written(tree: LodTree, opened: Gaussians, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_stage(write_streamed_sog_stage(tmp_path_factory.mktemp("web"), tree, opened))


def leaves(node: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for child in node.get("children", []):
        yield from leaves(child)
    if "lods" in node:
        yield node


def test_finest_level_comes_back(written: Path, tree: LodTree, opened: Gaussians) -> None:
    for path in (written, written.parent):
        found = read_splats(path)
        assert len(found) == N
        assert np.abs(found.means - opened.means[tree.order]).max() < 1e-3


def test_writing_tells_one_share_that_never_falls_and_ends_whole(
    tree: LodTree, opened: Gaussians, tmp_path: Path
) -> None:
    """Each chunk began again at 0."""
    words: list[Progress] = []
    run_stage(write_streamed_sog_stage(tmp_path, tree, opened), words.append)
    assert falls(words) == []
    assert shares(words)[-1] == 1
    assert len(set(shares(words))) > 2 * len(list(tmp_path.glob("*/meta.json"))), "within each"


def test_reading_tells_one_share_that_goes_on(written: Path, tmp_path: Path) -> None:
    """Each chunk began again at 0, and the time left was said to be a second."""
    shutil.copytree(written.parent, tmp_path, dirs_exist_ok=True)
    meta = json.loads(written.read_text(encoding="utf-8"))
    meta["environment"] = meta["filenames"][-1]  # a second chunk that is read
    (tmp_path / LOD_META).write_text(json.dumps(meta), encoding="utf-8")
    words: list[Progress] = []
    run_stage(read_splats_stage(tmp_path), words.append)
    assert len({word.stage for word in words}) == 1
    shares = [word.done / word.total for word in words]
    assert shares == sorted(shares)
    assert any(0 < share < 0.5 for share in shares), "within a chunk, too"
    assert any(0.5 < share < 1 for share in shares)


def test_every_level_is_listed_once_and_lies_in_its_box(written: Path, tree: LodTree) -> None:
    meta = json.loads(written.read_text(encoding="utf-8"))
    assert meta["version"] == 1
    assert meta["lodLevels"] == len(meta["counts"])
    assert meta["count"] == sum(meta["counts"])
    assert meta["counts"] == list(tree.sizes[: meta["lodLevels"]])
    chunks = [run_stage(read_sog_stage(written.parent / name)) for name in meta["filenames"]]
    used = [np.zeros(len(chunk), np.int32) for chunk in chunks]
    for leaf in leaves(meta["tree"]):
        assert sorted(leaf["lods"]) == [str(level) for level in range(meta["lodLevels"])]
        for part in leaf["lods"].values():
            rows = slice(part["offset"], part["offset"] + part["count"])
            used[part["file"]][rows] += 1
            means = chunks[part["file"]].means[rows]
            assert (means >= np.array(leaf["bound"]["min"]) - 1e-3).all()
            assert (means <= np.array(leaf["bound"]["max"]) + 1e-3).all()
    assert all((counts == 1).all() for counts in used)


def test_leaves_with_some_levels_and_an_environment_are_read(written: Path, tmp_path: Path) -> None:
    meta = json.loads(written.read_text(encoding="utf-8"))
    kept = next(leaves(meta["tree"]))
    del kept["lods"]["0"]  # its finest is level 1 now
    meta = {
        "lodLevels": meta["lodLevels"],
        "filenames": [f"../{written.parent.name}/{name}" for name in meta["filenames"]],
        "environment": "env/meta.json",
        "tree": {"bound": kept["bound"], "children": [kept]},
    }
    folder = tmp_path / "other"
    folder.mkdir()
    (folder / LOD_META).write_text(json.dumps(meta), encoding="utf-8")
    with pytest.raises(GagaError, match="in its folder"):
        read_splats(folder)
    meta["filenames"] = [name.removeprefix("../") for name in meta["filenames"]]
    shutil.copytree(written.parent, folder / written.parent.name)
    shutil.copytree(written.parent / "1_0", folder / "env")
    (folder / LOD_META).write_text(json.dumps(meta), encoding="utf-8")
    n_env = len(read_splats(written.parent / "1_0"))
    assert len(read_splats(folder)) == kept["lods"]["1"]["count"] + n_env


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"version": 2}, "version 2"),
        ({"filenames": []}, "does not list"),
        ({"filenames": ["/etc/passwd"] * 99}, "in its folder"),
        ({"tree": {"bound": {"min": [0, 0, 0], "max": [1, 1, 1]}}}, "names no splats"),
        ({"tree": 3}, "tree"),
    ],
)
def test_damaged_lists_are_told(
    written: Path, tmp_path: Path, change: dict[str, Any], says: str
) -> None:
    meta = {**json.loads(written.read_text(encoding="utf-8")), **change}
    (tmp_path / LOD_META).write_text(json.dumps(meta), encoding="utf-8")
    with pytest.raises(GagaError, match=says):
        read_splats(tmp_path)


def test_deep_trees_ranges_beyond_a_chunk_and_the_same_one_often_are_told(
    written: Path, tmp_path: Path
) -> None:
    meta = json.loads(written.read_text(encoding="utf-8"))
    deep = meta["tree"]
    for _ in range(100):
        deep = {"bound": meta["tree"]["bound"], "children": [deep]}
    (tmp_path / LOD_META).write_text(json.dumps({**meta, "tree": deep}), encoding="utf-8")
    with pytest.raises(GagaError, match="deeper"):
        read_splats(tmp_path)
    for name in meta["filenames"]:
        shutil.copytree(written.parent / name.split("/")[0], tmp_path / name.split("/")[0])
    leaf = next(leaves(meta["tree"]))
    often = {"bound": leaf["bound"], "children": [leaf] * 9}
    (tmp_path / LOD_META).write_text(json.dumps({**meta, "tree": often}), encoding="utf-8")
    with pytest.raises(GagaError, match="fewer splats"):
        read_splats(tmp_path)
    leaf["lods"]["0"]["count"] = N + 1
    (tmp_path / LOD_META).write_text(json.dumps(meta), encoding="utf-8")
    with pytest.raises(GagaError, match="fewer splats"):
        read_splats(tmp_path)
