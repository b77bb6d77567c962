"""Results of cleaning: a preview, edits, cleaned copies.

The cleaning itself (`gaga_core.scene.cleanup.clean`) needs SciPy, which is imported only when it
runs.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, IntArray
from gaga_core.progress import Progress, Stage
from gaga_core.scene.edits.objects import set_labels
from gaga_core.scene.edits.placement import recolor
from gaga_core.scene.edits.splats import delete, isolate, select
from gaga_core.scene.edits.values import Edit, together
from gaga_core.scene.objects import selected_groups
from gaga_core.scene.scene import Revision, Scene, State

if TYPE_CHECKING:
    from gaga_core.scene.cleanup.clean import CleanPreview

DROPPED = (0.93, 0.36, 0.26)  # color of splats that would leave the object; RGB 0..1
TAKEN_IN = (0.20, 0.60, 1.00)  # of splats that would join it: apart for color-blind eyes too
_KEPT_OPACITY = 0.35  # factor for the rest of the object: what lies inside is seen
_OTHER_OPACITY = 0.06  # for everything else: floaters are mostly behind or inside of something
_SHOWN_OPACITY = 20.0  # factor for those that come and go: floaters are faint
_GRAY = np.tile([0.85 * 0.299, 0.85 * 0.587, 0.85 * 0.114, 0.05], (3, 1))  # (3, 4) Rec. 601 luma
_STAGE = "Clean up"


def clean_object_stage(scene: Scene, group: int) -> "Stage[CleanPreview]":
    """`clean_object` of one object, as the scene is at the call."""
    return _clean_object(replace(scene), group)


def _clean_object(scene: Scene, group: int) -> "Stage[CleanPreview]":
    yield Progress(_STAGE, 0, 0)
    from gaga_core.scene.cleanup.clean import clean_object

    preview = clean_object(scene, group)
    yield Progress(_STAGE, 1, 1)
    return preview


def clean_objects_stage(scene: Scene, groups: Sequence[int]) -> Stage[IntArray]:
    """Clean objects one after the other; labels (N,) after all. The scene is not changed."""
    return _clean_objects(replace(scene, revision=Revision()), groups)


def _clean_objects(scene: Scene, groups: Sequence[int]) -> Stage[IntArray]:
    yield Progress(_STAGE, 0, len(groups))
    from gaga_core.scene.cleanup.clean import clean_object, cleaned_labels

    for i, group in enumerate(groups):
        # The next object sees what the earlier ones added and removed.
        edit = cleaned_labels(scene, clean_object(scene, group))
        if edit is not None:
            edit.apply(scene)
        yield Progress(_STAGE, i + 1, len(groups))
    return scene.labels


# --- looking at it


def cleaning_tint(scene: Scene, preview: "CleanPreview") -> Edit | None:
    """The edit that shows a preview in the picture; it is never to become an entry.

    What would go is `DROPPED`, what would come is `TAKEN_IN`; everything else is gray and seen
    through.
    """
    kept = np.setdiff1d(preview.before, preview.remove, assume_unique=True)
    others = np.ones(len(scene), np.bool_)
    others[preview.before] = others[preview.add] = False
    return _in_turn(
        scene,
        "Preview of the cleaning",
        lambda s: recolor(s, others, _GRAY, _OTHER_OPACITY),
        lambda s: recolor(s, kept, _GRAY, _KEPT_OPACITY),
        lambda s: recolor(s, preview.remove, _flat(DROPPED), _SHOWN_OPACITY),
        lambda s: recolor(s, preview.add, _flat(TAKEN_IN), _SHOWN_OPACITY),
    )


def _flat(rgb: Sequence[float]) -> DoubleArray:
    """The affine color (3, 4) that makes everything ``rgb``."""
    return np.column_stack([np.zeros((3, 3)), rgb])


# --- doing it


def relabel(scene: Scene, labels: IntArray, title: str = "Clean") -> Edit | None:
    """Take the labels (N,) of cleaned objects over."""
    rows = np.flatnonzero(labels != scene.labels)
    return set_labels(scene, rows, labels[rows], title)


def cleaned_edit(scene: Scene, preview: "CleanPreview", title: str) -> Edit | None:
    """Give and take the splats of ``preview``, and select the object as it is then.

    An object that is isolated stays so: what it loses is hidden, what it gains is shown.
    """
    from gaga_core.scene.cleanup.clean import cleaned_labels

    is_alone = bool((scene.labels[scene.visible] == preview.group).all())
    return _in_turn(
        scene,
        title,
        lambda s: cleaned_labels(s, preview),
        lambda s: select(s, preview.after),
        lambda s: isolate(s, preview.after) if is_alone else None,
    )


def isolate_cleaned(
    scene: Scene,
    groups: Sequence[int],
    labels: IntArray,
    title: str,
    also: IntArray | Sequence[int] = (),
) -> Edit | None:
    """Take the labels (N,) of cleaned objects over, and hide all but these and ``also`` (K,)."""
    objects = _rows_of(scene, groups, labels)
    shown = objects.copy()
    shown[np.asarray(also, np.int32)] = True
    return _in_turn(
        scene,
        title,
        lambda s: relabel(s, labels),
        lambda s: select(s, objects),
        lambda s: isolate(s, shown),
    )


def delete_cleaned(
    scene: Scene, groups: Sequence[int], labels: IntArray, title: str
) -> Edit | None:
    """Take the labels (N,) of cleaned objects over, and delete these objects.

    Their floaters, which are nobody's then, go too: they would be left hanging in the air.
    """
    wanted = np.array(groups, np.int32)
    floaters = np.isin(scene.labels, wanted) & (labels == 0)
    rows = _rows_of(scene, groups, labels) | floaters
    return _in_turn(
        scene,
        title,
        lambda s: relabel(s, labels),
        lambda s: delete(s, rows),
    )


def cleaned_copy(scene: Scene, groups: Sequence[int], labels: IntArray) -> Scene:
    """A copy with the labels (N,) of cleaned objects in which these objects are selected."""
    copy = replace(scene, labels=labels, revision=Revision())
    edit = select(copy, _rows_of(scene, groups, labels))
    if edit is not None:
        edit.apply(copy)
    return copy


def whole_objects(scene: Scene) -> tuple[int, ...]:
    """The selected objects when the selection is whole objects and nothing else; else none."""
    groups = selected_groups(scene)
    selected = scene.has(State.SELECTED)
    members = _rows_of(scene, groups, scene.labels) & ~scene.has(State.LOCKED)
    if (selected & ~members).any() or (members & scene.visible & ~selected).any():
        return ()
    return tuple(int(group) for group in groups)


def _rows_of(scene: Scene, groups: Sequence[int] | IntArray, labels: AnyArray) -> BoolArray:
    """Splats (N,) of these groups that are not deleted."""
    members: BoolArray = np.isin(labels, np.asarray(groups, np.int32)) & ~scene.has(State.DELETED)
    return members


def _in_turn(scene: Scene, title: str, *builds: Callable[[Scene], Edit | None]) -> Edit | None:
    """One edit of several, each built on what the ones before it make of ``scene``."""
    work = replace(scene, revision=Revision())
    made = []
    for build in builds:
        edit = build(work)
        if edit is not None:
            edit.apply(work)
            made.append(edit)
    return together(title, made)
