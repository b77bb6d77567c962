"""Matches of a learned model: joined into features that photos share, and a rung of the ladder."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray
from gaga_core.cli.main import main
from gaga_core.errors import GagaError
from gaga_core.pipeline.place import place_photos
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.placing import ladder
from gaga_core.placing.ladder import LadderConfig, Rung, place_stage
from gaga_core.placing.photos import PhotoSet
from gaga_core.placing.sfm import SfmConfig
from gaga_core.placing.worker import one_to_one, shared_features
from gaga_core.progress import Progress, Stage, run_stage
from gaga_core.segmentation.models.catalogue import MATCHER
from gaga_core.segmentation.models.weights import find_model
from tests.core.conftest import ROOM_SFM, PlacedRoom
from tests.core.placing.photo_scenes import photograph, walk_cameras, write_photos
from tests.core.segmentation.models.hub_server import Hub, fresh_models, serve


def test_places_of_one_point_in_many_pairs_become_one_feature() -> None:
    rng = np.random.default_rng(0)
    true = np.stack(np.meshgrid(np.arange(20), np.arange(15)), -1).reshape(-1, 2) * 16 + 4.0
    which = np.repeat(np.arange(len(true)), 9)
    places = true[which] + rng.uniform(-0.4, 0.4, (len(which), 2))
    scores = rng.uniform(0.2, 1, len(which))
    wrong = true[::7] + np.array([3.5, 0])  # in the same cells, of one match each
    order = rng.permutation(len(places) + len(wrong))
    mixed, sure = np.concatenate([places, wrong])[order], np.r_[scores, np.full(len(wrong), 0.3)]
    features, found = shared_features(mixed, sure[order], 8, 1.5)
    assert len(features) == len(true)
    back = np.empty_like(found)
    back[order] = found
    assert (back[len(places) :] == -1).all()
    kept = back[: len(places)]
    assert (kept >= 0).all()
    assert len(np.unique(np.c_[which, kept], axis=0)) == len(true)  # each point has its own
    assert np.linalg.norm(features[kept] - true[which], axis=1).max() < 0.6
    assert len(shared_features(np.zeros((0, 2)), np.zeros(0), 8, 1.5)[0]) == 0


def test_a_feature_has_one_match_in_a_pair_the_surest() -> None:
    features = np.array([[0, 5], [0, 6], [1, 6], [2, -1], [3, 7]])
    found = one_to_one(features, np.array([0.3, 0.9, 0.8, 1.0, 0.1]))
    assert sorted(found.tolist()) == [[0, 6], [3, 7]]


def _room_points(n: int) -> DoubleArray:
    """On the planes of the room."""
    rng = np.random.default_rng(2)
    points = rng.uniform((-1.9, -1, 0.1), (1.5, 1.9, 1.6), (n, 3))
    for axis, at in ((2, 0.0), (1, 2.0), (0, -2.0)):
        points[axis::3, axis] = at
    return points


def _matched_truly(folder: Path, _: float) -> Stage[None]:
    """As a model would that sees the points of the room, and errs in a fifth of its matches."""
    rng, cameras = np.random.default_rng(1), {c.name: c for c in walk_cameras(8)}
    points = _room_points(300)
    pairs = [line.split() for line in (folder / "pairs.txt").read_text().splitlines()]
    counts, places = [], []
    for i, names in enumerate(pairs):
        yield Progress("Match photos", i, len(pairs))
        seen = [cameras[name].project(points) for name in names]
        both = np.all([cameras[n].shows(*s) for n, s in zip(names, seen, strict=True)], axis=0)
        found = np.stack([s[0][both] for s in seen], axis=1)
        found += rng.normal(0, 0.2, found.shape)
        wrong = rng.random(len(found)) < 0.2
        found[wrong] = rng.uniform(5, 200, (int(wrong.sum()), 2, 2))
        counts.append(len(found))
        places.append(found / (320, 240))
    n = sum(counts)
    np.savez(
        folder / "learned.npz",
        names=np.array(pairs),
        counts=np.array(counts),
        places=np.concatenate(places),
        scores=rng.uniform(0.3, 1, n),
    )


def test_learned_matches_join_the_others_and_are_verified(
    placed_room: PlacedRoom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def steps(_: PhotoSet, config: SfmConfig, *, has_learned: bool) -> tuple[Rung, ...]:
        assert has_learned
        return Rung("first attempt", config), Rung("learned", config, reuses=True, is_learned=True)

    monkeypatch.setattr(ladder, "rungs", steps)
    work = tmp_path / "work"
    shutil.copytree(placed_room.workspace, work)
    stage = place_stage(
        placed_room.photos, work, ROOM_SFM, ladder=LadderConfig(1.01), learned=_matched_truly
    )
    found = run_stage(stage)
    assert found.attempts[-1]["chosen"]
    assert found.best.title.startswith("learned")
    assert found.best.is_right
    gained = len(found.best.facts.points) - len(placed_room.facts.points)
    assert 150 < gained < 330  # of 300 points, each once, and hardly one of the wrong places
    tracks = np.sort(found.best.facts.track_lengths)
    assert (tracks >= 6).sum() > (placed_room.facts.track_lengths >= 6).sum() + 60


def test_the_rung_is_there_with_the_model_only(placed_room: PlacedRoom) -> None:
    without, having = (
        ladder.rungs(placed_room.photos, ROOM_SFM, has_learned=has) for has in (False, True)
    )
    assert not any(rung.is_learned for rung in without)
    assert [rung.is_learned for rung in having[:2]] == [False, True]
    assert tuple(rung for rung in having if not rung.is_learned) == without


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A tiny random EfficientLoFTR as a repository."""
    pytest.importorskip("transformers", reason="the extra models is not installed")
    from tests.core.segmentation.tiny_models import save_tiny

    save_tiny("efficientloftr", tmp_path / "hub")
    return tmp_path / "hub"


def test_a_model_finds_each_place_again_in_the_same_picture(repository: Path) -> None:
    import torch

    from gaga_core.segmentation.matches import load_matcher

    picture = photograph(walk_cameras(1)[0])
    matcher = load_matcher(repository, 160)
    found = matcher.match(picture, picture)
    assert len(found.scores) > 10
    assert np.median(np.linalg.norm(found.first - found.second, axis=1)) < 1  # of 320 pixels
    wide = matcher.match(picture, np.repeat(picture, 3, axis=1))
    assert np.median(np.linalg.norm(wide.first - wide.second / (3, 1), axis=1)) < 1
    # What is refined side by side are the cells that match, whichever they are.
    true = np.array([[1, 5], [2, 7], [9, 3]])
    scores = torch.zeros(1, 12, 12)
    scores[0, true[:, 0], true[:, 1]] = 0.9
    indices, sure = matcher.network._get_matches_from_scores(scores.view(1, 3, 4, 3, 4))  # type: ignore[attr-defined]
    assert [pair for pair in indices[0].T.tolist() if -1 not in pair] == true.tolist()
    np.testing.assert_array_equal(sure[0] > 0, indices[0] >= 0)
    (repository / "config.json").write_text('{"model_type": "sam2"}')
    with pytest.raises(GagaError, match="type sam2, which matches no photos"):
        load_matcher(repository, 160)


def test_a_refusal_names_the_model_and_a_downloaded_one_is_tried(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fresh_models(tmp_path, monkeypatch)
    for seed in range(4):  # of four rooms: nothing to match
        folder = tmp_path / f"room{seed}"
        write_photos(folder, 1, seed=seed)
        (tmp_path / "photos").mkdir(exist_ok=True)
        (folder / "000.jpg").rename(tmp_path / "photos" / f"{seed}.jpg")
    every, told = ladder.rungs, list[Progress]()

    def first_rungs(photos: PhotoSet, config: SfmConfig, *, has_learned: bool) -> tuple[Rung, ...]:
        return every(photos, config, has_learned=has_learned)[: 1 + has_learned]

    monkeypatch.setattr(ladder, "rungs", first_rungs)  # the later ones take a minute

    def place(scene: str) -> None:
        told.clear()
        config = ReconstructConfig(threads=1)
        run_stage(place_photos(tmp_path / "photos", tmp_path / scene, config), told.append)

    with pytest.raises(GagaError, match=f"gaga models get {MATCHER.name}"):
        place("without")
    assert not any("learned model" in step.message for step in told)
    with serve(Hub({MATCHER.hub: repository})) as hub:
        monkeypatch.setenv("HF_ENDPOINT", hub.url)
        assert main(["models", "get", MATCHER.name, "--accept-licence", MATCHER.name]) == 0
    assert find_model(MATCHER) is not None
    with pytest.raises(GagaError, match=r"^((?!gaga models get).)*$"):
        place("with")
    assert any("learned model" in step.message for step in told)
    assert any("load the model" in step.message for step in told)
