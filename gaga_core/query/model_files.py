"""A model of words in a folder as transformers saves it: network, and tokenizer or processor.

Read from disk, never downloaded; torch and transformers are imported when one is loaded.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeVar

import msgspec

from gaga_core.errors import GagaError
from gaga_core.io.json_file import read_foreign_json

if TYPE_CHECKING:
    from torch.nn import Module

    from gaga_core.segmentation.loading import ModelKind
    from gaga_core.segmentation.settings import Device

S = TypeVar("S", bound=msgspec.Struct)
Companion = Literal["AutoTokenizer", "AutoProcessor"]  # class of transformers


class ModelConfig(msgspec.Struct, frozen=True):
    """What is read of a model's config.json."""

    model_type: str = ""


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
    kind = read_or_default(folder / "config.json", ModelConfig()).model_type
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
