"""A project from anyone opens whole or is refused in a sentence, and so is a step of a history."""

import copy
import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaga_core.arrays import MOST_GROUP, AnyArray
from gaga_core.errors import GagaError
from gaga_core.scene.edits.history import History, HistoryRecord
from gaga_core.scene.edits.wire import of_json, script_form, to_json
from gaga_core.scene.project import save_project
from gaga_core.scene.scene import Revision, Scene
from tests.core.scene.edits.edit_walk import builders, snapshot, some_bank, walk_scene
from tests.core.scene.projects import edited, model_in, opened

_VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 2, 2**31 - 1, 2**40, 1e300, "", "\x00", "\x1b[31m", "x" * 3000, [], {},
)  # fmt: skip


def assert_whole(scene: Scene) -> None:
    """What kernels, tables and lists take for granted of a scene."""
    n, rows = len(scene.gaussians), len(scene.placements)
    for column in (scene.labels, scene.state, scene.placement, scene.source):
        assert column.shape == (n,)
    ends = {"placement": rows, "labels": MOST_GROUP + 1, "source": scene.n_rows_of_files}
    for name, end in ends.items():
        column = getattr(scene, name)
        assert (column >= 0).all(), name
        assert (column < end).all(), name
    for table in (scene.placements.matrix, scene.placements.color, scene.placements.opacity):
        assert np.abs(table).max() <= 1e18
    assert np.linalg.det(scene.placements.matrix[:, :, :3]).all()
    assert all(0 <= group <= MOST_GROUP for group in (*scene.names, *scene.colors))
    for of_opened in (scene.confidence, scene.identities.colors):
        assert of_opened is None or len(of_opened) == scene.n_opened


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    project = edited(opened(model_in(tmp_path)))
    history, rng = History(project.scene), np.random.default_rng(0)
    project.scene.bank = some_bank(rng, project.scene)
    for name in ("append_made", "keep_set", "move_scene", "set_identities"):
        history.do(builders()[name](rng, project.scene))
    return save_project(project)


def wrong(array: AnyArray) -> Iterator[AnyArray]:
    shape = array.shape
    yield from (np.full(shape, "x"), np.ones(shape, complex), np.stack([array, array]))
    for value in (np.nan, np.inf, 1e300, -5, 2**31 - 1, -(2**31), 0, 2**40, 0.5):
        yield np.full(shape, value)


def test_arrays_of_a_scene_that_cannot_be_are_refused(saved: Path) -> None:
    file = next(saved.glob("scene-*.npz"))
    with np.load(file) as stored:
        whole = dict(stored)
    accepted = 0
    for name in whole:
        for value in wrong(whole[name]):
            np.savez(file, **(whole | {name: value}))
            with suppress(GagaError):
                assert_whole(opened(saved).scene)
                accepted += 1
    assert accepted < 4 * len(whole)


def test_what_is_no_color_is_left_out(saved: Path) -> None:
    file = saved / "project.json"
    content = json.loads(file.read_text())
    for wrong_channel in (10**400, 1e300, -1, 2, "x", None):
        colors = {"1": [0, 0.5, wrong_channel], "2": [0, 0.5, 1]}
        file.write_text(json.dumps(content | {"colors": colors}))
        assert opened(saved).scene.colors == {2: (0, 0.5, 1)}


def places(value: object, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The way to every value in a document."""
    yield way
    inside = dict(enumerate(value)) if isinstance(value, list) else value
    for key, child in inside.items() if isinstance(inside, dict) else ():
        yield from places(child, (*way, key))


def replaced(document: Any, way: tuple[Any, ...], value: object) -> Any:
    if not way:
        return value
    made = inner = copy.deepcopy(document)
    for key in way[:-1]:
        inner = inner[key]
    inner[way[-1]] = value
    return made


def test_values_of_a_project_that_cannot_be_are_refused(saved: Path) -> None:
    file = saved / "project.json"
    document = json.loads(file.read_text())
    for way in places(document):
        for value in _VALUES:
            file.write_text(json.dumps(replaced(document, way, value)))
            with suppress(GagaError):
                assert_whole(opened(saved).scene)


def near(value: object) -> tuple[Any, ...]:
    """Values of the same kind that may not fit the others of a step."""
    if isinstance(value, int) and not isinstance(value, bool):
        return value - 1, value + 1, value + 50, value + 10**6
    if not isinstance(value, list):
        return ()
    moved = [n + 50 if isinstance(n, int) else n for n in value]
    return (
        value[:-1],
        value[::-1],
        value + value[-1:],
        moved,
        [value[0]] * len(value) if value else 0,
    )


@pytest.mark.parametrize("part", range(4))
def test_a_walk_over_a_hostile_history_leaves_a_whole_scene(part: int) -> None:
    scene, rng = walk_scene(400), np.random.default_rng(part)
    history = History(scene)
    for build in builders().values():
        history.do(build(rng, scene))
    record = history.record()
    for i, done in list(enumerate(record.edits))[part::4]:
        step = to_json(done)
        for way in places(step):
            value: Any = step
            for key in way:
                value = value[key]
            if not way or (isinstance(value, float) and rng.random() < 0.9):
                continue  # a number of a matrix, of which there are many
            for other in (*near(value), _VALUES[rng.integers(len(_VALUES))]):
                with suppress(GagaError):
                    edit = of_json(replaced(step, way, other))
                    edits = (*record.edits[:i], edit, *record.edits[i + 1 :])
                    walk(scene, replace(record, edits=edits))


def walk(scene: Scene, record: HistoryRecord) -> None:
    """Undo and redo everything, over what cannot be done."""
    trial = replace(scene, revision=Revision())
    history = History(trial)
    history.resume(record)
    for move in (*[history.undo] * len(record.edits), *[history.redo] * len(record.edits)):
        before = snapshot(trial)
        try:
            move()
        except GagaError:
            assert snapshot(trial) == before
        assert_whole(trial)


@pytest.mark.parametrize("inside", [None, 7, "text", [7], [None, {}], {}])
def test_a_script_leaves_out_edits_together_that_are_none(inside: object) -> None:
    assert script_form({"kind": "together", "edits": inside}) is None
