"""The groups with which a model opens: of the last association, or those that its file carries.

After an association and a lift there are two labels for every Gaussian: the votes of the masks, and
the classifier on its identity encoding. The preset paper takes those of the classifier once it is
trained as published; otherwise votes are in use. The other ones wait in `scene.Identities`.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gaga_core.arrays import IntArray, UInt8Array, check_shape
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.bank_file import bank_digest, load_bank
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.identity.classifier_io import FILE, field_of_model
from gaga_core.identity.colors import encoding_colors
from gaga_core.identity.field import FILE as IDENTITY_FILE
from gaga_core.io.arrays_file import read_arrays
from gaga_core.scene.edits.objects import as_bytes
from gaga_core.scene.scene import Identities, Labelling, Scene


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


@dataclass(frozen=True, eq=False)
class OpenedGroups:
    """What a scene begins with."""

    labels: IntArray  # (N,)
    confidence: UInt8Array | None  # (N,) 0..255
    bank: MemoryBank | None = None
    identities: Identities = field(default_factory=Identities)


def groups_of_folder(work: Path, n_gaussians: int) -> OpenedGroups:
    """The groups of the last association in ``work`` (SCENE/gaga), which has a labels.npz.

    Labels come from the identities where they were trained as published from groups of the preset
    paper, else from the votes. Raises ``GagaError`` when a file is damaged or of another model.
    """
    labels, confidence = read_labels(work / "labels.npz", n_gaussians)
    bank = load_bank(work / "bank.npz") if (work / "bank.npz").is_file() else None
    found = _lifted(work, bank, n_gaussians)
    if found is None:
        return OpenedGroups(labels, confidence, bank)
    lifted, colors, mode = found
    if bank is not None and (mode, bank.preset) == ("paper", "paper"):
        votes = Labelling(labels, confidence)
        identities = Identities("identities", votes, colors)
        return OpenedGroups(lifted.labels, lifted.confidence, bank, identities)
    return OpenedGroups(labels, confidence, bank, Identities("votes", lifted, colors))


def _lifted(
    work: Path, bank: MemoryBank | None, n_gaussians: int
) -> tuple[Labelling, UInt8Array | None, str] | None:
    """Labels, colors (N, 3) and mode of the last lift; None where it is of other groups."""
    path = work / IDENTITY_FILE
    if not path.is_file() or path.stat().st_mtime_ns < (work / "labels.npz").stat().st_mtime_ns:
        return None
    cure = "Lift the groups again, or remove it."
    names = ("labels", "confidence", "mode")
    arrays = read_arrays(path, cure, names, optional=("bank", "colors"))
    digest, colors = str(arrays.get("bank", "")), arrays.get("colors")
    if digest and (bank is None or digest != bank_digest(bank)):
        return None
    try:
        check_shape("labels", arrays["labels"], (n_gaussians,), np.int32)
        check_shape("confidence", arrays["confidence"], (n_gaussians,), np.float32)
        if arrays["labels"].min(initial=0) < 0:
            raise ValueError("labels: an id below 0")
        if colors is not None:
            check_shape("colors", colors, (n_gaussians, 3), np.uint8)
    except ValueError as error:
        raise GagaError(f"{path} is damaged or of another model. {cure}") from error
    labelling = Labelling(arrays["labels"], as_bytes(arrays["confidence"]))
    return labelling, colors, str(arrays["mode"])


def groups_of_file(gaussians: Gaussians, path: Path) -> OpenedGroups:
    """Groups (N,) and confidence (N,) 0..255 that the file of splats at ``path`` carries.

    A column ``group``; else the argmax, over each encoding, of the classifier that Gaussian
    Grouping and Gaga train, with the softmax as its confidence; else none: all 0. Raises
    ``GagaError`` when the classifier is damaged.
    """
    column = gaussians.extra.get("group")
    if column is not None and column.dtype.kind in "iu":
        return OpenedGroups(np.maximum(column.astype(np.int64), 0).astype(np.int32), None)
    try:
        classifier = field_of_model(gaussians, path)
    except GagaError as error:
        raise GagaError(
            f"{error} Or move {FILE} away to open the splats without groups."
        ) from error
    if classifier is None:
        return OpenedGroups(np.zeros(len(gaussians), np.int32), None)
    labels, confidence = classifier.classify(classifier.encodings)
    identities = Identities(colors=encoding_colors(classifier.encodings))
    return OpenedGroups(labels, as_bytes(confidence), None, identities)


def with_groups(scene: Scene, opened: OpenedGroups) -> Scene:
    """``scene``, just read, with what it begins with; the same object."""
    scene.labels, scene.confidence = opened.labels, opened.confidence
    scene.bank, scene.identities = opened.bank, opened.identities
    return scene
