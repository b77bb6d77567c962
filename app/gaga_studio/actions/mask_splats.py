"""The splats of a mask of the memory bank, lit in the picture: with the depth gate and without."""

from typing import TYPE_CHECKING

import numpy as np

from gaga_core.arrays import UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.grouping.memory_bank import Decision
from gaga_core.progress import Stage
from gaga_core.raster import choose
from gaga_studio.actions.association_repair import evidence_of
from gaga_studio.session import stages
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session

if TYPE_CHECKING:
    from gaga_core.grouping.figures import MaskSplats
    from gaga_core.grouping.repair.view_evidence import Evidence

# Red, green, blue and share 0..255 of a color over the splat's own.
IN_GATE = (255, 176, 32, 235)
CUT_OFF = (226, 58, 190, 235)  # behind the mask, but not at the depth of its surface
REST = (36, 37, 42, 165)


def found(session: Session, decision: Decision) -> "MaskSplats | None":
    """Return who lies behind a mask; None until a quiet job has read its view, or if it cannot.

    Ask again in a later frame.
    """
    view = _view_of(session, decision)
    if view is None:
        return None
    document, evidence, camera = view
    if decision.view not in evidence.bounds:
        asked = (decision.view, evidence)
        if session.jobs.quiet is None and asked not in document.looked_at:
            document.looked_at.add(asked)  # once: a view that cannot be read fails every time
            session.jobs.start_quiet("Look at the view", _look_stage(evidence, camera))
        return None
    key = (decision.view, decision.mask, evidence)
    if document.lit is None or document.lit[0] != key:
        document.lit = (key, _splats(evidence, camera, decision.mask))
    return document.lit[1]


def _splats(evidence: "Evidence", camera: Camera, mask: int) -> "MaskSplats | None":
    from gaga_core.grouping.figures import mask_splats  # numba

    try:
        return mask_splats(evidence.gated, camera, mask)
    except GagaError:  # the masks were made again: nothing is lit, and there are no shares
        return None


def overlaps(
    session: Session, decision: Decision, *, has_gate: bool = True
) -> dict[int, float] | None:
    """Return the share of the splats behind a mask that each group holds, descending.

    0 are the splats of no group. None until a quiet job has read its view: ask again in a later
    frame. Empty when the masks are gone. The same dict as long as nothing changed.
    """
    splats, document = found(session, decision), session.document
    if splats is None or document is None:
        is_pending = session.jobs.quiet is not None and _view_of(session, decision) is not None
        return None if is_pending else {}
    from gaga_core.grouping.figures import shares_of_groups  # numba

    chosen, scene = splats.of(has_gate), document.scene
    key = (splats, has_gate, scene.revision.splats, scene.revision.labels)
    return document.read.once(
        "shares", key, lambda: shares_of_groups(scene.labels[: len(chosen)], chosen)
    )


def tint(session: Session, decision: Decision | None) -> UInt8Array | None:
    """Return the colors (N, 4) that light up the splats of a mask; None when nothing is lit.

    The same array as long as nothing changed.
    """
    document = session.document
    if document is None or decision is None or not session.view.lights_masks:
        return None
    splats = found(session, decision)
    if splats is None:
        return None
    has_gate, revision = session.view.has_mask_gate, document.scene.revision.splats
    key = (splats, has_gate, revision)
    return document.read.once("tint", key, lambda: _colors(document, splats, has_gate))


def _colors(document: Document, splats: "MaskSplats", has_gate: bool) -> UInt8Array:
    """Colors (N, 4) of all splats; copies have those of their originals, added ones are dim."""
    kind = splats.gated.astype(np.uint8)
    if not has_gate:
        kind += 2 * (splats.behind & ~splats.gated).astype(np.uint8)
    kind = np.append(kind, np.uint8(0))
    table = np.array([REST, IN_GATE, CUT_OFF], np.uint8)
    colors: UInt8Array = table[kind[np.minimum(document.scene.source, len(kind) - 1)]]
    return colors


def _view_of(session: Session, decision: Decision) -> "tuple[Document, Evidence, Camera] | None":
    """Return what a mask is looked up in; None when its masks are gone."""
    document = session.document
    if document is None or document.scene.bank is None:
        return None
    try:
        evidence = evidence_of(session, document)
        return document, evidence, evidence.camera(decision.view)
    except GagaError:  # there are no masks of this view
        return None


def _look_stage(evidence: "Evidence", camera: Camera) -> Stage[object]:
    """Find the accepted depths of the masks of one view."""

    def gather() -> Stage[object]:
        from gaga_core.grouping.repair.view_evidence import gather_stage

        yield from gather_stage(evidence.only([camera]), choose(), only_bounds=True)
        return None

    return stages.prepared("Look at the view", gather)
