"""From photos to objects by one command: what is missing is made, what is there stays."""

import json
import shutil
from pathlib import Path

import pytest

from gaga_core.cli.main import main
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.pipeline import run
from gaga_core.pipeline.run import RunConfig, missing_stages, run_folder
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.progress import run_stage
from tests.core.placing.photo_scenes import write_photos
from tests.core.segmentation.fake_provider import Quarters

TINY = ("--iterations", "30", "--max-side", "96")
ALL = ["reconstruct", "masks", "associate", "lift", "render"]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that ``gaga run PHOTOS`` made of eight photos, beside them."""
    photos = tmp_path_factory.mktemp("walk") / "shots"
    write_photos(photos, 8)
    run_stage(run_folder(photos.with_name("shots-scene"), RunConfig(_tiny()), photos=photos))
    return photos.with_name("shots-scene")


@pytest.fixture
def quick_masks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Regions take seconds a photo; here four quarters stand for them."""
    monkeypatch.setattr(run, "provider_named", lambda name: Quarters(name=name))


def _tiny() -> ReconstructConfig:
    return ReconstructConfig(iterations=30, max_side=96)


def test_photos_become_groups_in_one_command(
    made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = open_scene_folder(made)
    assert len(folder.cameras) == 8
    assert {path.stem for path in (made / "masks/regions").glob("*.png")} == {
        Path(name).stem for name in folder.train
    }
    assert (made / "gaga" / "identity.npz").is_file()
    pictures = sorted((made / "gaga" / "renders" / "groups").glob("*.png"))
    assert [path.stem for path in pictures] == [Path(name).stem for name in folder.test]
    assert any(read_labels(path).max() > 0 for path in pictures)
    assert missing_stages(folder) == ()
    photos = made.with_name("shots")
    assert len(list(photos.iterdir())) == 8, "the photos are left as they were"
    assert main(["run", str(photos), "--json", *TINY]) == 0  # again: nothing to do
    said = json.loads(capsys.readouterr().out)
    assert said["stages_run"] == []
    assert said["scene"] == str(made)
    assert said["groups"] > 0


@pytest.mark.usefixtures("quick_masks")
def test_each_missing_part_is_made_alone(made: Path, tmp_path: Path) -> None:
    scene = tmp_path / "scene"
    shutil.copytree(made, scene)
    photos = {p: p.stat().st_mtime_ns for p in (scene / "images").iterdir()}
    (scene / "masks").rename(tmp_path / "masks")
    assert missing_stages(open_scene_folder(scene)) == ()  # it has its groups
    for path in (scene / "gaga").glob("*.npz"):
        path.unlink()
    assert missing_stages(open_scene_folder(scene)) == tuple(ALL[1:])
    assert missing_stages(open_scene_folder(scene), RunConfig(masks=tmp_path)) == tuple(ALL[2:])
    assert run_stage(run_folder(scene)) == tuple(ALL[1:])
    assert photos == {p: p.stat().st_mtime_ns for p in (scene / "images").iterdir()}


def test_half_of_the_masks_are_none(made: Path, tmp_path: Path) -> None:
    """A run that was stopped in the middle of the masks goes on there."""
    scene = tmp_path / "scene"
    shutil.copytree(made, scene)
    shutil.rmtree(scene / "gaga")
    masks = sorted((scene / "masks/regions").glob("*.png"))
    before = {path: path.stat().st_mtime_ns for path in masks[1:]}
    masks[0].unlink()
    assert missing_stages(open_scene_folder(scene))[0] == "masks"
    run_stage(run_folder(scene))
    assert masks[0].is_file()
    assert before == {path: path.stat().st_mtime_ns for path in masks[1:]}


@pytest.mark.usefixtures("quick_masks")
def test_masks_of_the_user_are_not_made_again(made: Path, tmp_path: Path) -> None:
    scene = tmp_path / "scene"
    shutil.copytree(made, scene)
    shutil.rmtree(scene / "gaga")
    (scene / "masks/regions").rename(scene / "masks/mine")
    (scene / "masks/mine/provider.json").unlink()
    sorted((scene / "masks/mine").glob("*.png"))[0].unlink()
    assert run_stage(run_folder(scene)) == tuple(ALL[2:])
    assert not (scene / "masks/regions").exists()
    named = RunConfig(masks_from="regions")  # asked for by name: made, and associated instead
    assert run_stage(run_folder(scene, named)) == tuple(ALL[1:])
    report = json.loads((scene / "gaga/report.json").read_text())
    assert Path(report["associate"]["mask_folder"]).name == "regions"
    assert run_stage(run_folder(scene, named)) == ()
