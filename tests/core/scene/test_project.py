import json
from pathlib import Path

import numpy as np
import pytest
import torch
from plyfile import PlyData

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.cli.main import main
from gaga_core.errors import GagaError
from gaga_core.export.export import export_scene_stage
from gaga_core.identity.classifier_io import with_encodings, write_classifier
from gaga_core.identity.field import Identity, IdentityField, save_identity
from gaga_core.identity.linear_kernels import D
from gaga_core.io.cameras.colmap import write_colmap
from gaga_core.io.files import fingerprint
from gaga_core.io.folder.scene_folder import World, known_world, write_world
from gaga_core.io.splats.ply import write_ply
from gaga_core.progress import run_stage
from gaga_core.scene import edits
from gaga_core.scene.camera_path import Bookmark, Shot
from gaga_core.scene.edits.history import History
from gaga_core.scene.edits.values import Edit
from gaga_core.scene.project import save_project
from tests.core.scene.projects import assert_same, edited, model_in, opened
from tests.scenes import objects_scene, random_gaussians


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

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(GagaError, match="disk is full"):
        save_project(project)
    assert {p.name: p.read_bytes() for p in where.iterdir()} == before


@pytest.mark.parametrize("size", [1e6, 1e17, 1e19, 1e30, 1e-19, 1e-120])
@pytest.mark.parametrize("kind", ["far", "large", "bright", "scene"])
def test_an_edit_is_refused_or_what_it_makes_can_be_saved_and_opened(
    tmp_path: Path, size: float, kind: str
) -> None:
    """A typed 1e30 was saved, and the project could never be opened again."""
    project = opened(model_in(tmp_path))
    scene, splats = project.scene, np.arange(20)
    far, large = np.column_stack([np.eye(3), [size, 0, 0]]), size * np.eye(3, 4)
    edit: Edit | None
    for _ in range(3):
        try:
            if kind == "scene":
                edit = edits.move_scene(scene, large, "Grow")
            elif kind == "bright":
                edit = edits.recolor(scene, splats, large)
            else:
                edit = edits.transform(scene, splats, far if kind == "far" else large)
        except (GagaError, ValueError):  # a map that flattens space is a wrong call
            break
        assert edit is not None
        edit.apply(scene)
    assert_same(opened(save_project(project)).scene, scene)


def test_a_place_too_far_to_be_saved_is_a_sentence(tmp_path: Path) -> None:
    project = opened(model_in(tmp_path))
    far = np.column_stack([np.eye(3), [1e30, 0, 0]])
    with pytest.raises(GagaError, match="than can be saved"):
        edits.transform(project.scene, np.arange(20), far)
    edit = edits.move_scene(project.scene, 1e8 * np.eye(3, 4), "Grow")
    assert edit is not None
    edit.apply(project.scene)
    with pytest.raises(GagaError, match="than can be saved"):
        edits.move_scene(project.scene, 1e11 * np.eye(3, 4), "Grow")


def test_what_could_not_be_opened_is_not_saved_over_the_last_save(tmp_path: Path) -> None:
    project = opened(model_in(tmp_path))
    saved = save_project(project)
    project.scene.placements.matrix[0, 0, 3] = 1e30
    with pytest.raises(GagaError, match="saved before is as it was"):
        save_project(project)
    assert opened(saved).scene.placements.matrix[0, 0, 3] == 0


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


def test_metres_and_the_vertical_of_given_poses_reach_the_project_and_its_export(
    tmp_path: Path,
) -> None:
    scene = objects_scene(2, 20, n_cameras=3)
    (tmp_path / "sparse" / "0").mkdir(parents=True)
    write_colmap(
        tmp_path / "sparse" / "0", scene.cameras, np.ones((1, 3)), np.ones((1, 3), np.uint8)
    )
    write_ply(tmp_path / "point_cloud.ply", scene.gaussians)
    assert not opened(tmp_path).scene.frame.is_metric
    assert np.allclose(opened(tmp_path).up, (0, 0, 1), atol=0.02)
    write_world(tmp_path, World(is_metric=True, up=(0, 1, 0), program="ARKit"))
    project = opened(tmp_path)
    assert project.scene.frame.is_metric
    assert np.allclose(project.up, (0, 1, 0))
    # Turned on its side as a whole, the vertical turns along; a saved project keeps both.
    turn = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0]], np.float64)
    edit = edits.move_scene(project.scene, turn, "Turn")
    assert edit is not None
    History(project.scene).do(edit)
    assert np.allclose(project.up, (0, 0, 1))
    again = opened(save_project(project))
    assert again.scene.frame.is_metric
    assert np.allclose(again.up, (0, 0, 1))
    # A file that is damaged says nothing, and stops nothing.
    (tmp_path / "gaga" / "world.json").write_text('{"up": [0, 0, 0], "is_metric": 3}')
    assert known_world(tmp_path) == (False, None)


# --- Models that Gaussian Grouping and Gaga trained open with their objects, and ours load there.


_N, _K = 500, 300  # more classes than a byte holds


def _trained(seed: int = 0) -> tuple[FloatArray, FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    shapes = (_N, D), (_K, D), (_K,)
    encodings, weight, bias = (rng.normal(size=s).astype(np.float32) for s in shapes)
    return encodings, weight, bias


def _model_folder(folder: Path) -> Path:
    """The layout that the published trainings leave."""
    encodings, weight, bias = _trained()
    place = folder / "point_cloud" / "iteration_30000"
    place.mkdir(parents=True)
    write_ply(place / "point_cloud.ply", with_encodings(random_gaussians(_N), encodings))
    layer = torch.nn.Conv2d(D, _K, 1)
    with torch.no_grad():
        layer.weight.copy_(torch.tensor(weight).reshape(_K, D, 1, 1))
        layer.bias.copy_(torch.tensor(bias))  # type: ignore[union-attr]
    torch.save(layer.state_dict(), place / "classifier.pth")
    return place


def _labels_by_their_code(folder: Path, n_classes: int) -> IntArray:
    """What the published code makes of a folder: columns by name, a 1 x 1 convolution, argmax."""
    vertices = PlyData.read(str(folder / "point_cloud.ply")).elements[0]
    objects = np.zeros((len(vertices.data), D, 1))
    for channel in range(D):
        objects[:, channel, 0] = np.asarray(vertices[f"obj_dc_{channel}"])
    features = torch.tensor(objects, dtype=torch.float).transpose(1, 2)  # (N, 1, D)
    classifier = torch.nn.Conv2d(D, n_classes, kernel_size=1)
    classifier.load_state_dict(torch.load(folder / "classifier.pth", weights_only=True))
    with torch.no_grad():
        logits = classifier(features.permute(2, 0, 1))  # (D, N, 1) -> (K, N, 1)
    return torch.softmax(logits, 0).argmax(0)[:, 0].numpy().astype(np.int32)


@pytest.mark.parametrize("part", ["", "point_cloud/iteration_30000/point_cloud.ply"])
def test_a_trained_model_opens_with_its_objects(tmp_path: Path, part: str) -> None:
    place = _model_folder(tmp_path)
    scene = opened(tmp_path / part).scene
    encodings, weight, bias = _trained()
    scores = np.exp((encodings @ weight.T + bias).astype(np.float64))
    probability = (scores / scores.sum(axis=1, keepdims=True)).max(axis=1)
    assert np.array_equal(scene.labels, _labels_by_their_code(place, _K))
    assert scene.confidence is not None
    np.testing.assert_allclose(scene.confidence, 255 * probability, atol=0.51)


def test_without_a_classifier_it_opens_without_objects(tmp_path: Path) -> None:
    (_model_folder(tmp_path) / "classifier.pth").unlink()
    assert not opened(tmp_path).scene.labels.any()


def test_a_damaged_classifier_is_told_with_the_way_around(tmp_path: Path) -> None:
    (_model_folder(tmp_path) / "classifier.pth").write_bytes(b"nothing")
    with pytest.raises(GagaError, match=r"move classifier\.pth away"):
        opened(tmp_path)


def test_groups_of_a_classifier_are_kept_by_an_export_and_a_project(tmp_path: Path) -> None:
    _model_folder(tmp_path)
    project = opened(tmp_path)
    out = tmp_path / "kept.ply"
    run_stage(export_scene_stage(project.scene, out, groups=True))
    assert np.array_equal(opened(out).scene.labels, project.scene.labels)


def test_an_export_with_identity_is_read_alike_by_their_code(tmp_path: Path) -> None:
    synthetic = objects_scene()
    root, out = tmp_path / "scene", tmp_path / "point_cloud" / "iteration_10000"
    (root / "gaga").mkdir(parents=True)
    out.mkdir(parents=True)
    write_ply(root / "point_cloud.ply", synthetic.gaussians)
    rng = np.random.default_rng(1)
    n = len(synthetic.gaussians)
    field = IdentityField(
        rng.normal(size=(n, D)).astype(np.float32),
        rng.normal(size=(40, D)).astype(np.float32),
        rng.normal(size=40).astype(np.float32),
    )
    labels, confidence = field.classify(field.encodings)
    save_identity(root / "gaga" / "identity.npz", Identity(field, labels, confidence, "paper"))
    status = main(["export", str(root), "--out", str(out / "point_cloud.ply"), "--identity"])
    assert status == 0
    assert np.array_equal(_labels_by_their_code(out, 40), labels)
    assert np.array_equal(opened(tmp_path).scene.labels, labels)  # and by ourselves


def test_a_model_of_others_is_exported_with_its_own_identities(tmp_path: Path) -> None:
    place = _model_folder(tmp_path / "theirs")
    out = tmp_path / "ours"
    out.mkdir()
    command = ["export", str(tmp_path / "theirs"), "--out", str(out / "point_cloud.ply")]
    assert main([*command, "--identity"]) == 0
    assert np.array_equal(_labels_by_their_code(out, _K), _labels_by_their_code(place, _K))


def test_identities_need_a_ply(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _model_folder(tmp_path)
    out = tmp_path / "small.splat"
    assert main(["export", str(tmp_path), "--out", str(out), "--identity"]) == 1
    assert "Choose --form ply" in capsys.readouterr().err
    assert not out.exists()


def test_a_classifier_of_other_width_is_refused(tmp_path: Path) -> None:
    place = _model_folder(tmp_path)
    state = torch.nn.Conv2d(8, 30, 1).state_dict()
    torch.save(state, place / "classifier.pth")
    with pytest.raises(GagaError, match="weights of shape"):
        opened(tmp_path)
    write_classifier(place / "classifier.pth", np.ones((2, D), np.float32), np.ones(2, np.float32))
    assert opened(tmp_path).scene.labels.max() <= 1
