"""HEIC of phones, raw files of cameras, and pictures of more than 8 bits or four inks."""

import struct
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image, ImageCms

from gaga_core.errors import GagaError
from gaga_core.io.images import image_header, read_rgb
from gaga_core.placing.photos import exif_focal


def _smooth(width: int = 64, height: int = 48) -> np.ndarray:
    v, u = np.mgrid[0:height, 0:width]
    return np.stack([u * 255 // width, v * 255 // height, 0 * u + 90], axis=2).astype(np.uint8)


def test_heic_is_upright_with_its_focal_length(tmp_path: Path) -> None:
    heif = pytest.importorskip("pillow_heif", reason="the extra photos is not installed")
    heif.register_heif_opener()
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6  # to be turned clockwise
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = 26
    path = tmp_path / "IMG_1.HEIC"
    Image.fromarray(_smooth()).save(path, format="HEIF", exif=exif.tobytes(), quality=95)
    picture = read_rgb(path)
    assert picture.shape == (64, 48, 3)
    turned = np.rot90(_smooth(), -1).astype(int)
    assert np.abs(picture.astype(int) - turned).mean() < 4
    assert exif_focal(path, 48, 64) == pytest.approx(26 / np.hypot(36, 24) * np.hypot(48, 64))
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(GagaError, match=r"damaged|not a picture"):
        read_rgb(path)


def test_what_says_that_it_is_a_jpeg_is_not_read_as_heic(tmp_path: Path) -> None:
    """The larger reader opens only what is named so."""
    heif = pytest.importorskip("pillow_heif", reason="the extra photos is not installed")
    heif.register_heif_opener()
    Image.fromarray(_smooth()).save(tmp_path / "a.jpg", format="HEIF")
    with pytest.raises(GagaError, match="not a picture"):
        read_rgb(tmp_path / "a.jpg")


def test_cmyk_is_shown_by_its_profile_and_without_one_by_its_numbers(tmp_path: Path) -> None:
    inks = Image.fromarray(_smooth()).convert("CMYK")
    inks.save(tmp_path / "plain.jpg", quality=95)
    assert np.abs(read_rgb(tmp_path / "plain.jpg").astype(int) - _smooth()).mean() < 6
    inks.save(tmp_path / "bad.tif", icc_profile=b"no profile")
    assert np.array_equal(read_rgb(tmp_path / "bad.tif"), np.asarray(inks.convert("RGB")))
    # A profile of RGB does not fit four inks: it is passed over.
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    inks.save(tmp_path / "other.tif", icc_profile=srgb)
    assert np.array_equal(read_rgb(tmp_path / "other.tif"), np.asarray(inks.convert("RGB")))


def test_sixteen_bits_are_read_by_their_upper_ones(tmp_path: Path) -> None:
    deep = (_smooth().astype(np.uint16) << 8) | 77
    (tmp_path / "deep.tif").write_bytes(_tiff(deep, {}))
    assert np.array_equal(read_rgb(tmp_path / "deep.tif"), _smooth())
    gray = deep[..., 0]
    Image.fromarray(gray).save(tmp_path / "gray.png")
    assert np.abs(read_rgb(tmp_path / "gray.png")[..., 0].astype(int) - _smooth()[..., 0]).max() < 2


def test_a_raw_photo_has_its_white_balance_and_stands_upright(tmp_path: Path) -> None:
    pytest.importorskip("rawpy", reason="the extra photos is not installed")
    sensor = np.full((96, 128, 1), 16000, np.uint16)  # a gray card under light of these channels
    sensor[0::2, 0::2] = 8000  # red
    sensor[1::2, 1::2] = 12000  # blue
    path = tmp_path / "DSC_1.DNG"
    path.write_bytes(_tiff(sensor, _dng(orientation=6, neutral=(0.5, 1.0, 0.75))))
    picture = read_rgb(path)
    assert picture.shape == (128, 96, 3)
    middle = picture[20:-20, 20:-20].reshape(-1, 3).astype(int)
    assert np.ptp(middle.mean(axis=0)) < 12  # gray
    assert middle.mean() > 60
    with image_header(path) as image:
        assert image.getexif().get(ExifTags.Base.Orientation) == 1
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(GagaError, match=r"damaged|not a picture"):
        read_rgb(path)


_Tag = tuple[int, tuple[object, ...]]  # type of TIFF, values


def _dng(orientation: int, neutral: tuple[float, ...]) -> dict[int, _Tag]:
    """Tags of a Bayer sensor (Adobe's DNG specification, version 1.4)."""
    matrix = (1, 0, 0, 0, 1, 0, 0, 0, 1)
    return {
        254: (4, (0,)),
        271: (2, (b"Acme\0",)),
        272: (2, (b"Acme One\0",)),
        262: (3, (32803,)),  # color filter array
        274: (3, (orientation,)),
        33421: (3, (2, 2)),
        33422: (1, (0, 1, 1, 2)),
        50706: (1, (1, 4, 0, 0)),
        50708: (2, (b"Acme One\0",)),
        50717: (4, (65535,)),
        50721: (10, tuple((int(v * 10000), 10000) for v in matrix)),
        50728: (5, tuple((int(v * 10000), 10000) for v in neutral)),
        50778: (3, (21,)),
    }


def _tiff(pixels: np.ndarray, more: dict[int, _Tag]) -> bytes:
    """An uncompressed TIFF of (H, W, C) uint16."""
    height, width, n = pixels.shape
    tags: dict[int, _Tag] = {
        256: (4, (width,)),
        257: (4, (height,)),
        258: (3, (16,) * n),
        259: (3, (1,)),
        262: (3, (2,)),
        273: (4, (0,)),
        277: (3, (n,)),
        278: (4, (height,)),
        279: (4, (pixels.nbytes,)),
        **more,
    }
    codes = {1: "B", 2: "s", 3: "H", 4: "I", 5: "II", 10: "ii"}
    start = 8 + 2 + 12 * len(tags) + 4
    entries, data = BytesIO(), BytesIO()
    for tag in sorted(tags):
        kind, values = tags[tag]
        if kind == 2:
            raw = values[0] if isinstance(values[0], bytes) else b""
            count = len(raw)
        else:
            flat = np.array(values).ravel().tolist()
            raw, count = struct.pack(f"<{len(values) * codes[kind]}", *flat), len(values)
        if tag == 273:
            place = entries.tell() + 8  # filled below
        if len(raw) > 4:
            at = start + data.tell()
            data.write(raw + b"\0" * (len(raw) % 2))
            raw = struct.pack("<I", at)
        entries.write(struct.pack("<HHI", tag, kind, count) + raw.ljust(4, b"\0"))
    table = bytearray(entries.getvalue())
    table[place : place + 4] = struct.pack("<I", start + data.tell())
    head = b"II*\0" + struct.pack("<IH", 8, len(tags))
    return head + bytes(table) + bytes(4) + data.getvalue() + pixels.astype("<u2").tobytes()
