"""Running what is missing in a scene folder: each stage once, and again when its source changed."""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.cli.main import main
from gaga_core.errors import GagaError
from gaga_core.grouping.associate import AssociateConfig
from gaga_core.grouping.bank_file import load_bank, save_bank
from gaga_core.io.folder.scene_folder import SceneFolder, open_scene_folder, read_model
from gaga_core.io.masks.label_maps import read_labels, write_labels
from gaga_core.pipeline import run
from gaga_core.pipeline.associate import associate_scene
from gaga_core.pipeline.lift import lift_scene, read_identity
from gaga_core.pipeline.render import render_views
from gaga_core.pipeline.run import (
    JOIN,
    RunConfig,
    SceneStage,
    Work,
    missing_stages,
    run_folder,
    run_missing,
)
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.progress import Progress, Stage, run_stage
from tests.core.placing.photo_scenes import write_photos
from tests.core.segmentation.fake_provider import Quarters
from tests.made import contents, write_true_scene
from tests.scenes import objects_scene


@pytest.fixture
def folder(tmp_path: Path) -> SceneFolder:
    """A scene folder of 5 views, 4 of them for training, with perfect masks and no results."""
    scene = objects_scene(n_objects=3, per_object=120, n_cameras=5)
    write_true_scene(tmp_path / "scene", scene, test=(4,))
    return open_scene_folder(tmp_path / "scene")


def test_each_stage_runs_once(folder: SceneFolder) -> None:
    everything = ("associate", "lift", "render")
    assert missing_stages(folder) == everything
    assert run_stage(run_missing(folder)) == everything
    before = contents(folder.root)
    assert run_stage(run_missing(folder)) == ()
    assert contents(folder.root) == before
    (folder.work / "renders" / "groups" / f"{Path(folder.test[0]).stem}.png").unlink()
    assert run_stage(run_missing(folder)) == ("render",)
    (folder.work / "identity.npz").unlink()
    assert run_stage(run_missing(folder)) == ("lift",)
    after = contents(folder.root)
    assert {name for name in before if after.get(name) != before[name]} <= {"gaga/report.json"}


def test_new_groups_make_encodings_and_pictures_anew(folder: SceneFolder) -> None:
    run_stage(run_missing(folder))
    run_stage(associate_scene(folder))
    for path in (folder.work / "identity.npz", *folder.work.rglob("renders/groups/*.png")):
        os.utime(path, (1e9, 1e9))  # clocks of file systems are coarse
    assert missing_stages(folder) == ("lift", "render")


def test_masks_of_new_views_join_the_groups(folder: SceneFolder) -> None:
    """Not all over again: what was decided stays, and the report says what was done."""
    masks, new = folder.root / "masks" / "sim", folder.train[-1]
    held = (masks / new).read_bytes()
    (masks / new).unlink()
    run_stage(run_missing(folder))
    before = load_bank(folder.work / "bank.npz")
    write_labels(masks / new, np.zeros((48, 64), np.int32))
    assert missing_stages(folder) == ()  # a view without any mask has nothing to join
    (masks / new).write_bytes(held)
    assert missing_stages(folder) == ("associate", "lift", "render")
    assert run_stage(run_missing(folder)) == (JOIN, "lift", "render")
    report = json.loads((folder.work / "report.json").read_text())
    assert report["associate"]["notes"] == ["Views that were added: 1, to 3 before."]
    after = load_bank(folder.work / "bank.npz")
    assert after.log[: len(before.log)] == before.log
    assert {decision.view for decision in after.log} == set(folder.train)
    assert missing_stages(folder) == ()
    # Groups of the other preset are made of all views again.
    (folder.work / "masks" / new).unlink()
    save_bank(folder.work / "bank.npz", before)
    wanted = RunConfig(associate=AssociateConfig.of("paper"), keeps_groups=False)
    assert run._can_join(Work(folder, RunConfig()))
    assert not run._can_join(Work(folder, wanted))


def test_a_stage_that_is_to_run_takes_those_that_need_it_along(
    folder: SceneFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stage before all others, whose result the later ones find: how stages are added."""
    run_stage(run_missing(folder))
    later = folder.root / "masks" / "new"

    def segment(work: Work) -> Stage[object]:
        yield Progress("Segment", 0, 1)
        return (work.folder.root / "masks" / "sim").rename(later)

    added = SceneStage("masks", (), lambda _: later.is_dir(), segment)
    place = [stage.name for stage in run.STAGES].index("associate")
    before, after = run.STAGES[: place - 1], run.STAGES[place + 1 :]
    first = replace(run.STAGES[place], needs=("masks",))
    monkeypatch.setattr(run, "STAGES", (*before, added, first, *after))
    assert run_stage(run_missing(folder)) == ("masks", "associate", "lift", "render")
    report = json.loads((folder.work / "report.json").read_text())
    assert report["associate"]["mask_folder"] == "masks/new"
    assert missing_stages(folder) == ()


def test_a_stage_that_fails_leaves_what_came_before(folder: SceneFolder) -> None:
    stage = run_missing(folder)
    for progress in stage:
        if progress.stage.startswith("Render"):
            break
    stage.close()
    assert missing_stages(folder) == ("render",)
    for path in folder.mask_folders.values():
        path.rename(folder.root / "elsewhere")
    (folder.work / "labels.npz").unlink()
    with pytest.raises(GagaError, match="no masks and no photos"):
        run_stage(run_missing(open_scene_folder(folder.root)))


def test_identities_are_drawn_as_groups_are(folder: SceneFolder, tmp_path: Path) -> None:
    """The closed form decodes to the label map but for pixels where two groups weigh the same."""
    with pytest.raises(GagaError, match="Lift the groups first"):
        run_stage(render_views(folder, what="identity"))
    run_stage(associate_scene(folder))
    run_stage(lift_scene(folder, "vote"))
    decoded = run_stage(render_views(folder, what="identity", views="all"))
    assert [path.parent for path in decoded] == [folder.work / "renders" / "identity"] * 5
    splatted = run_stage(render_views(folder, tmp_path / "groups", views="all"))
    n = len(run_stage(read_model(folder)))
    n_groups = read_identity(folder, n).field.n_groups
    for one, other in zip(decoded, splatted, strict=True):
        ids = read_labels(one)
        assert (ids == read_labels(other)).mean() > 0.97
        assert 0 < ids.max() <= n_groups


# --- From photos to objects by one command: what is missing is made, what is there stays.


TINY = ("--iterations", "30", "--max-side", "96")
ALL = ["reconstruct", "masks", "associate", "lift", "render"]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that ``gaga run PHOTOS`` made of eight photos, next to them."""
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
