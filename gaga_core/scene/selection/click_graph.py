"""What clicks choose among: small pieces of the surfaces, and how likely neighbours are one thing.

No model is needed. Views are rendered and divided into regions; samples of the surfaces, joined to
pieces, get evidence about their borders from creases and from what the views show in one region
(`gaga_core.grouping.hierarchy`). This takes seconds to a minute, once; then clicks are answered
from the graph alone (`click_cut`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.color import rgb_from_dc
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.gate import ViewMasks
from gaga_core.grouping.hierarchy.borders import Agreement, coarse_graph, fine_graph
from gaga_core.grouping.hierarchy.linkage import SignedGraph, joined
from gaga_core.grouping.hierarchy.pieces import Neighbourhood, small_pieces
from gaga_core.grouping.hierarchy.sheets import planes_of
from gaga_core.grouping.hierarchy.surfels import Surfels, sample_surfels
from gaga_core.grouping.robust.surface_points import DepthMaps
from gaga_core.kernels import n_threads, run_chunks
from gaga_core.progress import Progress, Stage, part
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.scene import Scene
from gaga_core.segmentation.regions import regions

STAGE = "Prepare clicks"
_STEPS = 5
_SAMPLES = 60_000  # most samples of the surfaces
_LEAST_SAMPLES = 32  # fewer show no surface
_OPAQUE = 0.5  # alpha of a pixel that shows a surface
_HIDDEN = 3.0  # spacings of the samples within which a splat is near one
_NODES, _PIECES = 4.0, 2.3  # evidence at which small pieces join to nodes, and to judged ones
_PARTS, _OBJECTS = 1.2, 0.9  # ... and those to parts, and to objects
_LEAST_PART, _LEAST_OBJECT = 1.5, 6.0  # samples that a view shows of the smallest, on average
_SAME_GROUP = 1.0  # evidence that two pieces of one group of the scene add
_NEAREST = 6  # samples that decide about a splat
_COLOR = 3.0  # spacings that a splat is away for a unit of color difference
_CHUNK = 65536


@dataclass(frozen=True, eq=False)
class ClickGraph:
    """Nodes are small pieces of surface; samples carry them; splats follow the samples around."""

    points: DoubleArray  # (S, 3) samples, world
    node: LongArray  # (S,) of each sample, dense ids from 0
    graph: SignedGraph  # of nodes; evidence in log odds that two are one thing
    centre: DoubleArray  # (n, 3) of the nodes, world
    part: LongArray  # (n,) the part that each node belongs to
    object: LongArray  # (n,) the object that each node belongs to, as far as can be told
    rows: IntArray  # (K,) splats that can be clicked, ascending
    nearest: IntArray  # (K, k) samples around each
    weights: FloatArray  # (K, k) of them, sum 1
    tree: cKDTree  # of the points

    def splats(self, samples: BoolArray) -> IntArray:
        """Splats (M,), ascending, that chosen samples (S,) bool make chosen."""
        # Imported when first needed: importing numba takes a large part of the launch time.
        from gaga_core.scene.selection.click_kernels import vote_of_samples

        result = np.empty(len(self.rows), np.bool_)

        def work(start: int, stop: int) -> None:
            vote_of_samples(self.nearest, self.weights, samples, result, start, stop)

        run_chunks(work, len(self.rows), _CHUNK)
        return self.rows[result]


def click_graph_stage(
    scene: Scene, views: Sequence[Camera], rasterizer: Rasterizer
) -> Stage[ClickGraph]:
    """Look at what is visible of ``scene`` from ``views`` and build the graph.

    Groups that the scene has are evidence, too. Raises ``GagaError`` when the views show next to
    nothing.
    """
    rows = np.flatnonzero(scene.visible).astype(np.int32)
    labels = scene.labels[rows]
    gaussians = yield from bake_stage(scene, indices=rows)
    looked = yield from part(_looked(gaussians, views, rasterizer), 0, _STEPS, STAGE)
    masks, depths = looked.masks, looked.depths
    sample = sample_surfels(views, lambda c: masks[c.name], lambda _: (), depths, _SAMPLES)
    surfels = yield from part(sample, 1, _STEPS, STAGE)
    yield Progress(STAGE, 2, _STEPS, "unseen surfaces")
    finite = np.isfinite(gaussians.means).all(axis=1)
    surfels = _with_unseen(surfels, gaussians.means[finite & (gaussians.opacities > _OPAQUE)])
    if len(surfels.points) < _LEAST_SAMPLES:
        raise GagaError("The views show next to none of the splats, so nothing can be clicked.")
    yield Progress(STAGE, 3, _STEPS, "splats around the surfaces")
    tree = cKDTree(surfels.points)
    spacing = _spacing(tree)
    nearest, weights = _votes(tree, spacing, gaussians, _colors(looked, views, surfels))
    yield Progress(STAGE, 4, _STEPS, "borders")
    groups = _majority(labels, nearest[:, 0], len(spacing))
    node, graph, parts, objects = _nodes(surfels, groups, len(views))
    sums = [np.bincount(node, column) for column in surfels.points.T]
    centre = np.stack(sums, axis=1) / np.bincount(node)[:, None]
    return ClickGraph(
        surfels.points, node, graph, centre, parts, objects, rows, nearest, weights, tree
    )


@dataclass(frozen=True, eq=False)
class _Looked:
    """What was rendered, by name of the view."""

    depths: DepthMaps
    masks: dict[str, ViewMasks]
    images: dict[str, UInt8Array]  # (H, W, 3)


def _looked(
    gaussians: Gaussians, views: Sequence[Camera], rasterizer: Rasterizer
) -> Stage[_Looked]:
    looked = _Looked(DepthMaps(views), {}, {})
    for i, camera in enumerate(views):
        yield Progress(STAGE, i, len(views), f"look at the scene, {i + 1} of {len(views)}")
        frame = rasterizer.render(gaussians, camera)
        image = np.rint(np.clip(np.nan_to_num(frame.image), 0, 1) * 255).astype(np.uint8)
        looked.depths.add(camera.name, frame.median_depth, frame.alpha, _OPAQUE)
        looked.masks[camera.name] = ViewMasks.of(regions(image, frame.median_depth))
        looked.images[camera.name] = image
    return looked


def _with_unseen(surfels: Surfels, means: FloatArray) -> Surfels:
    """The samples, and some of the splats (K, 3) that no view shows, as samples without more."""
    points, room = surfels.points, _SAMPLES - len(surfels.points)
    if len(points) > 1 and len(means):
        tree = cKDTree(points)
        distance, nearest = tree.query(means.astype(np.float64), workers=n_threads())
        means = means[np.asarray(distance) > _HIDDEN * _spacing(tree)[nearest]]
    if len(means) == 0:
        return surfels
    more = means[:: -(-len(means) // max(room, _LEAST_SAMPLES))].astype(np.float64)
    unknown = np.zeros((len(more), surfels.regions.shape[1]), np.int32)
    return Surfels(
        np.concatenate([points, more]),
        np.concatenate([surfels.normals, np.zeros((len(more), 3))]),
        np.concatenate([surfels.regions, unknown]),
        np.concatenate([surfels.n_views, np.ones(len(more), np.int32)]),
        np.pad(surfels.further, ((0, len(more)), (0, 0))),
    )


def _spacing(tree: cKDTree) -> DoubleArray:
    """Median distance (S,) of each point of a tree to its nearest others, above 0."""
    points = np.asarray(tree.data)
    k = min(_NEAREST + 1, len(points))
    distance = np.asarray(tree.query(points, k=k, workers=n_threads())[0])
    result: DoubleArray = np.maximum(np.median(distance[:, 1:], axis=1), 1e-12)
    return result


def _colors(looked: _Looked, views: Sequence[Camera], surfels: Surfels) -> FloatArray:
    """Mean color (S, 3) of each sample in the views that show it, 0..1; NaN where none does."""
    total, count = np.zeros((len(surfels.points), 3)), np.zeros(len(surfels.points))
    for v, camera in enumerate(views):
        seen = np.flatnonzero(surfels.regions[:, v])
        columns, rows = camera.project(surfels.points[seen])[0].astype(np.int64).T
        total[seen] += looked.images[camera.name][rows, columns]
        count[seen] += 255
    with np.errstate(invalid="ignore"):
        return (total / count[:, None]).astype(np.float32)


def _votes(
    tree: cKDTree, spacing: DoubleArray, gaussians: Gaussians, colors: FloatArray
) -> tuple[IntArray, FloatArray]:
    """The nearest samples (N, k) of each splat, and their weights by distance and color."""
    means = np.where(np.isfinite(gaussians.means), gaussians.means, 0).astype(np.float64)
    k = min(_NEAREST, len(spacing))
    nearest, weights = np.empty((len(means), k), np.int32), np.empty((len(means), k), np.float32)
    rgb = np.clip(rgb_from_dc(gaussians.sh[:, 0]), 0, 1)
    for start in range(0, len(means), _CHUNK):
        rows = slice(start, start + _CHUNK)
        distance, found = tree.query(means[rows], k=k, workers=n_threads())
        away = np.asarray(distance).reshape(-1, k) / spacing[np.asarray(found).reshape(-1, k)]
        unlike = np.linalg.norm(colors[found].reshape(-1, k, 3) - rgb[rows][:, None], axis=2)
        cost = away + _COLOR * np.nan_to_num(unlike)
        voice = np.exp(cost.min(axis=1, keepdims=True) - cost)
        nearest[rows] = np.asarray(found).reshape(-1, k)
        weights[rows] = voice / voice.sum(axis=1, keepdims=True)
    return nearest, weights


def _majority(labels: IntArray, sample: IntArray, n: int) -> IntArray:
    """The group (n,) that most splats of each sample have, 0 = none."""
    grouped = np.flatnonzero(labels > 0)
    n_labels = int(labels.max(initial=0)) + 1
    keys, count = np.unique(
        sample[grouped].astype(np.int64) * n_labels + labels[grouped], return_counts=True
    )
    keys = keys[np.argsort(count, kind="stable")]
    result = np.zeros(n, np.int32)
    result[keys // n_labels] = keys % n_labels  # of one sample the largest count is written last
    return result


def _nodes(
    surfels: Surfels,
    groups: IntArray,  # (S,) of the scene, 0 = none
    n_views: int,
) -> tuple[LongArray, SignedGraph, LongArray, LongArray]:
    """Node of each sample (S,), their graph, and part and object of each node (n,)."""
    near = Neighbourhood.of(surfels.points)
    piece = small_pieces(surfels, near)
    agreement = Agreement.of(surfels, near, piece)
    fine = fine_graph(surfels, near, piece, agreement)
    plane = planes_of(surfels, near)
    shown = surfels.n_views / n_views

    def judged(cluster: LongArray) -> SignedGraph:
        graph = coarse_graph(surfels, near, plane, piece, agreement, cluster)
        evidence = graph.evidence + _of_groups(graph, _group_of(groups, cluster))
        size = np.bincount(cluster, shown).astype(np.float64)
        return replace(graph, evidence=evidence, size=size)

    node_of_piece, judged_of_piece = joined(fine, _NODES), joined(fine, _PIECES)
    judged_of = np.zeros(int(node_of_piece.max()) + 1, np.int64)
    judged_of[node_of_piece] = judged_of_piece
    first = judged(judged_of_piece[piece])
    parts = _joined(first, _PARTS, _LEAST_PART)[judged_of]
    node = node_of_piece[piece]
    objects = _joined(judged(parts[node]), _OBJECTS, _LEAST_OBJECT)[parts]
    return node, _with_judged(fine.contracted(node_of_piece), first, judged_of), parts, objects


def _joined(graph: SignedGraph, evidence: float, least: float) -> LongArray:
    """Clusters (n,) after all joins of so much evidence, and of what is smaller than ``least``."""
    cluster = joined(graph, evidence)
    return joined(graph.contracted(cluster), -np.inf, least)[cluster]


def _with_judged(graph: SignedGraph, judged: SignedGraph, judged_of: LongArray) -> SignedGraph:
    """The graph of nodes (n,) with the evidence of the larger pieces (n,) that they belong to."""
    a, b = judged_of[graph.first], judged_of[graph.second]
    n = len(judged.size)
    at = np.searchsorted(judged.first * n + judged.second, np.minimum(a, b) * n + np.maximum(a, b))
    at = np.minimum(at, max(len(judged.first) - 1, 0))
    evidence = np.where(a == b, graph.evidence, judged.evidence[at] if len(judged.first) else 0)
    return replace(graph, evidence=evidence)


def _group_of(groups: IntArray, cluster: LongArray) -> IntArray:
    """The group (n,) that most samples (S,) of each cluster have, 0 = none."""
    return _majority(groups, cluster.astype(np.int32), int(cluster.max()) + 1)


def _of_groups(graph: SignedGraph, group: IntArray) -> DoubleArray:
    """What groups (n,) of the scene say about each border: one group, two, or nothing."""
    a, b = group[graph.first], group[graph.second]
    return np.where((a == 0) | (b == 0), 0.0, np.where(a == b, _SAME_GROUP, -_SAME_GROUP))
