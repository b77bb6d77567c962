"""Configs of models small enough for tests, with weights large enough that masks differ."""

from pathlib import Path
from typing import Any

import torch
import transformers
from torch.nn import Module
from transformers.utils import logging

T: Any = transformers  # its configs take keywords that their types do not know
_SIDE = 128


def save_tiny(kind: str, folder: Path) -> None:
    """Save a random model of a transformers type into ``folder``."""
    torch.manual_seed(5)
    model: Any = _MAKERS[kind]()
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for name, value in model.named_parameters():
            if value.dim() > 1 and "embed" not in name:
                fan_in = value[0].numel()
                value.copy_(torch.randn(value.shape, generator=generator) * 1.5 / fan_in**0.5)
    logging.disable_progress_bar()  # type: ignore[no-untyped-call]
    model.save_pretrained(folder)


def _model(prefix: str, vision: object, *, decoder: object = None, **more: object) -> Module:
    """The Segment Anything model whose classes begin so, at tests' sizes."""
    config = getattr(T, f"{prefix}Config")(
        vision_config=vision,
        prompt_encoder_config=getattr(T, f"{prefix}PromptEncoderConfig")(**_PROMPT),
        mask_decoder_config=decoder or getattr(T, f"{prefix}MaskDecoderConfig")(**_DECODER),
        **more,
    )
    model: Module = getattr(T, f"{prefix}Model")(config)
    return model


def _sam() -> Module:
    decoder = T.SamMaskDecoderConfig(num_hidden_layers=2, **_DECODER)
    return _model("Sam", T.SamVisionConfig(**_VISION), decoder=decoder)


def _sam_hq() -> Module:
    decoder = T.SamHQMaskDecoderConfig(num_hidden_layers=2, vit_dim=32, **_DECODER)
    return _model("SamHQ", T.SamHQVisionConfig(**_VISION), decoder=decoder)


def _sam2() -> Module:
    backbone = T.Sam2HieraDetConfig(
        hidden_size=12,
        num_attention_heads=1,
        image_size=[_SIDE, _SIDE],
        blocks_per_stage=[1, 1, 2, 1],
        embed_dim_per_stage=[12, 24, 48, 96],
        num_attention_heads_per_stage=[1, 2, 4, 8],
        window_size_per_stage=[8, 4, 4, 2],
        global_attention_blocks=[3],  # never a stage's first block
        window_positional_embedding_background_size=[4, 4],
    )
    vision = T.Sam2VisionConfig(
        backbone_config=backbone,
        backbone_channel_list=[96, 48, 24, 12],
        backbone_feature_sizes=[[32, 32], [16, 16], [8, 8]],
        fpn_hidden_size=32,
    )
    return _model("Sam2", vision)


def _sam2_video(width: int = 32, channels: int = 16) -> Module:
    """As the published SAM 2.1 folders are: with the memory that one picture does not need."""
    image: Any = _sam2()
    image.config.vision_config.fpn_hidden_size = width
    size = {"hidden_size": width}
    memory = {
        "attention_hidden_size": width,
        "attention_feed_forward_hidden_size": 32,
        "attention_num_layers": 1,
        "attention_rope_feat_sizes": [8, 8],
        "encoder_hidden_size": width,
        "encoder_output_channels": channels,
        "fuser_embed_dim": width,
        "fuser_intermediate_dim": 64,
    }
    model: Module = T.Sam2VideoModel(
        T.Sam2VideoConfig(
            vision_config=image.config.vision_config,
            prompt_encoder_config=T.Sam2VideoPromptEncoderConfig(**_PROMPT | size),
            mask_decoder_config=T.Sam2VideoMaskDecoderConfig(**_DECODER | size),
            image_size=_SIDE,
            mask_downsampler_embed_dim=width,
            **{f"memory_{name}": value for name, value in memory.items()},
        )
    )
    return model


def _sam2_film() -> Module:
    """A video model whose memory works: its attention takes 64 channels, pointers are wider."""
    return _sam2_video(128, 64)


def _sam3_tracker() -> Module:
    backbone = T.Sam3ViTConfig(
        hidden_size=32,
        intermediate_size=64,
        num_hidden_layers=2,
        num_attention_heads=4,
        image_size=112,
        patch_size=14,
        window_size=4,
        global_attn_indexes=[1],
        pretrain_image_size=56,
    )
    vision = T.Sam3VisionConfig(
        backbone_config=backbone,
        fpn_hidden_size=32,
        backbone_feature_sizes=[[32, 32], [16, 16], [8, 8]],
    )
    prompt = {**_PROMPT, "image_size": 112, "patch_size": 14}
    model: Module = T.Sam3TrackerModel(
        T.Sam3TrackerConfig(
            vision_config=vision,
            prompt_encoder_config=T.Sam3TrackerPromptEncoderConfig(**prompt),
            mask_decoder_config=T.Sam3TrackerMaskDecoderConfig(**_DECODER),
        )
    )
    return model


def _swin() -> Any:
    return T.SwinConfig(
        image_size=64,
        embed_dim=16,
        depths=[1, 1, 1, 1],
        num_heads=[1, 2, 2, 4],
        window_size=4,
        out_features=["stage1", "stage2", "stage3", "stage4"],
    )


def _mask2former() -> Module:
    model: Module = T.Mask2FormerForUniversalSegmentation(
        T.Mask2FormerConfig(
            backbone_config=_swin(),
            feature_size=32,
            mask_feature_size=32,
            hidden_dim=32,
            encoder_feedforward_dim=32,
            dim_feedforward=32,
            encoder_layers=1,
            decoder_layers=2,
            num_attention_heads=4,
            num_queries=12,
            num_labels=3,
        )
    )
    return model


def _maskformer() -> Module:
    decoder = T.DetrConfig(
        d_model=32,
        decoder_layers=1,
        encoder_layers=1,
        decoder_attention_heads=2,
        encoder_attention_heads=2,
        decoder_ffn_dim=32,
        encoder_ffn_dim=32,
        num_queries=12,
    )
    model: Module = T.MaskFormerForInstanceSegmentation(
        T.MaskFormerConfig(
            backbone_config=T.MaskFormerSwinConfig(**_swin().to_dict()),
            decoder_config=decoder,
            fpn_feature_size=32,
            mask_feature_size=32,
            num_labels=3,
        )
    )
    return model


def _eomt() -> Module:
    model: Module = T.EomtForUniversalSegmentation(
        T.EomtConfig(
            hidden_size=32,
            num_hidden_layers=3,
            num_attention_heads=2,
            image_size=64,
            patch_size=8,
            num_blocks=1,
            num_queries=12,
            num_upscale_blocks=1,
            num_labels=3,
        )
    )
    return model


def _efficientloftr() -> Module:
    """Takes every match, however unsure."""
    config = T.EfficientLoFTRConfig(
        stage_num_blocks=[1, 1, 1, 1],
        out_features=[16, 16, 24, 32],
        hidden_size=32,
        num_attention_layers=1,
        num_attention_heads=8,
        coarse_matching_threshold=0.0,
        coarse_matching_border_removal=0,
    )
    model: Module = T.EfficientLoFTRForKeypointMatching(config)
    for module in model.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            torch.nn.init.ones_(module.weight)  # or nothing of the picture is left
    return model


_VISION = {
    "hidden_size": 32,
    "num_hidden_layers": 2,
    "num_attention_heads": 2,
    "image_size": _SIDE,
    "patch_size": 16,
    "output_channels": 32,
    "window_size": 4,
    "global_attn_indexes": [1],
    "num_pos_feats": 16,
    "mlp_dim": 64,
}
_PROMPT = {"hidden_size": 32, "image_size": _SIDE, "patch_size": 16, "mask_input_channels": 4}
_DECODER = {"hidden_size": 32, "mlp_dim": 64, "num_attention_heads": 2, "iou_head_hidden_dim": 32}
_MAKERS = {
    "sam": _sam,
    "sam_hq": _sam_hq,
    "sam2": _sam2,
    "sam2_video": _sam2_video,
    "sam2_film": _sam2_film,
    "sam3_tracker": _sam3_tracker,
    "mask2former": _mask2former,
    "maskformer": _maskformer,
    "eomt": _eomt,
    "efficientloftr": _efficientloftr,
}
