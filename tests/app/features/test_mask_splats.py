"""The splats of a chosen mask: lit, gated or not, and whose they are."""

import time

import numpy as np
import pytest

from gaga_core.grouping.memory_bank import Decision
from gaga_studio.features import selection
from gaga_studio.features.commands import run
from gaga_studio.features.find import masks, memory_bank
from gaga_studio.session.session import Session


def _mask(session: Session) -> Decision:
    """A mask of the object 3, its view read."""
    decision = session.decisions(3)[-1]
    while memory_bank.mask_overlaps(session, decision) is None:
        session.jobs.poll()
    return decision


def test_overlaps_of_a_mask_are_looked_up_in_a_quiet_job(associated: Session) -> None:
    decision = associated.decisions(3)[-1]
    assert memory_bank.mask_overlaps(associated, decision) is None
    decision = _mask(associated)
    found = memory_bank.mask_overlaps(associated, decision)
    assert found is not None
    assert memory_bank.mask_overlaps(associated, decision) is found  # counted once, not every frame
    assert next(iter(found)) == 3
    assert list(found.values()) == sorted(found.values(), reverse=True)
    assert 0.5 < found[3] <= 1
    assert sum(found.values()) == pytest.approx(1)
    behind = memory_bank.mask_overlaps(associated, decision, has_gate=False)
    assert behind is not None
    assert len(behind) >= len(found)
    assert behind[3] < found[3]  # the floor is behind every ball


def test_lit_splats_are_those_of_the_mask_and_the_gate_is_a_switch(associated: Session) -> None:
    session = associated
    decision = _mask(session)
    splats = memory_bank.mask_splats_of(session, decision)
    assert splats is not None
    gated = memory_bank.mask_tint(session, decision)
    assert gated is not None
    assert np.array_equal((gated == memory_bank.IN_GATE).all(axis=1), splats.gated)
    assert not (gated == memory_bank.CUT_OFF).all(axis=1).any()
    assert memory_bank.mask_tint(session, decision) is gated  # nothing is sent to the card again
    run("view.mask_gate", session)
    free = memory_bank.mask_tint(session, decision)
    assert free is not None
    assert np.array_equal((free == memory_bank.IN_GATE).all(axis=1), splats.gated)
    cut = (free == memory_bank.CUT_OFF).all(axis=1)
    assert np.array_equal(cut, splats.behind & ~splats.gated)
    assert cut.any()
    assert memory_bank.mask_tint(session, None) is None
    run("view.lights_masks", session)
    assert memory_bank.mask_tint(session, decision) is None


def test_copies_are_lit_with_their_originals(associated: Session) -> None:
    session = associated
    decision = _mask(session)
    before = memory_bank.mask_tint(session, decision)
    selection.select_groups(session, (3,))
    assert run("edit.duplicate", session)
    scene = session.scene
    assert scene is not None
    after = memory_bank.mask_tint(session, decision)
    assert before is not None
    assert after is not None
    assert len(after) == len(scene) > len(before)
    assert np.array_equal(after, before[scene.source])


def test_a_view_that_cannot_be_read_is_tried_once(associated: Session) -> None:
    session = associated
    decision = session.decisions(3)[-1]
    assert session.project is not None
    assert session.project.folder is not None
    (folder,) = session.project.folder.mask_folders.values()
    for path in folder.glob(f"**/{decision.view}*"):
        path.write_bytes(b"no picture")
    end = time.monotonic() + 30
    while (
        found := memory_bank.mask_overlaps(session, decision)
    ) is None and time.monotonic() < end:
        session.jobs.poll()
        time.sleep(0.01)
    assert found == {}
    assert memory_bank.mask_tint(session, decision) is None
    assert session.jobs.quiet is None, "it fails again in every frame"


def test_masks_that_were_made_again_are_read_again(associated: Session) -> None:
    session, document = associated, associated.need()
    decision = _mask(session)
    kept = memory_bank.evidence_of(session, document)
    assert memory_bank.mask_splats_of(session, decision) is not None
    assert masks.choose(session, session.provider)  # as a job that has made masks does
    assert memory_bank.evidence_of(session, document) is not kept
    assert memory_bank.mask_splats_of(session, decision) is None  # until its view is read again
    assert memory_bank.mask_overlaps(session, _mask(session))
