"""Weights on this machine: where they are searched, and what to say when there are none.

Nothing is downloaded here (that is `download`, after a person's consent). Searched, in this order:
a path that the user names, the folder of models of this program (`models_folder`), the user's own
cache of the Hugging Face hub.
"""

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

import msgspec

from gaga_core.errors import GagaError
from gaga_core.io.files import explain_os_error
from gaga_core.io.json_file import MOST_BYTES, decode_json, read_bytes
from gaga_core.segmentation.models.catalogue import KnownModel

_SAMPLES, _SAMPLE_BYTES = 16, 1 << 16  # of each weights file that are hashed
_WEIGHT_SUFFIXES = (".safetensors", ".bin", ".pth", ".pt")


@dataclass(frozen=True)
class Weights:
    """Weights that are there."""

    path: Path  # a folder with config.json, or a .pth file
    model_type: str  # transformers' name: "sam2", "mask2former", ...; "sam" for .pth files

    @property
    def family(self) -> str:
        """The family, "" for a model that makes no masks here."""
        return family_of(self.model_type)


def family_of(model_type: str) -> str:
    """The family of a transformers model type, "" when it is none of ours."""
    if model_type in ("sam", "sam_hq", "sam2", "sam2_video", "sam3_tracker", "sam3_video"):
        return "sam"
    if model_type in ("mask2former", "maskformer", "eomt", "eomt_dinov3"):
        return "universal"
    return ""


def models_folder() -> Path:
    """The folder of models: GAGA_MODELS, else "models" in the user's folder."""
    chosen = os.environ.get("GAGA_MODELS")
    if chosen:
        return Path(chosen)
    home = os.environ.get("GAGA_HOME")
    if home:
        return Path(home) / "models"
    if os.name == "nt":
        base = os.environ.get("LOCALAPPDATA") or str(Path.home() / "AppData" / "Local")
    else:
        base = os.environ.get("XDG_DATA_HOME") or str(Path.home() / ".local" / "share")
    return Path(base) / "gaga-studio" / "models"


def find_weights(model: KnownModel, hub_cache: Path | None = None) -> Weights | None:
    """Weights of ``model`` in the folder of models or the user's hub cache; None if in neither.

    ``hub_cache`` overrides the place that the environment (HF_HOME, HF_HUB_CACHE) says.
    """
    found = find_model(model, hub_cache)
    return weights_at(found) if found is not None else None


def find_model(model: KnownModel, hub_cache: Path | None = None) -> Path | None:
    """Where `find_weights` finds a model of any kind: its folder, or its checkpoint."""
    base = models_folder()
    for place in (base / model.name, base / model.hub.split("/")[-1]):
        if is_model_folder(place):
            return place
    if model.file and (base / model.file).is_file():
        return base / model.file
    return _hub_snapshot(model.hub, hub_cache)


def weights_at(path: Path) -> Weights:
    """The model at a path that the user named; ``GagaError`` when it is no model for masks."""
    if path.is_file():
        if path.suffix.lower() not in (".pth", ".pt"):
            raise GagaError(
                f"{path} is no checkpoint. Choose a sam_vit_*.pth file, or the folder of a model "
                "(config.json and model.safetensors)."
            )
        return Weights(path, "sam")
    if not path.is_dir():
        raise GagaError(f"{path} does not exist. Choose a model's folder or a sam_vit_*.pth file.")
    if not is_model_folder(path):
        raise GagaError(
            f"{path} is no folder of a model: it needs config.json and model.safetensors. "
            "Copy both from the model's page."
        )
    model_type = model_type_of(path)
    if not family_of(model_type):
        raise GagaError(
            f"The model in {path} is of type {model_type or 'unknown'}, which makes no masks here. "
            "Choose a SAM, SAM-HQ, SAM 2, SAM 3, Mask2Former, MaskFormer or EoMT model."
        )
    return Weights(path, model_type)


def is_model_folder(path: Path) -> bool:
    """Whether ``path`` holds a model of transformers with its weights."""
    return (path / "config.json").is_file() and bool(_weight_files(path))


def own_models(known: tuple[KnownModel, ...]) -> dict[str, Weights]:
    """Models for masks that the user has put into the folder of models under other names."""
    base = models_folder()
    if not base.is_dir():
        return {}
    taken = {model.name for model in known} | {model.hub.split("/")[-1] for model in known}
    found = {}
    for path in sorted(base.iterdir()):
        if path.name not in taken and path.is_dir() and is_model_folder(path):
            model_type = model_type_of(path)
            if family_of(model_type):
                found[path.name] = Weights(path, model_type)
    return found


def where_to_put(model: KnownModel) -> str:
    """One sentence: which files belong where."""
    base = models_folder()
    is_of_masks = model.purpose == "masks"
    files = "config.json, preprocessor_config.json and model.safetensors"
    text = (
        f"Get it with gaga models get {model.name}, or under Models in the window. By hand: put "
        f"{files if is_of_masks else 'all files'} of {model.page} "
        f"(about {model.megabytes} MB, {model.licence}) into {base / model.name}"
    )
    return text + (f", or {model.file} into {base}." if model.file else ".")


def weights_id(weights: Weights) -> str:
    """Hash of the weights: names, sizes, the config and samples of each file (a gigabyte takes
    long to read whole)."""
    digest = hashlib.sha256()
    path = weights.path
    files = [path] if path.is_file() else _weight_files(path)
    try:
        if path.is_dir():
            digest.update((path / "config.json").read_bytes())
        for file in files:
            size = file.stat().st_size
            digest.update(f"{size}".encode())
            with file.open("rb") as stream:
                for i in range(_SAMPLES):
                    stream.seek(max(0, (size - _SAMPLE_BYTES) * i // (_SAMPLES - 1)))
                    digest.update(stream.read(_SAMPLE_BYTES))
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    return digest.hexdigest()[:32]


class _Config(msgspec.Struct, frozen=True):
    """What we read of a config.json of the hub."""

    model_type: str = ""


def _weight_files(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return sorted(p for p in folder.iterdir() if p.suffix in _WEIGHT_SUFFIXES and p.is_file())


def model_type_of(folder: Path) -> str:
    """What the configuration of a model says that it is; "" when it does not."""
    path = folder / "config.json"
    raw = read_bytes(path, "", MOST_BYTES)
    try:
        return decode_json(raw, _Config, str(path), "").model_type
    except GagaError:
        return ""


def _hub_snapshot(repository: str, cache: Path | None) -> Path | None:
    """The newest whole snapshot of a repository in the hub's cache; never asks the network."""
    try:
        from huggingface_hub import try_to_load_from_cache
    except ImportError:
        return None
    found = try_to_load_from_cache(repository, "config.json", cache_dir=cache)
    if not isinstance(found, str):
        return None
    folder = Path(found).parent
    return folder if is_model_folder(folder) else None
