"""Edits as JSON: the recorded form of what the window does, run by ``gaga edit``.

A script is a list of operations, each an object with ``op`` and its fields::

    [{"op": "recolor", "groups": [3], "color": [0.9, 0.1, 0.1]},
     {"op": "rotate", "groups": ["mug"], "axis": [0, 0, 1], "degrees": 45},
     {"op": "delete", "groups": [4, 5]}]

``groups`` are ids or names; an operation on splats without it acts on the selection. What the
window records (`History.recorded`) are operations "edit": exact, for the same file only.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.geometry import quats_to_matrices
from gaga_core.progress import run_stage
from gaga_core.scene import edits, selection
from gaga_core.scene.cleaned import clean_objects_stage, relabel
from gaga_core.scene.edit_json import decode_edit
from gaga_core.scene.edits import Edit
from gaga_core.scene.history import History
from gaga_core.scene.objects import group_indices, group_name, selected_groups, selected_indices
from gaga_core.scene.scene import Scene
from gaga_core.scene.script_fields import (
    Check,
    Value,
    color,
    count,
    factors,
    flag,
    group_list,
    how,
    matrix,
    name,
    number,
    share,
    vector,
)
from gaga_core.scene.tint import mean_color, tint_affine

Fields = Mapping[str, Value]


@dataclass(frozen=True)
class Op:
    """One checked operation of a script."""

    at: int  # place in the script, from 1
    kind: str
    fields: Fields
    edit: Edit | None = None  # of "edit": as recorded


@dataclass(frozen=True)
class _Kind:
    """What an operation takes and how it becomes an edit."""

    build: Callable[[Scene, Op], Edit | None]
    required: Mapping[str, Check]
    optional: Mapping[str, Check]


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


# --- what operations act on ---------------------------------------------------------------------


def _groups(scene: Scene, op: Op) -> list[int]:
    """Group ids of an operation, names looked up; those of the selection when it has none."""
    wanted = op.fields.get("groups")
    if wanted is None:
        return [int(g) for g in selected_groups(scene)]
    assert isinstance(wanted, tuple)
    present = {int(g) for g in np.unique(scene.labels)}
    by_name = {group_name(scene, g): g for g in sorted(present, reverse=True)}
    found: list[int] = []
    for item in wanted:
        group = by_name.get(item) if isinstance(item, str) else item
        if not isinstance(group, int) or group not in present:
            raise GagaError(f'Operation {op.at} ("{op.kind}"): there is no group {item!r} here.')
        found.append(group)
    return found


def _splats(scene: Scene, op: Op) -> IntArray:
    if "groups" in op.fields:
        return group_indices(scene, _groups(scene, op))
    chosen = selected_indices(scene)
    if len(chosen) == 0:
        raise GagaError(
            f'Operation {op.at} ("{op.kind}"): nothing is selected. Give "groups", or select first.'
        )
    return chosen


def _vector(op: Op, field: str) -> DoubleArray:
    return np.array(op.fields[field], np.float64)


def _about(scene: Scene, op: Op, linear: DoubleArray) -> DoubleArray:
    """Map (3, 4) that turns or scales about a point: ``about``, else the middle of the splats."""
    if "about" in op.fields:
        centre = _vector(op, "about")
    else:
        centre = selection.world_means(scene, _splats(scene, op)).mean(axis=0, dtype=np.float64)
    return np.column_stack([linear, centre - linear @ centre])


def _shift(by: DoubleArray) -> DoubleArray:
    return np.column_stack([np.eye(3), by])


# --- operations ---------------------------------------------------------------------------------


def _select(scene: Scene, op: Op) -> Edit | None:
    mode = op.fields.get("how", "set")
    return edits.select(scene, group_indices(scene, _groups(scene, op)), mode)  # type: ignore[arg-type]


def _move(scene: Scene, op: Op) -> Edit | None:
    return edits.transform(scene, _splats(scene, op), _shift(_vector(op, "by")), "Move")


def _rotate(scene: Scene, op: Op) -> Edit | None:
    axis, degrees = _vector(op, "axis"), float(_vector(op, "degrees"))
    length = np.linalg.norm(axis)
    if length == 0:
        raise GagaError(f'Operation {op.at} ("rotate"): field "axis" must not be zero.')
    half = np.radians(degrees) / 2
    quat = np.concatenate([[np.cos(half)], np.sin(half) * axis / length])
    turn = _about(scene, op, quats_to_matrices(quat[None])[0])
    return edits.transform(scene, _splats(scene, op), turn, "Rotate")


def _scale(scene: Scene, op: Op) -> Edit | None:
    linear = np.diag(np.broadcast_to(_vector(op, "factor"), (3,)))
    return edits.transform(scene, _splats(scene, op), _about(scene, op, linear), "Scale")


def _transform(scene: Scene, op: Op) -> Edit | None:
    world = _vector(op, "matrix")
    if not np.linalg.det(world[:, :3]):
        raise GagaError(f'Operation {op.at} ("transform"): field "matrix" flattens space.')
    return edits.transform(scene, _splats(scene, op), world, "Transform")


def _recolor(scene: Scene, op: Op) -> Edit | None:
    if "color" not in op.fields and "opacity" not in op.fields:
        raise GagaError(f'Operation {op.at} ("recolor"): give "color", "opacity" or both.')
    splats = _splats(scene, op)
    opacity = float(_vector(op, "opacity")) if "opacity" in op.fields else 1.0
    affine = np.eye(3, 4)
    if "color" in op.fields:
        strength = float(_vector(op, "strength")) if "strength" in op.fields else 1.0
        affine = tint_affine(mean_color(scene, splats), _vector(op, "color"), strength)
    return edits.recolor(scene, splats, affine, opacity)


def _duplicate(scene: Scene, op: Op) -> Edit | None:
    by = _shift(_vector(op, "by")) if "by" in op.fields else None
    new_group = bool(op.fields.get("new_group", True))
    return edits.duplicate(scene, _splats(scene, op), by, new_group)


def _rename(scene: Scene, op: Op) -> Edit | None:
    groups = _groups(scene, op)
    if len(groups) != 1 or groups[0] == 0:
        raise GagaError(f'Operation {op.at} ("rename"): give one object in "groups".')
    return edits.rename(scene, groups[0], str(op.fields["name"]))


def _clean(scene: Scene, op: Op) -> Edit | None:
    groups = _groups(scene, op)
    if not groups:
        raise GagaError(f'Operation {op.at} ("clean"): no object is selected. Give "groups".')
    return relabel(scene, run_stage(clean_objects_stage(scene, groups)))


_GROUPS: Mapping[str, Check] = {"groups": group_list}
_ABOUT: Mapping[str, Check] = {"groups": group_list, "about": vector}
_KINDS: Mapping[str, _Kind] = {
    "select": _Kind(_select, _GROUPS, {"how": how}),
    "select_all": _Kind(lambda s, _: edits.select(s, selection.everything(s)), {}, {}),
    "select_none": _Kind(lambda s, _: edits.select(s, selection.nothing()), {}, {}),
    "invert": _Kind(lambda s, _: edits.select(s, selection.inverted(s)), {}, {}),
    "hide": _Kind(lambda s, op: edits.hide(s, _splats(s, op)), {}, _GROUPS),
    "show": _Kind(lambda s, op: edits.show(s, _splats(s, op)), _GROUPS, {}),
    "show_all": _Kind(lambda s, _: edits.show_all(s), {}, {}),
    "isolate": _Kind(lambda s, op: edits.isolate(s, _splats(s, op)), {}, _GROUPS),
    "lock": _Kind(lambda s, op: edits.lock(s, _splats(s, op)), {}, _GROUPS),
    "unlock": _Kind(lambda s, op: edits.unlock(s, _splats(s, op)), _GROUPS, {}),
    "delete": _Kind(lambda s, op: edits.delete(s, _splats(s, op)), {}, _GROUPS),
    "restore": _Kind(lambda s, _: edits.restore(s), {}, {}),
    "move": _Kind(_move, {"by": vector}, _GROUPS),
    "rotate": _Kind(_rotate, {"axis": vector, "degrees": number}, _ABOUT),
    "scale": _Kind(_scale, {"factor": factors}, _ABOUT),
    "transform": _Kind(_transform, {"matrix": matrix}, _GROUPS),
    "recolor": _Kind(
        _recolor, {}, {**_GROUPS, "color": color, "strength": share, "opacity": share}
    ),
    "duplicate": _Kind(_duplicate, {}, {**_GROUPS, "by": vector, "new_group": flag}),
    "rename": _Kind(_rename, {"name": name}, _GROUPS),
    "merge": _Kind(lambda s, op: edits.merge_groups(s, _groups(s, op)), {}, _GROUPS),
    "clean": _Kind(_clean, {}, _GROUPS),
    "undo": _Kind(lambda _s, _o: None, {}, {"times": count}),
    "redo": _Kind(lambda _s, _o: None, {}, {"times": count}),
}
OPERATIONS: Sequence[str] = tuple(sorted(_KINDS))
