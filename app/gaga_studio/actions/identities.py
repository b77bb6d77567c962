"""Identity encodings of the groups, and whether labels are votes or theirs."""

from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.identity.lift import Mode, mode_of_preset
from gaga_core.scene import edits
from gaga_core.scene.edits.objects import NO_IDENTITIES
from gaga_core.scene.scene import LabelSource
from gaga_studio.actions import unchanged
from gaga_studio.session import stages
from gaga_studio.session.find_options import lift_mode
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.session import Session
from gaga_studio.session.stages import LiftedScene

__all__ = ["NO_IDENTITIES", "lift", "lift_after_finding", "use_labels"]
_CHANGED = "The objects were found again meanwhile, so the identities are left out. Lift again."


@notifies
def lift(session: Session, mode: Mode | None = None) -> None:
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

    def is_same() -> bool:
        return document.settled().scene.bank is bank

    check = unchanged.watch(session, document, is_same, _CHANGED)

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
