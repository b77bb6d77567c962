"""Mask2Former-like models: preparation, queries to masks, every family from a folder."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from gaga_core.arrays import UInt8Array
from gaga_core.errors import GagaError
from gaga_core.progress import run_stage
from gaga_core.segmentation.base import FlattenConfig, Picture
from gaga_core.segmentation.choose import ProviderSettings, provider_named
from gaga_core.segmentation.settings import UniversalConfig
from gaga_core.segmentation.universal import (
    Preparation,
    Queries,
    entity_masks,
    panoptic_masks,
    prepared_size,
    read_preparation,
)
from tests.core.segmentation.conftest import NO_TRANSFORMERS, UNIVERSAL_KINDS

pytest.importorskip("transformers", reason=NO_TRANSFORMERS)

Folder = Callable[[str], Path]


@pytest.fixture(scope="session")
def small_folder(model_folder: Folder) -> Folder:
    """The same with a preprocessor_config.json for small pictures: quicker."""

    def folder(kind: str) -> Path:
        path = model_folder(kind)
        text = json.dumps({"size": {"shortest_edge": 64, "longest_edge": 96}, "size_divisor": 32})
        (path / "preprocessor_config.json").write_text(text)
        return path

    return folder


@pytest.mark.parametrize("kind", UNIVERSAL_KINDS)
@pytest.mark.parametrize("way", ["entity", "panoptic"])
def test_every_family_makes_label_maps(
    kind: str, way: str, small_folder: Folder, photo: UInt8Array
) -> None:
    config = UniversalConfig(kind=way, min_score=0.0, min_visible=0.0)  # type: ignore[arg-type]
    settings = ProviderSettings(universal=config, flatten=FlattenConfig(0.0, 0.0), device="cpu")
    provider = provider_named("tiny", weights=small_folder(kind), settings=settings)
    labels = run_stage(provider.label_map(Picture(photo)))
    assert labels.shape == photo.shape[:2]
    assert labels.dtype == np.int32
    n = int(labels.max())
    assert n >= 1
    assert set(np.unique(labels)) <= set(range(n + 1))
    np.testing.assert_array_equal(run_stage(provider.label_map(Picture(photo))), labels)
    stage = provider.label_map(Picture(photo))
    next(stage)
    stage.close()
    assert "torchvision" not in sys.modules


def _queries(masks: list[tuple[slice, slice]], scores: list[float]) -> Queries:
    """Queries with a mask each, on a picture of 24 x 32 at a quarter of its size."""
    logits = torch.full((len(masks), 6, 8), -6.0)
    for i, (rows, columns) in enumerate(masks):
        logits[i, rows, columns] = 6.0
    share = torch.tensor(scores)[:, None]
    return Queries(torch.cat([share, torch.zeros_like(share)], dim=1), logits)


def test_entities_are_kept_by_score_and_once() -> None:
    left, right = (slice(0, 6), slice(0, 4)), (slice(0, 6), slice(4, 8))
    almost_left = (slice(0, 6), slice(0, 5))
    nothing = (slice(0, 0), slice(0, 0))
    queries = _queries([almost_left, left, right, right, nothing], [0.7, 0.9, 0.4, 0.8, 0.99])
    config = UniversalConfig(min_score=0.5)
    masks = run_stage(entity_masks(queries, 24, 32, config))
    assert masks.scores.tolist() == pytest.approx([0.9, 0.8], abs=0.01)
    assert masks.boxes.tolist() == [[0, 0, 16, 24], [16, 0, 32, 24]]
    both = run_stage(entity_masks(queries, 24, 32, UniversalConfig(max_overlap=0.9)))
    assert both.scores.tolist() == pytest.approx([0.9, 0.8, 0.7], abs=0.01)


def test_each_pixel_goes_to_one_query() -> None:
    whole, patch = (slice(0, 6), slice(0, 8)), (slice(0, 6), slice(6, 8))
    hidden = (slice(0, 6), slice(5, 8))  # wins a third of itself only
    queries = _queries([whole, patch, hidden], [0.6, 0.9, 0.8])
    masks = panoptic_masks(queries, 24, 32, UniversalConfig("panoptic", min_visible=0.5))
    assert masks.scores.tolist() == pytest.approx([0.6, 0.9])
    assert not (masks.mask(0) & masks.mask(1)).any()
    assert masks.boxes[1].tolist() in ([24, 0, 32, 24], [25, 0, 32, 24])
    assert len(panoptic_masks(queries, 24, 32, UniversalConfig("panoptic", min_score=0.95))) == 0


def test_panoptic_as_transformers_does() -> None:
    from types import SimpleNamespace

    from transformers import Mask2FormerImageProcessorPil

    generator = torch.Generator().manual_seed(0)
    classes = torch.randn(1, 60, 5, generator=generator) * 3
    coarse = torch.randn(1, 60, 6, 6, generator=generator) * 4
    logits = torch.nn.functional.interpolate(coarse, (384, 384), mode="bilinear")
    theirs = Mask2FormerImageProcessorPil().post_process_panoptic_segmentation(
        SimpleNamespace(class_queries_logits=classes, masks_queries_logits=logits),
        threshold=0.5,
        overlap_mask_area_threshold=0.0,
        label_ids_to_fuse=set(),
        target_sizes=[(96, 128)],
    )[0]["segmentation"]
    # They leave "no object" out when it is the most likely; here only its probability counts.
    queries = Queries(classes[0].softmax(-1)[:, :-1], logits[0])
    config = UniversalConfig("panoptic", min_score=0.5, min_visible=0.0)
    masks = panoptic_masks(queries, 96, 128, config)
    expected = [np.asarray(theirs == i) for i in np.unique(theirs) if i > 0]
    assert len(masks) == len(expected) >= 3
    for k, mask in enumerate(expected):
        union = (masks.mask(k) | mask).sum()
        assert (masks.mask(k) & mask).sum() > 0.97 * union  # probabilities, not logits, are scaled


@pytest.mark.parametrize("size", [(480, 640), (1080, 1920), (1920, 1080), (100, 1000)])
def test_sizes_as_transformers_prepares_them(size: tuple[int, int]) -> None:
    from transformers import Mask2FormerImageProcessorPil

    image = np.zeros((*size, 3), np.uint8)
    theirs = Mask2FormerImageProcessorPil()(image)["pixel_values"][0].shape[-2:]
    assert prepared_size(*size, Preparation()) == tuple(theirs)


def test_preparations_are_read(tmp_path: Path) -> None:
    assert read_preparation(tmp_path, "mask2former") == Preparation()
    path = tmp_path / "preprocessor_config.json"
    path.write_text('{"size": 640, "max_size": 900, "size_divisibility": 16}')
    assert read_preparation(tmp_path, "maskformer") == Preparation(640, 900, None, 16)
    path.write_text('{"size": {"height": 384, "width": 512}, "image_mean": [0, 0, 0]}')
    fixed = read_preparation(tmp_path, "mask2former")
    assert (fixed.fixed, fixed.mean) == ((384, 512), (0.0, 0.0, 0.0))
    assert prepared_size(100, 900, fixed) == (384, 512)
    square = read_preparation(tmp_path, "eomt", 640)
    assert (square.square, prepared_size(480, 960, square)) == (640, (320, 640))
    for text in ("{", "[]", '{"size": "big"}'):
        path.write_text(text)
        with pytest.raises(GagaError, match="preprocessor_config"):
            read_preparation(tmp_path, "mask2former")
