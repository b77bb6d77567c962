"""The operations of edit scripts that select by region or number, and set scenes straight."""

from collections.abc import Mapping

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.errors import GagaError
from gaga_core.scene import edits
from gaga_core.scene.arrange import ground_map, mirror_map
from gaga_core.scene.edits import Edit
from gaga_core.scene.grade import Grade, grade_affine
from gaga_core.scene.objects import selected_indices
from gaga_core.scene.scene import Scene
from gaga_core.scene.script.fields import (
    Check,
    color,
    group_list,
    how,
    matrix,
    name,
    number,
    points,
    share,
    signed_share,
    vector,
)
from gaga_core.scene.script.operations import (
    Op,
    OperationKind,
    about,
    groups_of,
    splats_of,
    vector_of,
)
from gaga_core.scene.selection import algebra, by_value, by_volume, neighbourhood
from gaga_core.scene.selection.components import floaters


def _take(scene: Scene, op: Op, chosen: IntArray) -> Edit | None:
    mode = op.fields.get("how", "set")
    return edits.select(scene, chosen, mode)  # type: ignore[arg-type]


def _select_sphere(scene: Scene, op: Op) -> Edit | None:
    radius = float(vector_of(op, "radius"))
    return _take(scene, op, by_volume.in_sphere(scene, vector_of(op, "centre"), radius))


def _box(op: Op) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """World from unit cube (4, 4) of ``lo`` and ``hi``, or of a ``matrix``."""
    full = np.eye(4)
    if "matrix" in op.fields:
        full[:3] = vector_of(op, "matrix")
    elif "lo" in op.fields and "hi" in op.fields:
        lo, hi = vector_of(op, "lo"), vector_of(op, "hi")
        full[:3, :3] = np.diag(hi - lo)
        full[:3, 3] = (lo + hi) / 2
    else:
        raise GagaError(f'Operation {op.at} ("{op.kind}"): give "lo" and "hi", or "matrix".')
    if not np.linalg.det(full):
        raise GagaError(f'Operation {op.at} ("{op.kind}"): a side of the box has no length.')
    return full


def _crop(scene: Scene, op: Op) -> Edit | None:
    outside = np.setdiff1d(algebra.everything(scene), by_volume.in_box(scene, _box(op)))
    return edits.delete(scene, outside, "Crop")


def _select_range(scene: Scene, op: Op) -> Edit | None:
    named = str(op.fields["column"])
    low = float(vector_of(op, "low")) if "low" in op.fields else -np.inf
    high = float(vector_of(op, "high")) if "high" in op.fields else np.inf
    try:
        return _take(scene, op, by_value.in_range(scene, named, low, high))
    except ValueError as error:
        raise GagaError(f'Operation {op.at} ("{op.kind}"): {error}.') from error


def _select_color(scene: Scene, op: Op) -> Edit | None:
    tolerance = float(vector_of(op, "tolerance")) if "tolerance" in op.fields else 0.1
    return _take(scene, op, by_value.like_color(scene, vector_of(op, "color").tolist(), tolerance))


def _select_set(scene: Scene, op: Op) -> Edit | None:
    return _take(scene, op, edits.named_selection(scene, str(op.fields["name"])))


def _keep(scene: Scene, op: Op) -> Edit | None:
    return edits.keep_selection(scene, str(op.fields["name"]), splats_of(scene, op))


def _grown(scene: Scene, op: Op) -> Edit | None:
    splats = splats_of(scene, op)
    change = neighbourhood.grown if op.kind == "grow" else neighbourhood.shrunk
    if "reach" in op.fields:
        reach = float(vector_of(op, "reach"))
    else:
        reach = neighbourhood.spacing(scene, splats)
    return edits.select(scene, change(scene, splats, reach), "set", op.kind.capitalize())


def _floaters(scene: Scene, op: Op) -> Edit | None:
    strength = float(vector_of(op, "strength")) if "strength" in op.fields else 1.0
    if not strength > 0:
        raise GagaError(f'Operation {op.at} ("{op.kind}"): "strength" must be above 0.')
    among = splats_of(scene, op) if "groups" in op.fields else algebra.everything(scene)
    return edits.delete(scene, floaters(scene, among, strength), "Delete floaters")


def _grade(scene: Scene, op: Op) -> Edit | None:
    values = {key: value for key, value in op.fields.items() if key != "groups"}
    try:
        grade = Grade(**values)  # type: ignore[arg-type]
    except ValueError as error:
        raise GagaError(f'Operation {op.at} ("{op.kind}"): {error}.') from error
    splats = splats_of(scene, op)
    return edits.recolor(scene, splats, grade_affine(grade), grade.opacity, "Grade colors")


def _mirror(scene: Scene, op: Op) -> Edit | None:
    axis = str(op.fields["axis"])
    if axis not in ("x", "y", "z"):
        raise GagaError(f'Operation {op.at} ("mirror"): field "axis" must be x, y or z.')
    middle = about(scene, op, np.zeros((3, 3)))[:, 3]
    return edits.transform(
        scene, splats_of(scene, op), mirror_map("xyz".index(axis), middle), "Mirror"
    )


def _ground(scene: Scene, op: Op) -> Edit | None:
    up = vector_of(op, "up") if "up" in op.fields else np.array([0.0, 0.0, 1.0])
    if not up.any():
        raise GagaError(f'Operation {op.at} ("{op.kind}"): field "up" must not be zero.')
    moved = ground_map(vector_of(op, "points"), up, vector_of(op, "seen_from"))
    return edits.transform(scene, algebra.whole(scene), moved, "Align to ground")


def _separate(scene: Scene, op: Op) -> Edit | None:
    chosen = selected_indices(scene)
    if len(chosen) == 0:
        raise GagaError(f'Operation {op.at} ("{op.kind}"): nothing is selected. Select first.')
    return edits.separate(scene, chosen)


def _split(scene: Scene, op: Op) -> Edit | None:
    groups = groups_of(scene, op)
    if len(groups) != 1 or groups[0] == 0:
        raise GagaError(f'Operation {op.at} ("split"): give one object in "groups".')
    return edits.split(scene, groups[0])


def _assign(scene: Scene, op: Op) -> Edit | None:
    groups = groups_of(scene, op)
    chosen = selected_indices(scene)
    if len(groups) != 1 or len(chosen) == 0:
        raise GagaError(
            f'Operation {op.at} ("assign"): give one object in "groups", and select splats first.'
        )
    return edits.set_labels(scene, chosen, groups[0])


_HOW: Mapping[str, Check] = {"how": how}
_GROUPS: Mapping[str, Check] = {"groups": group_list}
_BOX: Mapping[str, Check] = {"lo": vector, "hi": vector, "matrix": matrix}
_GRADE: Mapping[str, Check] = {
    "tint": vector,
    "temperature": signed_share,
    "green": signed_share,
    "saturation": number,
    "brightness": signed_share,
    "black": signed_share,
    "white": number,
    "opacity": share,
}
REGION_KINDS: Mapping[str, OperationKind] = {
    "select_sphere": OperationKind(_select_sphere, {"centre": vector, "radius": number}, _HOW),
    "select_box": OperationKind(
        lambda s, op: _take(s, op, by_volume.in_box(s, _box(op))), {}, {**_BOX, **_HOW}
    ),
    "select_range": OperationKind(
        _select_range, {"column": name}, {"low": number, "high": number, **_HOW}
    ),
    "select_color": OperationKind(_select_color, {"color": color}, {"tolerance": share, **_HOW}),
    "select_set": OperationKind(_select_set, {"name": name}, _HOW),
    "keep_set": OperationKind(_keep, {"name": name}, _GROUPS),
    "grow": OperationKind(_grown, {}, {"reach": number, **_GROUPS}),
    "shrink": OperationKind(_grown, {}, {"reach": number, **_GROUPS}),
    "crop": OperationKind(_crop, {}, _BOX),
    "delete_floaters": OperationKind(_floaters, {}, {"strength": number, **_GROUPS}),
    "grade": OperationKind(_grade, {}, {**_GRADE, **_GROUPS}),
    "mirror": OperationKind(_mirror, {"axis": name}, {"about": vector, **_GROUPS}),
    "align_to_ground": OperationKind(
        _ground, {"points": points, "seen_from": vector}, {"up": vector}
    ),
    "separate": OperationKind(_separate, {}, {}),
    "split": OperationKind(_split, {}, _GROUPS),
    "assign": OperationKind(_assign, _GROUPS, {}),
}
