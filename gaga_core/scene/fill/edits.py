"""The edit that removes an object and fills what it hid."""

from dataclasses import replace

import numpy as np

from gaga_core.arrays import DoubleArray, LongArray
from gaga_core.color import LUMA
from gaga_core.scene.edits.placement import recolor
from gaga_core.scene.edits.splats import append_made, delete
from gaga_core.scene.edits.values import Edit, together
from gaga_core.scene.fill.fill import Filling
from gaga_core.scene.scene import Revision, Scene, State

_LEVELS = 16  # of lightening: each takes one row of the table of placements


def filled_edit(scene: Scene, found: Filling, title: str) -> Edit | None:
    """Delete the object with what it hid, lighten its shadow, and add the new splats.

    ``scene``: as it was when ``found`` was computed.
    """
    if found.model:
        title = f"{title}, colors by {found.model}"
    scratch = replace(scene, revision=Revision())
    parts: list[Edit] = []

    def add(edit: Edit | None) -> None:
        if edit is not None:
            edit.apply(scratch)
            parts.append(edit)

    add(delete(scratch, np.concatenate([found.removed, found.unseen]), title))
    for splats, factors in _levels(found):
        affine = np.column_stack([np.diag(factors), np.zeros(3)])
        add(recolor(scratch, splats, affine, title="Lighten the shadow"))
    add(append_made(scratch, found.splats, found.labels, title, State(0)))
    return together(title, parts)


def _levels(found: Filling) -> list[tuple[LongArray, DoubleArray]]:
    """Splats that are lightened alike, and by which factors of red, green and blue."""
    if len(found.stained) == 0:
        return []
    gains = found.gains.astype(np.float64)
    key = np.log(gains @ LUMA)
    edges = np.linspace(key.min(), key.max() + 1e-9, _LEVELS + 1)
    level = np.digitize(key, edges)
    return [(found.stained[level == k], gains[level == k].mean(axis=0)) for k in np.unique(level)]
