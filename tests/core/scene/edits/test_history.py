"""Undo is exact: random walks against snapshots."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray, IntArray, LongArray
from gaga_core.scene import edits
from gaga_core.scene.edits import Edit, Edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.scene import Scene, State
from tests.core.scene.edits.edit_walk import Snapshot, builders, columns, snapshot, walk_scene


class _Walk:
    """A history beside the snapshots that it must meet: ``past[i]`` after i entries."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.scene = walk_scene(seed=seed)
        self.history = History(self.scene)
        self.past = [snapshot(self.scene)]
        self.kinds = list(builders().items())
        self.seen: set[str] = set()
        self.n_kept = 0  # undone entries that selections have left

    def build(self) -> Edit | None:
        name, build = self.kinds[self.rng.integers(len(self.kinds))]
        edit = build(self.rng, self.history.base)
        if edit is not None:
            self.seen.add(name)
        return edit

    def do(self) -> None:
        self._do(self.build())

    def select(self) -> None:
        self._do(builders()["select"](self.rng, self.history.base))

    def _do(self, edit: Edit | None) -> None:
        undone = self.undone()
        if self.history.do(edit):
            self._entered(snapshot(self.scene), undone)

    def preview(self) -> None:
        for _ in range(self.rng.integers(1, 4)):
            self.history.preview(self.build())
        previewed, undone = snapshot(self.scene), self.undone()
        if self.rng.random() < 0.5:
            self.history.preview(None)
        elif self.history.commit_preview():
            self._entered(previewed, undone)

    def undone(self) -> list[Snapshot]:
        """What can be redone after a selection: all from the first undone edit of the scene on."""
        entries = enumerate(self.history.entries(), start=1)
        first = (at for at, entry in entries if not (entry.done or entry.is_selection))
        return self.past[next(first, len(self.past)) :]

    def _entered(self, state: Snapshot, undone: list[Snapshot]) -> None:
        at = self.history.cursor
        self.n_kept += len(undone) if (kept := self.history.entries()[at - 1].is_selection) else 0
        self.past[at:] = [state, *(undone if kept else ())]

    def jump(self) -> None:
        self.history.go_to(int(self.rng.integers(len(self.past))))

    def check(self) -> None:
        assert snapshot(self.scene) == self.past[self.history.cursor]
        assert len(self.history.entries()) == len(self.past) - 1


@pytest.mark.parametrize("seed", range(4))
def test_a_random_walk_of_do_undo_redo_and_preview_meets_its_snapshots(seed: int) -> None:
    walk = _Walk(seed)
    moves = [walk.do] * 4 + [walk.history.undo] * 2 + [walk.history.redo] + [walk.preview] * 2
    moves.append(walk.select)
    for _ in range(400):
        [*moves, walk.jump][walk.rng.integers(len(moves) + 1)]()
        walk.check()
    for at in (0, len(walk.past) - 1, 0):
        walk.history.go_to(at)
        walk.check()
    assert len(walk.seen) >= len(walk.kinds) - 2
    assert walk.n_kept > 5


def test_many_selections_after_an_undo_cost_what_the_last_one_does() -> None:
    scene = walk_scene(400)
    history = History(scene)
    history.do(edits.select(scene, np.arange(9)))
    history.do(edits.delete(scene, np.arange(9)))
    deleted, size = snapshot(scene), history.entries()[-1].nbytes
    history.undo()
    rng = np.random.default_rng(0)
    for _ in range(50):
        history.do(edits.select(scene, rng.random(len(scene)) < 0.5))
    *_, newest, undone = history.entries()
    assert undone.nbytes <= size + newest.nbytes
    assert history.redo() == "Delete"
    assert snapshot(scene) == deleted


def test_the_budget_drops_what_was_undone_before_what_is_done() -> None:
    scene = walk_scene(4000)
    rng = np.random.default_rng(0)
    history = History(scene)
    history.do(edits.hide(scene, rng.random(len(scene)) < 0.5))
    history.do(edits.delete(scene, rng.random(len(scene)) < 0.5))
    history.set_budget(history.nbytes)
    history.undo()
    before = snapshot(scene)
    history.do(edits.select(scene, rng.random(len(scene)) < 0.5))
    assert history.nbytes <= history.budget
    assert [entry.title for entry in history.entries()] == ["Hide", "Select"]
    history.undo()
    assert snapshot(scene) == before


@pytest.mark.parametrize("name", builders())
def test_a_changed_column_bumps_its_counter(name: str) -> None:
    rng = np.random.default_rng(5)
    scene = walk_scene()
    history = History(scene)
    counters = {
        "labels": "labels",
        "state": "state",
        "placement": "placement",
        "matrix": "placements",
        "color": "placements",
        "opacity": "placements",
        "means": "splats",
        "sh": "splats",
    }
    kinds = builders()
    setting_up = ("select", "transform", "hide", "delete", "lock")
    for step in range(40):
        if step % 2:
            history.do(kinds[setting_up[rng.integers(5)]](rng, scene))
        edit = kinds[name](rng, scene)
        if edit is None:
            continue
        for action in (partial(history.do, edit), history.undo, history.redo):
            before, names, folders = columns(scene), dict(scene.names), scene.folders
            revision = vars(scene.revision).copy()
            action()
            for column, counter in counters.items():
                if columns(scene)[column].tobytes() != before[column].tobytes():
                    assert vars(scene.revision)[counter] > revision[counter], column
            if scene.names != names or scene.folders != folders:
                assert scene.revision.names > revision["names"]


def test_columns_of_a_snapshot_do_not_change_under_its_holder() -> None:
    rng = np.random.default_rng(2)
    scene = walk_scene()
    history = History(scene)
    for build in list(builders().values()) * 3:
        held = columns(scene)
        copies = {name: column.copy() for name, column in held.items()}
        history.do(build(rng, scene))
        history.undo()
        history.redo()
        for name, column in held.items():
            assert column.tobytes() == copies[name].tobytes(), name


class _Breaks(Edit, frozen=True, tag="breaks"):
    """An edit whose apply fails."""

    def apply(self, scene: Scene) -> None:
        raise MemoryError

    def revert(self, scene: Scene) -> None:
        raise AssertionError


@pytest.mark.parametrize("use", ["do", "preview"])
def test_an_edit_that_fails_leaves_scene_and_cursor(use: str) -> None:
    scene = walk_scene()
    history = History(scene)
    history.do(edits.hide(scene, np.arange(9)))
    before = snapshot(scene)
    hide, move = edits.hide(scene, np.arange(50)), edits.transform(scene, np.array([4]), _shift(1))
    assert hide is not None
    assert move is not None
    broken: Edit = Edits("Several", (hide, move, _Breaks("Broken")))
    run: dict[str, Callable[[Edit], object]] = {"do": history.do, "preview": history.preview}
    with pytest.raises(MemoryError):
        run[use](broken)
    assert snapshot(scene) == before
    assert history.cursor == 1
    assert not history.is_previewing
    assert history.undo() == "Hide"


def _shift(x: float) -> DoubleArray:
    matrix = np.eye(3, 4)
    matrix[0, 3] = x
    return matrix


def test_frames_of_a_drag_touch_the_table_only_and_end_as_one_entry() -> None:
    scene = walk_scene()
    history = History(scene)
    start = snapshot(scene)
    splats = np.flatnonzero(scene.labels == 3)
    history.preview_with(lambda base: edits.transform(base, splats, _shift(0.5)))
    revision = vars(scene.revision).copy()
    column = scene.placement
    for x in (1.0, 2.0, 3.0):
        history.preview_with(partial(_moved, splats=splats, x=x))
    assert scene.placement is column
    assert scene.revision.placement == revision["placement"]
    assert scene.revision.placements > revision["placements"]
    assert scene.placements.matrix[scene.placement[splats[0]], 0, 3] == 3.0
    assert history.entries() == ()
    assert history.commit_preview()
    assert [entry.title for entry in history.entries()] == ["Move"]
    end = snapshot(scene)
    history.undo()
    assert snapshot(scene) == start
    history.redo()
    assert snapshot(scene) == end


def _moved(base: Scene, splats: IntArray | LongArray, x: float) -> Edit | None:
    return edits.transform(base, splats, _shift(x))


def test_do_undo_and_redo_drop_a_preview_first() -> None:
    scene = walk_scene()
    history = History(scene)
    history.do(edits.hide(scene, np.arange(5)))
    hidden = snapshot(scene)
    for action in (history.undo, history.redo):
        history.preview(edits.transform(history.base, np.arange(9), _shift(1)))
        action()
        assert not history.is_previewing
    assert snapshot(scene) == hidden
    history.preview(edits.transform(history.base, np.arange(9), _shift(1)))
    history.do(None)
    assert snapshot(scene) == hidden


def test_the_budget_drops_the_oldest_and_keeps_the_newest() -> None:
    scene = walk_scene(4000)
    history = History(scene, budget_bytes=5500)
    rng = np.random.default_rng(0)
    snapshots, ids = [snapshot(scene)], [history.state_id]
    for _ in range(30):
        flip = edits.select(scene, rng.random(len(scene)) < 0.5)
        assert flip is not None
        assert flip.nbytes <= 520
        history.do(flip)
        snapshots.append(snapshot(scene))
        ids.append(history.state_id)
    kept = len(history.entries())
    assert 10 <= kept < 30
    assert history.nbytes <= 5500
    while history.undo():
        pass
    assert snapshot(scene) == snapshots[30 - kept]
    assert history.state_id == ids[30 - kept]
    small = History(scene, budget_bytes=1)
    small.do(edits.delete(scene, rng.random(len(scene)) < 0.5))
    assert small.can_undo


def test_state_id_tells_saved_from_unsaved() -> None:
    scene = walk_scene()
    history = History(scene)
    ids = [history.state_id]
    for i in range(3):
        history.do(edits.hide(scene, np.array([i])))
        ids.append(history.state_id)
    assert len(set(ids)) == 4
    history.undo()
    history.undo()
    assert history.state_id == ids[1]
    history.redo()
    assert history.state_id == ids[2]
    history.undo()
    history.do(edits.hide(scene, np.array([9])))
    assert history.state_id not in ids
    history.clear()
    assert history.entries() == ()
    assert history.state_id not in ids


def test_an_edit_of_another_scene_is_refused() -> None:
    small, large = walk_scene(50), walk_scene(60)
    edit = edits.hide(small, np.arange(5))
    with pytest.raises(ValueError, match="50 splats"):
        History(large).do(edit)
    assert not large.has(State.HIDDEN).any()


def test_entries_say_which_change_the_selection_and_nothing_else() -> None:
    scene = walk_scene(60)
    history = History(scene)
    some = np.arange(9)
    history.do(edits.select(scene, some))
    history.do(edits.hide(scene, some))
    history.do(edits.together("Both", (edits.select(scene, some[:3]), edits.lock(scene, some))))
    history.do(edits.select(scene, np.arange(30, 40)))
    assert [entry.is_selection for entry in history.entries()] == [True, False, False, True]
