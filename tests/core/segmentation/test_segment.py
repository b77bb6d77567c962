"""Masks of a scene folder: what is written, what is kept, and what a cancel leaves."""

import itertools
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import UInt8Array
from gaga_core.errors import GagaError
from gaga_core.io.cameras.colmap import write_colmap
from gaga_core.io.folder.scene_folder import SceneFolder, open_scene_folder
from gaga_core.io.images import write_rgb
from gaga_core.io.masks.label_maps import (
    mask_folder,
    read_further_labels,
    read_labels,
    write_labels,
)
from gaga_core.io.splats.ply import write_ply
from gaga_core.pipeline import segment
from gaga_core.pipeline.segment import segment_scene
from gaga_core.pipeline.settings import SegmentConfig
from gaga_core.progress import Progress, Stage, run_stage
from gaga_core.raster import choose
from gaga_core.segmentation.base import (
    FlattenConfig,
    ModelCard,
    ModelProvider,
    ScoredMasks,
    scored_masks,
)
from gaga_core.segmentation.choose import ProviderSettings, provider_named
from gaga_core.segmentation.regions import RegionsConfig, RegionsProvider
from gaga_core.segmentation.settings import GeneratorConfig
from tests.core.segmentation.fake_provider import Quarters
from tests.scenes import objects_scene


@pytest.fixture
def folder(tmp_path: Path) -> SceneFolder:
    """Five views with photos, four of them for training; splats; no masks."""
    root = tmp_path / "scene"
    scene = objects_scene(n_objects=3, per_object=80, n_cameras=5)
    write_ply(root / "point_cloud.ply", scene.gaussians)
    write_colmap(root / "sparse" / "0", scene.cameras, np.zeros((1, 3)), np.zeros((1, 3), np.uint8))
    rng = np.random.default_rng(0)
    for camera in scene.cameras:
        picture = rng.integers(0, 255, (camera.height, camera.width, 3), dtype=np.uint8)
        write_rgb(root / "images" / camera.name, picture)
    return open_scene_folder(root)


def _hidden(root: Path) -> list[Path]:
    return [path for path in root.rglob(".*") if path.is_file()]


def test_maps_of_the_train_views_are_written(folder: SceneFolder) -> None:
    provider = Quarters()
    steps: list[Progress] = []
    report = run_stage(segment_scene(folder, provider), steps.append)
    assert report.made == folder.train
    assert report.n_masks == 4 * 4
    assert report.folder == folder.root / "masks" / "quarters"
    for name in folder.train:
        labels = read_labels(report.folder / f"{Path(name).stem}.png")
        assert labels.shape == (120, 160)
        assert np.unique(labels).tolist() == [1, 2, 3, 4]
    record = json.loads((report.folder / "provider.json").read_text())
    assert (record["model"], record["licence"]) == ("four quarters", "MIT")
    assert record["settings"] == {"setting": 1}
    assert sorted(record["views"]) == sorted(Path(name).stem for name in folder.train)
    shares = [step.done / step.total for step in steps if step.total]
    assert shares == sorted(shares)
    assert shares[-1] == 1
    assert "left" in steps[-2].message or any("left" in step.message for step in steps)
    assert open_scene_folder(folder.root).mask_folders == {"quarters": report.folder}


def test_regions_are_of_what_is_before_the_background(folder: SceneFolder) -> None:
    """The coarsest level is the silhouettes; a new mask makes the regions of its view again."""
    masks = folder.root / "foreground"
    masks.mkdir()
    mask = np.zeros((120, 160, 3), np.uint8)
    mask[30:90, 20:60] = mask[40:80, 100:140] = 255
    for camera in folder.cameras:
        write_rgb(masks / f"{Path(camera.name).stem}.png", mask)
    provider = RegionsProvider(RegionsConfig(width=160))
    report = run_stage(segment_scene(folder, provider))
    inside = mask[..., 0] > 0
    for name in folder.train:
        path = report.folder / f"{Path(name).stem}.png"
        coarsest, *finer = read_further_labels(path)
        for labels in (read_labels(path), *finer):
            assert np.array_equal(labels > 0, inside)
        assert np.unique(coarsest[30:90, 20:60]).tolist() == [1]
        assert np.unique(coarsest[40:80, 100:140]).tolist() == [2]
    assert run_stage(segment_scene(folder, provider)).kept == folder.train
    write_rgb(masks / f"{Path(folder.train[0]).stem}.png", mask[:, ::-1])
    assert run_stage(segment_scene(folder, provider)).made == folder.train[:1]


def test_a_second_run_makes_only_what_is_missing(folder: SceneFolder) -> None:
    run_stage(segment_scene(folder, Quarters()))
    again = Quarters()
    report = run_stage(segment_scene(folder, again, views="all"))
    assert report.made == folder.test
    assert report.kept == folder.train
    assert len(again.seen) == 1
    (report.folder / f"{Path(folder.train[0]).stem}.png").unlink()
    report = run_stage(segment_scene(folder, again, views="all"))
    assert report.made == ()  # it came from the cache
    assert len(again.seen) == 1
    assert run_stage(segment_scene(folder, again, redo=True)).made == folder.train


def test_another_setting_is_another_mask_and_the_old_one_comes_back(folder: SceneFolder) -> None:
    run_stage(segment_scene(folder, Quarters(1)))
    assert len(run_stage(segment_scene(folder, Quarters(2))).made) == 4
    back = Quarters(1)
    assert len(run_stage(segment_scene(folder, back)).kept) == 4
    assert back.seen == []
    record = json.loads((folder.root / "masks" / "quarters" / "provider.json").read_text())
    assert record["settings"] == {"setting": 1}
    smaller = SegmentConfig(longest_side=80)
    assert len(run_stage(segment_scene(folder, back, config=smaller)).made) == 4
    assert read_labels(folder.root / "masks" / "quarters" / "001.png").shape == (60, 80)


def test_regions_are_written_at_several_levels_of_detail(folder: SceneFolder) -> None:
    config = RegionsConfig(width=40)
    report = run_stage(segment_scene(folder, RegionsProvider(config)))
    path = report.folder / f"{Path(folder.train[0]).stem}.png"
    maps = [*read_further_labels(path)[:1], read_labels(path)[2::4, 2::4]]
    maps += read_further_labels(path)[1:]
    assert [m.shape for m in maps] == [(30, 40)] * 4
    for coarse, fine in itertools.pairwise(maps):
        assert len(np.unique(np.stack([coarse, fine]).reshape(2, -1), axis=1).T) == fine.max()
    run_stage(segment_scene(folder, RegionsProvider(replace(config, detail=0.5))))
    run_stage(segment_scene(folder, RegionsProvider(config)))  # back from the cache
    assert len(read_further_labels(path)) == 3
    assert mask_folder(report.folder, folder.train).further[folder.train[0]]()[2].max() > 1


def _nested_masks(image: UInt8Array) -> Stage[ScoredMasks]:
    yield Progress("Segment", 0, 1, "")
    masks = np.zeros((2, *image.shape[:2]), bool)
    masks[0], masks[1, 30:60, 40:80] = True, True
    return scored_masks(masks, [0.9, 0.8], *image.shape[:2])


_NESTED = ModelProvider("nested", ModelCard("nested"), "0", lambda: _nested_masks, FlattenConfig())


def test_masks_of_a_model_that_contain_each_other_are_written_as_wholes_and_parts(
    folder: SceneFolder,
) -> None:
    report = run_stage(segment_scene(folder, _NESTED))
    masks = mask_folder(report.folder, folder.train)
    flat = masks.loaders[folder.train[0]]()
    wholes, parts = masks.further[folder.train[0]]()
    assert not masks.are_regions
    assert [len(np.unique(labels)) for labels in (flat, wholes, parts)] == [1, 1, 2]


def test_masks_of_a_model_from_before_levels_are_kept_and_named(
    folder: SceneFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as before:
        before.setattr(segment, "_WITH_LEVELS", segment._VERSION)
        run_stage(segment_scene(folder, _NESTED))
    report = run_stage(segment_scene(folder, _NESTED, views="all"))
    assert report.flat == folder.train  # kept: a model may have worked on them for hours
    assert report.made == folder.test
    assert f"The masks of {len(folder.train)} photos" in report.notes[0]
    assert report.to_json()["views_without_levels"] == len(folder.train)
    report = run_stage(segment_scene(folder, _NESTED, redo=True))
    assert report.made == folder.train
    assert run_stage(segment_scene(folder, _NESTED)).notes == ()


def test_a_changed_photo_is_made_anew(folder: SceneFolder) -> None:
    run_stage(segment_scene(folder, Quarters()))
    name = folder.train[1]
    write_rgb(folder.image_paths[name], np.zeros((120, 160, 3), np.uint8))
    assert run_stage(segment_scene(folder, Quarters())).made == (name,)


def test_maps_edited_by_hand_are_kept(folder: SceneFolder) -> None:
    report = run_stage(segment_scene(folder, Quarters()))
    path = report.folder / f"{Path(folder.train[0]).stem}.png"
    write_labels(path, np.full((120, 160), 7, np.int32))
    run_stage(segment_scene(folder, Quarters()))
    assert (read_labels(path) == 7).all()


@pytest.mark.parametrize("n_steps", [3, 14])
def test_a_cancel_keeps_finished_views_and_no_halves(folder: SceneFolder, n_steps: int) -> None:
    provider = Quarters()
    stage = segment_scene(folder, provider)
    for _ in range(n_steps):
        next(stage)
    stage.close()
    target = folder.root / "masks" / "quarters"
    finished = sorted(target.glob("*.png"))
    assert len(finished) == n_steps // 5  # 1 + 3 steps a view, and one at its end
    for path in finished:
        assert read_labels(path).max() == 4
    assert _hidden(folder.root) == []
    rest = run_stage(segment_scene(folder, Quarters()))
    assert len(rest.made) == 4 - len(finished)


def test_bad_photos_are_named_and_the_rest_is_done(folder: SceneFolder) -> None:
    cut, gone, *good = folder.train
    path = folder.image_paths[cut]
    path.write_bytes(path.read_bytes()[:200])
    folder.image_paths[gone].unlink()
    report = run_stage(segment_scene(open_scene_folder(folder.root), Quarters()))
    assert report.made == tuple(good)
    assert set(report.failed) == {cut, gone}
    assert "damaged" in report.failed[cut]
    assert "is not in" in report.failed[gone]
    assert len(report.notes) == 2
    for name in good:
        folder.image_paths[name].unlink()
    with pytest.raises(GagaError, match=r"damaged|is not in"):
        run_stage(segment_scene(open_scene_folder(folder.root), Quarters()))


def test_maps_of_others_are_never_overwritten(folder: SceneFolder) -> None:
    path = folder.root / "masks" / "quarters" / "001.png"
    write_labels(path, np.full((4, 4), 9, np.int32))
    for redo in (False, True):
        report = run_stage(segment_scene(folder, Quarters(), redo=redo))
        assert (read_labels(path) == 9).all()
        assert report.foreign == ("001.png",)
        assert len({*report.made, *report.kept}) == 3, "the others have none"
        assert "not made here" in report.notes[0]
    for other in path.parent.glob("*.png"):
        write_labels(other, np.full((4, 4), 9, np.int32))
    (path.parent / "provider.json").unlink()
    with pytest.raises(GagaError, match="not made here"):
        run_stage(segment_scene(folder, Quarters()))
    assert run_stage(segment_scene(folder, Quarters(), name="mine")).folder.name == "mine"


def test_a_damaged_record_costs_no_work(folder: SceneFolder) -> None:
    report = run_stage(segment_scene(folder, Quarters()))
    for text in ("", "[]", '{"views": 3}', '{"views": {"001": "x"}}'):
        (report.folder / "provider.json").write_text(text)
        again = Quarters()
        assert len(run_stage(segment_scene(folder, again)).kept) == 4
        assert again.seen == []


def test_depth_is_given_to_those_who_use_it(folder: SceneFolder) -> None:
    provider = Quarters(cues=frozenset({"depth"}), work_width=80)
    run_stage(segment_scene(folder, provider, rasterizer=choose("cpu")))
    camera = next(c for c in folder.cameras if c.name == folder.train[0])
    picture = provider.seen[0]
    assert picture.image.shape == (60, 80, 3)
    assert picture.depth is not None
    assert picture.depth.shape == (60, 80)
    seen = picture.depth > 0
    assert seen.mean() > 0.2
    away = np.linalg.norm(camera.position)
    assert abs(np.median(picture.depth[seen]) - away) < 0.5 * away
    assert read_labels(folder.root / "masks" / "quarters" / "001.png").shape == (120, 160)
    (folder.root / "point_cloud.ply").unlink()
    blind = Quarters(cues=frozenset({"depth"}))
    report = run_stage(segment_scene(open_scene_folder(folder.root), blind))
    assert len(report.made) == 4  # masks with depth are others than masks without
    assert blind.seen[0].depth is None


def test_other_splats_make_other_masks_only_with_depth(folder: SceneFolder) -> None:
    with_depth = Quarters(cues=frozenset({"depth"}))
    run_stage(segment_scene(folder, with_depth, rasterizer=choose("cpu")))
    run_stage(segment_scene(folder, Quarters(), name="plain"))
    write_ply(folder.root / "point_cloud.ply", objects_scene(2, 50, seed=1).gaussians)
    report = run_stage(segment_scene(folder, with_depth, rasterizer=choose("cpu")))
    assert len(report.made) == 4
    assert len(run_stage(segment_scene(folder, Quarters(), name="plain")).kept) == 4


def test_a_model_from_a_folder_end_to_end(
    folder: SceneFolder, model_folder: Callable[[str], Path]
) -> None:
    generator = GeneratorConfig(
        points_per_side=2, pred_iou_thresh=-1e9, stability_score_thresh=0.0, min_area=0.0
    )
    settings = ProviderSettings(generator=generator, flatten=FlattenConfig(-1e9, 0.0))
    weights = model_folder("sam2")
    provider = provider_named("tiny", weights=weights, settings=settings)
    report = run_stage(segment_scene(folder, provider))
    assert len(report.made) == 4
    record = json.loads((report.folder / "provider.json").read_text())
    assert record["source"] == str(weights)
    assert record["settings"]["points_per_side"] == 2
    other = replace(settings, generator=replace(generator, points_per_batch=1))
    same = provider_named("tiny", weights=weights, settings=other)
    assert len(run_stage(segment_scene(folder, same)).kept) == 4
