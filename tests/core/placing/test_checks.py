"""Wrong models do not pass: each is planted in a right one, self-consistent but for its flaw."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.errors import GagaError
from gaga_core.geometry import look_at
from gaga_core.placing import checks
from gaga_core.placing.checks import (
    Bridge,
    Verdict,
    check_model,
    check_poses_stage,
    judge_poses,
    weakest_bridge,
)
from gaga_core.placing.metrics import SfmFacts, summarize
from gaga_core.progress import run_stage
from tests.core.conftest import PlacedRoom

# --- Wrong models do not pass: each is planted in a right one, self-consistent but for its flaw.


# --- Wrong models do not pass: each is planted in a right one, self-consistent but for its flaw.


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


@pytest.mark.parametrize("array", ["focal", "sizes"])
@pytest.mark.parametrize("value", [0, -1])
def test_lenses_and_photos_that_cannot_be_are_refused(
    array: str, value: int, placed_room: PlacedRoom, tmp_path: Path
) -> None:
    with np.load(placed_room.workspace / "facts.npz") as stored:
        whole = dict(stored)
    whole[array][0, 1] = value
    np.savez(tmp_path / "facts.npz", **whole)
    with pytest.raises(GagaError, match=f"{array}: {value}"):
        SfmFacts.load(tmp_path / "facts.npz")


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
    return np.arange(len(facts.names)) >= len(facts.names) // 2


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
    """A loop that did not close: half of the views sees everything a little shifted."""
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


# --- Two clusters of cameras that few points hold: a right joint passes, a wrong one does not.


ARC = 8  # views of an arc
FOCAL, NOISE = 500.0, 0.7  # pixels
Motion = tuple[float, DoubleArray, DoubleArray]  # scale, rotation, shift


def posed(centre: DoubleArray) -> DoubleArray:
    """cam_from_world (3, 4) of a camera that looks at the origin."""
    return look_at(centre, np.zeros(3), np.array([0, 0, 1.0]))[:3]


def two_arcs(
    n_across: int, gap: float = 50.0, seed: int = 0, moved: Motion | None = None
) -> SfmFacts:
    """Two arcs of 40 degrees; 300 points for each, and ``n_across`` that three views of both see.

    ``moved``: the second arc lies so instead, with the same pictures: what an adjustment leaves
    that put the halves together wrong.
    """
    rng = np.random.default_rng(seed)
    degrees = np.r_[np.linspace(0, 40, ARC), np.linspace(40 + gap, 80 + gap, ARC)]
    angles = np.radians(degrees)
    centres = np.stack(
        [2 * np.cos(angles), 2 * np.sin(angles), 0.8 + 0.3 * (degrees % 7) / 7], axis=1
    )
    true = np.array([posed(c) for c in centres])
    points = rng.uniform(-0.5, 0.5, (600 + n_across, 3))
    views = [range(ARC)] * 300 + [range(ARC, 2 * ARC)] * 300
    views += [range(ARC - 3, ARC + 3)] * n_across
    seen_views = np.concatenate([list(v) for v in views])
    seen_points = np.repeat(np.arange(len(points)), [len(v) for v in views])
    rays = np.einsum("oij,oj->oi", true[seen_views, :, :3], points[seen_points])
    rays += true[seen_views, :, 3]
    rays = (
        rays / rays[:, 2:]
        + np.c_[rng.normal(0, NOISE / FOCAL, (len(rays), 2)), np.zeros(len(rays))]
    )
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    poses = true.copy()
    if moved is not None:
        scale, turn, shift = moved
        for k in range(ARC, 2 * ARC):
            poses[k] = posed(centres[k])
            poses[k, :, :3] = true[k, :, :3] @ turn.T
            poses[k, :, 3] = -poses[k, :, :3] @ (scale * turn @ centres[k] + shift)
    keys = zip(seen_points.tolist(), seen_views.tolist(), strict=True)
    of = {key: o for o, key in enumerate(keys)}
    rows = [
        (of[p, v], of[p, w])
        for p, group in enumerate(views)
        for v, w in zip(group, list(group)[1:], strict=False)
    ]
    first, second = np.array(rows).T
    pairs, counts = np.unique(
        np.stack([seen_views[first], seen_views[second]], axis=1), axis=0, return_counts=True
    )
    names = tuple(f"{k:02d}.jpg" for k in range(2 * ARC))
    return SfmFacts(
        names=names,
        poses=poses,
        focal=np.full((2 * ARC, 2), FOCAL),
        sizes=np.tile([640, 480], (2 * ARC, 1)),
        points=points,
        track_lengths=np.array([len(v) for v in views]),
        seen_points=seen_points,
        seen_views=seen_views,
        seen_errors=np.full(len(seen_views), NOISE),
        match_views=np.stack([seen_views[first], seen_views[second]], axis=1),
        match_points=np.stack([seen_points[first], seen_points[second]], axis=1),
        match_rays=np.stack([rays[first], rays[second]], axis=1),
        all_names=names,
        pairs=pairs,
        pair_matches=counts,
        model_sizes=np.array([2 * ARC]),
    )


def bridge_of(facts: SfmFacts) -> Bridge:
    found = weakest_bridge(facts)
    assert found is not None
    return found


def is_refused(facts: SfmFacts) -> bool:
    return "clusters" in {
        v.check for v in check_model(facts, summarize(facts)) if v.level == "error"
    }


@pytest.mark.parametrize("n_across", [14, 30, 40])
def test_a_right_joint_passes_however_few_points_two_views_share(n_across: int) -> None:
    facts = two_arcs(n_across)
    bridge = bridge_of(facts)
    assert set(np.flatnonzero(bridge.side)) in ({*range(ARC)}, {*range(ARC, 2 * ARC)})
    assert (bridge.n_common, bridge.n_points) == (n_across, n_across)
    assert bridge.off < 0.03
    assert not is_refused(facts)


@pytest.mark.parametrize(
    ("scale", "degrees", "shift"), [(1.27, 0, 0), (1, 15, 0), (1, 0, 0.3), (0.8, -5, 0.1)]
)
def test_a_wrong_joint_is_refused(scale: float, degrees: float, shift: float) -> None:
    turn = Rotation.from_rotvec([0, 0, np.radians(degrees)]).as_matrix()
    facts = two_arcs(40, moved=(scale, turn, np.array([shift, 0, 0])))
    bridge = bridge_of(facts)
    assert bridge.off > 0.1
    assert is_refused(facts)


def test_too_few_points_that_both_sides_know_hold_nothing() -> None:
    assert is_refused(two_arcs(11))
    facts = two_arcs(40)
    # One view of each side alone: no side knows how far the points are.
    outer = np.isin(facts.match_views, [ARC - 3, ARC - 2, ARC + 1, ARC + 2])
    outer &= facts.match_points >= 600
    assert is_refused(replace(facts, match_points=np.where(outer, -1, facts.match_points)))


def test_cameras_in_one_place_hold_nothing_and_no_weak_joint_is_not_looked_at() -> None:
    facts = two_arcs(40)
    turned_only = facts.poses.copy()
    turned_only[:, :, 3] = 0
    assert not bridge_of(replace(facts, poses=turned_only)).holds()
    assert weakest_bridge(two_arcs(200)) is None


def test_more_common_points_make_a_joint_surer() -> None:
    few, many = (
        np.mean([bridge_of(two_arcs(n, seed=s)).spread for s in range(3)]) for n in (13, 42)
    )
    assert 0 < many < 0.8 * few


# --- Given poses are held against the photos.


def test_poses_of_other_photos_are_refused(
    placed_room: PlacedRoom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = placed_room.workspace.parent / "in"
    photos = {camera.name: folder / camera.name for camera in placed_room.cameras}
    rng = np.random.default_rng(0)
    wrong = []
    for camera in placed_room.cameras:
        eye = np.array([rng.uniform(-2, 2), rng.uniform(-4, -2), rng.uniform(0.3, 3)])
        pose = look_at(eye, np.array([0, 0.4, 0.8]), np.array([0, 0, 1.0]))
        wrong.append(replace(camera, cam_from_world=pose))
    judged: list[SfmFacts] = []

    def judge(facts: SfmFacts) -> tuple[Verdict, ...]:
        judged.append(facts)
        return judge_poses(facts)

    monkeypatch.setattr(checks, "judge_poses", judge)
    (verdict,) = run_stage(check_poses_stage(wrong, photos, tmp_path / "work"))
    assert not (tmp_path / "work").exists()
    assert verdict.level == "error"
    assert "contradict the given poses" in verdict.text
    poses = {camera.name: camera.cam_from_world[:3] for camera in placed_room.cameras}
    right = replace(judged[0], poses=np.array([poses[name] for name in judged[0].names]))
    assert judge_poses(right) == ()
