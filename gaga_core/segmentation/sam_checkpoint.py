"""Checkpoints of the first Segment Anything as Meta published them: ``sam_vit_{b,l,h}_*.pth``.

Names are mapped to those of transformers' ``SamModel``, and its config is read off the shapes, so
every size works, also fine-tuned ones (MedSAM has the same layout).
"""

import pickle
import re
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import Module

from gaga_core.errors import GagaError
from gaga_core.io.files import explain_os_error
from gaga_core.segmentation.loading import freeze

_DECODER_HEADS = 8  # of all published models; the weights do not show it
# Beginnings of names, and what transformers calls them; the first one that fits.
_NAMES = """
image_encoder.patch_embed.proj. vision_encoder.patch_embed.projection.
image_encoder.neck.0. vision_encoder.neck.conv1.
image_encoder.neck.1. vision_encoder.neck.layer_norm1.
image_encoder.neck.2. vision_encoder.neck.conv2.
image_encoder.neck.3. vision_encoder.neck.layer_norm2.
image_encoder.blocks. vision_encoder.layers.
image_encoder. vision_encoder.
prompt_encoder.pe_layer.positional_encoding_gaussian_matrix {shared}
prompt_encoder.point_embeddings. prompt_encoder.point_embed.
prompt_encoder.mask_downscaling.0. prompt_encoder.mask_embed.conv1.
prompt_encoder.mask_downscaling.1. prompt_encoder.mask_embed.layer_norm1.
prompt_encoder.mask_downscaling.3. prompt_encoder.mask_embed.conv2.
prompt_encoder.mask_downscaling.4. prompt_encoder.mask_embed.layer_norm2.
prompt_encoder.mask_downscaling.6. prompt_encoder.mask_embed.conv3.
mask_decoder.transformer.norm_final_attn. mask_decoder.transformer.layer_norm_final_attn.
mask_decoder.output_upscaling.0. mask_decoder.upscale_conv1.
mask_decoder.output_upscaling.1. mask_decoder.upscale_layer_norm.
mask_decoder.output_upscaling.3. mask_decoder.upscale_conv2.
"""
_POSITIONS = "prompt_encoder.shared_embedding.positional_embedding"
_BEGINNINGS = [line.split() for line in _NAMES.format(shared=_POSITIONS).strip().splitlines()]
_NORM = re.compile(r"(blocks|transformer\.layers)(\.\d+\.)norm(\d)")
# The layers of a small network are counted from input to output: first, those between, last.
_HEAD = re.compile(
    r"^(mask_decoder\.(?:output_hypernetworks_mlps\.\d+|iou_prediction_head))\.layers\.(\d+)\."
)
_SHARED = "shared_image_embedding.positional_embedding"


def load_sam_checkpoint(path: Path) -> Module:
    """transformers' ``SamModel`` with the weights of an original checkpoint, on the processor.

    Only tensors are read (``weights_only``): a checkpoint can not run code. Raises ``GagaError``
    when the file is damaged or of another model.
    """
    return sam_of_state(read_checkpoint(path), str(path))


def read_checkpoint(path: Path) -> dict[str, Tensor]:
    """The tensors of a ``.pth`` file by their original names."""
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    except (RuntimeError, EOFError, ValueError, KeyError, pickle.UnpicklingError) as error:
        raise GagaError(
            f"{path} is damaged or no checkpoint of tensors. Download it again."
        ) from error
    for wrapper in ("model", "state_dict"):  # as trainers save them
        if isinstance(content, dict) and isinstance(content.get(wrapper), dict):
            content = content[wrapper]
    if not isinstance(content, dict) or not content:
        raise GagaError(f"{path} holds no weights. Choose a sam_vit_*.pth file.")
    return {
        str(name).removeprefix("module."): value
        for name, value in content.items()
        if isinstance(value, Tensor)
    }


def sam_of_state(state: Mapping[str, Tensor], origin: str) -> Module:
    """``SamModel`` of original weights; ``origin`` is the file's name for messages."""
    import transformers

    _check_kind(state, origin)
    try:
        config = _config_of(state)
        model: Module = transformers.SamModel(config)
        renamed = rename(state)
        renamed[_SHARED] = renamed[_POSITIONS]
        lacking, left = model.load_state_dict(renamed, strict=False)
    except (KeyError, IndexError, ValueError, RuntimeError, ZeroDivisionError) as error:
        raise GagaError(
            f"The weights in {origin} do not make a Segment Anything model "
            f"({str(error).splitlines()[0][:160]}). Download the file again."
        ) from error
    if lacking or left:
        odd = [*lacking, *left]
        raise GagaError(
            f"{origin} is not the Segment Anything of 2023: {len(odd)} weights do not fit "
            f"(first: {odd[0]}). Choose a sam_vit_*.pth file."
        )
    return freeze(model.float())


def rename(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The same tensors under the names of transformers."""
    last: dict[str, int] = {}
    for name in state:
        head = _HEAD.match(name)
        if head:
            last[head[1]] = max(last.get(head[1], 0), int(head[2]))
    renamed = {}
    for name, value in state.items():
        new = _NORM.sub(r"\1\2layer_norm\3", name)
        head = _HEAD.match(name)
        if head:
            layer = int(head[2])
            inner = f"layers.{layer - 1}"
            place = "proj_in" if layer == 0 else "proj_out" if layer == last[head[1]] else inner
            new = f"{head[1]}.{place}.{name[head.end() :]}"
        for old, theirs in _BEGINNINGS:
            if new.startswith(old):
                new = theirs + new.removeprefix(old)
                break
        renamed[new] = value
    return renamed


def _check_kind(state: Mapping[str, Tensor], origin: str) -> None:
    if any(name.startswith("mask_decoder.hf_") for name in state):
        raise GagaError(
            f"{origin} is a SAM-HQ checkpoint. Use the folder of that model for transformers."
        )
    if "image_encoder.pos_embed" not in state or "mask_decoder.iou_token.weight" not in state:
        raise GagaError(
            f"{origin} holds another model than the Segment Anything of 2023. "
            "Choose a sam_vit_*.pth file, or the folder of the model for transformers."
        )


def _config_of(state: Mapping[str, Tensor]) -> "transformers.SamConfig":  # type: ignore[name-defined]  # noqa: F821
    """The config that follows from the shapes of the weights."""
    import transformers

    embed = state["image_encoder.patch_embed.proj.weight"]  # (C, 3, p, p)
    hidden, patch = int(embed.shape[0]), int(embed.shape[-1])
    grid = int(state["image_encoder.pos_embed"].shape[1])
    n_layers = _count(state, r"^image_encoder\.blocks\.(\d+)\.")
    has_positions = "image_encoder.blocks.0.attn.rel_pos_h" in state
    reach = [
        (len(state[f"image_encoder.blocks.{i}.attn.rel_pos_h"]) + 1) // 2 for i in range(n_layers)
    ]
    windows = [r for r in reach if r != grid]
    vision = transformers.SamVisionConfig(
        hidden_size=hidden,
        output_channels=int(state["image_encoder.neck.0.weight"].shape[0]),
        num_hidden_layers=n_layers,
        num_attention_heads=hidden // int(state["image_encoder.blocks.0.attn.rel_pos_h"].shape[1]),
        image_size=grid * patch,
        patch_size=patch,
        window_size=windows[0] if windows else grid,
        global_attn_indexes=[i for i in range(n_layers) if reach[i] == grid],
        num_pos_feats=int(
            state["prompt_encoder.pe_layer.positional_encoding_gaussian_matrix"].shape[1]
        ),
        mlp_dim=int(state["image_encoder.blocks.0.mlp.lin1.weight"].shape[0]),
        use_rel_pos=has_positions,
    )
    width = int(state["mask_decoder.iou_token.weight"].shape[1])
    prompt = transformers.SamPromptEncoderConfig(
        hidden_size=width,
        image_size=grid * patch,
        patch_size=patch,
        mask_input_channels=int(state["prompt_encoder.mask_downscaling.3.weight"].shape[0]),
    )
    across = state[
        "mask_decoder.transformer.layers.0.cross_attn_token_to_image.q_proj.weight"
    ].shape[0]
    decoder = transformers.SamMaskDecoderConfig(
        hidden_size=width,
        mlp_dim=int(state["mask_decoder.transformer.layers.0.mlp.lin1.weight"].shape[0]),
        num_hidden_layers=_count(state, r"^mask_decoder\.transformer\.layers\.(\d+)\."),
        num_attention_heads=_DECODER_HEADS,
        attention_downsample_rate=width // int(across),
        num_multimask_outputs=int(state["mask_decoder.mask_tokens.weight"].shape[0]) - 1,
        iou_head_depth=_count(state, r"^mask_decoder\.iou_prediction_head\.layers\.(\d+)\."),
        iou_head_hidden_dim=int(state["mask_decoder.iou_prediction_head.layers.0.weight"].shape[0]),
        layer_norm_eps=1e-5,  # torch's own, which the original decoder keeps
    )
    return transformers.SamConfig(
        vision_config=vision, prompt_encoder_config=prompt, mask_decoder_config=decoder
    )


def _count(state: Mapping[str, Tensor], pattern: str) -> int:
    """Number of layers whose index the first group of ``pattern`` matches."""
    found = (re.match(pattern, name) for name in state)
    return 1 + max(int(match[1]) for match in found if match)
