"""The program that learns what objects are: a tiny run from nothing, and what its scores mean."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gaga_core.grouping.surfaces import boosted_trees
from gaga_core.grouping.surfaces.boosted_trees import FILE, Learned, learned
from gaga_core.grouping.surfaces.objects import grown
from tests.bench.figures import data_folder

pytest.importorskip("mujoco", reason="MuJoCo is not installed: the extra `tools`")
pytest.importorskip("sklearn", reason="scikit-learn is not installed: the extra `tools`")
from tools.learn_objects.learn import Sizes, best_ious, judge, make, scored
from tools.learn_objects.samples import Labelled, scene_samples

_SCANS = data_folder("ycb_meshes")
_TINY = Sizes(train=2, val=1, test=1, trees=8, width=160, views=7, only_scans=True)
pytestmark = pytest.mark.skipif(not _SCANS.is_dir(), reason="no scans here (GAGA_TEST_DATA)")


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("learned")
    make(folder, _SCANS, folder / FILE, sizes=_TINY)
    return folder


@pytest.fixture
def own(work: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Learned]:
    monkeypatch.setattr(boosted_trees, "assets", lambda: work)
    learned.cache_clear()
    yield learned()
    learned.cache_clear()


@pytest.fixture(scope="module")
def scene(work: Path) -> Labelled:
    return scene_samples(work / "train" / "train_001_table", work / "samples", 1)


def test_what_is_learned_is_what_the_program_reads(own: Learned, work: Path) -> None:
    assert [len(trees.roots) for trees in own] == [8, 8, 16, 4]
    card = (work / FILE).with_suffix(".md").read_text("utf-8")
    assert "3 scenes with truth" in card  # one of them without surroundings as well
    assert "| all of scans | 1 |" in card


def test_it_parts_true_borders_better_than_chance(own: Learned, scene: Labelled) -> None:
    """On a scene that it learned from."""
    tree = grown(scene.seen)
    leaves = range(tree.n_leaves)
    same = np.array([np.bincount(scene.truth[tree.leaf == k]).argmax() for k in leaves])
    is_one = same[tree.borders.first] == same[tree.borders.second]
    assert np.median(tree.judged[is_one]) > np.median(tree.judged[~is_one])


def test_the_iou_of_a_node_is_that_of_its_best_object(own: Learned, scene: Labelled) -> None:
    tree = grown(scene.seen)
    found, leaves, weight = best_ious(scene, tree), tree.leaves(), scene.seen.shown
    for node in range(0, len(tree.parent), 7):
        inside = np.isin(tree.leaf, leaves[node].indices)
        ious = [0.0]
        for k in range(1, int(scene.truth.max()) + 1):
            own_samples = scene.truth == k
            ious.append(weight[inside & own_samples].sum() / weight[inside | own_samples].sum())
        assert found[node] == pytest.approx(max(ious))


def test_true_groups_score_full_and_one_group_scores_nothing(scene: Labelled) -> None:
    truth = scene.truth.astype(np.int64)
    assert scored(truth, scene)[:3] == (1.0, 1.0, 1.0)
    iou, precision, recall, listed = scored(np.ones_like(truth), scene)
    n_objects = round(1 / listed)
    assert precision == recall * n_objects  # one group is at most one object
    assert recall <= 1 / n_objects < 0.5
    assert iou < 0.5
    assert scored(np.zeros_like(truth), scene) == (0.0, 0.0, 0.0, 0.0)


def test_test_scenes_are_made_when_they_are_scored(
    own: Learned, work: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert not (work / "test").exists()
    judge(work, _SCANS, _TINY)
    assert "| all of scans | 1 |" in capsys.readouterr().out
