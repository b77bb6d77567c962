"""Click to segment without a model: clicks to a good object, and what a click costs.

The true object of a splat is the vote of all true label maps. A simulated person clicks each object
where it is deepest in the view that shows most of it, of every second held-out view, then again and
again where the largest error of any of them is deepest: on the object if it is missing there, off
it if not (as interactive segmentation is measured: Sofiiuk et al., ICIP 2022). IoU is of splats,
each by the weight with which the views show it. Settings were chosen on ycb_table, a generated room
and a quarter of the demo's objects; ycb_crowd took no part. Scenes that are not on this machine are
left out (GAGA_TEST_DATA).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.sparse import csr_matrix

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.votes import vote_labels
from gaga_core.io.folder.scene_folder import SceneFolder, read_model, select_views
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.by_screen import pick
from gaga_core.scene.selection.click import (
    Answer,
    Click,
    ClickGraph,
    click_graph_stage,
    click_views,
    clicked,
    nothing_yet,
)
from tests.bench.figures import Figure, median_ms
from tests.bench.known_scenes import known_scenes, true_labels

_GOOD = 0.9  # IoU
_MOST = 6  # clicks
_REPORTED = (1, 3, 5)
_SHOWN = 0.5  # summed weight of the splats that make a pixel
_LEAST = 30  # pixels of an object in a view, at half size
_MILLION = 1_000_000


@dataclass(frozen=True, eq=False)
class _View:
    """A held-out view at half size."""

    camera: Camera
    weights: csr_matrix  # (H W, N) what each splat adds to each pixel
    depth: FloatArray  # (H, W)

    def shows(self, chosen: BoolArray) -> BoolArray:
        """Pixels (H, W) that splats (N,) make for the most part."""
        weight = self.weights @ chosen.astype(np.float32)
        return np.asarray(weight.reshape(self.depth.shape) > _SHOWN)


@dataclass(frozen=True, eq=False)
class _Set:
    """A scene with known objects, looked at and ready for clicks."""

    gaussians: Gaussians
    graph: ClickGraph
    truth: IntArray  # (N,)
    counts: FloatArray  # (N,) weight with which the views show each splat
    views: tuple[_View, ...]


def figures() -> list[Figure]:
    """Clicks to IoU 0.9, IoU after some clicks, and the cost of one at a million splats."""
    found: list[Figure] = []
    graph = None
    for name, folder in known_scenes("ycb_table", "ycb_crowd", "demo"):
        scene = _looked_at(folder)
        ious = np.array([_ious(scene, k) for k in _objects(scene)])
        reached = ious >= _GOOD
        needed = np.where(reached.any(axis=1), reached.argmax(axis=1) + 1, _MOST)
        bar = "<= 3"
        found.append(Figure(f"click: {name}, clicks to IoU 0.9", float(needed.mean()), "", bar))
        found += [
            Figure(f"click: {name}, IoU after {n}", float(ious[:, n - 1].mean()), "")
            for n in _REPORTED
        ]
        graph, gaussians = scene.graph, scene.gaussians
    assert graph is not None
    return [*found, _cost(graph, gaussians)]


def _looked_at(folder: SceneFolder) -> _Set:
    gaussians = run_stage(read_model(folder))
    maps = {camera.name: true_labels(folder, camera) for camera in folder.cameras}
    # Background takes part in the vote as label 1.
    n = 1 + max(int(m.max()) for m in maps.values())
    votes = run_stage(
        vote_labels(gaussians, folder.cameras, lambda c: maps[c.name] + 1, n, choose("cpu"))
    )
    graph = run_stage(
        click_graph_stage(
            Scene.of(gaussians),
            click_views(select_views(folder, "train"), gaussians.means),
            choose("cpu"),
        )
    )
    views = tuple(_view(gaussians, c) for c in select_views(folder, "test")[::2])
    truth = np.maximum(votes.labels - 1, 0).astype(np.int32)
    return _Set(gaussians, graph, truth, votes.weight, views)


def _view(gaussians: Gaussians, camera: Camera) -> _View:
    small = camera.resized(camera.width // 2, camera.height // 2)
    n = small.width * small.height
    found = choose("cpu").weights(gaussians, small, np.arange(n), w_min=0.01)
    rows = (found.weights, found.indices, found.indptr)
    depth = choose("cpu").render(gaussians, small).median_depth
    shape = (n, len(gaussians))
    return _View(small, csr_matrix(rows, shape=shape), depth)


def _objects(scene: _Set) -> list[int]:
    """Objects that a held-out view shows."""
    shown = []
    for k in np.unique(scene.truth[scene.truth > 0]).tolist():
        most = max(int(view.shows(scene.truth == k).sum()) for view in scene.views)
        if most >= _LEAST:
            shown.append(k)
    return shown


def _ious(scene: _Set, k: int) -> DoubleArray:
    """IoU (6,) of an object after each click; after the last error it stays."""
    true = scene.truth == k
    answer: Answer = nothing_yet(scene.graph)
    chosen = np.zeros(len(scene.truth), np.bool_)
    ious: list[float] = []
    while len(ious) < _MOST:
        click = _next_click(scene, true, chosen)
        if click is not None:
            answer = clicked(scene.graph, answer, click)
            chosen = np.zeros(len(scene.truth), np.bool_)
            chosen[scene.graph.splats(answer.samples)] = True
        ious.append(float(scene.counts[chosen & true].sum() / scene.counts[chosen | true].sum()))
    return np.array(ious)


def _next_click(scene: _Set, true: BoolArray, chosen: BoolArray) -> Click | None:
    """A click where the largest error of any view is deepest; None when there is none."""
    best, largest = None, 0
    for view in scene.views:
        wanted = view.shows(true)
        wrong = (wanted != view.shows(chosen)) & (view.depth > 0)
        parts, n = ndimage.label(wrong)
        if n == 0:
            continue
        area = np.bincount(parts.ravel())[1:]
        if area.max() <= largest:
            continue
        largest = int(area.max())
        inside = np.pad(parts == area.argmax() + 1, 1)
        deep = ndimage.distance_transform_edt(inside)[1:-1, 1:-1]
        row, column = np.unravel_index(int(deep.argmax()), deep.shape)
        depth = float(view.depth[row, column])
        x, y, z = view.camera.unproject(column + 0.5, row + 0.5, depth).tolist()
        best = Click((x, y, z), bool(wanted[row, column]))
    return best


def _cost(graph: ClickGraph, gaussians: Gaussians) -> Figure:
    """CPU time of the second click among a million splats: copies of those of a scene."""
    rows = np.resize(np.arange(len(gaussians)), _MILLION)
    place = np.zeros(len(gaussians), np.int64)
    place[graph.rows] = np.arange(len(graph.rows))
    large = replace(
        graph,
        rows=np.arange(_MILLION, dtype=np.int32),
        nearest=graph.nearest[place[rows]],
        weights=graph.weights[place[rows]],
    )
    scene = Scene.of(gaussians.take(rows))
    camera = click_views((), gaussians.means)[5]
    x, y, z = graph.centre[np.argmax(np.bincount(graph.object[graph.node]))].tolist()
    first = clicked(large, nothing_yet(large), Click((x, y, z)))
    u, v = camera.width / 2, camera.height / 2

    def click() -> None:
        found = pick(scene, camera, u, v)
        assert found is not None
        a, b, c = found.point.tolist()
        answer = clicked(large, first, Click((a, b, c), is_on=False))
        History(scene).do(edits.select(scene, large.splats(answer.samples), "set"))

    return Figure("click: one more among 1M splats", median_ms(click), "CPU-ms", "<= 300")
