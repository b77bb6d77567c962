"""Stages over a scene folder: what they write, and that they write it whole or not at all."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaga_core.cli.main import main
from gaga_core.errors import GagaError
from gaga_core.evaluate.group_scores import Score, score_pairs
from gaga_core.grouping.associate import AssociateConfig
from gaga_core.grouping.bank_file import load_bank, read_groups
from gaga_core.io.folder.scene_folder import (
    SceneFolder,
    mask_path_of,
    open_scene_folder,
    select_views,
)
from gaga_core.io.images import write_rgb
from gaga_core.io.masks.label_maps import RECORD, read_labels, write_labels
from gaga_core.pipeline.associate import associate_scene, associated_masks, views_to_add
from gaga_core.pipeline.render import render_views
from gaga_core.pipeline.run import RunConfig, missing_stages
from gaga_core.progress import run_stage
from tests.made import contents, write_true_scene
from tests.scenes import objects_scene


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene folder of 8 views, 6 of them for training, with perfect masks."""
    root = tmp_path_factory.mktemp("made")
    scene = objects_scene(n_objects=4, per_object=200, n_cameras=8)
    write_true_scene(root, scene, test=(3, 7))
    for camera in scene.cameras:
        write_rgb(root / "images" / camera.name, np.zeros((120, 160, 3), np.uint8))
    return root


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> SceneFolder:
    """A copy of the scene to write into."""
    return open_scene_folder(shutil.copytree(made, tmp_path / "scene"))


def test_the_report_names_the_mask_ids_of_the_first_view(folder: SceneFolder) -> None:
    """Groups are counted from 1; the paper calls those of the first view by their masks' ids."""
    for path in (folder.root / "masks").glob("*/*.png"):
        labels = read_labels(path)
        write_labels(path, np.where(labels > 0, 7 * labels + 35, 0).astype(np.int32))
    for preset in ("paper", "released", "robust"):
        bank = run_stage(associate_scene(folder, config=AssociateConfig.of(preset))).bank
        saved = load_bank(folder.work / "bank.npz")
        assert (saved.preset, saved.log) == (preset, bank.log)
        assert np.array_equal(saved.shared, bank.shared)
        entry = json.loads((folder.work / "report.json").read_text())["associate"]
        first = [d for d in bank.log if d.view == folder.train[0] and d.group]
        named = {str(d.group): d.mask for d in first} if preset != "robust" else {}
        assert entry["first_view"] == named
        assert all(mask >= 42 for mask in named.values())


def test_associate_writes_bank_labels_and_pseudo_labels(folder: SceneFolder) -> None:
    result = run_stage(associate_scene(folder))
    bank = load_bank(folder.work / "bank.npz")
    assert bank.log == result.bank.log
    assert (bank.group == result.bank.group).all()
    labels, confidence = read_groups(folder, len(result.labels))
    assert (labels == result.labels).all()
    assert (confidence == result.confidence).all()
    assert sorted(p.stem for p in (folder.work / "masks").iterdir()) == sorted(
        Path(name).stem for name in folder.train
    )
    name = folder.train[2]
    written = read_labels(folder.work / "masks" / name)
    masks = read_labels(folder.root / "masks/sim" / name)
    assert (written == result.mask_groups[name][masks]).all()
    report = json.loads((folder.work / "report.json").read_text())
    assert report["associate"]["groups"] == result.bank.n_groups == 5
    assert not list(folder.work.glob(".*"))


def test_regions_become_objects_with_levels_and_masks_of_models_do_not(
    folder: SceneFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    robust = AssociateConfig.of("robust")
    assert run_stage(associate_scene(folder, config=robust)).bank.levels is None
    noted = run_stage(associate_scene(folder, config=robust.at_detail(0.2))).notes
    assert any("detail has no effect" in note for note in noted)
    record = folder.root / "masks" / "sim" / RECORD
    record.write_text(json.dumps({"provider": "regions", "views": {}}), encoding="utf-8")
    assert main(["associate", str(folder.root), "--detail", "0", "--json"]) == 0
    levels = load_bank(folder.work / "bank.npz").levels
    assert levels is not None
    assert levels.chosen == 0
    labels, _ = read_groups(folder, levels.labels.shape[1])
    assert np.array_equal(labels, levels.labels[0])
    assert json.loads(capsys.readouterr().out)["groups"] == labels.max()
    record.write_text(json.dumps({"provider": "sam2", "views": {}}), encoding="utf-8")
    assert run_stage(associate_scene(folder, config=robust)).bank.levels is None


def test_new_views_join_by_the_same_settings_and_of_the_same_masks(
    folder: SceneFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    """The preset is that of the groups, and switches that are given count."""
    masks, last = folder.root / "masks" / "sim", folder.train[-2:]
    held = {name: (masks / name).read_bytes() for name in last}
    for name in last:
        (masks / name).unlink()
    command, strict = ["associate", str(folder.root)], ["--threshold", "0.95"]
    assert main([*command, "--add"]) == 1
    assert "no groups" in capsys.readouterr().err
    assert main([*command, "--preset", "paper", *strict]) == 0
    for name in last:
        (masks / name).write_bytes(held[name])
    shutil.copytree(masks, masks.with_name("other"))
    assert main([*command, "--add", "--masks", "other"]) == 1
    assert "made from the masks in" in capsys.readouterr().err
    assert main([*command, "--add", "--masks", "sim", *strict]) == 0
    added = load_bank(folder.work / "bank.npz")
    assert main([*command, "--preset", "paper", "--masks", "sim", *strict]) == 0
    whole = load_bank(folder.work / "bank.npz")
    assert {decision.view for decision in whole.log} == set(folder.train)
    assert added.log == whole.log
    assert np.array_equal(added.group, whole.group)


def test_masks_of_another_place_with_the_same_name_are_others(
    folder: SceneFolder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """New views of the scene's own masks joined groups that were made of a folder elsewhere."""
    elsewhere, command = tmp_path / "sim", ["associate", str(folder.root)]
    shutil.copytree(folder.root / "masks" / "sim", elsewhere)
    (elsewhere / folder.train[-1]).unlink()
    assert main([*command, "--preset", "paper", "--masks", str(elsewhere)]) == 0
    assert associated_masks(folder) == elsewhere.resolve()
    assert views_to_add(folder) == ()
    assert main([*command, "--add", "--masks", "sim"]) == 1
    assert "made from the masks in" in capsys.readouterr().err
    named = RunConfig(masks_from="sim", keeps_groups=True)
    assert "associate" in missing_stages(folder, named)
    assert main([*command, "--preset", "paper", "--masks", "sim"]) == 0
    assert "associate" not in missing_stages(folder, named)
    copied = open_scene_folder(shutil.copytree(folder.root, tmp_path / "copied"))
    assert associated_masks(copied) == copied.root / "masks" / "sim"
    report = copied.work / "report.json"
    told = json.loads(report.read_text("utf-8"))
    told["associate"]["mask_folder"] = "a" * 5000  # longer than any name: no folder, no error
    report.write_text(json.dumps(told), "utf-8")
    assert associated_masks(copied) is None


def test_a_detail_needs_levels_and_a_number_in_range() -> None:
    with pytest.raises(GagaError, match="no levels"):
        AssociateConfig.of("paper").at_detail(0.5)
    with pytest.raises(GagaError, match="between 0 and 1"):
        AssociateConfig.of("robust").at_detail(1.5)
    assert AssociateConfig.of("paper").at_detail(None) == AssociateConfig.of("paper")


def test_groups_of_test_views_match_the_truth(folder: SceneFolder, tmp_path: Path) -> None:
    run_stage(associate_scene(folder))
    files = run_stage(render_views(folder, tmp_path / "out"))
    assert [path.name for path in files] == [f"{Path(n).stem}.png" for n in folder.test]
    with Image.open(files[0]) as picture:
        assert picture.mode in ("I;16", "I")
    _, score = _scores(folder, files)
    assert score.iou > 0.85
    assert score.recall == 1.0


def test_more_than_255_groups_survive_the_files(folder: SceneFolder) -> None:
    ids = np.array([[0, 1, 255, 256], [257, 300, 511, 65535]], np.int32)
    write_labels(folder.root / "wide.png", ids)
    assert (read_labels(folder.root / "wide.png") == ids).all()
    n = 400  # groups; the last one is what every splat gets
    folder.work.mkdir()
    run_stage(associate_scene(folder))
    labels, confidence = read_groups(folder, 1400)
    np.savez(
        folder.work / "labels.npz",
        labels=np.where(labels > 0, labels + n, 0).astype(np.int32),
        confidence=confidence,
    )
    files = run_stage(render_views(folder))
    assert read_labels(files[0]).max() > n


def test_cancelled_association_leaves_the_folder_untouched(folder: SceneFolder) -> None:
    before = contents(folder.root)
    for steps in (1, 4, 9, 14, 17):
        stage = associate_scene(folder)
        for _ in range(steps):
            next(stage)
        stage.close()
        assert contents(folder.root) == before


def test_cancelled_association_keeps_the_former_result(folder: SceneFolder) -> None:
    run_stage(associate_scene(folder))
    before = contents(folder.root)
    stage = associate_scene(folder, config=AssociateConfig(threshold=0.9))
    for step in stage:
        if step.stage == "Write label maps":
            break
    stage.close()
    assert contents(folder.root) == before


def test_cancelled_render_leaves_nothing(folder: SceneFolder, tmp_path: Path) -> None:
    stage = render_views(folder, tmp_path / "deep" / "out", what="rgb", views="all")
    for _ in range(4):
        next(stage)
    stage.close()
    assert not (tmp_path / "deep").exists()


def test_render_depth_and_rgb(folder: SceneFolder, tmp_path: Path) -> None:
    (depth,) = run_stage(render_views(folder, tmp_path / "d", what="depth", views="000"))
    values = read_labels(depth)
    assert 2500 < np.median(values[values > 0]) < 4500
    (rgb,) = run_stage(render_views(folder, tmp_path / "c", what="rgb", views=("000.png",)))
    with Image.open(rgb) as picture:
        assert (picture.mode, picture.size) == ("RGB", (160, 120))


def test_views_by_word_and_by_name(folder: SceneFolder) -> None:
    assert [c.name for c in select_views(folder, "test")] == list(folder.test)
    assert select_views(folder, ("train",)) == select_views(folder, "train")
    assert len(select_views(folder, "all")) == 8
    assert [c.name for c in select_views(folder, "002,005.png")] == ["002.png", "005.png"]
    with pytest.raises(GagaError, match="no view 99"):
        select_views(folder, ["002", "99"])


def test_plain_sentences(folder: SceneFolder, tmp_path: Path) -> None:
    with pytest.raises(GagaError, match="no mask folder sam"):
        mask_path_of(folder, "sam")
    with pytest.raises(GagaError, match="There are no groups"):
        run_stage(render_views(folder))
    with pytest.raises(GagaError, match="nothing called 'normals'"):
        run_stage(render_views(folder, what="normals"))  # type: ignore[arg-type]
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(GagaError, match=r"None of the 6 photos has masks|no masks"):
        run_stage(associate_scene(folder, empty))
    (folder.root / "point_cloud.ply").unlink()
    with pytest.raises(GagaError, match="no model"):
        run_stage(associate_scene(open_scene_folder(folder.root)))


def test_groups_of_another_model_are_refused(folder: SceneFolder) -> None:
    run_stage(associate_scene(folder))
    with pytest.raises(GagaError, match=r"another model .1,400 splats, not 7"):
        read_groups(folder, 7)
    (folder.work / "labels.npz").write_bytes(b"no zip")
    with pytest.raises(GagaError, match="damaged"):
        read_groups(folder, 1400)


@pytest.mark.slow
@pytest.mark.parametrize(("preset", "precision"), [("paper", 0.88), ("robust", 0.94)])
def test_ycb_table_reaches_the_bar(
    preset: str, precision: float, ycb_table: Path, tmp_path: Path
) -> None:
    """Held-out views, void left out, of every second training view: measured IoU 0.948, recall 1.0
    by both presets.

    Precision 0.94 by paper and 1.0 by robust.
    """
    folder = _beside(open_scene_folder(ycb_table), tmp_path)
    folder = replace(folder, train=folder.train[::2])
    run_stage(associate_scene(folder, "sim", AssociateConfig.of(preset)))
    files = run_stage(render_views(folder, tmp_path / "out"))
    with_void, without_void = _scores(replace(folder, root=ycb_table), files)
    assert without_void.iou >= 0.93
    assert without_void.precision >= precision
    assert without_void.recall == 1.0
    assert with_void.iou >= 0.93
    assert with_void.recall == 1.0


def _scores(folder: SceneFolder, files: Sequence[Path]) -> tuple[Score, Score]:
    """Scores of label maps against gt/instance: with void, and with void left out."""
    truth = folder.root / "gt" / "instance"
    return score_pairs([(read_labels(truth / path.name), read_labels(path)) for path in files])


def _beside(folder: SceneFolder, work: Path) -> SceneFolder:
    """The same scene with its results elsewhere: real data stays as it is."""
    return replace(folder, root=work)


def test_several_mask_folders_have_to_be_chosen_from(folder: SceneFolder) -> None:
    assert mask_path_of(folder, None) == folder.root / "masks" / "sim"
    (folder.root / "masks" / "other").mkdir()
    write_labels(folder.root / "masks" / "other" / "000.png", np.ones((4, 4), np.int32))
    both = open_scene_folder(folder.root)
    with pytest.raises(GagaError, match="several mask folders: other, sim"):
        mask_path_of(both, None)
    assert mask_path_of(both, "sim") == folder.root / "masks" / "sim"
