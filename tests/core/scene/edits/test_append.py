"""Splats of other files beside those of the scene: one scene, one undo, one project."""

import gzip
import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from zipfile import ZipFile

import numpy as np
import pytest

from gaga_core.arrays import AnyArray, DoubleArray, IntArray
from gaga_core.edit_script import run_script
from gaga_core.errors import GagaError
from gaga_core.io.files import fingerprint
from gaga_core.io.splats.splat_files import SplatFormat, write_splats
from gaga_core.progress import run_stage
from gaga_core.scene import edits
from gaga_core.scene.bake import bake
from gaga_core.scene.edits import Edit
from gaga_core.scene.edits.history import History
from gaga_core.scene.edits.splats import append_made, regrouped, spread
from gaga_core.scene.edits.values import read_added_stage
from gaga_core.scene.objects import group_name
from gaga_core.scene.orientation import degrees_of, pose_of
from gaga_core.scene.project import Project, open_path_stage, save_project
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection.algebra import world_means
from tests.core.scene.edits.edit_walk import columns, snapshot
from tests.core.scene.projects import assert_same
from tests.scenes import random_gaussians


@pytest.fixture
def room(tmp_path: Path) -> Path:
    gaussians = random_gaussians(200, sh_degree=1)
    extra: dict[str, AnyArray] = {
        "group": np.arange(200, dtype=np.int32) % 4,
        "quality": np.ones(200),
    }
    write_splats(tmp_path / "room.ply", replace(gaussians, extra=MappingProxyType(extra)))
    return tmp_path / "room.ply"


@pytest.fixture
def chair(tmp_path: Path) -> Path:
    gaussians = random_gaussians(90, seed=5, sh_degree=2)
    extra = {"obj_dc_0": np.full(90, 2, np.float32)}
    write_splats(tmp_path / "chair.ply", replace(gaussians, extra=MappingProxyType(extra)))
    return tmp_path / "chair.ply"


def opened(path: Path) -> Project:
    return run_stage(open_path_stage(path))


def add(history: History, scene: Scene, path: Path) -> None:
    splats, digest = run_stage(read_added_stage(path))
    assert history.do(edits.append(scene, splats, path, digest))


@pytest.mark.parametrize("degrees", [0.0, 8.0, 25.0, 40.0, 120.0, 180.0])
@pytest.mark.parametrize("form", [SplatFormat.PLY, SplatFormat.SPZ, SplatFormat.GLB])
def test_a_file_is_turned_where_its_format_did_or_both_ups_clearly_differ(
    room: Path, tmp_path: Path, form: SplatFormat, degrees: float
) -> None:
    """Models of the same coordinates, each with an up that was estimated, fitted no more."""
    scene, angle = opened(room).scene, np.radians(degrees)
    up = np.array([0.0, -1.0, 0.0])
    path = tmp_path / f"other{form.suffix}"
    write_splats(path, random_gaussians(50, seed=3).with_up(up), form=form)
    splats, digest = run_stage(read_added_stage(path))
    assert splats.up is not None
    np.testing.assert_allclose(splats.up, up, atol=1e-6)
    of_scene = np.array([np.sin(angle), -np.cos(angle), 0.0])
    assert History(scene).do(edits.append(scene, splats, path, digest, up=3 * of_scene))
    added = world_means(scene)[200:].astype(np.float64)
    turn = np.array(
        [
            [np.cos(angle), -np.sin(angle), 0.0],
            [np.sin(angle), np.cos(angle), 0.0],
            [0.0, 0.0, 1.0],
        ]
    )
    is_turned = form is SplatFormat.GLB or degrees > 30
    wanted = splats.means @ turn.T if is_turned else splats.means
    if degrees == 180:  # about any axis across
        np.testing.assert_allclose(added[:, 1], -splats.means[:, 1], atol=1e-4)
    else:
        np.testing.assert_allclose(added, wanted, atol=1e-4)


def test_added_splats_are_splats_like_all_others(room: Path, chair: Path) -> None:
    scene = opened(room).scene
    history = History(scene)
    add(history, scene, chair)
    assert len(scene) == 290
    g = scene.gaussians
    assert g.sh_degree == 2
    assert not g.sh[:200, 4:].any()
    assert (g.extra["quality"] == np.r_[np.ones(200), np.zeros(90)]).all()
    assert (g.extra["obj_dc_0"] == np.r_[np.zeros(200), np.full(90, 2)]).all()
    group = int(scene.labels[-1])
    assert (scene.labels[200:] == group).all()
    assert group_name(scene, group) == "chair"
    assert group not in scene.labels[:200]
    assert np.array_equal(scene.has(State.SELECTED), np.arange(290) >= 200)
    assert scene.n_opened == 200


def test_undo_takes_every_bit_back_and_redo_brings_it_again(room: Path, chair: Path) -> None:
    scene = opened(room).scene
    history = History(scene)
    states = [(snapshot(scene), scene.added)]
    for step in range(3):
        if step == 1:
            history.do(edits.duplicate(scene, np.arange(195, 205)))
        else:
            add(history, scene, chair if step == 0 else room)
        states.append((snapshot(scene), scene.added))
    assert scene.n_rows_of_files == 490
    for at in (2, 0, 3, 1):
        history.go_to(at)
        assert (snapshot(scene), scene.added) == states[at]
        assert all(column.flags.c_contiguous for column in columns(scene).values())


def test_it_moves_as_a_whole_on_a_row_of_its_own(room: Path, chair: Path) -> None:
    scene = opened(room).scene
    history = History(scene)
    add(history, scene, chair)
    rows = len(scene.placements)
    before = bake(scene).means
    shift = np.c_[np.eye(3), [5.0, 0, 0]]
    history.do(edits.transform(scene, scene.has(State.SELECTED), shift))
    assert len(scene.placements) == rows  # its own row was changed, none was added
    moved = bake(scene).means - before
    np.testing.assert_allclose(
        moved, np.where(np.arange(290)[:, None] < 200, 0, [[5.0, 0, 0]]), atol=1e-5
    )


def test_a_saved_project_brings_all_files_back(room: Path, chair: Path) -> None:
    project = opened(room)
    scene = project.scene
    history = History(scene)
    scene.confidence = np.full(200, 9, np.uint8)
    add(history, scene, chair)
    history.do(edits.duplicate(scene, np.arange(150, 250)))
    history.do(edits.delete(scene, np.arange(180, 220)))
    add(history, scene, chair)
    where = save_project(project)
    back = opened(where).scene
    assert snapshot(back) == snapshot(scene)
    assert [item.path for item in back.added] == [str(_copy_in(where))] * 2
    assert [replace(item, path=str(chair)) for item in back.added] == list(scene.added)
    sure = back.confidence_of()
    assert sure is not None
    assert (sure[:200] == 9).all()
    assert (sure[200:290] == 255).all()
    again = save_project(opened(where))  # and once more, from what was opened
    assert snapshot(opened(again).scene) == snapshot(scene)


def _copy_in(project: Path) -> Path:
    (copy,) = project.glob("added-*/*.ply")
    return copy


@pytest.mark.parametrize("end", ["gone", "changed"])
def test_a_project_keeps_what_was_added(room: Path, chair: Path, end: str) -> None:
    """A file that was only added took all edits of the scene along when it went."""
    project = opened(room)
    history = History(project.scene)
    add(history, project.scene, chair)
    where, before = save_project(project), snapshot(project.scene)
    if end == "gone":
        chair.unlink()
    else:
        write_splats(chair, random_gaussians(90, seed=6))
    assert snapshot(opened(where).scene) == before
    assert save_project(project) == where, "the copy is what the next save names, too"
    assert save_project(opened(where)) == where
    moved = where.rename(where.with_name("elsewhere.gaga"))
    assert snapshot(opened(moved).scene) == before
    other = save_project(opened(moved), where.with_name("other.gaga"))
    shutil.rmtree(moved)
    assert snapshot(opened(other).scene) == before


def test_a_save_elsewhere_takes_the_copy_that_was_made(room: Path, chair: Path) -> None:
    """It was said that the project could not be opened again, next to a copy of the file."""
    project = opened(room)
    add(History(project.scene), project.scene, chair)
    where, before = save_project(project), snapshot(project.scene)
    chair.unlink()
    other = save_project(project, where.with_name("other.gaga"))
    shutil.rmtree(where)
    assert snapshot(opened(other).scene) == before
    assert _copy_in(other).name == chair.name


def test_a_copy_goes_with_what_was_added(room: Path, chair: Path) -> None:
    project = opened(room)
    history = History(project.scene)
    add(history, project.scene, chair)
    where = save_project(project)
    stamp = _copy_in(where).stat().st_mtime_ns
    save_project(project)
    assert _copy_in(where).stat().st_mtime_ns == stamp, "it is made once"
    history.undo()
    save_project(project)
    assert not list(where.glob("added-*"))


def test_a_folder_of_sog_is_kept_whole(room: Path, tmp_path: Path) -> None:
    write_splats(tmp_path / "bowl.sog", random_gaussians(50))
    with ZipFile(tmp_path / "bowl.sog") as archive:
        archive.extractall(tmp_path / "bowl")
    project = opened(room)
    add(History(project.scene), project.scene, tmp_path / "bowl" / "meta.json")
    where, before = save_project(project), snapshot(project.scene)
    shutil.rmtree(tmp_path / "bowl")
    assert snapshot(opened(where).scene) == before


def test_a_project_whose_added_file_is_gone_or_changed_says_so(room: Path, chair: Path) -> None:
    project = opened(room)
    add(History(project.scene), project.scene, chair)
    where = save_project(project)
    text = (where / "project.json").read_text()
    document = json.loads(text)
    document["added"][0]["path"] = str(chair)  # as older projects have it
    (where / "project.json").write_text(json.dumps(document))
    write_splats(chair, random_gaussians(90, seed=6))
    with pytest.raises(GagaError, match=r"chair\.ply changed"):
        opened(where)
    chair.unlink()
    with pytest.raises(GagaError, match="gone"):
        opened(where)
    document["added"][0].pop("fingerprint")
    (where / "project.json").write_text(json.dumps(document))
    with pytest.raises(GagaError, match="damaged"):
        opened(where)


def test_no_two_objects_have_one_name(room: Path, chair: Path) -> None:
    """The same chair twice: each was called "chair", in lists and in exports."""
    scene = opened(room).scene
    history = History(scene)
    for n in (1, 2, 3):
        add(history, scene, chair)
        assert sorted(scene.names.values()) == ["chair", "chair 2", "chair 3"][:n]
    last = max(scene.names)
    assert history.do(edits.rename(scene, last, "Chair 4"))
    add(history, scene, chair)
    assert len({name.casefold() for name in scene.names.values()}) == 4


def test_the_recorded_edit_names_the_file_and_replays_to_the_same(room: Path, chair: Path) -> None:
    scene = opened(room).scene
    history = History(scene)
    add(history, scene, chair)
    history.do(edits.delete(scene, np.arange(250, 290)))
    script = json.loads(json.dumps(history.recorded()))
    assert len(json.dumps(script)) < 20_000  # no splats in it
    replayed = opened(room).scene
    run_script(replayed, script)
    assert snapshot(replayed) == snapshot(scene)
    write_splats(chair, random_gaussians(90, seed=7))
    with pytest.raises(GagaError, match="changed"):
        run_script(opened(room).scene, script)


def test_groups_of_an_association_leave_added_splats_theirs(room: Path, chair: Path) -> None:
    scene = opened(room).scene
    add(History(scene), scene, chair)
    own = int(scene.labels[-1])
    few = spread(scene, np.ones(200, np.int32))
    assert (few[200:] == own).all()
    many = np.arange(200, dtype=np.int32)
    labels, own_ids = regrouped(scene, many)
    assert (labels[:200] == many).all()
    assert labels[200:].min() > 199
    assert own_ids == {int(scene.labels[-1]): int(labels[-1])}


def test_splats_made_as_part_of_an_object_stay_part_of_it_when_groups_change() -> None:
    scene = Scene.of(random_gaussians(40), np.repeat(np.array([1, 2, 0, 5], np.int32), 10))
    history = History(scene)
    history.do(edits.rename(scene, 2, "table"))
    history.do(edits.rename(scene, 9, "rug"))
    made = np.array([2, 2, 2, 9, 0, 0], np.int32)  # 9: no splat of the file is in it
    splats = scene.gaussians.take(np.array([10, 13, 18, 0, 20, 27]))
    history.do(append_made(scene, splats, made, "Fill"))
    found = np.repeat(np.array([3, 12, 0, 12, 4], np.int32), 8)
    found[10:20] = [0, 0, 0, 12, 12, 12, 12, 12, 12, 0]
    labels, own_ids = regrouped(scene, found)
    assert labels[40:43].tolist() == [0, 12, 12], "as the nearest of the table"
    assert labels[43] > found.max()
    assert labels[44:].tolist() == [0, 12], "as the nearest that were in no object"
    assert own_ids == {int(scene.labels[43]): int(labels[43])}


def test_what_is_copied_stays_an_object_of_its_own_when_groups_change() -> None:
    scene = Scene.of(random_gaussians(40), np.repeat(np.array([1, 2, 0, 5], np.int32), 10))
    history = History(scene)
    history.do(edits.duplicate(scene, np.arange(10)))  # a whole object: 40 to 49
    copy = int(scene.labels[40])
    history.do(edits.duplicate(scene, np.arange(10)))  # and again: 50 to 59 ...
    history.do(edits.merge_groups(scene, (5, int(scene.labels[50]))))  # ... put into another one
    history.do(edits.duplicate(scene, np.arange(10, 14)))  # a part, 60 to 63, stays in its object
    history.do(edits.duplicate(scene, np.arange(20, 27)))  # of what is in no object: 64 to 70
    history.do(edits.duplicate(scene, np.arange(20, 27)))  # ... twice: 71 to 77
    found = np.repeat(np.array([copy, 2, 7, 9, 4], np.int32), [10, 10, 5, 5, 10])
    labels, own_ids = regrouped(scene, found)
    assert np.array_equal(labels[:40], found)
    (kept,) = set(labels[40:50].tolist())
    assert own_ids == {copy: kept}
    assert kept not in found
    assert set(labels[50:60].tolist()) == {4}, "part of what it was put into"
    assert set(labels[60:64].tolist()) == {2}
    loose = [set(labels[a : a + 5].tolist()) for a in (64, 71)]  # all of what is found as 7
    assert len(loose[0] | loose[1]) == 2
    assert not (loose[0] | loose[1]) & {*found.tolist(), kept}
    assert labels[69:71].tolist() == labels[76:78].tolist() == [9, 9], "two of five"
    history.do(edits.delete(scene, np.arange(64, 78)))
    assert set(regrouped(scene, found)[0][64:].tolist()) <= {7, 9}, "what is deleted is no object"


def test_groups_of_the_file_become_groups_with_its_name(room: Path, tmp_path: Path) -> None:
    write_splats(tmp_path / "lamp.spz", random_gaussians(10), SplatFormat.SPZ)
    scene = opened(tmp_path / "lamp.spz").scene
    add(History(scene), scene, room)
    names = {group_name(scene, int(g)) for g in np.unique(scene.labels[10:])}
    assert names == {"room", "room 1", "room 2", "room 3"}
    assert scene.added[0].fingerprint == fingerprint(room)


def test_a_script_says_how_an_added_file_was_read_and_an_older_one_took_other_axes(
    room: Path, tmp_path: Path
) -> None:
    lamp = tmp_path / "lamp.spz"
    write_splats(lamp, random_gaussians(10), SplatFormat.SPZ)
    raw = bytearray(gzip.decompress(lamp.read_bytes()))[:-12]  # without the record of its axes
    raw[14] = 0
    lamp.write_bytes(gzip.compress(raw))
    scene = opened(room).scene
    history = History(scene)
    add(history, scene, lamp)
    recorded = json.loads(json.dumps(history.recorded()))
    again = opened(room).scene
    run_script(again, recorded)
    assert snapshot(again) == snapshot(scene)
    for part in recorded[0]["edits"]:
        part.pop("axes", None)
    older = opened(room).scene
    run_script(older, recorded)
    assert older.added[0].axes == "RUB"
    means = scene.gaussians.means[200:]
    np.testing.assert_array_equal(
        older.gaussians.means[200:], means * np.array([1, -1, -1], np.float32)
    )


# --- Splats that came after the scene was moved: reset puts them where they were put.


_N = 40  # splats of each file


def _turn(degrees: float, scale: float, offset: tuple[float, float, float]) -> DoubleArray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.column_stack([scale * np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), offset])


_FIRST, _THEN = _turn(30, 2.0, (1, 0, 3)), _turn(-70, 0.5, (0, 5, 0))


@pytest.fixture
def project(tmp_path: Path) -> Project:
    """A file, another one, a motion of all, a third file and splats that an edit made, and another
    motion: 40 splats each."""
    for seed in range(3):
        write_splats(tmp_path / f"{seed}.ply", random_gaussians(_N, seed=seed, sh_degree=1))
    project: Project = run_stage(open_path_stage(tmp_path / "0.ply"))
    scene = project.scene
    history = History(scene)
    _do(history, _added(scene, tmp_path / "1.ply"))
    _do(history, edits.move_scene(scene, _FIRST, "Move"))
    _do(history, _added(scene, tmp_path / "2.ply"))
    made = random_gaussians(_N, seed=3, sh_degree=1)
    _do(history, append_made(scene, made, np.full(_N, 50, np.int32), "Made"))
    _do(history, edits.move_scene(scene, _THEN, "Move"))
    (tmp_path / "script.json").write_text(json.dumps(history.recorded()))
    return project


def _added(scene: Scene, path: Path) -> Edit | None:
    splats, digest = run_stage(read_added_stage(path))
    return edits.append(scene, splats, path, digest)


def _do(history: History, edit: Edit | None) -> None:
    assert history.do(edit)


def _file(k: int) -> IntArray:
    return np.arange(k * _N, (k + 1) * _N, dtype=np.int32)


def _moved_and_reset(scene: Scene, history: History) -> None:
    """Each file in another way; then all are reset at once."""
    for k in range(4):
        some = _file(k)[: _N // (1 + k % 2)]
        _do(history, edits.transform(scene, some, _turn(20 * k + 5, 3, (k, k, 0))))
    _do(history, edits.reset_placement(scene, np.arange(len(scene))))


def test_reset_puts_each_file_where_it_was_put(project: Project) -> None:
    scene = project.scene
    history, before = History(scene), world_means(scene)
    assert edits.reset_placement(scene, np.arange(len(scene))) is None, "nothing was moved alone"
    _moved_and_reset(scene, history)
    np.testing.assert_allclose(world_means(scene), before, atol=1e-5)
    _do(history, edits.duplicate(scene, _file(2), _turn(0, 1, (9, 0, 0))))
    copy = _file(4)
    _do(history, edits.reset_placement(scene, copy))
    np.testing.assert_allclose(world_means(scene, copy), before[_file(2)], atol=1e-5)


def test_rotation_and_scale_count_from_when_the_file_came(project: Project) -> None:
    scene = project.scene
    for k in range(4):
        pose = pose_of(scene, _file(k), np.zeros(3))
        np.testing.assert_allclose(degrees_of(pose, local=False), 0, atol=1e-9)
        np.testing.assert_allclose(pose.scale, 1, rtol=1e-9)


def test_a_saved_project_and_a_script_know_it(project: Project, tmp_path: Path) -> None:
    before = world_means(project.scene)
    again = run_stage(open_path_stage(save_project(project, tmp_path / "saved.gaga"))).scene
    replayed = run_stage(open_path_stage(tmp_path / "0.ply")).scene
    run_script(replayed, json.loads((tmp_path / "script.json").read_text()))
    for scene in (again, replayed):
        for item, known in zip(scene.added, project.scene.added, strict=True):
            assert replace(item, path=known.path) == known, "but for the copy of the file"
        _moved_and_reset(scene, History(scene))
        np.testing.assert_allclose(world_means(scene), before, atol=1e-5)
    assert_same(again, replayed)


def test_a_frame_that_is_none_is_a_sentence(project: Project, tmp_path: Path) -> None:
    where = save_project(project, tmp_path / "saved.gaga")
    text = (where / "project.json").read_text()
    for frame in ([[1, 0, 0, 0]], [[0, 0, 0, 0]] * 4):
        content = json.loads(text)
        content["added"][1]["frame"] = frame
        (where / "project.json").write_text(json.dumps(content))
        with pytest.raises(GagaError, match="damaged"):
            run_stage(open_path_stage(where))
