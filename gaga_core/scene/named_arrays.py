"""Splats and identities as named arrays and back, bit for bit: in scene files, histories, edits."""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from gaga_core.arrays import MOST_GROUP, AnyArray
from gaga_core.gaussians import Gaussians
from gaga_core.io.arrays_file import TEXT, Column, checked
from gaga_core.scene.frame import FARTHEST
from gaga_core.scene.scene import Identities, Labelling, Placements

_OWN = {
    "means": Column(np.float32, ("N", 3)),
    "quats": Column(np.float32, ("N", 4)),
    "log_scales": Column(np.float32, ("N", 3), unknown=True),  # -inf: no size at all
    "logit_opacities": Column(np.float32, ("N",), unknown=True),  # inf: opaque
    "sh": Column(np.float32, ("N", "S", 3)),
}
_EXTRA = "extra:"  # before the names of all other columns
PLACEMENTS = {
    "matrix": Column(np.float64, ("P", 3, 4), low=-FARTHEST, high=FARTHEST),
    "color": Column(np.float64, ("P", 3, 4), low=-FARTHEST, high=FARTHEST),
    "opacity": Column(np.float64, ("P",), low=0, high=FARTHEST),
}
_IDENTITIES = {  # of M splats of the opened file
    "labels_from": replace(TEXT, optional=True),
    "other_labels": Column(np.int32, ("M",), low=0, high=MOST_GROUP, optional=True),
    "other_confidence": Column(np.uint8, ("M",), optional=True),
    "identity_colors": Column(np.uint8, ("M", 3), optional=True),
}


def identity_arrays(identities: Identities) -> dict[str, AnyArray]:
    """``identities`` as named arrays; none where labels are votes and there is nothing else."""
    arrays: dict[str, AnyArray] = {}
    if identities.source != "votes":
        arrays["labels_from"] = np.array(identities.source)
    if identities.other is not None:
        arrays["other_labels"] = identities.other.labels
        if identities.other.confidence is not None:
            arrays["other_confidence"] = identities.other.confidence
    if identities.colors is not None:
        arrays["identity_colors"] = identities.colors
    return arrays


def identities_of(arrays: Mapping[str, AnyArray], **lengths: int) -> Identities:
    """What `identity_arrays` wrote; ``ValueError`` if damaged. ``lengths``: M, where it is known,
    the splats of the opened file."""
    arrays = checked(arrays, _IDENTITIES, **lengths)
    source, labels = str(arrays.get("labels_from", "votes")), arrays.get("other_labels")
    colors, confidence = arrays.get("identity_colors"), arrays.get("other_confidence")
    other = None if labels is None else Labelling(labels, confidence)
    if source == "votes":
        return Identities("votes", other, colors)
    if source == "identities" and other is not None:
        return Identities("identities", other, colors)
    raise ValueError(f"labels_from: {source!r} without the other labels")


def placements_of(arrays: Mapping[str, AnyArray]) -> Placements:
    """The placements whose columns ``arrays`` hold. Raises ``ValueError`` when one is none."""
    own = checked(arrays, PLACEMENTS)
    if (np.linalg.det(own["matrix"][:, :, :3]) == 0).any():
        raise ValueError("matrix: a placement that flattens space")
    return Placements(**own)


def columns_of(splats: Gaussians) -> dict[str, AnyArray]:
    """Every column by name, bit for bit."""
    own: dict[str, AnyArray] = {name: getattr(splats, name) for name in _OWN}
    return own | {_EXTRA + name: column for name, column in splats.extra.items()}


def splats_of(columns: Mapping[str, AnyArray]) -> Gaussians:
    """The splats of `columns_of`. Raises ``KeyError`` or ``ValueError`` when they are damaged."""
    extra = {k.removeprefix(_EXTRA): v for k, v in columns.items() if k.startswith(_EXTRA)}
    if odd := [name for name, column in extra.items() if column.dtype.kind not in "iuf"]:
        raise ValueError(f"{odd[0]}: expected numbers")
    own = checked(columns, _OWN)
    means, quats, log_scales, opacities, sh = (own[name] for name in _OWN)
    return Gaussians(means, quats, log_scales, opacities, sh, MappingProxyType(extra))
