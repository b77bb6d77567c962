"""What the session tells a person, and what it asks."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum


class Level(StrEnum):
    """How much a notice matters."""

    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True)
class Notice:
    """One sentence for the user."""

    level: Level
    text: str
    time: float = field(default_factory=time.monotonic)  # seconds, ``time.monotonic``


@dataclass(frozen=True, eq=False)
class Question:
    """Something that must be answered before the session goes on; the window shows it as a modal.

    The last choice is the one that changes nothing (Escape).
    """

    text: str
    choices: tuple[str, ...]
    on_choice: Callable[[str], None]


def unsaved_question(text: str, save: Callable[[], None], discard: Callable[[], None]) -> Question:
    """Save, discard, or cancel."""

    def chosen(choice: str) -> None:
        if choice == "Save":
            save()
        elif choice == "Discard":
            discard()

    return Question(text, ("Save", "Discard", "Cancel"), chosen)
