"""Tiny random models of words and pictures, saved as a person has them: in a folder."""

from pathlib import Path
from typing import Any

import pytest

WORDS = ("a", "photo", "of", "red", "chair", "fox", "object", "things", "stuff", "texture", ".")


def write_clip(folder: Path, *, siglip: bool = False, seed: int = 0) -> Path:
    """A random CLIP (or SigLIP) with its tokenizer and preprocessor."""
    transformers = pytest.importorskip("transformers", reason="transformers is not installed")
    import torch

    torch.manual_seed(seed)
    kind = "Siglip" if siglip else "CLIP"
    text = {
        "vocab_size": 99, "hidden_size": 32, "intermediate_size": 37, "num_hidden_layers": 2,
        "num_attention_heads": 4, "max_position_embeddings": 32, "eos_token_id": 3,
        "bos_token_id": 2,
    }  # fmt: skip
    vision = {
        "hidden_size": 32, "intermediate_size": 37, "num_hidden_layers": 2,
        "num_attention_heads": 4, "image_size": 32, "patch_size": 8,
    }  # fmt: skip
    more = {} if siglip else {"projection_dim": 16}
    config = getattr(transformers, f"{kind}Config")(text_config=text, vision_config=vision, **more)
    getattr(transformers, f"{kind}Model")(config).save_pretrained(folder)
    _tokenizer(transformers).save_pretrained(folder)
    return folder


def write_grounding_dino(folder: Path) -> Path:
    """A random Grounding DINO with its processor."""
    t = pytest.importorskip("transformers", reason="transformers is not installed")
    import torch

    torch.manual_seed(0)
    tokenizer = _tokenizer(t)
    backbone = t.SwinConfig(
        image_size=64, patch_size=4, embed_dim=12, depths=[1, 1, 1, 1], num_heads=[1, 2, 3, 4],
        window_size=4, out_features=["stage2", "stage3", "stage4"], out_indices=[2, 3, 4],
    )  # fmt: skip
    text = t.BertConfig(
        vocab_size=len(tokenizer), hidden_size=24, num_hidden_layers=1, num_attention_heads=2,
        intermediate_size=32, max_position_embeddings=64,
    )  # fmt: skip
    config = t.GroundingDinoConfig(
        backbone_config=backbone, text_config=text, d_model=32, encoder_layers=1, decoder_layers=2,
        encoder_ffn_dim=48, decoder_ffn_dim=48, encoder_attention_heads=4,
        decoder_attention_heads=4, num_queries=10, max_text_len=16, num_feature_levels=4,
        disable_custom_kernels=True,
    )  # fmt: skip
    t.GroundingDinoForObjectDetection(config).save_pretrained(folder)
    size = {"shortest_edge": 64, "longest_edge": 96}
    processor = t.GroundingDinoProcessor(t.GroundingDinoImageProcessorPil(size=size), tokenizer)
    processor.save_pretrained(folder)
    return folder


def write_owlv2(folder: Path) -> Path:
    """A random OWLv2 with its processor."""
    t = pytest.importorskip("transformers", reason="transformers is not installed")
    import torch

    torch.manual_seed(0)
    tokenizer = _tokenizer(t)
    text = {
        "vocab_size": 99, "hidden_size": 32, "intermediate_size": 37, "num_hidden_layers": 2,
        "num_attention_heads": 4, "max_position_embeddings": 16,
    }  # fmt: skip
    vision = {
        "hidden_size": 32, "intermediate_size": 37, "num_hidden_layers": 2,
        "num_attention_heads": 4, "image_size": 32, "patch_size": 8,
    }  # fmt: skip
    config = t.Owlv2Config(text_config=text, vision_config=vision, projection_dim=32)
    t.Owlv2ForObjectDetection(config).save_pretrained(folder)
    pictures = t.Owlv2ImageProcessorPil(size={"height": 32, "width": 32})
    t.Owlv2Processor(pictures, tokenizer).save_pretrained(folder)
    return folder


def _tokenizer(transformers: Any) -> Any:
    letters = [chr(c) for c in range(ord("b"), ord("z") + 1)]
    words = ["[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]", *WORDS, *letters]
    vocabulary = {word: i for i, word in enumerate(words)}
    tokenizer = transformers.BertTokenizer(vocab=vocabulary)
    tokenizer.model_max_length = 16
    return tokenizer
