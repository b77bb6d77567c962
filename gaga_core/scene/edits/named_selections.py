"""Builders of edits of named selections."""

import numpy as np

from gaga_core.arrays import AnyArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.scene.edits.values import SetNamedSelection
from gaga_core.scene.index_set import IndexSet, sorted_indices
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.algebra import selectable


def keep_selection(scene: Scene, name: str, indices: AnyArray) -> SetNamedSelection | None:
    """Keep these splats under a name; one of that name is replaced.

    Raises ``GagaError`` for an empty name.
    """
    title = " ".join(name.split())
    if not title:
        raise GagaError("A selection needs a name to be kept.")
    kept = IndexSet.of(sorted_indices(indices, len(scene)), len(scene))
    before = scene.named_selections.get(title)
    if before is not None and before.equals(kept):
        return None
    return SetNamedSelection("Keep selection", title, before, kept)


def forget_selection(scene: Scene, name: str) -> SetNamedSelection | None:
    """Forget a named selection; the splats stay as they are."""
    before = scene.named_selections.get(name)
    return None if before is None else SetNamedSelection("Forget selection", name, before, None)


def named_selection(scene: Scene, name: str) -> IntArray:
    """Splats (K,) of a named selection that can be selected now.

    Rows never move, so a set stays right while the scene grows. ``GagaError`` for another name.
    """
    if name not in scene.named_selections:
        raise GagaError(f'There is no selection named "{name}" here.')
    rows = scene.named_selections[name].indices()
    rows = rows[rows < len(scene)]  # the copies of an undone duplicate are no more
    chosen: IntArray = rows[selectable(scene)[rows]].astype(np.int32)
    return chosen
