"""The search of the open scene: typed words, an index, a detector, names; what is said of them."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import FloatArray, IntArray, UInt8Array
from gaga_core.pipeline.search import train_views
from gaga_core.progress import run_stage
from gaga_core.query.detector import Boxes, DetectConfig, as_boxes
from gaga_core.scene import edits
from gaga_core.scene.edits.objects import name_groups
from gaga_core.scene.objects import group_indices
from gaga_studio.features import object_list, objects, selection, transform
from gaga_studio.features.find import association, click_object
from gaga_studio.features.find import search as search_actions
from gaga_studio.features.find.search import SearchState
from gaga_studio.features.object_list import ListFilter, ObjectListView
from gaga_studio.session.session import Session
from tests.app.looks import describe, names_of, objects_of, scene_of

_SIZE = (640, 480)
_WORDS = {"ruby": (1.0, 0.0, 0.0), "leaf": (0.0, 1.0, 0.0), "sky": (0.0, 0.0, 1.0)}


class _Mean:
    """An embedder of crops by their mean hue, and of words by the color that they name."""

    fingerprint = "mean color"

    def pictures(self, pictures: "list[UInt8Array]") -> FloatArray:
        return _hues([np.asarray(p, np.float32).reshape(-1, 3).mean(axis=0) for p in pictures])

    def texts(self, texts: "list[str]") -> FloatArray:
        named = _WORDS.items()
        return _hues([next((rgb for w, rgb in named if w in t), (0, 0, 0)) for t in texts])


class _Whole:
    """A detector that finds the left half of every picture."""

    def detect(self, picture: UInt8Array, phrase: str, config: DetectConfig) -> Boxes:
        height, width = picture.shape[:2]
        return as_boxes([[0, 0, width / 2, height]], [0.9], (height, width))


def _hues(colors: "Sequence[FloatArray | tuple[float, ...]]") -> FloatArray:
    """Unit vectors (n, 3) of what is not gray in colors."""
    rows = np.array(colors, np.float32)
    rows -= rows.mean(axis=1, keepdims=True)
    length = np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-6)
    result: FloatArray = (rows / length).astype(np.float32)
    return result


def _ask(session: Session, text: str) -> tuple[int, ...]:
    """Type, and wait until everything that runs in parallel is done."""
    search_actions.type_text(session, text, _SIZE)
    search = session.need().feature(SearchState)
    end = time.monotonic() + 60
    search_actions.follow(session)
    search_actions.answer(session, object_list.kept_groups)
    while time.monotonic() < end:
        session.tick(0.01)
        search_actions.follow(session)
        search_actions.answer(session, object_list.kept_groups)
        key = search.key(session.need().scene, train_views(session.need().project))
        is_measured = search.measured is not None and search.measured.key == key
        if is_measured and not search.is_looking_up and session.jobs.quiet is None:
            break
        time.sleep(0.01)
    search_actions.follow(session)
    search_actions.answer(session, object_list.kept_groups)
    return tuple(hit.group for hit in search.hits)


@pytest.fixture
def embedder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> _Mean:
    """A model in its place, whose weights are never read."""
    made = _Mean()
    monkeypatch.setattr(search_actions, "embedder_folder", lambda: tmp_path)
    monkeypatch.setattr(search_actions, "load_embedder", lambda folder: made)
    return made


def test_looks_are_known_before_the_rest_is_measured(associated: Session) -> None:
    """Pictures of objects wait for them alone; names may wait for kernels."""
    document = associated.need()
    search, cameras = SearchState(), train_views(document.project)
    key = search.key(document.scene, cameras)
    assert not search.rests(key)
    stage = search_actions.measure_stage(document.scene, cameras, key, lambda: None, search.take)
    next(stage)
    assert not search.has_looks
    next(stage)
    assert search.has_looks
    assert search.measured is None
    assert search.digest_of(1) is not None
    run_stage(stage)
    assert search.measured is not None


def test_words_find_objects_without_any_model(associated: Session) -> None:
    table = associated.objects()
    groups = _ask(associated, "the largest")
    assert groups
    search = associated.need().feature(SearchState)
    assert search.sentence
    assert len(search.meant) == 1
    by_name = _ask(associated, f"group {table.ids[2]}")
    assert by_name[0] == table.ids[2]
    objects.rename(associated, int(table.ids[2]), "blue teapot")
    assert _ask(associated, "teapot") == (int(table.ids[2]),)
    assert _ask(associated, "eapo") == (int(table.ids[2]),), "a part of a name, too"
    assert _ask(associated, "") == ()


@pytest.mark.parametrize("typed", ["ange", "rang", "range", "orange"])
def test_as_many_are_said_to_be_called_so_as_are_listed(associated: Session, typed: str) -> None:
    """A part of several names was near enough to one of them: one was said, four were listed."""
    ids = [int(group) for group in associated.objects().ids if group > 0]
    names = ("orange thing", "orange round thing", "orange thing on the right", "orange bowl")
    document = associated.need()
    document.do(name_groups(document.scene, dict(zip(ids, names, strict=False))))
    assert set(_ask(associated, typed)) == set(ids[:4])
    assert document.feature(SearchState).sentence.startswith("4 ")


def test_what_is_only_called_so_is_said_beside_what_is_so(associated: Session) -> None:
    """20 white ones were said, and 21 selected."""
    ids = [int(group) for group in associated.objects().ids if group > 0]
    document, search = associated.need(), associated.need().feature(SearchState)
    _ask(associated, "the largest")  # they have descriptions then
    color = document.name_of(ids[0]).split()[0]
    of_color = set(_ask(associated, color)[: len(search.meant)])
    other = next(group for group in ids if group not in of_color)
    document.do(name_groups(document.scene, {other: f"not {color}ish"}))
    _ask(associated, color)
    assert set(search.meant) == of_color | {other}
    numbers = [int(word) for word in search.sentence.split() if word.isdigit()]
    assert sum(numbers) == len(search.meant)


def test_a_preview_that_waits_is_searched_as_before(associated: Session) -> None:
    """Nothing was found, and nothing was said."""
    group = int(associated.objects().ids[-1])
    objects.rename(associated, group, "bot")
    document, before = associated.need(), _ask(associated, "bot")
    selection.select_groups(associated, (group,))
    edit = edits.delete(document.scene, associated.selected_indices())
    assert edit is not None
    document.show(edit, waits_as="Clean up")
    search = document.feature(SearchState)
    for text in ("", "bot"):
        search_actions.type_text(associated, text, _SIZE)
    search_actions.answer(associated, object_list.kept_groups)
    assert search.meant == before == (group,)


def test_the_filter_of_the_list_leaves_out_answers_and_says_how_many(associated: Session) -> None:
    table, document = associated.objects(), associated.need()
    ids = [int(group) for group in table.ids if group > 0]
    document.do(name_groups(document.scene, dict.fromkeys(ids[:3], "mug")))
    assert set(_ask(associated, "mug")) == set(ids[:3])
    counts = {int(g): float(n) for g, n in zip(table.ids, table.counts, strict=True)}
    chosen = counts[ids[1]]
    fit = {group for group in ids[:3] if counts[group] == chosen}
    document.feature(ObjectListView).filter = ListFilter({"splats": (chosen, chosen)})
    assert set(_ask(associated, "mug")) == fit
    assert document.feature(SearchState).n_left_out == 3 - len(fit) > 0
    assert search_actions.take_all(associated)
    assert set(associated.selected_groups()) == fit, "Enter takes what is shown"
    document.feature(ObjectListView).filter = ListFilter({"splats": (0.0, 0.0)})
    assert _ask(associated, "mug") == ()
    assert document.feature(SearchState).n_left_out == 3
    document.feature(ObjectListView).filter = ListFilter()
    search_actions.follow(associated)
    search_actions.answer(associated, object_list.kept_groups)
    assert set(document.feature(SearchState).meant) == set(ids[:3]), "all again, without typing"
    assert document.feature(SearchState).n_left_out == 0


def test_enter_selects_the_best_and_arrows_move(associated: Session) -> None:
    groups = _ask(associated, "objects")
    groups = groups or _ask(associated, "group")
    assert len(groups) > 2
    before = associated.rig.pose
    assert search_actions.take_hit(associated)
    assert associated.selected_groups() == (groups[0],)
    assert associated.rig.is_moving or associated.rig.pose != before
    search = associated.need().feature(SearchState)
    search.move(-1)
    assert search.at == 0
    search.move(1)
    assert search_actions.take_hit(associated, flies=False)
    assert associated.selected_groups() == (groups[1],)
    search.move(1000)
    assert search.at == len(groups) - 1


def test_shift_enter_selects_all_that_fit_and_no_other(associated: Session) -> None:
    ids = [int(group) for group in associated.objects().ids if group > 0]
    associated.need().do(name_groups(associated.need().scene, dict.fromkeys(ids[:3], "mug")))
    selection.select_groups(associated, (ids[4],))
    _ask(associated, "mug")
    assert set(associated.need().feature(SearchState).meant) == set(ids[:3])
    assert search_actions.take_all(associated)
    assert set(associated.selected_groups()) == set(ids[:3]), "as many as the button says"
    _ask(associated, "zebra")
    assert not search_actions.take_all(associated)


def test_selecting_measures_nothing_again_but_editing_does(associated: Session) -> None:
    groups = _ask(associated, "the largest")
    search, scene = associated.need().feature(SearchState), associated.need().scene
    cameras = train_views(associated.need().project)
    key, found = search.key(scene, cameras), search.measured
    selection.select_groups(associated, (groups[0],))
    assert search.key(scene, cameras) == key
    _ask(associated, "the smallest")
    assert search.measured is found
    objects.delete(associated)
    assert search.key(scene, cameras) != key
    assert groups[0] not in _ask(associated, "the largest")
    associated.undo()
    assert _ask(associated, "the largest") == groups


def _half(session: Session) -> IntArray:
    """Every second selected splat."""
    return session.selected_indices()[::2]


def _paint(session: Session) -> bool:
    return transform.recolor(session, (0.9, 0.1, 0.9))


def _grow(session: Session) -> bool:
    return transform.move(session, np.diag([3.0, 3.0, 3.0, 1.0]))


def _away(session: Session) -> bool:
    matrix = np.eye(4)
    matrix[:3, 3] = 4, 3, 2
    return transform.move(session, matrix)


def _next(session: Session) -> int:
    """An object that is not selected."""
    others = set(session.objects().ids.tolist()) - {0, *session.selected_groups()}
    return min(others)


def _merge(session: Session) -> bool:
    return session.edit(
        lambda s: edits.merge_groups(s, (*session.selected_groups(), _next(session)))
    )


def _find_again(session: Session) -> bool:
    association.associate(session, preset="robust")
    return session.jobs.wait()


_EDITS: dict[str, Callable[[Session], bool]] = {
    "recolor": _paint,
    "scale": _grow,
    "move": _away,
    "merge": _merge,
    "delete": objects.delete,
    "hide": objects.hide,
    "duplicate": transform.duplicate,
    "separate": lambda s: s.edit(lambda scene: edits.separate(scene, _half(s))),
    "assign": lambda s: objects.assign(s, _next(s), _half(s)),
    "unassign": lambda s: objects.assign(s, 0, _half(s)),
    "delete a part": lambda s: s.edit(lambda scene: edits.delete(scene, _half(s))),
    "rename": lambda s: objects.rename(s, s.selected_groups()[0], "kettle"),
    "name as another": lambda s: objects.rename(
        s, s.selected_groups()[0], s.need().name_of(_next(s))
    ),
    "find again": _find_again,
}


@pytest.mark.parametrize("edit", list(_EDITS))
def test_undo_and_redo_bring_back_what_objects_were_called(associated: Session, edit: str) -> None:
    """Descriptions of the edited scene stayed where they were still true."""
    session = associated
    describe(session)
    for group in [g for g in session.objects().ids.tolist() if g > 0][:3]:
        selection.select_groups(session, (group,))
        before, n = describe(session), session.need().history.cursor
        assert _EDITS[edit](session)
        after = describe(session)
        while session.need().history.cursor > n:
            assert session.undo()
        search_actions.follow(session)
        assert names_of(session) == before, "in the first frame"
        assert describe(session) == before, "and when all is measured again"
        while session.redo():
            pass
        assert describe(session) == after
        while session.need().history.cursor > n:
            session.undo()


def test_what_loses_the_name_that_it_came_with_is_described(associated: Session) -> None:
    """It was called by its number until something else changed."""
    session = associated
    group = next(g for g in session.objects().ids.tolist() if g > 0)
    assert objects.rename(session, group, "mug")
    session.need().feature(SearchState).measured = None  # as in a project that is opened
    assert describe(session)[group] == "mug"
    assert objects.rename(session, group, "")
    assert not describe(session)[group].startswith("group")


def test_the_title_of_an_edit_has_no_number_of_a_group_whose_name_comes_later(
    associated: Session,
) -> None:
    """It stayed "Select group 47" where the list says "orange object" a second later."""
    document, group = associated.need(), int(associated.objects().ids[1])
    assert not document.scene.described
    selection.select_groups(associated, (group,))
    assert document.undo_title == "Select an object"
    name = describe(associated)[group]
    selection.select_groups(associated, ())
    selection.select_groups(associated, (group,))
    assert document.undo_title == f"Select {name}"


def test_a_search_ends_with_its_scene(associated: Session, scene_folder: Path) -> None:
    _ask(associated, "the largest")
    associated.open(scene_folder)
    assert associated.jobs.wait()
    assert associated.need().feature(SearchState).text == ""


def test_without_a_model_every_step_says_where_to_put_one(
    associated: Session, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("GAGA_MODELS", str(tmp_path / "models"))
    monkeypatch.setenv("HF_HOME", str(tmp_path / "hub"))
    for reason in (
        search_actions.no_embedder(),
        search_actions.no_detector(),
        search_actions.no_index(associated),
    ):
        assert str(tmp_path / "models") in reason
        assert "MB" in reason
    assert "without" in search_actions.index_state(associated)
    assert str(tmp_path / "models") in search_actions.index_state(associated)


def test_the_color_of_a_selection_stays_whatever_it_is_called_and_wherever_it_is(
    associated: Session,
) -> None:
    """Part of one object and of the next: made an object, turned, moved, with the scene, and
    described after each. A recolor lands on what was chosen by it."""
    sh = scene_of(associated).gaussians.sh
    sh[:, 0] = np.random.default_rng(0).uniform(-1.5, 1.5, (len(sh), 3))
    first, second = (group_indices(scene_of(associated), k) for k in objects_of(associated)[:2])
    associated.need().select(np.concatenate([first[::2], second[: len(second) // 2]]))
    kept = transform.selected_color(associated)
    turned = transform.motion(np.ones(3), (0.3, 0, 0.1), (20, 90, 40), (2.0, 1.0, 0.5))
    whole = transform.motion(np.zeros(3), (1, 0, 0), (90, 0, 30), 2.0)
    changes: tuple[Callable[[], bool], ...] = (
        lambda: click_object.make_object(associated),
        lambda: transform.move(associated, turned),
        lambda: associated.need().do(edits.move_scene(scene_of(associated), whole, "Turn")),
        lambda: transform.duplicate(associated),
    )
    for change in changes:
        assert change()
        _ask(associated, "object")
        np.testing.assert_allclose(transform.selected_color(associated), kept, atol=0.001)
    transform.recolor(associated, (0.1, 0.2, 0.8))
    np.testing.assert_allclose(transform.selected_color(associated), (0.1, 0.2, 0.8), atol=0.01)


def test_an_index_finds_any_noun_and_says_what_it_no_longer_knows(
    associated: Session, embedder: _Mean
) -> None:
    search_actions.index(associated)
    assert associated.jobs.wait()
    assert associated.notices[-1].level == "info", associated.notices
    best = _ask(associated, "leaf")[0]
    found = associated.need().feature(SearchState).measured
    assert found is not None
    rgb = found.facts.rgb
    greens = rgb[:, 1] - np.maximum(rgb[:, 0], rgb[:, 2])
    assert found.facts.row(best) in np.argsort(-greens)[:2]
    assert "knows all" in search_actions.index_state(associated)
    selection.select_groups(associated, (best,))
    transform.move(associated, np.array([[1.0, 0, 0, 0.3], [0, 1, 0, 0], [0, 0, 1, 0]]))
    _ask(associated, "leaf")
    assert search_actions.index_state(associated).startswith("1 has changed")
    search_actions.index(associated)
    assert associated.jobs.wait()
    _ask(associated, "leaf")
    assert "knows all" in search_actions.index_state(associated)


def test_a_cancelled_index_leaves_the_former_one(associated: Session, embedder: _Mean) -> None:
    search_actions.index(associated)
    associated.jobs.cancel()
    assert associated.jobs.wait()
    assert search_actions.no_index(associated)


def test_objects_are_named_in_one_edit(associated: Session, embedder: _Mean) -> None:
    search_actions.index(associated)
    assert associated.jobs.wait()
    history = associated.history
    assert history is not None
    before, names = history.cursor, dict(associated.need().scene.names)
    search_actions.name_all(associated)
    assert associated.jobs.wait()
    assert history.cursor - before in (0, 1)
    if history.cursor > before:
        associated.need().undo()
    assert associated.need().scene.names == names


def test_naming_many_is_one_edit_that_reverts(associated: Session) -> None:
    document = associated.need()
    ids = [int(group) for group in associated.objects().ids if group > 0]
    assert document.do(name_groups(document.scene, {ids[0]: "mug", ids[1]: " big  bowl "}))
    assert document.scene.names == {ids[0]: "mug", ids[1]: "big bowl"}
    assert associated.undo() == "Name objects"
    assert document.scene.names == {}
    assert name_groups(document.scene, {}) is None


def test_a_detector_answers_for_this_view_until_something_else_is_typed(
    associated: Session, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    _ask(associated, "thing")
    search = associated.need().feature(SearchState)
    search.detector = _Whole()
    monkeypatch.setattr(search_actions, "detector_folder", lambda: tmp_path)
    assert search_actions.no_question(associated) == ""
    search_actions.find_here(associated, _SIZE)
    assert associated.jobs.wait()
    search_actions.follow(associated)
    search_actions.answer(associated, object_list.kept_groups)
    assert search.in_view == "thing"
    assert "thing" in search.sentence
    _ask(associated, "the largest")
    assert search.in_view == ""
    assert len(search.meant) == 1


def test_a_failing_model_is_said_once(associated: Session, embedder: _Mean) -> None:
    search_actions.index(associated)
    assert associated.jobs.wait()
    _ask(associated, "ruby")
    search = associated.need().feature(SearchState)
    search.know(("leaf",), "The model cannot be read.")
    assert search.problem
    assert not search.is_looking_up
    _ask(associated, "sky")
    assert not search.problem
