"""The operations of edit scripts that act on objects: each makes an edit of a scene."""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from msgspec import UNSET, UnsetType, field

from gaga_core.edit_script.base import (
    OnGroups,
    OnSplats,
    Operation,
    Views,
    centred,
    given,
    groups_of,
    one_object_of,
)
from gaga_core.edit_script.fields import (
    Color,
    Count,
    Factors,
    Flag,
    Groups,
    How,
    LabelSource,
    Matrix,
    Name,
    Number,
    Share,
    Vector,
)
from gaga_core.errors import GagaError
from gaga_core.geometry import quats_to_matrices
from gaga_core.scene import edits
from gaga_core.scene.edits import Edit
from gaga_core.scene.edits.history import History
from gaga_core.scene.objects import group_indices
from gaga_core.scene.orientation import motion_between, pose_of, with_degrees
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection import algebra
from gaga_core.scene.selection.bounds import splat_box
from gaga_core.scene.tint import mean_color, tint_affine

# --- selecting, hiding, locking, deleting -------------------------------------------------------


class Select(Operation, frozen=True):
    """Select objects."""

    groups: Groups
    how: How = "set"

    def edit(self, scene: Scene) -> Edit | None:
        return edits.select(scene, group_indices(scene, groups_of(scene, self.groups)), self.how)


class SelectAll(Operation, frozen=True):
    """Select everything that is visible and not locked."""

    def edit(self, scene: Scene) -> Edit | None:
        return edits.select(scene, algebra.everything(scene))


class SelectNone(Operation, frozen=True):
    """Select nothing."""

    def edit(self, scene: Scene) -> Edit | None:
        return edits.select(scene, algebra.nothing())


class Invert(Operation, frozen=True):
    """Select what is not selected."""

    def edit(self, scene: Scene) -> Edit | None:
        return edits.select(scene, algebra.inverted(scene))


class Hide(OnSplats, frozen=True):
    """Hide."""

    def edit(self, scene: Scene) -> Edit | None:
        return edits.hide(scene, self.splats(scene))


class Show(Operation, frozen=True):
    """Show again."""

    groups: Groups

    def edit(self, scene: Scene) -> Edit | None:
        return edits.show(scene, group_indices(scene, groups_of(scene, self.groups)))


class ShowAll(Operation, frozen=True):
    """Show everything."""

    def edit(self, scene: Scene) -> Edit | None:
        return edits.show_all(scene)


class Isolate(OnSplats, frozen=True):
    """Hide everything else."""

    def edit(self, scene: Scene) -> Edit | None:
        return edits.isolate(scene, self.splats(scene))


class Lock(OnSplats, frozen=True):
    """Keep from being selected."""

    def edit(self, scene: Scene) -> Edit | None:
        return edits.lock(scene, self.splats(scene))


class Unlock(Operation, frozen=True):
    """Allow to be selected again."""

    groups: Groups

    def edit(self, scene: Scene) -> Edit | None:
        return edits.unlock(scene, group_indices(scene, groups_of(scene, self.groups)))


class Delete(OnSplats, frozen=True):
    """Delete."""

    def edit(self, scene: Scene) -> Edit | None:
        return edits.delete(scene, self.splats(scene))


class Restore(Operation, frozen=True):
    """Bring back everything that was deleted."""

    def edit(self, scene: Scene) -> Edit | None:
        return edits.restore(scene)


# --- placing and coloring -----------------------------------------------------------------------


class Move(OnSplats, frozen=True):
    """Shift by a vector, scene units."""

    by: Vector

    def edit(self, scene: Scene) -> Edit | None:
        shift = np.column_stack([np.eye(3), np.array(self.by, np.float64)])
        return edits.transform(scene, self.splats(scene), shift, "Move")


class Rotate(OnSplats, frozen=True):
    """Turn about a point, else about the middle of the splats."""

    axis: Vector
    degrees: Number
    about: Vector | UnsetType = UNSET

    def edit(self, scene: Scene) -> Edit | None:
        axis = np.array(self.axis, np.float64)
        length = np.linalg.norm(axis)
        if length == 0:
            raise GagaError('field "axis" must not be zero.')
        half = np.radians(self.degrees) / 2
        quat = np.concatenate([[np.cos(half)], np.sin(half) * axis / length])
        splats = self.splats(scene)
        turn = centred(scene, splats, self.about, quats_to_matrices(quat[None])[0])
        return edits.transform(scene, splats, turn, "Rotate")


class Scale(OnSplats, frozen=True):
    """Scale by one factor or three about a point, else about the middle of the splats."""

    factor: Factors
    about: Vector | UnsetType = UNSET

    def edit(self, scene: Scene) -> Edit | None:
        splats = self.splats(scene)
        linear = np.diag(np.broadcast_to(np.array(self.factor, np.float64), (3,)))
        return edits.transform(scene, splats, centred(scene, splats, self.about, linear), "Scale")


class Transform(OnSplats, frozen=True):
    """Apply any affine map of positions, 3 rows of 4 numbers."""

    matrix: Matrix

    def edit(self, scene: Scene) -> Edit | None:
        world = np.array(self.matrix, np.float64)
        if not np.linalg.det(world[:, :3]):
            raise GagaError('field "matrix" flattens space.')
        return edits.transform(scene, self.splats(scene), world, "Transform")


class Place(OnSplats, frozen=True):
    """Put to a position, a rotation and a scale; what is not given stays."""

    position: Vector | UnsetType = UNSET  # of the middle of the box
    rotation: Vector | UnsetType = UNSET  # degrees about the world's x, then y, then z
    scale: Factors | UnsetType = UNSET  # along the object's own axes

    def edit(self, scene: Scene) -> Edit | None:
        splats = self.splats(scene)
        lo, hi = splat_box(scene, splats, 0.98)
        start = pose_of(scene, splats, (lo + hi) / 2)
        stop = start
        if not isinstance(self.rotation, UnsetType):
            stop = with_degrees(stop, np.array(self.rotation, np.float64), local=False)
        if not isinstance(self.position, UnsetType):
            stop = replace(stop, centre=np.array(self.position, np.float64))
        if not isinstance(self.scale, UnsetType):
            scale = np.broadcast_to(np.array(self.scale, np.float64), (3,))
            stop = replace(stop, scale=scale * np.sign(start.scale))
        return edits.transform(scene, splats, motion_between(start, stop), "Place")


class ResetPlacement(OnSplats, frozen=True):
    """Put back to where the file has it."""

    def edit(self, scene: Scene) -> Edit | None:
        return edits.reset_placement(scene, self.splats(scene))


class Recolor(OnSplats, frozen=True):
    """Give a new mean color, a factor of opacity, or both."""

    color: Color | UnsetType = UNSET
    strength: Share = 1.0
    opacity: Share | UnsetType = UNSET

    def edit(self, scene: Scene) -> Edit | None:
        if self.color is UNSET and self.opacity is UNSET:
            raise GagaError('give "color", "opacity" or both.')
        splats, affine = self.splats(scene), np.eye(3, 4)
        if not isinstance(self.color, UnsetType):
            mean = mean_color(scene, splats)
            affine = tint_affine(mean, np.array(self.color, np.float64), self.strength)
        return edits.recolor(scene, splats, affine, given(self.opacity, 1.0))


# --- objects ------------------------------------------------------------------------------------


class Duplicate(OnSplats, frozen=True):
    """Copy, as a new object unless ``new_group`` is false."""

    by: Vector | UnsetType = UNSET
    new_group: Flag = True

    def edit(self, scene: Scene) -> Edit | None:
        by = None
        if not isinstance(self.by, UnsetType):
            by = np.column_stack([np.eye(3), np.array(self.by, np.float64)])
        return edits.duplicate(scene, self.splats(scene), by, self.new_group)


class Rename(OnGroups, frozen=True):
    """Name one object."""

    name: Name

    def edit(self, scene: Scene) -> Edit | None:
        return edits.rename(scene, one_object_of(scene, self.groups), self.name)


class Merge(OnGroups, frozen=True):
    """Make one object of several."""

    def edit(self, scene: Scene) -> Edit | None:
        return edits.merge_groups(scene, groups_of(scene, self.groups))


class SplitHere(OnGroups, frozen=True):
    """Make objects of the parts that one object has a level of detail finer."""

    def edit(self, scene: Scene) -> Edit | None:
        return edits.split_here(scene, one_object_of(scene, self.groups))


class JoinHere(OnGroups, frozen=True):
    """Join one object with those that are one thing with it a level coarser."""

    def edit(self, scene: Scene) -> Edit | None:
        return edits.join_here(scene, one_object_of(scene, self.groups))


class Labels(Operation, frozen=True):
    """Take the groups from the votes of the masks, or from identities."""

    source: LabelSource = field(name="from")

    def edit(self, scene: Scene) -> Edit | None:
        return edits.use_labels(scene, self.source)


# --- history ------------------------------------------------------------------------------------


class Undo(Operation, frozen=True):
    """Take back so many edits."""

    times: Count = 1

    def run(self, history: History, scene: Scene, views: Views = tuple) -> str:
        titles = _until_none(history.undo, self.times)
        return f"Undo {titles}" if titles else ""


class Redo(Operation, frozen=True):
    """Do so many edits again."""

    times: Count = 1

    def run(self, history: History, scene: Scene, views: Views = tuple) -> str:
        titles = _until_none(history.redo, self.times)
        return f"Redo {titles}" if titles else ""


def _until_none(step: Callable[[], str | None], times: int) -> str:
    """Titles of so many steps, or of as many as there are."""
    done = []
    for _ in range(times):
        title = step()
        if title is None:
            break
        done.append(title)
    return ", ".join(done)


ObjectOperation: TypeAlias = (
    Select
    | SelectAll
    | SelectNone
    | Invert
    | Hide
    | Show
    | ShowAll
    | Isolate
    | Lock
    | Unlock
    | Delete
    | Restore
    | Move
    | Rotate
    | Scale
    | Transform
    | Place
    | ResetPlacement
    | Recolor
    | Duplicate
    | Rename
    | Merge
    | SplitHere
    | JoinHere
    | Labels
    | Undo
    | Redo
)
