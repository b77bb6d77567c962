"""The operations of edit scripts: functions whose parameters are the fields of a JSON object."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from inspect import Parameter, signature
from typing import Annotated, Literal, TypeVar, get_type_hints

import msgspec
import numpy as np
from msgspec import UNSET, Meta, Struct, UnsetType

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.geometry import quats_to_matrices
from gaga_core.progress import run_stage
from gaga_core.query.group_facts import outside_color
from gaga_core.scene import edits
from gaga_core.scene.cleanup import clean_objects_stage, relabel
from gaga_core.scene.edits.folders import existing
from gaga_core.scene.edits.history import History
from gaga_core.scene.edits.values import Edit
from gaga_core.scene.folders import SEPARATOR, tidy_path
from gaga_core.scene.frame import carried_camera, inverse
from gaga_core.scene.objects import group_indices, selected_groups, selected_indices
from gaga_core.scene.orientation import (
    ground_map,
    mirror_map,
    motion_between,
    pose_of,
    with_degrees,
)
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection import algebra, by_value, by_volume, neighbourhood
from gaga_core.scene.selection.bounds import object_points, robust_box
from gaga_core.scene.selection.neighbourhood import floaters
from gaga_core.scene.tint import Grade, grade_affine, tint_affine

_T = TypeVar("_T")
_F = TypeVar("_F", bound="Callable[..., Edit | str | None]")
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
Chosen = Groups | UnsetType  # of the selection, where they are not given
MaybeNumber = Number | UnsetType
MaybeVector = Vector | UnsetType
MaybeMatrix = Matrix | UnsetType

# --- the target of an operation -----------------------------------------------------------------


def given(value: _T | UnsetType, default: _T) -> _T:
    """An optional field, or its default."""
    return default if isinstance(value, UnsetType) else value


def groups_of(scene: Scene, wanted: Chosen) -> list[int]:
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


def one_object_of(scene: Scene, wanted: Chosen) -> int:
    """The one object that an operation names, or that is selected."""
    groups = groups_of(scene, wanted)
    if len(groups) != 1 or groups[0] == 0:
        raise GagaError('give one object in "groups".')
    return groups[0]


def splats_of(scene: Scene, wanted: Chosen) -> IntArray:
    """Splats (K,) of the groups, else the selected ones."""
    if not isinstance(wanted, UnsetType):
        return group_indices(scene, groups_of(scene, wanted))
    chosen = selected_indices(scene)
    if len(chosen) == 0:
        raise GagaError('nothing is selected. Give "groups", or select first.')
    return chosen


def centred(scene: Scene, splats: IntArray, about: MaybeVector, linear: DoubleArray) -> DoubleArray:
    """Map (3, 4) that turns or scales about a point: ``about``, else the middle of the splats."""
    if isinstance(about, UnsetType):
        centre = algebra.world_means(scene, splats).mean(axis=0, dtype=np.float64)
    else:
        centre = np.array(about, np.float64)
    return np.column_stack([linear, centre - linear @ centre])


def shift(by: Vector) -> DoubleArray:
    """Map (3, 4) that moves by a vector."""
    return np.column_stack([np.eye(3), np.array(by, np.float64)])


def _box(lo: MaybeVector, hi: MaybeVector, matrix: MaybeMatrix) -> DoubleArray:
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


def _reach(scene: Scene, splats: IntArray, reach: MaybeNumber) -> float:
    """The distance that is given, else that between neighbours among the splats."""
    if isinstance(reach, UnsetType):
        return neighbourhood.spacing(scene, splats)
    return reach


# --- the operation type -------------------------------------------------------------------------

# Parameters that stand for the field "groups", and those that are no field.
_OF_GROUPS = {"splats": splats_of, "objects": groups_of, "group": one_object_of}
_NO_FIELD = ("scene", "history", "views")
_FUNCTIONS: dict[type[Struct], Callable[..., Edit | str | None]] = {}
OPERATION_TYPES: dict[str, type[Struct]] = {}


def operation(function: _F) -> _F:
    """Make a function the operation of its name: the fields are its parameters.

    It returns the edit of ``scene``, None when nothing would change, or a title when it has done
    the work through ``history``. ``splats`` (K,), ``objects`` (ids) and ``group`` (one id) are
    those of the field "groups", else of the selection; ``views`` gives what the cameras of the
    photos saw. It raises ``GagaError`` with a sentence for what the scene does not have.
    """
    hints, op = get_type_hints(function, include_extras=True), function.__name__
    fields: list[tuple[str, object, object]] = []
    for name, parameter in signature(function).parameters.items():
        if name in _OF_GROUPS:
            fields.append(("groups", Chosen, UNSET))
        elif name not in _NO_FIELD:
            required = parameter.default is Parameter.empty
            fields.append((name, hints[name], msgspec.NODEFAULT if required else parameter.default))
    OPERATION_TYPES[op] = msgspec.defstruct(
        op.title().replace("_", ""),
        fields,
        namespace={"__doc__": function.__doc__},
        rename=lambda name: name.removesuffix("_"),  # of a word of Python
        frozen=True,
        kw_only=True,
        forbid_unknown_fields=True,
        tag_field="op",
        tag=op,
    )
    _FUNCTIONS[OPERATION_TYPES[op]] = function
    return function


def run_operation(step: Struct, history: History, scene: Scene, views: Views) -> str:
    """Apply an operation as it was read through ``history``; its title, "" when nothing changed."""
    function, values = _FUNCTIONS[type(step)], msgspec.structs.asdict(step)
    values |= {"scene": scene, "history": history, "views": views}
    for name in signature(function).parameters:
        if name in _OF_GROUPS:
            values[name] = _OF_GROUPS[name](scene, values["groups"])
    done = function(**{name: values[name] for name in signature(function).parameters})
    if isinstance(done, str):
        return done
    return done.title if done is not None and history.do(done) else ""


# --- selecting, hiding, locking, deleting -------------------------------------------------------


@operation
def select(scene: Scene, groups: Groups, how: How = "set") -> Edit | None:
    """Select objects."""
    return edits.select(scene, group_indices(scene, groups_of(scene, groups)), how)


@operation
def select_all(scene: Scene) -> Edit | None:
    """Select everything that is visible and not locked."""
    return edits.select(scene, algebra.everything(scene))


@operation
def select_none(scene: Scene) -> Edit | None:
    """Select nothing."""
    return edits.select(scene, algebra.nothing())


@operation
def invert(scene: Scene) -> Edit | None:
    """Invert the selection."""
    return edits.select(scene, algebra.inverted(scene))


@operation
def hide(scene: Scene, splats: IntArray) -> Edit | None:
    """Hide."""
    return edits.hide(scene, splats)


@operation
def show(scene: Scene, groups: Groups) -> Edit | None:
    """Show again."""
    return edits.show(scene, group_indices(scene, groups_of(scene, groups)))


@operation
def show_all(scene: Scene) -> Edit | None:
    """Show everything."""
    return edits.show_all(scene)


@operation
def isolate(scene: Scene, splats: IntArray) -> Edit | None:
    """Hide everything else."""
    return edits.isolate(scene, splats)


@operation
def lock(scene: Scene, splats: IntArray) -> Edit | None:
    """Keep from being selected."""
    return edits.lock(scene, splats)


@operation
def unlock(scene: Scene, groups: Groups) -> Edit | None:
    """Allow to be selected again."""
    return edits.unlock(scene, group_indices(scene, groups_of(scene, groups)))


@operation
def delete(scene: Scene, splats: IntArray) -> Edit | None:
    """Delete."""
    return edits.delete(scene, splats)


@operation
def restore(scene: Scene) -> Edit | None:
    """Bring back everything that was deleted."""
    return edits.restore(scene)


# --- placing and coloring -----------------------------------------------------------------------


@operation
def move(scene: Scene, splats: IntArray, by: Vector) -> Edit | None:
    """Shift by a vector, scene units."""
    return edits.transform(scene, splats, shift(by), "Move")


@operation
def rotate(
    scene: Scene, splats: IntArray, axis: Vector, degrees: Number, about: MaybeVector = UNSET
) -> Edit | None:
    """Turn about a point, else about the middle of the splats."""
    along = np.array(axis, np.float64)
    length = np.linalg.norm(along)
    if length == 0:
        raise GagaError('field "axis" must not be zero.')
    half = np.radians(degrees) / 2
    quat = np.concatenate([[np.cos(half)], np.sin(half) * along / length])
    turn = centred(scene, splats, about, quats_to_matrices(quat[None])[0])
    return edits.transform(scene, splats, turn, "Rotate")


@operation
def scale(
    scene: Scene, splats: IntArray, factor: Factors, about: MaybeVector = UNSET
) -> Edit | None:
    """Scale by one factor or three about a point, else about the middle of the splats."""
    linear = np.diag(np.broadcast_to(np.array(factor, np.float64), (3,)))
    return edits.transform(scene, splats, centred(scene, splats, about, linear), "Scale")


@operation
def transform(scene: Scene, splats: IntArray, matrix: Matrix) -> Edit | None:
    """Apply any affine map of positions, 3 rows of 4 numbers."""
    world = np.array(matrix, np.float64)
    if not np.linalg.det(world[:, :3]):
        raise GagaError('field "matrix" flattens space.')
    return edits.transform(scene, splats, world, "Transform")


@operation
def place(
    scene: Scene,
    splats: IntArray,
    position: MaybeVector = UNSET,  # of the middle of the box
    rotation: MaybeVector = UNSET,  # degrees about the world's x, then y, then z
    scale: Factors | UnsetType = UNSET,  # along the object's own axes
) -> Edit | None:
    """Put to a position, a rotation and a scale; what is not given stays."""
    # Floaters along the axes of the world: scripts that were saved earlier give the same as then.
    lo, hi = robust_box(*object_points(scene, splats, turns_along=False))
    start = stop = pose_of(scene, splats, (lo + hi) / 2)
    if not isinstance(rotation, UnsetType):
        stop = with_degrees(stop, np.array(rotation, np.float64), local=False)
    if not isinstance(position, UnsetType):
        stop = replace(stop, centre=np.array(position, np.float64))
    if not isinstance(scale, UnsetType):
        factors = np.broadcast_to(np.array(scale, np.float64), (3,))
        stop = replace(stop, scale=factors * np.sign(start.scale))
    return edits.transform(scene, splats, motion_between(start, stop), "Place")


@operation
def mirror(scene: Scene, splats: IntArray, axis: Axis, about: MaybeVector = UNSET) -> Edit | None:
    """Mirror across x, y or z about a point, else about the middle of the splats."""
    middle = centred(scene, splats, about, np.zeros((3, 3)))[:, 3]
    return edits.transform(scene, splats, mirror_map("xyz".index(axis), middle), "Mirror")


@operation
def reset_placement(scene: Scene, splats: IntArray) -> Edit | None:
    """Reset the placement to that of the file."""
    return edits.reset_placement(scene, splats)


@operation
def recolor(
    scene: Scene,
    views: Views,
    splats: IntArray,
    color: Color | UnsetType = UNSET,
    strength: Share = 1.0,
    opacity: Share | UnsetType = UNSET,
) -> Edit | None:
    """Give a new mean color from outside, a factor of opacity, or both."""
    if color is UNSET and opacity is UNSET:
        raise GagaError('give "color", "opacity" or both.')
    affine = np.eye(3, 4)
    if not isinstance(color, UnsetType):
        back = inverse(scene.frame.world)  # to the frame in which the scene was opened
        cameras = [carried_camera(camera, back) for camera in views()]
        now = outside_color(scene, splats, cameras)
        affine = tint_affine(now, np.array(color, np.float64), strength)
    return edits.recolor(scene, splats, affine, given(opacity, 1.0))


@operation
def grade(  # noqa: PLR0913 - the fields of the operation
    scene: Scene,
    splats: IntArray,
    tint: Vector = (1.0, 1.0, 1.0),
    temperature: SignedShare = 0.0,
    green: SignedShare = 0.0,
    saturation: Number = 1.0,
    brightness: SignedShare = 0.0,
    black: SignedShare = 0.0,
    white: Number = 1.0,
    opacity: Share = 1.0,
) -> Edit | None:
    """Grade colors."""
    light = brightness, black, white, opacity
    wanted = grade_affine(Grade(tint, temperature, green, saturation, *light))
    return edits.recolor(scene, splats, wanted, opacity, "Grade colors")


# --- objects ------------------------------------------------------------------------------------


@operation
def duplicate(
    scene: Scene, splats: IntArray, by: MaybeVector = UNSET, new_group: Flag = True
) -> Edit | None:
    """Copy, as a new object unless ``new_group`` is false."""
    moved = None if isinstance(by, UnsetType) else shift(by)
    return edits.duplicate(scene, splats, moved, new_group)


@operation
def rename(scene: Scene, group: int, name: Name) -> Edit | None:
    """Name one object."""
    return edits.rename(scene, group, name)


@operation
def merge(scene: Scene, objects: list[int]) -> Edit | None:
    """Make one object of several."""
    return edits.merge_groups(scene, objects)


@operation
def split(scene: Scene, group: int) -> Edit | None:
    """Split one object into parts that do not touch."""
    return edits.split(scene, group)


@operation
def split_here(scene: Scene, group: int) -> Edit | None:
    """Make objects of the parts that one object has a level of detail finer."""
    return edits.split_here(scene, group)


@operation
def join_here(scene: Scene, group: int) -> Edit | None:
    """Join one object with those that are one with it a level coarser."""
    return edits.join_here(scene, group)


@operation
def separate(scene: Scene) -> Edit | None:
    """Make the selection an object."""
    chosen = selected_indices(scene)
    if len(chosen) == 0:
        raise GagaError("nothing is selected. Select first.")
    return edits.separate(scene, chosen)


@operation
def assign(scene: Scene, groups: Groups) -> Edit | None:
    """Make the selection part of an object."""
    wanted, chosen = groups_of(scene, groups), selected_indices(scene)
    if len(wanted) != 1 or len(chosen) == 0:
        raise GagaError('give one object in "groups", and select splats first.')
    return edits.set_labels(scene, chosen, wanted[0])


@operation
def labels(scene: Scene, from_: LabelSource) -> Edit | None:
    """Take the groups from the votes of the masks, or from identities."""
    return edits.use_labels(scene, from_)


# --- folders and parents ------------------------------------------------------------------------


@operation
def new_folder(scene: Scene, folder: Path) -> Edit | None:
    """Make an empty folder."""
    return edits.new_folder(scene, folder)


@operation
def put_in_folder(scene: Scene, folder: Path, objects: list[int]) -> Edit | None:
    """Put objects into a folder, which is made if it is not there; "" takes them out of all."""
    if not objects:
        raise GagaError('no object is selected. Give "groups", or select first.')
    return edits.put_in_folder(scene, objects, folder)


@operation
def move_folder(scene: Scene, folder: Path, into: Path = "") -> Edit | None:
    """Put a folder into another one; "" takes it out of all."""
    return edits.put_in_folder(scene, (), into, (folder,), "Move folder")


@operation
def rename_folder(scene: Scene, folder: Path, name: Name) -> Edit | None:
    """Give a folder another name."""
    return edits.rename_folder(scene, folder, name)


@operation
def delete_folder(scene: Scene, folder: Path) -> Edit | None:
    """Take a folder away; what is in it goes into the folder that it was in."""
    return edits.delete_folder(scene, folder)


@operation
def set_parent(scene: Scene, parent: OneGroup, objects: list[int]) -> Edit | None:
    """Put objects under another object; those under them go along."""
    if not objects:
        raise GagaError('no object is selected. Give "groups", or select first.')
    return edits.set_parent(scene, objects, one_object_of(scene, (parent,)))


@operation
def leave_parent(scene: Scene, objects: list[int]) -> Edit | None:
    """Take objects out from under their parent, to where that is."""
    return edits.leave_parent(scene, objects)


# --- selecting by region and number -------------------------------------------------------------


@operation
def select_sphere(scene: Scene, centre: Vector, radius: Number, how: How = "set") -> Edit | None:
    """Splats whose centre is in a ball."""
    found = by_volume.in_sphere(scene, np.array(centre, np.float64), radius)
    return edits.select(scene, found, how)


@operation
def select_box(
    scene: Scene,
    lo: MaybeVector = UNSET,
    hi: MaybeVector = UNSET,
    matrix: MaybeMatrix = UNSET,
    how: How = "set",
) -> Edit | None:
    """Splats in a box of two corners, or in a map of the unit cube."""
    return edits.select(scene, by_volume.in_box(scene, _box(lo, hi, matrix)), how)


@operation
def select_range(
    scene: Scene,
    column: Name,
    low: MaybeNumber = UNSET,
    high: MaybeNumber = UNSET,
    how: How = "set",
) -> Edit | None:
    """Splats by a number, such as size or opacity."""
    found = by_value.in_range(scene, column, given(low, -np.inf), given(high, np.inf))
    return edits.select(scene, found, how)


@operation
def select_color(
    scene: Scene, color: Color, tolerance: Share = 0.1, how: How = "set"
) -> Edit | None:
    """Splats by their color."""
    return edits.select(scene, by_value.like_color(scene, color, tolerance), how)


@operation
def select_set(scene: Scene, name: Name, how: How = "set") -> Edit | None:
    """A named selection."""
    return edits.select(scene, edits.named_selection(scene, name), how)


@operation
def keep_set(scene: Scene, splats: IntArray, name: Name) -> Edit | None:
    """Keep the selection under a name."""
    return edits.keep_selection(scene, name, splats)


@operation
def grow(scene: Scene, splats: IntArray, reach: MaybeNumber = UNSET) -> Edit | None:
    """Add splats within a distance of the selection."""
    grown = neighbourhood.grown(scene, splats, _reach(scene, splats, reach))
    return edits.select(scene, grown, "set", "Grow")


@operation
def shrink(scene: Scene, splats: IntArray, reach: MaybeNumber = UNSET) -> Edit | None:
    """Remove splats near the border of the selection."""
    shrunk = neighbourhood.shrunk(scene, splats, _reach(scene, splats, reach))
    return edits.select(scene, shrunk, "set", "Shrink")


@operation
def crop(
    scene: Scene, lo: MaybeVector = UNSET, hi: MaybeVector = UNSET, matrix: MaybeMatrix = UNSET
) -> Edit | None:
    """Delete everything outside a box of two corners, or of a map of the unit cube."""
    inside = by_volume.in_box(scene, _box(lo, hi, matrix))
    return edits.delete(scene, np.setdiff1d(algebra.everything(scene), inside), "Crop")


@operation
def delete_floaters(scene: Scene, groups: Chosen = UNSET, strength: Positive = 1.0) -> Edit | None:
    """Delete isolated splats: of the groups, else of everything."""
    among = algebra.everything(scene) if groups is UNSET else splats_of(scene, groups)
    return edits.delete(scene, floaters(scene, among, strength), "Delete floaters")


# --- the scene as a whole -----------------------------------------------------------------------


@operation
def align_to_ground(
    scene: Scene, points: Points, seen_from: Vector, up: Vector = (0.0, 0.0, 1.0)
) -> Edit | None:
    """Make the plane of three points level."""
    corners, eye, above = (np.array(value, np.float64) for value in (points, seen_from, up))
    if not above.any():
        raise GagaError('field "up" must not be zero.')
    return edits.move_scene(scene, ground_map(corners, above, eye), "Align to ground")


@operation
def set_scale(scene: Scene, points: Ends, metres: Positive) -> Edit | None:
    """Scale everything so that the way between two points has a length in metres."""
    one, two = np.array(points, np.float64)
    return edits.set_scale(scene, float(np.linalg.norm(two - one)), metres, np.zeros(3))


@operation
def set_origin(scene: Scene, point: Vector) -> Edit | None:
    """Move everything so that a point becomes the origin."""
    return edits.set_origin(scene, np.array(point, np.float64))


# --- computed from the splats: these take seconds -----------------------------------------------


@operation
def clean(scene: Scene, objects: list[int]) -> Edit | None:
    """Clean up, as in the window."""
    if not objects:
        raise GagaError('no object is selected. Give "groups".')
    return relabel(scene, run_stage(clean_objects_stage(scene, objects)))


@operation
def fill(
    scene: Scene,
    views: Views,
    groups: Chosen = UNSET,
    lighten: Flag = True,  # take its shadow off what it stood on
    model: FilePath = "",  # of an inpainting model that colors the hole
    sha256: Digest = "",  # of that file; another one is refused
) -> Edit | None:
    """Delete and fill what was hidden; without groups and selection: fill where was deleted."""
    # SciPy's and numba's import takes long: only where something is filled.
    from gaga_core.fill.fill import fill_stage, fill_title, fillable, filled_edit
    from gaga_core.fill.surfaces import FillConfig
    from gaga_core.raster import choose

    splats = fillable(scene) if groups is UNSET else splats_of(scene, groups)
    if sha256 and not model:
        raise GagaError('"sha256" is that of a model: give "model", too.')
    config = FillConfig(lighten=lighten, model=model, model_sha256=sha256)
    found = run_stage(fill_stage(scene, splats, views(), choose(), config))
    return filled_edit(scene, found, fill_title(scene, splats))


@operation
def reduce(scene: Scene, views: Views, splats: IntArray, share: Share) -> Edit | None:
    """Merge similar neighbours until a share of the splats is left."""
    # SciPy's and numba's import takes long: only where something is merged.
    from gaga_core.raster import choose
    from gaga_core.scene.reduce import reduce_stage, reduce_title, reduced_edit

    if share == 0:
        raise GagaError('"share" must be above 0: it is the share of the splats that is kept.')
    found = run_stage(reduce_stage(scene, splats, share, views(), choose()))
    return reduced_edit(scene, found, reduce_title(scene, splats, found))


# --- history ------------------------------------------------------------------------------------


@operation
def undo(history: History, times: Count = 1) -> str:
    """Take back so many edits."""
    return _repeated("Undo", history.undo, times)


@operation
def redo(history: History, times: Count = 1) -> str:
    """Do so many edits again."""
    return _repeated("Redo", history.redo, times)


def _repeated(verb: str, step: Callable[[], str | None], times: int) -> str:
    """So many steps, or as many as there are; their titles."""
    titles: list[str] = []
    while len(titles) < times and (title := step()) is not None:
        titles.append(title)
    return f"{verb} {', '.join(titles)}" if titles else ""
