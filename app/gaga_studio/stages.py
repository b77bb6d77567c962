"""The long work that a person starts on the open scene: associate, export.

Each runs as a job; its result arrives as an edit or a notice.
"""

from pathlib import Path

from gaga_core.grouping.associate import Association, BankSnapshot
from gaga_studio import tasks
from gaga_studio.notices import Level
from gaga_studio.session import Session
from gaga_studio.view import Mode


def associate(session: Session, provider: str | None = None, preset: str | None = None) -> None:
    """Make groups from the masks of ``provider`` (default: the first), as one edit."""
    chosen = provider or session.provider
    session.attempt(lambda: _associate(session, chosen, preset or session.settings.preset))


def _associate(session: Session, provider: str, preset: str) -> None:
    document = session.need()
    session.provider, session.masks = tasks.masks_of(document.project, provider)
    stage = tasks.associate_project_stage(document.project, session.masks, preset)
    mode = session.view.mode

    def progress(payload: object) -> None:
        if isinstance(payload, BankSnapshot) and session.document is document:
            view = session.view
            view.mode = view.mode if session.live else Mode.GROUPS  # seen growing
            session.live = payload

    def done(result: Association) -> None:
        session.notify(Level.INFO, f"Found {document.group(result)} objects.")
        for note in result.notes:
            session.notify(Level.WARNING, note)

    def end() -> None:
        session.view.mode = mode if session.live else session.view.mode
        session.live = None

    session.jobs.start("Associate masks", stage, progress, done, end)


def export(session: Session, what: tasks.Export, path: Path, *, groups: bool = False) -> None:
    """Write what is visible, the selection, or one .ply per (selected, else any) object.

    ``path`` is a folder for "objects"; ``groups`` adds a column with the group to a .ply.
    """
    if session.scene is None:
        return
    scene, chosen = session.need().settled().scene, session.selected_groups()
    stage = tasks.export_stage(scene, what, path, chosen=chosen, groups=groups)
    title = f"Export to {path.name}"
    session.jobs.start(title, stage, on_done=lambda text: session.notify(Level.INFO, text))
