"""Wrong models do not pass: each is planted in a right one, self-consistent but for its flaw."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.placing.checks import Verdict, check_model
from gaga_core.placing.metrics import SfmFacts, summarize
from tests.core.conftest import PlacedRoom


@pytest.fixture
def right(placed_room: PlacedRoom) -> SfmFacts:
    return placed_room.facts


def verdicts(facts: SfmFacts, priors: dict[str, float] | None = None) -> dict[str, Verdict]:
    found = {v.check: v for v in check_model(facts, summarize(facts), priors)}
    for verdict in found.values():
        assert verdict.text.endswith(".")
        assert "{" not in verdict.text
        assert len(verdict.text) < 300
    return found


def errors(facts: SfmFacts, priors: dict[str, float] | None = None) -> set[str]:
    return {name for name, v in verdicts(facts, priors).items() if v.level == "error"}


def moved_apart(facts: SfmFacts, moved: BoolArray, motion: DoubleArray) -> SfmFacts:
    """The views ``moved`` (V,) and a copy of all that they see, moved rigidly by ``motion`` (4, 4).

    Every observation fits as before: what is seen from both sides stands twice.
    """
    back = np.linalg.inv(motion)
    poses = facts.poses.copy()
    for i in np.flatnonzero(moved):
        poses[i] = facts.poses[i] @ back
    n = len(facts.points)
    copy = facts.points @ motion[:3, :3].T + motion[:3, 3]
    theirs = moved[facts.seen_views]
    sides = moved[facts.match_views] & (facts.match_points >= 0)
    points = np.concatenate([facts.points, copy])
    seen = facts.seen_points + n * theirs
    lengths = np.bincount(seen, minlength=2 * n)
    return replace(
        facts,
        poses=poses,
        points=points,
        seen_points=seen,
        track_lengths=lengths[lengths > 0],
        match_points=facts.match_points + n * sides,
    )


def motion(turn_degrees: float, shift: float, facts: SfmFacts) -> DoubleArray:
    """A turn about the middle of the points and a shift in units of their spread."""
    middle, spread = np.median(facts.points, axis=0), facts.points.std()
    result = np.eye(4)
    result[:3, :3] = Rotation.from_rotvec([0, np.radians(turn_degrees), 0]).as_matrix()
    result[:3, 3] = middle - result[:3, :3] @ middle + np.array([1.0, 0.3, 0]) * shift * spread
    return result


def half(facts: SfmFacts) -> BoolArray:
    result: BoolArray = np.arange(len(facts.names)) >= len(facts.names) // 2
    return result


def test_a_right_model_passes(right: SfmFacts) -> None:
    assert verdicts(right, dict.fromkeys(right.names, 300.0)) == {}
    summary = summarize(right)
    assert summary.agreeing == 1
    assert summary.doubled < 0.02
    assert summary.parts == 1


def test_moving_the_whole_model_changes_nothing(right: SfmFacts) -> None:
    everywhere = np.ones(len(right.names), bool)
    moved = moved_apart(right, everywhere, motion(70, 2, right))
    assert verdicts(moved) == {}


def test_two_clusters_turned_against_each_other_are_refused(right: SfmFacts) -> None:
    """As global mapping can leave them: every photo placed, every error small."""
    # By 90 degrees about an axis of the room most rays between the halves may still meet.
    wrong = moved_apart(right, half(right), motion(180, 0, right))
    assert np.array_equal(wrong.seen_errors, right.seen_errors)
    assert {"clusters", "pairs", "doubled"} <= errors(wrong)


def test_doubled_walls_are_refused(right: SfmFacts) -> None:
    """A loop that did not close: half of the views sees everything a little beside."""
    wrong = moved_apart(right, half(right), motion(0, 0.15, right))
    assert "doubled" in errors(wrong)
    hardly = moved_apart(right, half(right), motion(0, 0.002, right))
    assert not {"doubled", "pairs"} & set(verdicts(hardly))


def test_a_collapsed_focal_length_is_refused(right: SfmFacts) -> None:
    for times in (10.0, 0.2):
        assert "focal" in errors(replace(right, focal=right.focal * times))


def test_focal_lengths_are_held_against_what_is_known(right: SfmFacts) -> None:
    focal = float(right.focal.mean())
    assert "prior" not in verdicts(right, {right.names[0]: focal * 1.05})
    assert verdicts(right, {right.names[0]: focal * 1.3})["prior"].level == "warning"
    assert "prior" in errors(right, {right.names[0]: focal * 3})
    uneven = replace(right, focal=right.focal * [1, 1.1])
    assert verdicts(uneven)["axes"].level == "warning"


def test_few_placed_photos_are_refused_and_named(right: SfmFacts) -> None:
    n = len(right.names)
    more = tuple(f"lost{i:02d}.jpg" for i in range(3 * n))
    wrong = replace(right, all_names=(*right.all_names, *more), model_sizes=np.array([n, 5]))
    verdict = verdicts(wrong)["registered"]
    assert verdict.level == "error"
    assert "lost00.jpg" in verdict.text
    assert "5 of them make a scene of their own" in verdict.text
    one = replace(right, all_names=(*right.all_names, "lost.jpg"))
    assert verdicts(one)["registered"].level == "warning"


def test_points_behind_their_cameras_are_refused(right: SfmFacts) -> None:
    poses = right.poses.copy()
    poses[0, :3] = np.diag([-1.0, 1, -1]) @ poses[0, :3]  # one camera looks the other way
    assert "behind" in errors(replace(right, poses=poses))


def test_cameras_at_one_place_are_refused(right: SfmFacts) -> None:
    """Turning on the spot: as the points are far away, no angle is left between the views."""
    poses = right.poses.copy()
    shrink = 1e-3
    centres = -np.einsum("vij,vi->vj", poses[:, :, :3], poses[:, :, 3])
    near = centres.mean(axis=0) + shrink * (centres - centres.mean(axis=0))
    poses[:, :, 3] = -np.einsum("vij,vj->vi", poses[:, :, :3], near)
    assert "collapse" in errors(replace(right, poses=poses))


def test_errors_of_the_fit_and_short_tracks_are_told(right: SfmFacts) -> None:
    assert verdicts(replace(right, seen_errors=right.seen_errors + 1.5))["reprojection"].level == (
        "warning"
    )
    assert "reprojection" in errors(replace(right, seen_errors=right.seen_errors + 4))
    assert "track" in errors(replace(right, track_lengths=np.full(len(right.points), 2)))
