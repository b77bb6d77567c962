"""Find objects: associate the masks of the open scene."""

from collections.abc import Callable

from gaga_core.grouping.associate import Association, BankSnapshot
from gaga_core.scene import edits
from gaga_core.scene.edits.append import ids_of_added, spread
from gaga_studio.actions import identities
from gaga_studio.session import stages
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.session import Session
from gaga_studio.session.view_state import Mode


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
