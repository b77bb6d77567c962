"""Depth maps of phone programs, each written as its program does."""

from pathlib import Path, PurePosixPath

import numpy as np
import pytest
from PIL import Image

from gaga_core.arrays import FloatArray
from gaga_core.errors import GagaError
from gaga_core.io.depth_maps import DepthMap, is_map, read_depth

SIZE = (32, 24)


def depth() -> FloatArray:
    """Metres, with holes."""
    found = np.random.default_rng(0).uniform(0.3, 5, SIZE[::-1]).astype(np.float32)
    found[3:6, 4:9] = 0
    return found


def write_lzfse(path: Path, values: np.ndarray) -> Path:
    lzfse = pytest.importorskip("lzfse", reason="the extra depth is not installed")
    path.write_bytes(lzfse.compress(values.tobytes()))
    return path


def write_exr(path: Path, values: FloatArray, channel: str = "R") -> Path:
    openexr = pytest.importorskip("OpenEXR", reason="the extra depth is not installed")
    header = {"compression": openexr.ZIP_COMPRESSION, "type": openexr.scanlineimage}
    with openexr.File(header, {channel: values}) as file:
        file.write(str(path))
    return path


def _written(folder: Path, kind: str) -> DepthMap:
    path = folder / f"7.{kind}"
    if kind == "png":
        Image.fromarray(np.round(depth() * 1000).astype(np.uint16)).save(path)
    elif kind == "tif":
        Image.fromarray(depth()).save(path)
    elif kind == "npy":
        np.save(path, depth())
    elif kind == "exr":
        write_exr(path, depth())
    else:
        write_lzfse(path, depth())
    return DepthMap(path, size=SIZE)


@pytest.mark.parametrize("kind", ["png", "tif", "npy", "exr", "depth"])
def test_depth_of_each_form_is_read_in_metres(tmp_path: Path, kind: str) -> None:
    found = read_depth(_written(tmp_path, kind))
    assert found.dtype == np.float32
    assert np.abs(found - depth()).max() <= (0.000501 if kind == "png" else 0)


@pytest.mark.parametrize("kind", ["png", "npy", "exr", "depth"])
def test_damaged_depth_gets_a_sentence(tmp_path: Path, kind: str) -> None:
    file = _written(tmp_path, kind)
    raw = file.path.read_bytes()
    for content in (raw[: len(raw) // 2], b"", b"x" * 100):
        file.path.write_bytes(content)
        with pytest.raises(GagaError, match=rf"7\.{kind}"):
            read_depth(file)


def test_values_that_are_no_depth_are_not_known(tmp_path: Path) -> None:
    np.save(tmp_path / "0.npy", np.array([[1.0, np.nan, np.inf, -2.0]], np.float32))
    assert read_depth(DepthMap(tmp_path / "0.npy")).tolist() == [[1, 0, 0, 0]]


@pytest.mark.parametrize("kind", ["png", "conf"])
def test_the_lowest_confidence_is_left_out(tmp_path: Path, kind: str) -> None:
    file = _written(tmp_path, "png")
    levels = np.random.default_rng(1).integers(0, 3, SIZE[::-1]).astype(np.uint8)
    path = tmp_path / f"c.{kind}"
    if kind == "png":
        Image.fromarray(levels).save(path)
    else:
        write_lzfse(path, levels)
    found = read_depth(DepthMap(file.path, confidence=path, size=SIZE))
    np.testing.assert_array_equal(found > 0, (levels > 0) & (depth() > 0))
    Image.fromarray(levels[:5]).save(tmp_path / "short.png")
    with pytest.raises(GagaError, match="another size"):
        read_depth(DepthMap(file.path, confidence=tmp_path / "short.png"))


def test_maps_among_photos_are_no_photos() -> None:
    maps = ["depth/0.png", "keyframes/confidence/3.png", "masks/a.png", "depth_00007.png"]
    photos = ["0.png", "images/3.jpg", "depths.png", "a/depth_of_field.png", "conf_a.png"]
    assert [name for name in maps + photos if is_map(PurePosixPath(name))] == maps
