"""What was saved before edits had one description opens to the same bits.

See tests/fixtures/before_consolidation/README.md.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaga_core.arrays import AnyArray
from gaga_core.edit_script import OPERATIONS, run_script
from gaga_core.progress import run_stage
from gaga_core.scene.edits.history import History
from gaga_core.scene.project import open_path_stage, saved_scene, scene_arrays
from gaga_core.scene.scene import Revision, Scene
from gaga_studio.features import autosave
from gaga_studio.features.autosave import FILE, read_history
from gaga_studio.session.session import Session

SAVED = Path(__file__).resolve().parents[1] / "fixtures" / "before_consolidation"
PLACE = "@FIXTURE@"
# What a script does not keep: it is replayed to write splats.
_NOT_RECORDED = ("bank_", "confidence", "labels_from", "other_", "identity_colors", "set_", "len")


def digest(scene: Scene, *, recorded: bool = False) -> str:
    """Of every bit of a scene but its revision, or of what a script keeps of it."""
    g, order = scene.gaussians, scene.folders
    arrays: dict[str, AnyArray] = {
        **{name: getattr(g, name) for name in ("means", "quats", "log_scales")},
        **{name: getattr(g, name) for name in ("logit_opacities", "sh")},
        **{f"extra {name}": column for name, column in g.extra.items()},
        **scene_arrays(scene),
    }
    found = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        if not (recorded and name.startswith(_NOT_RECORDED)):
            found.update(f"{name} {array.dtype.str} {array.shape}".encode())
            found.update(np.ascontiguousarray(array).tobytes())
    sets = [] if recorded else list(scene.named_selections)
    tables = scene.names, scene.colors, order.paths, dict(order.home), dict(order.parent), sets
    files = [replace(item, path=Path(item.path).name) for item in scene.added]
    found.update(repr((tables, [(f.path, f.fingerprint, f.first, f.n, f.axes) for f in files],
                       [(f.frame, f.is_merged) for f in files])).encode())  # fmt: skip
    return found.hexdigest()[:16]


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """A copy of the files that names its new place."""
    folder = tmp_path / "saved"
    shutil.copytree(SAVED, folder)
    for file in folder.rglob("*.json"):
        text = file.read_text(encoding="utf-8")
        file.write_text(text.replace(PLACE, folder.as_posix()), encoding="utf-8")
    kept = folder / "recovery" / FILE
    with np.load(kept) as npz:
        arrays = dict(npz)
    text = arrays["edits"].tobytes().decode().replace(PLACE, folder.as_posix())
    np.savez(kept, **arrays | {"edits": np.frombuffer(text.encode(), np.uint8)})
    for lift in folder.rglob("identity.npz"):
        os.utime(lift)  # a checkout writes the files in any order; the lift was the last
    return folder


@pytest.fixture
def expected(saved: Path) -> dict[str, Any]:
    return json.loads((saved / "expected.json").read_text())


def opened(path: Path) -> Scene:
    return run_stage(open_path_stage(path)).scene


def test_a_project_and_the_folder_of_an_association_open(
    saved: Path, expected: dict[str, Any]
) -> None:
    assert digest(opened(saved / "project")) == expected["project"]
    assert digest(opened(saved / "associated")) == expected["associated"]


def test_every_state_of_an_autosaved_history_comes_back(
    saved: Path, expected: dict[str, Any]
) -> None:
    folder = saved / "recovery"
    scene = opened(folder)
    copied = read_history(folder, saved_scene(folder), scene)
    assert copied is not None
    trial = replace(scene, revision=Revision())
    undo = History(trial)
    undo.resume(copied.record)
    assert undo.cursor == expected["cursor"]
    assert [entry.title for entry in undo.entries()] == expected["titles"]
    assert list(copied.contents) == expected["contents"]
    for cursor in (*range(len(expected["states"])), *reversed(range(len(expected["states"])))):
        undo.go_to(cursor)
        assert digest(trial) == expected["states"][cursor], cursor


def test_a_crash_is_recovered_with_its_history(
    saved: Path,
    expected: dict[str, Any],
    new_session: Callable[[], Session],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    session = new_session()
    monkeypatch.setattr(autosave, "root", lambda: saved)
    assert autosave.offer(session)
    session.answer("Recover")
    assert session.jobs.wait()
    assert session.scene is not None, session.notices
    assert digest(session.scene) == expected["states"][expected["cursor"]]
    session.undo()
    assert digest(session.scene) == expected["states"][expected["cursor"] - 1]


def test_recorded_edits_of_every_kind_replay_to_the_same_bits(
    saved: Path, expected: dict[str, Any]
) -> None:
    recorded = json.loads((saved / "recorded.json").read_text())
    kinds = {kind for edit in recorded for kind in _kinds(edit)}
    assert kinds == {"flip", "labels", "names", "color", "folders", "placement", "copies",
                     "append", "made", "frame", "together"}  # fmt: skip
    scene = opened(saved / "associated")
    titles = run_script(scene, recorded)
    assert list(titles) == [edit["title"] for edit in recorded]
    assert digest(scene, recorded=True) == expected["replayed"]


def _kinds(edit: dict[str, Any]) -> list[str]:
    return [edit["kind"], *(kind for part in edit.get("edits", []) for kind in _kinds(part))]


def test_every_operation_of_a_script_does_what_it_did(
    saved: Path, expected: dict[str, Any]
) -> None:
    script = json.loads((saved / "operations.json").read_text())
    computed = next(i for i, item in enumerate(script) if item["op"] == "reduce")
    assert {item["op"] for item in script} | {"edit"} == set(OPERATIONS)
    scene = opened(saved / "project")
    titles: list[str] = []
    undo = History(scene)
    for operation in script[:computed]:
        before = digest(scene)
        done = run_script(scene, [operation], undo)
        assert bool(done) == (digest(scene) != before), operation
        titles += done
    after = expected["operations"]
    assert titles == after["titles"]
    with np.load(saved / "operations.npz") as arrays:
        for name in ("labels", "state", "placement", "source"):
            np.testing.assert_array_equal(getattr(scene, name), arrays[name], name)
        # Recoloring began with the mean color; now with that from outside, as in the swatch.
        for name, off in (("matrix", 1e-7), ("color", 1e-2), ("opacity", 1e-7)):
            np.testing.assert_allclose(getattr(scene.placements, name), arrays[name], 0, off)
    assert {str(group): name for group, name in scene.names.items()} == after["names"]
    assert list(scene.folders.paths) == after["folders"]
    assert {str(child): above for child, above in scene.folders.parent.items()} == after["parents"]
    n = len(scene)
    assert [title.split()[0] for title in run_script(scene, script[computed:])] == after["computed"]
    assert len(scene) > n
