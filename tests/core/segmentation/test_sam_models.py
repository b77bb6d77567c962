"""Segment Anything models of transformers: from a folder, offline, without torchvision."""

import json
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gaga_core.arrays import UInt8Array
from gaga_core.errors import GagaError
from gaga_core.progress import Progress, run_stage
from gaga_core.segmentation.base import FlattenConfig, ModelProvider, Picture
from gaga_core.segmentation.choose import ProviderSettings, provider_named
from gaga_core.segmentation.loading import load_folder
from gaga_core.segmentation.sam import fitted, sam_encoder
from gaga_core.segmentation.settings import GeneratorConfig
from tests.core.segmentation.conftest import SAM_KINDS

Folder = Callable[[str], Path]
_OPEN = GeneratorConfig(  # random weights: every mask will do
    points_per_side=4,
    points_per_batch=6,
    pred_iou_thresh=-1e9,
    stability_score_thresh=0.0,
    box_nms_thresh=0.999,
    min_area=0.0,
)


def _provider(folder: Path, generator: GeneratorConfig = _OPEN) -> ModelProvider:
    settings = ProviderSettings(generator=generator, flatten=FlattenConfig(-1e9, 0.0), device="cpu")
    provider = provider_named("tiny", weights=folder, settings=settings)
    assert isinstance(provider, ModelProvider)
    return provider


@pytest.mark.parametrize("kind", SAM_KINDS)
def test_every_family_makes_label_maps(kind: str, model_folder: Folder, photo: UInt8Array) -> None:
    provider = _provider(model_folder(kind))
    steps: list[Progress] = []
    labels = run_stage(provider.label_map(Picture(photo)), steps.append)
    assert labels.shape == photo.shape[:2]
    assert labels.dtype == np.int32
    n = int(labels.max())
    assert n >= 1
    assert set(np.unique(labels)) <= set(range(n + 1))
    assert [s.done for s in steps if s.total][-1] == 16
    np.testing.assert_array_equal(run_stage(provider.label_map(Picture(photo))), labels)
    fresh = _provider(model_folder(kind))
    assert fresh.fingerprint() == provider.fingerprint()
    np.testing.assert_array_equal(run_stage(fresh.label_map(Picture(photo))), labels)
    assert "torchvision" not in sys.modules


@pytest.mark.parametrize("kind", SAM_KINDS)
@pytest.mark.parametrize("crop_layers", [0, 1])
def test_masks_lie_in_the_picture_and_come_best_first(
    kind: str, crop_layers: int, model_folder: Folder, photo: UInt8Array
) -> None:
    tall = np.ascontiguousarray(photo.transpose(1, 0, 2))
    config = replace(_OPEN, crop_layers=crop_layers)
    masks = run_stage(_provider(model_folder(kind), config).masks(Picture(tall)))
    assert (masks.height, masks.width) == (120, 90)
    assert (np.diff(masks.scores) <= 0).all()
    assert masks.boxes.min() >= 0
    assert (masks.boxes[:, 2:] <= (90, 120)).all()
    assert (masks.areas > 0).all()
    assert len(masks) > 0


def test_a_cancel_leaves_the_provider_whole(model_folder: Folder, photo: UInt8Array) -> None:
    provider = _provider(model_folder("sam2"))
    stage = provider.label_map(Picture(photo))
    for _ in range(4):
        next(stage)
    stage.close()
    fresh = run_stage(_provider(model_folder("sam2")).label_map(Picture(photo)))
    np.testing.assert_array_equal(run_stage(provider.label_map(Picture(photo))), fresh)


def test_sizes_are_rounded_as_published() -> None:
    assert fitted(480, 640, 1024) == (768, 1024)
    assert fitted(683, 1024, 1024) == (683, 1024)
    assert fitted(333, 1000, 1024) == fitted(1000, 333, 1024)[::-1] == (341, 1024)
    assert fitted(1, 2000, 1024) == (1, 1024)


@pytest.mark.parametrize(("height", "width"), [(90, 120), (120, 90), (128, 128), (300, 41)])
def test_pictures_are_prepared_as_sam_does(height: int, width: int, model_folder: Folder) -> None:
    """Compared with transformers' own processor, where that needs no torchvision."""
    from transformers.models.sam.image_processing_pil_sam import SamImageProcessorPil

    image = np.random.default_rng(0).integers(0, 255, (height, width, 3), dtype=np.uint8)
    processor = SamImageProcessorPil(
        size={"longest_edge": 128}, pad_size={"height": 128, "width": 128}
    )
    theirs = torch.as_tensor(np.array(processor(image)["pixel_values"][0]))
    seen: list[torch.Tensor] = []
    model = load_folder("mask_generation", model_folder("sam"))
    look = model.get_image_embeddings

    def watch(pixels: torch.Tensor) -> torch.Tensor:
        seen.append(pixels)
        result: torch.Tensor = look(pixels)  # type: ignore[operator]
        return result

    model.get_image_embeddings = watch  # type: ignore[assignment]
    sam_encoder(model)(image)
    assert seen[0].shape == (1, 3, 128, 128)
    assert float((seen[0][0] - theirs).abs().max()) < 1e-5


def test_masks_fall_where_the_points_were(model_folder: Folder) -> None:
    """Logits are scaled up over the padding's edge: a logit's centre keeps its place."""
    encoded = sam_encoder(load_folder("mask_generation", model_folder("sam")))(
        np.zeros((64, 128, 3), np.uint8)
    )
    assert encoded.shown == (0.5, 1.0)
    logits = torch.full((1, 32, 32), -8.0)
    logits[0, 4:8, 8:16] = 8.0  # a quarter of the model's picture of 128
    mask = encoded.upscale(logits)[0] > 0
    assert mask.shape == (64, 128)
    rows, columns = mask.any(1).nonzero(), mask.any(0).nonzero()
    assert (int(rows.min()), int(rows.max())) == (16, 31)
    assert (int(columns.min()), int(columns.max())) == (32, 63)


def test_settings_and_weights_change_the_fingerprint(model_folder: Folder, tmp_path: Path) -> None:
    base = _provider(model_folder("sam")).fingerprint()
    more_points = _provider(model_folder("sam"), replace(_OPEN, points_per_side=5))
    assert more_points.fingerprint() != base
    batches = _provider(model_folder("sam"), replace(_OPEN, points_per_batch=1))
    assert batches.fingerprint() == base
    shutil.copytree(model_folder("sam"), tmp_path / "other")
    assert _provider(tmp_path / "other").fingerprint() == base
    path = tmp_path / "other" / "model.safetensors"
    data = bytearray(path.read_bytes())
    data[-100] ^= 1
    path.write_bytes(data)
    assert _provider(tmp_path / "other").fingerprint() != base


def test_damaged_folders_are_named(model_folder: Folder, tmp_path: Path, photo: UInt8Array) -> None:
    for number, harm in enumerate((_truncate, _other_config, _lacking)):
        folder = tmp_path / str(number)
        shutil.copytree(model_folder("sam"), folder)
        harm(folder)
        with pytest.raises(GagaError, match=f"{folder}.*[Cc]opy the whole folder"):
            run_stage(_provider(folder).label_map(Picture(photo)))


def _truncate(folder: Path) -> None:
    path = folder / "model.safetensors"
    path.write_bytes(path.read_bytes()[:5000])


def _other_config(folder: Path) -> None:
    """Weights of another size than the config says."""
    path = folder / "config.json"
    config = json.loads(path.read_text())
    config["vision_config"]["hidden_size"] = 64
    path.write_text(json.dumps(config))


def _lacking(folder: Path) -> None:
    """A file without the decoder's weights: masks would come from random ones."""
    from safetensors.torch import load_file, save_file

    path = folder / "model.safetensors"
    state = {k: v for k, v in load_file(path).items() if "hypernetworks" not in k}
    save_file(state, path, metadata={"format": "pt"})
