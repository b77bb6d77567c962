"""CLIP and SigLIP behind one protocol: pictures and texts to unit vectors of one space.

Models are read from a local folder, never downloaded; transformers and torch are imported when one
is loaded. Pictures are prepared here (square already, resized, normalised), so no torchvision.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np
from PIL import Image

from gaga_core.arrays import FloatArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.segmentation.weights import Weights, weights_id

if TYPE_CHECKING:
    import torch
    from transformers import PretrainedConfig, PreTrainedTokenizerBase

    from gaga_core.segmentation.settings import Device

_KINDS = ("clip", "siglip")
# Means and deviations of the published models, for folders without a preprocessor_config.json.
_NORMAL = {
    "clip": ((0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)),
    "siglip": ((0.5, 0.5, 0.5), (0.5, 0.5, 0.5)),
}


class Embedder(Protocol):
    """Maps pictures and texts into one space; vectors are float32 rows of length 1."""

    @property
    def fingerprint(self) -> str:
        """Changes with the model."""
        ...

    def pictures(self, pictures: Sequence[UInt8Array]) -> FloatArray:
        """Vectors (n, D) of square pictures (S, S, 3)."""
        ...

    def texts(self, texts: Sequence[str]) -> FloatArray:
        """Vectors (n, D) of texts."""
        ...


class _TwoTowers(Protocol):
    """What CLIP and SigLIP models of transformers have in common."""

    config: "PretrainedConfig"
    device: "torch.device"

    def get_image_features(self, *, pixel_values: "torch.Tensor") -> object: ...

    def get_text_features(self, **tokens: "torch.Tensor") -> object: ...


@dataclass(frozen=True, eq=False)
class TextImageModel:
    """A CLIP or SigLIP model that was loaded."""

    fingerprint: str
    model: _TwoTowers
    tokenizer: "PreTrainedTokenizerBase"
    kind: str
    size: int  # pixels
    mean: tuple[float, ...]
    std: tuple[float, ...]

    def pictures(self, pictures: Sequence[UInt8Array]) -> FloatArray:
        """Vectors (n, D) of square pictures (S, S, 3) uint8."""
        import torch

        side = (self.size, self.size)
        resized = [Image.fromarray(p).resize(side, Image.Resampling.BICUBIC) for p in pictures]
        values = np.stack([np.asarray(p, np.float32) for p in resized]) / 255
        values = (values - np.array(self.mean, np.float32)) / np.array(self.std, np.float32)
        pixels = torch.from_numpy(np.ascontiguousarray(values.transpose(0, 3, 1, 2)))
        with torch.inference_mode():
            found = self.model.get_image_features(pixel_values=pixels.to(self.model.device))
        return _unit(found)

    def texts(self, texts: Sequence[str]) -> FloatArray:
        """Vectors (n, D) of texts; lower case, cut where the model's longest text ends."""
        import torch

        longest = int(self.model.config.text_config.max_position_embeddings)
        tokens = self.tokenizer(
            [text.lower() for text in texts],
            padding=True if self.kind == "clip" else "max_length",
            max_length=longest,
            truncation=True,
            return_tensors="pt",
        )
        given = {"input_ids": tokens["input_ids"].to(self.model.device)}
        if self.kind == "clip":
            given["attention_mask"] = tokens["attention_mask"].to(self.model.device)
        with torch.inference_mode():
            return _unit(self.model.get_text_features(**given))


def load_embedder(folder: Path, device: "Device" = "auto") -> TextImageModel:
    """The CLIP or SigLIP model in ``folder`` (as transformers saves them).

    Raises ``GagaError`` when transformers is missing, or the folder holds no such model.
    """
    kind = str(read_config(folder).get("model_type", ""))
    if kind not in _KINDS:
        raise GagaError(
            f"{folder} holds no CLIP or SigLIP model (it says {kind or 'nothing'!r}). "
            "Choose the folder of one."
        )
    from gaga_core.segmentation.loading import choose_device, load_folder

    where = choose_device(device)
    model = load_folder("text_image", folder)
    tokenizer = load_part("AutoTokenizer", folder)
    shown = _read_json(folder / "preprocessor_config.json")
    mean, std = (
        tuple(float(v) for v in shown[key]) if _is_triple(shown.get(key)) else usual
        for key, usual in zip(("image_mean", "image_std"), _NORMAL[kind], strict=True)
    )
    towers = cast(_TwoTowers, model.to(where))
    return TextImageModel(
        fingerprint=weights_id(Weights(folder, kind)),
        model=towers,
        tokenizer=cast("PreTrainedTokenizerBase", tokenizer),
        kind=kind,
        size=int(towers.config.vision_config.image_size),
        mean=mean,
        std=std,
    )


def load_part(auto: str, folder: Path) -> object:
    """What belongs to a model: its tokenizer or processor, by the name of transformers' class."""
    from gaga_core.segmentation.loading import first_line, offline

    with offline():
        import transformers

        try:
            return getattr(transformers, auto).from_pretrained(folder, local_files_only=True)
        except (OSError, ValueError, RuntimeError, KeyError, TypeError, ImportError) as error:
            raise GagaError(
                f"The files beside the model in {folder} cannot be loaded ({first_line(error)}). "
                "Copy the whole folder again, with its tokenizer and preprocessor files."
            ) from error


def read_config(folder: Path) -> Mapping[str, object]:
    """The config.json of a model folder; ``GagaError`` when there is none."""
    if not (folder / "config.json").is_file():
        raise GagaError(f"{folder} holds no model: it has no config.json. Choose a model's folder.")
    return _read_json(folder / "config.json")


def _read_json(path: Path) -> dict[str, list[float]]:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return value if isinstance(value, dict) else {}


def _is_triple(value: object) -> bool:
    return isinstance(value, list) and len(value) == 3


def _unit(found: object) -> FloatArray:
    """Rows of length 1; transformers 5 wraps features in an output object."""
    rows = cast("torch.Tensor", getattr(found, "pooler_output", found))
    values = rows.float().cpu().numpy()
    length = np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-12)
    result: FloatArray = (values / length).astype(np.float32)
    return result
