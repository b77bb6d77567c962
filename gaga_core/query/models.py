"""Which model is meant: a folder, or one known by name that the user has put in its place."""

from pathlib import Path

from gaga_core.errors import GagaError
from gaga_core.models.catalogue import KNOWN_DETECTORS, KNOWN_EMBEDDERS, KnownModel
from gaga_core.models.weights import find_model, is_model_folder, models_folder

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


def where_to_put_all(model: KnownModel) -> str:
    """One sentence: which files belong where, the words' files included."""
    return (
        f"Get it with gaga models get {model.name}, or under Models in the window. "
        f"By hand: put all files of {model.page} (about {model.megabytes} MB, {model.licence}) "
        f"into {models_folder() / model.name}."
    )
