"""Random weights of Segment Anything of 2023 under their original names (Kirillov 2023).

``tests/fixtures/sam_2023.npz`` holds what the published architecture, written plainly and without
modules, makes of those of seed 0 (`sam_reference.py` of commit 453603a has the program).
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

State = dict[str, Tensor]


@dataclass(frozen=True)
class Shape:
    """Sizes of a random model; the decoder has 8 heads as all published ones have."""

    width: int = 48  # of the encoder
    heads: int = 3
    depth: int = 3
    grid: int = 8  # patches a side
    patch: int = 16
    window: int = 3
    whole: tuple[int, ...] = (2,)  # blocks that attend to the whole picture
    out: int = 64  # of the decoder
    inner: int = 96  # of the decoder's MLP
    iou_hidden: int = 40


class _Random:
    """Random weights by name, large enough that every part matters."""

    def __init__(self, seed: int) -> None:
        self.generator = torch.Generator().manual_seed(seed)
        self.state: State = {}

    def put(self, name: str, *size: int, scale: float = 0.0) -> None:
        fan_in = math.prod(size[1:]) if len(size) > 1 else size[0]
        values = torch.randn(*size, generator=self.generator)
        self.state[name] = values * (scale or 1.6 / math.sqrt(fan_in))

    def dense(self, name: str, n_in: int, n_out: int) -> None:
        self.put(f"{name}.weight", n_out, n_in)
        self.put(f"{name}.bias", n_out, scale=0.3)

    def norm(self, name: str, n: int) -> None:
        self.put(f"{name}.weight", n, scale=0.5)
        self.state[f"{name}.weight"] += 1
        self.put(f"{name}.bias", n, scale=0.3)

    def attention(self, name: str, outer: int, inner: int) -> None:
        for part in ("q_proj", "k_proj", "v_proj"):
            self.dense(f"{name}.{part}", outer, inner)
        self.dense(f"{name}.out_proj", inner, outer)


def random_state(shape: Shape, seed: int = 0) -> State:
    """Random weights of that shape."""
    random = _Random(seed)
    _random_encoder(random, shape)
    _random_prompts(random, shape.out)
    _random_decoder(random, shape)
    return random.state


def _random_encoder(random: _Random, shape: Shape) -> None:
    c, o, side = shape.width, shape.out, shape.grid
    random.put("image_encoder.patch_embed.proj.weight", c, 3, shape.patch, shape.patch)
    random.put("image_encoder.patch_embed.proj.bias", c, scale=0.3)
    random.put("image_encoder.pos_embed", 1, side, side, c, scale=0.5)
    for i in range(shape.depth):
        block = f"image_encoder.blocks.{i}"
        reach = side if i in shape.whole else shape.window
        random.norm(f"{block}.norm1", c)
        random.norm(f"{block}.norm2", c)
        random.dense(f"{block}.attn.qkv", c, 3 * c)
        random.dense(f"{block}.attn.proj", c, c)
        for axis in "hw":
            name = f"{block}.attn.rel_pos_{axis}"
            random.put(name, 2 * reach - 1, c // shape.heads, scale=0.3)
        random.dense(f"{block}.mlp.lin1", c, 4 * c)
        random.dense(f"{block}.mlp.lin2", 4 * c, c)
    random.put("image_encoder.neck.0.weight", o, c, 1, 1)
    random.norm("image_encoder.neck.1", o)
    random.put("image_encoder.neck.2.weight", o, o, 3, 3)
    random.norm("image_encoder.neck.3", o)


def _random_prompts(random: _Random, o: int) -> None:
    name = "prompt_encoder"
    random.put(f"{name}.pe_layer.positional_encoding_gaussian_matrix", 2, o // 2, scale=1.0)
    for i in range(4):
        random.put(f"{name}.point_embeddings.{i}.weight", 1, o, scale=1.0)
    random.put(f"{name}.not_a_point_embed.weight", 1, o, scale=1.0)
    random.put(f"{name}.no_mask_embed.weight", 1, o, scale=1.0)
    for index, (n_in, n_out, k) in {0: (1, 4, 2), 3: (4, 16, 2), 6: (16, o, 1)}.items():
        random.put(f"{name}.mask_downscaling.{index}.weight", n_out, n_in, k, k)
        random.put(f"{name}.mask_downscaling.{index}.bias", n_out, scale=0.3)
    random.norm(f"{name}.mask_downscaling.1", 4)
    random.norm(f"{name}.mask_downscaling.4", 16)


def _random_decoder(random: _Random, shape: Shape) -> None:
    o, hidden = shape.out, shape.iou_hidden
    for i in range(2):
        layer = f"mask_decoder.transformer.layers.{i}"
        random.attention(f"{layer}.self_attn", o, o)
        random.attention(f"{layer}.cross_attn_token_to_image", o, o // 2)
        random.attention(f"{layer}.cross_attn_image_to_token", o, o // 2)
        random.dense(f"{layer}.mlp.lin1", o, shape.inner)
        random.dense(f"{layer}.mlp.lin2", shape.inner, o)
        for k in range(1, 5):
            random.norm(f"{layer}.norm{k}", o)
    random.attention("mask_decoder.transformer.final_attn_token_to_image", o, o // 2)
    random.norm("mask_decoder.transformer.norm_final_attn", o)
    random.put("mask_decoder.iou_token.weight", 1, o, scale=1.0)
    random.put("mask_decoder.mask_tokens.weight", 4, o, scale=1.0)
    name = "mask_decoder.output_upscaling"
    random.put(f"{name}.0.weight", o, o // 4, 2, 2, scale=0.3)
    random.put(f"{name}.0.bias", o // 4, scale=0.3)
    random.norm(f"{name}.1", o // 4)
    random.put(f"{name}.3.weight", o // 4, o // 8, 2, 2, scale=0.2)
    random.put(f"{name}.3.bias", o // 8, scale=0.3)
    for i in range(4):
        head = f"mask_decoder.output_hypernetworks_mlps.{i}.layers"
        for j, n_out in enumerate([o, o, o // 8]):
            random.dense(f"{head}.{j}", o, n_out)
    for j, (n_in, n_out) in enumerate([(o, hidden), (hidden, hidden), (hidden, 4)]):
        random.dense(f"mask_decoder.iou_prediction_head.layers.{j}", n_in, n_out)
