"""Whatever bytes a file holds, reading it gives a result or one sentence, and never less."""

import io
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaga_core.api import Scene
from gaga_core.errors import GagaError
from gaga_core.evaluate.group_scores import UNANSWERED, evaluate, score_pairs
from gaga_core.io.arrays_file import read_array, read_arrays
from gaga_core.io.cameras.cameras_json import read_cameras_json, write_cameras_json
from gaga_core.io.cameras.colmap import read_colmap, write_colmap
from gaga_core.io.folder.scene_folder import open_scene_folder, with_entry
from gaga_core.io.masks.label_maps import read_labels, write_labels
from gaga_core.io.splats.ply import read_ply, write_ply
from gaga_core.progress import run_stage
from gaga_core.scene.camera_path import load_path
from gaga_core.scene.project import (
    ModelChangedError,
    Project,
    SavedElsewhereError,
    open_path_stage,
    save_project,
)
from tests.scenes import orbit_cameras, random_gaussians


def opened(path: Path) -> Project:
    return run_stage(open_path_stage(path))


def test_arrays_of_another_kind_are_damage(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.zeros(3))
    with pytest.raises(GagaError, match="damaged"):
        read_arrays(tmp_path / "a.npy", "Do it again.")
    with pytest.raises(GagaError, match="does not exist"):
        read_arrays(tmp_path / "b.npz", "Do it again.")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (b"element vertex 30", b"element vertex " + b"9" * 30, "truncated or damaged"),
        (b"f_rest_3\n", b"f_rest_99\n", "without f_rest_3"),
        (b"element", "comment café\nelement".encode(), "outside ASCII"),
    ],
)
def test_odd_ply_headers(tmp_path: Path, old: bytes, new: bytes, says: str) -> None:
    path = tmp_path / "a.ply"
    write_ply(path, random_gaussians(30, sh_degree=1))
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    with pytest.raises(GagaError, match=says):
        read_ply(path)


@pytest.fixture(scope="module")
def binary_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    import pycolmap

    text = tmp_path_factory.mktemp("text")
    write_colmap(text, orbit_cameras(4), np.ones((5, 3)), np.zeros((5, 3), np.uint8))
    binary = tmp_path_factory.mktemp("binary")
    pycolmap.Reconstruction(str(text)).write_binary(str(binary))
    return binary


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("cameras.bin", lambda b: b[:-1], "cameras.bin is truncated"),
        ("cameras.bin", lambda b: b[:30], "cameras.bin is truncated"),
        ("points3D.bin", lambda _: b"", "points3D.bin is truncated"),
        ("points3D.bin", lambda b: b"\xff" * 8 + b[8:], "points3D.bin is truncated"),
        ("points3D.bin", None, "no points3D.bin"),
        ("images.bin", lambda b: b[:200], "cannot be read"),
    ],
)
def test_a_binary_model_that_was_cut_is_refused(
    binary_model: Path, tmp_path: Path, name: str, content: Callable[[bytes], bytes], says: str
) -> None:
    for file in binary_model.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    assert len(read_colmap(tmp_path).cameras) == 4
    if content is None:
        (tmp_path / name).unlink()
    else:
        (tmp_path / name).write_bytes(content((tmp_path / name).read_bytes()))
    with pytest.raises(GagaError, match=says):
        read_colmap(tmp_path)


@pytest.mark.parametrize("camera", ["0 0 50 50 5 5", "10 10 0 50 5 5", "10 10 50 50 nan 5"])
def test_cameras_without_size_or_focal_length_are_named(tmp_path: Path, camera: str) -> None:
    write_colmap(tmp_path, orbit_cameras(1), np.ones((1, 3)), np.zeros((1, 3), np.uint8))
    (tmp_path / "cameras.txt").write_text(f"1 PINHOLE {camera}\n")
    with pytest.raises(GagaError, match="COLMAP model"):
        read_colmap(tmp_path)


def test_a_split_may_name_photos_by_stem(tmp_path: Path) -> None:
    write_colmap(
        tmp_path / "sparse/0", orbit_cameras(3), np.ones((1, 3)), np.ones((1, 3), np.uint8)
    )
    (tmp_path / "split.json").write_text('{"train": ["000", "002.jpg"], "test": ["001.png"]}')
    folder = open_scene_folder(tmp_path)
    assert (folder.train, folder.test) == (("000.png", "002.png"), ("001.png",))
    (tmp_path / "split.json").write_text('{"train": "000", "test": []}')
    with pytest.raises(GagaError, match=r"split\.json"):
        open_scene_folder(tmp_path)


def test_negative_ids_are_none_and_maps_can_be_written_to(tmp_path: Path) -> None:
    Image.fromarray(np.array([[-1, 70000], [3, 0]], np.int32)).save(tmp_path / "a.tif")
    labels = read_labels(tmp_path / "a.tif")
    assert labels.tolist() == [[0, 70000], [3, 0]]
    assert labels.flags.writeable


def test_a_missing_map_scores_zero_for_void_too(tmp_path: Path) -> None:
    true = np.zeros((4, 5), np.int32)
    true[0] = 1
    for name in ("pred", "gt"):
        (tmp_path / name).mkdir()
    write_labels(tmp_path / "gt" / "a.png", true)
    report = evaluate(tmp_path / "pred", tmp_path / "gt")
    assert report.missing == ("a",)
    for score in (report.with_void, report.without_void):
        assert (score.iou, score.pooled_iou, score.recall, score.n_predicted) == (0, 0, 0, 0)
    with_void, _ = score_pairs([(true, true), (true, np.full_like(true, UNANSWERED))])
    assert with_void.iou == pytest.approx(0.5)
    assert with_void.n_predicted == 2


def test_ids_too_large_for_a_table_score_alike() -> None:
    rng = np.random.default_rng(0)
    true = np.kron(rng.integers(0, 4, (4, 5)), np.ones((3, 3))).astype(np.int32)
    pred = rng.integers(0, 4, true.shape).astype(np.int32)
    assert score_pairs([(true, pred)]) == score_pairs([(true, pred * 500_000_000)])


@pytest.mark.parametrize("names", ["[]", "null", '{"mug": "x"}'])
def test_names_of_another_form_are_damage(tmp_path: Path, names: str) -> None:
    write_ply(tmp_path / "a.ply", random_gaussians(9))
    file = save_project(opened(tmp_path / "a.ply")) / "project.json"
    file.write_text(file.read_text().replace('"names": {}', f'"names": {names}'))
    with pytest.raises(GagaError, match=r"damaged \(.*names|damaged \(.*key"):
        opened(file)


def test_a_save_with_a_copy_does_not_need_the_model(tmp_path: Path) -> None:
    model = tmp_path / "a.ply"
    write_ply(model, random_gaussians(30))
    project = opened(model)
    project.scene.labels[3] = 2
    write_ply(model, random_gaussians(30, seed=1))  # an export over the opened file
    with pytest.raises(ModelChangedError):
        save_project(project)
    where = save_project(project, copies_model=True)
    model.unlink()
    save_project(project)
    again = opened(where).scene
    assert again.labels[3] == 2
    assert again.gaussians.means.tobytes() == project.scene.gaussians.means.tobytes()


_SIZES = {
    "more than there is": ((1 << 40,), b""),
    "less than there is": ((1,), bytes(400)),
    "negative": ((-4,), bytes(16)),
}


@pytest.mark.parametrize("name", list(_SIZES))
def test_arrays_that_announce_another_size_take_no_memory(tmp_path: Path, name: str) -> None:
    shape, content = _SIZES[name]
    head = io.BytesIO()
    header = {"descr": "<f4", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(head, header)
    (tmp_path / "a.npy").write_bytes(head.getvalue() + content)
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", head.getvalue() + content)
    tracemalloc.start()
    try:
        for read, file in ((read_arrays, "a.npz"), (read_array, "a.npy")):
            with pytest.raises(GagaError, match="damaged"):
                read(tmp_path / file, "Do it again.")
        assert tracemalloc.get_traced_memory()[1] < 1e6
    finally:
        tracemalloc.stop()


def test_an_archive_of_too_much_is_refused_before_it_is_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "a.npz"
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        head, {"descr": "|u1", "fortran_order": False, "shape": (200_000_000,)}
    )
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("a0.npy", head.getvalue() + bytes(200_000_000))
    monkeypatch.setattr("gaga_core.io.arrays_file.MOST_BYTES", 100_000_000)
    with pytest.raises(GagaError, match="damaged"):
        read_arrays(file, "Do it again.")


@pytest.mark.parametrize("size", [0, 65_537, 10**12])
def test_cameras_of_absurd_size_are_a_sentence(tmp_path: Path, size: int) -> None:
    cameras = orbit_cameras(2, width=64, height=48)
    write_cameras_json(tmp_path / "cameras.json", cameras)
    text = (tmp_path / "cameras.json").read_text()
    (tmp_path / "cameras.json").write_text(text.replace('"width": 64', f'"width": {size}'))
    with pytest.raises(GagaError, match=r"cameras.json is damaged \(field \[0\].width"):
        read_cameras_json(tmp_path / "cameras.json")
    write_colmap(tmp_path, cameras, np.zeros((3, 3)), np.zeros((3, 3), np.uint8))
    text = (tmp_path / "cameras.txt").read_text()
    (tmp_path / "cameras.txt").write_text(text.replace("PINHOLE 64", f"PINHOLE {size}"))
    with pytest.raises(GagaError, match="no usable camera"):
        read_colmap(tmp_path)


_DEEP = b"[" * 1_000_000
_FILES = ["project.json", "split.json", "cameras.json", "path.json", "report.json"]


@pytest.mark.parametrize("name", _FILES)
@pytest.mark.parametrize(
    "content", [_DEEP, b'{"a": ' * 200_000, b"NaN", b"9" * 5000, b"", b"\xff\xfe"], ids=range(6)
)
def test_our_json_is_refused_in_a_sentence(tmp_path: Path, name: str, content: bytes) -> None:
    file = tmp_path / name
    file.write_bytes(content)
    if name == "report.json":
        assert with_entry(file, "a", {"b": 1}).startswith("{")
        return
    readers: dict[str, Callable[[], object]] = {
        "project.json": lambda: opened(file),
        "cameras.json": lambda: read_cameras_json(file),
        "path.json": lambda: load_path(file),
        "split.json": lambda: open_scene_folder(with_views(tmp_path)),
    }
    with pytest.raises(GagaError, match=name):
        readers[name]()


def with_views(root: Path) -> Path:
    sparse = root / "sparse" / "0"
    sparse.mkdir(parents=True, exist_ok=True)
    write_colmap(sparse, orbit_cameras(2), np.zeros((3, 3)), np.zeros((3, 3), np.uint8))
    return root


def test_a_fresh_look_at_a_ply_never_replaces_an_earlier_save(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", random_gaussians(30))
    first = opened(tmp_path / "a.ply")
    first.scene.names[1] = "mug"
    one = save_project(first)
    two = save_project(opened(tmp_path / "a.ply"))
    assert one != two
    assert opened(one).scene.names == {1: "mug"}
    assert save_project(first) == one  # saving on goes where it was


def test_a_save_elsewhere_keeps_the_photos_and_foreign_files(tmp_path: Path) -> None:
    root, other = tmp_path / "s", tmp_path / "other"
    write_colmap(root / "sparse/0", orbit_cameras(3), np.ones((1, 3)), np.ones((1, 3), np.uint8))
    write_ply(root / "point_cloud.ply", random_gaussians(9))
    save_project(opened(root), other / "project.json")
    (other / "scene-of-mine.npz").write_bytes(b"not ours")
    again = opened(other)
    assert again.folder is not None
    assert len(again.folder.cameras) == 3
    save_project(again)
    assert (other / "scene-of-mine.npz").read_bytes() == b"not ours"


@pytest.mark.parametrize("there", ["project", "scene", "photos"])
def test_a_save_elsewhere_never_takes_the_place_of_something_else(
    tmp_path: Path, there: str
) -> None:
    """The files of another project were deleted, and another scene opened as this one."""
    write_ply(tmp_path / "a.ply", random_gaussians(9))
    other = tmp_path / "other"
    if there == "project":
        write_ply(tmp_path / "b.ply", random_gaussians(9, seed=1))
        save_project(opened(tmp_path / "b.ply"), other)
    elif there == "scene":
        points, colors = np.ones((1, 3)), np.ones((1, 3), np.uint8)
        write_colmap(other / "sparse/0", orbit_cameras(3), points, colors)
        write_ply(other / "point_cloud.ply", random_gaussians(9, seed=1))
        save_project(opened(other))
    else:
        other.mkdir()
        Image.new("RGB", (8, 8)).save(other / "1.jpg")
    before = {p: p.read_bytes() for p in other.rglob("*") if p.is_file()}
    ours = opened(tmp_path / "a.ply")
    for project in (ours, opened(save_project(ours, tmp_path / "ours.gaga"))):
        said = "Another project" if there == "project" else "Choose a new folder"
        with pytest.raises(GagaError, match=said):
            save_project(project, other)
        with pytest.raises(GagaError, match=said):
            Scene(project).save(other)
    after = {p: p.read_bytes() for p in other.rglob("*") if p.is_file()}
    assert after.items() >= before.items()
    if there == "project":  # that was said
        save_project(ours, other, overwrites=True)
        assert opened(other).model_path == tmp_path / "a.ply"


def test_a_project_finds_its_splats_under_another_name(tmp_path: Path) -> None:
    """Nothing led back to the project of a file that was renamed."""
    old, new = tmp_path / "a.ply", tmp_path / "renamed.ply"
    write_ply(old, random_gaussians(9))
    write_ply(tmp_path / "0.ply", random_gaussians(8))
    project = opened(old)
    project.scene.names = {1: "mug"}
    saved = save_project(project)
    old.rename(new)
    again = opened(saved)
    assert (again.model_path, again.scene.names) == (new, {1: "mug"})
    assert opened(new).saved_of_file == saved
    assert opened(tmp_path / "0.ply").saved_of_file is None
    save_project(again, saved)
    assert opened(saved).model_path == new
    new.unlink()
    with pytest.raises(GagaError, match=r"renamed\.ply"):
        opened(saved)


def test_an_export_keeps_the_splats_of_other_projects(tmp_path: Path) -> None:
    """They fitted no file any more; without a project a file is replaced."""
    for name in ("a.ply", "b.ply", "free.ply"):
        write_ply(tmp_path / name, random_gaussians(9, seed=len(name)))
    save_project(opened(tmp_path / "b.ply"), tmp_path / "other.gaga")
    scene = Scene(opened(tmp_path / "a.ply"))
    before = (tmp_path / "b.ply").read_bytes()
    with pytest.raises(GagaError, match=r"other\.gaga is read from"):
        scene.export(tmp_path / "b.ply")
    assert (tmp_path / "b.ply").read_bytes() == before
    assert scene.export(tmp_path / "free.ply").is_file()


def test_splats_that_were_trained_again_are_no_renamed_ones(tmp_path: Path) -> None:
    """A backup opened in their place without a word."""
    write_ply(tmp_path / "a.ply", random_gaussians(9))
    saved = save_project(opened(tmp_path / "a.ply"))
    (tmp_path / "a.ply").rename(tmp_path / "backup.ply")
    write_ply(tmp_path / "a.ply", random_gaussians(10))
    with pytest.raises(GagaError, match=r"a\.ply changed"):
        opened(saved)


def test_what_a_failed_save_left_blocks_no_later_one(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", random_gaussians(9))
    where = tmp_path / "b"
    for name in ("added-0123456789abcdef/c.ply", "model-0123456789ab.ply", ".gaga.lock"):
        (where / name).parent.mkdir(parents=True, exist_ok=True)
        (where / name).touch()
    assert save_project(opened(tmp_path / "a.ply"), where) == where


def test_a_script_that_runs_again_saves_where_it_did(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", random_gaussians(9))
    for name in ("x", "x/project.json"):
        assert Scene(opened(tmp_path / "a.ply")).save(tmp_path / name) == tmp_path / "x"
    one, other = opened(tmp_path / "x"), opened(tmp_path / "x")
    save_project(other)
    for path in (None, tmp_path / "x"):
        with pytest.raises(SavedElsewhereError):  # its own place is no other one
            Scene(one).save(path)
    with pytest.raises(SavedElsewhereError):
        save_project(opened(tmp_path / "a.ply"), tmp_path / "x")
