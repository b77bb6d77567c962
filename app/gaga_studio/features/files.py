"""Open, save, add splats, save a script.

Long work runs as a job; its result arrives as an edit or a notice.
"""

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from gaga_core.errors import counted
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write
from gaga_core.io.images import IMAGE_SUFFIXES
from gaga_core.io.splats.splat_files import READ_SUFFIXES
from gaga_core.scene import edits
from gaga_core.scene.edits.values import read_added_stage
from gaga_core.scene.project import require_other_file
from gaga_studio.features import level_of_detail
from gaga_studio.features.base import (
    Command,
    ask,
    busy,
    first_of,
    needs,
    no_scene,
    not_saveable,
    preview_waits,
)
from gaga_studio.session.notices import Level, Request, choose_one, notifies
from gaga_studio.session.session import Session
from gaga_studio.system import paths


@notifies
def save_script(session: Session, path: Path) -> bool:
    """Write every edit since the scene was opened as a script for ``gaga edit``."""
    document = session.need()
    require_other_file(document.project, path)
    document.settled()
    recorded = document.history.recorded()
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(recorded, indent=1), encoding="utf-8")
    edits = counted(len(recorded), "edit")
    text = f"Recorded {edits}, all since the scene was opened, in {path}."
    if (project := document.project.path) is not None:
        text += f" They fit {project.name} as it was opened: to save over it replaces that."
    session.notify(Level.INFO, text, shows=path)
    return True


def drop(session: Session, dropped: Sequence[Path]) -> None:
    """Open what was dropped into the window: a scene, a film, photos, or files of splats.

    Photos stand for their folder. Splats become one scene; where one is open, the answer to a
    question says whether they are added to it. Nothing happens behind a question.
    """
    if session.pending_question is not None:
        session.notify(Level.HINT, "Answer the question first, then drop the files again.")
        return
    is_splats = [path.is_file() and path.suffix.lower() in READ_SUFFIXES for path in dropped]
    splats = tuple(path for path, is_one in zip(dropped, is_splats, strict=True) if is_one)
    first = dropped[0]
    if first.is_file() and first.suffix.lower() in IMAGE_SUFFIXES:
        session.open(first.parent)
        return
    if not splats:
        session.open(first)
        return

    def open_them() -> None:
        rest = splats[1:]
        session.open(splats[0], then=partial(add_splats, session, *rest) if rest else None)

    def add_them() -> None:
        add_splats(session, *splats)

    if session.document is None:
        open_them()
        return
    what = splats[0].name if len(splats) == 1 else f"{len(splats)} files"
    session.pending_question = choose_one(
        f"Add the splats of {what} to {session.document.name}, or open them instead?",
        {"Add": add_them, "Open": open_them},
    )


@notifies
def add_splats(session: Session, path: Path, *more: Path) -> None:
    """Add the splats of other files to the open scene, selected, each as one edit."""
    document = session.document
    if document is None:
        return
    document.settled()  # a preview that waits would refuse the splats when they are read

    def done(read: tuple[Gaussians, str]) -> None:
        if session.document is not document:
            return
        splats, digest = read
        up = session.rig.up
        document.do(edits.append(document.settled().scene, splats, path, digest, up=up))
        session.notify(
            Level.INFO, f"Added {counted(len(splats), 'splat')} of {path.name}; they are selected."
        )
        if splats.is_antialiased != document.scene.gaussians.is_antialiased:
            session.notify(
                Level.WARNING,
                f"{path.name} was trained in another mode (classic or antialiased) "
                "than this scene, so its fine parts may look thinner or thicker here.",
            )
        if more:
            add_splats(session, *more)
            return
        level_of_detail.offer(session)

    session.jobs.start(f"Add {path.name}", read_added_stage(path), on_done=done)


def recent(session: Session) -> tuple[Command, ...]:
    """A command for each scene that was open lately."""

    def open_it(name: str) -> Command:
        path = Path(name)
        title = f"{path.name}, in {paths.shown(path.parent)}"
        return Command(
            f"file.recent {name}",
            name,
            lambda s: s.open(path),
            enabled=busy,
            describe=lambda _: title,
        )

    return tuple(map(open_it, session.settings.recent))


def _saved_project(session: Session) -> Path | None:
    """The project that was saved last of the file that is open; looked for once."""
    document = session.need()
    project = document.project
    return document.read.once("saved project", (project.path,), lambda: project.saved_of_file)


def open_saved_project(session: Session) -> None:
    """Open the project that was saved of the file that is open."""
    saved = _saved_project(session)
    if saved is not None:
        session.open(saved)


_has_saved = needs(_saved_project, "No project was saved of this file.")
_no_edits = needs(
    lambda session: session.need().history.is_recorded,
    "Nothing was edited since the scene was opened.",
)
COMMANDS: tuple[Command, ...] = (
    ask("file.open_folder", "Open scene folder…", Request.OPEN_FOLDER, "Ctrl+O", enabled=busy),
    ask("file.open_file", "Open splat file…", Request.OPEN_FILE, "Ctrl+Shift+O", enabled=busy),
    Command(
        "file.saved_project",
        "Open the project saved of this file",
        open_saved_project,
        enabled=first_of(_has_saved, busy),
    ),
    ask(
        "file.add_splats",
        "Add splats…",
        Request.ADD_SPLATS,
        enabled=first_of(not_saveable, preview_waits),
    ),
    Command("file.demo", "Open the demo", Session.open_demo, enabled=busy),
    Command("file.save", "Save project", lambda s: s.save(), "Ctrl+S", enabled=no_scene),
    ask("file.save_as", "Save project as…", Request.SAVE_AS, "Ctrl+Shift+S", enabled=no_scene),
    ask("file.save_script", "Save the edits as a script…", Request.SAVE_SCRIPT, enabled=_no_edits),
    Command("file.close", "Close", Session.close, "Ctrl+W", enabled=not_saveable),
    Command("file.quit", "Quit", Session.quit, "Ctrl+Q"),
)
