"""What every operation of an edit script is, and what it acts on."""

from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

import numpy as np
from msgspec import UNSET, Struct, UnsetType

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.edit_script.fields import Groups, Vector
from gaga_core.errors import GagaError
from gaga_core.scene.edits import Edit
from gaga_core.scene.edits.folders import existing
from gaga_core.scene.edits.history import History
from gaga_core.scene.folders import SEPARATOR, tidy_path
from gaga_core.scene.objects import group_indices, selected_groups, selected_indices
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection import algebra

_T = TypeVar("_T")
Views = Callable[[], Sequence[Camera]]  # of the photos, around the scene as it is now; world


def _snake(name: str) -> str:
    """The ``op`` of a class: "SelectAll" is "select_all"."""
    return "".join("_" + c.lower() if c.isupper() and i else c.lower() for i, c in enumerate(name))


class Operation(Struct, frozen=True, forbid_unknown_fields=True, tag_field="op", tag=_snake):
    """An operation of a script as it is read: its fields are those of the JSON object."""

    def edit(self, scene: Scene) -> Edit | None:
        """The edit of ``scene``; None when nothing would change.

        Raises ``GagaError`` with a sentence for what this scene does not have.
        """
        raise NotImplementedError

    def edit_seen(self, scene: Scene, views: Views) -> Edit | None:
        """The edit, where it also asks what the cameras of the photos saw."""
        return self.edit(scene)

    def run(self, history: History, scene: Scene, views: Views = tuple) -> str:
        """Apply it through ``history``; its title, "" when it changed nothing."""
        edit = self.edit_seen(scene, views)
        return edit.title if edit is not None and history.do(edit) else ""


class OnSplats(Operation, frozen=True, kw_only=True):
    """An operation on the splats of its groups, or on the selection."""

    groups: Groups | UnsetType = UNSET

    def splats(self, scene: Scene) -> IntArray:
        """Splats (K,) of its groups, else the selected ones."""
        return splats_of(scene, self.groups)


class OnGroups(Operation, frozen=True, kw_only=True):
    """An operation on its groups, or on those of the selection."""

    groups: Groups | UnsetType = UNSET


def given(value: _T | UnsetType, default: _T) -> _T:
    """An optional field, or its default."""
    return default if isinstance(value, UnsetType) else value


def groups_of(scene: Scene, wanted: Groups | UnsetType) -> list[int]:
    """Group ids, names looked up; those of the selection when none are given.

    "Kitchen/" are all groups that lie in the folder "Kitchen"; "teapot/", if there is no such
    folder, are the object "teapot" and all that lies under it.
    """
    if isinstance(wanted, UnsetType):
        return [int(g) for g in selected_groups(scene)]
    present = {int(g) for g in np.unique(scene.labels)}
    by_name = {f"group {g}": g for g in present}  # a description may change: scripts do not use it
    by_name |= {scene.names[g]: g for g in sorted(present, reverse=True) if g in scene.names}
    found: list[int] = []
    for item in wanted:
        if isinstance(item, str) and item.endswith(SEPARATOR) and item not in by_name:
            found += [group for group in _inside(scene, item, by_name) if group in present]
            continue
        group = by_name.get(item) if isinstance(item, str) else item
        if group not in present:
            raise GagaError(f"there is no group {item!r} here.")
        assert group is not None
        found.append(group)
    return found


def _inside(scene: Scene, item: str, by_name: Mapping[str, int]) -> tuple[int, ...]:
    """The groups that "Kitchen/", a folder, or "teapot/", an object, mean."""
    name = item.removesuffix(SEPARATOR)
    group = by_name.get(name, int(name) if name.isdecimal() else 0)
    if tidy_path(item) in scene.folders.paths or group <= 0 or group not in by_name.values():
        return scene.folders.groups(existing(scene, item))
    return group, *scene.folders.under(group)


def one_object_of(scene: Scene, wanted: Groups | UnsetType) -> int:
    """The one object that an operation names, or that is selected."""
    groups = groups_of(scene, wanted)
    if len(groups) != 1 or groups[0] == 0:
        raise GagaError('give one object in "groups".')
    return groups[0]


def splats_of(scene: Scene, wanted: Groups | UnsetType) -> IntArray:
    """Splats (K,) of the groups, else the selected ones."""
    if not isinstance(wanted, UnsetType):
        return group_indices(scene, groups_of(scene, wanted))
    chosen = selected_indices(scene)
    if len(chosen) == 0:
        raise GagaError('nothing is selected. Give "groups", or select first.')
    return chosen


def centred(
    scene: Scene, splats: IntArray, about: Vector | UnsetType, linear: DoubleArray
) -> DoubleArray:
    """Map (3, 4) that turns or scales about a point: ``about``, else the middle of the splats."""
    if isinstance(about, UnsetType):
        centre = algebra.world_means(scene, splats).mean(axis=0, dtype=np.float64)
    else:
        centre = np.array(about, np.float64)
    return np.column_stack([linear, centre - linear @ centre])
