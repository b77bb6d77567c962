"""Identity encodings of the groups, and whether labels are votes or theirs."""

from collections.abc import Callable

from gaga_core.grouping.associate import Association, BankSnapshot
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.identity.lift import Mode as LiftMode
from gaga_core.identity.lift import mode_of_preset
from gaga_core.scene import edits
from gaga_core.scene.edits.append import ids_of_added, spread
from gaga_core.scene.edits.identities import NO_IDENTITIES
from gaga_core.scene.scene import LabelSource
from gaga_studio.features.base import Command, ask, needs, no_bank, no_masks, watch
from gaga_studio.session import stages
from gaga_studio.session.document import Document
from gaga_studio.session.find_options import lift_mode
from gaga_studio.session.notices import Level, Request, notifies
from gaga_studio.session.session import Session
from gaga_studio.session.stages import LiftedScene
from gaga_studio.session.view import Mode

# --- Identity encodings of the groups, and whether labels are votes or theirs.


__all__ = ["NO_IDENTITIES", "lift", "lift_after_finding", "use_labels"]
_CHANGED = "The objects were found again meanwhile, so the identities are left out. Lift again."


@notifies
def lift(session: Session, mode: LiftMode | None = None) -> None:
    """Make identities of the groups as one edit, in ``mode``; default: as the settings say.

    Labels come from them where the paper says so: trained, from groups of the preset paper.
    """
    document = session.need()
    bank = document.settled().scene.bank
    preset = bank.preset if bank is not None else "paper"
    mode = mode or lift_mode(session.settings, preset) or mode_of_preset(preset)
    options = session.find_options.lift
    stage = stages.lift_project_stage(document.project, session.masks, mode, options)
    used = (mode, preset) == ("paper", "paper")

    check = watch(session, document, _CHANGED, lambda: document.settled().scene.bank is bank)

    def done(found: LiftedScene) -> None:
        if not check():
            return
        labels, confidence, colors = found.labels, found.confidence, found.colors
        scene = document.settled().scene
        document.do(edits.set_identities(scene, labels, confidence, colors, used=used))
        session.notify(Level.INFO, _text(bank, is_used=used))

    session.jobs.start("Lift groups to identities", stage, on_done=done)


def lift_after_finding(session: Session, preset: str) -> None:
    """Go on with identities where the settings, or ``preset``, ask for them."""
    mode = lift_mode(session.settings, preset)
    if mode is not None:
        lift(session, mode)


@notifies
def use_labels(session: Session, source: LabelSource) -> None:
    """Take labels from the votes of the masks or from the identities, as one edit."""
    document = session.need()
    document.do(edits.use_labels(document.settled().scene, source))


def _text(bank: MemoryBank | None, *, is_used: bool) -> str:
    n = bank.n_groups if bank is not None else 0
    rest = (
        "Labels come from them now."
        if is_used
        else 'Labels stay votes; "Labels by identities" takes them.'
    )
    return f"{n} groups have identities. {rest}"


# --- Find objects: associate the masks of the open scene.


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
        lift_after_finding(session, preset)

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


_no_identities = needs(
    lambda session: session.need().scene.identities.other is not None, NO_IDENTITIES
)


def _labels(source: LabelSource) -> Command:
    return Command(
        f"object.labels_{source}",
        f"Labels by {source}",
        lambda session: use_labels(session, source),
        enabled=_no_identities,
        is_on=lambda s: s.scene is not None and s.scene.identities.source == source,
    )


COMMANDS: tuple[Command, ...] = (
    Command(
        "object.associate",
        "Find objects (associate masks)",
        associate,
        "Ctrl+G",
        enabled=no_masks,
    ),
    ask(
        "object.find_settings",
        "Find objects with settings…",
        Request.FIND_OBJECTS,
        enabled=no_masks,
    ),
    Command("object.lift", "Lift groups to identities", lift, enabled=no_bank),
    _labels("votes"),
    _labels("identities"),
)
