"""Turn a scene upright whose file does not say which way its axes point, and remember that."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.splats.spz import states_axes
from gaga_core.scene import edits
from gaga_core.scene.orientation import guess_up, known_up
from gaga_core.scene.selection.bounds import splat_box
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.session import Session

COMMAND, LEAVE = "tool.turn_upright", "tool.leave_upright"
_TITLE = "Turn upright"
# Half around x: from right, up, back, which some programs write into .spz, to right, down, front.
_HALF_TURN = np.concatenate([np.diag([1.0, -1.0, -1.0]), np.zeros((3, 1))], axis=1)
_MOST = 100  # files that are remembered, newest first


@notifies
def turn(session: Session) -> bool:
    """Turn everything half around x; a second time it is as in the file.

    The file is turned from then on whenever it is opened, if it does not say how it stands.
    """
    if not _turn(session, is_content=True):
        return False
    _remember(session, is_turned=_name(session) not in session.settings.upright)
    return True


def why_not_turned(session: Session) -> str:
    """Needs a scene that does not stand upright by what is known: by its photos, by the answer of a
    person, by its file, or by its ground."""
    if session.document is None:
        return "No scene is open."
    if session.cameras:
        return "The photos say which way is up. Use Align to ground, or Rotate."
    if is_left(session):
        return "You said that it is upright. Choose It is upright again to take that back."
    document = session.document
    if _is_open_question(document.project.model_path):
        return ""
    up, gaussians = session.rig.up, document.scene.gaussians
    states = document.project.model_path.suffix.lower() == ".spz"
    decided = document.read.once("known up", (gaussians, states), lambda: _known(gaussians, states))
    if decided is None:
        return ""
    known, who = decided
    now = document.world[:3, :3] @ known
    if float(_HALF_TURN[:, :3] @ now @ up) > float(now @ up):  # it was turned over
        return ""
    return f"{who} that it is upright. Use Align to ground, or Rotate."


def _known(gaussians: Gaussians, states_its_axes: bool) -> tuple[DoubleArray, str] | None:
    """The up direction (3,) of the splats as in their file, and who says so; None: nobody."""
    if gaussians.up is not None:
        return gaussians.up, "The file says"
    if (shown := known_up(gaussians)) is not None:
        return shown, "Its ground shows"
    # Where the axes of the file are known, up is that of models.
    return (guess_up(gaussians), "The file says") if states_its_axes else None


def is_turned(session: Session) -> bool:
    """Whether the file that is open is turned whenever it is opened."""
    return session.document is not None and _name(session) in session.settings.upright


def is_left(session: Session) -> bool:
    """Whether a person answered that the file that is open stands as it should."""
    return session.document is not None and _name(session) in session.settings.as_filed


def leave(session: Session) -> bool:
    """Remember that the file stands as it should: it is not asked about again. A second time that
    is taken back."""
    if is_left(session):
        _remember(session)
    else:
        _remember(session, is_turned=False)
    return True


def why_not_left(session: Session) -> str:
    """Needs a file that does not say which way is up."""
    if session.document is None:
        return "No scene is open."
    path = session.document.project.model_path
    if _is_open_question(path):
        return ""
    return "Only an .spz file that does not say which way is up is asked about."


def _name(session: Session) -> str:
    return str(session.need().project.model_path.resolve())


def _remember(session: Session, *, is_turned: bool | None = None) -> None:
    """Note whether the file that is open is turned, if it does not say how it stands; None: that
    is not known."""
    if not _is_open_question(session.need().project.model_path):
        return
    name, now = _name(session), session.settings
    turned, left = (tuple(p for p in known if p != name) for known in (now.upright, now.as_filed))
    if is_turned:
        turned = (name, *turned)[:_MOST]
    elif is_turned is not None:
        left = (name, *left)[:_MOST]
    session.change_settings(replace(now, upright=turned, as_filed=left))


@notifies
def opened(session: Session) -> bool:
    """A file was opened: turn it when it was turned before, else say what cannot be known."""
    document = session.need()
    path = document.project.model_path
    if document.project.path is not None or not _is_open_question(path):
        return False  # a saved project keeps how it stands
    if str(path.resolve()) in session.settings.upright:
        return _turn(session, is_content=False)
    if str(path.resolve()) not in session.settings.as_filed:
        text = f"Is it upside down? {path.name} does not say which way is up."
        session.notify(Level.HINT, text, COMMAND, otherwise=LEAVE)
    return False


def _turn(session: Session, *, is_content: bool) -> bool:
    document = session.need()
    scene = document.settled().scene
    before = document.world, session.rig.goal
    edit = edits.move_scene(scene, _HALF_TURN, _TITLE)
    done = document.do(edit, is_content=is_content)
    box = splat_box(scene)
    session.rig.frame_scene(*box, up=session.rig.up)
    session.rig.turn_to_clearest(scene, box)
    session.rig.follow(document.world)
    document.kept_poses = (before, (document.world, session.rig.goal))
    return done


def _is_open_question(path: Path) -> bool:
    """Whether the file does not say which way is up."""
    if path.suffix.lower() != ".spz":
        return False
    try:
        return not states_axes(path)
    except GagaError:  # it was moved since it was opened: nothing is asked
        return False
