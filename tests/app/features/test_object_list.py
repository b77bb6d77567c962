"""Pictures of objects in the list: alone, tight, and those of the present state."""

import threading
import time

import numpy as np
import pytest

from gaga_core.arrays import UInt8Array
from gaga_core.progress import Progress, Stage
from gaga_core.scene.object_picture import GROUND
from gaga_core.scene.objects import group_indices
from gaga_studio.features import object_list, selection, transform
from gaga_studio.features.find import search
from gaga_studio.features.find.search import SearchState
from gaga_studio.session.session import Session


def measure(session: Session) -> None:
    """What the object list does in every frame, until everything is measured."""
    document, end = session.need(), time.monotonic() + 60
    while True:
        search.follow(session)
        session.jobs.poll()
        if document.feature(SearchState).has_looks and session.jobs.quiet is None:
            search.follow(session)
            return
        assert time.monotonic() < end
        time.sleep(0.02)


def request(session: Session, group: int) -> tuple[str, object_list.Load | None] | None:
    table = session.objects()
    row = table.row(group)
    assert row is not None
    return object_list.picture_request(session, table, row)


def picture(session: Session, group: int) -> tuple[str, UInt8Array]:
    found = request(session, group)
    assert found is not None
    assert found[1] is not None
    return found[0], found[1]().render()


@pytest.fixture
def measured(associated: Session) -> Session:
    measure(associated)
    return associated


def test_a_picture_shows_the_object_alone_as_large_as_fits(measured: Session) -> None:
    _, shown = picture(measured, 2)
    assert shown.shape == (object_list.SMALL, object_list.SMALL, 3)
    drawn = np.abs(shown.astype(int) - GROUND).max(axis=2) > 12
    assert not drawn[[0, -1]].any()  # neutral ground at the edges
    assert not drawn[:, [0, -1]].any()
    rows, columns = np.flatnonzero(drawn.any(axis=1)), np.flatnonzero(drawn.any(axis=0))
    assert max(np.ptp(rows), np.ptp(columns)) > 0.75 * object_list.SMALL


def test_a_copy_made_while_a_job_runs_has_a_name_and_a_picture(measured: Session) -> None:
    """It was "group 12" without a picture until the job ended."""
    ends = threading.Event()

    def job() -> Stage[None]:
        yield Progress("Wait", 0, 1)
        ends.wait(120)

    assert measured.jobs.start("Wait", job())
    selection.select_groups(measured, (2,))
    assert transform.duplicate(measured)
    (copy,) = measured.selected_groups()
    measure(measured)
    assert measured.jobs.running is not None
    assert not measured.need().name_of(copy).startswith("group")
    _, shown = picture(measured, copy)
    assert np.abs(shown.astype(int) - GROUND).max() > 12
    ends.set()
    assert measured.jobs.wait()


def test_a_few_strays_do_not_make_the_object_small(measured: Session) -> None:
    scene = measured.need().scene
    rows = group_indices(scene, 2)
    scene.gaussians.means[rows[::25]] += np.float32(3.0) * scene.gaussians.means.std()
    scene.revision.splats += 1
    measure(measured)
    _, shown = picture(measured, 2)
    drawn = np.abs(shown.astype(int) - GROUND).max(axis=2) > 12
    assert np.ptp(np.flatnonzero(drawn.mean(axis=1) > 0.1)) > 0.5 * object_list.SMALL


def test_a_picture_is_that_of_the_state_through_recolor_and_undo(measured: Session) -> None:
    key, before = picture(measured, 2)
    other, _ = picture(measured, 3)
    selection.select_groups(measured, (2,))
    assert picture(measured, 2)[0] == key  # a selection draws nothing again
    assert transform.recolor(measured, (1.0, 0.0, 0.0))
    search.follow(measured)
    stale = request(measured, 2)
    assert stale == (key, None)  # nothing is drawn under the digest of another state
    measure(measured)
    red, after = picture(measured, 2)
    assert red != key
    assert (
        after[..., 0].mean() - after[..., 1].mean() > before[..., 0].mean() - before[..., 1].mean()
    )
    assert picture(measured, 3)[0] == other
    measured.undo()
    measure(measured)
    key_again, again = picture(measured, 2)
    assert key_again == key
    np.testing.assert_array_equal(again, before)


def test_nothing_is_drawn_before_the_objects_are_measured(associated: Session) -> None:
    assert request(associated, 2) is None
