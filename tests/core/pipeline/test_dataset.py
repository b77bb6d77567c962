"""Labelled data of new views: true labels, ids that stay, and only stale pictures made again."""

import itertools
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from plyfile import PlyData

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.cli.main import main
from gaga_core.errors import GagaError
from gaga_core.export.dataset.records import Record, read_record, shown_objects
from gaga_core.export.dataset.settings import DatasetConfig, Form, planned
from gaga_core.fill.fill import Filling, fill_stage
from gaga_core.io.masks.coco import compress_counts, decode_rle, encode_rle
from gaga_core.pipeline import dataset
from gaga_core.pipeline.dataset import DatasetReport, dataset_stage
from gaga_core.pipeline.settings import EngineConfig
from gaga_core.progress import Progress, Stage, run_stage
from gaga_core.raster.cpu.rasterizer import Outlines
from gaga_core.raster.reference import ReferenceRasterizer
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.project import Project, open_path_stage, save_project
from tests.made import contents, write_true_scene
from tests.scenes import Synthetic, objects_scene

_SMALL = DatasetConfig(
    views=12, views_each=3, width=160, height=120, coverage=0.5, fill=False, validation=0.3
)
_KILLED = DatasetConfig(views=60, views_each=10, width=160, height=120, coverage=0.0, fill=False)


@pytest.fixture(scope="module")
def scene() -> Synthetic:
    return objects_scene(n_objects=4, per_object=400, n_cameras=12)


@pytest.fixture
def project(tmp_path: Path, scene: Synthetic) -> Project:
    """Four balls on a floor with their true labels."""
    root = tmp_path / "balls"
    write_true_scene(root, scene)
    project = run_stage(open_path_stage(root))
    project.scene.labels = scene.labels
    return project


_LABELS: tuple[Form, ...] = ("coco", "yolo")  # only "bop" needs models of the objects


def made(project: Project, out: Path, config: DatasetConfig = _SMALL) -> DatasetReport:
    return run_stage(dataset_stage([project], out, config, _LABELS))


def records(out: Path) -> dict[str, Record]:
    found = (read_record(out, path.stem) for path in sorted((out / "records").iterdir()))
    return {one.name: one for one in found if one is not None and not one.is_left_out}


def values(path: Path) -> IntArray:
    return np.asarray(Image.open(path)).astype(np.int32)


def test_labels_are_those_of_the_scene_drawn_by_the_reference(
    project: Project, scene: Synthetic, tmp_path: Path
) -> None:
    """Visible ids, whole outlines, poses and depth against drawing each by itself."""
    made(project, tmp_path / "set", changed(moved=0.0, removed=0.0, width=96, height=72))
    reference, n = ReferenceRasterizer(), 0
    for record in list(records(tmp_path / "set").values())[:3]:
        camera = record.camera
        truth = reference.label_splat(scene.gaussians, camera, scene.labels)
        ids = values(tmp_path / "set" / record.file("ids"))
        expected = np.where(truth.confidence < 0.3, 0, truth.labels)
        depth = values(tmp_path / "set" / record.file("depth")) * record.depth_scale
        drawn = reference.render(scene.gaussians, camera).median_depth
        assert np.abs(depth - drawn)[np.abs(depth - drawn) < 0.1].max() < 1e-4
        assert (np.abs(depth - drawn) < 1e-4).mean() > 0.995  # the rest is at edges
        for one in record.objects:
            n += 1
            size = (camera.height, camera.width)
            seen, whole = decode_rle(one.counts, size), decode_rle(one.whole_counts, size)
            np.testing.assert_array_equal(seen, ids == one.group)
            true = expected == one.group
            assert (seen & true).sum() >= 0.95 * (seen | true).sum()
            rows = np.flatnonzero(scene.labels == one.group)
            alone = reference.render(scene.gaussians.take(rows), camera).alpha >= 0.5
            assert (whole & (alone | true)).sum() >= 0.98 * (whole | alone | true).sum()
            assert not (seen & ~whole).any()
            middle = (camera.cam_from_world @ [*centre_of(scene, one.group), 1])[:3]
            pose = np.array(one.cam_from_object).reshape(4, 4)
            assert np.abs(pose[:3, 3] - middle).max() < 0.02  # of a box by splats, radius 0.28
            np.testing.assert_allclose(pose[:3, :3], camera.cam_from_world[:3, :3], atol=1e-12)
    assert n > 6


def _has_one_share(seen: list[Progress]) -> None:
    """The labels began again at 0 when all pictures were there."""
    assert {step.stage for step in seen if step.total} == {"Make pictures"}
    shares = [step.done / step.total for step in seen if step.total]
    assert shares == sorted(shares)
    assert any("COCO" in step.message for step in seen)


def changed(**changes: float) -> DatasetConfig:
    return DatasetConfig(**{**{k: getattr(_SMALL, k) for k in vars(_SMALL)}, **changes})


def centre_of(scene: Synthetic, group: int) -> list[float]:
    own = scene.gaussians.means[scene.labels == group]
    return ((own.min(axis=0) + own.max(axis=0)) / 2).tolist()


def test_objects_move_on_their_support_and_poses_follow(
    project: Project, scene: Synthetic, tmp_path: Path
) -> None:
    """A moved ball is where its pose says, on the floor, and not in another one."""
    made(project, tmp_path / "set", changed(moved=1.0, removed=0.0, lights=0.0))
    n_moved = 0
    for record in records(tmp_path / "set").values():
        places = {}
        for one in record.objects:
            world = np.linalg.inv(record.camera.cam_from_world) @ np.reshape(
                one.cam_from_object, (4, 4)
            )
            places[one.group] = world[:3, 3]
            n_moved += not np.allclose(world[:3, 3], centre_of(scene, one.group), atol=0.05)
            assert abs(world[2, 3]) < 0.05  # as high as before
            u, v = record.camera.project(world[None, :3, 3])[0][0]
            x, y, w, h = one.whole_box
            if x > 5 and y > 5 and x + w < record.width - 5 and y + h < record.height - 5:
                assert abs(u - (x + w / 2)) < 0.2 * w + 2
                assert abs(v - (y + h / 2)) < 0.2 * h + 2
        for a in places:
            assert all(np.linalg.norm(places[a] - places[b]) > 0.5 for b in places if b != a)
    assert n_moved > 4


def test_no_view_of_one_placement_is_for_both(project: Project, tmp_path: Path) -> None:
    out = tmp_path / "set"
    report = made(project, out, changed(views=30))
    splits: dict[str, set[str]] = {}
    for record in records(out).values():
        splits.setdefault(record.placement, set()).add(record.split)
    assert all(len(of) == 1 for of in splits.values())
    assert splits["as-it-is"] == {"train"}
    assert min(report.by_split.values()) > 0


def test_the_share_counts_the_holes_that_are_filled(
    project: Project, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A hole takes as long as 80 pictures, and had no share: of 13 s the last 9 were told as a
    fifth. Also where a run that was ended goes on."""
    fills, steps = list[object](), list[Progress]()

    def counted_fill(*args: Any) -> Stage[Filling]:
        found = yield from fill_stage(*args)
        fills.append(found)
        return found

    monkeypatch.setattr(dataset, "fill_stage", counted_fill)
    config, at = changed(fill=True, moved=1.0, removed=0.5, coverage=0.0), list[int]()

    def heard(step: Progress) -> None:
        steps.append(step)
        at.append(len(fills))

    run_stage(dataset_stage([project], tmp_path / "set", config, ("coco",)), heard)
    _has_one_share(steps)
    n = len(fills)
    assert n > 1
    with_all = [step.done / step.total for step, k in zip(steps, at, strict=True) if k == n]
    assert with_all[0] > 0.9, "pictures take no time next to holes"
    for step, k in zip(steps, at, strict=True):
        if step.total and k < n:
            assert k / n - 0.15 < step.done / step.total <= (k + 1) / n + 0.05
    for path in list((tmp_path / "set" / "records").iterdir())[1::2]:
        path.unlink()
    steps.clear()
    run_stage(dataset_stage([project], tmp_path / "set", config, ("coco",)), steps.append)
    _has_one_share(steps)


@pytest.mark.parametrize(
    ("views", "each", "shares"),
    [
        (4, 2, (0.5, 0.2, 0.2)),
        (19, 3, (0.6, 0.2, 0.3)),
        (9, 2, (1.0, 0.0, 0.4)),
        (6, 2, (0, 0, 0.9)),
    ],
)
def test_what_is_planned_for_validation_is_made(
    project: Project, tmp_path: Path, views: int, each: int, shares: tuple[float, float, float]
) -> None:
    """20 % of two placements are one of them: half of the pictures."""
    moved, removed, validation = shares
    config = changed(
        views=views, views_each=each, moved=moved, removed=removed, validation=validation,
        coverage=0.0, width=32, height=32,
    )  # fmt: skip
    made(project, tmp_path / "set", config)
    found = list(records(tmp_path / "set").values())
    n_kept = sum(record.split == "val" for record in found)
    assert len(found) == views
    assert planned(config) == (len({record.placement for record in found}), n_kept)
    if (views, validation) == (4, 0.2):
        assert n_kept == 2


def test_only_what_is_stale_is_made_again(project: Project, tmp_path: Path) -> None:
    """A rename changes tables; a merge the pictures that show the merged; ids stay."""
    out, config = tmp_path / "set", changed(moved=0.0, removed=0.0, coverage=0.3)
    assert made(project, out, config).made == 12
    assert "\nval: images/train " in (out / "data.yaml").read_text(), "none is for validation"
    before, files = json.loads((out / "dataset.json").read_text()), contents(out)
    assert made(project, out, config).made == 0
    now = contents(out)
    assert {k: v for k, v in now.items() if not k.startswith("scenes/")} == {
        k: v
        for k, v in files.items()
        if not k.startswith("scenes/")  # these count what was made
    }
    history = History(project.scene)
    history.do(edits.rename(project.scene, 2, "mug"))
    assert made(project, out, config).made == 0
    renamed = json.loads((out / "dataset.json").read_text())
    assert [row["id"] for row in renamed["classes"]] == [row["id"] for row in before["classes"]]
    assert renamed["objects"] == before["objects"]
    assert "mug" in (out / "data.yaml").read_text()
    shows = {name for name, r in records(out).items() if {1, 2} & {o.group for o in r.objects}}
    history.do(edits.merge_groups(project.scene, [1, 2]))
    report = made(project, out, config)
    assert report.made >= len(shows)
    fresh = tmp_path / "fresh"
    made(project, fresh, config)
    for name, record in records(fresh).items():
        assert records(out)[name] == record
        ids = record.file("ids")
        np.testing.assert_array_equal(values(out / ids), values(fresh / ids))
    after = json.loads((out / "dataset.json").read_text())
    kept = {(row["scene"], row["group"]): row["id"] for row in after["objects"]}
    assert all(kept[row["scene"], row["group"]] == row["id"] for row in before["objects"])


def test_an_ended_run_goes_on(project: Project, tmp_path: Path) -> None:
    """Closed in the middle, then run again: as if it had never been ended."""
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    made(project, whole)
    stage = dataset_stage([project], cut, _SMALL, _LABELS)
    for step in stage:
        if step.message.endswith("0002-001"):
            break
    stage.close()
    n_there = len(list((cut / "records").iterdir()))
    assert 0 < n_there < 12
    report = made(project, cut)
    assert report.made == 12 - n_there
    names = ("images", "ids", "depth", "records", "instances_train.json", "data.yaml")
    first, second = contents(whole), contents(cut)
    assert {k: v for k, v in first.items() if k.startswith(names)} == {
        k: v for k, v in second.items() if k.startswith(names)
    }


def test_a_killed_run_goes_on(project: Project, tmp_path: Path) -> None:
    """The program killed while it writes, then run again: as if it had never been killed."""
    save_project(project)
    root, whole, cut, config = tmp_path / "balls", tmp_path / "whole", tmp_path / "cut", _KILLED
    switches = [f"--{name.replace('_', '-')}={value}" for name, value in vars(config).items()]
    switches = [s for s in switches if not s.startswith("--fill")] + ["--no-fill"]
    call = [sys.executable, "-m", "gaga_core.cli.main", "dataset", str(root), "--out", str(cut)]
    labels = f"--to={','.join(_LABELS)}"
    with subprocess.Popen([*call, *switches, labels], stdout=subprocess.DEVNULL) as program:
        until = time.monotonic() + 120
        while len(list(cut.glob("records/*.json"))) < 4 and program.poll() is None:
            assert time.monotonic() < until
            time.sleep(0.001)
        program.kill()
    n_there = len(list(cut.glob("records/*.json")))
    assert 4 <= n_there < config.views
    run_stage(dataset_stage([root], whole, config, _LABELS))
    report = run_stage(dataset_stage([root], cut, config, _LABELS))
    assert 0 < report.made <= config.views - n_there + 1
    names = ("images/", "ids/", "depth/", "records/", "instances_", "data.yaml")
    first, second = (
        {k: v for k, v in contents(out).items() if k.startswith(names) and "/." not in k}
        for out in (whole, cut)
    )
    assert first == second


def test_coco_says_what_the_ids_show(project: Project, tmp_path: Path) -> None:
    coco = pytest.importorskip("pycocotools.coco", reason="pycocotools is in the dev group")
    out = tmp_path / "set"
    made(project, out)
    for split in ("train", "val"):
        read = coco.COCO(str(out / f"instances_{split}.json"))
        rows = {row["id"]: row for row in json.loads((out / "dataset.json").read_text())["objects"]}
        for number in read.getImgIds():
            image = read.loadImgs(number)[0]
            ids = values(out / image["ids_file"])
            for one in read.loadAnns(read.getAnnIds(imgIds=number)):
                mask = read.annToMask(one).astype(bool)
                np.testing.assert_array_equal(mask, ids == one["group_id"])
                assert rows[one["object_id"]]["class_id"] == one["category_id"]
                assert rows[one["object_id"]]["group"] == one["group_id"]
                x, y, w, h = one["bbox"]
                assert mask[y : y + h, x : x + w].sum() == mask.sum() == one["area"]


def test_bop_has_the_documented_layout(project: Project, tmp_path: Path) -> None:
    """Files and fields of the format's page, in millimetres, one folder for each placement; one
    share counts pictures, models and labels."""
    out, steps = tmp_path / "set", list[Progress]()
    report = run_stage(dataset_stage([project], out, _SMALL), steps.append)
    _has_one_share(steps)
    info = json.loads((out / "bop" / "models" / "models_info.json").read_text())
    models = {path.name: PlyData.read(str(path)) for path in (out / "bop" / "models").glob("*.ply")}
    for number, facts in info.items():
        model = models[f"obj_{int(number):06d}.ply"]
        corners = np.stack(model["face"]["vertex_indices"])
        sides = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        assert (np.unique(sides, axis=0, return_counts=True)[1] == 2).all()  # it is closed
        for axis in "xyz":
            assert model["vertex"][axis].min() == pytest.approx(facts[f"min_{axis}"], abs=1e-3)
            assert np.ptp(model["vertex"][axis]) == pytest.approx(facts[f"size_{axis}"], abs=1e-3)
    n_pictures = 0
    for folder in sorted((out / "bop").glob("*/0*")):
        cameras, poses, facts = (
            json.loads((folder / f"scene_{name}.json").read_text())
            for name in ("camera", "gt", "gt_info")
        )
        assert set(cameras) == set(poses) == set(facts)
        for key in poses:
            n_pictures += 1
            name = f"{int(key):06d}"
            assert (folder / "rgb" / f"{name}.jpg").is_file()
            depth = values(folder / "depth" / f"{name}.png") * cameras[key]["depth_scale"]
            for k, (pose, fact) in enumerate(zip(poses[key], facts[key], strict=True)):
                assert str(pose["obj_id"]) in info
                assert f"obj_{pose['obj_id']:06d}.ply" in models
                whole = values(folder / "mask" / f"{name}_{k:06d}.png") > 0
                seen = values(folder / "mask_visib" / f"{name}_{k:06d}.png") > 0
                assert fact["px_count_all"] == whole.sum()
                assert fact["px_count_visib"] == seen.sum()
                assert fact["visib_fract"] == pytest.approx(seen.sum() / whole.sum())
                if fact["visib_fract"] > 0.95 and seen.sum() > 200:
                    behind = pose["cam_t_m2c"][2] - np.median(depth[seen])
                    assert 0 < behind < 280  # a ball of 560 mm
                rotation = np.reshape(pose["cam_R_m2c"], (3, 3))
                np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
    assert n_pictures == report.pictures


def test_run_lengths_are_those_of_whole_pictures() -> None:
    """Of any masks of many objects, against the encoder of pictures; areas and boxes as well."""
    rng = np.random.default_rng(0)
    camera = Camera(np.eye(3), np.eye(4), 1, 1)
    for height, width in ((7, 5), (1, 9), (12, 12), (40, 31)):
        for n, share in itertools.product((1, 63, 70), (0.02, 0.5, 1.0)):
            whole = rng.random((n, height, width)) < share
            labels = np.where(rng.random((height, width)) < 0.9, rng.integers(0, n + 1), 0)
            labels[rng.random((height, width)) < 0.3] = n
            bits = np.zeros((height, width, -(-n // 64)), np.uint64)
            for k in range(n):
                bits[:, :, k // 64] |= whole[k].astype(np.uint64) << np.uint64(k % 64)
            objects = np.arange(1, n + 1, dtype=np.int32)
            outlines = Outlines(labels.astype(np.int32), objects, bits)
            found = shown_objects(outlines, dict.fromkeys(range(1, n + 1), np.eye(4)), camera)
            assert [one.group for one in found] == [k + 1 for k in range(n) if whole[k].sum() >= 10]
            for one in found:
                for mask, area, box, counts in (
                    (labels == one.group, one.area, one.box, one.counts),
                    (whole[one.group - 1], one.whole_area, one.whole_box, one.whole_counts),
                ):
                    assert counts == compress_counts(encode_rle(mask))
                    x, y, w, h = box
                    assert mask[y : y + h, x : x + w].sum() == mask.sum() == area
                    rows, columns = np.nonzero(mask)
                    assert not area or [h, w] == [int(np.ptp(rows)) + 1, int(np.ptp(columns)) + 1]


def test_scenes_on_workers_give_the_same_pictures(
    tmp_path: Path, scene: Synthetic, project: Project
) -> None:
    """Two folders by processes, and one that cannot be labelled: it does not stop the other."""
    save_project(project)
    bare = tmp_path / "bare"
    write_true_scene(bare, scene)  # has no groups
    root = tmp_path / "balls"
    config, engine = changed(views=3), EngineConfig(workers=2)
    out = tmp_path / "by-workers"
    report = run_stage(dataset_stage([root, bare], out, config, ("coco",), engine=engine))
    assert len(report.failed) == 1
    assert "no visible objects" in report.failed[0]
    run_stage(dataset_stage([root], tmp_path / "here", config, ("coco",)))
    ours, theirs = records(tmp_path / "here"), records(out)
    assert ours == theirs
    assert ours


def test_what_cannot_be(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").touch()
    with pytest.raises(GagaError, match="holds other files"):
        made(project, tmp_path / "mine")
    assert project.folder is not None
    assert main(["dataset", str(project.model_path), "--out", str(tmp_path / "a")]) == 1
    assert "no photos" in capsys.readouterr().err
    assert main(["dataset", str(project.folder.root), "--to", "voc"]) == 1
    assert "choose of coco, yolo, bop" in capsys.readouterr().err
    with pytest.raises(GagaError, match="Lower --coverage"):  # 4 times as fine as the photos
        made(project, tmp_path / "none", changed(views=2, moved=0.0, width=640, height=480))


def test_models_are_made_for_bop_alone(project: Project, tmp_path: Path) -> None:
    """Labels without them, and with them after a second run, which makes no picture again."""
    out, config = tmp_path / "set", changed(views=3)
    run_stage(dataset_stage([project], out, config, ("coco",)))
    assert not (out / "models").exists()
    report = run_stage(dataset_stage([project], out, config, ("coco", "bop")))
    assert report.made == 0
    assert len(list((out / "bop" / "models").glob("*.ply"))) == 4


def test_of_few_photos_views_are_kept_that_photos_would_be(tmp_path: Path) -> None:
    """Six photos around a table show little of each other from the same side."""
    scene = objects_scene(n_objects=4, per_object=400, n_cameras=6)
    root = tmp_path / "few"
    write_true_scene(root, scene)
    project = run_stage(open_path_stage(root))
    project.scene.labels = scene.labels
    report = made(project, tmp_path / "set", changed(coverage=0.8, moved=0.0, views=24))
    assert report.left_out <= 2


def test_what_is_left_out_counts_as_no_picture(project: Project, tmp_path: Path) -> None:
    """No view shows only what photos saw from the same side."""
    report = made(project, tmp_path / "set", changed(coverage=1.0, width=32, height=32))
    assert 0 < report.left_out < 12
    assert report.made == report.pictures == 12 - report.left_out
    assert report.kept == 0


def test_views_of_what_photos_looked_at_are_as_far_as_photos(
    project: Project, scene: Synthetic, tmp_path: Path
) -> None:
    made(project, tmp_path / "set", changed(closer=0.0, moved=0.0, views=24))
    made(project, tmp_path / "close", changed(closer=1.0, moved=0.0, views=24))
    far, close = (
        np.median(
            [np.linalg.norm(one.camera.position) for one in records(tmp_path / name).values()]
        )
        for name in ("set", "close")
    )
    photos = np.median([np.linalg.norm(camera.position) for camera in scene.cameras])
    assert abs(far / photos - 1) < 0.05
    assert close < 0.95 * photos
