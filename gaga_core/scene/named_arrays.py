"""Splats and identities as named arrays and back, bit for bit: in scene files, histories, edits."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from gaga_core.arrays import AnyArray, check_shape
from gaga_core.gaussians import Gaussians
from gaga_core.scene.scene import Identities, Labelling

_OWN = ("means", "quats", "log_scales", "logit_opacities", "sh")
_EXTRA = "extra:"  # before the names of all other columns


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


def identities_of(arrays: Mapping[str, AnyArray], n_opened: int) -> Identities:
    """What `identity_arrays` wrote, of a file of ``n_opened`` splats; ``ValueError`` if damaged."""
    source = str(arrays.get("labels_from", "votes"))
    labels, confidence = arrays.get("other_labels"), arrays.get("other_confidence")
    colors = arrays.get("identity_colors")
    if colors is not None:
        check_shape("identity_colors", colors, (n_opened, 3), np.uint8)
    other = None
    if labels is not None:
        check_shape("other_labels", labels, (n_opened,), np.int32)
        if labels.min(initial=0) < 0:
            raise ValueError("other_labels: an id below 0")
        if confidence is not None:
            check_shape("other_confidence", confidence, (n_opened,), np.uint8)
        other = Labelling(labels, confidence)
    if source == "votes":
        return Identities("votes", other, colors)
    if source == "identities" and other is not None:
        return Identities("identities", other, colors)
    raise ValueError(f"labels_from: {source!r} without the other labels")


def columns_of(splats: Gaussians) -> dict[str, AnyArray]:
    """Every column by name, bit for bit."""
    own: dict[str, AnyArray] = {name: getattr(splats, name) for name in _OWN}
    return own | {_EXTRA + name: column for name, column in splats.extra.items()}


def splats_of(columns: Mapping[str, AnyArray]) -> Gaussians:
    """The splats of `columns_of`. Raises ``KeyError`` or ``ValueError`` when they are damaged."""
    extra = {k.removeprefix(_EXTRA): v for k, v in columns.items() if k.startswith(_EXTRA)}
    means, quats, log_scales, opacities, sh = (columns[name] for name in _OWN)
    return Gaussians(means, quats, log_scales, opacities, sh, MappingProxyType(extra))
