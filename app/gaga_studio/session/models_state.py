"""What the sheet of models shows: the known models here, terms that wait for an answer."""

from collections.abc import Callable
from dataclasses import dataclass

from gaga_core.models.catalogue import KnownModel
from gaga_core.models.hub import Listing
from gaga_core.models.status import ModelStatus


@dataclass
class ModelsState:
    """State of the sheet; `actions.models` changes it."""

    entries: tuple[ModelStatus, ...] = ()  # as last looked at; empty = look when it is shown
    offered: Listing | None = None  # its licence and size are shown, the user has not answered
    removing: KnownModel | None = None  # the user is asked whether
    then: Callable[[], object] | None = None  # what the offered model was wanted for

    def entry(self, name: str) -> ModelStatus | None:
        """The entry of a model, None before they were looked at."""
        return next((entry for entry in self.entries if entry.model.name == name), None)
