"""A process of its own that groups a large scene and says what it took.

``python -m tests.bench.scale_worker FOLDER N_VIEWS PRESET [N_SPLATS]`` reads the masks that
`write_masks` left in FOLDER and prints one line of JSON. PRESET "regions" takes them for masks that
no model made. The peak of memory is that of the whole process: the scene
with all its view-dependent color, the association, the vote, the identity encodings.
"""

import json
import sys
import time
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import AssociateConfig, associate_stage
from gaga_core.identity.closed_form import Voted, vote_identity
from gaga_core.masks import MaskSet
from gaga_core.progress import Progress, run_stage
from gaga_core.raster import choose
from tests.bench.figures import peak_mib
from tests.scenes import orbit_cameras

N_SPLATS = 3_000_000
N_GROUPS = 300
N_VIEWS = 200
_STRIDE = 77  # about the golden section of the ring, and no divisor of it
_COLUMNS, _ROWS = 20, 15  # of balls on the floor
_FLOOR = 600_000  # splats of no group
_SIZE = (640, 480)


@dataclass(frozen=True)
class Cost:
    """What one run took."""

    associate_s: float  # wall
    vote_s: float  # wall, the part of it that is votes
    identity_s: float  # wall
    cpu_s: float  # of the whole process
    scene_mib: float  # peak of memory when the scene was there
    peak_mib: float  # peak of memory of the process
    groups: int
    right: float  # share of the splats of balls whose group is the one of most of their ball


def cameras(n: int) -> tuple[Camera, ...]:
    """The first ``n`` <= 200 of the cameras around the scene, all round it for any ``n``."""
    ring = orbit_cameras(N_VIEWS, width=_SIZE[0], height=_SIZE[1], radius=2.2)
    return tuple(ring[i * _STRIDE % N_VIEWS] for i in range(n))


def large_scene(n: int = N_SPLATS) -> tuple[Gaussians, IntArray]:
    """``n`` splats: balls on a floor, and the ball (n,) of each, 1..300, 0 = floor. Degree 3."""
    rng = np.random.default_rng(0)
    n_floor = n * _FLOOR // N_SPLATS
    labels = np.zeros(n, np.int32)
    labels[n_floor:] = np.arange(n - n_floor) * N_GROUPS // (n - n_floor) + 1
    x, y = np.meshgrid(np.linspace(-1.4, 1.4, _COLUMNS), np.linspace(-1.4, 1.4, _ROWS))
    centres = np.stack([x.ravel(), y.ravel(), np.full(N_GROUPS, 0.07)], axis=1)
    means = np.empty((n, 3), np.float32)
    means[:n_floor, :2] = rng.uniform(-1.6, 1.6, (n_floor, 2))
    means[:n_floor, 2] = 0
    out = rng.normal(size=(n - n_floor, 3))
    out *= 0.065 / np.linalg.norm(out, axis=1, keepdims=True)
    means[n_floor:] = centres[labels[n_floor:] - 1] + out
    size = np.where(labels > 0, 0.0026, 0.0042) * np.sqrt(N_SPLATS / n)
    gaussians = Gaussians(
        means=means,
        quats=rng.normal(size=(n, 4)).astype(np.float32),
        log_scales=np.log(size[:, None] * rng.uniform(0.4, 1.2, (n, 3))).astype(np.float32),
        logit_opacities=rng.normal(1.5, 1.5, n).astype(np.float32),
        sh=np.full((n, 16, 3), 0.05, np.float32),
    )
    return gaussians, labels


def write_masks(folder: Path, n_views: int, n: int = N_SPLATS) -> None:
    """The true label map of every view, with ids of its own, as <name>.npy (H, W) uint16."""
    gaussians, labels = large_scene(n)
    rng = np.random.default_rng(1)
    for camera in cameras(n_views):
        shown = choose("cpu").label_splat(gaussians, camera, labels).labels
        ids = np.append(0, rng.permutation(N_GROUPS) + 1).astype(np.uint16)
        np.save(folder / f"{camera.name}.npy", ids[shown])


def _load(path: Path) -> IntArray:
    ids: IntArray = np.load(path).astype(np.int32)
    return ids


def group_scene(folder: Path, n_views: int, preset: str, n: int = N_SPLATS) -> Cost:
    """Associate, vote and give encodings, as `gaga associate` and `gaga lift` do."""
    gaussians, truth = large_scene(n)
    scene_mib = peak_mib()
    views = cameras(n_views)
    loaders = {c.name: partial(_load, folder / f"{c.name}.npy") for c in views}
    masks = MaskSet(loaders, "scale", are_regions=preset == "regions")
    voting, last = 0.0, time.perf_counter()

    def watch(step: Progress) -> None:
        nonlocal voting, last
        now = time.perf_counter()
        voting += (now - last) * step.message.startswith("vote")
        last = now

    start = time.perf_counter()
    engine = choose("cpu")
    config = AssociateConfig.of("robust" if masks.are_regions else preset)
    found = run_stage(associate_stage(gaussians, views, masks, engine, config), watch)
    associated = time.perf_counter()
    voted = Voted(found.labels, found.confidence)
    n_groups = found.bank.n_groups
    run_stage(vote_identity(gaussians, voted, found.bank.group, n_groups, views, engine))
    end = time.perf_counter()
    return Cost(
        associate_s=associated - start,
        vote_s=voting,
        identity_s=end - associated,
        cpu_s=time.process_time(),
        scene_mib=scene_mib,
        peak_mib=peak_mib(),
        groups=n_groups,
        right=_share_right(found.labels, truth),
    )


def _share_right(labels: IntArray, truth: IntArray) -> float:
    """Share of splats of balls that have the group of most splats of their ball."""
    table = np.zeros((N_GROUPS + 1, int(labels.max(initial=0)) + 1), np.int64)
    np.add.at(table, (truth, labels), 1)
    table[:, 0] = 0
    return float(table[1:].max(axis=1).sum() / (truth > 0).sum())


if __name__ == "__main__":
    n_splats = int(sys.argv[4]) if len(sys.argv) > 4 else N_SPLATS
    cost = group_scene(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3], n_splats)
    sys.stdout.write(json.dumps(asdict(cost)) + "\n")
