"""What options change in an export, and nothing else."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import FloatArray
from gaga_core.errors import GagaError
from gaga_core.export.export import (
    PACKED,
    estimated_bytes,
    export_objects_stage,
    export_scene_stage,
)
from gaga_core.export.options import ExportOptions, Point
from gaga_core.io.splats.splat_files import SplatFormat, read_splats
from gaga_core.progress import run_stage
from gaga_core.scene.bake import bake
from gaga_core.scene.export_manifest import listed_files
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import Scene
from tests.core.scene.edits.edit_walk import walk_scene


def test_each_option_changes_what_it_says_and_nothing_else(tmp_path: Path) -> None:
    scene = walk_scene(sh_degree=3)
    whole = bake(scene)
    up: Point = (0.6, 0.0, 0.8)
    middle = (whole.means.min(axis=0) + whole.means.max(axis=0)) / 2

    def written(options: ExportOptions) -> tuple[FloatArray, ...]:
        run_stage(export_scene_stage(scene, tmp_path / "out.ply", options=options))
        back = read_splats(tmp_path / "out.ply")
        return back.means, back.log_scales, back.sh, back.quats, back.logit_opacities

    plain = written(ExportOptions())
    for got, expected in zip(
        plain,
        (whole.means, whole.log_scales, whole.sh, whole.quats, whole.logit_opacities),
        strict=True,
    ):
        np.testing.assert_array_equal(got, expected)
    less = written(ExportOptions(sh_degree=1))
    np.testing.assert_array_equal(less[2], whole.sh[:, :4])
    np.testing.assert_array_equal(less[0], whole.means)
    placed = written(ExportOptions(centre=True, ground=True, up=up, scale=2.5))
    expected = 2.5 * (whole.means - middle)
    shift = placed[0] - expected
    np.testing.assert_allclose(shift, np.broadcast_to(shift[0], shift.shape), atol=1e-4)
    assert np.linalg.norm(np.cross(shift[0], up)) < 1e-4, "lifted along up"
    heights = placed[0] @ np.array(up)
    assert (heights < -1e-4).mean() <= 0.006
    assert heights.min() < 0.05 * np.ptp(heights)
    np.testing.assert_allclose(placed[1], whole.log_scales + np.log(2.5), rtol=1e-5)
    np.testing.assert_array_equal(placed[3], whole.quats)


def test_a_crop_keeps_what_is_inside(tmp_path: Path) -> None:
    scene = walk_scene()
    lo, hi = np.percentile(bake(scene).means, [20, 80], axis=0)
    options = ExportOptions(crop=((lo[0], lo[1], lo[2]), (hi[0], hi[1], hi[2])))
    inside = ((bake(scene).means >= lo) & (bake(scene).means <= hi)).all(axis=1)
    assert 0 < inside.sum() < len(inside)
    n = run_stage(export_scene_stage(scene, tmp_path / "out.ply", options=options)).n_splats
    assert n == inside.sum()
    away = ExportOptions(crop=((1e6, 1e6, 1e6), (2e6, 2e6, 2e6)))
    with pytest.raises(GagaError, match="in the box of the crop"):
        run_stage(export_scene_stage(scene, tmp_path / "none.ply", options=away))


def test_files_of_objects_share_an_origin(tmp_path: Path) -> None:
    scene = walk_scene()
    options = ExportOptions(centre=True, scale=2.0)
    manifest = run_stage(export_objects_stage(scene, tmp_path / "o", [1, 2], options=options))
    files = listed_files(manifest)
    together = np.concatenate([read_splats(file).means for file in files])
    np.testing.assert_allclose(together.min(axis=0), -together.max(axis=0), atol=1e-4)
    plain = np.concatenate([bake(scene, indices=group_indices(scene, g)).means for g in (1, 2)])
    np.testing.assert_allclose(np.ptp(together, axis=0), 2 * np.ptp(plain, axis=0), rtol=1e-4)


@pytest.mark.parametrize("form", sorted({*SplatFormat} - {*PACKED}))
@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("has_normals", [False, True])
def test_the_size_is_told_beforehand(
    form: SplatFormat, degree: int, has_normals: bool, tmp_path: Path
) -> None:
    scene = walk_scene(20_000, sh_degree=3)
    if has_normals:
        normals = {f"n{axis}": np.zeros(len(scene), np.float32) for axis in "xyz"}
        scene = Scene.of(replace(scene.gaussians, extra=normals))
    path = tmp_path / f"out{form.suffix}"
    options = ExportOptions(sh_degree=degree)
    n = run_stage(export_scene_stage(scene, path, form=form, options=options)).n_splats
    told = estimated_bytes(scene.gaussians, n, form, degree)
    assert told == pytest.approx(path.stat().st_size, rel=0.1)


@pytest.mark.parametrize(
    "wrong",
    [{"sh_degree": 5}, {"scale": 0.0}, {"up": (1.0, 1.0, 0.0)}, {"crop": ((1, 0, 0), (0, 1, 1))}],
)
def test_what_cannot_be_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        ExportOptions(**wrong)  # type: ignore[arg-type]
