"""The operations of edit scripts that act on objects: each makes an edit of a scene."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.geometry import quats_to_matrices
from gaga_core.progress import run_stage
from gaga_core.scene import edits
from gaga_core.scene.cleanup.edits import clean_objects_stage, relabel
from gaga_core.scene.edits import Edit
from gaga_core.scene.objects import group_indices, selected_groups, selected_indices
from gaga_core.scene.scene import Scene
from gaga_core.scene.script.fields import (
    Check,
    Value,
    color,
    count,
    factors,
    flag,
    group_list,
    how,
    label_source,
    matrix,
    name,
    number,
    share,
    vector,
)
from gaga_core.scene.selection import algebra
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
class OperationKind:
    """What an operation takes and how it becomes an edit."""

    build: Callable[[Scene, Op], Edit | None]
    required: Mapping[str, Check]
    optional: Mapping[str, Check]


# --- what operations act on ---------------------------------------------------------------------


def groups_of(scene: Scene, op: Op) -> list[int]:
    """Group ids of an operation, names looked up; those of the selection when it has none."""
    wanted = op.fields.get("groups")
    if wanted is None:
        return [int(g) for g in selected_groups(scene)]
    assert isinstance(wanted, tuple)
    present = {int(g) for g in np.unique(scene.labels)}
    by_name = {f"group {g}": g for g in present}  # a description may change: scripts do not use it
    by_name |= {scene.names[g]: g for g in sorted(present, reverse=True) if g in scene.names}
    found: list[int] = []
    for item in wanted:
        group = by_name.get(item) if isinstance(item, str) else item
        if not isinstance(group, int) or group not in present:
            raise GagaError(f'Operation {op.at} ("{op.kind}"): there is no group {item!r} here.')
        found.append(group)
    return found


def splats_of(scene: Scene, op: Op) -> IntArray:
    """Splats (K,) of the groups that an operation names, else the selected ones."""
    if "groups" in op.fields:
        return group_indices(scene, groups_of(scene, op))
    chosen = selected_indices(scene)
    if len(chosen) == 0:
        raise GagaError(
            f'Operation {op.at} ("{op.kind}"): nothing is selected. Give "groups", or select first.'
        )
    return chosen


def vector_of(op: Op, field: str) -> DoubleArray:
    """The numbers of a field: (), (3,), (3, 3) or (3, 4)."""
    return np.array(op.fields[field], np.float64)


def about(scene: Scene, op: Op, linear: DoubleArray) -> DoubleArray:
    """Map (3, 4) that turns or scales about a point: ``about``, else the middle of the splats."""
    if "about" in op.fields:
        centre = vector_of(op, "about")
    else:
        centre = algebra.world_means(scene, splats_of(scene, op)).mean(axis=0, dtype=np.float64)
    return np.column_stack([linear, centre - linear @ centre])


def _shift(by: DoubleArray) -> DoubleArray:
    return np.column_stack([np.eye(3), by])


# --- operations ---------------------------------------------------------------------------------


def _select(scene: Scene, op: Op) -> Edit | None:
    mode = op.fields.get("how", "set")
    return edits.select(scene, group_indices(scene, groups_of(scene, op)), mode)  # type: ignore[arg-type]


def _move(scene: Scene, op: Op) -> Edit | None:
    return edits.transform(scene, splats_of(scene, op), _shift(vector_of(op, "by")), "Move")


def _rotate(scene: Scene, op: Op) -> Edit | None:
    axis, degrees = vector_of(op, "axis"), float(vector_of(op, "degrees"))
    length = np.linalg.norm(axis)
    if length == 0:
        raise GagaError(f'Operation {op.at} ("rotate"): field "axis" must not be zero.')
    half = np.radians(degrees) / 2
    quat = np.concatenate([[np.cos(half)], np.sin(half) * axis / length])
    turn = about(scene, op, quats_to_matrices(quat[None])[0])
    return edits.transform(scene, splats_of(scene, op), turn, "Rotate")


def _scale(scene: Scene, op: Op) -> Edit | None:
    linear = np.diag(np.broadcast_to(vector_of(op, "factor"), (3,)))
    return edits.transform(scene, splats_of(scene, op), about(scene, op, linear), "Scale")


def _transform(scene: Scene, op: Op) -> Edit | None:
    world = vector_of(op, "matrix")
    if not np.linalg.det(world[:, :3]):
        raise GagaError(f'Operation {op.at} ("transform"): field "matrix" flattens space.')
    return edits.transform(scene, splats_of(scene, op), world, "Transform")


def _recolor(scene: Scene, op: Op) -> Edit | None:
    if "color" not in op.fields and "opacity" not in op.fields:
        raise GagaError(f'Operation {op.at} ("recolor"): give "color", "opacity" or both.')
    splats = splats_of(scene, op)
    opacity = float(vector_of(op, "opacity")) if "opacity" in op.fields else 1.0
    affine = np.eye(3, 4)
    if "color" in op.fields:
        strength = float(vector_of(op, "strength")) if "strength" in op.fields else 1.0
        affine = tint_affine(mean_color(scene, splats), vector_of(op, "color"), strength)
    return edits.recolor(scene, splats, affine, opacity)


def _duplicate(scene: Scene, op: Op) -> Edit | None:
    by = _shift(vector_of(op, "by")) if "by" in op.fields else None
    new_group = bool(op.fields.get("new_group", True))
    return edits.duplicate(scene, splats_of(scene, op), by, new_group)


def _rename(scene: Scene, op: Op) -> Edit | None:
    return edits.rename(scene, _one_object(scene, op), str(op.fields["name"]))


def _labels(scene: Scene, op: Op) -> Edit | None:
    return edits.use_labels(scene, op.fields["from"])  # type: ignore[arg-type]


def _clean(scene: Scene, op: Op) -> Edit | None:
    groups = groups_of(scene, op)
    if not groups:
        raise GagaError(f'Operation {op.at} ("clean"): no object is selected. Give "groups".')
    return relabel(scene, run_stage(clean_objects_stage(scene, groups)))


def _split_here(scene: Scene, op: Op) -> Edit | None:
    return edits.split_here(scene, _one_object(scene, op))


def _join_here(scene: Scene, op: Op) -> Edit | None:
    return edits.join_here(scene, _one_object(scene, op))


def _one_object(scene: Scene, op: Op) -> int:
    groups = groups_of(scene, op)
    if len(groups) != 1 or groups[0] == 0:
        raise GagaError(f'Operation {op.at} ("{op.kind}"): give one object in "groups".')
    return groups[0]


GROUPS: Mapping[str, Check] = {"groups": group_list}
ABOUT: Mapping[str, Check] = {"groups": group_list, "about": vector}
OBJECT_KINDS: Mapping[str, OperationKind] = {
    "select": OperationKind(_select, GROUPS, {"how": how}),
    "select_all": OperationKind(lambda s, _: edits.select(s, algebra.everything(s)), {}, {}),
    "select_none": OperationKind(lambda s, _: edits.select(s, algebra.nothing()), {}, {}),
    "invert": OperationKind(lambda s, _: edits.select(s, algebra.inverted(s)), {}, {}),
    "hide": OperationKind(lambda s, op: edits.hide(s, splats_of(s, op)), {}, GROUPS),
    "show": OperationKind(lambda s, op: edits.show(s, splats_of(s, op)), GROUPS, {}),
    "show_all": OperationKind(lambda s, _: edits.show_all(s), {}, {}),
    "isolate": OperationKind(lambda s, op: edits.isolate(s, splats_of(s, op)), {}, GROUPS),
    "lock": OperationKind(lambda s, op: edits.lock(s, splats_of(s, op)), {}, GROUPS),
    "unlock": OperationKind(lambda s, op: edits.unlock(s, splats_of(s, op)), GROUPS, {}),
    "delete": OperationKind(lambda s, op: edits.delete(s, splats_of(s, op)), {}, GROUPS),
    "restore": OperationKind(lambda s, _: edits.restore(s), {}, {}),
    "move": OperationKind(_move, {"by": vector}, GROUPS),
    "rotate": OperationKind(_rotate, {"axis": vector, "degrees": number}, ABOUT),
    "scale": OperationKind(_scale, {"factor": factors}, ABOUT),
    "transform": OperationKind(_transform, {"matrix": matrix}, GROUPS),
    "recolor": OperationKind(
        _recolor, {}, {**GROUPS, "color": color, "strength": share, "opacity": share}
    ),
    "duplicate": OperationKind(_duplicate, {}, {**GROUPS, "by": vector, "new_group": flag}),
    "rename": OperationKind(_rename, {"name": name}, GROUPS),
    "merge": OperationKind(lambda s, op: edits.merge_groups(s, groups_of(s, op)), {}, GROUPS),
    "split_here": OperationKind(_split_here, {}, GROUPS),
    "join_here": OperationKind(_join_here, {}, GROUPS),
    "labels": OperationKind(_labels, {"from": label_source}, {}),
    "clean": OperationKind(_clean, {}, GROUPS),
    "undo": OperationKind(lambda _s, _o: None, {}, {"times": count}),
    "redo": OperationKind(lambda _s, _o: None, {}, {"times": count}),
}
