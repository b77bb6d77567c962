"""The groups with which a model opens: of the last association, or those that its file carries."""

from pathlib import Path

import numpy as np

from gaga_core.arrays import IntArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.identity.classifier_io import FILE, field_of_model
from gaga_core.io.arrays_file import read_arrays
from gaga_core.scene.edits.groups import as_bytes


def read_labels(path: Path, n_gaussians: int) -> tuple[IntArray, UInt8Array | None]:
    """Groups (N,) and their confidence (N,) 0..255, if it is there, of a ``labels.npz``.

    Raises ``GagaError`` when the file is damaged or of a model with other than ``n_gaussians``.
    """
    cure = "Run Associate again, or remove it."
    arrays = read_arrays(path, cure)
    labels = arrays.get("labels", np.zeros(0, np.float32))
    confidence = arrays.get("confidence")
    is_right = labels.ndim == 1 and labels.dtype.kind in "iu"
    if confidence is not None:
        is_right &= confidence.shape == labels.shape and confidence.dtype.kind == "f"
    if not is_right:
        raise GagaError(f"{path} is damaged. {cure}")
    if len(labels) != n_gaussians:
        raise GagaError(
            f"{path} is of another model ({len(labels):,} splats, not {n_gaussians:,}). "
            "Run Associate again, or remove it."
        )
    sure = None if confidence is None else as_bytes(confidence)
    return np.ascontiguousarray(labels, np.int32), sure


def labels_of_file(gaussians: Gaussians, path: Path) -> tuple[IntArray, UInt8Array | None]:
    """Groups (N,) and confidence (N,) 0..255 that the file of splats at ``path`` carries.

    A column ``group``; else the argmax, over each encoding, of the classifier that Gaussian
    Grouping and Gaga train, with the softmax as its confidence; else none: all 0. Raises
    ``GagaError`` when the classifier is damaged.
    """
    column = gaussians.extra.get("group")
    if column is not None and column.dtype.kind in "iu":
        return np.maximum(column.astype(np.int64), 0).astype(np.int32), None
    try:
        field = field_of_model(gaussians, path)
    except GagaError as error:
        raise GagaError(
            f"{error} Or move {FILE} away to open the splats without groups."
        ) from error
    if field is None:
        return np.zeros(len(gaussians), np.int32), None
    labels, confidence = field.classify(field.encodings)
    return labels, as_bytes(confidence)
