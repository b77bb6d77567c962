"""The way through the program in five steps: a calm card in the lower left corner of the picture.

Each step ticks itself when it is done. The card covers neither the offer of the next stage nor the
middle of the picture: where there is no room for five lines it is one line, the next step.
"""

from dataclasses import dataclass, field, replace

from imgui_bundle import ImVec2, imgui

from gaga_core.scene.scene import Scene, State
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.picture_area import PictureArea
from gaga_studio.ui.kit.theme import em

STEPS = (
    ("open", "Open a scene, photos or the demo"),
    ("find", "Find its objects"),
    ("click", "Click an object"),
    ("change", "Hide, color or move it"),
    ("export", "Export what you made"),
)
_TRAIN = ("train", "Make splats of the photos")  # the second step, where photos were opened
_WIDTH, _LINE, _GAP = 17.0, 1.55, 0.7  # ems
_HIGH = 1.9 + len(STEPS) * _LINE + 1.2  # title, steps, padding


@dataclass
class FirstSteps:
    """Which of `STEPS` were done, in this run of the program and in former ones."""

    done: set[str] = field(default_factory=set)
    has_photos: bool = False  # photos without splats were opened
    is_alone: bool = False  # a file of splats: no photos to find objects in, a click takes one
    _is_read: bool = False  # what was done in former runs
    _document: int = 0
    _state: int = -1  # of the history when it was last looked at
    _look: "Look | None" = None  # at the scene, the last one
    _selected: tuple[int, ...] = ()  # objects, as the scene was opened: nobody clicked them

    @property
    def steps(self) -> tuple[tuple[str, str], ...]:
        """All steps of what was opened."""
        if self.has_photos:
            return (STEPS[0], _TRAIN, *STEPS[1:])
        return tuple(step for step in STEPS if step[0] != "find" or not self.is_alone)

    def follow(self, session: Session) -> None:
        """Tick what is done by now, and keep it for the next run; once all is, put them away."""
        if not self._is_read:
            self._is_read = True
            self.done |= set(session.settings.steps_done)
            if not self.next:
                session.change_settings(replace(session.settings, first_steps_done=True))
        self._tick(session)
        done = tuple(sorted(self.done))
        if done != session.settings.steps_done:
            session.change_settings(replace(session.settings, steps_done=done))

    def _tick(self, session: Session) -> None:
        document = session.document
        if session.has_exported:
            self.done.add("export")
        if session.photos is not None or session.training is not None:
            self.done.add("open")
            self.has_photos = True
        if document is None:
            return
        if self._document != id(document):
            if self._document and not self.next:  # it is not shown over the next scene
                session.change_settings(replace(session.settings, first_steps_done=True))
            self._document, self._state, self._look = id(document), -1, look_of(document.scene)
            self._selected = session.selected_groups()
        self.done |= {"open", "train"} if self.has_photos else {"open"}
        if document.history.is_previewing:  # what is shown then is not done yet
            return
        if document.read.has_groups():
            self.done.add("find")
        self.is_alone = document.project.folder is None and "find" not in self.done
        selected = session.selected_groups()
        self._selected = self._selected if selected else ()
        is_clicked = selected != self._selected if "find" in self.done else self.is_alone
        if is_clicked and len(session.selected_indices()) > 0:
            self.done.add("click")
        if document.history.state_id == self._state or "change" in self.done:
            return
        self._state, look = document.history.state_id, look_of(document.scene)
        if "click" in self.done and self._look is not None and look.is_changed_since(self._look):
            self.done.add("change")
        self._look = look

    @property
    def next(self) -> int:
        """Number of the first step that is not done, from 1; 0 when all are."""
        return next((i for i, (name, _) in enumerate(self.steps, 1) if name not in self.done), 0)


@dataclass(frozen=True)
class Look:
    """What changes when something is hidden, colored, moved or deleted; not by making objects."""

    n: int  # splats: more are a copy, which is none of that
    states: tuple[int, int]  # hidden and deleted splats
    placed: tuple[int, int]  # revisions
    world: bytes  # how the scene is moved as a whole, which is none of that either

    def is_changed_since(self, before: "Look") -> bool:
        """Whether one of them was done."""
        is_of_scene = self.n != before.n or self.world != before.world
        return self.states != before.states or (not is_of_scene and self.placed != before.placed)


def look_of(scene: Scene) -> Look:
    """Return what is seen of ``scene`` now."""
    hidden, deleted = (int(scene.has(state).sum()) for state in (State.HIDDEN, State.DELETED))
    revision = scene.revision
    placed = revision.placement, revision.placements
    return Look(len(scene), (hidden, deleted), placed, scene.frame.world.tobytes())


@dataclass(frozen=True)
class CardPlace:
    """Position of the card, pixels of the screen."""

    left: float
    bottom: float
    width: float
    is_whole: bool  # all five lines


def place(area: PictureArea, foot: float, unit: float, n: int = len(STEPS)) -> CardPlace | None:
    """Where the card fits into the picture above the y of ``foot``; None: nowhere.

    ``unit`` is one em. The ``n`` lines need room next to the middle third, or below it, and none of
    the card of a training.
    """
    left, top, width, height = area.left, area.top, area.width, area.height
    bottom = min(foot, area.bottom) - _GAP * unit
    wide, high = _WIDTH * unit, (_HIGH + (n - len(STEPS)) * _LINE) * unit
    is_next_to = left + _GAP * unit + wide <= left + width / 3
    below = bottom - high >= top + height * 2 / 3
    is_free = bottom - high >= area.live_bottom
    if is_free and ((is_next_to and bottom - high >= top + 3 * unit) or below):
        return CardPlace(left + _GAP * unit, bottom, wide, True)
    strip = min(20 * unit, width - 2 * _GAP * unit)
    highest = bottom - 2.2 * unit
    if strip < 9 * unit or highest < max(top + height * 2 / 3, area.live_bottom):
        return None
    return CardPlace(left + _GAP * unit, bottom, strip, False)


def draw(
    session: Session, area: PictureArea, progress: FirstSteps, *, is_covered: bool = False
) -> None:
    """The card, unless it was put away, or the place ``is_covered``."""
    progress.follow(session)
    area.steps_height = 0.0
    if session.settings.first_steps_done or is_covered or not area.width:
        return
    is_open = session.document is not None
    if not is_open and area.height < em(20):  # the ways to begin need all of it
        return
    foot = area.offer_top if is_open else area.bottom
    where = place(area, foot, em(), len(progress.steps))
    if where is None:
        return
    if not is_open:  # the ways to begin are in the middle: one line at the foot
        where = replace(where, is_whole=False, width=min(em(20), area.width - em(1.4)))
        area.steps_height = em(3)
    imgui.set_next_window_pos(ImVec2(where.left, where.bottom), imgui.Cond_.always, ImVec2(0, 1))
    imgui.set_next_window_size_constraints(ImVec2(where.width, 0), ImVec2(where.width, em(40)))
    shown = _card if where.is_whole else _strip
    imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(em(0.6), em(0.5)))
    widgets.floating_card("First steps", lambda: shown(session, progress))
    imgui.pop_style_var()


def _card(session: Session, progress: FirstSteps) -> None:
    at = progress.next
    imgui.align_text_to_frame_padding()
    with theme.face(strong=True):
        imgui.text_unformatted("First steps" if at else "All steps done")
    _close(session)
    for number, (name, text) in enumerate(progress.steps, 1):
        _step(text, name in progress.done, number == at)


def _step(text: str, is_done: bool, is_next: bool) -> None:
    widgets.text(
        icons.SUCCESS if is_done else icons.RINGS,
        theme.GOOD if is_done else theme.ACCENT if is_next else theme.FAINT,
    )
    imgui.same_line(0, em(0.5))
    widgets.line(text, theme.DIM if is_done else theme.TEXT)


def _strip(session: Session, progress: FirstSteps) -> None:
    at = progress.next
    imgui.align_text_to_frame_padding()
    widgets.text(
        f"{at} / {len(progress.steps)}" if at else icons.SUCCESS,
        theme.ACCENT if at else theme.GOOD,
    )
    imgui.same_line(0, em(0.6))
    imgui.align_text_to_frame_padding()
    room = imgui.get_content_region_avail().x - em(2)
    steps = progress.steps
    imgui.text_unformatted(widgets.elided(steps[at - 1][1] if at else "All steps done", room))
    widgets.tooltip("\n".join(f"{i}. {text}" for i, (_, text) in enumerate(steps, 1)))
    _close(session)


def _close(session: Session) -> None:
    imgui.same_line(imgui.get_window_width() - em(2.1))
    if widgets.small_icon("Put away", icons.CLOSE, hint="Close; reopen it from Help"):
        session.change_settings(replace(session.settings, first_steps_done=True))
