import json
from pathlib import Path

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.io.files import fingerprint
from gaga_core.io.splats.ply import write_ply
from gaga_core.scene import edits
from gaga_core.scene.camera_path import Bookmark, Shot
from gaga_core.scene.edits.history import History
from gaga_core.scene.project import save_project
from tests.core.scene.projects import assert_same, edited, model_in, opened
from tests.scenes import objects_scene


def test_a_saved_project_is_reopened_with_every_edit(tmp_path: Path) -> None:
    project = edited(opened(model_in(tmp_path)))
    where = save_project(project)
    assert where == tmp_path / "model.gaga"
    for path in (where, where / "project.json"):
        again = opened(path)
        assert_same(project.scene, again.scene)
        assert again.model_path == project.model_path
    assert again.path == where


def test_a_failed_save_keeps_the_former_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    project = opened(model_in(tmp_path))
    where = save_project(project)
    before = {p.name: p.read_bytes() for p in where.iterdir()}
    edited(project)

    def full(*_: object, **__: object) -> str:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("gaga_core.scene.project.json.dumps", full)
    with pytest.raises(GagaError, match="disk is full"):
        save_project(project)
    assert {p.name: p.read_bytes() for p in where.iterdir()} == before


def test_a_model_that_changed_or_went_is_named(tmp_path: Path) -> None:
    path = model_in(tmp_path)
    where = save_project(edited(opened(path)))
    write_ply(path, objects_scene(seed=9).gaussians)
    with pytest.raises(GagaError, match="changed since"):
        opened(where)
    path.unlink()
    with pytest.raises(GagaError, match="are gone"):
        opened(where)


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"format": 1}'])
def test_a_damaged_project_file_is_a_sentence_and_stays(tmp_path: Path, text: str) -> None:
    where = save_project(opened(model_in(tmp_path)))
    (where / "project.json").write_text(text)
    with pytest.raises(GagaError):
        opened(where)
    assert (where / "project.json").read_text() == text


def test_a_project_in_which_an_object_lies_under_itself_is_a_sentence(tmp_path: Path) -> None:
    where = save_project(opened(model_in(tmp_path)))
    content = json.loads((where / "project.json").read_text())
    for parents in ({"1": 2, "2": 1}, {"0": 1}, {"1": 0}):
        (where / "project.json").write_text(json.dumps(content | {"parents": parents}))
        with pytest.raises(GagaError, match="damaged"):
            opened(where)


def test_damaged_columns_are_a_sentence(tmp_path: Path) -> None:
    where = save_project(edited(opened(model_in(tmp_path))))
    file = next(where.glob("scene-*.npz"))
    with np.load(file) as stored:
        arrays = dict(stored)
    for name, value in (("source", arrays["source"] + 10**6), ("labels", arrays["labels"][:-1])):
        with file.open("wb") as out:
            np.savez(out, **(arrays | {name: value}))
        with pytest.raises(GagaError, match="damaged"):
            opened(where)
    file.write_bytes(b"PK no more")
    with pytest.raises(GagaError, match="damaged"):
        opened(where)


def test_numbers_of_numpy_are_saved(tmp_path: Path) -> None:
    project = opened(model_in(tmp_path))
    shot = Shot((np.float64(1), 0, 0), (1, 0, 0, 0), np.float64(1), 1, np.float64(2))
    project.bookmarks = (Bookmark("here", shot),)
    project.scene.colors = {1: (np.float64(0.5), 0, np.float32(1))}  # type: ignore[dict-item]
    again = opened(save_project(project))
    assert again.bookmarks == project.bookmarks
    assert again.scene.colors == {1: (0.5, 0, 1)}


def test_a_project_moves_with_its_model(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    project = edited(opened(model_in(tmp_path / "a")))
    save_project(project)
    (tmp_path / "a").rename(tmp_path / "b")
    assert_same(project.scene, opened(tmp_path / "b" / "model.gaga").scene)


def test_a_newer_format_is_refused(tmp_path: Path) -> None:
    where = save_project(opened(model_in(tmp_path)))
    document = json.loads((where / "project.json").read_text())
    document["format"] = 99
    (where / "project.json").write_text(json.dumps(document))
    with pytest.raises(GagaError, match="newer"):
        opened(where)


def test_fingerprint_sees_a_change_anywhere_it_samples(tmp_path: Path) -> None:
    path = tmp_path / "x"
    content = np.random.default_rng(0).integers(0, 256, 3_000_000).astype(np.uint8)
    path.write_bytes(content.tobytes())
    before = fingerprint(path)
    content[1_500_000] ^= 1
    path.write_bytes(content.tobytes())
    assert fingerprint(path) != before


def test_real_scene_with_a_project(ycb_table: Path, tmp_path: Path) -> None:
    root = tmp_path / "table"
    root.mkdir()
    for name in ("images", "sparse", "masks", "point_cloud.ply", "split.json"):
        (root / name).symlink_to(ycb_table / name)
    project = opened(root)
    assert project.folder is not None
    assert len(project.folder.cameras) == 64
    history = History(project.scene)
    history.do(edits.delete(project.scene, np.arange(100)))
    save_project(project)
    assert (root / "gaga" / "project.json").is_file()
    again = opened(root)
    assert_same(project.scene, again.scene)
    assert again.folder is not None
    assert again.scene.visible.sum() == 59_900
