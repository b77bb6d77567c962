"""Original checkpoints of Segment Anything, against a reference of the published architecture."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gaga_core.arrays import UInt8Array
from gaga_core.errors import GagaError
from gaga_core.progress import run_stage
from gaga_core.segmentation.base import FlattenConfig, Picture
from gaga_core.segmentation.choose import ProviderSettings, provider_named
from gaga_core.segmentation.sam_checkpoint import load_sam_checkpoint
from gaga_core.segmentation.settings import GeneratorConfig
from tests.core.segmentation.conftest import NO_TRANSFORMERS
from tests.core.segmentation.sam_reference import Shape, random_state

pytest.importorskip("transformers", reason=NO_TRANSFORMERS)

_SHAPES = (
    Shape(),
    Shape(width=32, heads=2, depth=4, grid=6, window=4, whole=(1, 3), out=128, iou_hidden=24),
)
_KNOWN = Path(__file__).parents[2] / "fixtures" / "sam_2023.npz"
_POINTS = ((20.0, 30.0), (90.5, 7.0), (0.0, 95.0))


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("wrapper", ["", "model"])
def test_the_same_logits(which: int, wrapper: str, tmp_path: Path) -> None:
    shape, known = _SHAPES[which], np.load(_KNOWN)
    state = random_state(shape)
    path = tmp_path / "sam_vit_x.pth"
    torch.save({wrapper: state} if wrapper else state, path)
    model = load_sam_checkpoint(path)
    side = shape.grid * shape.patch
    pixels = torch.randn(1, 3, side, side, generator=torch.Generator().manual_seed(2))
    with torch.inference_mode():
        ours = model.get_image_embeddings(pixels)  # type: ignore[operator]
        out = model(
            image_embeddings=ours,
            input_points=torch.tensor(_POINTS)[None, :, None],
            input_labels=torch.ones(1, len(_POINTS), 1, dtype=torch.long),
            multimask_output=True,
        )
    found = (ours[:, ::8, ::2, ::2], out.pred_masks[0][..., 1::5, 1::5], out.iou_scores[0])
    for name, values in zip(("embedding", "masks", "iou"), found, strict=True):
        np.testing.assert_allclose(values.numpy(), known[f"{name}_{which}"], atol=1e-4)


def test_the_config_is_read_off_the_weights(tmp_path: Path) -> None:
    shape = _SHAPES[1]
    torch.save(random_state(shape), tmp_path / "a.pth")
    model: Any = load_sam_checkpoint(tmp_path / "a.pth")
    vision = model.config.vision_config
    assert (vision.window_size, list(vision.global_attn_indexes)) == (4, [1, 3])
    assert (vision.image_size, vision.num_attention_heads) == (96, 2)


def test_masks_from_a_checkpoint(tmp_path: Path, photo: UInt8Array) -> None:
    path = tmp_path / "sam_vit_b_01ec64.pth"
    torch.save(random_state(Shape()), path)
    generator = GeneratorConfig(
        points_per_side=4, pred_iou_thresh=-1e9, stability_score_thresh=0.0, min_area=0.0
    )
    settings = ProviderSettings(generator=generator, flatten=FlattenConfig(-1e9, 0.0))
    provider = provider_named("own", weights=path, settings=settings)
    labels = run_stage(provider.label_map(Picture(photo)))
    assert labels.shape == photo.shape[:2]
    assert labels.max() >= 1
    np.testing.assert_array_equal(labels, run_stage(provider.label_map(Picture(photo))))


class _Harm:
    def __reduce__(self) -> tuple[object, ...]:
        return (print, ("code ran",))


def test_what_is_no_such_checkpoint_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state = random_state(Shape())
    cases: dict[str, object] = {
        "hq": {**state, "mask_decoder.hf_token.weight": torch.zeros(1, 64)},
        "other": {"backbone.weight": torch.zeros(3)},
        "lacking": {k: v for k, v in state.items() if "output_upscaling.3" not in k},
        "more": {**state, "mask_decoder.extra.weight": torch.zeros(1)},
        "list": [torch.zeros(1)],
        "empty": {},
        "odd": {**state, "image_encoder.pos_embed": torch.zeros(1, 5, 5, 48)},
    }
    for name, content in cases.items():
        path = tmp_path / f"{name}.pth"
        torch.save(content, path)
        with pytest.raises(GagaError, match=name):
            load_sam_checkpoint(path)
    whole = tmp_path / "whole.pth"
    torch.save(state, whole)
    (tmp_path / "cut.pth").write_bytes(whole.read_bytes()[:4000])
    (tmp_path / "text.pth").write_text("nothing")
    (tmp_path / "code.pth").write_bytes(pickle.dumps(_Harm(), 2))
    for name in ("cut", "text", "code", "missing"):
        with pytest.raises(GagaError, match=name):
            load_sam_checkpoint(tmp_path / f"{name}.pth")
    assert "code ran" not in capsys.readouterr().out
