"""The stage over a scene folder: what it writes, that it writes it whole or not at all."""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.errors import GagaError
from gaga_core.evaluate.group_scores import Score, score_pairs
from gaga_core.grouping.associate import AssociateConfig, associate_stage
from gaga_core.grouping.bank_file import read_groups
from gaga_core.grouping.votes import splat_groups
from gaga_core.identity.closed_form import Voted, vote_identity
from gaga_core.identity.field import encoding_colors
from gaga_core.identity.lift import LiftConfig, Mode
from gaga_core.identity.rows import RowConfig
from gaga_core.identity.train import FILE as CHECKPOINT
from gaga_core.identity.train import PaperConfig, RefineConfig
from gaga_core.io.folder.scene_folder import (
    SceneFolder,
    open_scene_folder,
    read_model,
    select_views,
)
from gaga_core.io.images import read_rgb
from gaga_core.io.masks.label_maps import mask_folder, read_labels, write_labels
from gaga_core.pipeline.associate import associate_scene
from gaga_core.pipeline.lift import (
    decode_groups,
    lift_scene,
    read_identity,
)
from gaga_core.pipeline.render import render_views
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.scene.project import open_path_stage
from tests.made import contents, write_true_scene
from tests.scenes import objects_scene

_ROWS = RowConfig(per_view=1000)
_SMALL = LiftConfig(
    refine=RefineConfig(rows=_ROWS, steps=10),
    paper=PaperConfig(iterations=30, rows=_ROWS, reg_samples=100, checkpoint_every=10),
)
_MODES: tuple[Mode, ...] = ("vote", "refine", "paper")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene folder of 6 views with perfect masks, associated."""
    root = tmp_path_factory.mktemp("made") / "scene"
    write_true_scene(root, objects_scene(n_objects=4, per_object=150, n_cameras=6), test=(5,))
    run_stage(associate_scene(open_scene_folder(root)))
    return root


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> SceneFolder:
    """A copy of the scene to write into."""
    return open_scene_folder(shutil.copytree(made, tmp_path / "scene"))


@pytest.mark.parametrize("mode", _MODES)
def test_lift_writes_identities_and_a_report(folder: SceneFolder, mode: Mode) -> None:
    before = contents(folder.root)
    report = run_stage(lift_scene(folder, mode, _SMALL))
    after = contents(folder.root)
    changed = {name for name in after if after[name] != before.get(name)}
    assert changed == {"gaga/identity.npz", "gaga/report.json"}
    gaussians = run_stage(read_model(folder))
    identity = read_identity(folder, len(gaussians))
    assert identity.mode == report.mode == mode
    assert np.array_equal(identity.labels, identity.field.labels())
    assert report.groups == identity.field.n_groups == 5
    assert report.labelled == (identity.labels > 0).sum() > 0.9 * len(gaussians)
    entries = json.loads((folder.work / "report.json").read_text())
    assert "associate" in entries
    assert entries["lift"] == json.loads(json.dumps(report.to_json())) | {
        "config": entries["lift"]["config"]
    }
    assert entries["lift"]["rows"] > 0
    assert ("steps" in entries["lift"]) == (mode != "vote")


def test_vote_keeps_the_associations_labels(folder: SceneFolder) -> None:
    run_stage(lift_scene(folder, "vote"))
    gaussians = run_stage(read_model(folder))
    labels, confidence = read_groups(folder, len(gaussians))
    identity = read_identity(folder, len(gaussians))
    voted = confidence > 0
    assert np.array_equal(identity.labels[voted], labels[voted])
    camera = select_views(folder, "test")[0]
    decoded = decode_groups(choose(), gaussians, camera, identity.field)
    shown = splat_groups(choose(), gaussians, camera, identity.labels)
    assert (decoded == shown).mean() > 0.97


@pytest.mark.parametrize("mode", ["vote", "refine"])
def test_a_cancelled_lift_leaves_the_folder_untouched(folder: SceneFolder, mode: Mode) -> None:
    steps = sum(1 for _ in lift_scene(folder, mode, _SMALL))
    shutil.rmtree(folder.work)
    run_stage(associate_scene(folder))
    before = contents(folder.root)
    for stop_at in range(1, steps + 1, max(1, steps // 5)):
        stage = lift_scene(folder, mode, _SMALL)
        for _ in range(stop_at):
            next(stage)
        stage.close()
        assert contents(folder.root) == before


def test_a_cancelled_training_leaves_a_checkpoint_alone_and_goes_on(folder: SceneFolder) -> None:
    run_stage(lift_scene(folder, "paper", _SMALL))
    gaussians = run_stage(read_model(folder))
    whole = read_identity(folder, len(gaussians))
    run_stage(lift_scene(folder, "vote"))
    before = contents(folder.root)
    stage = lift_scene(folder, "paper", _SMALL)
    trained = 0
    for progress in stage:
        trained += progress.message.startswith("Train identities")
        if trained == 14:
            break
    stage.close()
    after = contents(folder.root)
    assert set(after) - set(before) == {f"gaga/{CHECKPOINT}"}
    assert {name: after[name] for name in before} == before
    report = run_stage(lift_scene(folder, "paper", _SMALL))
    assert report.figures.resumed_at == 14
    assert not (folder.work / CHECKPOINT).exists()
    resumed = read_identity(folder, len(gaussians))
    assert np.array_equal(resumed.field.encodings, whole.field.encodings)
    assert np.array_equal(resumed.field.weight, whole.field.weight)


def test_labels_of_the_bank_can_be_trained_on(folder: SceneFolder) -> None:
    report = run_stage(lift_scene(folder, "refine", replace(_SMALL, pseudo="bank")))
    assert report.figures.accuracy is not None
    assert report.figures.accuracy > 0.9
    with pytest.raises(ValueError, match="pseudo"):
        LiftConfig(pseudo="other")  # type: ignore[arg-type]


def test_what_is_missing_or_does_not_fit_is_told(folder: SceneFolder) -> None:
    with pytest.raises(GagaError, match="no mode 'magic'"):
        run_stage(lift_scene(folder, "magic"))  # type: ignore[arg-type]
    with pytest.raises(GagaError, match="Lift the groups first"):
        read_identity(folder, 3)
    run_stage(lift_scene(folder, "vote"))
    with pytest.raises(GagaError, match="the model has 3"):
        read_identity(folder, 3)
    name = f"{Path(folder.train[0]).stem}.png"
    write_labels(folder.work / "masks" / name, np.full((120, 160), 77, np.int32))
    with pytest.raises(GagaError, match="unknown groups"):
        run_stage(lift_scene(folder, "refine", _SMALL))
    (folder.work / "bank.npz").unlink()
    with pytest.raises(GagaError, match="lacks the memory bank"):
        run_stage(lift_scene(folder, "vote"))
    (folder.work / "labels.npz").unlink()
    with pytest.raises(GagaError, match="Associate the masks first"):
        run_stage(lift_scene(folder, "vote"))


def test_decoded_test_views_of_a_real_table_are_as_good_as_splatted_ones(ycb_table: Path) -> None:
    """Held-out IoU of the decode path of mode "vote" within 2 points of label_splat."""
    scene = open_scene_folder(ycb_table)
    gaussians, engine = run_stage(read_model(scene)), choose()
    cameras = select_views(scene, "train")[::4]
    masks = mask_folder(scene.mask_folders["sim"], [camera.name for camera in cameras])
    association = run_stage(
        associate_stage(gaussians, cameras, masks, engine, AssociateConfig.of("paper"))
    )
    closed = run_stage(
        vote_identity(
            gaussians,
            Voted(association.labels, association.confidence),
            association.bank.group,
            association.bank.n_groups,
            cameras,
            engine,
        )
    )
    labels, field = closed.identity.labels, closed.identity.field
    test = select_views(scene, "test")
    truth = [read_labels(ycb_table / "gt/instance" / f"{Path(c.name).stem}.png") for c in test]

    def score(shown: list[np.ndarray]) -> Score:
        return score_pairs(zip(truth, shown, strict=True))[1]

    splatted = score([splat_groups(engine, gaussians, camera, labels) for camera in test])
    decoded = score([decode_groups(engine, gaussians, camera, field) for camera in test])
    assert splatted.iou > 0.4
    assert abs(decoded.iou - splatted.iou) < 0.02


def test_labels_are_the_classifiers_where_the_paper_says_so(folder: SceneFolder) -> None:
    """Preset paper: votes until identities are trained as published, then their labels."""
    n = len(run_stage(read_model(folder)))
    votes = read_groups(folder, n)[0]
    source, labels = _opened(folder)
    assert (source, labels.tolist()) == ("votes", votes.tolist())
    run_stage(lift_scene(folder, "vote"))
    assert _opened(folder)[0] == "votes"
    run_stage(lift_scene(folder, config=_SMALL))  # no mode: the preset's
    identity = read_identity(folder, n)
    assert identity.mode == "paper"
    assert not np.array_equal(identity.labels, votes)
    source, labels = _opened(folder)
    assert source == "identities"
    assert np.array_equal(labels, identity.labels)
    (picture,) = run_stage(render_views(folder, views=folder.test))
    camera = select_views(folder, "test")[0]
    shown = splat_groups(choose(), run_stage(read_model(folder)), camera, identity.labels)
    assert np.array_equal(read_labels(picture), shown)
    # Groups that were made again are no longer those of the identities.
    strict = replace(AssociateConfig(), threshold=0.9)
    run_stage(associate_scene(folder, config=strict))
    os.utime(folder.work / "identity.npz")
    assert _opened(folder)[0] == "votes"


def test_robust_groups_keep_their_votes(folder: SceneFolder) -> None:
    run_stage(associate_scene(folder, config=AssociateConfig.of("robust")))
    report = run_stage(lift_scene(folder))
    assert report.mode == "vote"
    run_stage(lift_scene(folder, "paper", _SMALL))
    scene = run_stage(open_path_stage(folder.root)).scene
    assert scene.identities.source == "votes"
    assert scene.identities.other is not None
    identity = read_identity(folder, len(scene))
    assert np.array_equal(scene.identities.other.labels, identity.labels)
    colors = encoding_colors(identity.field.encodings)
    assert scene.identities.colors is not None
    assert np.array_equal(scene.identities.colors, colors)


def _opened(folder: SceneFolder) -> tuple[str, IntArray]:
    scene = run_stage(open_path_stage(folder.root)).scene
    return scene.identities.source, scene.labels


def test_encodings_are_pictures_of_their_colors(folder: SceneFolder) -> None:
    run_stage(lift_scene(folder, "vote"))
    (picture,) = run_stage(render_views(folder, what="encodings"))
    gaussians, camera = run_stage(read_model(folder)), select_views(folder, "test")[0]
    field = read_identity(folder, len(gaussians)).field
    channels = encoding_colors(field.encodings).astype(np.float32) / np.float32(255)
    shown = choose().render(gaussians, camera, channels=channels).image
    assert np.abs(read_rgb(picture).astype(float) - 255 * shown).max() <= 1
    assert len(np.unique(channels, axis=0)) >= field.n_groups - 1
