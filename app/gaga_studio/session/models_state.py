"""What the sheet of models shows: the known models here, terms that wait for an answer."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from gaga_core.segmentation.choose import ProviderEntry
from gaga_core.segmentation.models.catalogue import KnownModel
from gaga_core.segmentation.models.hub import Listing
from gaga_core.segmentation.models.status import ModelStatus

if TYPE_CHECKING:
    from gaga_core.segmentation.sam import Prompter


@dataclass
class ModelsState:
    """State of the sheet; `actions.models` changes it."""

    entries: tuple[ModelStatus, ...] = ()  # as last looked at; empty = look when it is shown
    offered: Listing | None = None  # its licence and size are shown, the user has not answered
    removing: KnownModel | None = None  # the user is asked whether
    then: Callable[[], object] | None = None  # what the offered model was wanted for
    promptable: tuple[ProviderEntry, ...] | None = None  # can be asked for one thing; None = look
    prompters: dict[str, "Prompter"] = field(default_factory=dict)  # loaded, by name of the model

    def entry(self, name: str) -> ModelStatus | None:
        """The entry of a model, None before they were looked at."""
        return next((entry for entry in self.entries if entry.model.name == name), None)
