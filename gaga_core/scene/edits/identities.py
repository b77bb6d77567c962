"""Builders of edits of where labels come from: votes of the masks, or identities (section 3.3)."""

from dataclasses import replace

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, UInt8Array, check_shape
from gaga_core.errors import GagaError
from gaga_core.scene.edits.groups import as_bytes, set_labels
from gaga_core.scene.edits.values import Edit, SetConfidence, SetIdentities, together
from gaga_core.scene.scene import Identities, Labelling, LabelSource, Scene

NO_IDENTITIES = "There are no identities of these groups. Lift the groups first."


def use_labels(scene: Scene, source: LabelSource, title: str = "") -> Edit | None:
    """Take the labels of the opened file's rows from ``source``; None when they are already.

    The labels in use are kept as they are, corrections by hand included, and come back when their
    source is chosen again. Duplicates and added splats stay in their groups. Raises ``GagaError``
    when there are no identities.
    """
    if source == scene.identities.source:
        return None
    wanted, title = scene.identities.other, title or f"Labels by {source}"
    if wanted is None:
        raise GagaError(NO_IDENTITIES)
    kept = _in_use(scene, len(wanted.labels))
    after = replace(scene.identities, source=source, other=kept)
    return together(title, (*_columns(scene, wanted, title), _change(scene, after, title)))


def set_identities(
    scene: Scene,
    labels: IntArray,  # (M,) by row of the opened file
    confidence: FloatArray,  # (M,) 0..1
    colors: UInt8Array,  # (M, 3)
    *,
    used: bool,
    title: str = "Lift groups to identities",
) -> Edit | None:
    """The result of a lift: what its classifier says of each Gaussian (`identity.field`).

    ``used``: labels come from there from now on; else votes stay in use. Former identities are
    replaced.
    """
    n = scene.n_opened
    check_shape("labels", labels, (n,), np.int32)
    check_shape("confidence", confidence, (n,), np.float32)
    check_shape("colors", colors, (n, 3), np.uint8)
    found, now = Labelling(labels, as_bytes(confidence)), scene.identities
    has_votes = now.source == "votes"
    votes = _in_use(scene, n) if has_votes else now.other
    if used:
        after = Identities("identities", votes, colors)
        return together(title, (*_columns(scene, found, title), _change(scene, after, title)))
    back = () if has_votes or votes is None else _columns(scene, votes, title)
    after = Identities("votes", found, colors)
    return together(title, (*back, _change(scene, after, title)))


def _in_use(scene: Scene, n: int) -> Labelling:
    return Labelling(scene.labels[:n].copy(), scene.confidence)


def _columns(scene: Scene, found: Labelling, title: str) -> tuple[Edit | None, Edit | None]:
    rows = np.zeros(len(scene), np.bool_)
    rows[: len(found.labels)] = True
    labels = set_labels(scene, rows, found.labels, title)
    if found.confidence is scene.confidence:
        return labels, None
    return labels, SetConfidence(title, scene.confidence, found.confidence)


def _change(scene: Scene, after: Identities, title: str) -> SetIdentities:
    return SetIdentities(title, scene.identities, after)
