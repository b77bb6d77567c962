"""What a command is."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level
from gaga_studio.session.requests import Request
from gaga_studio.session.session import Session

# --- What a command is.


Reason = Callable[[Session], str]
ViewSwitch = Literal[
    "show_frusta",
    "show_outline",
    "show_box",
    "show_panels",
    "show_info",
    "show_cube",
    "takes_splats",
    "visible_only",
    "snaps",
    "local_axes",
    "lights_masks",
    "has_mask_gate",
    "folder_colors",
    "uses_lod",
]  # fields of `ViewState` that are on or off


def always(_: Session) -> str:
    """No reason against it."""
    return ""


@dataclass(frozen=True)
class Command:
    """Something that a person can do from anywhere.

    Shortcuts are written as on the keys, by character: "Ctrl+Shift+Z", "Delete", "/"; modifiers in
    the order Ctrl, Shift, Alt.
    """

    id: str
    title: str
    run: Callable[[Session], object]
    shortcut: str = ""
    aliases: tuple[str, ...] = ()
    enabled: Reason = always  # "" when it can be run, else why not
    is_on: Callable[[Session], bool] | None = None  # of what can be switched on and off
    describe: Callable[[Session], str] | None = None  # title of the moment: "Undo Move chair"

    def title_now(self, session: Session) -> str:
        """Title for the menu at this moment."""
        return self.describe(session) if self.describe is not None else self.title


def ask(request: Request) -> Callable[[Session], None]:
    """Return an action that asks the window for this (see `Session.take_request`)."""

    def run(session: Session) -> None:
        session.request = request

    return run


def switch(
    id_: str, title: str, name: ViewSwitch, shortcut: str = "", enabled: Reason = always
) -> Command:
    """Build a command that switches a field of the view on and off."""

    def run(session: Session) -> None:
        setattr(session.view, name, not getattr(session.view, name))

    return Command(
        id_, title, run, shortcut, enabled=enabled, is_on=lambda s: getattr(s.view, name)
    )


# --- Check that the result of a job still fits what is open.


def watch(
    session: Session, document: Document, is_same: Callable[[], bool], text: str
) -> Callable[[], bool]:
    """Return a check for the end of a job: is ``document`` still open, and ``is_same`` true?

    When ``is_same`` is false, the user gets the notice ``text``.
    """

    def check() -> bool:
        if session.document is not document:
            return False
        if is_same():
            return True
        session.notify(Level.WARNING, text)
        return False

    return check
