"""A scene may come from anyone: nothing is written, moved or removed behind a link in it."""

import hashlib
import json
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write, refuse_links, remove_leftovers, set_aside
from gaga_core.io.folder.lock import LOCK, OWNER, lock_folder
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.folder.staging import finish_publishing, publish_all, staging_folder
from gaga_core.io.splats.ply import write_ply
from gaga_core.pipeline.place import WORKSPACE, _claim, write_entry
from gaga_core.placing.checks import check_poses_stage
from gaga_core.progress import run_stage
from gaga_core.scene.project import open_path_stage, save_project
from tests.scenes import orbit_cameras, random_gaussians

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="links need a right there")
_LEFT = "gaga/.gaga-abcd1234"
_OLD = 1e9  # seconds since the epoch: nobody writes to such a file any more


def scene_in(root: Path) -> Path:
    root.mkdir()
    write_ply(root / "point_cloud.ply", random_gaussians(9))
    (root / "images").mkdir()
    return root


def publish(root: Path) -> None:
    with staging_folder(root / "gaga") as staging:
        (staging / "a" / "b").mkdir(parents=True)
        (staging / "a" / "b" / "c").write_text("new")
        publish_all(staging, ["a/b/c"], root / "gaga")


def replace_folder(root: Path) -> None:
    with staging_folder(root / "gaga") as staging:
        (staging / "a" / "b").mkdir(parents=True)
        (staging / "a" / "b" / "d").write_text("new")
        publish_all(staging, ["a"], root / "gaga")


def write(root: Path, name: str) -> None:
    with atomic_write(root / name) as temporary:
        temporary.write_text("new")


def save(root: Path) -> None:
    project = run_stage(open_path_stage(root / "point_cloud.ply"))
    save_project(project, root / "gaga", overwrites=True)


def claim(root: Path) -> None:
    workspace = root / WORKSPACE
    if not workspace.is_symlink():
        (workspace / "task").write_text("mine")
    _claim(workspace, "mine")
    (workspace / "photos").mkdir(exist_ok=True)
    (workspace / "photos" / "a.jpg").write_text("new")


def check_poses(root: Path) -> None:
    cameras, photo = orbit_cameras(1), root / "images" / "a.jpg"
    photos = {camera.name: photo for camera in cameras}
    assert run_stage(check_poses_stage(cameras, {}, root / WORKSPACE / "poses")) == ()
    assert run_stage(check_poses_stage(cameras, photos, root / WORKSPACE / "poses")) == ()


def clear(root: Path) -> None:
    for path in (root / "gaga").glob("**/*"):
        os.utime(path, (_OLD, _OLD), follow_symlinks=False)
    remove_leftovers(root / "gaga")


def lock(root: Path) -> None:
    lock_folder(root / "gaga").release()


# What writes, and a path that it touches.
_WRITERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "publish": ("gaga/a/b/c", publish),
    "replace a folder": ("gaga/a/b/c", replace_folder),
    "finish a plan": (f"{_LEFT}/a/b/c", lambda root: finish_publishing(root / "gaga")),
    "finish a plan of what is there": ("gaga/a/b/c", open_scene_folder),
    "remove leftovers": ("gaga/.gaga-00000000/a/b", clear),
    "write a file": ("gaga/cache/masks/a.png", lambda root: write(root, "gaga/cache/masks/a.png")),
    "write a mask": ("masks/sam/a.png", lambda root: write(root, "masks/sam/a.png")),
    "report": ("gaga/report.json", lambda root: write_entry(root, {})),
    "lock": (f"gaga/{LOCK}", lock),
    "name the owner": (f"gaga/{OWNER}", lock),
    "save": ("gaga/project.json", save),
    "save again": ("gaga/scene-0123456789ab.npz", save),
    "set aside": ("gaga/a.json", lambda root: set_aside(root / "gaga" / "a.json")),
    "claim a workspace": (f"{WORKSPACE}/photos/a.jpg", claim),
    "check poses": (f"{WORKSPACE}/poses/a/b", check_poses),
}
_CASES = [(name, k) for name, (path, _) in _WRITERS.items() for k in range(path.count("/") + 1)]


def digest(folder: Path) -> str:
    found = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        found.update(f"{path.relative_to(folder)} {path.is_symlink()}".encode())
        found.update(path.read_bytes() if path.is_file() else b"")
    return found.hexdigest()


@pytest.mark.parametrize(("name", "k"), _CASES)
def test_nothing_behind_a_link_changes(tmp_path: Path, name: str, k: int) -> None:
    path, writer = _WRITERS[name]
    root, outside = scene_in(tmp_path / "scene"), tmp_path / "outside"
    step = Path(*Path(path).parts[: k + 1])
    (outside / path).parent.mkdir(parents=True)
    (outside / path).write_text("outside")
    for folder in (root, outside) if name.startswith("finish") else ():  # a plan of both
        left = folder / _LEFT
        (left / "a" / "b").mkdir(parents=True, exist_ok=True)
        (left / "a" / "b" / "c").write_text("moved")
        (left / "publish.json").write_text(json.dumps(["a/b/c"]))
    linked = root / step
    if linked.exists():
        linked.rename(tmp_path / "former")
    linked.parent.mkdir(parents=True, exist_ok=True)
    linked.symlink_to(outside / step)
    before = digest(outside)
    with suppress(GagaError):
        writer(root)
    assert digest(outside) == before


@pytest.mark.parametrize("name", _WRITERS)
def test_a_scene_behind_a_link_is_written_to_as_any(tmp_path: Path, name: str) -> None:
    path, writer = _WRITERS[name]
    real, plain = scene_in(tmp_path / "real"), scene_in(tmp_path / "plain")
    for root in (real, plain):
        (root / path).parent.mkdir(parents=True)
        (root / path).write_text("{}" if name != "lock" else "")
    (tmp_path / "link").symlink_to(real)
    for root in (tmp_path / "link", plain):
        writer(root)
    names = [
        {path.name for path in root.rglob("*") if "-" not in path.name} for root in (real, plain)
    ]
    assert names[0] == names[1]


@pytest.mark.parametrize("name", [".", "./", "a//../..", "\0", "n" * 5000])
def test_a_plan_that_names_no_file_inside_moves_nothing(tmp_path: Path, name: str) -> None:
    left = tmp_path / ".gaga-abcd1234"
    left.mkdir()
    (left / "bank.npz").write_text("new")
    (left / "publish.json").write_text(json.dumps(["bank.npz", name]))
    before = digest(tmp_path)
    assert finish_publishing(tmp_path) == 0
    assert digest(tmp_path) == before


def test_links_on_the_way_to_a_scene_are_the_users_own(tmp_path: Path) -> None:
    real = scene_in(tmp_path / "real")
    (tmp_path / "gaga").symlink_to(real)  # no scene lies around it
    refuse_links(tmp_path / "gaga" / "gaga" / "masks")
    (real / "gaga").mkdir()
    (real / "gaga" / "masks").symlink_to(tmp_path)
    with pytest.raises(GagaError, match="is a link"):
        refuse_links(tmp_path / "gaga" / "gaga" / "masks" / "a")
