"""``gaga align``: two scene folders of one place, from photos on disk to the similarity."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaga_core.io.files import assets
from gaga_core.io.splats.splat_files import read_splats, write_splats
from gaga_core.pipeline import align
from gaga_core.pipeline.settings import AlignConfig
from gaga_core.progress import Progress, run_stage
from gaga_core.scene.bake import bake
from gaga_core.scene.captures.alignment import difference
from gaga_core.scene.captures.by_photos import align_by_photos_stage
from gaga_core.scene.edits import transform
from gaga_core.scene.frame import inverse
from gaga_core.scene.scene import Scene
from tests.core.cli.calls import Capture, answer, refusal
from tests.core.scene.captures.scenes import (
    any_similarity,
    write_furnished,
    write_posed,
    write_scene,
)

pytestmark = pytest.mark.usefixtures("few_draws")


@pytest.fixture
def halves(tmp_path: Path) -> tuple[Path, Path, np.ndarray]:
    world = any_similarity(np.random.default_rng(3))
    write_scene(tmp_path / "a", 0)
    write_scene(tmp_path / "b", 1, world=world)
    return tmp_path / "a", tmp_path / "b", world


def test_two_halves_come_together(halves: tuple[Path, Path, np.ndarray], capsys: Capture) -> None:
    first, second, world = halves
    said = answer(capsys, "align", str(first), str(second))
    file = Path(str(said.pop("file")))
    assert file == first / "gaga" / "align-b.json"
    assert json.loads(file.read_text(encoding="utf-8")) == said
    found = said["alignment"]
    assert isinstance(found, dict)
    turn, scale = difference(inverse(world), np.array(found["first_from_second"]))
    assert np.degrees(turn) < 0.5
    assert scale < 0.005
    assert said["changes"] is None  # there are no splats
    assert sorted(p.name for p in first.iterdir()) == ["gaga", "images", "sparse"]


def test_no_step_is_named_for_photos_where_surfaces_are_matched(
    halves: tuple[Path, Path, np.ndarray], tmp_path: Path
) -> None:
    """The first one was "Look at photos" in scenes that have none."""
    first, second = (run_stage(align.open_capture_stage(path))[0] for path in halves[:2])
    steps: list[Progress] = []
    run_stage(align_by_photos_stage(first, second, tmp_path / "work", by="surfaces"), steps.append)
    names = list(dict.fromkeys(step.stage for step in steps))
    assert names[0] == "Look at the drawn surfaces"
    assert [name for name in names if "photo" in name] == []
    usual = align.usual_seconds(first, second, AlignConfig(by="surfaces"))
    assert [step for step in usual if step in names] == names, "each has its share of the bar"


def test_photos_that_another_program_placed_are_placed(tmp_path: Path, capsys: Capture) -> None:
    """Their poses lie next to them; nothing was made of them here."""
    world = any_similarity(np.random.default_rng(4))
    write_scene(tmp_path / "a", 0)
    write_posed(tmp_path / "b", 1, world=world, k1=0.3)
    in_scene, _ = run_stage(align.open_capture_stage(tmp_path / "b"))
    assert len(in_scene.cameras) == len(in_scene.lenses) == 4
    # A folder of photos, and no scene folder.
    second = (tmp_path / "b" / "images").rename(tmp_path / "walk")
    (tmp_path / "b" / "transforms.json").rename(second / "transforms.json")
    said = answer(capsys, "align", str(tmp_path / "a"), str(second))
    found = said["alignment"]
    assert isinstance(found, dict)
    turn, scale = difference(inverse(world), np.array(found["first_from_second"]))
    assert np.degrees(turn) < 0.5
    assert scale < 0.005
    (second / "transforms.json").unlink()
    assert "Make" in refusal(capsys, "align", str(tmp_path / "a"), str(second))


def test_what_moved_is_listed_and_both_are_written(tmp_path: Path, capsys: Capture) -> None:
    """Splats with groups: one ball moved, one went, one came, one stayed."""
    world = any_similarity(np.random.default_rng(5))
    first, second = write_furnished(tmp_path, world)
    target = tmp_path / "both.ply"
    said = answer(capsys, "align", str(first), str(second), "--write", str(target))
    changes = said["changes"]
    assert isinstance(changes, list)
    found = sorted((c["kind"], c["first_group"], c["second_group"]) for c in changes)
    assert found == [("came", None, 5), ("moved", 2, 2), ("went", 3, None)]
    both, a, b = (
        read_splats(p) for p in (target, *(f / "point_cloud.ply" for f in (first, second)))
    )
    assert len(both) == len(a) + len(b)
    back = inverse(world)
    expected = b.means @ back[:3, :3].T + back[:3, 3]
    np.testing.assert_allclose(both.means[len(a) :], expected, atol=0.03)


def test_lone_files_are_aligned_by_their_surfaces(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The demo's splats, and the same turned about the vertical, in smaller pictures;
    nobody asked what changed."""
    monkeypatch.setattr(align, "_SIDE", 240)
    files, world = (tmp_path / "a.ply", tmp_path / "b.ply"), np.eye(4)
    world[:3, :3] = 1.7 * Rotation.from_euler("z", 35, degrees=True).as_matrix()
    world[:3, 3] = 0.5, -1, 2
    scene = Scene.of(read_splats(assets() / "demo" / "point_cloud.sog"))
    write_splats(files[0], bake(scene))
    edit = transform(scene, np.arange(len(scene)), world[:3])
    assert edit is not None
    edit.apply(scene)
    write_splats(files[1], bake(scene))
    said = answer(capsys, "align", *map(str, files), "--no-changes")
    found = said["alignment"]
    assert isinstance(found, dict)
    turn, scale = difference(inverse(world), np.array(found["first_from_second"]))
    assert np.degrees(turn) < 0.5
    assert scale < 0.005
    assert (found["by"], found["pixels"], said["changes"]) == ("surfaces", None, None)
    assert Path(str(said["file"])) == tmp_path / "a-align-b.json"


def test_scenes_of_other_places_are_refused_in_words(tmp_path: Path, capsys: Capture) -> None:
    write_scene(tmp_path / "a", 0)
    write_scene(tmp_path / "b", 1, seed=1)
    said = refusal(capsys, "align", str(tmp_path / "a"), str(tmp_path / "b"))
    assert "place it by hand" in said
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["images", "sparse"]
