"""Damage that knows the formats: files that are valid but for what one rule changed in them.

`mutate` damages bytes, wherever they are; these rules reach what lies behind a format's checks.
"""

import gzip
import io
import os
import random
import shutil
import struct
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from PIL import Image

from tests.fuzz.mutate import INTERESTING, with_wrong_value

_PICTURES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff")
_COUNTS = (*INTERESTING, -1, -5, 1, 2, 1000, 1 << 20, 1 << 24, 1 << 28, 1 << 40, 1 << 63)


class Evil:
    """Unpickled it makes a folder where none may be made."""

    def __init__(self, outside: Path) -> None:
        self._outside = outside

    def __reduce__(self) -> tuple[object, ...]:
        return os.mkdir, (str(self._outside / "unpickled"),)


# --- JSON: a value anywhere in a document, which may lie in a glTF, a zip archive or an array


def _json_inside(content: bytes) -> tuple[bytes, Callable[[bytes], bytes]] | None:
    """The JSON text of a file, and what makes the file of another text."""
    if content[:1] in (b"{", b"["):
        return content, bytes
    if content[:4] == b"glTF":
        end = 20 + int.from_bytes(content[12:16], "little")
        return content[20:end], lambda text: _glb(text, content[end:])
    for name, part in _unzipped(content).items() if _is_archive(content) else ():
        is_text = name.endswith(".npy") and part[128:129] == b"{"  # as an array of bytes
        if is_text or part[:1] in (b"{", b"["):
            return part[128 * is_text :], partial(_with_text, content, name, is_text)
    return None


def _with_text(content: bytes, name: str, is_array: bool, text: bytes) -> bytes:
    part = _npy(np.frombuffer(text, np.uint8)) if is_array else text
    return _zipped([*(_unzipped(content) | {name: part}).items()])


def _glb(text: bytes, rest: bytes) -> bytes:
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    return head + struct.pack("<I4s", len(text), b"JSON") + text + rest


def _values(content: bytes, rng: random.Random, _: Path) -> bytes:
    text, whole = _json_inside(content) or (content, bytes)
    for _i in range(rng.choice((1, 1, 2))):
        text = with_wrong_value(text, rng)
    return whole(text)


# --- arrays: .npy, and those of an .npz


def _array(raw: bytes) -> Any:
    return np.load(io.BytesIO(raw), allow_pickle=False)


def _npy(array: Any) -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array(out, np.asanyarray(array), allow_pickle=True)
    return out.getvalue()


def _unzipped(content: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _zipped(parts: list[tuple[str, bytes]]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, part in parts:
            archive.writestr(zipfile.ZipInfo(name), part, zipfile.ZIP_DEFLATED)
    return out.getvalue()


_DTYPES = (
    "U8", "S8", "c8", "c16", "?", "f2", "f4", "f8", ">f4", ">i4", "i1", "u1", "i2", "u2", "i4",
    "u4", "i8", "u8", "M8[s]", "m8[s]", "V4", "f16",
)  # fmt: skip
_WRONG = (
    float("nan"), float("inf"), -float("inf"), 1e300, 3.4e38, -1e300, -5, -1, 1 << 30,
    (1 << 31) - 1, -(1 << 31), 1 << 31, (1 << 63) - 1, 0, 1e-310,
)  # fmt: skip
_MOST_TEXT = 10_000_000  # letters of an array: the worker has to make it
_TEXTS = ("", "../../x", "/etc/passwd", "a" * 100_000, "\x1b[31m\u202e\r\n", "\ud800", "\0", "-1")


def _arrays(content: bytes, rng: random.Random, outside: Path) -> bytes:
    if content[:2] != b"PK":
        return _npy(_wrong_array(_array(content), rng, outside))
    parts = _unzipped(content)
    for _ in range(rng.choice((1, 1, 2))):
        name = rng.choice([*parts])
        if parts[name][:6] == np.lib.format.MAGIC_PREFIX and b"'|O'" not in parts[name][:128]:
            parts[name] = _npy(_wrong_array(_array(parts[name]), rng, outside))
    return _zipped([*parts.items()])


def _wrong_array(array: Any, rng: random.Random, outside: Path) -> Any:
    return rng.choice((_other_values, _other_values, _other_shape, _other_dtype))(
        array, rng, outside
    )


def _other_dtype(array: Any, rng: random.Random, outside: Path) -> Any:
    if rng.random() < 0.1:
        return np.array([Evil(outside)] * 3, object)
    dtype = np.dtype(rng.choice(_DTYPES))
    try:
        with np.errstate(all="ignore"):
            return array.astype(dtype)
    except (ValueError, TypeError, OverflowError):  # no such cast: as many of the other kind
        return np.zeros(array.shape, dtype)


def _other_shape(array: Any, rng: random.Random, _: Path) -> Any:
    longer = np.concatenate([np.atleast_1d(array)] * 2)
    ways = (
        lambda: np.zeros((), array.dtype),
        lambda: np.atleast_1d(array)[:0],
        lambda: np.zeros((3, 0), array.dtype),
        lambda: np.zeros((0,) * 3, array.dtype),
        lambda: np.asfortranarray(array.T),
        lambda: longer[: len(longer) // 2 + 1],
        lambda: np.atleast_1d(array)[:-1],
        lambda: longer,
        lambda: array[None],
        lambda: array[..., None],
        lambda: array.reshape(-1),
        lambda: np.zeros((1,) * 32, array.dtype),
        lambda: np.zeros(rng.choice((100_000, 3_000_000)), array.dtype),
    )
    return rng.choice(ways)()


def _other_values(array: Any, rng: random.Random, _: Path) -> Any:
    if array.dtype.kind in "US":
        text = rng.choice(_TEXTS)[: max(_MOST_TEXT // max(array.size, 1), 1)]
        as_bytes = text.encode(errors="surrogatepass")
        return np.full(array.shape, as_bytes if array.dtype.kind == "S" else text)
    if array.dtype.kind not in "fiub":
        return array
    value, array = rng.choice(_WRONG), np.array(array)
    if array.dtype.kind != "f":
        top = np.iinfo(array.dtype).max if array.dtype.kind in "iu" else 1
        if value != value or abs(value) > top or (value < 0 and array.dtype.kind != "i"):
            array = array.astype(np.float64 if isinstance(value, float) else np.int64)
    flat = array.reshape(-1)
    at = slice(None) if rng.random() < 0.4 or not flat.size else rng.randrange(flat.size)
    with np.errstate(all="ignore"):
        flat[at] = min(value, (1 << 63) - 1) if array.dtype.kind in "iu" else value
    return array


# --- entries of archives


def _entries(content: bytes, rng: random.Random, outside: Path) -> bytes:
    parts = [*_unzipped(content).items()]
    at = rng.randrange(len(parts))
    name, part = parts[at]
    names = (
        f"../{name}", str(outside / "unpacked"), "x.npy", rng.choice(parts)[0], "a" * 5000, "\0",
        name.replace(".npy", ""), name.upper(), "\x1b[31m.npy", "",
    )  # fmt: skip
    way = rng.randrange(6)
    if way == 0:
        del parts[at]
    elif way == 1:
        parts.append((name, rng.choice(parts)[1]))
    elif way == 2:
        parts[at] = (rng.choice(names), part)
    elif way == 3:  # much out of little
        parts.append((f"x{name}", bytes(rng.choice((1 << 20, 1 << 26)))))
    elif way == 4:
        parts[at] = (name, rng.choice((b"", part * 2, rng.choice(parts)[1], b"{}", part[:-1])))
    else:
        parts += [(f"{i}.npy", part[:128]) for i in range(rng.choice((100, 3000)))]
    return _zipped(parts)


# --- headers: counts, types and lengths


def _headers(content: bytes, rng: random.Random, _: Path) -> bytes:
    if content[:3] == b"ply":
        return _ply(content, rng)
    if content[:8] == b"\x89PNG\r\n\x1a\n":
        return _png(content, rng)
    if content[:2] == b"\x1f\x8b":
        return _spz(content, rng)
    if content[:2] == b"PK":
        parts = _unzipped(content)
        name = rng.choice([*parts])
        return _zipped([*(parts | {name: _headers(parts[name], rng, _)}).items()])
    if content[:6] == np.lib.format.MAGIC_PREFIX:
        return _npy_head(content, rng)
    return _number(content, rng)


def _number(content: bytes, rng: random.Random) -> bytes:
    """A number of a binary file: in its head, after a four-letter name, or anywhere."""
    starts = [*range(0, min(len(content), 128), 4)]
    starts += [4096 + 4 * i for i in range(16) if len(content) > 4160]  # sections of .ksplat
    named = [i + 4 for i in range(len(content) - 8) if content[i : i + 4].isalpha()][:300]
    anywhere = [rng.randrange(len(content) // 4 + 1) * 4 for _ in range(4)]
    at = rng.choice(rng.choice([some for some in (starts, starts, named, anywhere) if some]))
    order: Literal["big", "little"] = "big" if at in named and rng.random() < 0.5 else "little"
    size = rng.choice((2, 4, 4, 8))
    raw = (rng.choice(_COUNTS) % (1 << 8 * size)).to_bytes(size, order)
    if rng.random() < 0.2:
        raw = struct.pack("<f", rng.choice((float("nan"), float("inf"), 3.4e38, -3.4e38, 1e-40)))
    if rng.random() < 0.1:  # the length of the file itself
        return rng.choice((b"", content[:-1], content + b"\0", content * 3, bytes(32 << 20)))
    return content[:at] + raw + content[at + len(raw) :]


def _ply(content: bytes, rng: random.Random) -> bytes:
    head, end, rows = content.partition(b"end_header\n")
    lines = head.decode("latin-1").splitlines()
    at = rng.randrange(1, len(lines))
    counts = [i for i, line in enumerate(lines) if line.startswith("element")]
    types = ["char", "uchar", "short", "ushort", "int", "uint", "float", "double", "float128", "s"]
    types += [f"list {a} {b}" for a in ("uchar", "int", "float") for b in ("float", "int")]
    properties = [i for i, line in enumerate(lines) if line.startswith("property")]
    way = rng.randrange(9)
    if way in (0, 1) and counts:
        at = rng.choice(counts)
        kind, name, count = (*lines[at].split(), "0", "0")[:3]
        near = [str(int(count) + d) for d in (1, -1)] if count.isdecimal() else []
        value = rng.choice((*map(str, _COUNTS), "9" * 30, "1e3", "nan", "", *near))
        lines[at] = f"{kind} {name} {value}"
    elif way in (2, 3) and properties:
        at = rng.choice(properties)
        lines[at] = f"property {rng.choice(types)} {lines[at].split()[-1]}"
    elif way == 4:
        form = rng.choice(("ascii", "binary_big_endian", "binary_little_endian", "binary"))
        lines[1] = f"format {form} {rng.choice(('1.0', '2.0', ''))}"
    elif way == 5:
        lines.insert(at, lines[rng.randrange(len(lines))])
    elif way == 6:
        del lines[at]
    elif way == 7:  # an element of nothing, or of lists, before or after the others
        more = [f"element {rng.choice(('x', 'vertex', 'chunk'))} {rng.choice(_COUNTS)}"]
        more += [f"property {rng.choice(types)} a"] * rng.randrange(3)
        place = rng.choice((*counts, len(lines)))
        lines[place:place] = more
    else:
        lines.insert(
            at, rng.choice(("comment ", "obj_info ", "property float ")) + rng.choice(_TEXTS)
        )
    text = "\n".join(lines).encode("utf-8", "replace") + b"\n"
    return text + end + rows


def _png_chunk(name: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


def _zeros(n: int) -> bytes:
    """``n`` zero bytes, rounded up to whole MiB, as a zlib stream, without making them."""
    packer, n_blocks = zlib.compressobj(9, zlib.DEFLATED, -15), -(-n // (1 << 20))
    block = packer.compress(bytes(1 << 20)) + packer.flush(zlib.Z_FULL_FLUSH)
    checksum = ((n_blocks << 20) % 65521) << 16 | 1  # Adler-32
    return b"\x78\x01" + block * n_blocks + packer.flush() + struct.pack(">I", checksum)


def _png_of(width: int, height: int, bits: int, kind: int, n_bytes: int | None = None) -> bytes:
    """A black PNG of so many pixels; ``n_bytes`` of them are there (None: all)."""
    channels = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[kind]
    size = height * (1 + (width * bits * channels + 7) // 8) if n_bytes is None else n_bytes
    head = _png_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, 0))
    palette = _png_chunk(b"PLTE", bytes(range(255)) * 3) if kind == 3 else b""
    body = head + palette + _png_chunk(b"IDAT", _zeros(size)) + _png_chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def _png(content: bytes, rng: random.Random) -> bytes:
    way = rng.randrange(6)
    if way < 3:  # the head, with its right checksum
        head = bytearray(content[16:29])
        if way < 2:
            at = rng.choice((0, 4))
            head[at : at + 4] = struct.pack(">I", rng.choice(_COUNTS) % (1 << 32))
        else:
            head[rng.randrange(8, 13)] = rng.choice((0, 1, 2, 3, 4, 6, 8, 16, 255))
        return content[:8] + _png_chunk(b"IHDR", bytes(head)) + content[33:]
    if way == 3:
        sizes = ((13_300, 13_300), (1, 178_000_000), (178_000_000, 1), (9_000, 9_000))
        width, height = rng.choice(sizes)
        bits, kind = rng.choice(((8, 2), (16, 0), (8, 0), (1, 0), (8, 6), (8, 3), (16, 2)))
        return _png_of(width, height, bits, kind, rng.choice((0, None)))
    text = b"a\0\0" + _zeros(rng.choice((1 << 10, 1 << 20, 60 << 20)))
    inner = _png_of(*rng.choice(((20, 30), (9_000, 9_000))), 16, 0)
    chunk = rng.choice((
        _png_chunk(b"zTXt", text), _png_chunk(b"iCCP", text), _png_chunk(b"gaLV", inner),
        _png_chunk(b"gaLV", bytes(1 << 20)), _png_chunk(b"eXIf", bytes(range(256)) * 4),
        _png_chunk(b"tEXt", b"a\0" + bytes(1 << 20)), _png_chunk(b"acTL", bytes(8)),
    ))  # fmt: skip
    return content[:33] + chunk * rng.choice((1, 30)) + content[33:]


def _spz(content: bytes, rng: random.Random) -> bytes:
    raw = bytearray(gzip.decompress(content))
    if rng.random() < 0.2:  # many splats of nothing
        count = rng.choice((1 << 20, 20_000_000))
        raw[8:12] = struct.pack("<I", count)
        return gzip.compress(bytes(raw[:16]), mtime=0) + gzip.compress(bytes(1 << 20), mtime=0) * (
            count * 20 >> 20
        )
    at = rng.choice((0, 4, 8, 8, 8, 12, 13, 14, 15))
    size = 4 if at < 12 else 1
    raw[at : at + size] = (rng.choice(_COUNTS) % (1 << 8 * size)).to_bytes(size, "little")
    return gzip.compress(bytes(raw), mtime=0)


def _npy_head(content: bytes, rng: random.Random) -> bytes:
    n = int.from_bytes(content[8:10], "little")
    shapes = ("()", "(-1,)", "(0,)", "(1099511627776,)", "(4294967296, 4294967296)", "(3.0,)")
    more = ("(True,)", "('a',)", "(1,) * 9", "(9223372036854775807,)", "(0, 1099511627776)")
    kinds = (
        "'|O'",
        "'<U4000000'",
        "'<f4'",
        "[('a', '<f4'), ('b', '|O')]",
        "'V0'",
        "'>i4'",
        "'|b1'",
    )
    shape, kind = rng.choice((*shapes, *more)), rng.choice(("'<f4'", *kinds))
    text = (
        f"{{'descr': {kind}, 'fortran_order': {rng.choice((True, False, 3))}, 'shape': {shape}, }}"
    )
    text = rng.choice((text, text, text, "(" * 200, "{" + text, "__import__('os')"))
    return (
        content[:8] + struct.pack("<H", len(text) + 1) + text.encode() + b"\n" + content[10 + n :]
    )


# --- pictures by every encoder


def _pictures(content: bytes, rng: random.Random, outside: Path) -> bytes:
    way = rng.randrange(10)
    if way == 0:
        return _postscript(outside / "drawn")
    with Image.open(io.BytesIO(content), formats=("PNG", "JPEG", "WEBP", "BMP", "TIFF")) as opened:
        image = opened.convert("RGB")
    if way == 1:
        return _saved(
            Image.fromarray(np.asarray(image.convert("L")).astype(np.uint16) * 257), "PNG"
        )
    if way == 2:
        return _saved(image.convert("CMYK"), rng.choice(("JPEG", "TIFF")))
    if way == 3:
        clear = image.convert("P", palette=Image.Palette.ADAPTIVE)
        return _saved(clear, "PNG", transparency=bytes(range(256)))
    if way == 4:
        exif = Image.Exif()
        exif[0x0112], exif[0x010F] = rng.choice((0, 3, 6, 9, 65535)), "a" * rng.choice((1, 60_000))
        exif.get_ifd(0x8769).update({0x920A: 35.0, 0xA405: 28, 0xA20E: 90.0, 0x9286: b"\xff" * 8})
        raw = bytearray(exif.tobytes())
        for _ in range(rng.randrange(5)):
            raw[rng.randrange(6, min(len(raw), 200))] = rng.randrange(256)
        return _saved(image, rng.choice(("JPEG", "PNG", "WEBP")), exif=bytes(raw))
    if way == 5:
        frames = [image, image.convert("L"), image.resize((3, 5))]
        kind = rng.choice(("GIF", "TIFF", "PNG", "MPO", "WEBP"))
        return _saved(image, kind, save_all=True, append_images=frames)
    Image.init()
    return _saved(image, rng.choice(sorted(Image.SAVE)))


def _saved(image: Image.Image, kind: str, **options: Any) -> bytes:
    """The picture by an encoder of Pillow, in the first mode that it takes."""
    if kind == "PDF":  # it would write the time of day
        options = {"creationDate": time.gmtime(0), "modDate": time.gmtime(0)}
    for mode in (image.mode, "RGB", "L", "1", "P", "RGBA", "F", "I;16", "CMYK"):
        out = io.BytesIO()
        try:
            image.convert(mode).save(out, kind, **options)
        except (OSError, ValueError, LookupError, TypeError, struct.error, RuntimeError):
            options = options if mode == image.mode else {}
            continue
        if out.tell():
            return out.getvalue()
    return kind.encode()


def _postscript(marker: Path) -> bytes:
    """A program that writes a file when it is drawn, and then draws without an end."""
    text = f"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 40 30\n({marker}) (w) file closefile\n"
    return f"{text}{{}} loop\n%%EOF\n".encode()


# --- links and pipes on the way to a file


def linked(victim: Path, opened: Path, outside: Path, rng: random.Random) -> None:
    """Put something else in the place of a file in ``opened``, or of a folder on the way.

    ``opened`` itself may be a link to wherever a person wants, inside of it there may be none.
    """
    step = rng.choice([victim, victim, *(p for p in victim.parents if opened in p.parents)])
    is_folder, aside = step.is_dir(), outside / step.name
    way = rng.choice(
        ("out", "out", "itself", "nothing", "new", "up", "pipe", "device", "other", "empty")
    )
    if way == "out":
        shutil.move(step, aside)
    elif is_folder:
        shutil.rmtree(step)
    else:
        step.unlink()
    goals = {"out": aside, "itself": step, "nothing": opened / "nothing", "up": opened}
    goals |= {"new": outside / "new", "device": Path("/dev/zero")}
    if way in goals:
        step.symlink_to(goals[way])
    elif way == "pipe":
        os.mkfifo(step)
    elif is_folder != (way == "other"):
        step.mkdir()
    else:
        step.touch()


class Rule(NamedTuple):
    """A way to change the content of a file."""

    fits: Callable[[Path, bytes], bool]
    change: Callable[[bytes, random.Random, Path], bytes]  # ``Path``: the folder outside


def _is_archive(content: bytes) -> bool:
    return content[:2] == b"PK" and zipfile.is_zipfile(io.BytesIO(content))


RULES: Mapping[str, Rule] = {
    "values": Rule(lambda _, content: _json_inside(content) is not None, _values),
    "arrays": Rule(
        lambda path, content: path.suffix in (".npz", ".npy") and len(content) > 0, _arrays
    ),
    "entries": Rule(lambda _, content: _is_archive(content), _entries),
    "headers": Rule(lambda _, content: len(content) > 0 and content[:1] not in b"{[", _headers),
    "pictures": Rule(lambda path, _: path.suffix.lower() in _PICTURES, _pictures),
}
LINKS = "links"


def changed(victim: Path, opened: Path, outside: Path, rng: random.Random) -> str:
    """Change the file ``victim`` or the way to it from the folder ``opened``; return the rule.

    ``outside`` is an empty folder that no reader and no writer may change.
    """
    content = victim.read_bytes()
    fitting = [name for name, rule in RULES.items() if rule.fits(victim, content)]
    name = rng.choice([*fitting, *fitting, LINKS])
    if name == LINKS:
        linked(victim, opened, outside, rng)
    else:
        victim.write_bytes(RULES[name].change(content, rng, outside))
    return name


def inventory(folder: Path) -> dict[str, tuple[int, int, bytes]]:
    """All that lies in a folder: mode, time of the last change and content by path."""
    found = {}
    for path in sorted(_walked(folder)):
        state = path.lstat()
        content = path.read_bytes() if path.is_file() and not path.is_symlink() else b""
        found[path.relative_to(folder).as_posix()] = state.st_mode, state.st_mtime_ns, content
    return found


def _walked(folder: Path) -> Iterator[Path]:
    for path in folder.iterdir():
        yield path
        if path.is_dir() and not path.is_symlink():
            yield from _walked(path)
