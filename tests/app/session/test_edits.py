"""The session: clicks, edits of the selection, and the whole walk without a window."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.color import rgb_from_dc
from gaga_core.export.export import export_scene_stage
from gaga_core.io.splats.ply import read_ply
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.scene import edits
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.algebra import world_means
from gaga_core.scene.tint import mean_color
from gaga_studio.features import export, objects, selection, transform
from gaga_studio.features.find import association
from gaga_studio.features.transform import shift
from gaga_studio.session.notices import Level
from gaga_studio.session.session import Session
from gaga_studio.ui.panels import inspector
from tests.app.looks import finish, objects_of, scene_of, snapshot

_W, _H = 320, 240


# --- picking


def test_a_swatch_has_the_color_that_is_seen(session: Session) -> None:
    """Small splats inside of a thing do not darken it, and faint ones count little."""
    made, rows = scene_of(session).gaussians, np.arange(40)
    scales, logits, sh = (np.zeros_like(a[:40]) for a in (
        made.log_scales, made.logit_opacities, made.sh
    ))  # fmt: skip
    scales[1:20], logits[0], logits[20:], sh[0] = -4, 4, -9, 1.0
    seen = Scene.of(replace(made.take(rows), log_scales=scales, logit_opacities=logits, sh=sh))
    assert np.abs(mean_color(seen, rows) - mean_color(seen, rows[:1])).max() < 0.02


def test_a_click_takes_the_group_of_greatest_weight(associated: Session) -> None:
    scene, rng = scene_of(associated), np.random.default_rng(1)
    raster = choose("cpu")
    camera = associated.rig.camera(_W, _H)
    for _ in range(40):
        x, y = int(rng.integers(_W)), int(rng.integers(_H))
        pixel = np.array([y * _W + x], np.int64)
        row = raster.weights(scene.gaussians, camera, pixel)
        votes = np.bincount(scene.labels[row.indices], weights=row.weights, minlength=1)
        group = selection.click(associated, x + 0.5, y + 0.5, _W, _H)
        assert group == votes.argmax()
        assert associated.selected_groups() == ((group,) if group else ())


# --- the walk


def _colors(gaussians_sh: FloatArray) -> FloatArray:
    return rgb_from_dc(gaussians_sh[:, 0])


def test_the_whole_walk(
    session: Session, new_session: Callable[[], Session], scene_folder: Path, tmp_path: Path
) -> None:
    association.associate(session)
    finish(session)
    scene = scene_of(session)
    red_one, bowl, doomed = objects_of(session)[:3]
    selection.select_groups(session, (red_one,))
    objects.rename(session, red_one, "red mug")
    objects.isolate(session)
    assert set(np.unique(scene.labels[scene.visible])) == {red_one}
    objects.show_all(session)
    selection.select_groups(session, (red_one,))
    transform.preview_recolor(session, (0.2, 0.4, 0.9))
    transform.recolor(session, (0.9, 0.1, 0.1))
    np.testing.assert_allclose(
        mean_color(scene, group_indices(scene, red_one)), [0.9, 0.1, 0.1], atol=0.02
    )
    start = world_means(scene, group_indices(scene, red_one))
    transform.move(session, shift(np.array([0.0, 0.0, 0.5])))
    moved = world_means(scene, group_indices(scene, red_one))
    np.testing.assert_allclose(moved - start, np.tile([0, 0, 0.5], (len(start), 1)), atol=1e-6)
    transform.duplicate(session)
    (copy,) = session.selected_groups()
    assert session.need().name_of(copy) == "red mug 2"
    selection.select_groups(session, (doomed,))
    objects.delete(session)
    selection.select_groups(session, (bowl,))
    objects.hide(session)

    final = snapshot(scene)
    n_edits = len(session.history.entries()) if session.history else 0
    while session.undo() is not None:
        pass
    assert not session.unsaved
    for _ in range(n_edits):
        assert session.redo() is not None
    assert snapshot(scene) == final

    target = tmp_path / "out" / "scene.ply"
    run_stage(export_scene_stage(scene, target, what="visible", groups=True))
    written = read_ply(target)
    assert len(written) == int(scene.visible.sum())
    groups = written.extra["group"]
    assert {doomed, bowl}.isdisjoint(groups.tolist())
    assert {red_one, copy} <= set(groups.tolist())
    reds = _colors(written.sh)[groups == red_one]
    np.testing.assert_allclose(reds.mean(axis=0), [0.9, 0.1, 0.1], atol=0.03)

    selection.select_groups(session, (copy,))
    export.export(session, "selected", tmp_path / "copy.ply")
    finish(session)
    assert len(read_ply(tmp_path / "copy.ply")) == len(group_indices(scene, copy))
    export.export(session, "objects", tmp_path / "objects")
    finish(session)
    assert sorted(p.name for p in (tmp_path / "objects").iterdir()) == [
        "groups.json",
        "red-mug-2.ply",
    ]

    session.save()
    finish(session)
    again = new_session()
    again.open(scene_folder)
    finish(again)
    assert snapshot(scene_of(again)) == snapshot(scene)
    assert again.need().name_of(red_one) == "red mug"
    assert len(again.decisions(red_one)) == len(session.decisions(red_one)) > 0
    assert not again.unsaved


def test_edits_need_a_selection(associated: Session) -> None:
    for act in (
        objects.delete,
        objects.hide,
        objects.isolate,
        objects.lock,
        transform.duplicate,
    ):
        before = associated.notices
        assert not act(associated)
        (notice,) = (one for one in associated.notices if one not in before)
        assert notice.level is Level.HINT, "a hint, nothing went wrong"
        assert "Nothing is selected" in notice.text
    assert associated.history is not None
    assert not associated.history.can_undo


def test_eye_lock_and_solo_of_the_list(associated: Session) -> None:
    scene = scene_of(associated)
    group, other = objects_of(associated)[:2]
    objects.set_hidden(associated, group, True)
    assert not scene.visible[group_indices(scene, group)].any()
    objects.set_hidden(associated, group, False)
    objects.set_locked(associated, group, True)
    selection.select_groups(associated, (group,))
    assert associated.selected_groups() == ()
    objects.set_locked(associated, group, False)
    objects.isolate_item(associated, other)
    assert set(np.unique(scene.labels[scene.visible])) == {other}
    objects.isolate_item(associated, other)
    assert scene.visible.all()


def test_merge_and_invert(associated: Session) -> None:
    scene = scene_of(associated)
    first, second = objects_of(associated)[:2]
    n = int(np.isin(scene.labels, [first, second]).sum())
    selection.select_groups(associated, (first, second))
    objects.merge(associated)
    assert int((scene.labels == first).sum()) == n
    selection.select_inverse(associated)
    assert first not in associated.selected_groups()
    selection.select_all(associated)
    assert len(associated.selected_indices()) == len(scene)


def test_inspector_follows_the_selection_through_undo(associated: Session) -> None:
    first, second = objects_of(associated)[:2]
    selection.select_groups(associated, (first,))
    selection.select_groups(associated, (second,))
    assert associated.focus == second
    associated.undo()
    assert associated.focus == first


def test_hovering_names_the_object_under_the_resting_mouse(associated: Session) -> None:
    group = 0
    for x in range(10, _W, 20):
        found = associated.pick(x + 0.5, _H / 2 + 0.5, _W, _H)
        if found is not None and found.group:
            group = found.group
            break
    assert group
    end = time.monotonic() + 10
    while associated.hovered_group == 0 and time.monotonic() < end:
        associated.hover(x + 0.5, _H / 2 + 0.5, _W, _H)
        associated.tick(0.01)
        time.sleep(0.01)
    assert associated.hovered_group == group
    associated.rig.go_to(associated.cameras[3])
    associated.tick(0.01)
    assert associated.hovered_group == 0


def test_an_edit_of_parts_is_called_so(associated: Session) -> None:
    """A brush of single splats had "Delete 12 objects" in the history, of which 12 stayed."""
    document, ids = associated.need(), associated.objects().ids[1:3]
    one, other = (group_indices(document.scene, int(group)) for group in ids)
    document.select(np.append(one, other), "set", "Select")
    assert document.title_for("Delete") == "Delete 2 objects"
    document.select(np.append(one[:1], other[:4]), "set", "Select")
    assert document.title_for("Delete") == "Delete 5 splats of 2 objects"
    document.select(other[:1], "set", "Select")
    assert document.title_for("Delete") == f"Delete 1 splat of {document.titled(int(ids[1]))}"


def test_one_view_is_no_views(associated: Session) -> None:
    """An object of one photo was "seen in 1 views"."""
    document, group = associated.need(), objects_of(associated)[0]
    assert document.scene.bank is not None
    log = document.scene.bank.log
    own = [one for one in log if one.group == group]
    for n in (1, 2):
        kept = tuple(one for one in log if one.group != group) + tuple(own[:n])
        document.scene.bank = replace(document.scene.bank, log=kept)
        document.scene.revision.labels += 1  # as any change of the bank is
        document.select(group_indices(document.scene, group), "set", "Select")
        _, facts = inspector.title(associated, document)
        assert facts[-1] == ("seen in 1 photo" if n == 1 else "seen in 2 photos")


def test_loose_splats_next_to_those_of_objects_are_told_apart(associated: Session) -> None:
    """A rectangle over the tip of a robot and the ground was "robot, 6,049 splats"."""
    document, (group, other) = associated.need(), objects_of(associated)[:2]
    own = group_indices(document.scene, group)
    loose = group_indices(document.scene, other)[:3]
    document.edit(lambda scene: edits.set_labels(scene, loose, 0, "Take out"))
    name, whole = document.name_of(group), f"{len(own):,} splats"
    titled = document.titled(group)

    def named(*splats: IntArray) -> tuple[str, str, list[str]]:
        document.select(np.concatenate(splats), "set", "Select")
        title, facts = inspector.title(associated, document)
        return document.title_for("Delete"), title, [f for f in facts if "seen in" not in f]

    mixed = f"{name} and loose splats"
    assert named(own) == (f"Delete {titled}", name, [whole])
    assert named(own[:2], loose) == (
        f"Delete 2 splats of {titled} and 3 loose splats",
        mixed,
        ["2 splats", f"of {len(own):,}", "3 loose splats"],
    )
    assert named(own, loose[:1]) == (
        f"Delete {titled} and 1 loose splat", mixed, [whole, "1 loose splat"],
    )  # fmt: skip
    assert named(loose) == ("Delete splats", "Loose splats", ["3 splats"])
    both = np.append(own, group_indices(document.scene, other))
    assert named(both, loose)[1:] == (
        "2 objects and loose splats", [f"{len(both):,} splats", "3 loose splats"],
    )  # fmt: skip
    assert named(both[:-1], loose)[1] == "Parts of 2 objects and loose splats"
