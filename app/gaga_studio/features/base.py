"""The command type, conditions that features compose, and the check at the end of a job."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, Literal, TypeVar

from gaga_core.errors import GagaError
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.scene.edits import Edit
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level, NothingSelectedError, PreviewWaitsError, Request
from gaga_studio.session.session import Session

T = TypeVar("T")
Reason = Callable[[Session], str]  # why not; "" when nothing is against it
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

SettingSwitch = Literal["children_go_along", "clean_first"]  # fields of `Settings`


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
    enabled: Reason = lambda _: ""  # "" when it can be run, else why not
    is_on: Callable[[Session], bool] | None = None  # of what can be switched on and off
    describe: Callable[[Session], str] | None = None  # current title: "Undo Move chair"

    def title_now(self, session: Session) -> str:
        """Title for the menu at this moment."""
        return self.describe(session) if self.describe is not None else self.title


def ask(
    id_: str,
    title: str,
    request: Request,
    shortcut: str = "",
    aliases: tuple[str, ...] = (),
    enabled: Reason = lambda _: "",
) -> Command:
    """Build a command that asks the window for something (see `Session.take_request`)."""

    def run(session: Session) -> None:
        session.request = request

    return Command(id_, title, run, shortcut, aliases, enabled)


def switch(
    id_: str,
    title: str,
    name: ViewSwitch,
    shortcut: str = "",
    enabled: Reason = lambda _: "",
    is_on: Callable[["Session"], bool] | None = None,
) -> Command:
    """Build a command that switches a field of the view on and off.

    ``is_on``: what holds, where that may be another thing than is chosen; it is not ``enabled``
    there.
    """

    def run(session: Session) -> None:
        setattr(session.view, name, not getattr(session.view, name))

    holds = is_on or (lambda s: getattr(s.view, name))
    return Command(id_, title, run, shortcut, enabled=enabled, is_on=holds)


def setting(id_: str, title: str, name: SettingSwitch) -> Command:
    """Build a command that switches a preference on and off."""

    def run(session: Session) -> None:
        is_on = getattr(session.settings, name)
        changed = replace(session.settings, **{name: not is_on})  # type: ignore[arg-type]
        session.change_settings(changed)

    return Command(id_, title, run, is_on=lambda s: getattr(s.settings, name))


# --- conditions: reasons why a command is disabled


def first_of(*reasons: Reason) -> Reason:
    """Return the first of these reasons that is against it."""
    return lambda session: next(filter(None, (reason(session) for reason in reasons)), "")


def needs(holds: Callable[[Session], object], text: str) -> Reason:
    """Build a condition on the open scene: ``text`` is the reason while ``holds`` is not true."""

    def reason(session: Session) -> str:
        if session.document is None:
            return without_scene(session)
        return "" if holds(session) else text

    return reason


def without_scene(session: Session) -> str:
    """The reason why what needs a scene cannot be: none is open, or photos without splats are."""
    if session.photos is None:
        return "No scene is open."
    return busy(session) or "There are no splats yet. Make them from the photos first."


def busy(session: Session) -> str:
    """Needs the job runner."""
    return session.jobs.why_busy


def preview_waits(session: Session) -> str:
    """Needs a scene that can be changed: what a task finds is lost where a preview waits."""
    waits = session.document.waiting if session.document is not None else ""
    return str(PreviewWaitsError(waits)) if waits else ""


def need_no_job(session: Session) -> None:
    """Raise ``GagaError`` while a job runs."""
    if reason := busy(session):
        raise GagaError(reason)


def not_one_object(session: Session) -> str:
    """Needs exactly one selected object."""
    if reason := no_selection(session):
        return reason
    n = len(session.selected_groups())
    return "" if n == 1 else f"{n} objects are selected. Select one." if n else "Select an object."


no_scene = needs(lambda session: True, "")
no_selection = needs(lambda session: len(session.selected_indices()), str(NothingSelectedError()))


def no_groups(session: Session) -> str:
    """Needs objects."""
    if session.document is None or session.live is not None or session.document.read.has_groups():
        return no_scene(session)
    return session.no_groups_text


no_confidence = needs(
    lambda session: session.need().scene.confidence is not None,
    "The confidence of the groups is not known. Use Find objects.",
)
no_photos = needs(lambda session: session.cameras, "This scene has no photos.")
not_saveable = first_of(no_scene, busy)
_without_masks = needs(
    lambda session: len(session.masks), "This scene has no masks. Use Make masks, or Import masks."
)
no_masks = first_of(not_saveable, preview_waits, _without_masks)
NO_BANK = "The masks of these objects are not known. Use Find objects first."
no_shown_bank = first_of(
    needs(lambda session: session.need().scene.bank is not None, NO_BANK), _without_masks
)
no_bank = first_of(no_shown_bank, no_masks)
no_views = first_of(no_photos, busy)
nothing_pointed = needs(
    lambda session: session.view.pointed is not None,
    "No point is chosen. Right-click one in the picture.",
)


# --- values of a document that features need


class Preview(Generic[T]):
    """A result that is shown until something else is done."""

    def __init__(self) -> None:
        self._held: tuple[T, Edit] | None = None

    def take(self, found: T, edit: Edit) -> None:
        """Note what was found, and the edit whose preview shows it."""
        self._held = found, edit

    def shown(self, session: Session) -> T | None:
        """Return what is shown now."""
        held, history = self._held, session.history
        return held[0] if held and history and held[1] is history.preview_edit else None


def one_object(session: Session, text: str = "Select one object.") -> int:
    """Return the only selected object; ``GagaError`` with ``text`` unless there is exactly one."""
    groups = session.selected_groups()
    if len(groups) != 1:
        raise GagaError(text)
    return groups[0]


def need_bank(session: Session) -> tuple[Document, MemoryBank]:
    """Return the open document and its memory bank; ``GagaError`` when it has none."""
    document = session.need()
    if document.scene.bank is None:
        raise GagaError(NO_BANK)
    return document, document.scene.bank


def watch(
    session: Session, document: Document, text: str, is_same: Callable[[], bool] | None = None
) -> Callable[[], bool]:
    """Return a check for the end of a job: is ``document`` still open, and ``is_same`` true?

    By default: is there no other edit and no preview? If not, the user gets the notice ``text``.
    """
    before = document.history.state_id

    def no_edit() -> bool:
        return document.history.state_id == before and not document.history.is_previewing

    def check() -> bool:
        if session.document is not document:
            return False
        if (is_same or no_edit)():
            return True
        session.notify(Level.WARNING, text)
        return False

    return check
