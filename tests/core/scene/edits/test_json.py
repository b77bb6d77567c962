"""What the window records, replayed: the same scene bit for bit."""

import json

import numpy as np
import pytest

from gaga_core.edit_script.run import run_script
from gaga_core.errors import GagaError
from gaga_core.scene import edits
from gaga_core.scene.edits import Edit
from gaga_core.scene.edits.history import History
from gaga_core.scene.edits.json import decode_edit, encode_edit
from tests.core.scene.edits.edit_walk import Snapshot, builders, snapshot, walk_scene


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


def test_every_kind_of_edit_comes_back_as_it_was() -> None:
    rng = np.random.default_rng(1)
    for name, build in builders().items():
        if name in ("keep_set", "forget_set"):  # not of the splats: not recorded
            continue
        scene = walk_scene(300)
        if name in ("show", "show_all", "unlock", "restore"):  # nothing to show yet
            tries: list[Edit | None] = [edits.hide(scene, np.arange(3))]
        else:
            tries = [build(rng, scene) for _ in range(50)]
        first = next(filter(None, (encode_edit(e) for e in tries if e is not None)))
        assert encode_edit(decode_edit(json.loads(json.dumps(first)))) == first


def test_a_script_of_another_scene_is_told_so() -> None:
    scene = walk_scene(300)
    history = History(scene)
    history.do(edits.hide(scene, np.arange(5)))
    with pytest.raises(GagaError, match="recorded on another scene"):
        run_script(walk_scene(301), history.recorded())


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
    recorded = {"op": "edit", **(encode_edit(edit) or {}), **damage}
    before = snapshot(scene)
    with pytest.raises(GagaError, match="damaged"):
        run_script(scene, [recorded])
    assert snapshot(scene) == before
