"""CLIP and SigLIP behind one protocol: pictures and texts to unit vectors of one space.

Models are read from a local folder, never downloaded; transformers and torch are imported when one
is loaded. Pictures are prepared here (square already, resized, normalised), so no torchvision.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol, TypeVar, cast

import msgspec
import numpy as np
from PIL import Image

from gaga_core.arrays import FloatArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.io.json_file import read_foreign_json
from gaga_core.segmentation.models.catalogue import KNOWN_DETECTORS, KNOWN_EMBEDDERS, KnownModel
from gaga_core.segmentation.models.weights import (
    Weights,
    find_model,
    is_model_folder,
    model_type_of,
    models_folder,
    weights_id,
)
from gaga_core.segmentation.models.weights import where_to_put as where_to_put_all

if TYPE_CHECKING:
    import torch
    from torch.nn import Module
    from transformers import PretrainedConfig, PreTrainedTokenizerBase

    from gaga_core.segmentation.loading import ModelKind
    from gaga_core.segmentation.settings import Device

# --- A model of words in a folder as transformers saves it: network, and tokenizer or processor.
# Read from disk, never downloaded; torch and transformers are imported when one is loaded.


S = TypeVar("S", bound=msgspec.Struct)
Companion = Literal["AutoTokenizer", "AutoProcessor"]  # class of transformers


@dataclass(frozen=True, eq=False)
class LoadedModel:
    """A network and what prepares its input."""

    kind: str  # model_type of config.json
    network: "Module"  # on its device, frozen
    companion: object  # tokenizer or processor


def load_model(
    folder: Path,
    task: "ModelKind",
    kinds: Sequence[str],  # model types of config.json that will do
    companion: Companion,
    *,
    title: str,
    device: "Device" = "auto",
) -> LoadedModel:
    """The model in ``folder``; ``title`` is what a person calls such models.

    Raises ``GagaError`` when transformers is missing, or the folder holds another kind of model.
    """
    if not (folder / "config.json").is_file():
        raise GagaError(f"{folder} holds no model: it has no config.json. Choose a model's folder.")
    kind = model_type_of(folder)
    if kind not in kinds:
        raise GagaError(
            f"{folder} holds no {title} model (it says {kind or 'nothing'!r}). "
            "Choose the folder of one."
        )
    from gaga_core.segmentation.loading import choose_device, load_folder

    where = choose_device(device)
    network = load_folder(task, folder)
    return LoadedModel(kind, network.to(where), _load_companion(companion, folder))


def read_or_default(path: Path, default: S) -> S:
    """The content of a model's JSON file; ``default`` when there is none that can be read."""
    try:
        return read_foreign_json(path, type(default))
    except GagaError:
        return default


def _load_companion(name: Companion, folder: Path) -> object:
    from gaga_core.segmentation.loading import first_line, offline

    with offline():
        import transformers

        try:
            return getattr(transformers, name).from_pretrained(folder, local_files_only=True)
        except (OSError, ValueError, RuntimeError, KeyError, TypeError, ImportError) as error:
            raise GagaError(
                f"The files next to the model in {folder} cannot be loaded ({first_line(error)}). "
                "Copy the whole folder again, with its tokenizer and preprocessor files."
            ) from error


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


class _Shown(msgspec.Struct, frozen=True):
    """What is read of a model's preprocessor_config.json; None = as published."""

    image_mean: tuple[float, float, float] | None = None
    image_std: tuple[float, float, float] | None = None


def load_embedder(folder: Path, device: "Device" = "auto") -> TextImageModel:
    """The CLIP or SigLIP model in ``folder`` (as transformers saves them).

    Raises ``GagaError`` when transformers is missing, or the folder holds no such model.
    """
    found = load_model(
        folder, "text_image", _KINDS, "AutoTokenizer", title="CLIP or SigLIP", device=device
    )
    shown = read_or_default(folder / "preprocessor_config.json", _Shown())
    mean, std = (
        given or usual
        for given, usual in zip(
            (shown.image_mean, shown.image_std), _NORMAL[found.kind], strict=True
        )
    )
    towers = cast(_TwoTowers, found.network)
    return TextImageModel(
        fingerprint=weights_id(Weights(folder, found.kind)),
        model=towers,
        tokenizer=cast("PreTrainedTokenizerBase", found.companion),
        kind=found.kind,
        size=int(towers.config.vision_config.image_size),
        mean=mean,
        std=std,
    )


def _unit(found: object) -> FloatArray:
    """Rows of length 1; transformers 5 wraps features in an output object."""
    rows = cast("torch.Tensor", getattr(found, "pooler_output", found))
    values = rows.float().cpu().numpy()
    length = np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-12)
    return (values / length).astype(np.float32)


# --- Which model is meant: a folder, or one known by name that the user has put in its place.


__all__ = ["KNOWN_DETECTORS", "KNOWN_EMBEDDERS", "find_any", "folder_of", "where_to_put_all"]


def folder_of(
    given: str | Path, known: tuple[KnownModel, ...], hub_cache: Path | None = None
) -> Path:
    """Folder of the model that ``given`` names: a path, a name in the folder of models, or one of
    ``known``, looked up there and in the user's hub cache. Never downloads.

    Raises ``GagaError`` that says which files belong where.
    """
    path = Path(given)
    if path.is_dir():
        return path
    own = models_folder() / str(given)
    if is_model_folder(own):
        return own
    model = next((m for m in known if str(given) in (m.name, m.hub)), None)
    if model is None:
        names = ", ".join(m.name for m in known)
        raise GagaError(f"There is no model {given}. Give its folder, or one of {names}.")
    found = find_model(model, hub_cache)
    if found is None:
        raise GagaError(f"{model.title} is not on this computer. {where_to_put_all(model)}")
    return found


def find_any(known: tuple[KnownModel, ...], hub_cache: Path | None = None) -> Path | None:
    """Folder of the first of ``known`` that is there; None when there is none."""
    found = (find_model(model, hub_cache) for model in known)
    return next((path for path in found if path is not None), None)
