"""Label maps on disk: one PNG a view, named by the photo's path without its suffix."""

from collections import Counter
from collections.abc import Iterable, Sequence
from functools import partial
from io import BytesIO
from pathlib import Path, PurePosixPath

import msgspec
import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from gaga_core.arrays import IntArray, check_shape
from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write, safe_name, same_name
from gaga_core.io.images import block_of, blocks, image_header, open_image, pictures_in
from gaga_core.io.json_file import read_foreign_json
from gaga_core.masks import MaskSet

RECORD = "provider.json"  # next to label maps that were made here: by whom, with which settings
_FURTHER = b"gaLV"  # private, ancillary, not to be copied to a changed picture (PNG, section 5.4)
# Of zlib: runs alone, whose search for repetitions takes most of the time and gains nothing here
# (regions of 6 photos at 4 levels: 10.0 kB in 2.5 ms, with it 10.5 kB in 4.0 ms).
_RUN_LENGTHS = 3  # Z_RLE
_PER_PIXEL = 4  # bytes, int32
_WITHOUT_MODEL = "regions"  # the provider that has no model: `segmentation.regions`


def read_labels(path: Path) -> IntArray:
    """Label map (H, W) int32, 0 = none.

    8- and 16-bit gray and palette pictures hold ids; in RGB pictures every distinct color but black
    is an id (in the order of its value). Raises ``GagaError`` when the file is not a picture.
    """
    return _ids_of(path, open_image(path, per_pixel=_PER_PIXEL))


def read_further_labels(path: Path) -> tuple[IntArray, ...]:
    """Label maps at other levels of detail that `write_labels` put into the file, of any size.

    None where another program wrote the file. Raises ``GagaError`` when they are damaged.
    """
    with image_header(path) as image:
        chunks = getattr(image, "private_chunks", ())
    maps: list[IntArray] = []
    for data in [chunk[1] for chunk in chunks if chunk[0] == _FURTHER]:
        held = sum(labels.nbytes for labels in maps)
        maps.append(_ids_of(path, open_image(path, data, per_pixel=_PER_PIXEL, held=held)))
    return tuple(maps)


def _ids_of(path: Path, image: Image.Image) -> IntArray:
    if image.mode == "F":
        raise GagaError(f"{path.name} holds fractions, not ids. Save it as an 8- or 16-bit PNG.")
    labels = np.empty((image.height, image.width), np.int32)
    parts = list(blocks(*labels.shape))
    if len(image.getbands()) == 1:
        mode = "L" if image.mode == "1" else None
        for where in parts:  # some data sets mark void with -1; here 0 is "none"
            labels[where] = np.maximum(block_of(image, where, mode), 0)
        return labels
    colors = np.zeros(1, np.int32)  # in order; 0 stays "none"
    is_gray = True
    for where in parts:
        red, green, blue = np.moveaxis(block_of(image, where, "RGB").astype(np.int32), 2, 0)
        labels[where] = (red << 16) | (green << 8) | blue
        colors = np.union1d(colors, labels[where])
        is_gray = is_gray and np.array_equal(red, green) and np.array_equal(red, blue)
    for where in parts:  # a gray picture saved as RGB holds ids
        labels[where] = labels[where] >> 16 if is_gray else np.searchsorted(colors, labels[where])
    return labels


def write_labels(path: Path, labels: IntArray, further: Sequence[IntArray] = ()) -> None:
    """Write a label map (H, W) as a 16-bit gray PNG; ids above 65535 do not fit.

    ``further`` are label maps of the same picture at other levels of detail, of any size. Each one
    is a PNG in a private chunk of the file, which other programs ignore, and drop when they save.
    """
    chunks = PngInfo()
    for finer in further:
        buffer = BytesIO()
        _gray(path, finer).save(buffer, format="PNG", compress_type=_RUN_LENGTHS)
        chunks.add(_FURTHER, buffer.getvalue())
    picture = _gray(path, labels)
    with atomic_write(path) as temporary:
        picture.save(temporary, format="PNG", compress_type=_RUN_LENGTHS, pnginfo=chunks)


def _gray(path: Path, labels: IntArray) -> Image.Image:
    check_shape("labels", labels, ("H", "W"))
    if labels.size and (labels.min() < 0 or labels.max() > 65535):
        raise GagaError(f"{path.name}: ids must lie in 0..65535 to be written as a label map.")
    return Image.fromarray(labels.astype(np.uint16))


def view_key(name: str) -> str:
    """Where the files of a view lie, without suffix: ``l/1`` of the photo ``l/1.jpg``.

    Names come from files of other programs: parts that lead out of a folder (``..``, a leading
    ``/``) are left out, and each other part is a name on every system (`safe_name`).
    """
    path = PurePosixPath(name)
    parts = (*path.parent.parts, path.stem)
    return "/".join(safe_name(part) for part in parts if part not in (path.anchor, "..", ".", ""))


def view_keys(names: Iterable[str]) -> dict[str, str]:
    """`view_key` of each view. Raises ``GagaError`` when two views would share their files."""
    keys: dict[str, str] = {}
    owners: dict[str, str] = {}
    for name in names:
        keys[name] = view_key(name)
        owner = owners.setdefault(same_name(keys[name]), name)
        if owner != name:
            raise GagaError(
                f"The photos {owner} and {name} differ only in their suffix or in case, so they "
                "would share their masks. Rename one of them, and reconstruct the cameras again."
            )
    return keys


def list_label_files(folder: Path) -> tuple[Path, ...]:
    """Pictures of ``folder`` by name; hidden files are left out."""
    if not folder.is_dir():
        raise GagaError(f"{folder} is not a folder. Choose a folder of label maps.")
    return tuple(pictures_in(folder).values())


def label_files(folder: Path) -> dict[str, Path]:
    """Pictures of ``folder`` and of its subfolders by their path without suffix (``l/1``).

    Names are those of `view_key`. Hidden files and folders are left out. Raises ``GagaError`` when
    ``folder`` is no folder.
    """
    found = {safe_name(path.stem): path for path in list_label_files(folder)}
    for inner in sorted(folder.iterdir()):
        if inner.is_dir() and not inner.name.startswith("."):
            name = safe_name(inner.name)
            found |= {f"{name}/{key}": path for key, path in label_files(inner).items()}
    return found


def label_files_of(
    folder: Path, view_names: Iterable[str], among: Iterable[str] = ()
) -> dict[str, Path]:
    """The label map in ``folder`` of each of these views that has one there.

    A map lies where its photo does (`view_key`). A map in ``folder`` itself also belongs to the
    only photo of its stem in a subfolder, as other programs write it; ``among`` names all views of
    the scene where ``view_names`` are a part of them. Raises ``GagaError`` when ``folder`` is no
    folder.
    """
    names = list(view_names)
    files = label_files(folder)
    n_of_stem = Counter(_stem(name) for name in {*names, *among})
    found = {}
    for name in names:
        stem = _stem(name)
        path = files.get(view_key(name)) or (files.get(stem) if n_of_stem[stem] == 1 else None)
        if path is not None:
            found[name] = path
    return found


def _stem(name: str) -> str:
    return view_key(name).rpartition("/")[2]


class MaskRecord(msgspec.Struct, frozen=True):
    """What is read again of provider.json, next to label maps."""

    provider: str = ""
    model: str = ""
    # Path of a photo without suffix -> hash of all its map depends on; "" = made elsewhere.
    views: dict[str, str] = {}
    settings: dict[str, object] = {}  # of the model, that change the masks
    source: str = ""  # file or folder of the weights
    longest_side: int | None = None  # pixels, of the photos as they were segmented
    use_depth: bool | None = None  # whether the depth of the splats was given to the provider


def mask_folder(folder: Path, view_names: Iterable[str], among: Iterable[str] = ()) -> MaskSet:
    """The label maps of ``folder`` for these views, as `label_files_of` finds them.

    Nothing is read yet. Raises ``GagaError`` when ``folder`` is no folder.
    """
    files = label_files_of(folder, view_names, among)
    loaders = {name: partial(read_labels, path) for name, path in files.items()}
    are_regions = _are_regions(folder)
    further = {name: partial(read_further_labels, path) for name, path in files.items()}
    return MaskSet(loaders, str(folder), are_regions, further)


def _are_regions(folder: Path) -> bool:
    """Whether the record of the folder says that no model, and nobody else, made its label maps."""
    try:
        record = read_foreign_json(folder / RECORD, MaskRecord)
    except GagaError:
        return False  # not recorded
    return record.provider == _WITHOUT_MODEL and "" not in record.views.values()
