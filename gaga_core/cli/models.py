"""The command for weights of models: which are known, get one after consent, remove it, where."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg, subcommand

from gaga_core.cli import output as out
from gaga_core.cli.output import AsJson
from gaga_core.errors import GagaError

if TYPE_CHECKING:
    from gaga_core.segmentation.models.catalogue import KnownModel
    from gaga_core.segmentation.models.hub import HubConfig

_NO_CONSENT = 2  # exit status


@dataclass(frozen=True)
class ListModels:
    """Print every known model: licence, size, what it is good for, seconds a photo, if it is here.

    Asks no network.
    """

    json: AsJson = False

    def run(self) -> int:
        """Print the list."""
        from gaga_core.segmentation.models.status import all_models
        from gaga_core.segmentation.models.weights import models_folder

        entries = [entry.to_json() for entry in all_models()]
        if self.json:
            return out.result({"folder": str(models_folder()), "models": entries}, as_json=True)
        rows = [["name", "for", "here", "about MB", "licence", "s a photo"]]
        for entry in entries:
            seconds = entry["seconds_a_photo"]
            about = "" if entry["is_measured"] else "about "
            unknown = "not known" if entry["purpose"] == "masks" else ""
            shown = f"{about}{seconds:.2g}" if isinstance(seconds, float) else unknown
            here = "yes" if entry["is_here"] else "no"
            size, licence = f"{entry['megabytes']:,}", str(entry["licence"])
            rows.append([str(entry["name"]), str(entry["purpose"]), here, size, licence, shown])
        out.table(rows)
        out.say(
            f"Models lie in {models_folder()}. Sizes are approximate; gaga models get NAME "
            "shows licence and exact size, and downloads nothing without your consent."
        )
        return 0


@dataclass(frozen=True)
class GetModels:
    """Download models from the Hugging Face hub or a mirror, once you have accepted their licences.

    Only safetensors, configurations and tokenizer files. Each file's hash is checked against what
    the hub states; the commit and the hashes are written into model.lock.json next to the weights.
    A download that was stopped goes on where it was. Without --accept-licence nothing is
    downloaded: the licence and the size are shown, and the exit status is 2.
    """

    names: Positional[tuple[str, ...]] = ()
    """Models, as gaga models list names them; may be left out with --lock."""
    accept_licence: tuple[str, ...] = ()
    """Licences that you accept, by their names or by those of the models."""
    endpoint: str = ""
    """Address of a mirror of the hub; default: HF_ENDPOINT, else https://huggingface.co."""
    offline: bool = False
    """Ask no network: say what is missing (as HF_HUB_OFFLINE=1 does)."""
    revision: str = "main"
    """Branch, tag or commit of the repository."""
    lock: Path | None = None
    """A model.lock.json: get exactly the files that it names, of its commit."""
    json: AsJson = False

    def run(self) -> int:
        """Download what is missing."""
        from gaga_core.segmentation.models.catalogue import known_model
        from gaga_core.segmentation.models.download import read_lock
        from gaga_core.segmentation.models.hub import HubConfig

        names = self.names or ((read_lock(self.lock).name,) if self.lock is not None else ())
        if not names:
            raise GagaError("Name a model. gaga models list shows them.")
        config = HubConfig(self.endpoint, self.offline)
        results, status = [], 0
        for model in [known_model(name) for name in names]:
            installed = self._get(model, config)
            if installed is None:
                status = _NO_CONSENT
                continue
            results.append(installed)
            if not self.json:
                out.say(f"{model.title} is in {installed['path']}.")
        if status == 0 or results:
            out.result({"models": results} if self.json else {}, as_json=self.json)
        return status

    def _get(self, model: "KnownModel", config: "HubConfig") -> dict[str, object] | None:
        """What is here now; None without consent."""
        from gaga_core.segmentation.models.download import (
            Consent,
            Installed,
            check_against,
            check_folder,
            download,
            read_lock,
        )
        from gaga_core.segmentation.models.hub import list_files, terms
        from gaga_core.segmentation.models.weights import find_model

        lock = read_lock(self.lock) if self.lock is not None else None
        here = find_model(model)
        if here is not None:
            if lock is not None:
                check_folder(here, lock)
            return Installed(model, here, 0).to_json()
        try:
            listing = list_files(model, config, revision=lock.commit if lock else self.revision)
        except GagaError:
            if self._accepts(model, model.licence):
                raise
            listing = None  # without consent the approximate size will do
        licence = listing.licence_name if listing is not None else model.licence
        if listing is None or not self._accepts(model, licence):
            out.fail(
                f"{terms(model, listing)} Nothing was downloaded: read the licence, and repeat "
                f"with --accept-licence {model.name}."
            )
            return None
        if lock is not None:
            listing = check_against(listing, lock)
        return out.follow(download(listing, Consent(model.name, licence), config)).to_json()

    def _accepts(self, model: "KnownModel", licence: str) -> bool:
        """Whether the person accepted it, by the model's name or by that of its licence."""
        given = {text.casefold() for text in self.accept_licence}
        return bool(given & {name.casefold() for name in (model.name, model.hub, licence)})


@dataclass(frozen=True)
class RemoveModels:
    """Delete models from the folder of models, and what a stopped download left of them."""

    names: Positional[tuple[str, ...]]
    """Models, as gaga models list names them."""
    json: AsJson = False

    def run(self) -> int:
        """Delete them."""
        from gaga_core.segmentation.models.catalogue import known_model
        from gaga_core.segmentation.models.download import remove

        if not self.names:
            raise GagaError("Name a model. gaga models list shows them.")
        removed = {}
        for model in [known_model(name) for name in self.names]:
            folder = remove(model)
            removed[model.name] = str(folder or "")
            out.say(f"Removed {folder}." if folder else f"{model.title} is not here.")
        return out.result({"removed": removed} if self.json else {}, as_json=self.json)


@dataclass(frozen=True)
class WhereModels:
    """Print the folder of models, or where those that are named lie."""

    names: Positional[tuple[str, ...]] = ()
    """Models; none: the folder of all."""
    json: AsJson = False

    def run(self) -> int:
        """Print paths; exit status 1 when a model that was named is not here."""
        from gaga_core.segmentation.models.catalogue import known_model
        from gaga_core.segmentation.models.weights import find_model, models_folder

        found = {name: find_model(known_model(name)) for name in self.names}
        if self.json:
            paths = {name: str(path or "") for name, path in found.items()}
            out.result({"folder": str(models_folder()), "models": paths}, as_json=True)
        elif not found:
            out.line(str(models_folder()))
        for name, path in found.items():
            if path is None:
                out.fail(f"{name} is not here. Get it with gaga models get {name}.")
            elif not self.json:
                out.line(str(path))
        return 1 if None in found.values() else 0


AnyModelsCommand = (
    Annotated[ListModels, subcommand("list")]
    | Annotated[GetModels, subcommand("get")]
    | Annotated[RemoveModels, subcommand("remove")]
    | Annotated[WhereModels, subcommand("where")]
)


@dataclass(frozen=True)
class ModelsCommand:
    """List, get, remove models of masks and words. Nothing is downloaded without your consent."""

    action: Annotated[AnyModelsCommand, arg(name="")]

    def run(self) -> int:
        """Run the action."""
        return self.action.run()
