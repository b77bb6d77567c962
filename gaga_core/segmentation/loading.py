"""Models of transformers from a folder on disk: never from the network, never half-loaded."""

import logging
import os
import pickle
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from PIL import Image
from torch import Tensor
from torch.nn import Module

from gaga_core.arrays import FloatArray, UInt8Array
from gaga_core.errors import GagaError, cure_without
from gaga_core.segmentation.settings import Device

# What transformers and torch raise on damaged files; weights that are pickles are read as tensors
# alone, and one that names a function is an UnpicklingError.
_UNREADABLE = (
    OSError,
    ValueError,
    RuntimeError,
    LookupError,
    TypeError,
    AttributeError,
    ImportError,
    EOFError,
    MemoryError,
    OverflowError,
    pickle.UnpicklingError,
    zipfile.BadZipFile,
)
_OFFLINE = ("HF_HUB_OFFLINE", "TRANSFORMERS_OFFLINE")


def choose_device(wanted: Device = "auto") -> torch.device:
    """The device called ``wanted``; "auto" is CUDA where torch has it, else the processor.

    Raises ``GagaError`` when it is not there.
    """
    has = {"cuda": torch.cuda.is_available(), "mps": torch.backends.mps.is_available()}
    if wanted == "auto":
        return torch.device("cuda" if has["cuda"] else "cpu")
    if not has.get(wanted, wanted == "cpu"):
        raise GagaError(f"torch finds no device {wanted} here. Choose the device cpu.")
    return torch.device(wanted)


ModelKind = Literal[
    "mask_generation", "universal", "text_image", "text_boxes", "video_masks", "keypoint_matches"
]
_AUTO: dict[ModelKind, str] = {
    "mask_generation": "AutoModelForMaskGeneration",
    "universal": "AutoModelForUniversalSegmentation",
    "text_image": "AutoModel",  # CLIP, SigLIP
    "text_boxes": "AutoModelForZeroShotObjectDetection",  # Grounding DINO, OWLv2
    "video_masks": "Sam2VideoModel",  # SAM 2 with its memory
    "keypoint_matches": "AutoModelForKeypointMatching",  # EfficientLoFTR
}


def load_folder(kind: ModelKind, folder: Path) -> Module:
    """The model in ``folder`` (config.json, *.safetensors), on the processor, float32, frozen.

    Raises ``GagaError`` when transformers is missing, the folder holds another kind of model, or
    weights are missing: a model that is partly random would make plausible but wrong masks.
    """
    with offline():
        import transformers
        from safetensors import SafetensorError  # no OSError or ValueError of its own

        auto = getattr(transformers, _AUTO[kind])
        try:
            model, info = auto.from_pretrained(
                folder, local_files_only=True, output_loading_info=True, dtype=torch.float32
            )
        except (*_UNREADABLE, SafetensorError) as error:
            raise GagaError(
                f"The model in {folder} cannot be loaded ({first_line(error)}). "
                "Copy the whole folder again: config.json and model.safetensors belong together."
            ) from error
    lacking = [*info["missing_keys"], *info["mismatched_keys"]]
    if lacking:
        raise GagaError(
            f"The weights in {folder} do not fit its config.json: {len(lacking)} are missing "
            f"(first: {lacking[0]}). Copy the whole folder again."
        )
    return freeze(model)


def freeze(model: Module) -> Module:
    """``model`` ready for inference: no dropout, no gradients."""
    return model.eval().requires_grad_(False)


def normalized(
    image: UInt8Array, width: int, height: int, mean: tuple[float, ...], std: tuple[float, ...]
) -> Tensor:
    """Picture (H, W, 3) RGB -> (1, 3, height, width) float32, resized with pillow (bilinear)."""
    resized = Image.fromarray(image)
    if resized.size != (width, height):
        resized = resized.resize((width, height), Image.Resampling.BILINEAR)
    centre, spread = (np.array(values, np.float32) for values in (mean, std))
    unit: FloatArray = np.asarray(resized, np.float32) * np.float32(1 / 255)
    values = (unit - centre) / spread
    return torch.from_numpy(np.ascontiguousarray(values.transpose(2, 0, 1))[None])


def first_line(error: BaseException) -> str:
    """The text of an error in one line."""
    text = str(error).strip().splitlines()
    return text[0][:200] if text else type(error).__name__


@contextmanager
def offline() -> Iterator[None]:
    """Offline, and without transformers' bars and hints about packages that are not needed."""
    before = {name: os.environ.get(name) for name in _OFFLINE}
    os.environ.update(dict.fromkeys(_OFFLINE, "1"))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                from transformers.utils import logging as hints
            except ImportError as error:
                raise GagaError(
                    "This model needs the package transformers. "
                    f"Install it: {cure_without('models')}."
                ) from error
            verbosity, had_bar = hints.get_verbosity(), hints.is_progress_bar_enabled()
            hints.set_verbosity(logging.ERROR)
            hints.disable_progress_bar()  # type: ignore[no-untyped-call]
            try:
                yield
            finally:
                hints.set_verbosity(verbosity)
                if had_bar:
                    hints.enable_progress_bar()  # type: ignore[no-untyped-call]
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
