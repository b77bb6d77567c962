"""Level of detail: what building the tree costs, and a frame of a scene ten times as large.

1M and 10M splats; with GAGA_LOD_FULL=1 3M and 30M, which needs 8 GB of memory and 4 GB of disk.
"""

import os
import tempfile

from tests.bench.figures import Figure
from tests.bench.lod_worker import BUDGET, Cost
from tests.bench.workers import call_worker, run_worker

_ROW = 68  # bytes a splat in the file


def figures() -> list[Figure]:
    """Costs of the larger scene, and of its frame as a ratio to that of the smaller one."""
    is_full = bool(os.environ.get("GAGA_LOD_FULL"))
    with tempfile.TemporaryDirectory() as folder:
        few, many = (_cost(folder, n * 10**6) for n in ((3, 30) if is_full else (1, 10)))
    small, large = f"{few.n // 10**6}M", f"{many.n // 10**6}M"
    file_mib = _ROW * many.n / (1 << 20)
    memory, disk = many.build_mib / file_mib, many.tree_mib / file_mib
    growth = many.frame_ms / few.frame_ms
    most = "<= 8192" if is_full else ""
    return [
        Figure(f"{large}: CPU to build the tree", many.build_s, "s", "" if is_full else "<= 60"),
        Figure(f"{large}: memory to build it, per byte of file", memory, "ratio", "<= 2"),
        Figure(f"{large}: files of the tree, per byte of file", disk, "ratio"),
        Figure(f"{large}: CPU of a frame, per that of {small}", growth, "ratio", "<= 1.3"),
        Figure(f"{large}: CPU of a frame of {BUDGET:,} splats, 960x540", many.frame_ms, "ms"),
        Figure(f"{large}: most that a frame changes after half a turn", many.pop, "1/255", "<= 1"),
        Figure(
            f"{small}: CPU of a frame, per one of all splats", few.frame_ms / few.whole_ms, "ratio"
        ),
        Figure(f"{large}: CPU of a click", many.pick_ms, "ms"),
        Figure(
            f"{large}: CPU of a click, per one among all splats",
            many.pick_ms / many.whole_pick_ms,
            "ratio",
        ),
        Figure(f"{large}: peak of memory, textures included", many.peak_mib, "MiB", most),
    ]


def _cost(folder: str, n: int) -> Cost:
    arguments = [folder, str(n)]
    call_worker("tests.bench.lod_worker", arguments)  # writes the scene
    return Cost(**run_worker("tests.bench.lod_worker", arguments))
