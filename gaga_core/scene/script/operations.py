"""The operations of edit scripts: each reads its fields from JSON and makes an edit of a scene."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Literal, TypeVar

import numpy as np
from msgspec import UNSET, Meta, Struct, UnsetType, field

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.geometry import quats_to_matrices
from gaga_core.progress import run_stage
from gaga_core.scene import edits
from gaga_core.scene.arrange import ground_map, mirror_map
from gaga_core.scene.cleanup.edits import clean_objects_stage, relabel
from gaga_core.scene.edits.folders import existing
from gaga_core.scene.edits.history import History
from gaga_core.scene.edits.values import Edit
from gaga_core.scene.folders import SEPARATOR, tidy_path
from gaga_core.scene.grade import Grade, grade_affine
from gaga_core.scene.objects import group_indices, selected_groups, selected_indices
from gaga_core.scene.pose import motion_between, pose_of, with_degrees
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection import algebra, by_value, by_volume, neighbourhood
from gaga_core.scene.selection.bounds import splat_box
from gaga_core.scene.selection.components import floaters
from gaga_core.scene.tint import mean_color, tint_affine

_T = TypeVar("_T")
Views = Callable[[], Sequence[Camera]]  # of the photos, around the scene as it is now; world

# --- fields -------------------------------------------------------------------------------------

# What msgspec checks while it reads a script: descriptions end the sentence "field .. must be ..".
# A union of a bounded number and a tuple of fixed length crashes msgspec 0.22; within unions,
# tuples of any length have bounds instead.
_LARGEST = 1e18  # products of three stay finite in float64, and values in float32
Number = Annotated[
    float, Meta(ge=-_LARGEST, le=_LARGEST, description=f"a number up to {_LARGEST:g}")
]
Positive = Annotated[float, Meta(gt=0, le=_LARGEST, description="a number above 0")]
Share = Annotated[float, Meta(ge=0, le=1, description="a number between 0 and 1")]
SignedShare = Annotated[float, Meta(ge=-1, le=1, description="a number between -1 and 1")]
Count = Annotated[int, Meta(ge=1, description="a whole number of at least 1")]
Flag = Annotated[bool, Meta(description="true or false")]
Name = Annotated[str, Meta(max_length=200, description="a text of at most 200 characters")]
FilePath = Annotated[str, Meta(max_length=4096, description="the path of a file")]
Digest = Annotated[
    str, Meta(pattern="^([0-9a-fA-F]{64})?$", description="64 hexadecimal digits (SHA-256)")
]
How = Annotated[  # a way to change the selection
    Literal["set", "add", "remove", "intersect"], Meta(description="set, add, remove or intersect")
]
LabelSource = Annotated[Literal["votes", "identities"], Meta(description="votes or identities")]
Axis = Annotated[Literal["x", "y", "z"], Meta(description="x, y or z")]
Vector = Annotated[
    tuple[Number, Number, Number], Meta(description=f"a list of 3 numbers up to {_LARGEST:g}")
]
Color = Annotated[  # red, green, blue
    tuple[Share, Share, Share], Meta(description="a list of 3 numbers between 0 and 1")
]
_Three = Annotated[tuple[Positive, ...], Meta(min_length=3, max_length=3)]
Factors = Annotated[  # of all axes, or of each
    Positive | _Three, Meta(description="above 0: one number, or a list of 3")
]
_Row = tuple[Number, Number, Number, Number]
Matrix = Annotated[tuple[_Row, _Row, _Row], Meta(description="3 rows of 4 numbers")]
Points = Annotated[tuple[Vector, Vector, Vector], Meta(description="3 points of 3 numbers")]
Ends = Annotated[tuple[Vector, Vector], Meta(description="2 points of 3 numbers")]
OneGroup = Annotated[int | str, Meta(description="a group id or name")]
Groups = Annotated[
    tuple[int | str, ...], Meta(min_length=1, description="a list of group ids or names")
]
Path = Annotated[str, Meta(max_length=2000, description='a text such as "Kitchen/Cups"')]

# --- what an operation is and acts on -----------------------------------------------------------


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


# --- folders and parents ------------------------------------------------------------------------


class NewFolder(Operation, frozen=True):
    """Make an empty folder."""

    folder: Path

    def edit(self, scene: Scene) -> Edit | None:
        return edits.new_folder(scene, self.folder)


class PutInFolder(Operation, frozen=True):
    """Put objects into a folder, which is made if it is not there; "" takes them out of all."""

    folder: Path
    groups: Groups | UnsetType = UNSET

    def edit(self, scene: Scene) -> Edit | None:
        groups = groups_of(scene, self.groups)
        if not groups:
            raise GagaError('no object is selected. Give "groups", or select first.')
        return edits.put_in_folder(scene, groups, self.folder)


class MoveFolder(Operation, frozen=True):
    """Put a folder into another one; "" takes it out of all."""

    folder: Path
    into: Path = ""

    def edit(self, scene: Scene) -> Edit | None:
        return edits.put_in_folder(scene, (), self.into, (self.folder,), "Move folder")


class RenameFolder(Operation, frozen=True):
    """Give a folder another name."""

    folder: Path
    name: Name

    def edit(self, scene: Scene) -> Edit | None:
        return edits.rename_folder(scene, self.folder, self.name)


class DeleteFolder(Operation, frozen=True):
    """Take a folder away; what is in it goes into the folder that it was in."""

    folder: Path

    def edit(self, scene: Scene) -> Edit | None:
        return edits.delete_folder(scene, self.folder)


class SetParent(Operation, frozen=True):
    """Put objects under another object; what lies under them goes along."""

    parent: OneGroup
    groups: Groups | UnsetType = UNSET

    def edit(self, scene: Scene) -> Edit | None:
        groups = groups_of(scene, self.groups)
        if not groups:
            raise GagaError('no object is selected. Give "groups", or select first.')
        return edits.set_parent(scene, groups, one_object_of(scene, (self.parent,)))


class LeaveParent(Operation, frozen=True):
    """Take objects out from under the object that they lie under, to where that is."""

    groups: Groups | UnsetType = UNSET

    def edit(self, scene: Scene) -> Edit | None:
        return edits.leave_parent(scene, groups_of(scene, self.groups))


# --- selecting by region and number -------------------------------------------------------------


class Selecting(Operation, frozen=True, kw_only=True):
    """An operation that changes the selection by what it finds."""

    how: How = "set"

    def found(self, scene: Scene) -> IntArray:
        """Splats (K,) in order."""
        raise NotImplementedError

    def edit(self, scene: Scene) -> Edit | None:
        return edits.select(scene, self.found(scene), self.how)


class SelectSphere(Selecting, frozen=True):
    """Splats whose centre lies in a ball."""

    centre: Vector
    radius: Number

    def found(self, scene: Scene) -> IntArray:
        return by_volume.in_sphere(scene, np.array(self.centre, np.float64), self.radius)


class SelectBox(Selecting, frozen=True):
    """Splats in a box of two corners, or in a map of the unit cube."""

    lo: Vector | UnsetType = UNSET
    hi: Vector | UnsetType = UNSET
    matrix: Matrix | UnsetType = UNSET

    def found(self, scene: Scene) -> IntArray:
        return by_volume.in_box(scene, _box(self.lo, self.hi, self.matrix))


class SelectRange(Selecting, frozen=True):
    """Splats by a number of theirs."""

    column: Name
    low: Number | UnsetType = UNSET
    high: Number | UnsetType = UNSET

    def found(self, scene: Scene) -> IntArray:
        low, high = given(self.low, -np.inf), given(self.high, np.inf)
        return by_value.in_range(scene, self.column, low, high)


class SelectColor(Selecting, frozen=True):
    """Splats by their color."""

    color: Color
    tolerance: Share = 0.1

    def found(self, scene: Scene) -> IntArray:
        return by_value.like_color(scene, self.color, self.tolerance)


class SelectSet(Selecting, frozen=True):
    """A named selection."""

    name: Name

    def found(self, scene: Scene) -> IntArray:
        return edits.named_selection(scene, self.name)


class KeepSet(OnSplats, frozen=True):
    """Keep the selection under a name."""

    name: Name

    def edit(self, scene: Scene) -> Edit | None:
        return edits.keep_selection(scene, self.name, self.splats(scene))


class Grow(OnSplats, frozen=True):
    """Add what lies within a distance of the selection."""

    reach: Number | UnsetType = UNSET

    def edit(self, scene: Scene) -> Edit | None:
        splats = self.splats(scene)
        reach = _reach(scene, splats, self.reach)
        return edits.select(scene, neighbourhood.grown(scene, splats, reach), "set", "Grow")


class Shrink(OnSplats, frozen=True):
    """Remove what lies near the border of the selection."""

    reach: Number | UnsetType = UNSET

    def edit(self, scene: Scene) -> Edit | None:
        splats = self.splats(scene)
        reach = _reach(scene, splats, self.reach)
        return edits.select(scene, neighbourhood.shrunk(scene, splats, reach), "set", "Shrink")


# --- deleting -----------------------------------------------------------------------------------


class Crop(Operation, frozen=True):
    """Delete everything outside a box of two corners, or of a map of the unit cube."""

    lo: Vector | UnsetType = UNSET
    hi: Vector | UnsetType = UNSET
    matrix: Matrix | UnsetType = UNSET

    def edit(self, scene: Scene) -> Edit | None:
        inside = by_volume.in_box(scene, _box(self.lo, self.hi, self.matrix))
        outside = np.setdiff1d(algebra.everything(scene), inside)
        return edits.delete(scene, outside, "Crop")


class DeleteFloaters(OnSplats, frozen=True):
    """Delete splats that stand alone: of the groups, else of everything."""

    strength: Positive = 1.0

    def edit(self, scene: Scene) -> Edit | None:
        everything = self.groups is UNSET
        among = algebra.everything(scene) if everything else self.splats(scene)
        return edits.delete(scene, floaters(scene, among, self.strength), "Delete floaters")


# --- setting straight ---------------------------------------------------------------------------


class GradeColors(OnSplats, frozen=True, tag="grade"):
    """Grade colors."""

    tint: Vector = (1.0, 1.0, 1.0)
    temperature: SignedShare = 0.0
    green: SignedShare = 0.0
    saturation: Number = 1.0
    brightness: SignedShare = 0.0
    black: SignedShare = 0.0
    white: Number = 1.0
    opacity: Share = 1.0

    def edit(self, scene: Scene) -> Edit | None:
        grade = Grade(
            tint=self.tint,
            temperature=self.temperature,
            green=self.green,
            saturation=self.saturation,
            brightness=self.brightness,
            black=self.black,
            white=self.white,
            opacity=self.opacity,
        )
        splats = self.splats(scene)
        return edits.recolor(scene, splats, grade_affine(grade), grade.opacity, "Grade colors")


class Mirror(OnSplats, frozen=True):
    """Mirror across x, y or z about a point, else about the middle of the splats."""

    axis: Axis
    about: Vector | UnsetType = UNSET

    def edit(self, scene: Scene) -> Edit | None:
        splats = self.splats(scene)
        middle = centred(scene, splats, self.about, np.zeros((3, 3)))[:, 3]
        mirrored = mirror_map("xyz".index(self.axis), middle)
        return edits.transform(scene, splats, mirrored, "Mirror")


class AlignToGround(Operation, frozen=True):
    """Make the plane of three points level."""

    points: Points
    seen_from: Vector
    up: Vector = (0.0, 0.0, 1.0)

    def edit(self, scene: Scene) -> Edit | None:
        up = np.array(self.up, np.float64)
        if not up.any():
            raise GagaError('field "up" must not be zero.')
        points, eye = np.array(self.points, np.float64), np.array(self.seen_from, np.float64)
        moved = ground_map(points, up, eye)
        return edits.move_scene(scene, moved, "Align to ground")


class SetScale(Operation, frozen=True):
    """Scale everything so that the way between two points has a length in metres."""

    points: Ends
    metres: Positive

    def edit(self, scene: Scene) -> Edit | None:
        one, two = np.array(self.points, np.float64)
        length = float(np.linalg.norm(two - one))
        return edits.set_scale(scene, length, self.metres, np.zeros(3))


class SetOrigin(Operation, frozen=True):
    """Move everything so that a point becomes the origin."""

    point: Vector

    def edit(self, scene: Scene) -> Edit | None:
        return edits.set_origin(scene, np.array(self.point, np.float64))


# --- objects of regions -------------------------------------------------------------------------


class Separate(Operation, frozen=True):
    """Make the selection an object."""

    def edit(self, scene: Scene) -> Edit | None:
        chosen = selected_indices(scene)
        if len(chosen) == 0:
            raise GagaError("nothing is selected. Select first.")
        return edits.separate(scene, chosen)


class Split(Operation, frozen=True):
    """Split one object into parts that do not touch."""

    groups: Groups | UnsetType = UNSET

    def edit(self, scene: Scene) -> Edit | None:
        return edits.split(scene, one_object_of(scene, self.groups))


class Assign(Operation, frozen=True):
    """Make the selection part of an object."""

    groups: Groups

    def edit(self, scene: Scene) -> Edit | None:
        groups, chosen = groups_of(scene, self.groups), selected_indices(scene)
        if len(groups) != 1 or len(chosen) == 0:
            raise GagaError('give one object in "groups", and select splats first.')
        return edits.set_labels(scene, chosen, groups[0])


# --- computed from the splats: these take seconds -----------------------------------------------


class Clean(OnGroups, frozen=True):
    """Clean up, as in the window."""

    def edit(self, scene: Scene) -> Edit | None:
        groups = groups_of(scene, self.groups)
        if not groups:
            raise GagaError('no object is selected. Give "groups".')
        return relabel(scene, run_stage(clean_objects_stage(scene, groups)))


class Fill(OnSplats, frozen=True):
    """Delete and fill what was hidden; without groups and selection: fill where was deleted."""

    lighten: Flag = True  # take its shadow off what it stood on
    model: FilePath = ""  # of an inpainting model that colors the hole
    sha256: Digest = ""  # of that file; another one is refused

    def edit(self, scene: Scene) -> Edit | None:
        return self.edit_seen(scene, tuple)

    def edit_seen(self, scene: Scene, views: Views) -> Edit | None:
        # SciPy's and numba's import takes long: only where something is filled.
        from gaga_core.raster import choose
        from gaga_core.scene.fill.config import FillConfig
        from gaga_core.scene.fill.edits import filled_edit
        from gaga_core.scene.fill.fill import fill_stage, fill_title, fillable

        splats = fillable(scene) if self.groups is UNSET else self.splats(scene)
        if self.sha256 and not self.model:
            raise GagaError('"sha256" is that of a model: give "model", too.')
        config = FillConfig(lighten=self.lighten, model=self.model, model_sha256=self.sha256)
        found = run_stage(fill_stage(scene, splats, views(), choose(), config))
        return filled_edit(scene, found, fill_title(scene, splats))


class Reduce(OnSplats, frozen=True):
    """Merge neighbours that are alike until a share of the splats is left."""

    share: Share

    def edit(self, scene: Scene) -> Edit | None:
        return self.edit_seen(scene, tuple)

    def edit_seen(self, scene: Scene, views: Views) -> Edit | None:
        # SciPy's and numba's import takes long: only where something is merged.
        from gaga_core.raster import choose
        from gaga_core.scene.reduce import reduce_stage, reduce_title, reduced_edit

        if self.share == 0:
            raise GagaError('"share" must be above 0: it is the share of the splats that is kept.')
        splats = self.splats(scene)
        found = run_stage(reduce_stage(scene, splats, self.share, views(), choose()))
        return reduced_edit(scene, found, reduce_title(scene, splats, found))


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


def _box(lo: Vector | UnsetType, hi: Vector | UnsetType, matrix: Matrix | UnsetType) -> DoubleArray:
    """World from unit cube (4, 4) of two corners, or of a matrix."""
    full = np.eye(4)
    if not isinstance(matrix, UnsetType):
        full[:3] = np.array(matrix, np.float64)
    elif not isinstance(lo, UnsetType) and not isinstance(hi, UnsetType):
        low, high = np.array(lo, np.float64), np.array(hi, np.float64)
        full[:3, :3] = np.diag(high - low)
        full[:3, 3] = (low + high) / 2
    else:
        raise GagaError('give "lo" and "hi", or "matrix".')
    if not np.linalg.det(full):
        raise GagaError("a side of the box has no length.")
    return full


def _reach(scene: Scene, splats: IntArray, reach: Number | UnsetType) -> float:
    """The distance that is given, else that between neighbours among the splats."""
    if isinstance(reach, UnsetType):
        return neighbourhood.spacing(scene, splats)
    return reach


OPERATION_TYPES: Mapping[str, type[Operation]] = {
    str(kind.__struct_config__.tag): kind
    for kind in list(globals().values())
    if isinstance(kind, type) and issubclass(kind, Operation) and not kind.__subclasses__()
}
