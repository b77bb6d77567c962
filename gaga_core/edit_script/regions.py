"""The operations of edit scripts that select by region or number, and set scenes straight."""

from typing import TypeAlias

import numpy as np
from msgspec import UNSET, UnsetType

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.edit_script.base import OnSplats, Operation, centred, given, groups_of, one_object_of
from gaga_core.edit_script.fields import (
    Axis,
    Color,
    Ends,
    Groups,
    How,
    Matrix,
    Name,
    Number,
    Points,
    Positive,
    Share,
    SignedShare,
    Vector,
)
from gaga_core.errors import GagaError
from gaga_core.scene import edits
from gaga_core.scene.edits import Edit
from gaga_core.scene.objects import selected_indices
from gaga_core.scene.orientation import ground_map, mirror_map
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection import algebra, by_value, by_volume, neighbourhood
from gaga_core.scene.selection.neighbourhood import floaters
from gaga_core.scene.tint import Grade, grade_affine

# --- selecting ----------------------------------------------------------------------------------


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


RegionOperation: TypeAlias = (
    SelectSphere
    | SelectBox
    | SelectRange
    | SelectColor
    | SelectSet
    | KeepSet
    | Grow
    | Shrink
    | Crop
    | DeleteFloaters
    | GradeColors
    | Mirror
    | AlignToGround
    | SetScale
    | SetOrigin
    | Separate
    | Split
    | Assign
)
