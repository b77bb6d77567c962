"""Notices and questions for the user, errors that become notices, requests to the window."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum, StrEnum, auto
from functools import wraps
from pathlib import Path
from typing import Concatenate, ParamSpec, Protocol, TypeVar

from gaga_core.errors import GagaError

HINT_SECONDS = 4.0  # how long a hint is shown, as a card or in the status bar: two lines are read


class Level(StrEnum):
    """Severity of a notice."""

    HINT = "hint"  # nothing was done, and nothing went wrong
    INFO = "info"  # something was done
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True)
class Notice:
    """One sentence for the user."""

    level: Level
    text: str
    command: str = ""  # id of one that the notice offers
    time: float = field(default_factory=time.monotonic)  # seconds, ``time.monotonic``
    shows: Path | None = None  # what was written: it can be shown in its folder
    otherwise: str = ""  # id of the other answer: the notice is a question, and stays until then
    of_task: str = ""  # title of the one that failed: gone when it is tried again


class NothingSelectedError(GagaError):
    """An edit of the selection was asked for, and nothing is selected."""

    def __init__(self) -> None:
        super().__init__("Nothing is selected. Click an object first.")


class PreviewWaitsError(GagaError):
    """Something else was asked for while a preview waits to be applied or cancelled."""

    def __init__(self, name: str) -> None:
        super().__init__(f"Apply or cancel (Esc) the preview of {name} first.")


class Notifier(Protocol):
    """Something that shows notices: the session."""

    def notify(self, level: Level, text: str, command: str = "") -> None:
        """Tell the user one sentence."""
        ...


S = TypeVar("S", bound=Notifier)
P = ParamSpec("P")


def notifies(action: Callable[Concatenate[S, P], object]) -> Callable[Concatenate[S, P], bool]:
    """Decorate an action: what the user can correct becomes a notice, and it returns False.

    Any other result becomes a bool: whether the action did something.
    """

    @wraps(action)
    def notified(session: S, /, *args: P.args, **kwargs: P.kwargs) -> bool:
        try:
            return bool(action(session, *args, **kwargs))
        except (NothingSelectedError, PreviewWaitsError) as error:
            session.notify(Level.HINT, str(error))
        except GagaError as error:
            session.notify(Level.ERROR, str(error))
        return False

    return notified


@dataclass(frozen=True, eq=False)
class UserQuestion:
    """Something that must be answered before the session goes on; the window shows it as a modal.

    The last choice is the one that changes nothing (Escape); Enter takes the first one, except
    where each of the others ``loses`` something. ``is_past`` says that its text is no longer
    true, because a task has ended for example: then ``again`` asks a new question.
    """

    text: str
    choices: tuple[str, ...]
    on_choice: Callable[[str], None]
    is_past: Callable[[], bool] = lambda: False
    again: Callable[[], None] = lambda: None
    loses: bool = False

    @property
    def by_enter(self) -> str:
        """The choice that Enter takes."""
        return self.choices[-1 if self.loses else 0]


def choose_one(
    text: str,
    choices: Mapping[str, Callable[[], None]],
    is_past: Callable[[], bool] = lambda: False,
    again: Callable[[], None] = lambda: None,
    *,
    loses: bool = False,
) -> UserQuestion:
    """Build the question that does one of ``choices``, or nothing ("Cancel").

    ``loses``: each of them loses something, so Enter is "Cancel".
    """

    def chosen(choice: str) -> None:
        if choice in choices:
            choices[choice]()

    return UserQuestion(text, (*choices, "Cancel"), chosen, is_past, again, loses)


class Request(Enum):
    """One request; exactly one dialog registers itself for each (`ui.kit.requests`)."""

    # Sheets and menus over the window.
    COMMAND_LIST = auto()
    SHORTCUTS = auto()
    ABOUT = auto()
    PREFERENCES = auto()
    MAKE_MASKS = auto()
    EXPORT_MASKS = auto()
    DATASET = auto()
    MODELS = auto()
    REDUCE = auto()
    CHANGES = auto()
    FIND_OBJECTS = auto()
    ADD_VIEWS = auto()
    EXPORT_OBJECTS = auto()
    MAKE_SPLATS = auto()
    SAVE_FILM = auto()
    SAVE_PICTURE = auto()
    OBJECT_MENU = auto()  # of the object under the mouse
    SCENE_MENU = auto()  # where no object is under the mouse
    PANELS_BACK = auto()  # all to their places
    # A text field that takes the keyboard.
    RENAME = auto()
    FIND = auto()
    FIND_IN_VIEW = auto()  # the text that is there already
    # A panel that comes to the front.
    TIMELINE = auto()
    HISTORY = auto()
    CAMERA_PATH = auto()
    RECOLOR = auto()  # and the colors to choose from
    # A path of the file dialog.
    OPEN_FOLDER = auto()
    OPEN_FILE = auto()
    OPEN_PHOTOS = auto()
    OBJECT_MASKS = auto()
    ADD_SPLATS = auto()
    ADD_SCENE = auto()
    IMPORT_MASK_FOLDER = auto()
    IMPORT_MASK_FILE = auto()
    SAVE_AS = auto()
    SAVE_SCRIPT = auto()
    EXPORT_SCENE = auto()
    EXPORT_PAGE = auto()
    EXPORT_MESHES = auto()
    EXPORT_SIMULATION = auto()
    EXPORT_SELECTED = auto()
    EXPORT_CAMERAS = auto()
    INPAINTING_MODEL = auto()
    OPEN_PATH = auto()  # of the camera
    SAVE_PATH = auto()
