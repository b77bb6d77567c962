"""What is exported is what is visible, and nothing is left of an export that did not end."""

import errno
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.export.export import (
    PACKED,
    MeshExport,
    MeshForm,
    export_objects_stage,
    export_scene_stage,
    exported_indices,
    objects_losses,
    sampled_bytes,
    slug,
)
from gaga_core.export.options import ExportOptions
from gaga_core.export.solids import MeshConfig
from gaga_core.io.meshes import MeshFile
from gaga_core.io.splats import ply
from gaga_core.io.splats.glb import Buffers
from gaga_core.io.splats.ply import read_ply, write_ply
from gaga_core.io.splats.splat_files import SplatFormat, read_splats
from gaga_core.progress import Progress, Stage, run_stage
from gaga_core.scene import edits
from gaga_core.scene.bake import bake
from gaga_core.scene.edits.history import History
from gaga_core.scene.export_manifest import MANIFEST, listed_files, manifests_in, read_manifest
from gaga_core.scene.objects import group_indices
from gaga_core.scene.orientation import guess_up
from gaga_core.scene.project import open_path_stage
from gaga_core.scene.scene import Scene, State
from tests.core.scene.edits.edit_walk import builders, random_affine, walk_scene
from tests.scenes import random_gaussians
from tests.shares import falls, shares

COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("what", ["visible", "selected"])
def test_the_exported_count_is_the_visible_count(seed: int, what: Any, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    scene = walk_scene(seed=seed)
    history = History(scene)
    kinds = builders()
    for name in ("duplicate", "delete", "isolate", "show", "hide", "transform", "select"):
        history.do(kinds[name](rng, scene))
    history.do(edits.show(scene, np.arange(30)))
    history.do(edits.select(scene, np.arange(200), "add"))
    shown = scene.visible & (scene.has(State.SELECTED) if what == "selected" else True)
    assert shown.any()
    n = run_stage(export_scene_stage(scene, tmp_path / "out.ply", what=what)).n_splats
    back = read_ply(tmp_path / "out.ply")
    assert n == len(back) == shown.sum()
    assert np.array_equal(back.extra["tag"], scene.gaussians.extra["tag"][shown])


def test_export_reopens_as_the_baked_scene_bit_for_bit(tmp_path: Path) -> None:
    scene = walk_scene(sh_degree=3)
    moved = group_indices(scene, [2])
    History(scene).do(edits.transform(scene, moved, random_affine(np.random.default_rng(0))))
    run_stage(export_scene_stage(scene, tmp_path / "out.ply", groups=True))
    back, baked = read_ply(tmp_path / "out.ply"), bake(scene)
    still = scene.labels != 2
    for name in COLUMNS:
        assert getattr(back, name).tobytes() == getattr(baked, name).tobytes()
        original = getattr(scene.gaussians, name)
        assert getattr(back, name)[still].tobytes() == original[still].tobytes()
    for name, column in scene.gaussians.extra.items():
        assert back.extra[name].dtype == column.dtype
        assert np.array_equal(back.extra[name], column)
    assert np.array_equal(back.extra["group"], scene.labels)


def test_an_untouched_scene_exports_to_the_same_file(tmp_path: Path) -> None:
    write_ply(tmp_path / "in.ply", walk_scene().gaussians)
    scene = Scene.of(read_ply(tmp_path / "in.ply"))
    x, y, z = guess_up(scene.gaussians).tolist()
    run_stage(export_scene_stage(scene, tmp_path / "out.ply", options=ExportOptions(up=(x, y, z))))
    assert (tmp_path / "out.ply").read_bytes() == (tmp_path / "in.ply").read_bytes()


@pytest.mark.parametrize(
    "form", [form for form in SplatFormat if form not in (SplatFormat.SPLAT, SplatFormat.HTML)]
)
def test_a_file_tells_which_way_is_up(tmp_path: Path, form: SplatFormat) -> None:
    """Whatever its splats look like; a .splat has no room for it, a page is not read."""
    if form is SplatFormat.USD:
        pytest.importorskip("pxr")
    rng, path = np.random.default_rng(4), tmp_path / f"out{form.suffix}"
    scene = Scene.of(random_gaussians(200, seed=1))
    for up in (np.array([0.0, 0, 1]), *rng.normal(size=(3, 3))):
        x, y, z = (up / np.linalg.norm(up)).tolist()
        run_stage(export_scene_stage(scene, path, form=form, options=ExportOptions(up=(x, y, z))))
        back = read_splats(path)
        heights = scene.gaussians.means @ np.array([x, y, z])
        read = np.sort(back.means @ guess_up(back))  # some forms sort the splats
        np.testing.assert_allclose(read, np.sort(heights), atol=5e-3)


@pytest.mark.parametrize(
    "form", [form for form in SplatFormat if form not in (SplatFormat.SPLAT, SplatFormat.HTML)]
)
def test_a_file_says_that_its_unit_is_a_metre_only_where_that_is_known(
    tmp_path: Path, form: SplatFormat
) -> None:
    if form is SplatFormat.USD:
        pytest.importorskip("pxr")

    def is_metric(scene: Scene, scale: float = 1.0) -> bool:
        path, options = tmp_path / f"out{form.suffix}", ExportOptions(scale=scale)
        run_stage(export_scene_stage(scene, path, form=form, options=options))
        assert read_splats(path).is_metric == run_stage(open_path_stage(path)).scene.frame.is_metric
        return read_splats(path).is_metric

    scene = Scene.of(random_gaussians(30, seed=1).with_antialiasing(True))
    assert not is_metric(scene)
    History(scene).do(edits.set_scale(scene, 2.0, 0.5, np.zeros(3)))
    assert is_metric(scene)
    assert not is_metric(scene, scale=100)


def test_objects_in_metres_are_opened_in_metres(tmp_path: Path) -> None:
    scene = walk_scene()
    History(scene).do(edits.set_scale(scene, 2.0, 0.5, np.zeros(3)))
    run_stage(export_objects_stage(scene, tmp_path))
    assert run_stage(open_path_stage(tmp_path)).scene.frame.is_metric


def test_edits_during_an_export_do_not_reach_the_file(tmp_path: Path) -> None:
    scene = walk_scene()
    stage = export_scene_stage(scene, tmp_path / "out.ply")
    History(scene).do(edits.hide(scene, np.arange(100)))
    assert run_stage(stage).n_splats == 400


def test_nothing_visible_is_one_sentence(tmp_path: Path) -> None:
    scene = walk_scene(20)
    with pytest.raises(GagaError, match="Nothing is selected"):
        run_stage(export_scene_stage(scene, tmp_path / "out.ply", what="selected"))
    with pytest.raises(GagaError, match="None of these"):
        run_stage(export_objects_stage(scene, tmp_path / "out", [99]))
    assert list(tmp_path.iterdir()) == []


def test_objects_get_a_file_each_and_a_manifest(tmp_path: Path) -> None:
    scene = walk_scene()
    history = History(scene)
    for group, name in ((1, "Müg"), (3, "mug"), (4, "con"), (5, "碗")):
        history.do(edits.rename(scene, group, name))
    history.do(edits.hide(scene, group_indices(scene, 6)))
    history.do(edits.delete(scene, group_indices(scene, 1)[:2]))
    history.do(
        edits.transform(scene, group_indices(scene, 3), random_affine(np.random.default_rng(0)))
    )
    folder = tmp_path / "objects"
    manifest = run_stage(export_objects_stage(scene, folder, source="table.ply"))
    content = json.loads(manifest.read_text(encoding="utf-8"))
    assert content["version"] == 1
    assert content["source"] == "table.ply"
    rows = {row["id"]: row for row in content["groups"]}
    assert list(rows) == [1, 2, 3, 4, 5]
    files = [row["file"] for row in rows.values()]
    assert files == ["mug.ply", "mug-2.ply", "mug-3.ply", "con-object.ply", "group-5.ply"]
    assert sorted(p.name for p in folder.iterdir()) == sorted([*files, "groups.json"])
    for group, row in rows.items():
        back = read_ply(folder / row["file"])
        baked = bake(scene, indices=np.flatnonzero(scene.visible & (scene.labels == group)))
        assert row["count"] == len(back) == len(baked)
        assert back.means.tobytes() == baked.means.tobytes()
        box = np.array([baked.means.min(axis=0), baked.means.max(axis=0)])
        assert np.allclose(row["bbox"], box)
    assert rows[5]["name"] == "碗"


def test_chosen_objects_only_and_unassigned_on_request(tmp_path: Path) -> None:
    scene = walk_scene()
    run_stage(export_objects_stage(scene, tmp_path / "o", [0, 2, 99]))
    assert sorted(p.name for p in (tmp_path / "o").iterdir()) == [
        "groups.json",
        "mug.ply",
        "unassigned.ply",
    ]


@pytest.mark.parametrize("form", [SplatFormat.COMPRESSED_PLY, SplatFormat.SPLAT, SplatFormat.SPZ])
def test_the_manifest_names_files_of_the_form_and_no_others(
    tmp_path: Path, form: SplatFormat
) -> None:
    scene = walk_scene()
    run_stage(export_objects_stage(scene, tmp_path))  # files of another form lie there already
    files = listed_files(run_stage(export_objects_stage(scene, tmp_path, form=form)))
    assert len(files) == len(np.unique(scene.labels[exported_indices(scene)])) - 1
    for file in files:
        assert file.name.endswith(form.suffix)
        assert file.name.removesuffix(form.suffix).islower()
        assert len(read_splats(file))


def test_what_objects_lose_is_told_of_those_that_are_written() -> None:
    scene = walk_scene()
    clipped = np.flatnonzero(scene.labels == 2)
    sh = scene.gaussians.sh.copy()
    sh[clipped, 0] = 9.0
    scene.gaussians = replace(scene.gaussians, sh=sh)
    said = {
        groups: " ".join(objects_losses(scene, SplatFormat.SPLAT, groups))
        for groups in ((2,), (5,))
    }
    shown = len(np.intersect1d(clipped, exported_indices(scene)))
    assert f"those of {shown:,} splats" in said[2,]
    assert "out of range" not in said[5,]
    assert "out of range" in " ".join(objects_losses(scene, SplatFormat.SPLAT))
    assert objects_losses(scene, SplatFormat.PLY) == ()


@pytest.mark.parametrize("steps", range(1, 5))
def test_a_cancelled_export_leaves_nothing(steps: int, tmp_path: Path) -> None:
    scene = walk_scene()
    (tmp_path / "out.ply").write_bytes(b"precious")
    writing = export_scene_stage(scene, tmp_path / "out.ply")
    for _ in range(min(steps, 2)):
        next(writing)
    writing.close()
    objects = export_objects_stage(scene, tmp_path / "objects")
    for _ in range(3 * steps):
        next(objects)
    objects.close()
    assert [p.name for p in tmp_path.iterdir()] == ["out.ply"]
    assert (tmp_path / "out.ply").read_bytes() == b"precious"


def test_a_full_disk_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    scene = walk_scene()
    written = len(list(export_objects_stage(scene, tmp_path / "first")))
    assert written > 5
    monkeypatch.setattr(ply, "_pack", full)
    with pytest.raises(GagaError, match=r"full|space"):
        run_stage(export_scene_stage(scene, tmp_path / "out.ply"))
    with pytest.raises(GagaError, match=r"full|space"):
        run_stage(export_objects_stage(scene, tmp_path / "objects"))
    assert [p.name for p in tmp_path.iterdir()] == ["first"]


def test_slugs() -> None:
    assert slug("Blue mug (copy)") == "blue-mug-copy"
    assert slug("../../etc") == "etc"
    assert slug("NUL") == "nul-object"
    assert slug("***") == ""
    assert len(slug("x" * 500)) <= 60
    assert MANIFEST == "groups.json"


def test_a_glb_stands_upright_and_all_of_an_object_lies_in_one_frame(tmp_path: Path) -> None:
    """Splats, mesh, collider and box of a leaning cone whose tip is up."""
    rng = np.random.default_rng(0)
    up = np.array([0.0, 0.6, 0.8])
    side = np.linalg.qr(np.column_stack([up, np.eye(3)[:, :2]]))[0][:, 1:]
    height, turn = rng.uniform(0, 2, 4000), rng.uniform(0, 2 * np.pi, 4000)
    radius = 0.5 * (1 - height / 2)
    means = height[:, None] * up + (radius * [np.cos(turn), np.sin(turn)]).T @ side.T + 3
    some = walk_scene(4000, sh_degree=1).gaussians
    cone = replace(
        some,
        means=means.astype(np.float32),
        log_scales=np.full((4000, 3), np.log(0.04), np.float32),
        logit_opacities=np.full(4000, 5, np.float32),
    )
    scene = Scene.of(cone, np.ones(4000, np.int32))
    options = ExportOptions(up=(0.0, 0.6, 0.8))
    solids = [MeshExport(form, MeshFile.GLB, MeshConfig(24)) for form in MeshForm]
    forms: list[SplatFormat | MeshExport] = [SplatFormat.GLB, *solids]
    boxes = []
    for form in forms:
        manifest = run_stage(export_objects_stage(scene, tmp_path, [1], form=form, options=options))
        path = tmp_path / f"group-1{form.suffix}"
        gltf = Buffers.of(path.read_bytes(), path)
        points = gltf.accessor(0, 3).astype(np.float64)
        lo, hi = points.min(axis=0), points.max(axis=0)
        boxes.append(np.concatenate([lo, hi]))
        top = points[points[:, 1] > lo[1] + 0.75 * (hi[1] - lo[1])]
        if form != solids[-1]:  # a box has no tip
            assert np.ptp(top[:, 0]) < 0.5 * (hi[0] - lo[0]), "the tip is above"
    assert manifest.is_file()
    assert boxes[0][4] - boxes[0][1] == pytest.approx(2.0, abs=0.1)
    for box in boxes[1:]:
        np.testing.assert_allclose(box, boxes[0], atol=0.12)
    as_trained = replace(options, as_trained=True)
    run_stage(export_scene_stage(scene, tmp_path / "a.glb", options=as_trained))
    np.testing.assert_allclose(read_splats(tmp_path / "a.glb").means, cone.means, atol=1e-5)
    run_stage(export_scene_stage(scene, tmp_path / "a.ply", options=options))
    assert np.array_equal(read_splats(tmp_path / "a.ply").means, cone.means)


@pytest.mark.parametrize("form", PACKED)
@pytest.mark.parametrize("n_objects", [1, 12])
def test_what_is_said_of_the_size_of_a_file_is_its_size(
    tmp_path: Path, form: SplatFormat, n_objects: int
) -> None:
    """Whether most of its colors are the same from every side or not, and whatever is listed; a web
    page was said to be one and a half times as large."""
    some = walk_scene(60_000, sh_degree=2).gaussians
    plain = some.sh.copy()
    plain[:, 1:] = 0
    labels = np.arange(len(some), dtype=np.int32) // 500 % n_objects + 1
    for splats in (some, replace(some, sh=plain)):
        rows = np.arange(len(splats), dtype=np.int32)
        path = tmp_path / f"a{form.suffix}"
        run_stage(export_scene_stage(Scene.of(splats, labels), path, form=form))
        said = sampled_bytes(splats, rows, len(rows), ExportOptions(), form, n_objects)
        assert said == pytest.approx(path.stat().st_size, rel=0.2)


def test_solids_stand_for_objects_in_the_place_and_size_of_the_files(tmp_path: Path) -> None:
    """A collider holds every centre of a box of splats; what is flat is left out, and named."""
    rng = np.random.default_rng(0)
    scene = walk_scene(300)
    labels = np.repeat([1, 2, 3], 100).astype(np.int32)
    means = rng.uniform(-1, 1, (300, 3)).astype(np.float32) + 3
    means[labels == 2, 2] = 0
    scene = Scene.of(replace(scene.gaussians, means=means), labels)
    options = ExportOptions(scale=2.0, up=(0.0, 0.6, 0.8))
    for form in (MeshForm.BOX, MeshForm.COLLIDER):
        how = MeshExport(form, MeshFile.OBJ, MeshConfig(8))
        folder = tmp_path / form
        manifest = run_stage(export_objects_stage(scene, folder, [1, 2], form=how, options=options))
        content = json.loads(manifest.read_text(encoding="utf-8"))
        assert content["form"] == form
        assert content["units"] == 2
        assert content["up"] == [0.0, 0.6, 0.8]
        assert content["groups"][0]["file"] == f"group-1.{form}.obj"
        lines = (folder / content["groups"][0]["file"]).read_text(encoding="utf-8").splitlines()
        corners = np.array([line.split()[1:4] for line in lines if line[0] == "v"], float)
        inner = np.percentile(2 * means[labels == 1], [5, 95], axis=0)
        assert (corners.min(axis=0) < inner[0]).all()
        assert (corners.max(axis=0) > inner[1]).all()
        assert np.abs(corners - 6).max() < 4
    assert objects_losses(scene, MeshExport())[0].startswith("A mesh is a solid")
    clear = replace(scene.gaussians, logit_opacities=np.full(300, -9, np.float32))
    scene = Scene.of(clear, labels)
    collider = MeshExport(MeshForm.COLLIDER, MeshFile.GLB, MeshConfig(8))
    content = json.loads(
        run_stage(export_objects_stage(scene, tmp_path / "c", form=collider)).read_text("utf-8")
    )
    assert content["left_out"] == ["group 2"], "flat"
    assert sorted(path.name for path in (tmp_path / "c").iterdir()) == [
        "group-1.collider.glb",
        "group-3.collider.glb",
        "groups.json",
    ]
    mesh = MeshExport(MeshForm.MESH, MeshFile.GLB, MeshConfig(8))
    with pytest.raises(GagaError, match="None of these objects has a surface"):
        run_stage(export_objects_stage(scene, tmp_path / "d", form=mesh))


_FORMS: list[SplatFormat | MeshExport] = [
    *SplatFormat,
    *(MeshExport(form, file, MeshConfig(12)) for form in MeshForm for file in MeshFile),
]


@pytest.mark.parametrize("decimate", [1.0, 0.3])
@pytest.mark.parametrize("form", _FORMS, ids=lambda form: getattr(form, "suffix", str(form)))
def test_an_export_tells_one_share_that_never_falls_and_ends_whole(
    form: SplatFormat | MeshExport, decimate: float, tmp_path: Path
) -> None:
    """Of the scene and of its objects, in every form, whatever steps it has."""
    n, options = 1500, ExportOptions(decimate=decimate)
    scene = Scene.of(random_gaussians(n, sh_degree=1), np.arange(n, dtype=np.int32) // 500)
    moved = random_affine(np.random.default_rng(0))
    History(scene).do(edits.transform(scene, np.arange(700), moved))
    stages: list[Stage[Any]] = [
        export_objects_stage(scene, tmp_path / "out", form=form, options=options)
    ]
    if isinstance(form, SplatFormat):
        path = tmp_path / f"scene{form.suffix}"
        stages.append(export_scene_stage(scene, path, form=form, options=options))
    for stage in stages:
        words: list[Progress] = []
        run_stage(stage, words.append)
        assert falls(words) == []
        assert shares(words)[0] < 0.5
        assert shares(words)[-1] == pytest.approx(1)


def test_the_bar_moves_while_edits_are_applied(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That is a fifth of the time of a .ply of many moved splats, which stood at 0 %."""
    monkeypatch.setattr("gaga_core.scene.bake._CHUNK", 100)
    scene = Scene.of(random_gaussians(1000))
    moved = random_affine(np.random.default_rng(0))
    History(scene).do(edits.transform(scene, np.arange(1000), moved))
    words: list[Progress] = []
    run_stage(export_scene_stage(scene, tmp_path / "scene.ply"), words.append)
    assert falls(words) == []
    baked = shares([word for word in words if word.message.startswith("Apply edits")])
    assert len(set(baked)) == 11
    assert 0.1 < baked[-1] < 0.3


@pytest.mark.parametrize("form", [*MeshForm, SplatFormat.PLY, "merged"])
def test_the_bar_moves_while_an_object_is_written_and_never_back(form: Any, tmp_path: Path) -> None:
    n = 3000
    scene = Scene.of(random_gaussians(n), np.arange(n, dtype=np.int32) // (n // 2) + 1)
    how = MeshExport(form, config=MeshConfig(16)) if form in list(MeshForm) else SplatFormat.PLY
    options = ExportOptions(decimate=0.3 if form == "merged" else 1.0)
    steps = list[Progress]()
    stage = export_objects_stage(scene, tmp_path / "out", form=how, options=options)
    run_stage(stage, steps.append)
    shares = [step.done / step.total for step in steps]
    assert shares == sorted(shares)
    assert shares[-1] <= 1
    if form not in (MeshForm.BOX, SplatFormat.PLY):  # those take no time
        for k in (0, 1):
            assert len({share for share in shares if k / 2 < share < (k + 1) / 2}) > 1


def test_each_file_is_described_by_the_export_that_wrote_it_last(tmp_path: Path) -> None:
    """Over any order of exports into one folder, each file is in one manifest, with its count."""
    scene = walk_scene()
    ids = np.unique(scene.labels[scene.labels > 0]).tolist()
    rng = np.random.default_rng(3)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "groups-3.json").write_text("{}")  # not ours: stays
    last: dict[str, tuple[str, float]] = {}
    for _ in range(12):
        form = [SplatFormat.PLY, SplatFormat.SPZ][rng.integers(2)]
        some = rng.choice(ids, rng.integers(1, len(ids) + 1), replace=False).tolist()
        scale = float(rng.uniform(1, 2))
        options = ExportOptions(scale=scale)
        manifest = run_stage(
            export_objects_stage(scene, tmp_path / "out", some, form=form, options=options)
        )
        last.update({path.name: (manifest.name, scale) for path in listed_files(manifest)})
    described = [
        (entry.file, (path.name, read_manifest(path).units))
        for path in manifests_in(tmp_path / "out")
        if path.name != "groups-3.json"
        for entry in read_manifest(path).groups
    ]
    assert sorted(described) == sorted(last.items())
    written = {path.name for path in (tmp_path / "out").iterdir() if path.suffix != ".json"}
    assert written == set(last)
    assert (tmp_path / "out" / "groups-3.json").read_text() == "{}"
