"""Segment Anything of 2023 as a function of its weights, under their original names.

Written from the published architecture (Kirillov 2023, appendix A; ViTDet encoder, Li 2022;
relative positions of MViTv2, Li 2022b), plainly and without modules: what the loader is compared
with.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import conv2d, conv_transpose2d, gelu, layer_norm, linear, pad, relu

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


def embed(state: State, shape: Shape, pixels: Tensor) -> Tensor:
    """Embedding (1, out, grid, grid) of a prepared picture (1, 3, S, S)."""
    weight, bias = (state[f"image_encoder.patch_embed.proj.{k}"] for k in ("weight", "bias"))
    x = conv2d(pixels, weight, bias, stride=shape.patch).permute(0, 2, 3, 1)
    x = x + state["image_encoder.pos_embed"]
    for i in range(shape.depth):
        block = f"image_encoder.blocks.{i}"
        y = _norm(state, f"{block}.norm1", x, 1e-6)
        if i in shape.whole:
            y = _attend_2d(state, f"{block}.attn", y, shape.heads)
        else:
            y = _in_windows(state, f"{block}.attn", y, shape)
        x = x + y
        y = _norm(state, f"{block}.norm2", x, 1e-6)
        x = x + _dense(state, f"{block}.mlp.lin2", gelu(_dense(state, f"{block}.mlp.lin1", y)))
    x = conv2d(x.permute(0, 3, 1, 2), state["image_encoder.neck.0.weight"])
    x = _norm_2d(state, "image_encoder.neck.1", x)
    x = conv2d(x, state["image_encoder.neck.2.weight"], padding=1)
    return _norm_2d(state, "image_encoder.neck.3", x)


def _in_windows(state: State, name: str, x: Tensor, shape: Shape) -> Tensor:
    """Attention inside windows of the padded picture, one after the other."""
    side, w = shape.grid, shape.window
    n = -(-side // w)
    padded = pad(x, (0, 0, 0, n * w - side, 0, n * w - side))
    out = torch.zeros_like(padded)
    for r in range(n):
        for c in range(n):
            rows, columns = slice(r * w, r * w + w), slice(c * w, c * w + w)
            out[:, rows, columns] = _attend_2d(state, name, padded[:, rows, columns], shape.heads)
    return out[:, :side, :side]


def _attend_2d(state: State, name: str, x: Tensor, heads: int) -> Tensor:
    """Attention of a square of tokens with decomposed relative positions."""
    _, h, w, c = x.shape
    d = c // heads
    q, k, v = _dense(state, f"{name}.qkv", x).reshape(h * w, 3, heads, d).unbind(1)
    rows = torch.arange(h * w) // w
    columns = torch.arange(h * w) % w
    by_row = state[f"{name}.rel_pos_h"][rows[:, None] - rows[None] + h - 1]  # (hw, hw, d)
    by_column = state[f"{name}.rel_pos_w"][columns[:, None] - columns[None] + w - 1]
    out = torch.empty(h * w, heads, d)
    for i in range(heads):
        scores = q[:, i] @ k[:, i].T / math.sqrt(d)
        scores = scores + torch.einsum("qd,qkd->qk", q[:, i], by_row + by_column)
        out[:, i] = scores.softmax(1) @ v[:, i]
    return _dense(state, f"{name}.proj", out.reshape(1, h, w, c))


def decode(
    state: State, shape: Shape, embedding: Tensor, point: tuple[float, float]
) -> tuple[Tensor, Tensor]:
    """Three masks (3, 4 grid, 4 grid) and their predicted IoU (3,) for a point x, y in pixels."""
    side = shape.grid * shape.patch
    xy = (torch.tensor([point]) + 0.5) / side
    ends = "prompt_encoder.point_embeddings.1.weight"
    sparse = torch.cat(
        [_positions(state, xy) + state[ends], state["prompt_encoder.not_a_point_embed.weight"]]
    )
    centres = (torch.arange(shape.grid) + 0.5) / shape.grid
    y, x = torch.meshgrid(centres, centres, indexing="ij")
    key_pe = _positions(state, torch.stack([x, y], -1).reshape(-1, 2))
    image = embedding + state["prompt_encoder.no_mask_embed.weight"].reshape(1, -1, 1, 1)
    keys = image.flatten(2)[0].T
    tokens = torch.cat(
        [state["mask_decoder.iou_token.weight"], state["mask_decoder.mask_tokens.weight"], sparse]
    )
    queries = tokens
    for i in range(2):
        layer = f"mask_decoder.transformer.layers.{i}"
        if i == 0:
            queries = _attend(state, f"{layer}.self_attn", queries, queries, queries)
        else:
            q = queries + tokens
            queries = queries + _attend(state, f"{layer}.self_attn", q, q, queries)
        queries = _norm(state, f"{layer}.norm1", queries)
        q, k = queries + tokens, keys + key_pe
        queries = queries + _attend(state, f"{layer}.cross_attn_token_to_image", q, k, keys)
        queries = _norm(state, f"{layer}.norm2", queries)
        hidden = relu(_dense(state, f"{layer}.mlp.lin1", queries))
        queries = _norm(
            state, f"{layer}.norm3", queries + _dense(state, f"{layer}.mlp.lin2", hidden)
        )
        q, k = queries + tokens, keys + key_pe
        keys = keys + _attend(state, f"{layer}.cross_attn_image_to_token", k, q, queries)
        keys = _norm(state, f"{layer}.norm4", keys)
    final = "mask_decoder.transformer"
    q, k = queries + tokens, keys + key_pe
    queries = queries + _attend(state, f"{final}.final_attn_token_to_image", q, k, keys)
    queries = _norm(state, f"{final}.norm_final_attn", queries)
    up = _upscale(state, keys.T.reshape(1, shape.out, shape.grid, shape.grid))
    masks = torch.stack(
        [
            (
                _mlp(state, f"mask_decoder.output_hypernetworks_mlps.{i}", queries[1 + i])[
                    :, None, None
                ]
                * up
            ).sum(0)
            for i in range(1, 4)
        ]
    )
    return masks, _mlp(state, "mask_decoder.iou_prediction_head", queries[0])[1:]


def _upscale(state: State, x: Tensor) -> Tensor:
    name = "mask_decoder.output_upscaling"
    x = conv_transpose2d(x, state[f"{name}.0.weight"], state[f"{name}.0.bias"], stride=2)
    x = gelu(_norm_2d(state, f"{name}.1", x))
    x = conv_transpose2d(x, state[f"{name}.3.weight"], state[f"{name}.3.bias"], stride=2)
    return gelu(x)[0]


def _positions(state: State, xy: Tensor) -> Tensor:
    """Random Fourier features (n, out) of points (n, 2) in 0..1."""
    matrix = state["prompt_encoder.pe_layer.positional_encoding_gaussian_matrix"]
    angles = 2 * math.pi * ((2 * xy - 1) @ matrix)
    return torch.cat([angles.sin(), angles.cos()], dim=-1)


def _attend(state: State, name: str, q: Tensor, k: Tensor, v: Tensor, heads: int = 8) -> Tensor:
    q, k, v = (
        _dense(state, f"{name}.{part}_proj", x).reshape(len(x), heads, -1).transpose(0, 1)
        for part, x in (("q", q), ("k", k), ("v", v))
    )
    scores = (q @ k.transpose(1, 2) / math.sqrt(q.shape[-1])).softmax(-1)
    return _dense(state, f"{name}.out_proj", (scores @ v).transpose(0, 1).flatten(1))


def _mlp(state: State, name: str, x: Tensor) -> Tensor:
    for j in range(3):
        x = _dense(state, f"{name}.layers.{j}", x)
        x = relu(x) if j < 2 else x
    return x


def _dense(state: State, name: str, x: Tensor) -> Tensor:
    return linear(x, state[f"{name}.weight"], state[f"{name}.bias"])


def _norm(state: State, name: str, x: Tensor, eps: float = 1e-5) -> Tensor:
    return layer_norm(x, x.shape[-1:], state[f"{name}.weight"], state[f"{name}.bias"], eps)


def _norm_2d(state: State, name: str, x: Tensor) -> Tensor:
    """Over the channels of (1, C, h, w)."""
    y = layer_norm(
        x.permute(0, 2, 3, 1),
        (x.shape[1],),
        state[f"{name}.weight"],
        state[f"{name}.bias"],
        1e-6,
    )
    return y.permute(0, 3, 1, 2)
