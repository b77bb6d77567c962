"""Depth order of the splats, made in a thread of its own: only a jump waits for it."""

import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, UInt8Array
from gaga_core.camera import NEAR, Camera
from gaga_core.gaussians import Gaussians
from gaga_core.kernels import is_compiled
from gaga_core.scene.scene import Placements
from gaga_studio.gpu import sort_kernels

MARGIN = 0.12  # share of the picture's size kept around it: a turning camera has no empty border


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows that are sorted alone, and what is known of each row."""

    rows: IntArray  # (R,) ascending
    reach: FloatArray  # (N,) of `sort_kernels.reaches`
    scores: FloatArray  # (N,) of `sort_kernels.importance`

    def chosen(self, budget: int) -> "_Chosen":
        """The most important ones."""
        if not 0 < budget < len(self.rows):
            return _Chosen(0, self.rows, -np.inf)
        places, least = _best(self.scores[self.rows], budget)
        return _Chosen(budget, self.rows[places], least)


@dataclass(frozen=True, eq=False)
class SortJob:
    """A snapshot to sort: columns are never written in place, so references are enough."""

    ticket: int
    gaussians: Gaussians
    state: UInt8Array  # (N,)
    placement: IntArray  # (N,)
    placements: Placements
    camera: Camera
    budget: int = 0  # most important splats only; 0 = all
    coarse_budget: int = 0  # give the order of these too; 0 = not
    only: Rows | None = None  # of a pool: its columns are written in place, but for these rows


@dataclass(frozen=True, eq=False)
class DepthOrder:
    """Splats that can be seen, far to near, culled with some margin."""

    ticket: int
    order: IntArray  # (M,)
    n_splats: int  # of the scene that was sorted
    near: float  # depths between which 99 % of them lie
    far: float
    budget: int = 0  # of the job
    threshold: float = -np.inf  # of `sort_kernels.importance`, above which splats were taken
    coarse: IntArray | None = None  # (L,) of these the most important of the coarse budget
    coarse_budget: int = 0
    coarse_threshold: float = -np.inf
    camera: Camera | None = None  # for which it was culled; None: nothing was

    def covers(self, camera: Camera) -> bool:
        """Whether nothing that ``camera`` sees, in the depths between which nearly all lies, was
        culled: its corners at these depths, so all between them, are within the margin."""
        if self.camera is None:
            return True
        width, height = camera.width, camera.height
        corners = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1]])
        rays = corners @ np.linalg.inv(camera.K).T
        points = np.concatenate([rays * self.near, rays * self.far])  # (8, 3) of the camera
        world_from_cam = np.linalg.inv(camera.cam_from_world)
        pixels, depths = self.camera.project(
            points @ world_from_cam[:3, :3].T + world_from_cam[:3, 3]
        )
        size = np.array([self.camera.width, self.camera.height])
        margin = MARGIN * size.max()
        is_within = (pixels >= -margin) & (pixels <= size + margin)
        return bool((depths >= NEAR).all() and is_within.all())

    def thinned(self) -> "DepthOrder":
        """The order of the splats of the coarse budget, which there must be."""
        assert self.coarse is not None
        return replace(
            self,
            order=self.coarse,
            budget=self.coarse_budget,
            threshold=self.coarse_threshold,
            coarse=None,
        )


class Sorter:
    """One worker; of several waiting jobs only the latest is done."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._job: SortJob | None = None
        self._result: DepthOrder | None = None
        self._done = 0  # ticket of the last job done
        self._ended = False
        self._columns = SortColumns()
        self._thread = threading.Thread(target=self._work, name="gaga-sort", daemon=True)
        self._thread.start()

    def submit(self, job: SortJob) -> None:
        """Sort this next; a job that has not begun is forgotten."""
        with self._changed:
            self._job = job
            self._changed.notify_all()

    def take(self) -> DepthOrder | None:
        """The newest order that was not taken yet."""
        with self._changed:
            result, self._result = self._result, None
            return result

    def wait(self, ticket: int, timeout: float = 60.0) -> None:
        """Until the job with this ticket is done, at most ``timeout`` seconds."""
        with self._changed:
            self._changed.wait_for(lambda: self._done >= ticket or self._ended, timeout)

    def release(self) -> None:
        """End the worker."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._thread.join(timeout=10)

    def _work(self) -> None:
        try:
            while (job := self._next()) is not None:
                for result, is_last in self._columns.orders(job):
                    with self._changed:
                        self._result = result
                        self._done = job.ticket if is_last else self._done
                        self._changed.notify_all()
        finally:  # however the worker ended, no thread may wait for it
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _next(self) -> SortJob | None:
        with self._changed:
            self._changed.wait_for(lambda: self._job is not None or self._ended)
            job, self._job = self._job, None
            return None if self._ended else job


def plain_order(job: SortJob) -> DepthOrder:
    """The order of all splats in front of the camera, by numpy: what is drawn on a machine's first
    start while the kernels are compiled. Nothing is culled, so it will do as the camera moves.
    """
    poses = _poses(job.placements, job.camera)[0]
    known = (job.placement >= 0) & (job.placement < len(poses))
    forward = poses[np.where(known, job.placement, 0), 2]  # (N, 4)
    depths = (job.gaussians.means * forward[:, :3]).sum(axis=1) + forward[:, 3]
    if job.only is not None:
        listed = np.zeros(len(known), np.bool_)
        listed[job.only.rows] = True
        known &= listed
    seen = known & (job.state & sort_kernels.SKIPPED == 0) & (depths >= NEAR) & np.isfinite(depths)
    rows = np.flatnonzero(seen).astype(np.int32)
    order = rows[np.argsort(-depths[rows], kind="stable")]
    ends = np.percentile(depths[rows], [0.5, 99.5]) if len(rows) else (1.0, 1.0)
    return DepthOrder(job.ticket, order, len(job.gaussians), float(ends[0]), float(ends[1]))


def sort(job: SortJob) -> DepthOrder:
    """The order of ``job``, in this thread."""
    return SortColumns().sort(job)


@dataclass(frozen=True, eq=False)
class _Chosen:
    """The splats of a budget."""

    budget: int
    rows: IntArray  # (R,) ascending; empty stands for all
    threshold: float


_ALL = _Chosen(0, np.zeros(0, np.int32), -np.inf)


class SortColumns:
    """What is worked out once per set of Gaussians, and scratch memory."""

    def __init__(self) -> None:
        self._gaussians: Gaussians | None = None
        self._reach: FloatArray = np.zeros(0, np.float32)
        self._scores: FloatArray | None = None  # importance of each splat
        self._chosen = _ALL  # the budget asked for last
        self._depths: FloatArray = np.zeros(0, np.float32)
        self._ids: IntArray = np.zeros(0, np.int32)
        self._counts = np.zeros(sort_kernels.N_KEYS + 1, np.int32)
        self._is_quick = is_compiled()

    def orders(self, job: SortJob) -> Iterator[tuple[DepthOrder, bool]]:
        """The order of ``job`` and True; before it, while the kernels have to be compiled, which
        takes seconds, the plain one and False."""
        if not self._is_quick:
            with np.errstate(all="ignore"):
                yield plain_order(job), False
        yield self.sort(job), True
        self._is_quick = True

    def sort(self, job: SortJob) -> DepthOrder:
        """Cull and sort."""
        self._prepare(job)
        chosen = self._choose(job, job.budget)
        if job.only is not None and len(chosen.rows) == 0:
            nothing = np.zeros(0, np.int32)
            return DepthOrder(job.ticket, nothing, len(job.gaussians), 1.0, 1.0, job.budget)
        poses, stretch = _poses(job.placements, job.camera)
        n_found = sort_kernels.visible_depths(
            job.gaussians.means,
            self._reach if job.only is None else job.only.reach,
            job.state,
            job.placement,
            chosen.rows,
            poses,
            stretch,
            _lens(job.camera),
            self._depths,
            self._ids,
        )
        order = np.empty(n_found, np.int32)
        quantiles = np.array([1.0, 1.0], np.float32)
        sort_kernels.far_to_near(
            self._depths[:n_found].view(np.uint32),
            self._ids[:n_found],
            self._counts,
            order,
            quantiles.view(np.uint32),
        )
        near, far = float(quantiles[0]), float(quantiles[1])
        result = DepthOrder(
            job.ticket,
            order,
            len(job.gaussians),
            near,
            far,
            job.budget,
            chosen.threshold,
            camera=job.camera,
        )
        coarse = self._choose(job, job.coarse_budget)
        if coarse.budget == 0:
            return result
        is_chosen = np.zeros(len(job.gaussians), np.bool_)
        is_chosen[coarse.rows] = True
        return replace(
            result,
            coarse=order[is_chosen[order]],
            coarse_budget=job.coarse_budget,
            coarse_threshold=coarse.threshold,
        )

    def _prepare(self, job: SortJob) -> None:
        gaussians = job.gaussians
        if self._gaussians is gaussians:
            return
        n = len(gaussians)
        if job.only is None:
            self._reach = sort_kernels.reaches(gaussians.log_scales)
        self._depths = np.empty(n, np.float32)
        self._ids = np.empty(n, np.int32)
        self._scores = None
        self._chosen = _ALL
        self._gaussians = gaussians

    def _choose(self, job: SortJob, budget: int) -> "_Chosen":
        """The most important splats."""
        if job.only is not None:
            return job.only.chosen(budget)
        gaussians = self._gaussians
        if gaussians is None or not 0 < budget < len(gaussians):
            return _ALL
        if self._scores is None:
            self._scores = sort_kernels.importance(gaussians.log_scales, gaussians.logit_opacities)
        if self._chosen.budget != budget:
            self._chosen = _Chosen(budget, *_best(self._scores, budget))
        return self._chosen


def _best(scores: FloatArray, n: int) -> tuple[IntArray, float]:
    """Places (n,) of the largest scores and the least of them.

    Ascending: memory is read forwards, and ties in depth stay as without a budget.
    """
    last = len(scores) - n
    least = np.partition(scores, last)[last]
    return np.flatnonzero(scores >= least)[:n].astype(np.int32), float(least)


def _poses(placements: Placements, camera: Camera) -> tuple[DoubleArray, DoubleArray]:
    """cam_from_file (P, 3, 4) and the factor (P,) by which each placement enlarges at most."""
    matrix = np.asarray(placements.matrix, np.float64)
    poses = camera.cam_from_world[:3, :3] @ matrix
    poses[:, :, 3] += camera.cam_from_world[:3, 3]
    stretch = np.linalg.norm(matrix[:, :, :3], ord=2, axis=(1, 2)) * (1 + 1e-6)
    return np.ascontiguousarray(poses), stretch


def _lens(camera: Camera) -> DoubleArray:
    K, width, height = camera.K, camera.width, camera.height
    margin = MARGIN * max(width, height)
    return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], width, height, NEAR, margin])
