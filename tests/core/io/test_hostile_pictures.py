"""Pictures made to harm: read rightly or refused in one sentence, before they take memory."""

import ast
import os
import re
import struct
import subprocess
import sys
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from gaga_core.errors import GagaError
from gaga_core.io import files
from gaga_core.io.images import IMAGE_SUFFIXES, RAW_SUFFIXES, image_header, open_image, read_rgb
from gaga_core.io.masks.label_maps import read_further_labels, read_labels
from gaga_core.io.masks.other_programs import recognise
from gaga_core.placing.photos import Photo, PhotoSet, check_prepared, exif_focal

ROOT = Path(__file__).parents[3]
READERS: dict[str, Callable[[Path], object]] = {
    "photo": read_rgb,
    "small": lambda path: read_rgb(path, 64),
    "label map": read_labels,
    "further maps": read_further_labels,
    "masks": recognise,
    "focal": lambda path: exif_focal(path, 100, 100),
}
Image.init()
KINDS = sorted(Image.SAVE)
MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "CMYK", "YCbCr", "LAB", "I", "I;16", "F")
SIDE = 24
BASE = np.indices((SIDE, SIDE)).sum(axis=0).astype(np.uint8) * 4


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width: int, height: int, bits: int = 8, color: int = 0, chunks: bytes = b"") -> bytes:
    """A PNG without pixels, of a few bytes."""
    header = struct.pack(">IIBBBBB", width, height, bits, color, 0, 0, 0)
    content = chunk(b"IHDR", header) + chunks + chunk(b"IDAT", zlib.compress(b""))
    return b"\x89PNG\r\n\x1a\n" + content + chunk(b"IEND", b"")


def in_a_process(code: str, *arguments: object, **environment: str) -> list[str]:
    """Lines of standard output and error of Python ``code``."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    env = os.environ | {"PYTHONPATH": str(ROOT)} | environment
    done = subprocess.run(
        command, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=True
    )
    return done.stdout.splitlines()


def test_pictures_are_opened_in_one_place() -> None:
    readers = ("imageio", "cv2", "skimage.io", "torchvision", "tifffile", "matplotlib", "OpenEXR")
    named = re.compile(rf"\b(Image|PIL|{'|'.join(r.partition('.')[0] for r in readers)})\b")
    opened, imported = [], []
    for path in (p for part in ("gaga_core", "app", "tools") for p in (ROOT / part).rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if named.search(text) is None:
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Attribute) and node.attr == "open":
                owner = ast.unparse(node.value)
                opened += [path.relative_to(ROOT)] if owner.split(".")[-1] == "Image" else []
            names = [alias.name for alias in getattr(node, "names", ()) if hasattr(alias, "name")]
            if isinstance(node, ast.ImportFrom):
                whole = [f"{node.module}.{name}" for name in names]
                opened += [path.relative_to(ROOT)] if "PIL.Image.open" in whole else []
                names = whole
            if isinstance(node, ast.Import | ast.ImportFrom):
                imported += [
                    (path.relative_to(ROOT), n)
                    for n in names
                    if f"{n}.".startswith(tuple(f"{r}." for r in readers))
                ]
    assert opened == [Path("gaga_core/io/images.py")]
    assert imported == [(Path("gaga_core/io/depth_maps.py"), "OpenEXR")]  # after its header


@pytest.mark.parametrize("kind", KINDS)
def test_what_any_encoder_writes_is_read_rightly_or_refused(kind: str, tmp_path: Path) -> None:
    """Under each suffix of ours; a lossy format blurs dots."""
    for mode in MODES:
        plain = Image.fromarray(BASE)
        image = plain if mode == "L" else plain.convert("RGB").convert(mode.replace("I;16", "I"))
        image = image.convert("I;16") if mode == "I;16" else image
        try:
            image.save(tmp_path / "encoded", format=kind)
        except (OSError, ValueError, KeyError, AttributeError, TypeError, RuntimeError):
            continue  # not a mode of this encoder
        for suffix in IMAGE_SUFFIXES:
            path = (tmp_path / "encoded").replace(tmp_path / f"{mode.replace(';', '')}{suffix}")
            for name, read in READERS.items():
                try:
                    found = read(path)
                except GagaError:
                    continue
                if name == "photo" and suffix not in RAW_SUFFIXES:  # these are made, not read
                    assert isinstance(found, np.ndarray)
                    wanted = plain if mode[0] in "IF" else image
                    apart = np.abs(found.astype(int) - np.asarray(wanted.convert("RGB"))).mean()
                    assert apart < 16, (mode, suffix)
            path.replace(tmp_path / "encoded")


@pytest.mark.parametrize("suffix", IMAGE_SUFFIXES)
def test_postscript_is_never_executed(suffix: str, tmp_path: Path) -> None:
    """The program that Pillow gives it to lies first on the path here, and leaves a mark."""
    (tmp_path / "gs").write_text(f"#!/bin/sh\ntouch {tmp_path}/executed\n")
    (tmp_path / "gs").chmod(0o755)
    photo = tmp_path / f"a{suffix}"
    photo.write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\nshowpage\n")
    code = (
        "import sys; from pathlib import Path; from gaga_core.errors import GagaError\n"
        "from tests.core.io.test_hostile_pictures import READERS\n"
        "for read in READERS.values():\n"
        "    try: read(Path(sys.argv[1]))\n"
        "    except GagaError as error: print(error)\n"
    )
    path = f"{tmp_path}{os.pathsep}{os.environ['PATH']}"
    said = in_a_process(code, photo, PATH=path)
    assert all("not a picture" in line or "JPEG, which blurs" in line for line in said)
    assert len(said) >= 4
    assert not (tmp_path / "executed").exists()


LARGE = {
    "one column": png(1, 178_000_000),
    "one row": png(178_000_000, 1, color=2),
    "label map in colors": png(13_300, 13_300, color=2),
    "more than Pillow reads": png(100_000, 100_000),
    "largest": png(2**31 - 1, 2**31 - 1),
}


@pytest.mark.parametrize("name", LARGE)
@pytest.mark.parametrize("reader", ["photo", "label map"])
def test_large_pictures_in_small_files_are_refused_unread(
    name: str, reader: str, tmp_path: Path
) -> None:
    (tmp_path / "a.png").write_bytes(LARGE[name])
    with warnings.catch_warnings(record=True) as told:
        warnings.filterwarnings("ignore", module=r"PIL\.")  # pytest undoes that of the package
        with pytest.raises(GagaError, match=r"reading it would take|megapixels"):
            READERS[reader](tmp_path / "a.png")
    assert not told


def test_nothing_of_pillow_reaches_the_terminal(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(png(12_000, 12_000))
    code = (
        "import sys; from pathlib import Path; from gaga_core.io.images import image_header\n"
        "with image_header(Path(sys.argv[1])) as image: print(image.size)\n"
    )
    assert in_a_process(code, tmp_path / "a.png") == ["(12000, 12000)"]


@pytest.mark.parametrize("size", [(14_204, 10_652), (10_652, 14_204)])
def test_photos_of_the_largest_cameras_are_let_through(
    size: tuple[int, int], tmp_path: Path
) -> None:
    (tmp_path / "a.png").write_bytes(png(*size, color=2))
    warnings.filterwarnings("ignore", module=r"PIL\.")  # pytest undoes that of the package
    with image_header(tmp_path / "a.png", per_pixel=3) as image:  # as `read_rgb` opens it
        assert image.size == size


def test_further_maps_count_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Thirty maps in chunks, each small enough alone."""
    monkeypatch.setattr(files, "_ALWAYS_GRANTED", 64 << 20)
    whole = zlib.compress(bytes(1001 * 1000))
    header = struct.pack(">IIBBBBB", 1000, 1000, 8, 0, 0, 0, 0)
    inner = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", whole)
    inner += chunk(b"IEND", b"")
    (tmp_path / "a.png").write_bytes(png(1, 1, chunks=30 * chunk(b"gaLV", inner)))
    with pytest.raises(GagaError, match="reading it would take"):
        read_further_labels(tmp_path / "a.png")
    content = PngInfo()
    content.add(b"gaLV", inner)
    Image.new("L", (2, 2)).save(tmp_path / "b.png", pnginfo=content)
    assert [labels.shape for labels in read_further_labels(tmp_path / "b.png")] == [(1000, 1000)]


_PEAKS = """
import sys; from pathlib import Path
from gaga_core.io.images import _bytes_held, _bytes_to_decode, image_header, read_rgb
from gaga_core.io.masks.label_maps import read_labels
def bytes_of(what):
    status = Path("/proc/self/status").read_text()
    return 1024 * next(int(line.split()[1]) for line in status.splitlines() if what in line)
path = Path(sys.argv[1])
for read, n_of in ((read_rgb, 3), (read_labels, 4)):
    with image_header(path, per_pixel=n_of) as image:
        n = image.width * image.height
        taken = _bytes_held(image) + max(_bytes_to_decode(image), n_of * n)
    Path("/proc/self/clear_refs").write_text("5")  # the peak counts from here: proc(5)
    before = bytes_of("VmRSS")
    read(path)
    print((bytes_of("VmHWM") - before) / taken)
"""


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="no peaks of memory here")
@pytest.mark.parametrize(
    "kind", ["rgb.png", "deep.png", "turned.jpg", "progressive.jpg", "w.webp", "z.tif"]
)
def test_reading_takes_no_more_memory_than_was_checked(kind: str, tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    image = Image.new("I;16" if kind == "deep.png" else "RGB", (6000, 4000), 7)
    options: dict[str, dict[str, Any]] = {
        "turned.jpg": {"exif": exif},
        "progressive.jpg": {"progressive": True, "subsampling": 0},
        "w.webp": {"method": 0},
        "z.tif": {"compression": "tiff_deflate"},
    }
    image.save(tmp_path / kind, **options.get(kind, {}))
    shares = in_a_process(_PEAKS, tmp_path / kind)
    assert len(shares) == 2
    for share in shares:
        assert 0.2 < float(share) < 1.25, shares  # blocks that are converted come on top


def test_animated_and_further_pictures_are_read_as_their_first(tmp_path: Path) -> None:
    pictures = [Image.fromarray(BASE).convert("RGB").rotate(90 * i) for i in range(3)]
    kinds: dict[str, dict[str, Any]] = {
        "a.webp": {"lossless": True},
        "a.png": {},
        "a.tif": {"compression": "tiff_lzw"},
        "mpo.jpg": {"format": "MPO", "quality": 100, "subsampling": 0},
    }
    for name, options in kinds.items():
        pictures[0].save(tmp_path / name, save_all=True, append_images=pictures[1:], **options)
        found = read_rgb(tmp_path / name).astype(int)
        assert np.abs(found - np.asarray(pictures[0])).max() <= 8 * (name == "mpo.jpg")


def test_deep_and_odd_values_are_read(tmp_path: Path) -> None:
    deep = np.linspace(0, 65535, 400).astype(np.uint16).reshape(20, 20)
    Image.fromarray(deep).save(tmp_path / "a.png")
    Image.frombytes("I;16B", (20, 20), deep.astype(">u2").tobytes()).save(tmp_path / "a.tif")
    assert np.array_equal(
        read_rgb(tmp_path / "a.png")[..., 0], (deep / 65535 * 255).astype(np.uint8)
    )
    assert np.array_equal(read_rgb(tmp_path / "a.tif"), read_rgb(tmp_path / "a.png"))
    assert np.array_equal(read_labels(tmp_path / "a.tif"), deep)
    assert read_rgb(tmp_path / "a.png", 10).shape == (10, 10, 3)
    odd = np.array([[np.nan, np.inf, -np.inf, 100]], np.float32)
    Image.fromarray(odd).save(tmp_path / "odd.tif")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_rgb(tmp_path / "odd.tif")[0, :, 0].tolist() == [0, 255, 0, 0]


def test_pipes_folders_and_links_to_nowhere_are_sentences(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "link.png").symlink_to(tmp_path / "nowhere.png")
    for name in ("pipe", "folder", "link"):
        with pytest.raises(GagaError, match=r"regular file|folder|does not exist"):
            open_image(tmp_path / f"{name}.png")


@pytest.mark.parametrize("name", ["a.exr", "../a.jpg", "b.jpg", "link.jpg", "/a.jpg"])
def test_photos_of_a_stopped_run_are_looked_at_again(name: str, tmp_path: Path) -> None:
    """COLMAP opens them itself."""
    (tmp_path / "photos").mkdir()
    Image.new("RGB", (40, 40)).save(tmp_path / "photos" / "a.jpg")
    Image.new("RGB", (40, 40)).save(tmp_path / "photos" / "b.jpg", format="TIFF")
    for copy in (tmp_path / "a.jpg", tmp_path / "photos" / "a.exr"):
        Image.new("RGB", (40, 40)).save(copy, format="JPEG")
    (tmp_path / "photos" / "link.jpg").symlink_to(tmp_path / "a.jpg")
    check_prepared(PhotoSet((Photo("a.jpg", "a.jpg", 40, 40),)), tmp_path)
    with pytest.raises(GagaError, match="was not made here"):
        check_prepared(PhotoSet((Photo(name, "a.jpg", 40, 40),)), tmp_path)
