"""Exported objects are opened again: splats, ids, names, colors and folders."""

import json
from pathlib import Path

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.export.export import export_objects_stage
from gaga_core.io.splats.packing import READS
from gaga_core.io.splats.splat_files import SplatFormat
from gaga_core.progress import Progress, run_stage
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.folders import Folders
from gaga_core.scene.objects import group_colors, group_indices
from gaga_core.scene.project import READS_OBJECTS, open_path_stage, save_project
from gaga_core.scene.scene import Scene
from tests.core.scene.projects import assert_same, opened
from tests.scenes import objects_scene


@pytest.fixture
def scene() -> Scene:
    made = objects_scene(5, 40)
    scene = Scene.of(made.gaussians, made.labels)
    history = History(scene)
    history.do(edits.rename(scene, 2, "kettle"))
    history.do(edits.set_color(scene, 3, (1.0, 0.5, 0.0)))
    history.do(edits.put_in_folder(scene, (2, 3), "Kitchen"))
    history.do(edits.put_in_folder(scene, (4,), "Kitchen/Cups"))
    history.do(edits.set_parent(scene, (5,), 3))
    history.do(edits.set_parent(scene, (1,), 5))
    return scene


@pytest.mark.parametrize("form", [SplatFormat.PLY, SplatFormat.SPZ])
@pytest.mark.parametrize("name", ["", "groups.json"])
def test_an_export_is_opened_as_it_was(
    scene: Scene, tmp_path: Path, form: SplatFormat, name: str
) -> None:
    run_stage(export_objects_stage(scene, tmp_path / "out", form=form))
    project = opened(tmp_path / "out" / name)
    again = project.scene
    assert again.names == {2: "kettle"}
    assert again.colors == {3: (1.0, 0.5, 0.0)}
    assert again.folders == scene.folders
    assert project.model_path.parent == tmp_path / "out"
    for group in range(1, 6):
        before, after = group_indices(scene, group), group_indices(again, group)
        assert len(before) == len(after)
        far = np.abs(scene.gaussians.means[before] - again.gaussians.means[after])
        assert far.max() <= (0 if form is SplatFormat.PLY else 1e-3)
    saved = save_project(project, tmp_path / "saved.gaga")
    assert_same(again, opened(saved).scene)


def test_opening_tells_one_share_that_goes_on(scene: Scene, tmp_path: Path) -> None:
    """Each file began again at 0, and the time left was said to be a second."""
    run_stage(export_objects_stage(scene, tmp_path, form=SplatFormat.SOG))
    words: list[Progress] = []
    run_stage(open_path_stage(tmp_path), words.append)
    reads = [word for word in words if word.stage == READS_OBJECTS]
    assert not [word for word in words if word.stage == READS]
    shares = [word.done / word.total for word in reads]
    assert shares == sorted(shares)
    assert len(set(shares)) > 5, "within a file, too"


def test_some_objects_have_only_their_folders(scene: Scene, tmp_path: Path) -> None:
    run_stage(export_objects_stage(scene, tmp_path, (1, 4)))
    assert opened(tmp_path).scene.folders.paths == ("Kitchen", "Kitchen/Cups")
    assert opened(tmp_path).scene.folders.home == {1: "Kitchen", 4: "Kitchen/Cups"}


def test_an_object_without_what_it_lies_under_lies_under_the_next_one(
    scene: Scene, tmp_path: Path
) -> None:
    run_stage(export_objects_stage(scene, tmp_path / "a", (1, 3)))
    assert opened(tmp_path / "a").scene.folders == Folders(("Kitchen",), {3: "Kitchen"}, {1: 3})
    run_stage(export_objects_stage(scene, tmp_path / "b", (1, 2)))
    assert opened(tmp_path / "b").scene.folders == Folders(
        ("Kitchen",), {1: "Kitchen", 2: "Kitchen"}
    )


def test_a_manifest_of_an_older_version_has_no_folders(scene: Scene, tmp_path: Path) -> None:
    manifest = run_stage(export_objects_stage(scene, tmp_path))
    content = json.loads(manifest.read_text())
    for entry in content["groups"]:
        del entry["folder"], entry["parent"], entry["oriented_box"]
    manifest.write_text(json.dumps(content))
    again = opened(manifest).scene
    assert again.folders == Folders()
    usual = group_colors(np.array([2], np.int32))[0]
    assert 2 not in again.colors
    np.testing.assert_allclose(content["groups"][1]["color"], usual, atol=1e-3)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"groups": []}, "names no objects"),
        ({"groups": 3}, "damaged"),
        ({"id": 0}, "damaged"),
        ({"id": 1 << 40}, "damaged"),
        ({"parent": 1}, "lies under itself"),
        ({"file": "none.ply"}, "is gone"),
        ({"form": "mesh"}, "no splats"),
        ({"form": "html"}, "no splats"),
    ],
)
def test_a_damaged_manifest_is_one_sentence(
    scene: Scene, tmp_path: Path, change: dict[str, object], sentence: str
) -> None:
    manifest = run_stage(export_objects_stage(scene, tmp_path, (1, 2)))
    content = json.loads(manifest.read_text())
    if "groups" in change or "form" in change:
        content |= change
    else:
        content["groups"][0] |= change
    manifest.write_text(json.dumps(content))
    with pytest.raises(GagaError, match=sentence):
        opened(manifest)
