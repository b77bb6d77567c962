"""Edits as JSON: the recorded form of what the window does, run by ``gaga edit``.

A script is a list of operations, each an object with ``op`` and its fields::

    [{"op": "recolor", "groups": [3], "color": [0.9, 0.1, 0.1]},
     {"op": "rotate", "groups": ["mug"], "axis": [0, 0, 1], "degrees": 45},
     {"op": "delete", "groups": [4, 5]}]

``groups`` are ids or names; an operation on splats without it acts on the selection. What the
window records (`History.recorded`) are operations "edit": exact, for the same file only.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from gaga_core.errors import GagaError
from gaga_core.scene.edits import Edit
from gaga_core.scene.edits.append_values import AppendSplats
from gaga_core.scene.edits.history import History
from gaga_core.scene.edits.json import MOST_ROWS, decode_edit
from gaga_core.scene.edits.placement_values import AppendCopies
from gaga_core.scene.edits.values import Edits
from gaga_core.scene.scene import Scene
from gaga_core.scene.script.fields import Value
from gaga_core.scene.script.operations import OBJECT_KINDS, Op, OperationKind
from gaga_core.scene.script.regions import REGION_KINDS

# What numpy raises on numbers that no scene can have.
_IMPOSSIBLE = (ValueError, IndexError, OverflowError, MemoryError, np.linalg.LinAlgError)
_KINDS: Mapping[str, OperationKind] = {**OBJECT_KINDS, **REGION_KINDS}
OPERATIONS: Sequence[str] = tuple(sorted([*_KINDS, "edit"]))


def parse_script(content: object, n_rows: int | None = None) -> tuple[Op, ...]:
    """Check a script (the content of a JSON file) and return its operations.

    ``n_rows``: splats of the scene; recorded edits of more splats than it can have by then are
    refused. While it is not known (None) recorded edits are not decoded. Raises ``GagaError`` that
    names the operation and the field at fault.
    """
    if not isinstance(content, list):
        raise GagaError("The edit script must be a JSON list of operations.")
    ops: list[Op] = []
    for i, item in enumerate(content):
        op = _parsed(i + 1, item, n_rows)
        ops.append(op)
        if n_rows is not None:
            added = n_rows if op.kind == "duplicate" else _rows_added(op.edit)
            n_rows = min(n_rows + added, MOST_ROWS)
    return tuple(ops)


def _rows_added(edit: Edit | None) -> int:
    if isinstance(edit, Edits):
        return sum(map(_rows_added, edit.edits))
    if isinstance(edit, AppendCopies):
        return edit.splats.count
    return len(edit.splats) if isinstance(edit, AppendSplats) else 0


def run_script(scene: Scene, content: object, history: History | None = None) -> tuple[str, ...]:
    """Check all of a script, then apply it through ``history``; the titles of what changed.

    An operation that fails stops the script; those before it stay applied.
    Raises ``GagaError`` as `parse_script` does, and for a group that does not exist.
    """
    ops = parse_script(content, len(scene))
    history = History(scene) if history is None else history
    titles = []
    for op in ops:
        do = _undo_redo if op.kind in ("undo", "redo") else _do
        titles.append(do(history, op, scene))
    return tuple(title for title in titles if title)


def _do(history: History, op: Op, scene: Scene) -> str:
    """Apply an operation; its title, "" when it changed nothing."""
    try:
        edit = op.edit or _KINDS[op.kind].build(scene, op)
        return edit.title if edit is not None and history.do(edit) else ""
    except _IMPOSSIBLE as error:
        if op.edit is None:
            raise GagaError(f'Operation {op.at} ("{op.kind}") cannot be done: {error}.') from error
        raise GagaError(
            f"Operation {op.at} was recorded on another scene ({error}). "
            "Replay it on the file that it was recorded on."
        ) from error


def _parsed(at: int, item: object, n_rows: int | None) -> Op:
    if not isinstance(item, dict) or not isinstance(item.get("op"), str):
        raise GagaError(f'Operation {at} of the edit script must be an object with a field "op".')
    kind = item["op"]
    if kind == "edit":
        return Op(at, kind, {}, None if n_rows is None else decode_edit(item, n_rows))
    if kind not in _KINDS:
        known = ", ".join(sorted(_KINDS))
        raise GagaError(f'Operation {at}: "{kind}" is unknown; known are {known}.')
    checks = {**_KINDS[kind].required, **_KINDS[kind].optional}
    where = f'Operation {at} ("{kind}")'
    for field in item:
        if field != "op" and field not in checks:
            takes = ", ".join(sorted(checks)) or "no fields"
            raise GagaError(f'{where}: field "{field}" is unknown; it takes {takes}.')
    for field in _KINDS[kind].required:
        if field not in item:
            raise GagaError(f'{where}: field "{field}" is missing.')
    fields: dict[str, Value] = {}
    for field, value in item.items():
        if field != "op":
            fields[field] = checks[field](f'{where}: field "{field}"', value)
    return Op(at, kind, fields)


def _undo_redo(history: History, op: Op, _: Scene) -> str:
    times = op.fields.get("times", 1)
    assert isinstance(times, int)
    step = history.undo if op.kind == "undo" else history.redo
    done = []
    for _i in range(times):
        title = step()
        if title is None:
            break
        done.append(title)
    return f"{op.kind.capitalize()} {', '.join(done)}" if done else ""
