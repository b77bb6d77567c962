"""Three million Gaussians, 300 groups, views of 640x480: memory and time of grouping them.

Each run is a process of its own (`scale_worker`), so that its peak of memory is its own. The whole
run of 200 views takes some ten minutes; here 10 and 40 views show what a view costs, in seconds and
in memory, and what 200 of them come to. ``python -m tests.bench.bench_scale 200`` runs it whole.
"""

import sys
import tempfile
from pathlib import Path

from tests.bench.figures import Figure
from tests.bench.scale_worker import N_VIEWS, Cost, write_masks
from tests.bench.workers import run_worker

_FEW, _MANY = 10, 40
_LIMIT_MIB = 8192


def figures() -> list[Figure]:
    """Peak memory of 40 views, what 30 of them add to it, and time, of the preset "paper"."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_masks(folder, _MANY)
        many = run(folder, _MANY, "paper")
        few = run(folder, _FEW, "paper")
        robust = run(folder, _FEW, "robust")
        regions = run(folder, _FEW, "regions")
    by_view = (many.peak_mib - few.peak_mib) / (_MANY - _FEW)
    whole = many.peak_mib + (N_VIEWS - _MANY) * max(by_view, 0)
    seconds = (many.associate_s - few.associate_s) / (_MANY - _FEW)
    name = f"3M, 300 groups, {_MANY} views, 640x480"
    limit = f"<= {_LIMIT_MIB}"
    return [
        Figure(f"scale: {name}: peak memory", many.peak_mib, "MiB", limit),
        Figure("scale: of that, the scene itself", many.scene_mib, "MiB"),
        Figure("scale: memory that one more view adds", by_view, "MiB"),
        Figure(f"scale: peak memory of {N_VIEWS} views", whole, "MiB", limit),
        Figure(f"scale: peak memory, robust, {_FEW} views", robust.peak_mib, "MiB", limit),
        Figure("scale: association and vote, one view more", seconds, "s"),
        Figure("scale: share of that which is votes", many.vote_s / many.associate_s, ""),
        Figure("scale: identity encodings in closed form", many.identity_s, "s"),
        Figure("scale: association and vote, robust, a view", robust.associate_s / _FEW, "s"),
        Figure(
            f"scale: peak memory, without a model, {_FEW} views", regions.peak_mib, "MiB", limit
        ),
        Figure("scale: association without a model, a view", regions.associate_s / _FEW, "s"),
        Figure("scale: groups found of 300", many.groups, ""),
        Figure("scale: splats of balls in their ball's group", many.right, ""),
        Figure(f"scale: the same, robust, {_FEW} views", robust.right, ""),
    ]


def run(folder: Path, n_views: int, preset: str) -> Cost:
    """One run in a process of its own, over the masks in ``folder``."""
    arguments = [str(folder), str(n_views), preset]
    return Cost(**run_worker("tests.bench.scale_worker", arguments))


def _whole(n_views: int) -> None:
    """Run ``n_views`` views with both presets and say what it took."""
    with tempfile.TemporaryDirectory() as name:
        write_masks(Path(name), n_views)
        for preset in ("paper", "robust"):
            sys.stdout.write(f"{preset}: {run(Path(name), n_views, preset)}\n")


if __name__ == "__main__":
    _whole(int(sys.argv[1]))
