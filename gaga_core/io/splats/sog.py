"""SOG, PlayCanvas' format of lossless WebP pictures: a .sog (zip), or a folder with meta.json.

A pixel is a splat. Positions are 16 bits in two pictures, on a scale of ``sign(x) ln(1 + |x|)``;
sizes and colors are places in a table of 256 numbers (version 2) or between two limits (version
1); rotations are the three smaller parts of wxyz and the place of the largest; SH of degree 1 to 3
come from a palette of up to 65,536 entries. Layout: github.com/playcanvas/splat-transform.

Streamed SOG, version 1: the leaves of a tree of boxes in a lod-meta.json name, for each level of
detail they have, a range of splats of a chunk; level 0 is the finest. A chunk is a SOG in a folder
of its own. See developer.playcanvas.com/user-manual/gaussian-splatting/formats/streamed-sog.
"""

import io
import json
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, cast

import msgspec
import numpy as np
from PIL import Image

from gaga_core.arrays import FloatArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write, check_memory, open_file
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.images import image_header
from gaga_core.io.json_file import decode_json, read_foreign_json
from gaga_core.io.splats.packing import (
    METRE,
    READS,
    bytes_of_logits,
    damaged,
    file_inside,
    joined_splats,
    log_words,
    logits_of_bytes,
    nearest,
    palette_of,
    parts_of,
    quat_bytes,
    quats_of_three,
    reading,
    room_for,
    row_bytes,
    sane,
    splat_reader,
    splat_writer,
    table_of,
    writing,
)
from gaga_core.progress import Progress, Stage, portion

META, LOD_META = "meta.json", "lod-meta.json"
_MOST_META, _MOST_LOD_META = 1 << 24, 1 << 26  # bytes
_PICTURE_BYTES = 32  # of a splat while a picture is unpacked: Pillow has three copies, and we two
_MOST_LOG = np.float32(60)  # of a position: exp(60) = 1e26
_MOST_DEPTH = 64  # of the tree of a streamed SOG
_MOST_SIDE = 16384  # of a WebP
_SLACK = 1 << 20  # pixels that a picture may hold beyond its splats
_ZIP_RATIO = 20  # WebP does not shrink in a zip; what does is not a picture
_PER_ROW = 64  # palette entries in a row of pixels
_COEFFICIENTS = {1: 3, 2: 8, 3: 15}
MOST_DEGREE = 3  # of SH
_MOST = 16383  # pixels of a side of a WebP that is written

_Index = Annotated[int, msgspec.Meta(ge=0, lt=1 << 31)]
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class _Sog:
    path: Path
    n: int
    version: int
    meta: Mapping[str, object]
    load: Callable[[str], bytes]
    n_stored: int  # bytes of all files

    def part(self, name: str) -> Mapping[str, object]:
        return cast(Mapping[str, object], self.meta[name])

    def numbers(self, part: str, name: str, count: int) -> FloatArray:
        """A list of numbers; one alone stands for all."""
        values = sane(np.asarray(self.part(part)[name], np.float64).reshape(-1))
        values = np.repeat(values, count) if len(values) == 1 else values
        if len(values) < count:
            raise ValueError(f"{part}.{name}")
        return values

    def picture(self, part: str, i: int) -> UInt8Array:
        """Pixels (P, 4) RGBA of a picture that has at least one a splat."""
        pixels = self.image(part, i, self.n + _SLACK).reshape(-1, 4)
        if len(pixels) < self.n:
            raise ValueError(f"{part} has too few pixels")
        return pixels

    def image(self, part: str, i: int, most: int) -> UInt8Array:
        """Pixels (H, W, 4) of the i-th file of a part, at most so many."""
        name = cast(Sequence[str], self.part(part)["files"])[i]
        with image_header(self.path, self.load(name)) as picture:
            if max(picture.size) > _MOST_SIDE or picture.width * picture.height > most:
                raise ValueError(f"{part} has too many pixels")
            return np.asarray(picture.convert("RGBA"))


def is_sog_meta(path: Path) -> bool:
    """Whether ``path`` is the meta.json of a SOG folder."""
    try:
        found = path.name == META and path.is_file()
        if not found:
            return False
        content = read_foreign_json(path, dict[str, object], most_bytes=_MOST_META)
    except (GagaError, OSError):  # the second from a name that is too long
        return False
    return {"means", "quats", "scales", "sh0"} <= set(content)


@splat_reader
def read_sog_stage(path: Path) -> Stage[Gaussians]:
    """Read a .sog file, or the folder of a meta.json, with progress.

    Sizes of pictures are checked against the number of splats before they are unpacked.
    ``GagaError`` with one sentence when something is missing or damaged.
    """
    path = path / META if path.is_dir() else path
    try:
        if path.name == META:
            return (yield from _decoded(_opened(path, lambda name: _of_folder(path, name))))
        with open_file(path) as file, zipfile.ZipFile(file) as archive:
            return (yield from _decoded(_opened(path, lambda name: _of_zip(archive, name))))
    # The last two are zipfile's words for an unknown compression and for a password.
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
        raise damaged(path.name) from error
    except (ValueError, KeyError, TypeError, IndexError, OverflowError, SyntaxError) as error:
        raise GagaError(f"{path.name} is not a valid SOG ({error}). Export it again.") from error


def _opened(path: Path, load: Callable[[str], bytes]) -> _Sog:
    meta = decode_json(load(META), dict[str, Any], path.name, "Export it again.")
    version = meta.get("version", 1)
    if version not in (1, 2):
        raise GagaError(f"{path.name} is SOG version {version}; gaga-studio reads 1 and 2.")
    n = meta["means"]["shape"][0] if version == 1 else meta["count"]
    if isinstance(n, bool) or not isinstance(n, int) or not 0 < n <= _MOST_SIDE**2:
        raise ValueError(f"{n} splats")
    stored = size_of_parts(path) if path.name == META else path.stat().st_size
    return _Sog(path, n, version, meta, load, stored)


def size_of_parts(meta: Path) -> int:
    """Bytes of the files of a SOG in a folder."""
    return sum(file.stat().st_size for file in meta.parent.iterdir() if file.is_file())


def _of_folder(meta: Path, name: str) -> bytes:
    if Path(name).name != name:
        raise ValueError(f"file name {name!r}")
    with open_file(file_inside(meta, name)) as file:
        return file.read()


def _of_zip(archive: zipfile.ZipFile, name: str) -> bytes:
    info = archive.getinfo(name)
    if info.file_size > _ZIP_RATIO * info.compress_size + _MOST_META:
        raise ValueError(f"{name} unpacks to {info.file_size:,} bytes")
    return archive.read(info)


def _decoded(sog: _Sog) -> Stage[Gaussians]:
    n, is_antialiased = sog.n, sog.meta.get("model") == "antialiased"
    steps = 4 + ("shN" in sog.meta)
    yield reading(sog.path, 0, n)
    palette = _palette(sog) if "shN" in sog.meta else np.zeros((1, 0, 3), np.float32)
    room = n, 1 + palette.shape[1], n * _PICTURE_BYTES, sog.n_stored
    out = room_for(sog.path, *room)  # before a picture is unpacked
    low, high = sog.picture("means", 0), sog.picture("means", 1)
    lows, highs = (sog.numbers("means", name, 3) for name in ("mins", "maxs"))
    for part in parts_of(n):
        words = low[part, :3].astype(np.float32) + high[part, :3].astype(np.float32) * 256
        logs = lows + (highs - lows) * (words / np.float32(65535))
        # Beyond what a float32 takes it is out of range already.
        out.means[part] = np.sign(logs) * np.expm1(np.minimum(np.abs(logs), _MOST_LOG))
    del low, high
    yield reading(sog.path, n // steps, n)
    pixels = sog.picture("quats", 0)
    for part in parts_of(n):
        out.quats[part] = _quats(pixels[part])
    yield reading(sog.path, 2 * n // steps, n)
    pixels = sog.picture("scales", 0)
    _fill(out.log_scales, sog, "scales", pixels)
    yield reading(sog.path, 3 * n // steps, n)
    pixels = sog.picture("sh0", 0)
    _fill(out.sh[:, 0], sog, "sh0", pixels)
    if sog.version == 2:
        out.logit_opacities[:] = logits_of_bytes(pixels[:n, 3])
    else:
        least, most = (sog.numbers("sh0", name, 4)[3] for name in ("mins", "maxs"))
        for part in parts_of(n):
            shares = pixels[part, 3] / np.float32(255)
            out.logit_opacities[part] = least + (most - least) * shares
    if "shN" in sog.meta:
        pixels = sog.picture("shN", 1)
        for part in parts_of(n):
            yield reading(sog.path, 4 * n // steps, n)
            labels = pixels[part, 0].astype(np.int64) + pixels[part, 1].astype(np.int64) * 256
            out.sh[part, 1:] = palette[np.minimum(labels, len(palette) - 1)]
    out = replace(out, comments=("antialiased 1",)) if is_antialiased else out
    out = out.with_metres(sog.meta.get("unit") == METRE)  # ours, as is up
    match sog.meta.get("up"):
        case [float() | int(), float() | int(), float() | int()] as up:
            return out.with_up(up)
    return out


def _quats(pixels: UInt8Array) -> FloatArray:
    three = (pixels[:, :3] / np.float32(255) * 2 - 1) * np.float32(np.sqrt(0.5))
    quats = quats_of_three(np.maximum(pixels[:, 3], 252) - 252, three)
    quats[pixels[:, 3] < 252] = (1, 0, 0, 0)
    return quats


def _fill(column: FloatArray, sog: _Sog, name: str, pixels: UInt8Array) -> None:
    """Fill ``column`` (N, 3) with what the first three channels of ``pixels`` (P, 4) stand for."""
    if sog.version == 2:
        table = sog.numbers(name, "codebook", 256)
    else:
        low, high = (sog.numbers(name, end, 3)[:3] for end in ("mins", "maxs"))
    for part in parts_of(len(column)):
        rgb = pixels[part, :3]
        column[part] = table[rgb] if sog.version == 2 else low + (high - low) * (rgb / 255)


def _palette(sog: _Sog) -> FloatArray:
    """SH (E, S - 1, 3) of degree 1 and up that splats choose from; the last one is zeros: what a
    label beyond the palette means."""
    pixels = sog.image("shN", 0, _PER_ROW * 15 * 1024 + _SLACK)
    height, width = pixels.shape[:2]
    n_rest = {_PER_ROW * k: k for k in _COEFFICIENTS.values()}[width]
    if sog.version == 2:
        if _COEFFICIENTS[cast(int, sog.part("shN")["bands"])] != n_rest:
            raise ValueError("shN has another width than its bands")
        values = sog.numbers("shN", "codebook", 256)[pixels[:, :, :3]]
        count = cast(int, sog.part("shN")["count"])
    else:
        low, high = (sog.numbers("shN", name, 1)[0] for name in ("mins", "maxs"))
        values = (low + (high - low) * (pixels[:, :, :3] / np.float32(255))).astype(np.float32)
        count = height * _PER_ROW
    entries = values.reshape(height * _PER_ROW, n_rest, 3)[:count]
    return np.concatenate([entries, np.zeros((1, n_rest, 3), np.float32)])


# --- writing


@splat_writer
def write_sog_stage(path: Path, gaussians: Gaussians) -> Stage[None]:
    """Write a .sog, or with a path that ends in meta.json the folder around it, with progress.

    Whole or not at all. Raises ``GagaError`` when the place cannot be written.
    """
    path, n, n_files = Path(path), len(gaussians), 6 + 2 * bool(gaussians.sh_degree)
    if path.name != META:
        with atomic_write(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
            for done, (name, content) in enumerate(_files(gaussians)):
                yield writing(path, n * done // n_files, n)
                # A zip holds the time of its parts: the same scene gives the same bytes.
                archive.writestr(zipfile.ZipInfo(name), content)
            yield writing(path, n, n)
        return
    with staging_folder(path.parent) as staging:
        names = []
        for done, (name, content) in enumerate(_files(gaussians)):
            yield writing(path, n * done // n_files, n)
            (staging / name).write_bytes(content)
            names.append(name)
        yield writing(path, n, n)
        publish_all(staging, names, path.parent)


def _files(gaussians: Gaussians) -> Iterator[tuple[str, bytes]]:
    """Names and contents of the files; meta.json, which tells of the others, comes last."""
    n = len(gaussians)
    if n > _MOST * _MOST:
        raise GagaError(f"{n:,} splats do not fit into a SOG. Export objects.")
    words, low, high = log_words(gaussians.means)
    yield "means_l.webp", _webp((words & 255).astype(np.uint8))
    yield "means_u.webp", _webp((words >> 8).astype(np.uint8))
    largest, parts = quat_bytes(gaussians.quats)
    yield "quats.webp", _webp(parts, (252 + largest).astype(np.uint8))
    sizes = table_of(gaussians.log_scales)
    yield "scales.webp", _webp(nearest(sizes, gaussians.log_scales))
    colors = table_of(gaussians.sh[:, 0])
    alpha = bytes_of_logits(gaussians.logit_opacities)
    yield "sh0.webp", _webp(nearest(colors, gaussians.sh[:, 0]), alpha)
    meta: dict[str, object] = {
        "version": 2,
        "asset": {"generator": "gaga-studio"},
        "count": n,
        **({"model": "antialiased"} if gaussians.is_antialiased else {}),
        **({"up": up.tolist()} if (up := gaussians.up) is not None else {}),
        **({"unit": METRE} if gaussians.is_metric else {}),
        "means": {
            "mins": low.tolist(),
            "maxs": high.tolist(),
            "files": ["means_l.webp", "means_u.webp"],
        },
        "scales": {"codebook": sizes.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": colors.tolist(), "files": ["sh0.webp"]},
    }
    degree = min(gaussians.sh_degree, MOST_DEGREE)
    if degree:
        rest = gaussians.sh[:, 1 : (degree + 1) ** 2]
        entries, labels = palette_of(rest)
        table = table_of(entries)
        yield "shN_centroids.webp", _webp_of(_rows(nearest(table, entries)))
        pixels = np.stack([labels & 255, labels >> 8, np.zeros_like(labels)], axis=1)
        yield "shN_labels.webp", _webp(pixels.astype(np.uint8))
        meta["shN"] = {
            "count": len(entries),
            "bands": degree,
            "codebook": table.tolist(),
            "files": ["shN_centroids.webp", "shN_labels.webp"],
        }
    yield META, json.dumps(meta).encode()


def _webp(rgb: UInt8Array, alpha: UInt8Array | None = None) -> bytes:
    """A lossless picture with a pixel a splat: (N, 3) and (N,)."""
    n = len(rgb)
    width = -(-int(np.ceil(np.sqrt(n))) // 4) * 4
    pixels = np.zeros((-(-n // width), width, 4), np.uint8)
    pixels[..., 3] = 255
    flat = pixels.reshape(-1, 4)
    flat[:n, :3] = rgb
    if alpha is not None:
        flat[:n, 3] = alpha
    return _webp_of(pixels)


def _webp_of(pixels: UInt8Array) -> bytes:
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "WEBP", lossless=True, exact=True, quality=75, method=3)
    return out.getvalue()


def _rows(codes: UInt8Array) -> UInt8Array:
    """Palette entries (E, S - 1, 3) as a picture of 64 entries a row."""
    n, n_rest = codes.shape[:2]
    pixels = np.zeros((-(-n // _PER_ROW) * _PER_ROW, n_rest, 4), np.uint8)
    pixels[..., 3] = 255
    pixels[:n, :, :3] = codes
    return pixels.reshape(-1, _PER_ROW * n_rest, 4)


# --- streamed SOG


class Bound(msgspec.Struct, frozen=True):
    """A box, scene units."""

    min: Vector
    max: Vector


class Range(msgspec.Struct, frozen=True):
    """Splats of a chunk."""

    file: _Index  # place in `LodMeta.filenames`
    offset: _Index
    count: _Index


class Node(msgspec.Struct, frozen=True, omit_defaults=True):
    """A box of the tree: divided, or with splats at some levels of detail."""

    bound: Bound
    children: "list[Node]" = []
    lods: dict[str, Range] = {}


class LodMeta(msgspec.Struct, frozen=True, omit_defaults=True):
    """Content of lod-meta.json."""

    lodLevels: _Index  # noqa: N815  as the format names it
    filenames: list[str]
    tree: Node
    version: int = 1
    asset: dict[str, str] = {}
    count: _Index = 0  # of all levels
    counts: list[_Index] = []  # of each level
    environment: str = ""


def is_streamed_sog(path: Path) -> bool:
    """Whether ``path`` is a lod-meta.json, by its name."""
    return path.name == LOD_META and path.is_file()


def read_streamed_sog_stage(path: Path) -> Stage[Gaussians]:
    """Read the finest level of every leaf, and the environment, with progress.

    ``GagaError`` with one sentence when something is missing or damaged.
    """
    path = Path(path)
    meta = read_foreign_json(path, LodMeta, most_bytes=_MOST_LOD_META)
    if meta.version != 1:
        raise GagaError(f"{path} is version {meta.version} of streamed SOG; only 1 can be read.")
    wanted: dict[int, list[Range]] = {}
    for leaf in _leaves(meta.tree, path, 0):
        if not leaf.lods:
            continue
        finest = leaf.lods[min(leaf.lods, key=_level)]
        if finest.file >= len(meta.filenames):
            raise GagaError(f"{path} names chunk {finest.file}, which it does not list.")
        wanted.setdefault(finest.file, []).append(finest)
    pieces: list[Gaussians] = []
    n = n_stored = 0
    names = [(meta.filenames[file], parts) for file, parts in sorted(wanted.items())]
    if len({name for name, _ in names}) < len(names):
        raise GagaError(f"{path} lists a chunk twice. Export it again.")
    if meta.environment:
        names.append((meta.environment, []))
    if not names:
        raise GagaError(f"{path} names no splats. Export it again.")
    for done, (name, parts) in enumerate(names):
        place = chunk_path(path, name)
        begin, end = done / len(names), (done + 1) / len(names)
        chunk = yield from portion(read_sog_stage(place), begin, end, READS)
        n_stored += size_of_parts(place)
        n_asked = sum(part.count for part in parts)  # at one level none is asked for twice
        if n_asked > len(chunk) or any(part.offset + part.count > len(chunk) for part in parts):
            raise GagaError(f"{name} has fewer splats than {path} says. Export it again.")
        rows = [np.arange(part.offset, part.offset + part.count) for part in parts]
        pieces.append(chunk.take(np.concatenate(rows)) if rows else chunk)
        n += len(pieces[-1])  # twice: they are joined at the end
        n_bytes = 2 * n * row_bytes(chunk.sh.shape[1])
        check_memory(path, n_bytes, f"{n:,} splats and more", n_stored)
    yield Progress(READS, len(names), len(names))
    whole = joined_splats(pieces, path, n_stored)
    return replace(whole, comments=pieces[0].comments)


def _leaves(node: Node, path: Path, depth: int) -> Iterator[Node]:
    if depth > _MOST_DEPTH:
        raise GagaError(f"{path} is damaged: its tree is deeper than {_MOST_DEPTH} levels.")
    if node.lods or not node.children:
        yield node
    for child in node.children:
        yield from _leaves(child, path, depth + 1)


def _level(name: str) -> int:
    if not name.isdecimal() or len(name) > 4:
        raise GagaError(f"lod-meta.json is damaged: {name[:20]!r} is no level of detail.")
    return int(name)


def chunk_path(path: Path, name: str) -> Path:
    """The meta.json of a chunk; ``GagaError`` when it leads out of the folder."""
    parts = PurePosixPath(name)
    inside = name and not parts.is_absolute() and ".." not in parts.parts and "\\" not in name
    if not inside or parts.name != META:
        raise GagaError(f"{path} names {name!r}, which is no {META} in its folder.")
    return file_inside(path, name)
