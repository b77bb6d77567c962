"""Pictures of single objects for the list: the object alone, on neutral ground, as large as fits.

A request is a key that names what the picture shows, and a function for the image store's thread.
The digest of the object's splats is part of the key, so a picture that was drawn before is shown
again after an undo. Digests are measured in parallel (`actions.search`): until they are those of
the present scene, the former picture stays and nothing new is drawn.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from gaga_core.arrays import UInt8Array
from gaga_core.scene.bake import bake
from gaga_core.scene.object_picture import (
    MOST_DRAWN,
    ObjectView,
    object_picture,
    object_view,
)
from gaga_core.scene.objects import ObjectTable, group_indices
from gaga_core.scene.scene import Scene
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session

SIDE, LARGE = 96, 320  # pixels, in the list and in its tooltip

Load = Callable[[], UInt8Array]


def request(
    session: Session, table: ObjectTable, row: int, side: int = SIDE
) -> tuple[str, Load | None] | None:
    """Return key and loader of the picture of a row of the list; None if there is none yet.

    Without a loader only a picture that was drawn before can be shown.
    """
    document = session.document
    group = int(table.ids[row])
    if document is None or group == 0:
        return None
    if session.live is not None and not session.live.keeps_ids:
        return None
    digest = document.search.digest_of(group)
    if digest is None:
        return None
    key = f"object {digest:x} {side}"
    if not _may_draw(session, document):
        return key, None
    scene = replace(document.scene)  # columns are never written in place: a snapshot
    return key, partial(_drawn, scene, group, _view(session, table, row), side)


def _may_draw(session: Session, document: Document) -> bool:
    """Whether digests are those of the scene, and nothing goes on that drawing would delay."""
    is_busy = session.is_previewing or session.live is not None or session.rig.is_moving
    # A quiet job may compile what this needs.
    return not is_busy and session.jobs.quiet is None and document.search.is_measured


def _view(session: Session, table: ObjectTable, row: int) -> ObjectView:
    """From where the object of a row is drawn."""
    extent = np.linalg.norm(table.hi[row] - table.lo[row]) / 2
    radius = float(max(min(table.radius[row] * 1.2, extent), 1e-6))
    up = np.asarray(session.rig.up, np.float64)
    return object_view(table.centre[row], radius, session.cameras, up)


def _drawn(scene: Scene, group: int, view: ObjectView, side: int) -> UInt8Array:
    """The object (side, side, 3) and nothing else."""
    rows = group_indices(scene, group)
    splats = bake(scene, indices=rows[:: max(-(-len(rows) // MOST_DRAWN), 1)])
    return object_picture(splats, view, side)
