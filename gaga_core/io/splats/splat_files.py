"""Files of splats of every kind: which kind one is, reading it, writing it, and what that loses.

A kind is recognised by the content of a file; only .splat has no mark, and needs its suffix.
"""

import hashlib
from collections.abc import Callable, Iterator, Mapping
from enum import StrEnum
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from gaga_core.arrays import BoolArray
from gaga_core.color import SH_C0
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import explain_os_error, fingerprint, open_file
from gaga_core.io.json_file import read_foreign_json
from gaga_core.io.splats import compressed_ply, glb, spz, usd
from gaga_core.io.splats.compressed_ply import read_compressed_ply_stage, write_compressed_ply_stage
from gaga_core.io.splats.glb import buffer_file, read_glb_stage, write_glb_stage
from gaga_core.io.splats.ksplat import read_ksplat_stage
from gaga_core.io.splats.ply import read_ply_stage, write_ply_stage
from gaga_core.io.splats.sog import (
    LOD_META,
    META,
    chunk_path,
    is_sog_meta,
    is_streamed_sog,
    read_sog_stage,
    read_streamed_sog_stage,
    write_sog_stage,
)
from gaga_core.io.splats.splat import read_splat_stage, write_splat_stage
from gaga_core.io.splats.spz import OURS, fraction_bits, read_spz_stage, write_spz_stage
from gaga_core.io.splats.usd import is_usdz, read_usd_stage, write_usd_stage
from gaga_core.io.splats.web_page import plain_page, write_page_stage
from gaga_core.progress import Stage, run_stage

READ_SUFFIXES = (".ply", ".splat", ".spz", ".sog", ".ksplat", ".glb", ".gltf", *usd.SUFFIXES)
WRITE_SUFFIXES = (".ply", ".compressed.ply", ".splat", ".spz", ".sog", ".glb", ".usd", ".html")
_HEADER = 1 << 16  # bytes in which the header of a compressed PLY names its columns
_BY_START: Mapping[bytes, Callable[[Path], Stage[Gaussians]]] = {
    b"ply": read_ply_stage,
    spz.GZIP_MAGIC: read_spz_stage,
    spz.MAGIC: read_spz_stage,
    glb.MAGIC: read_glb_stage,
    b"PK": read_sog_stage,
    usd.MAGIC: read_usd_stage,
    usd.TEXT: read_usd_stage,
}
_BY_SUFFIX: Mapping[str, Callable[[Path], Stage[Gaussians]]] = {
    ".sog": read_sog_stage,
    ".splat": read_splat_stage,
    ".ksplat": read_ksplat_stage,
    ".gltf": read_glb_stage,
}
# Their worlds have an axis that is up: read as a 3DGS .ply, it is -y.
_STANDING, _UP = (read_glb_stage, read_usd_stage), (0.0, -1.0, 0.0)
_NORMALS = ("nx", "ny", "nz")
_MOST_BYTES = 1 << 30  # of a .gltf with its numbers in the text
_NAMED = 4  # columns that a sentence names; the others are counted


class SplatFormat(StrEnum):
    """Kinds of files that are written; the value is how a command names them."""

    PLY = "ply"
    COMPRESSED_PLY = "compressed-ply"
    SPLAT = "splat"
    SPZ = "spz"  # version 3, which most programs read
    SPZ4 = "spz4"
    SOG = "sog"
    GLB = "glb"  # with KHR_gaussian_splatting
    USD = "usd"  # with ParticleField3DGaussianSplat
    HTML = "html"  # a page to look at, which is not read

    @property
    def suffix(self) -> str:
        """Suffix of a file of this form."""
        return {"compressed-ply": ".compressed.ply", "spz4": ".spz"}.get(self.value, f".{self}")


def form_of(path: Path) -> SplatFormat:
    """The form that a name asks for; ``GagaError`` when it asks for none that is written."""
    name = Path(path).name.lower()
    if name == META:
        return SplatFormat.SOG  # in a folder
    if name.endswith(usd.SUFFIXES):
        return SplatFormat.USD
    others = [form for form in SplatFormat if form is not SplatFormat.SPZ4]
    for form in (SplatFormat.COMPRESSED_PLY, *others):
        if name.endswith(form.suffix):
            return form
    raise GagaError(
        f"{Path(path).name} cannot be written: choose a name that ends in .ply, .compressed.ply, "
        ".splat, .spz, .sog, .glb, .usd or .html, or the name meta.json for a SOG in a folder."
    )


def read_splats(path: Path) -> Gaussians:
    """Read a file of splats of any kind; see `read_splats_stage`."""
    return run_stage(read_splats_stage(path))


def read_splats_stage(path: Path, spz_axes: str = OURS) -> Stage[Gaussians]:
    """Read a .ply (plain, compressed), .splat, .spz, .ksplat, .glb, .gltf, OpenUSD or SOG file.

    All give Gaussians in the frame and units of a 3DGS .ply. ``spz_axes``: of an .spz that does not
    say its own (`states_axes`). Raises ``GagaError`` with one sentence when the file is of no known
    kind, damaged, or larger than memory.
    """
    path = Path(path)
    for listed in (path, path / LOD_META):
        if is_streamed_sog(listed):
            return (yield from read_streamed_sog_stage(listed))
    if is_sog_meta(path) or is_sog_meta(path / META):
        return (yield from read_sog_stage(path))
    if path.is_dir():
        raise GagaError(f"{path} is a folder. Choose a file of splats.")
    reader = read_usd_stage if is_usdz(path) else _reader_of(path)
    if reader is read_spz_stage:
        return (yield from read_spz_stage(path, spz_axes))
    gaussians = yield from reader(path)
    return gaussians.with_up(_UP) if reader in _STANDING else gaussians


def is_standing(path: Path) -> bool:
    """Whether a file of this name has an axis that is up, to which its writer turned the splats."""
    return Path(path).name.lower().endswith((SplatFormat.GLB.suffix, ".gltf", *usd.SUFFIXES))


def _reader_of(path: Path) -> Callable[[Path], Stage[Gaussians]]:
    """The reader of a file; ``GagaError`` when there is none."""
    try:
        with open_file(path) as file:
            start = file.read(_HEADER)
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    if start.startswith(b"ply") and b"packed_position" in start:
        return read_compressed_ply_stage
    for magic, reader in _BY_START.items():
        if start.startswith(magic):
            return reader
    suffix = path.suffix.lower()
    if suffix == ".ply" or not start:
        return read_ply_stage  # which says what is wrong
    if suffix in _BY_SUFFIX:
        return _BY_SUFFIX[suffix]
    raise GagaError(
        f"{path.name} is not a splat file that gaga-studio can read. Choose a .ply, .splat, .spz, "
        ".sog, .ksplat, .glb, .gltf or .usd file."
    )


def write_splats(path: Path, gaussians: Gaussians, form: SplatFormat | None = None) -> None:
    """Write a file of splats; see `write_splats_stage`."""
    run_stage(write_splats_stage(path, gaussians, form))


def write_splats_stage(
    path: Path, gaussians: Gaussians, form: SplatFormat | None = None
) -> Stage[None]:
    """Write splats in ``form`` (default: what the name asks for) with progress.

    `losses` says beforehand what the form does not keep. Nothing is left when it fails. Raises
    ``GagaError`` when there is nothing to write, splats have numbers that no reader takes
    (`packing.writable`), or the place cannot be written.
    """
    path = Path(path)
    form = form_of(path) if form is None else form
    if len(gaussians) == 0:
        raise GagaError(f"There is nothing to write to {path.name}: no splats are visible.")
    yield from _WRITERS[form](path, gaussians)


def _write_page(path: Path, gaussians: Gaussians) -> Stage[None]:
    return write_page_stage(path, plain_page(path.stem, gaussians))


_WRITERS: Mapping[SplatFormat, Callable[[Path, Gaussians], Stage[None]]] = {
    SplatFormat.PLY: write_ply_stage,
    SplatFormat.COMPRESSED_PLY: write_compressed_ply_stage,
    SplatFormat.SPLAT: write_splat_stage,
    SplatFormat.SPZ: write_spz_stage,
    SplatFormat.SPZ4: partial(write_spz_stage, version=4),
    SplatFormat.SOG: write_sog_stage,
    SplatFormat.GLB: write_glb_stage,
    SplatFormat.USD: write_usd_stage,
    SplatFormat.HTML: _write_page,
}
_PRECISION = {
    SplatFormat.SPLAT: "Colors, opacities and rotations are rounded to 8 bits a number.",
    SplatFormat.COMPRESSED_PLY: (
        "All numbers are rounded (positions to 1/2047 of the extent of 256 neighbours, colors "
        "and SH to 8 bits), and the splats are put in another order."
    ),
    SplatFormat.SOG: (
        "All numbers are rounded: positions to 16 bits, sizes and colors to the nearest of "
        "256, opacities and rotations to 8 bits, and SH to the nearest of a palette."
    ),
    SplatFormat.SPZ: (
        "All numbers are rounded: positions to {step:.2g} {units}, sizes to 3 percent, colors "
        "and opacities to 8 bits, SH to 5 bits or 4."
    ),
}
_PRECISION[SplatFormat.HTML] = _PRECISION[SplatFormat.SOG]
_PRECISION[SplatFormat.SPZ4] = _PRECISION[SplatFormat.SPZ]
# The most of a DC coefficient and of the others, for which a form has room; the others have all.
_LIMITS = {
    SplatFormat.SPLAT: (0.5 / SH_C0, np.inf),
    SplatFormat.COMPRESSED_PLY: (np.inf, compressed_ply.SH_RANGE),
    SplatFormat.SPZ: (0.5 / spz.COLOR_SCALE, 1.0),
    SplatFormat.SPZ4: (0.5 / spz.COLOR_SCALE, 1.0),
}


def losses(gaussians: Gaussians, form: SplatFormat) -> tuple[str, ...]:
    """What writing ``gaussians`` in ``form`` does not keep, a sentence each; nothing for a .ply."""
    return () if form is SplatFormat.PLY else tuple(_losses(gaussians, form))


def _losses(gaussians: Gaussians, form: SplatFormat) -> Iterator[str]:
    if form is SplatFormat.HTML:
        yield "No program opens a page as splats again: keep the scene itself, too."
    if form in _PRECISION:
        units = "metres" if gaussians.is_metric else "scene units"
        step = 2.0 ** -fraction_bits(gaussians.means)
        yield _PRECISION[form].format(step=step, units=units)
    degree = gaussians.sh_degree
    if form is SplatFormat.SPLAT and degree:
        yield f"The view-dependent color (SH of degree {degree}) is left out."
    has_room = (SplatFormat.SPLAT, SplatFormat.SPZ, SplatFormat.SPZ4, SplatFormat.USD)
    if form not in has_room and degree > 3:
        yield "The SH of degree 4 are left out."
    columns = [name for name in gaussians.extra if name not in _NORMALS]
    normals = [gaussians.extra[name] for name in _NORMALS if name in gaussians.extra]
    if any(column.any() for column in normals):
        columns.append("normals")
    if columns:
        more = len(columns) - _NAMED
        named = ", ".join(columns[:_NAMED]) + (f" and {more} more" if more > 0 else "")
        yield f"Other columns are left out: {named}."
    if form in (SplatFormat.SPLAT, SplatFormat.GLB, SplatFormat.USD) and gaussians.is_antialiased:
        yield "That the splats are to be drawn antialiased is not kept."
    if form is SplatFormat.SPLAT and gaussians.is_metric:
        yield "That a unit is a metre is not kept."
    clipped = _clipped(gaussians, form)
    if clipped:
        s = "" if clipped == 1 else "s"
        yield f"Colors or sizes out of range are clipped: those of {clipped:,} splat{s}."


def _clipped(gaussians: Gaussians, form: SplatFormat) -> int:
    """Splats with a color or size that the form has no room for."""
    if form not in _LIMITS:
        return 0
    most_dc, most_rest = _LIMITS[form]
    out: BoolArray = np.any(np.abs(gaussians.sh[:, 0]) > most_dc, axis=1)
    if gaussians.sh_degree and most_rest < np.inf:
        rest = gaussians.sh[:, 1:].reshape(len(out), -1)
        out |= (rest.max(axis=1) > most_rest) | (rest.min(axis=1) < -most_rest)
    if form in (SplatFormat.SPZ, SplatFormat.SPZ4):
        sizes = gaussians.log_scales
        out |= (sizes.min(axis=1) < -10) | (sizes.max(axis=1) > 255 / 16 - 10)
    return int(out.sum())


# --- the files of a model that lies in several: a .gltf takes its numbers from buffers next to it,
# the meta.json of a SOG folder from pictures, a lod-meta.json from such folders


def files_of_model(path: Path) -> tuple[Path, ...]:
    """``path``, then the files next to it or below it that its numbers lie in.

    None of them need exist; of a damaged model only ``path`` is known.
    """
    path = Path(path)
    if path.suffix.lower() != ".gltf" and path.name not in (META, LOD_META):
        return (path,)
    try:
        found = path.stat()
    except OSError:
        return (path,)
    parts = _parts(path, (found.st_ino, found.st_mtime_ns, found.st_size))
    if path.name == LOD_META:  # each chunk is a model of several files, too
        parts = tuple(file for chunk in parts for file in files_of_model(chunk))
    return (path, *parts)


def model_fingerprint(path: Path) -> str:
    """Digest of all files of a model; of a single file that of `fingerprint`.

    Raises ``GagaError`` when ``path`` itself cannot be read.
    """
    path = Path(path)
    files = files_of_model(path)
    if len(files) == 1:
        return fingerprint(path)
    digests = [fingerprint(file) if _is_there(file) else "gone" for file in files]
    return hashlib.sha256("\n".join(digests).encode()).hexdigest()


def _is_there(file: Path) -> bool:
    try:
        return file.is_file()
    except OSError:  # a name that no file can have
        return False


def is_same_model(path: Path, digest: str) -> bool:
    """Whether the model has this digest, which may be one of ``path`` alone as older projects have.

    Raises ``GagaError`` when ``path`` cannot be read.
    """
    return digest in (model_fingerprint(path), fingerprint(path))


@lru_cache(maxsize=4096)  # a streamed SOG may have as many chunks
def _parts(path: Path, stamp: tuple[int, int, int]) -> tuple[Path, ...]:
    """Files that a model names; ``stamp`` tells one version of it from another."""
    del stamp
    try:
        content = read_foreign_json(path, dict[str, Any], most_bytes=_MOST_BYTES)
        if path.name == LOD_META:
            names = [*content.get("filenames", []), *filter(None, [content.get("environment")])]
            return tuple(chunk_path(path, str(name)) for name in names)
        if path.name == META:
            described = [part for part in content.values() if isinstance(part, dict)]
            names = [str(name) for part in described for name in part.get("files", ())]
            return tuple(path.parent / name for name in names if Path(name).name == name)
        uris = [row.get("uri") for row in content.get("buffers", [])]
        named = [uri for uri in uris if isinstance(uri, str) and not uri.startswith("data:")]
        return tuple(buffer_file(uri, path) for uri in named)
    except (GagaError, OSError, ValueError, TypeError, AttributeError):
        return ()  # the reader of the model says what is wrong with it
