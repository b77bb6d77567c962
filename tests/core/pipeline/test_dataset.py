"""Labelled data of new views: true labels, ids that stay, and only stale pictures made again."""

import json
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from PIL import Image

from gaga_core.arrays import IntArray
from gaga_core.cli.main import main
from gaga_core.errors import GagaError
from gaga_core.export.dataset.records import Record, read_record, window_counts
from gaga_core.export.dataset.settings import DatasetConfig
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.images import write_rgb
from gaga_core.io.masks.coco import decode_rle, encode_rle
from gaga_core.pipeline.dataset import DatasetReport, dataset_stage
from gaga_core.pipeline.settings import EngineConfig
from gaga_core.progress import run_stage
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.raster.reference import ReferenceRasterizer
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.project import Project, open_path_stage
from tests.made import contents, write_true_scene
from tests.scenes import Synthetic, objects_scene

_SMALL = DatasetConfig(
    views=12, views_each=3, width=160, height=120, coverage=0.5, fill=False, validation=0.3
)


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


def made(project: Project, out: Path, config: DatasetConfig = _SMALL) -> DatasetReport:
    return run_stage(dataset_stage([project], out, config))


def records(out: Path) -> dict[str, Record]:
    found = (read_record(out, path.stem) for path in sorted((out / "records").iterdir()))
    return {one.name: one for one in found if one is not None and not one.is_left_out}


def values(path: Path) -> IntArray:
    return np.asarray(Image.open(path)).astype(np.int32)


def test_labels_are_those_of_the_scene_drawn_by_the_reference(
    project: Project, scene: Synthetic, tmp_path: Path
) -> None:
    """Visible ids, whole outlines, poses and depth against drawing each by itself."""
    made(project, tmp_path / "set", msgspec_free(moved=0.0, removed=0.0))
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


def msgspec_free(**changes: float) -> DatasetConfig:
    return DatasetConfig(**{**{k: getattr(_SMALL, k) for k in vars(_SMALL)}, **changes})


def centre_of(scene: Synthetic, group: int) -> list[float]:
    own = scene.gaussians.means[scene.labels == group]
    return ((own.min(axis=0) + own.max(axis=0)) / 2).tolist()  # type: ignore[no-any-return]
