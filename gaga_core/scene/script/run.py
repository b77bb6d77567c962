"""Edits as JSON: the recorded form of what the window does, run by ``gaga edit``.

A script is a list of operations, each an object with ``op`` and its fields::

    [{"op": "recolor", "groups": [3], "color": [0.9, 0.1, 0.1]},
     {"op": "rotate", "groups": ["mug"], "axis": [0, 0, 1], "degrees": 45},
     {"op": "delete", "groups": [4, 5]}]

``groups`` are ids or names; an operation on splats without it acts on the selection. What the
window records (`History.recorded`) are operations "edit": exact, for the same file only.
"""

from collections.abc import Mapping, Sequence

from gaga_core.errors import GagaError
from gaga_core.scene.edits import Edit
from gaga_core.scene.edits.history import History
from gaga_core.scene.edits.json import decode_edit
from gaga_core.scene.scene import Scene
from gaga_core.scene.script.fields import Value
from gaga_core.scene.script.operations import OBJECT_KINDS, Op, OperationKind
from gaga_core.scene.script.regions import REGION_KINDS

_KINDS: Mapping[str, OperationKind] = {**OBJECT_KINDS, **REGION_KINDS}
OPERATIONS: Sequence[str] = tuple(sorted([*_KINDS, "edit"]))


def parse_script(content: object) -> tuple[Op, ...]:
    """Check a script (the content of a JSON file) and return its operations.

    Raises ``GagaError`` that names the operation and the field at fault.
    """
    if not isinstance(content, list):
        raise GagaError("The edit script must be a JSON list of operations.")
    return tuple(_parsed(i + 1, item) for i, item in enumerate(content))


def run_script(scene: Scene, content: object, history: History | None = None) -> tuple[str, ...]:
    """Check all of a script, then apply it through ``history``; the titles of what changed.

    An operation that fails stops the script; those before it stay applied.
    Raises ``GagaError`` as `parse_script` does, and for a group that does not exist.
    """
    ops = parse_script(content)
    history = History(scene) if history is None else history
    titles = []
    for op in ops:
        if op.kind in ("undo", "redo"):
            title = _undo_redo(history, op)
        else:
            edit = op.edit or _KINDS[op.kind].build(scene, op)
            title = edit.title if edit is not None and _do(history, op, edit) else ""
        titles.append(title)
    return tuple(title for title in titles if title)


def _do(history: History, op: Op, edit: Edit) -> bool:
    try:
        return history.do(edit)
    except ValueError as error:
        if op.edit is None:
            raise
        raise GagaError(
            f"Operation {op.at} was recorded on another scene ({error}). "
            "Replay it on the file that it was recorded on."
        ) from error


def _parsed(at: int, item: object) -> Op:
    if not isinstance(item, dict) or not isinstance(item.get("op"), str):
        raise GagaError(f'Operation {at} of the edit script must be an object with a field "op".')
    kind = item["op"]
    if kind == "edit":
        return Op(at, kind, {}, decode_edit(item))
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


def _undo_redo(history: History, op: Op) -> str:
    times = op.fields.get("times", 1)
    assert isinstance(times, int)
    step = history.undo if op.kind == "undo" else history.redo
    done = [title for title in (step() for _ in range(times)) if title is not None]
    return f"{op.kind.capitalize()} {', '.join(done)}" if done else ""
