"""Associate, export, add splats, save a script.

Long work runs as a job; its result arrives as an edit or a notice.
"""

import json
from collections.abc import Callable
from pathlib import Path

from gaga_core.export.export import MeshExport
from gaga_core.export.options import ExportOptions
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import Association, BankSnapshot
from gaga_core.io.files import atomic_write
from gaga_core.io.splats.splat_files import SplatFormat
from gaga_core.progress import Stage
from gaga_core.scene import edits
from gaga_core.scene.edits.splats import ids_of_added, spread
from gaga_core.scene.edits.values import read_added_stage
from gaga_core.scene.objects import selected_groups
from gaga_studio.actions import children, identities
from gaga_studio.session import level_of_detail, stages
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.session import Session
from gaga_studio.session.view_state import Mode

_AS_IS = ExportOptions()


@notifies
def associate(session: Session, provider: str | None = None, preset: str | None = None) -> None:
    """Make groups from the masks of ``provider`` (default: the first), as one edit.

    With the settings of `Session.find_options`; then identities, where the preset has them.
    """
    document, preset = session.need(), preset or session.settings.preset
    config = session.find_options.association(preset)
    found = stages.masks_of(document.project, provider or session.provider)
    session.provider, session.masks = found
    stage = stages.associate_project_stage(document.project, session.masks, config)
    progress, end = watch_bank(session)

    def done(result: Association) -> None:
        session.notify(Level.INFO, f"Found {take_groups(document, result)} objects.")
        for note in result.notes:
            session.notify(Level.WARNING, note)
        identities.lift_after_finding(session, preset)

    session.jobs.start("Associate masks", stage, progress, done, end)


def take_groups(document: Document, found: Association) -> int:
    """Set the groups of the scene; return how many objects there are now."""
    scene = document.settled().scene
    labels = spread(scene, found.labels)  # duplicates follow their originals
    kept = ids_of_added(scene, labels)
    names = {new: scene.names[old] for old, new in kept.items() if old in scene.names}
    order = scene.folders.renumbered(kept)
    document.do(
        edits.set_grouping(
            scene, labels, found.bank, names, confidence=found.confidence, folders=order
        )
    )
    return int((document.read.objects(None, False).ids > 0).sum())


def watch_bank(session: Session) -> tuple[Callable[[object], None], Callable[[], None]]:
    """Return the callbacks of a job that fills a memory bank: for its progress, for its end.

    While it runs the picture shows the groups growing; then what it showed before.
    """
    document, mode = session.document, session.view.mode

    def progress(payload: object) -> None:
        if isinstance(payload, BankSnapshot) and session.document is document:
            view = session.view
            view.mode = view.mode if session.live else Mode.GROUPS  # seen growing
            session.live = payload

    def end() -> None:
        session.view.mode = mode if session.live else session.view.mode
        session.live = None

    return progress, end


def export(
    session: Session,
    what: stages.Export,
    path: Path,
    *,
    groups: bool = False,
    form: SplatFormat | MeshExport = SplatFormat.PLY,
    options: ExportOptions = _AS_IS,
) -> None:
    """Write what is visible, the selection, or one file per (selected, else any) object.

    ``path`` is a folder for "objects", whose files are of ``form``; else its suffix is the form of
    the file. ``groups`` adds a column with the group to a .ply, ``options`` change what is written.
    """
    if session.scene is None:
        return
    session.need().settled()
    scene = children.scene_along(session)
    chosen = selected_groups(scene).tolist()
    stage = stages.export_stage(
        scene, what, path, chosen=chosen, groups=groups, form=form, options=options
    )
    start_export(session, path, stage)


def start_export(session: Session, path: Path, stage: Stage[str]) -> None:
    """Run ``stage``, which exports to ``path`` and returns a sentence on what it has written."""

    def done(text: str) -> None:
        session.has_exported = True
        session.notify(Level.INFO, text, shows=path)

    session.jobs.start(f"Export to {path.name}", stage, on_done=done)


@notifies
def save_script(session: Session, path: Path) -> bool:
    """Write every edit since the scene was opened as a script for ``gaga edit``."""
    document = session.need()
    document.settled()
    recorded = document.history.recorded()
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(recorded, indent=1), encoding="utf-8")
    session.notify(Level.INFO, f"Recorded {len(recorded)} edits in {path}.", shows=path)
    return True


def add_splats(session: Session, path: Path) -> None:
    """Add the splats of another file to the open scene, selected, as one edit."""
    document = session.document
    if document is None:
        return

    def done(read: tuple[Gaussians, str]) -> None:
        if session.document is not document:
            return
        splats, digest = read
        document.do(edits.append(document.settled().scene, splats, path, digest))
        session.notify(
            Level.INFO, f"Added {len(splats):,} splats of {path.name}; they are selected."
        )
        if splats.is_antialiased != document.scene.gaussians.is_antialiased:
            session.notify(
                Level.WARNING,
                f"{path.name} was trained for another kind of drawing (antialiased or not) "
                "than this scene, so its fine parts may look thinner or thicker here.",
            )
        level_of_detail.offer(session)

    session.jobs.start(f"Add {path.name}", read_added_stage(path), on_done=done)
