"""Masks made to harm: imported rightly or refused in one sentence, soon and in little memory."""

import json
import math
import tracemalloc
import warnings
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import BoolArray, LongArray
from gaga_core.errors import GagaError
from gaga_core.io import files, json_file
from gaga_core.io.masks.other_programs import MaskList, recognise
from gaga_core.segmentation.base import scored_masks
from tests.core.io.mask_forms import H, W


def masks_of(path: Path) -> list[BoolArray]:
    """All masks of all pictures of a file."""
    found = [read() for read in recognise(path).views.values()]
    return [mask for one in found if isinstance(one, MaskList) for mask in one.masks]


def coco(path: Path, segmentation: object, height: object = H, width: object = W) -> Path:
    image = {"id": 1, "file_name": "a.jpg", "height": height, "width": width}
    mask = {"image_id": 1, "segmentation": segmentation}
    path.write_text(json.dumps({"images": [image], "annotations": [mask]}))
    return path


def covered(corners: LongArray, height: int, width: int) -> BoolArray:
    """Pixels whose centres lie in a polygon or on its edge; ``corners`` (P, 2) in half pixels.

    In whole numbers, so exact; one pixel against one edge.
    """
    y, x = 2 * np.indices((height, width)) + 1
    inside, on_edge = np.zeros((2, height, width), np.bool_)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        side = (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)
        inside ^= ((y0 <= y) != (y1 <= y)) & ((side > 0) == (y1 > y0)) & (side != 0)
        between = (np.minimum(x0, x1) <= x) & (x <= np.maximum(x0, x1))
        between &= (np.minimum(y0, y1) <= y) & (y <= np.maximum(y0, y1))
        on_edge |= (side == 0) & between
    return inside | on_edge


@pytest.mark.parametrize("seed", range(8))
def test_polygons_cover_the_centres_inside_and_on_the_edge(seed: int, tmp_path: Path) -> None:
    """Any polygon: one that crosses itself, is a line or a point, or leaves the picture."""
    rng = np.random.default_rng(seed)
    for _ in range(60):
        height, width = rng.integers(1, 20, 2).tolist()
        corners = rng.integers(-12, 50, (rng.integers(3, 9), 2))
        if rng.random() < 0.3:
            corners[1:3, 1] = corners[0, 1]  # edges along a row
        path = coco(tmp_path / "a.json", [(corners / 2).ravel().tolist()], height, width)
        (mask,) = masks_of(path)
        assert np.array_equal(mask, covered(corners, height, width)), corners.tolist()


@pytest.mark.parametrize("value", [1e9, -1e9, 1e300, math.nan, math.inf, 10**400])
@pytest.mark.parametrize("place", [0, 1, 4])
def test_corners_out_of_this_world_are_refused(value: float, place: int, tmp_path: Path) -> None:
    polygon: list[float] = [1, 1, 20, 1, 20, 20]
    polygon[place] = value
    with pytest.raises(GagaError, match=r"beyond 65,536 pixels|no list of numbers"):
        masks_of(coco(tmp_path / "a.json", [polygon]))


def test_polygons_of_much_work_are_refused(tmp_path: Path) -> None:
    comb = np.tile([0, 0, 1, 8000], 1000).tolist()
    with pytest.raises(GagaError, match="too many long edges"):
        masks_of(coco(tmp_path / "a.json", [comb], 8000, 8000))
    with pytest.raises(GagaError, match="cover its picture 100 times"):
        masks_of(coco(tmp_path / "a.json", [[0, 0, W, 0, W, H, 0, H]] * 102))
    (mask,) = masks_of(coco(tmp_path / "a.json", [np.tile([3, 4, 5, 6], 100_000).tolist()]))
    assert mask.sum() == 2


@pytest.mark.parametrize(
    ("height", "width"),
    [(10**9, 10**9), (-5, -5), (0, 40), (10**400, 1), (1, 2**28), (16384, 16384)],
)
def test_sizes_too_large_to_be_true_are_refused(height: int, width: int, tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    for segmentation in ([[1, 1, 2, 2, 3, 1]], {"size": [height, width], "counts": [1, 2]}):
        with pytest.raises(GagaError, match=r"pixels|height and width|damaged"):
            masks_of(coco(path, segmentation, height, width))


@pytest.mark.parametrize(
    "counts", [[-1, H * W + 1], [2**62] * 4, [10**400], "\x7f", "oooooooooooo", [1.5]]
)
def test_runs_that_make_no_mask_are_refused(counts: object, tmp_path: Path) -> None:
    with pytest.raises(GagaError):
        masks_of(coco(tmp_path / "a.json", {"size": [H, W], "counts": counts}))


def test_masks_beyond_memory_are_refused(tmp_path: Path) -> None:
    many = [{"segmentation": {"size": [8000, 8000], "counts": [64_000_000]}}] * 1000
    (tmp_path / "a.json").write_text(json.dumps(many))
    with pytest.raises(GagaError, match="too many to be true"):
        masks_of(tmp_path / "a.json")
    whole = np.ones((10_000, 10_000), np.bool_)
    with pytest.raises(GagaError, match="first 22 masks"):
        scored_masks((whole for _ in range(100)), np.ones(100, np.float32), *whole.shape)


STACK = np.ones((2, H, W), np.bool_)
ARRAYS: dict[str, tuple[dict[str, object], str]] = {
    "text scores": ({"masks": STACK, "scores": np.array(["a", "b"])}, "finite numbers"),
    "complex scores": ({"masks": STACK, "scores": np.ones(2, complex)}, "finite numbers"),
    "NaN scores": ({"masks": STACK, "scores": np.array([np.nan, 1])}, "finite numbers"),
    "infinite scores": ({"masks": STACK, "scores": np.array([np.inf, 1])}, "finite numbers"),
    "dates as scores": ({"masks": STACK, "scores": np.zeros(2, "M8[s]")}, "finite numbers"),
    "scores of two sides": ({"masks": STACK, "scores": np.ones((2, 3))}, "2 masks but 6 scores"),
    "text masks": ({"masks": np.full((2, H, W), "a")}, "must be numbers"),
    "complex masks": ({"masks": np.ones((2, H, W), complex)}, "must be numbers"),
    "records": ({"masks": np.zeros((2, H, W), "i4,f4")}, "must be numbers"),
    "objects": ({"masks": np.array([[[None]]])}, "damaged|plain arrays"),
    "four sides": ({"masks": np.ones((2, 3, H, W))}, "must be numbers"),
    "text labels": ({"labels": np.full((H, W), "a")}, "holds no masks"),
    "large labels": ({"labels": np.full((H, W), 2**40)}, "ids above"),
    "unsigned labels": ({"labels": np.full((H, W), 2**64 - 1, np.uint64)}, "ids above"),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_of_wrong_kinds_are_refused(name: str, tmp_path: Path) -> None:
    arrays, said = ARRAYS[name]
    np.savez(tmp_path / "a.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(GagaError, match=said):
        masks_of(tmp_path / "a.npz")


@pytest.mark.parametrize("kind", ["?", "i1", "u1", "<i2", ">u4", "i8", "u8"])
def test_ids_of_any_integers_are_read(kind: str, tmp_path: Path) -> None:
    labels = np.arange(H * W).reshape(H, W).astype(kind)
    np.savez(tmp_path / "a.npz", labels=labels)
    (read,) = recognise(tmp_path / "a.npz").views.values()
    found = read()
    assert isinstance(found, np.ndarray)
    assert found.dtype == np.int32
    assert np.array_equal(found, np.maximum(labels.astype(np.int64), 0))


@pytest.mark.parametrize("item", ["[[]]", "{}", "[],{}", '{"segmentation":[[]]}', "1.5"])
def test_lists_of_masks_that_fill_the_memory_are_refused_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, item: str
) -> None:
    """A byte of text takes up to 34 bytes of values; reading takes no more than was checked."""
    path = tmp_path / "a.json"
    path.write_text(f"[{','.join([item] * 20_000)}]")
    asked: list[float] = []
    with monkeypatch.context() as patched:
        patched.setattr(json_file, "check_memory", lambda _path, n, _what: asked.append(n))
        tracemalloc.start()
        with suppress(GagaError):
            recognise(path)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak <= asked[0]
    monkeypatch.setattr(files, "_ALWAYS_GRANTED", 1 << 10)
    monkeypatch.setattr(files, "machine_memory", lambda: 1 << 20)
    with pytest.raises(GagaError, match="of memory here"):
        recognise(path)


@pytest.mark.parametrize("value", [math.nan, math.inf, -1e300, "nan", "a", None, [1]])
def test_odd_scores_of_lists_are_refused_or_finite(value: object, tmp_path: Path) -> None:
    entry = {"segmentation": {"size": [H, W], "counts": [H * W]}, "score": value}
    (tmp_path / "a.json").write_text(json.dumps([entry]))
    (tmp_path / "m").mkdir()
    try:
        (read,) = recognise(tmp_path / "a.json").views.values()
        found = read()
    except GagaError:
        return
    assert isinstance(found, MaskList)
    assert np.isfinite(found.scores).all()


@pytest.mark.parametrize("score", ["nan", "inf", "-1e999", "", "a", "1,2"])
def test_a_table_of_odd_scores_is_refused(score: str, tmp_path: Path) -> None:
    from gaga_core.io.masks.label_maps import write_labels

    write_labels(tmp_path / "s" / "a" / "0.png", np.ones((H, W), np.int32))
    (tmp_path / "s" / "a" / "metadata.csv").write_text(f"id,predicted_iou\n0,{score}\n")
    (read,) = recognise(tmp_path / "s").views.values()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if score == "1,2":  # a further column
            found = read()
            assert isinstance(found, MaskList)
            assert found.scores == (1.0,)
        else:
            with pytest.raises(GagaError, match="damaged"):
                read()
