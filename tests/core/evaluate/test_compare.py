"""The ablation: baselines that fail where they must, and one table of all variants."""

import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaga_core.arrays import BoolArray, IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.evaluate.baselines import (
    Inputs,
    chained_3d_iou,
    label_gaussians,
    match_frame,
    no_association,
    overlap_tracker,
    true_maps,
    true_masks,
    video_tracks,
)
from gaga_core.evaluate.compare import (
    VariantRow,
    VariantTable,
    compare_dataset,
    compare_variants,
)
from gaga_core.evaluate.published import iou_drop, sparse_views
from gaga_core.evaluate.settings import ABLATIONS, TITLES, CompareConfig
from gaga_core.grouping.associate import AssociateConfig
from gaga_core.io.datasets import DATASETS, open_dataset
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.masks.label_maps import read_labels, write_labels
from gaga_core.masks import MaskSet
from gaga_core.pipeline.settings import IdentitySettings
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.core.grouping.true_masks import permuted, true_map
from tests.datasets import gaga_replica
from tests.made import write_true_scene
from tests.scenes import Synthetic, objects_scene

# The others need models, or masks that this scene has not.
RUN = tuple(n for n in TITLES if n not in ("sam2", "paper-sam2", "gaussian-grouping", "rendered"))


@pytest.fixture(scope="module")
def scene() -> Synthetic:
    """Balls that hide one another from low cameras all around."""
    return objects_scene(n_objects=6, per_object=300, n_cameras=16, seed=2)


@pytest.fixture(scope="module")
def truth(scene: Synthetic) -> list[IntArray]:
    return [true_map(scene, camera) for camera in scene.cameras]


@pytest.fixture(scope="module")
def root(scene: Synthetic, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene folder with perfect masks under random ids; every fourth view is held out."""
    root = tmp_path_factory.mktemp("compare")
    write_true_scene(root, scene, test=(3, 7, 11, 15), top=40)
    return root


@pytest.fixture(scope="module")
def table(root: Path) -> VariantTable:
    config = CompareConfig(shares=(0.25,), seeds=(0, 1), lift="none", lifting_iterations=150)
    stage = compare_variants(open_scene_folder(root), root / "gt/instance", config=config)
    return run_stage(stage)


def mask_set(maps: dict[str, IntArray]) -> MaskSet:
    return MaskSet({name: partial(maps.__getitem__, name) for name in maps})


def inputs_of(scene: Synthetic, maps: list[IntArray]) -> Inputs:
    named = {c.name: m for c, m in zip(scene.cameras, maps, strict=True)}
    return Inputs.of(scene.gaussians, scene.cameras, mask_set(named), choose())


def test_the_better_method_scores_better(table: VariantTable) -> None:
    iou = {variant: table.of(variant)[0].without_void.iou for variant in RUN}
    assert iou["paper"] > iou["all-gaussians"] + 0.02
    assert iou["all-gaussians"] > iou["none"]
    assert iou["paper"] > iou["chained"] - 1e-9
    assert iou["chained"] > iou["none"]
    assert iou["true-masks"] >= max(iou["paper"], iou["robust"]) - 0.01
    assert iou["per-frame"] == pytest.approx(1)  # the masks of this scene are perfect
    assert iou["lifting"] > iou["none"] + 0.1  # few objects, and all views share splats
    tracked, bank = table.of("tracker")[0], table.of("paper")[0]
    assert tracked.n_groups > 2 * bank.n_groups  # the ring turns too far from view to view
    assert tracked.without_void.precision < bank.without_void.precision


def test_the_table_and_its_file_tell_the_same(table: VariantTable, root: Path) -> None:
    saved = json.loads((root / "gaga" / "variants.json").read_text())
    assert len(saved["rows"]) == len(table.rows) == len(RUN) + 2 * 2
    assert saved["images"] == list(open_scene_folder(root).test)
    headings, *rows = table.table()
    assert len(rows) == len(RUN) + 2
    assert all(len(row) == len(headings) for row in rows)
    drop = table.drop("paper", 0.25)
    assert drop is not None
    assert rows[-1][-1] == f"{100 * drop:.1f} %"
    assert {row.n_views for row in table.of("paper", 0.25)} == {3}
    assert table.drop("chained", 0.25) is None
    assert not (root / "gaga" / "labels.npz").exists()


def test_the_same_comparison_gives_the_same_figures(table: VariantTable, root: Path) -> None:
    config = CompareConfig(variants=("paper", "chained", "tracker"), sparse=(), lift="none")
    stage = compare_variants(open_scene_folder(root), root / "gt/instance", config=config)
    again = run_stage(stage)
    for row in again.rows:
        before = table.of(row.variant)[0]
        assert (row.with_void, row.without_void) == (before.with_void, before.without_void)
        assert row.n_groups == before.n_groups


def test_ablations_change_one_setting_of_the_paper(root: Path) -> None:
    """Rows that change nothing are the paper's own, and "no depth" is its row "all Gaussians"."""
    rows = ("paper", "threshold 0.1", "f = 1", "all-gaussians", "no depth", "threshold 0.5")
    config = CompareConfig(variants=rows, sparse=())
    stage = compare_variants(open_scene_folder(root), root / "gt/instance", config=config)
    table = run_stage(stage)
    score = {row.variant: (row.without_void, row.with_void, row.n_groups) for row in table.rows}
    assert score["threshold 0.1"] == score["f = 1"] == score["paper"]
    assert score["no depth"] == score["all-gaussians"] != score["paper"]
    for name in ("threshold 0.05", "threshold 0.5"):
        assert ABLATIONS[name].config("paper") == replace(
            AssociateConfig(), threshold=float(name.split()[1])
        )
    assert table.rows[-1].title == "paper, threshold 0.5, labels by vote"
    with pytest.raises(GagaError, match="no variant 'threshold 7'"):
        CompareConfig(variants=("threshold 7",))


def test_bounds_are_left_out_where_the_truth_or_masks_they_need_are_not(
    root: Path, tmp_path: Path
) -> None:
    folder = open_scene_folder(root)
    gt, masks = tmp_path / "gt", tmp_path / "masks"
    gt.mkdir()
    masks.mkdir()
    for name in folder.test:
        write_labels(gt / name, read_labels(root / "gt/instance" / name))
    for name in folder.train:
        write_labels(masks / name, read_labels(root / "masks/sim" / name))
    bounds = ("per-frame", "true-masks", "true-maps")
    config = CompareConfig(variants=("none", *bounds), sparse=(), lift="none")
    table = run_stage(compare_variants(folder, gt, masks, config))
    assert [row.variant for row in table.rows] == ["none"]
    with pytest.raises(GagaError, match="no true map"):
        run_stage(compare_variants(folder, root / "masks", masks, config))
    with pytest.raises(GagaError, match="no variant"):
        CompareConfig(variants=("magic",))


def test_consistent_ids_need_no_association(scene: Synthetic, truth: list[IntArray]) -> None:
    inputs = inputs_of(scene, truth)
    labels = run_stage(label_gaussians(inputs, run_stage(no_association(inputs))))
    seen = labels > 0
    wanted = np.where(scene.labels > 0, scene.labels, 7)
    assert (labels == wanted)[seen].mean() > 0.95


def test_a_camera_that_stands_still_is_followed_exactly(
    scene: Synthetic, truth: list[IntArray]
) -> None:
    """The same view twelve times under other ids: every follower keeps each object's group."""
    camera, true = scene.cameras[0], truth[0]
    cameras = [type(camera)(camera.K, camera.cam_from_world, 160, 120, f"{i}") for i in range(6)]
    maps = {c.name: permuted(true, i, top=30) for i, c in enumerate(cameras)}
    inputs = Inputs.of(scene.gaussians, cameras, mask_set(maps), choose())
    for method in (chained_3d_iou, overlap_tracker):
        groups = run_stage(method(inputs))
        assert groups.n_groups == len(np.unique(true[true > 0]))
        shown = [groups.groups[name][labels] for name, labels in maps.items()]
        assert all((s == shown[0]).all() for s in shown)


def test_true_masks_survive_any_ids_and_void_stays_void(
    scene: Synthetic, truth: list[IntArray]
) -> None:
    floorless = [np.where(t == 7, 0, t).astype(np.int32) for t in truth]
    true_set = inputs_of(scene, floorless).masks
    inputs = inputs_of(scene, [permuted(t, i) for i, t in enumerate(truth)])
    by_masks = run_stage(label_gaussians(inputs, run_stage(true_masks(inputs, true_set))))
    floor = scene.labels == 0
    assert (by_masks[floor] == 0).mean() > 0.95
    assert (by_masks[~floor] == scene.labels[~floor])[by_masks[~floor] > 0].mean() > 0.97
    whole = Inputs.of(scene.gaussians, scene.cameras, true_maps(true_set), choose())
    by_maps = run_stage(label_gaussians(whole, run_stage(true_masks(whole, true_set))))
    assert (by_maps[floor] == 0).mean() > 0.95


def test_a_frame_matched_to_its_truth_by_hand() -> None:
    true = np.array([[1, 1, 1, 2, 2, 2, 0, 0]], np.int32)
    masks = np.array([[9, 9, 4, 3, 3, 3, 8, 0]], np.int32)
    matched = match_frame(masks, true)
    assert matched[0, :2].tolist() == [1, 1]
    assert matched[0, 3:6].tolist() == [2, 2, 2]
    assert matched[0, 2] != matched[0, 6]
    assert min(matched[0, 2], matched[0, 6]) > 2
    assert matched[0, 7] == 0


def test_sparse_views_are_random_nested_and_repeatable() -> None:
    names = [f"{i:03d}.png" for i in range(40)]
    choices = [sparse_views(names, share, seed=3) for share in (0.05, 0.1, 0.2, 0.3)]
    assert [len(c) for c in choices] == [2, 4, 8, 12]
    for small, large in pairwise(choices):
        assert set(small) < set(large)
    assert all(list(c) == sorted(c) for c in choices)
    assert choices[3] == sparse_views(names[::-1], 0.3, seed=3)
    assert choices[3] != sparse_views(names, 0.3, seed=4)
    assert len(sparse_views(names[:4], 0.05, seed=0)) == 1
    with pytest.raises(GagaError, match="share"):
        sparse_views(names, 0, seed=0)
    assert iou_drop(0.8, 0.6) == pytest.approx(0.25)
    assert iou_drop(0, 0) == 0


def test_tracks_begin_where_masks_are_not_covered_and_masks_take_theirs(
    scene: Synthetic, truth: list[IntArray]
) -> None:
    """A follower that knows the truth keeps every object's group; one that loses everything begins
    tracks again in every view."""
    views = scene.cameras[:4]
    shown = {c.name: permuted(truth[i], i, top=30) for i, c in enumerate(views)}
    inputs = Inputs.of(scene.gaussians, views, mask_set(shown), choose())
    of_photo = {i: truth[i] for i in range(len(views))}

    def photo_of(camera: Camera) -> UInt8Array:
        place = [c.name for c in views].index(camera.name)
        return np.full((camera.height, camera.width, 3), place, np.uint8)

    def sees(photos: Sequence[UInt8Array], masks: BoolArray) -> Iterator[BoolArray]:
        first = of_photo[int(photos[0][0, 0, 0])]
        objects = [np.bincount(first[mask]).argmax() for mask in masks]
        for photo in photos:
            yield np.stack([of_photo[int(photo[0, 0, 0])] == k for k in objects])

    def loses(photos: Sequence[UInt8Array], masks: BoolArray) -> Iterator[BoolArray]:
        for _ in photos:
            yield np.zeros_like(masks)

    groups = run_stage(video_tracks(inputs, photo_of, sees))
    of_object: dict[int, set[int]] = {}
    for camera, true in zip(views, truth, strict=False):
        found = groups.groups[camera.name][shown[camera.name]]
        for k in np.unique(true[true > 0]):
            of_object.setdefault(int(k), set()).update(np.unique(found[true == k]).tolist())
    assert all(len(ids) == 1 and 0 not in ids for ids in of_object.values())
    assert len(set.union(*of_object.values())) == len(of_object)
    lost = run_stage(video_tracks(inputs, photo_of, loses))
    assert lost.n_groups == sum(len(np.unique(m[m > 0])) for m in shown.values())


def test_sam_2_follows_masks_through_the_photos(root: Path, tmp_path: Path) -> None:
    """Random weights mean nothing, so only the way through is tested."""
    from tests.core.segmentation.tiny_models import save_tiny

    save_tiny("sam2_film", tmp_path / "sam2")
    shutil.copytree(root, tmp_path / "scene")
    folder = open_scene_folder(tmp_path / "scene")
    config = CompareConfig(("sam2",), (), lift="none", video_model=tmp_path / "sam2")
    gt = root / "gt/instance"
    with pytest.raises(GagaError, match="no photos"):
        run_stage(compare_variants(folder, gt, config=config))
    for i, camera in enumerate(folder.cameras):
        photo = np.random.default_rng(i).integers(
            0, 255, (camera.height, camera.width, 3), np.uint8
        )
        (tmp_path / "scene" / "images").mkdir(exist_ok=True)
        Image.fromarray(photo).save(tmp_path / "scene" / "images" / camera.name)
    few = replace(open_scene_folder(tmp_path / "scene"), train=folder.train[:2])
    table = run_stage(compare_variants(few, gt, config=config))
    assert [row.title for row in table.rows] == ["SAM 2 tracks, labels by vote"]
    assert table.rows[0].n_groups >= 1


def test_published_figures_of_a_data_set_are_not_next_to_one_scene(root: Path) -> None:
    config = CompareConfig(variants=("threshold 0.2", "threshold 0.4", "none"), sparse=())
    found = run_stage(compare_variants(open_scene_folder(root), root / "gt/instance", None, config))
    headings, *_ = found.table()
    assert "published" not in headings
    assert "IoU drop" not in headings  # no row has one
    notes = found.notes()
    assert notes[0].startswith("Counted with void left out")
    for text in ("no association (SAM) 8.8/3.2/2.2", "memory bank (SAM 2) 49.0/30.5/53.4"):
        assert any(text in note for note in notes)
    assert any("0.2 85.8/51.3/71.7" in note for note in notes)
    assert any("apart: they are means over the eight scenes" in note for note in notes)
    assert any("its own tracker needs weights and is quoted" in note for note in notes)
    saved = json.loads((root / "gaga" / "variants.json").read_text())["rows"]
    assert saved[0]["published"]["miou"]["ramen"] == 51.3
    assert "published" not in saved[1]
    alike = replace(found, apart=()).table()
    assert [row[alike[0].index("published")] for row in alike[1:]] == [
        "85.8/51.3/71.7",
        "",
        "8.8/3.2/2.2",
    ]


def test_names_of_rows_say_how_they_were_labelled(root: Path) -> None:
    """Baselines are trained as the method is; a shortcut is in the name."""
    names = ("paper", "released", "robust", "none", "lifting")
    few = IdentitySettings(lift_iterations=60)
    rows: dict[str, list[VariantRow]] = {}
    for lift in ("none", None):
        config = CompareConfig(names, (), lift=lift, identities=few, lifting_iterations=60)
        stage = compare_variants(open_scene_folder(root), root / "gt/instance", None, config)
        rows[lift or "preset"] = list(run_stage(stage).rows)
    trained = "identities by paper, 16,384 pixels a view, 60 steps"
    assert [row.title for row in rows["preset"]] == [
        f"paper, {trained}",
        f"released, {trained}",
        "robust, identities by vote",
        f"no association, {trained}",
        "linear assignment (Panoptic Lifting), its own training",
    ]
    assert [row.title for row in rows["none"]][:4] == [
        "paper, labels by vote",
        "released, labels by vote",
        "robust, groups",
        "no association, labels by vote",
    ]
    for plain, lifted in zip(rows["none"], rows["preset"], strict=True):
        assert plain.variant == lifted.variant
    assert rows["none"][0].without_void.iou != rows["preset"][0].without_void.iou
    assert rows["none"][3].with_void != rows["preset"][3].with_void
    assert CompareConfig(("paper", "f = 0")).lifted_by == "none"
    assert CompareConfig(("paper", "f = 0"), lift="paper").lifted_by == "paper"
    assert CompareConfig().trained.pixels == 16384
    assert CompareConfig(identities=IdentitySettings(pixels=0)).trained.pixels == 0
    with pytest.raises(GagaError, match="no lift"):
        CompareConfig(lift="magic")  # type: ignore[arg-type]


def test_masks_of_other_models_have_rows_of_their_own(root: Path, tmp_path: Path) -> None:
    """SAM 2's masks for the bank, tracks for Gaussian Grouping, rendered pictures for the bound."""
    scene = tmp_path / "scene"
    shutil.copytree(root, scene, ignore=shutil.ignore_patterns("gaga"))
    shutil.copytree(scene / "gt" / "instance", scene / "masks" / "object_mask")
    made = next(p.name for p in (scene / "masks").iterdir() if p.name != "object_mask")
    shutil.copytree(scene / "masks" / made, scene / "masks" / "sam2")
    config = CompareConfig(
        ("paper", "paper-sam2", "gaussian-grouping", "rendered"),
        (),
        lift="none",
        sam2_masks="sam2",
        bound_by="regions",
    )
    stage = compare_variants(open_scene_folder(scene), scene / "gt/instance", made, config)
    rows = {row.variant: row for row in run_stage(stage).rows}
    assert set(rows) == set(config.variants)
    assert rows["paper-sam2"].without_void == rows["paper"].without_void  # the same masks here
    assert rows["gaussian-grouping"].without_void.iou > 0.6  # its tracks are the truth
    assert 0 < rows["rendered"].without_void.iou < 1


def test_the_ablation_of_a_data_set_ends_with_its_means(replica: Path, tmp_path: Path) -> None:
    config = CompareConfig(("paper", "released", "none"), ("paper",), (0.5,), lift="none")
    data = open_dataset("replica", replica)
    *scenes, mean = run_stage(compare_dataset(data, tmp_path, None, config))
    assert [table.scene for table in scenes] == ["office_0", "room_0"]
    assert mean.scene == "mean of 2 scenes"
    for row in mean.rows:
        own = [r for t in scenes for r in t.rows if r.key == row.key]
        assert row.with_void.iou == pytest.approx(np.mean([r.with_void.iou for r in own]))
        assert row.with_void.n_true == sum(r.with_void.n_true for r in own)
    assert len(mean.rows) == 4
    assert any("without" in why and "room_1" in why for why in mean.apart)
    assert any("by vote here" in why for why in mean.apart)
    assert "published" not in mean.table()[0]
    assert (tmp_path / "office_0" / "gaga" / "variants.json").is_file()


def test_published_figures_stand_next_to_the_means_of_all_eight_scenes(tmp_path: Path) -> None:
    names = DATASETS["replica"].scenes
    for name in names:
        gaga_replica(tmp_path / "replica" / name)
    data, few = open_dataset("replica", tmp_path / "replica"), IdentitySettings(lift_iterations=3)
    config = CompareConfig(("paper", "none"), (), identities=few)
    *scenes, mean = run_stage(compare_dataset(data, tmp_path / "out", None, config))
    assert {table.scene for table in scenes} == set(names)
    assert mean.apart == ()
    headings, *rows = mean.table()
    at = headings.index("published")
    assert [row[at] for row in rows] == ["46.2/39.5/50.6", "8.8/3.2/2.2"]
    assert rows[0][0] == "paper, identities by paper, 16,384 pixels a view, 3 steps"
    assert any("not run here, but quoted" in note for note in mean.notes())
    assert all("published" not in table.table()[0] for table in scenes)
    voted = replace(config, lift="none", variants=("none",))
    one = run_stage(compare_dataset(data, tmp_path / "out", None, voted))[-1]
    assert one.apart == ("identities: by vote here, trained there",)
