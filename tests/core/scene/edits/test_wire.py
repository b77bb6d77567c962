"""What the window records, replayed: the same scene bit for bit."""

import json
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from gaga_core.edit_script import run_script
from gaga_core.errors import GagaError
from gaga_core.io.splats.splat_files import write_splats
from gaga_core.progress import run_stage
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History, HistoryRecord, history_arrays, history_of
from gaga_core.scene.edits.values import (
    AnyEdit,
    Edit,
    Edits,
    parts_of,
    read_added_stage,
)
from gaga_core.scene.edits.wire import to_json
from gaga_core.scene.scene import Scene
from tests.core.scene.edits.edit_walk import Snapshot, builders, snapshot, walk_scene
from tests.scenes import random_gaussians


def _without_bank(shot: Snapshot) -> tuple[object, ...]:
    left_out = ("confidence", "identities")
    columns = {k: v for k, v in shot.columns.items() if not k.startswith(left_out)}
    return columns, shot.names, shot.colors, shot.folders


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("budget", [1 << 30, 4000])
def test_a_recorded_walk_replays_to_the_same_scene(seed: int, budget: int) -> None:
    rng = np.random.default_rng(seed)
    scene = walk_scene(400)
    history = History(scene, budget)
    build = list(builders().values())
    for _ in range(100):
        if rng.random() < 0.2:
            history.undo()
        elif rng.random() < 0.1:
            history.redo()
        else:
            history.do(build[rng.integers(len(build))](rng, scene))
    recorded = json.loads(json.dumps(history.recorded()))
    assert len(recorded) > 10
    again = walk_scene(400)
    titles = run_script(again, recorded)
    assert _without_bank(snapshot(again)) == _without_bank(snapshot(scene))
    assert titles == tuple(entry["title"] for entry in recorded)


def test_every_kind_of_edit_comes_back_from_a_file_as_it_was(tmp_path: Path) -> None:
    rng, scene = np.random.default_rng(1), walk_scene()
    kinds: set[type[Edit]] = set()
    write_splats(tmp_path / "chair.ply", random_gaussians(20))
    splats, digest = run_stage(read_added_stage(tmp_path / "chair.ply"))

    def added(_: np.random.Generator, scene: Scene) -> Edit | None:
        return edits.append(scene, splats, tmp_path / "chair.ply", digest)

    for build in [*builders().values(), added] * 6:
        edit = build(rng, scene)
        if edit is None:
            continue
        arrays = history_arrays(HistoryRecord((edit,), 0, ()))
        record, n_lost = history_of(arrays)
        again = history_arrays(record)
        assert n_lost == 0
        assert arrays.keys() == again.keys()
        assert all(np.array_equal(arrays[name], again[name]) for name in arrays)
        assert record.edits[0].nbytes == edit.nbytes
        kinds.update(type(part) for part in parts_of(edit))
        History(scene).do(record.edits[0])
    assert {*kinds, Edits} == set(get_args(AnyEdit))


@pytest.mark.parametrize("n", [200, 301])
def test_a_script_of_another_scene_is_told_so(n: int) -> None:
    scene = walk_scene(300)
    history = History(scene)
    history.do(edits.hide(scene, np.arange(5)))
    with pytest.raises(GagaError, match="recorded on another scene"):
        run_script(walk_scene(n), history.recorded())


@pytest.mark.parametrize(
    "damage",
    [
        {"kind": "nonsense"},
        {"n": -1},
        {"flips": [[2, {"n": 300, "count": 5, "runs": [[0, 400]]}]]},
        {"flips": [[2, {"n": 300, "count": 5, "runs": [[4, 6], [0, 3]]}]]},
        {"flips": [[2, {"n": 300, "count": 5, "list": "AAAA"}]]},
        {"flips": [[2, {"n": 300, "count": 5, "bits": "no base 64"}]]},
        {"flips": 3},
        {"title": None, "flips": None},
    ],
)
def test_a_damaged_recording_is_one_sentence(damage: dict[str, object]) -> None:
    scene = walk_scene(300)
    edit = edits.hide(scene, np.arange(5))
    assert edit is not None
    recorded = {"op": "edit", **to_json(edit), **damage}
    before = snapshot(scene)
    with pytest.raises(GagaError, match="damaged"):
        run_script(scene, [recorded])
    assert snapshot(scene) == before
