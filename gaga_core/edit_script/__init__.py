"""Edits as JSON: the recorded form of what the window does, run by ``gaga edit``.

A script is a list of operations, each an object with ``op`` and its fields::

    [{"op": "recolor", "groups": [3], "color": [0.9, 0.1, 0.1]},
     {"op": "rotate", "groups": ["mug"], "axis": [0, 0, 1], "degrees": 45},
     {"op": "delete", "groups": [4, 5]}]

``groups`` are ids, names or folders ("Kitchen/"); an operation on splats
without it acts on the selection. What the window records (`History.recorded`) are operations
"edit": exact, for the same file only.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import get_args, get_type_hints

import msgspec
import numpy as np

from gaga_core.edit_script.operations import OPERATION_TYPES, Views, run_operation
from gaga_core.errors import GagaError
from gaga_core.io.json_file import explain_json_error
from gaga_core.scene.edits.history import History
from gaga_core.scene.edits.values import MOST_ROWS, Append, Edit, parts_of
from gaga_core.scene.edits.wire import of_json
from gaga_core.scene.scene import Scene

# What numpy raises on numbers that no scene can have.
_IMPOSSIBLE = (ValueError, IndexError, OverflowError, MemoryError, np.linalg.LinAlgError)
_UNKNOWN = re.compile(r"^Object contains unknown field `(.*)`$", re.DOTALL)
_AT = re.compile(r"at `\$\.(\w+)")
_MISSING = re.compile(r"^Object missing required field `(.*)`$", re.DOTALL)
OPERATIONS: Sequence[str] = tuple(sorted([*OPERATION_TYPES, "edit"]))


@dataclass(frozen=True)
class Step:
    """One checked operation of a script."""

    at: int  # place in the script, from 1
    kind: str
    operation: msgspec.Struct | None  # None: of the kind "edit"
    recorded: Edit | None = None  # of the kind "edit": as recorded, where it was decoded

    def __str__(self) -> str:
        return f'Operation {self.at} ("{self.kind}")'


def parse_script(content: object, n_rows: int | None = None) -> tuple[Step, ...]:
    """Check a script (the content of a JSON file) and return its operations.

    ``n_rows``: splats of the scene; recorded edits of more splats than it can have by then are
    refused. While it is not known (None) recorded edits are not decoded. Raises ``GagaError`` that
    names the operation and the field at fault.
    """
    if not isinstance(content, list):
        raise GagaError("The edit script must be a JSON list of operations.")
    steps: list[Step] = []
    for i, item in enumerate(content):
        step = _parsed(i + 1, item, n_rows)
        steps.append(step)
        if n_rows is not None:
            doubles = step.kind == "duplicate"
            n_rows = min(n_rows + (n_rows if doubles else _rows_added(step.recorded)), MOST_ROWS)
    return tuple(steps)


def _rows_added(edit: Edit | None) -> int:
    parts = () if edit is None else parts_of(edit)
    return sum(part.labels.count for part in parts if isinstance(part, Append))


def run_script(
    scene: Scene,
    content: object,
    history: History | None = None,
    views: Views = tuple,
) -> tuple[str, ...]:
    """Check all of a script, then apply it through ``history``; the titles of what changed.

    ``views`` gives the cameras of the photos around the scene as it is at that moment.
    An operation that fails stops the script; those before it stay applied.
    Raises ``GagaError`` as `parse_script` does, and for a group that does not exist.
    """
    steps = parse_script(content, len(scene))
    history = History(scene) if history is None else history
    titles = [_run(step, history, scene, views) for step in steps]
    return tuple(title for title in titles if title)


def _run(step: Step, history: History, scene: Scene, views: Views) -> str:
    """Apply an operation; its title, "" when it changed nothing."""
    if step.operation is None:
        return _replay(step, history)
    try:
        return run_operation(step.operation, history, scene, views)
    except GagaError as error:
        raise GagaError(f"{step}: {error}") from error
    except _IMPOSSIBLE as error:
        raise GagaError(f"{step} cannot be done: {error}.") from error


def _replay(step: Step, history: History) -> str:
    edit = step.recorded
    try:
        return edit.title if edit is not None and history.do(edit) else ""
    except _IMPOSSIBLE as error:
        raise GagaError(
            f"Operation {step.at} was recorded on another scene ({error}). "
            "Replay it on the file that it was recorded on."
        ) from error


def _parsed(at: int, item: object, n_rows: int | None) -> Step:
    if not isinstance(item, dict) or not isinstance(item.get("op"), str):
        raise GagaError(f'Operation {at} of the edit script must be an object with a field "op".')
    kind = item["op"]
    if kind == "edit":
        return Step(at, kind, None, None if n_rows is None else of_json(item, n_rows))
    if kind not in OPERATION_TYPES:
        near = " or ".join(get_close_matches(kind, OPERATION_TYPES, 3))
        meant = f"Do you mean {near}?" if near else "The page on scripting lists what there is."
        raise GagaError(f'Operation {at}: "{kind}" is unknown. {meant}')
    try:
        return Step(at, kind, msgspec.convert(item, OPERATION_TYPES[kind]))
    except (msgspec.ValidationError, ValueError, RecursionError) as error:
        why = _why(error, OPERATION_TYPES[kind], item)
        raise GagaError(f'Operation {at} ("{kind}"): {why}.') from error


def _why(error: Exception, kind: type[msgspec.Struct], item: Mapping[str, object]) -> str:
    """What is wrong with an operation, by its field."""
    text = str(error)
    if missing := _MISSING.match(text):
        return f'field "{missing[1]}" is missing'
    if unknown := _UNKNOWN.match(text):
        takes = ", ".join(sorted(kind.__struct_encode_fields__)) or "no fields"
        return f'field "{unknown[1]}" is unknown; it takes {takes}'
    at = _AT.search(text)
    wanted = _description(get_type_hints(kind, include_extras=True).get(at[1])) if at else ""
    if at is None or not wanted:
        return explain_json_error(error)
    value = repr(item[at[1]])
    return (
        f'field "{at[1]}" must be {wanted}, not {value if len(value) <= 40 else value[:37] + "..."}'
    )


def _description(hint: object) -> str:
    """What the type of a field says of itself; "" when it says nothing."""
    for meta in getattr(hint, "__metadata__", ()):
        return str(meta.description or "")
    return next((found for part in get_args(hint) if (found := _description(part))), "")
