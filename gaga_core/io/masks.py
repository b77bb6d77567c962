"""Label maps on disk: one PNG a view, named by the photo's stem."""

import json
from collections.abc import Iterable
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.arrays import AnyArray, IntArray, check_shape
from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write
from gaga_core.io.images import IMAGE_SUFFIXES, open_image
from gaga_core.masks import MaskSet

RECORD = "provider.json"  # next to label maps that were made here: by whom, with which settings
_WITHOUT_MODEL = "regions"  # the provider that has no model: `segmentation.regions`


def read_labels(path: Path) -> IntArray:
    """Label map (H, W) int32, 0 = none.

    8- and 16-bit gray and palette pictures hold ids; in RGB pictures every distinct color but black
    is an id (in the order of its value). Raises ``GagaError`` when the file is not a picture.
    """
    image = open_image(path)
    if image.mode == "1":
        image = image.convert("L")
    values = np.asarray(image)
    if values.ndim == 2:
        return _as_ids(path, values)
    colors = np.asarray(image.convert("RGB")).astype(np.int64)
    codes = (colors[..., 0] << 16) | (colors[..., 1] << 8) | colors[..., 2]
    if np.array_equal(colors[..., 0], colors[..., 1]) and np.array_equal(
        colors[..., 0], colors[..., 2]
    ):
        return _as_ids(path, colors[..., 0])  # a gray picture saved as RGB holds ids
    distinct = np.unique(codes)
    distinct = distinct[distinct > 0]
    ids = np.searchsorted(distinct, codes) + 1
    return np.where(codes == 0, 0, ids).astype(np.int32)


def write_labels(path: Path, labels: IntArray) -> None:
    """Write a label map (H, W) as a 16-bit gray PNG; ids above 65535 do not fit."""
    check_shape("labels", labels, ("H", "W"))
    if labels.size and (labels.min() < 0 or labels.max() > 65535):
        raise GagaError(f"{path.name}: ids must lie in 0..65535 to be written as a label map.")
    with atomic_write(path) as temporary:
        Image.fromarray(labels.astype(np.uint16)).save(temporary, format="PNG")


def list_label_files(folder: Path) -> tuple[Path, ...]:
    """Pictures of ``folder`` by name; hidden files are left out."""
    if not folder.is_dir():
        raise GagaError(f"{folder} is not a folder. Choose a folder of label maps.")
    files = (p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES)
    return tuple(sorted(p for p in files if not p.name.startswith(".")))


def mask_folder(folder: Path, view_names: Iterable[str]) -> MaskSet:
    """The label maps of ``folder`` for these views: a map belongs to the photo of its stem.

    Nothing is read yet. Raises ``GagaError`` when ``folder`` is no folder.
    """
    by_stem = {path.stem: path for path in list_label_files(folder)}
    loaders = {
        name: partial(read_labels, by_stem[Path(name).stem])
        for name in view_names
        if Path(name).stem in by_stem
    }
    return MaskSet(loaders, source=str(folder), are_regions=_are_regions(folder))


def _are_regions(folder: Path) -> bool:
    """Whether the record of the folder says that no model made its label maps."""
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False  # nobody says so
    return isinstance(record, dict) and record.get("provider") == _WITHOUT_MODEL


def _as_ids(path: Path, values: AnyArray) -> IntArray:
    if values.dtype.kind == "f":
        raise GagaError(f"{path.name} holds fractions, not ids. Save it as an 8- or 16-bit PNG.")
    # Some data sets mark void with -1; here 0 is "none". A copy: pillow's memory is read-only.
    return np.array(np.maximum(values, 0), np.int32, order="C")
