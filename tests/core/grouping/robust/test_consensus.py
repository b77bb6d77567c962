"""Groups by the consensus of all views: what a minority of views gets wrong does not count."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.grouping.associate import AssociateConfig, Association, associate_stage
from gaga_core.grouping.gate import ViewMasks
from gaga_core.grouping.memory_bank import two_best
from gaga_core.grouping.robust import consensus
from gaga_core.grouping.robust.consensus import (
    ConsensusConfig,
    LinkageRules,
    Priors,
    linkage_stage,
    merged_masks,
    without_wholes,
)
from gaga_core.grouping.robust.surface_points import (
    DepthMaps,
    Leaders,
    masks_of_points,
    point_tables,
    sample_points,
)
from gaga_core.masks import MaskSet
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.core.grouping.true_masks import masks_of, permuted, true_map
from tests.scenes import Synthetic, objects_scene

Spoil = Callable[[int, IntArray], None]


@pytest.fixture(scope="module")
def scene() -> Synthetic:
    return objects_scene(n_objects=5, n_cameras=10, seed=4)


def _spoilt(scene: Synthetic, spoil: Spoil) -> MaskSet:
    """True masks of all views after ``spoil(number of the view, label map)``, under random ids."""
    maps = {}
    for i, camera in enumerate(scene.cameras):
        labels = true_map(scene, camera)
        spoil(i, labels)
        maps[camera.name] = permuted(labels, i)
    return MaskSet({name: partial(maps.__getitem__, name) for name in maps})


def _associate(scene: Synthetic, masks: MaskSet, preset: str) -> Association:
    config = AssociateConfig.of(preset)
    return run_stage(associate_stage(scene.gaussians, scene.cameras, masks, choose(), config))


def _groups_of_objects(scene: Synthetic, result: Association) -> list[int]:
    """The group of most of the drawn splats of each of the five balls and of the floor."""
    seen = result.confidence > 0
    return [int(np.bincount(result.labels[seen & (scene.labels == k)]).argmax()) for k in range(6)]


def test_two_things_that_30_percent_of_the_views_merge_stay_two(scene: Synthetic) -> None:
    def merge(i: int, labels: IntArray) -> None:
        if i in (0, 4, 7):
            labels[labels == 2] = 1
            labels[labels == 4] = 3

    masks = _spoilt(scene, merge)
    groups = _groups_of_objects(scene, _associate(scene, masks, "robust"))
    assert len(set(groups)) == 6
    assert 0 not in groups
    paper = _groups_of_objects(scene, _associate(scene, masks, "paper"))
    assert len(set(paper)) < 6  # the first view decides


def test_wholes_of_many_things_in_half_of_the_views_join_nothing(scene: Synthetic) -> None:
    """Every second view shows the floor with all that stands on it as one mask."""

    def whole(i: int, labels: IntArray) -> None:
        if i % 2 == 0:
            labels[labels > 0] = 1

    result = _associate(scene, _spoilt(scene, whole), "robust")
    groups = _groups_of_objects(scene, result)
    assert len(set(groups)) == result.bank.n_groups == 6


def test_a_whole_is_a_mask_of_four_clusters_that_each_show_well_in_it() -> None:
    cluster = np.repeat(np.arange(1, 7), 20).astype(np.int32)
    mask_of = np.zeros((120, 3), np.int32)
    mask_of[:80, 0], mask_of[80:, 0] = 1, 2  # four clusters, two clusters
    mask_of[:62, 1] = 1  # three, and two points of a fourth one
    mask_of[:, 2] = 1  # all six
    wanted = mask_of.copy()
    wanted[:80, 0], wanted[:, 2] = 0, 0
    found = without_wholes(mask_of, cluster, [3, 2, 2], ConsensusConfig())
    assert np.array_equal(found, wanted)


def test_a_thing_that_40_percent_of_the_views_cut_is_one(scene: Synthetic) -> None:
    def cut(i: int, labels: IntArray) -> None:
        if i % 5 < 2:
            for k in range(1, 6):
                rows, columns = np.nonzero(labels == k)
                right = columns > np.median(columns)
                labels[rows[right], columns[right]] = 20 + k

    result = _associate(scene, _spoilt(scene, cut), "robust")
    assert result.bank.n_groups == 6
    assert len(set(_groups_of_objects(scene, result))) == 6


def test_the_order_of_the_views_does_not_matter(scene: Synthetic) -> None:
    """Cameras under other names, so that they come in another order: the same objects."""

    def merge_first(i: int, labels: IntArray) -> None:
        if i == 0:
            labels[labels > 0] = 1

    masks = _spoilt(scene, merge_first)
    cameras = tuple(
        Camera(c.K, c.cam_from_world, c.width, c.height, f"{(7 * i) % 10:03d}.png")
        for i, c in enumerate(scene.cameras)
    )
    renamed = MaskSet(
        {n.name: masks.loaders[c.name] for n, c in zip(cameras, scene.cameras, strict=True)}
    )
    a = _associate(scene, masks, "robust")
    b = _associate(Synthetic(scene.gaussians, scene.labels, cameras), renamed, "robust")
    pairs = set(zip(_groups_of_objects(scene, a), _groups_of_objects(scene, b), strict=True))
    assert len(pairs) == a.bank.n_groups == b.bank.n_groups == 6


def test_the_same_again_bit_for_bit(scene: Synthetic, monkeypatch: pytest.MonkeyPatch) -> None:
    masks = masks_of(scene, scene.cameras)
    first = _associate(scene, masks, "robust")
    monkeypatch.setenv("GAGA_THREADS", "1")
    again = _associate(scene, masks, "robust")
    assert (again.labels == first.labels).all()
    assert (again.confidence == first.confidence).all()
    assert again.bank.log == first.bank.log


def test_it_stops_at_any_step_and_says_how_far_it_is(scene: Synthetic) -> None:
    masks, config = masks_of(scene, scene.cameras[:3]), AssociateConfig.of("robust")
    arguments = (scene.gaussians, scene.cameras, masks, choose(), config)
    steps = list(associate_stage(*arguments))
    assert [step.done for step in steps] == sorted(step.done for step in steps)
    assert steps[-1].done <= steps[-1].total
    assert any("clusters" in step.message for step in steps)
    for n in range(1, len(steps), 4):
        stage = associate_stage(*arguments)
        for _ in range(n):
            next(stage)
        stage.close()


def test_views_without_masks_and_empty_maps_give_no_groups(scene: Synthetic) -> None:
    empty = np.zeros((120, 160), np.int32)
    masks = MaskSet({camera.name: lambda: empty for camera in scene.cameras[:3]})
    result = _associate(scene, masks, "robust")
    assert result.bank.n_groups == 0
    assert (result.labels == 0).all()


def test_points_lie_on_the_surface_and_halve_when_they_are_too_many(scene: Synthetic) -> None:
    load, depths = _loaded(scene)
    cameras = scene.cameras
    points = run_stage(sample_points(cameras, load, depths, 8, 8192))
    few = run_stage(sample_points(cameras, load, depths, 8, len(points) // 2))
    assert len(points) // 8 < len(few) <= len(points) // 2
    assert not np.array_equal(few, points[: len(few)])  # thinned everywhere, not cut off
    ball = np.abs(np.linalg.norm(points[:, None] - _centres(scene), axis=2) - 0.28).min(axis=1)
    assert (np.minimum(ball, np.abs(points[:, 2] + 0.3)) < 0.06).mean() > 0.97
    mask_of = run_stage(masks_of_points(points, cameras, load, depths))
    per_mask = [np.bincount(mask_of[:, v], minlength=7)[1:] for v in range(len(cameras))]
    assert np.min(per_mask) >= 6  # nearly eight witnesses in every mask of every view


def test_a_point_has_no_mask_where_it_is_hidden(scene: Synthetic) -> None:
    load, depths = _loaded(scene)
    behind = np.array([[0.0, 0.0, -2.0]])  # below the floor
    assert not run_stage(masks_of_points(behind, scene.cameras, load, depths)).any()


def test_a_large_mask_has_more_points_also_when_they_are_too_many(scene: Synthetic) -> None:
    """One view: a floor that fills most of it next to five balls."""
    load, depths = _loaded(scene)
    camera = scene.cameras[0]
    masks = load(camera)
    area = np.bincount(masks.labels.ravel())[1:] / masks.labels.size
    for limit, per_mask in ((8192, 8), (150, 4)):
        points = run_stage(sample_points([camera], load, depths, 8, limit))
        mask_of = run_stage(masks_of_points(points, [camera], load, depths))[:, 0]
        wanted = np.ceil(per_mask * (1 + 40 * area))
        assert np.abs(np.bincount(mask_of, minlength=7)[1:] - wanted).max() <= 2
    assert area.max() > 5 * np.median(area)


def test_linkage_is_what_the_definition_says() -> None:
    """Also with many merges, so that lists of pairs are packed on the way."""
    rng = np.random.default_rng(3)
    for n, n_views in ((40, 9), (1, 3), (70, 20)):
        mask_of = rng.integers(0, 3, (n, n_views)).astype(np.int32)
        for start in range(0, n - 12, 14):
            mask_of[start : start + 12, : n_views - 2] = mask_of[start, : n_views - 2]
        rules = LinkageRules(0.55, 0.1, 2.0)
        expected = _plain_linkage(mask_of, rules.array())
        cluster = run_stage(linkage_stage(mask_of, rules, "link"))
        assert list(dict.fromkeys(cluster.tolist())) == list(range(1, len(expected) + 1))
        found = {frozenset(np.flatnonzero(cluster == c).tolist()) for c in set(cluster.tolist())}
        assert found == expected


@pytest.mark.parametrize("n_pairs", [32_000, 35_000])
def test_more_points_of_one_view_than_16_bits_count_are_linked(n_pairs: int) -> None:
    """Each pair of points in a mask of its own; counts take no more bytes than they must."""
    mask_of = np.repeat(np.arange(1, n_pairs + 1, dtype=np.int32), 2)[:, None]
    assert consensus._counts(mask_of > 0).itemsize == (2 if 2 * n_pairs < 1 << 16 else 4)
    cluster = run_stage(linkage_stage(mask_of, LinkageRules(0.55, 0.1, 2.0), "link"))
    assert np.array_equal(cluster, mask_of[:, 0])


@pytest.mark.parametrize(
    ("n_shared", "touches", "joins"), [(1, False, 0), (2, False, 1), (1, True, 1)]
)
def test_one_stray_point_does_not_join_things_apart(
    n_shared: int, touches: bool, joins: bool
) -> None:
    """Six views see one cluster each, a seventh shows ``n_shared`` points of both in one mask."""
    cluster = np.repeat(np.array([1, 2], np.int32), 20)
    mask_of = np.zeros((40, 7), np.int32)
    mask_of[:20, :3], mask_of[20:, 3:6] = 1, 1
    mask_of[:n_shared, 6], mask_of[20 : 20 + n_shared, 6] = 1, 1
    tables = point_tables(mask_of, cluster, [2] * 7)
    key, value = (
        (np.array([1 * 3 + 2]), np.array([0.6])) if touches else (np.zeros(0, int), np.zeros(0))
    )
    joined = consensus._join_best(tables, Priors(3, key, value), ConsensusConfig())
    assert (joined is not None) == joins


@pytest.mark.parametrize(
    ("leads", "sees", "stays"), [(2, 2, True), (1, 1, False), (2, 8, False), (3, 8, True)]
)
def test_what_few_views_see_is_a_group_if_it_has_a_mask_in_most_of_them(
    leads: int, sees: int, stays: bool
) -> None:
    """A large thing in all of 100 views, and a small one that ``sees`` of them see and ``leads``
    have a mask of; in the others the mask of the large one covers it."""
    cluster = np.repeat(np.array([1, 2], np.int32), [40, 8])
    mask_of = np.zeros((48, 100), np.int32)
    mask_of[:40] = 1
    mask_of[40:, :sees] = 1
    mask_of[40:, :leads] = 2
    tables = point_tables(mask_of, cluster, [3] * 100)
    kept = consensus._supported(tables, np.bincount(cluster), ConsensusConfig())
    assert kept.tolist() == [0, 1, 2 if stays else 0]


def test_a_large_mask_that_holds_most_of_a_small_thing_is_merged() -> None:
    """A table of 100 points: with what the view shows of a cup, with a few points of a bowl."""
    table = csr_matrix([[0, 0, 0, 0], [0, 100, 5, 5], [0, 0, 0, 9], [0, 0, 1, 0]])
    assert merged_masks(table, ConsensusConfig()).tolist() == [1]
    table = csr_matrix([[0, 0, 0, 0], [0, 100, 2, 5], [0, 0, 0, 9], [0, 0, 1, 0]])
    assert merged_masks(table, ConsensusConfig()).tolist() == []


def test_merged_masks_hold_two_groups() -> None:
    table = csr_matrix([[0, 0, 0], [0, 9, 1], [0, 8, 2], [0, 5, 5], [0, 0, 3], [0, 1, 1]])
    assert merged_masks(table, ConsensusConfig()).tolist() == [2, 3]


def test_leaders_are_those_of_the_dense_table() -> None:
    """The two greatest counts of each row, as if no zero were left out."""
    rng = np.random.default_rng(0)
    dense = rng.integers(0, 4, (200, 30)) * (rng.random((200, 30)) < 0.2)
    dense[:, 0], dense[:5] = 0, 0
    dense[5, 2:] = 0
    dense[5, 1] = 3  # one group alone
    found, row = Leaders.of(csr_matrix(dense)), np.arange(200)
    first, second = two_best(dense)
    assert np.array_equal(found.first, first)
    assert np.array_equal(found.second, second)
    assert np.array_equal(found.n_first, dense[row, first])
    assert np.array_equal(found.n_second, dense[row, second])
    assert np.array_equal(found.total, dense.sum(axis=1))


def test_settings_are_checked() -> None:
    for bad in ({"per_mask": 0}, {"max_points": 1}, {"doubt": -1.0}, {"whole_groups": 2}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            ConsensusConfig(**bad)
    with pytest.raises(ValueError, match="agreements"):
        ConsensusConfig(view_agreement=1.0)
    with pytest.raises(ValueError, match="depth"):
        AssociateConfig(depth="none", consensus=ConsensusConfig())


def _centres(scene: Synthetic) -> DoubleArray:
    means = scene.gaussians.means
    found = [means[scene.labels == k].mean(axis=0) for k in range(1, 6)]
    return np.array(found, np.float64)


def _loaded(scene: Synthetic) -> tuple[Callable[[Camera], ViewMasks], DepthMaps]:
    maps = {camera.name: ViewMasks.of(true_map(scene, camera)) for camera in scene.cameras}
    depths = DepthMaps(scene.cameras)
    for camera in scene.cameras:
        frame = choose().render(scene.gaussians, camera)
        depths.add(camera.name, frame.median_depth, frame.alpha, 0.5)
    return lambda camera: maps[camera.name], depths


def _plain_linkage(mask_of: IntArray, rules: DoubleArray) -> set[frozenset[int]]:
    """Average linkage over pairs, from the definition, all agreements afresh after each merge."""
    known = (mask_of[:, None] > 0) & (mask_of[None] > 0)
    same = known & (mask_of[:, None] == mask_of[None])
    both, together = known.sum(axis=2), same.sum(axis=2)
    clusters = [[i] for i in range(len(mask_of))]
    while True:
        best, pair = rules[0], None
        for a in range(len(clusters)):
            for b in range(a + 1, len(clusters)):
                block = np.ix_(clusters[a], clusters[b])
                views = both[block].mean()
                value = (together[block].mean() + 0.5 * rules[2]) / (views + rules[2])
                if views >= rules[1] and value > best + 1e-9:
                    best, pair = value, (a, b)
        if pair is None:
            return {frozenset(cluster) for cluster in clusters}
        clusters[pair[0]] += clusters.pop(pair[1])
        clusters.sort(key=min)
