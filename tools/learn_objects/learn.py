"""Learning of `gaga_core.grouping.surfaces`: scenes, four ensembles, and their scores.

Borders are learned round by round, each round with the clusters that the ensemble of the earlier
rounds makes, so that it learns from its own mistakes; then once more from all rounds together.
Objectness is learned from the nodes of the trees that these ensembles grow. Nothing of a test scene
is read before ``test``; twelve of the scanned objects appear in test scenes alone.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np
from sklearn.ensemble import (  # type: ignore[import-untyped]
    HistGradientBoostingClassifier,
    HistGradientBoostingRegressor,
)
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, LongArray
from gaga_core.grouping.surfaces.boosted_trees import FILE, BoostedTrees, Learned, learned
from gaga_core.grouping.surfaces.borders import borders_of, joined
from gaga_core.grouping.surfaces.objects import (
    CHOSEN,
    ROUNDS,
    Tree,
    cuts,
    grown,
    join_crumbs,
    node_features,
)
from gaga_core.io.files import assets, atomic_write
from tools.learn_objects.samples import (
    ALONE,
    Labelled,
    cut_out_samples,
    painted_samples,
    scene_samples,
    trained_samples,
)
from tools.scenes.arrange import KINDS, kind_of
from tools.scenes.make import SceneConfig, Split, make_scene
from tools.scenes.parts import PAINTED_KINDS

_SAME_ROWS = 6000  # borders of small pieces of one object that a scene gives, at most
_ROOM = 0.5  # weight of borders inside of the room
_HIT = 0.5  # IoU from which on an object is found
_TREES, _LEAVES, _ROWS, _RATE = 400, 20, 40, 0.04  # of an ensemble; leaves, their rows; step
_OF_OBJECTS = 2  # times as many trees judge objects: a quarter of them cost 2 points of recall
_PAINTED_SEEDS = {"train": range(101, 104), "val": range(105, 106), "test": range(11, 12)}
_TRAINED = (0, 1, 4, 5, 7)  # seeds whose splats are trained as well
_CUT_OUT = 3  # every so many of the scenes are a scene without surroundings as well
_KNOWN = ("ycb_table", "ycb_crowd")  # scenes that earlier rules were fitted to: training


@dataclass(frozen=True)
class Sizes:
    """How many scenes take part, and how large they are."""

    train: int = 170  # of scanned objects, as are val and test
    val: int = 24
    test: int = 30
    trees: int = _TREES  # of an ensemble of borders; that of objectness has twice as many
    width: int = 480  # pixels of the photos of scanned objects
    views: int = 0  # photos of a scene; 0: drawn, 20 to 60
    only_scans: bool = False  # neither painted scenes nor trained splats

    def of(self, split: Split) -> int:
        """How many scenes of scanned objects a split has."""
        return {"train": self.train, "val": self.val, "test": self.test}[split]


def make(
    work: Path,
    scans: Path,
    out: Path | None = None,
    known: Path | None = None,
    sizes: Sizes = Sizes(),
) -> None:
    """Make the scenes, learn, and write the ensembles and their card.

    Args:
        work: folder for scenes and samples; what is there already is not made again
        scans: folder of .glb and masses_kg.json
        out: file to write; default: the one that the program carries
        known: folder of ycb_table and ycb_crowd, which take part where they are there
        sizes: how many scenes
    """
    out = out or assets() / FILE
    train = list(_scenes(work, scans, "train", sizes))
    for name in _KNOWN if known else ():
        if known and (known / name).is_dir():
            train += [scene_samples(known / name, work / "samples", seed=3)]
    with threadpool_limits(1):  # threads of OpenMP wait for each other where others work, too
        found = learn(train, sizes.trees)
    arrays = dict[str, AnyArray]()
    for name, trees in found._asdict().items():
        arrays |= trees.arrays(name)
    with atomic_write(out) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    rows = scores(_scenes(work, scans, "val", sizes), found)
    with atomic_write(out.with_suffix(".md")) as temporary:
        temporary.write_text(_card(sizes, len(train), rows), encoding="utf-8")


def judge(work: Path, scans: Path, sizes: Sizes = Sizes()) -> None:
    """Score the ensembles that the program carries on the test scenes: once, at the end.

    Args:
        work: folder for scenes and samples
        scans: folder of .glb and masses_kg.json
        sizes: how many scenes
    """
    for row in scores(_scenes(work, scans, "test", sizes), learned()):
        _say(str(row))


def _scenes(work: Path, scans: Path, split: Split, sizes: Sizes) -> Iterator[Labelled]:
    """The scenes of a split, first those of scanned objects, then the painted ones."""
    size = sizes.width, sizes.width * 3 // 4
    for seed in range(sizes.of(split)):
        kind = kind_of(seed)
        folder = work / split / f"{split}_{seed:03d}_{kind}"
        make_scene(folder, scans, SceneConfig(seed, split, kind, *size, sizes.views))
        _say(folder.name)
        yield scene_samples(folder, work / "samples", seed, all_views=split == "test")
        if split != "val" and seed in _TRAINED and not sizes.only_scans:
            yield trained_samples(folder, work, work / "samples", all_views=split == "test")
        if seed % _CUT_OUT == 1:
            yield cut_out_samples(folder, work / "samples" / "alone", seed)
    for seed in () if sizes.only_scans else _PAINTED_SEEDS[split]:
        for painted in PAINTED_KINDS:
            yield painted_samples(painted, seed, work / "samples", all_views=split == "test")


def _say(line: str) -> None:
    """Where the work is."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


# --- Learning.


def learn(scenes: Sequence[Labelled], n_trees: int = _TREES) -> Learned:
    """The ensembles that these scenes teach."""
    rng = np.random.default_rng(0)
    lone = [scene for scene in scenes if scene.name.endswith(ALONE)]
    scenes = [scene for scene in scenes if not scene.name.endswith(ALONE)]
    rows = []
    for scene in scenes:
        borders = borders_of(scene.seen, scene.seen.piece)
        same, weight = _labels(scene, scene.seen.piece, borders.first, borders.second)
        weight = weight * np.sqrt(borders.length)
        kept = rng.permutation(np.flatnonzero(same))[:_SAME_ROWS]
        weight[kept] *= same.sum() / max(len(kept), 1)
        chosen = np.concatenate([np.flatnonzero(~same), kept])
        rows.append((borders.features[chosen], same[chosen], weight[chosen] / len(same)))
    _say(f"small pieces: {len(scenes)} scenes")
    pieces = _log_odds(rows, n_trees)
    rows, by = [], pieces
    for is_last in (False, True):
        clusters = []
        for scene in scenes:
            graph = borders_of(scene.seen, scene.seen.piece).judged(pieces)
            clusters.append(join_crumbs(graph, ROUNDS[0])[scene.seen.piece])
        for k, least in enumerate(ROUNDS[1:], start=1):
            _say(f"borders, round {k} of {len(ROUNDS) - 1}{', again' if is_last else ''}")
            found = [borders_of(s.seen, c) for s, c in zip(scenes, clusters, strict=True)]
            for scene, cluster, borders in zip(scenes, clusters, found, strict=True):
                same, weight = _labels(scene, cluster, borders.first, borders.second)
                weight = weight * np.sqrt(borders.length)
                if len(same):
                    rows.append((borders.features, same, weight / max(weight.sum(), 1e-9)))
            if not is_last:
                by = _log_odds(rows, n_trees)
            clusters = [
                joined(b.judged(by), least)[c] for b, c in zip(found, clusters, strict=True)
            ]
    borders_by = _log_odds(rows, n_trees)
    _say("objects")
    objects, alone = (
        _objectness(some, pieces, borders_by, n)
        for some, n in ((scenes, _OF_OBJECTS * n_trees), (lone, n_trees // 2))
    )
    return Learned(pieces, borders_by, objects, alone)


def _objectness(
    scenes: Sequence[Labelled], pieces: BoostedTrees, borders: BoostedTrees, n_trees: int
) -> BoostedTrees:
    nodes, best = [], []
    for scene in scenes:
        tree = grown(scene.seen, pieces=pieces, borders=borders)
        nodes.append(node_features(scene.seen, tree, scene.views, scene.n_splats))
        best.append(best_ious(scene, tree))
    weights = np.concatenate([np.full(len(b), 1 / np.sqrt(len(b))) for b in best])
    model = HistGradientBoostingRegressor(**_settings(n_trees), random_state=0)
    model.fit(np.concatenate(nodes), np.concatenate(best), sample_weight=weights / weights.mean())
    return _trees_of(model)


def _settings(n_trees: int) -> dict[str, float]:
    return {
        "max_iter": n_trees, "learning_rate": _RATE, "max_leaf_nodes": _LEAVES,
        "min_samples_leaf": _ROWS, "l2_regularization": 5.0, "max_bins": 128, "max_features": 0.3,
    }  # fmt: skip


def _labels(
    scene: Labelled, cluster: LongArray, first: LongArray, second: LongArray
) -> tuple[BoolArray, DoubleArray]:
    """Which borders (B,) of clusters (S,) are inside of one object, and how far that is sure."""
    table = _table(cluster, scene)
    most = table.argmax(axis=1)
    pure = table.max(axis=1) / np.maximum(table.sum(axis=1), 1e-9)
    same = most[first] == most[second]
    weight = pure[first] * pure[second]
    return same, np.where(same & (most[first] == 0), _ROOM * weight, weight)


def _table(cluster: LongArray, scene: Labelled) -> DoubleArray:
    """Samples (n, K + 1) that a view shows, mean, of each cluster in each true object."""
    n, k = int(cluster.max()) + 1, int(scene.truth.max()) + 1
    counts = np.bincount(cluster * k + scene.truth, scene.seen.shown, n * k)
    return counts.reshape(n, k).astype(np.float64)


def best_ious(scene: Labelled, tree: Tree) -> DoubleArray:
    """IoU (n,) of the samples of each node with the true object that is most alike."""
    of_leaves = _table(tree.leaf, scene)
    of_nodes = np.asarray(tree.leaves() @ of_leaves)
    every = of_nodes.sum(axis=1)[:, None] + of_leaves.sum(axis=0) - of_nodes
    return (of_nodes / np.maximum(every, 1e-9))[:, 1:].max(axis=1, initial=0.0)


def _log_odds(
    rows: Sequence[tuple[DoubleArray, BoolArray, DoubleArray]], n_trees: int
) -> BoostedTrees:
    features, same, weight = (np.concatenate(column) for column in zip(*rows, strict=True))
    model = HistGradientBoostingClassifier(**_settings(n_trees), random_state=0)
    model.fit(features, same, sample_weight=weight / weight.mean())
    return _trees_of(model)


def _trees_of(
    model: HistGradientBoostingClassifier | HistGradientBoostingRegressor,
) -> BoostedTrees:
    """The ensemble as numbers of 32 bits, nodes in the order in which they are asked."""
    roots, nodes = list[int](), list[list[float]]()  # feature, threshold, right, value

    def add(tree: AnyArray, k: int) -> None:
        place = len(nodes)
        nodes.append([0, 0, 0, tree[k]["value"]])
        if tree[k]["is_leaf"]:
            return
        nodes[place][:2] = tree[k]["feature_idx"], tree[k]["num_threshold"]
        add(tree, tree[k]["left"])
        nodes[place][2] = len(nodes)
        add(tree, tree[k]["right"])

    for (predictor,) in model._predictors:
        roots.append(len(nodes))
        add(predictor.nodes, 0)
    feature, threshold, right, value = np.array(nodes, np.float64).T
    base = np.ravel(model._baseline_prediction)
    halves = (a.astype(np.float32).astype(np.float64) for a in (threshold, value, base))
    threshold, value, base = halves
    whole = (a.astype(np.int32) for a in (np.array(roots), feature, right))
    of_roots, of_feature, of_right = whole
    return BoostedTrees(of_roots, of_feature, threshold, of_right, value, base)


# --- Scores.


@dataclass(frozen=True)
class Row:
    """Scores of one kind of scene, in percent: means over scenes, and their standard deviations."""

    kind: str
    n_scenes: int
    iou: tuple[float, float]
    precision: tuple[float, float]
    recall: tuple[float, float]
    listed: float  # groups for each true object

    def __str__(self) -> str:
        figures = (self.iou, self.precision, self.recall)
        cells = " | ".join(f"{mean:.1f} ± {spread:.1f}" for mean, spread in figures)
        return f"| {self.kind} | {self.n_scenes} | {cells} | {self.listed:.2f} |"


def scores(scenes: Iterator[Labelled], by: Learned) -> list[Row]:
    """Scores by kind, then of all scenes of scanned objects."""
    found = dict[str, list[tuple[float, float, float, float]]]()
    for scene in scenes:
        tree = grown(scene.seen, pieces=by.pieces, borders=by.borders)
        judge = by.alone if scene.name.endswith(ALONE) else by.objects
        objectness = judge(node_features(scene.seen, tree, scene.views, scene.n_splats))
        clusters, behind, _ = cuts(tree, objectness, np.zeros(len(objectness), np.bool_))
        groups = np.where(behind, 0, 1 + clusters[CHOSEN])
        kind, of_scene = _kind_of(scene.name), scored(groups, scene)
        for name in (kind, "all of scans") if kind in KINDS else (kind,):
            found.setdefault(name, []).append(of_scene)
    rows = []
    for name, values in sorted(found.items()):
        mean, spread = np.mean(values, axis=0), np.std(values, axis=0)
        three = [(float(100 * mean[k]), float(100 * spread[k])) for k in range(3)]
        rows.append(Row(name, len(values), three[0], three[1], three[2], float(mean[3])))
    return rows


def _kind_of(name: str) -> str:
    """Of a scene: ``val_003_single``, ``trained_test_001_table``, ``room_105``."""
    first, *_, last = name.split("_")
    if first == "trained":
        return "trained splats"
    if name.endswith(ALONE):
        return "without surroundings"
    return f"painted {first}" if last.isdecimal() else last


def scored(groups: LongArray, scene: Labelled) -> tuple[float, float, float, float]:
    """Score groups (S,), 0 = not listed, by samples that views show, without void: IoU, precision,
    recall, and the listed groups for each true object."""
    table = _table(groups, scene)
    inside, true = table[:, 1:], table[:, 1:].sum(axis=0)
    iou = inside / np.maximum(inside.sum(axis=1)[:, None] + true - inside, 1e-9)
    iou[0] = 0
    there = true > 1
    listed = np.flatnonzero(inside.sum(axis=1) > 0.5)
    listed = listed[listed > 0]
    best = iou[:, there].max(axis=0)
    precision = float((iou[listed].max(axis=1) > _HIT).mean()) if len(listed) else 0.0
    n_listed = int((table[1:].sum(axis=1) > 0.5).sum())
    return float(best.mean()), precision, float((best > _HIT).mean()), n_listed / int(there.sum())


def _card(sizes: Sizes, n_train: int, rows: Sequence[Row]) -> str:
    """What the ensembles are, for people."""
    lines = "\n".join(str(row) for row in rows)
    return f"""# What `{FILE}` holds

Four ensembles of regression trees, learned on {date.today().isoformat()} by `python -m
tools.learn_objects make`: whether two small pieces of surface are one object ({sizes.trees} trees),
the same of what has grown from them ({sizes.trees}), the IoU of a node of the tree of joins with a
true object ({_OF_OBJECTS * sizes.trees}), and the same in files of objects without surroundings
({sizes.trees // 2}).

Data: {n_train} scenes with truth. {sizes.train} of scanned objects of the YCB set (CC BY 4.0) that
fell on tables, shelves, into boxes and bowls and onto each other (`tools.scenes`, seeds 0 to
{sizes.train - 1} of `train`; every fifth object appears in test scenes alone), objects cut out of
every third of them for the last ensemble, painted rooms, tables, contents and objects of parts, and
the scenes ycb_table and ycb_crowd. Of each scene 10 to 60 views were used, and regions of 400 or
480 pixels.

Scores on validation scenes, by samples of the surface, at the level of whole objects: mean and
standard deviation over scenes of IoU, precision, recall in percent, and listed groups for each true
object. Settings were chosen on them; `python -m tools.learn_objects test` has the test scenes.

| kind | scenes | IoU | precision | recall | listed |
|---|---|---|---|---|---|
{lines}
"""
