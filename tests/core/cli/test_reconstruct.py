"""The command that makes scenes of photos, and the one that runs many scenes."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from gaga_core.cli.main import main
from gaga_core.io.folder.scene_folder import World, known_world, open_scene_folder, write_world
from gaga_core.pipeline.reconstruct import reconstruct_scene, set_groups_aside
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.progress import run_stage
from tests.core.cli.calls import answer, refusal
from tests.core.conftest import PlacedRoom

Capture = pytest.CaptureFixture[str]
_SHORT = ReconstructConfig(iterations=120, max_side=64, max_splats=1000)
_ONLY_PLACED = replace(_SHORT, only="sfm")


@pytest.fixture(scope="module")
def placed(placed_room: PlacedRoom, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene folder of placed photos without splats; tests copy it."""
    scene = tmp_path_factory.mktemp("placed") / "scene"
    run_stage(reconstruct_scene(placed_room.workspace.parent / "in", scene, _ONLY_PLACED))
    return scene


def test_photos_are_placed_and_counted(
    placed_room: PlacedRoom, tmp_path: Path, capsys: Capture
) -> None:
    photos, scene = placed_room.workspace.parent / "in", tmp_path / "scene"
    source = tmp_path / "photos"
    shutil.copytree(photos, source)
    (source / "broken.jpg").write_text("no picture")
    assert main(["reconstruct", str(source), str(scene), "--only", "sfm", "--json"]) == 0
    captured = capsys.readouterr()
    values = json.loads(captured.out)
    assert values["stages_run"] == ["sfm"]
    assert values["sfm"]["registered"] == 8
    assert "broken.jpg" in captured.err
    assert len(open_scene_folder(scene).cameras) == 8
    again = answer(capsys, "reconstruct", str(source), str(scene), "--only", "sfm")
    assert again["stages_run"] == []
    short = ("--iterations", "120", "--max-side", "64", "--max-splats", "1000")
    trained = answer(capsys, "reconstruct", str(source), str(scene), *short, "--strategy", "mcmc")
    assert trained["stages_run"] == ["train"]
    figures = trained["train"]
    assert isinstance(figures, dict)
    assert figures["splats"] <= 1000


def test_a_stopped_training_goes_on_to_the_splats_of_a_whole_one(
    placed_room: PlacedRoom, placed: Path, tmp_path: Path, capsys: Capture
) -> None:
    photos, config = placed_room.workspace.parent / "in", _SHORT
    stopped, whole = tmp_path / "stopped", tmp_path / "whole"
    shutil.copytree(placed, stopped)
    assert "nothing to go on with" in refusal(
        capsys, "reconstruct", str(photos), str(stopped), "--go-on"
    )
    shutil.copytree(stopped, whole)
    stage = reconstruct_scene(None, stopped, config)
    for step in stage:
        if step.stage == "Train splats" and step.done > 40:
            break
    stage.close()
    assert not (stopped / "point_cloud.ply").exists()
    for groups in ("first", "second"):  # of splats that were kept before
        (stopped / "gaga" / "labels.npz").write_text(groups)
        set_groups_aside(stopped)
    kept = [stopped / name / "labels.npz" for name in ("gaga-before", "gaga-before-2")]
    assert [path.read_text() for path in kept] == ["first", "second"]
    went_on = answer(capsys, "run", str(stopped), "--go-on")
    assert went_on["stages_run"] == ["masks", "associate", "lift", "render"]
    run_stage(reconstruct_scene(None, whole, config))
    files = [(folder / "point_cloud.ply").read_bytes() for folder in (stopped, whole)]
    assert files[0] == files[1]


def test_what_is_known_of_the_photos_stays_when_splats_are_replaced(
    placed: Path, tmp_path: Path
) -> None:
    """What the first splats find goes aside with the second ones; the poses are those of before."""
    scene = tmp_path / "scene"
    shutil.copytree(placed, scene)
    write_world(scene, World(is_metric=True, up=(0, 0, 1), program="transforms.json"))
    of_photos = {"report.json", "world.json", "cache/masks/key.png"}
    of_splats = {"labels.npz", "bank.npz", "masks/0.png", "lod/tree.npz", "align-b.json"}

    def files(name: str) -> set[str]:
        root = scene / name
        return {p.relative_to(root).as_posix() for p in root.rglob("*") if p.is_file()}

    for name in (of_photos | of_splats) - {"report.json", "world.json"}:
        (scene / "gaga" / name).parent.mkdir(exist_ok=True, parents=True)
        (scene / "gaga" / name).write_text(name)
    run_stage(reconstruct_scene(None, scene, _SHORT))
    assert files("gaga") == of_photos | of_splats, "there were no splats before"
    assert not (scene / "gaga-before").exists()
    run_stage(reconstruct_scene(None, scene, _SHORT, again=True))
    assert (files("gaga"), files("gaga-before")) == (of_photos, of_splats)
    assert known_world(scene) == (True, (0, 0, 1))


def test_bad_input_is_one_sentence(tmp_path: Path, capsys: Capture) -> None:
    scene = str(tmp_path / "scene")
    assert "Check the path" in refusal(capsys, "reconstruct", str(tmp_path / "none"), scene)
    (tmp_path / "empty").mkdir()
    assert "0 usable photos" in refusal(capsys, "reconstruct", str(tmp_path / "empty"), scene)
    assert "--focal" in refusal(capsys, "reconstruct", str(tmp_path), scene, "--focal", "-3")
    video = tmp_path / "walk.mp4"
    video.write_text("no video")
    assert "cannot be read as a video" in refusal(capsys, "reconstruct", str(video), scene)
    assert not Path(scene).exists()


def test_a_folder_without_scenes_is_told(tmp_path: Path, capsys: Capture) -> None:
    alone = ("run", str(tmp_path))
    assert "--masks and --masks-from" in refusal(
        capsys, *alone, "--masks", "a", "--masks-from", "regions"
    )
    assert "--to are for one scene" in refusal(capsys, *alone, "--to", "a", "--executor", "local")
    said = refusal(capsys, "run", str(tmp_path), "--executor", "local")
    assert "no scene folders" in said
    assert "--workers" in refusal(
        capsys, "run", str(tmp_path), "--executor", "local", "--workers", "0"
    )
