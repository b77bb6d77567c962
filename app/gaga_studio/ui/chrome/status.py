"""The status bar: what a click does now, the running task, and figures of the picture."""

import time
from dataclasses import dataclass
from functools import lru_cache

from imgui_bundle import ImVec2, imgui

from gaga_core.errors import counted
from gaga_core.raster import backend_report
from gaga_studio.features import add_scene, cleanup, fill, reconstruction
from gaga_studio.features.base import preview_waits
from gaga_studio.features.find.association import in_minutes
from gaga_studio.session.jobs import Job
from gaga_studio.session.session import Session
from gaga_studio.tools.base import Tool
from gaga_studio.ui.kit import theme, widgets
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

# --- The status line: what a click does now, what is under the mouse, and which job runs.

_NARROW = 40.0  # em: a narrower bar has no room for figures next to a job
_LOOK_EVERY = 10.0  # seconds; a look asks the driver and the installed packages


@dataclass(frozen=True)
class Backend:
    """Who blends splats for association, votes and training (the picture is OpenGL's)."""

    name: str  # "CPU" or "CUDA"
    reason: str  # the device, or why CUDA is not used: a clause without a full stop

    @property
    def sentence(self) -> str:
        """What a tooltip says."""
        return f"Objects are found on the {self.name}: {self.reason}."


def backend() -> Backend:
    """The backend that a stage started now would choose; answers at once, starts no self-test."""
    return _look(int(time.monotonic() / _LOOK_EVERY))


@lru_cache(maxsize=1)
def _look(_period: int) -> Backend:
    name, reason = backend_report(wait=False)
    return Backend(name.upper(), reason)


def status_text(session: Session, tool: Tool, *, is_typing: bool = False) -> str:
    """One line, never empty. ``is_typing``: Enter and Esc go to a field."""
    document = session.document
    if document is None and session.hint:  # why a key did nothing
        return session.hint
    if session.training is not None and session.training.is_stopped:
        back = reconstruction.before_training(session)
        return f"Training has stopped. Continue it, keep these splats, or go back to {back}."
    if session.training is not None and session.training.scene is None:
        return "The photos are placed first. Then splats are shown here as they are trained."
    if session.training is not None:
        return "The splats are shown as they are trained. Drag orbits, the wheel zooms."
    if session.photos is not None:
        return "Make splats of these photos, or open something else."
    if document is None:
        return "Open a scene folder or a file of splats, or drop one here."
    if session.rig.is_flying:
        return "W A S D fly, Q down, E up, Shift fast, Alt slow; drag looks around. V ends flying."
    previews = (cleanup, fill, add_scene)
    if is_typing and any(one.shown(session) is not None for one in previews):
        return "Enter and Esc belong to the field. Apply or Cancel ends the preview."
    waits = preview_waits(session)
    if waits and session.notices and session.notices[-1].text == waits:
        return waits  # in small windows there is no room for the notice next to the preview
    if cleanup.shown(session) is not None:
        return "Enter applies the cleaning, Esc discards it. Drag orbits."
    if fill.shown(session) is not None:
        return "Enter applies the fill, Esc discards it. Drag orbits."
    if add_scene.shown(session) is not None:
        return "Enter adds the scene, Esc discards it. Drag orbits."
    if session.hint:
        return session.hint
    hint = tool.hint(session)
    hovered = session.hovered_group
    return f"{document.name_of(hovered)}  ·  {hint}" if hovered else hint


@dataclass(frozen=True)
class FrameFigures:
    """What the picture costs, and who draws it."""

    n_splats: int
    frame_ms: float  # of the last picture
    backend: str  # "llvmpipe, OpenGL 4.5"


def draw(session: Session, hint: str, figures: FrameFigures | None) -> None:
    """The whole bar; ``hint`` says what a click does now."""
    right = _figures_text(session, figures)
    left = imgui.get_cursor_pos_x()
    width = left + imgui.get_content_region_avail().x
    job = session.jobs.running or session.jobs.quiet or session.jobs.preparing
    if job is not None and width < em(_NARROW):
        right = ""
    tail = imgui.calc_text_size(right).x + em(1) if right else 0.0
    middle = _job_width(session, job, width - tail - left) if job is not None else 0.0
    imgui.align_text_to_frame_padding()
    room = width - tail - middle - em(1)
    if room > em(4):
        widgets.line(hint, theme.DIM, room)
    else:
        imgui.dummy(ImVec2(1, 1))
    if job is not None:
        imgui.same_line(width - tail - middle)
        _job(session, job, middle)
    if right:
        imgui.same_line(width - tail + em(1))
        imgui.align_text_to_frame_padding()
        widgets.dim(right)
        widgets.tooltip(backend().sentence)


_BAR, _SHORT_BAR, _CANCEL, _GAPS = 7.0, 3.5, 4.8, 1.9  # ems


def _job_width(session: Session, job: Job, room: float) -> float:
    """What the job's words, bar and button need; what a click does now gives way to them."""
    cancel = em(_CANCEL) if session.jobs.running is not None else 0.0
    words = imgui.calc_text_size(job_text(job)).x + cancel + em(_GAPS)
    return min(max(words + em(_BAR), em(24)), room)


def _job(session: Session, job: Job, width: float) -> None:
    cancel = em(_CANCEL) if session.jobs.running is not None else 0.0
    words = imgui.calc_text_size(job_text(job)).x
    bar = em(_BAR) if words + cancel + em(_GAPS + _BAR) <= width else em(_SHORT_BAR)
    room = width - cancel - bar - em(_GAPS - 0.1)
    text = job_text(job)
    if (wide := imgui.calc_text_size(text).x) > room:  # the share is read before the title, too
        of_title = imgui.calc_text_size(job.title).x
        title = widgets.elided(job.title, max(of_title - (wide - room), 0.0))
        text = widgets.elided(title + text.removeprefix(job.title), room)
    # The button stays where it is, whatever the words are.
    spare = max(room - imgui.calc_text_size(text).x, 0.0)
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + spare)
    imgui.align_text_to_frame_padding()
    imgui.text_unformatted(text)
    widgets.tooltip(job.message)
    imgui.same_line(0, em(0.6))
    fraction = job.fraction if job.fraction >= 0 else -imgui.get_time()
    top = imgui.get_cursor_pos_y()
    imgui.set_cursor_pos_y(top + (imgui.get_frame_height() - em(0.35)) / 2)
    imgui.progress_bar(fraction, ImVec2(bar, em(0.35)), "")
    imgui.same_line(0, em(0.6))
    imgui.set_cursor_pos_y(top)
    if not cancel:  # a quiet job: nothing waits for it
        imgui.dummy(ImVec2(1, 1))
        return
    why_not = "Already stopping" if job.is_cancelling else ""
    face = Face(width=cancel)
    if widgets.button("Cancel", face, why_not=why_not, hint="Stop; nothing is changed"):
        session.jobs.cancel()


def job_text(job: Job) -> str:
    """ "Find objects 45 %, under a minute left"; the step is named while the share is not known."""
    if job.is_cancelling:
        return f"{job.title}: stopping"
    if job.fraction < 0:
        names_step = not job.title.startswith(job.stage)
        return f"{job.title}: {job.stage[:1].lower()}{job.stage[1:]}" if names_step else job.title
    text = f"{job.title}  {100 * job.fraction:.0f} %"
    if job.eta_s is not None:
        text += f", {time_left(job.eta_s)}"
    return text


def time_left(seconds: float) -> str:
    """ "under a minute left" or "about 3 min left": no finer than it is known, as other programs
    may take the machine at any time."""
    return f"{'under a minute' if seconds < 60 else in_minutes(seconds)} left"


_TITLE_S = 1.0  # seconds: the window's title changes no more often while a task runs


class WindowTitle:
    """The title of the window: what runs and how far it is, then what is open.

    A task that ends within a second leaves it as it is.
    """

    def __init__(self) -> None:
        self._said_at, self._task = 0.0, ""

    def text(self, session: Session, now: float) -> str:
        """ "42 % Make splats - table - gaga-studio" at the time ``now``, seconds."""
        job = session.jobs.running
        if job is None:
            self._said_at, self._task = now, ""
        elif now - self._said_at >= _TITLE_S:
            self._said_at = now
            share = f"{100 * job.fraction:.0f} % " if job.fraction >= 0 else ""
            self._task = f"{share}{job.title}"
        return " - ".join(filter(None, (self._task, session.title, "gaga-studio")))


def _figures_text(session: Session, figures: FrameFigures | None) -> str:
    if figures is None or session.document is None or not session.view.show_info:
        return ""
    parts = [counted(figures.n_splats, "splat")]
    width = imgui.get_main_viewport().size.x
    if width > em(60):
        parts += [f"{figures.frame_ms:.0f} ms", figures.backend]
    if width > em(75):
        compute = backend()
        parts.append(f"{compute.name} ({compute.reason})" if width > em(130) else compute.name)
    return "   ".join(parts)
