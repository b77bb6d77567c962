"""Turn a scene upright whose file does not say which way its axes point, and remember that."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from gaga_core.errors import GagaError
from gaga_core.io.splats.spz import states_axes
from gaga_core.scene import edits
from gaga_core.scene.selection.bounds import splat_box
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.session import Session

COMMAND = "tool.turn_upright"
_TITLE = "Turn upright"
# Half around x: from right, up, back, which some programs write into .spz, to right, down, front.
_HALF_TURN = np.concatenate([np.diag([1.0, -1.0, -1.0]), np.zeros((3, 1))], axis=1)
_MOST = 100  # files that are remembered, newest first


@notifies
def turn(session: Session) -> bool:
    """Turn everything half around x; a second time it is as in the file.

    The file is turned from then on whenever it is opened, if it does not say how it stands.
    """
    document = session.need()
    if not _turn(session, is_content=True):
        return False
    name = str(document.project.model_path.resolve())
    if _is_open_question(document.project.model_path):
        now = session.settings.upright
        others = tuple(path for path in now if path != name)
        kept = others if name in now else (name, *others)[:_MOST]
        session.change_settings(replace(session.settings, upright=kept))
    return True


@notifies
def opened(session: Session) -> bool:
    """A file was opened: turn it when it was turned before, else say what cannot be known."""
    document = session.need()
    path = document.project.model_path
    if document.project.path is not None or not _is_open_question(path):
        return False  # a saved project keeps how it stands
    if str(path.resolve()) in session.settings.upright:
        return _turn(session, is_content=False)
    text = f"{path.name} does not say which way is up. Is it upside down?"
    session.notify(Level.HINT, text, COMMAND)
    return False


def _turn(session: Session, *, is_content: bool) -> bool:
    document = session.need()
    scene = document.settled().scene
    edit = edits.move_scene(scene, _HALF_TURN, _TITLE)
    done = document.do(edit, is_content=is_content)
    up = session.rig.up if session.cameras else None  # photos turn along, up does not
    session.rig.frame_scene(*splat_box(scene), session.cameras, up=up)
    return done


def _is_open_question(path: Path) -> bool:
    """Whether the file does not say which way is up."""
    if path.suffix.lower() != ".spz":
        return False
    try:
        return not states_axes(path)
    except GagaError:  # it was moved since it was opened: nothing is asked
        return False
