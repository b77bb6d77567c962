"""``python -m gaga_core.io.cameras.colmap_worker MODEL OUT.npz``: read COLMAP through pycolmap.

Run in a process of its own: on damaged files the C++ reader may abort or ask for absurd memory,
and neither may end the window. Prints one line about the failure and exits with 1.
"""

import re
import sys
import time
from pathlib import Path

import numpy as np
import pycolmap

from gaga_core.io.folder.processes import end_with_parent

# Address space beyond what the interpreter has: a damaged count asks for far more, and filling
# even 8 GiB before the refusal takes half a minute.
_CPU_SECONDS, _BYTES_PER_SECOND = 4, 1 << 20  # a tenth of what a whole model is read at
_MEMORY = 1 << 30  # bytes
_MEMORY_PER_BYTE = 20  # of the model's files


def main() -> int:
    """Read the model in argv[1], write arrays to argv[2]."""
    end_with_parent()
    _limit(Path(sys.argv[1]))
    try:
        model = pycolmap.Reconstruction(sys.argv[1])
        _check_cameras(Path(sys.argv[1]) / "cameras.bin", model)
        images = sorted(model.images.values(), key=lambda image: str(image.name))
        used = [model.cameras[image.camera_id] for image in images]
        poses = [np.asarray(image.cam_from_world().matrix()) for image in images]
    except (ValueError, IndexError, KeyError, RuntimeError, MemoryError, OverflowError) as error:
        said = (str(error).splitlines() or ["damaged"])[0]
        sys.stdout.write(re.sub(r"^\[[\w.]+:\d+\] (Check failed: )?", "", said)[:120])
        return 1
    points = list(model.points3D.values())
    np.savez(
        sys.argv[2],
        names=np.array([str(image.name) for image in images], dtype=np.str_),
        K=np.array([c.calibration_matrix() for c in used], np.float64).reshape(-1, 3, 3),
        sizes=np.array([(c.width, c.height) for c in used], np.int64).reshape(-1, 2),
        models=np.array([str(c.model.name) for c in used], dtype=np.str_),
        poses=np.array(poses, np.float64).reshape(-1, 3, 4),
        points=np.array([p.xyz for p in points], np.float64).reshape(-1, 3),
        colors=np.array([p.color for p in points], np.uint8).reshape(-1, 3),
    )
    return 0


def _check_cameras(file: Path, model: pycolmap.Reconstruction) -> None:
    """pycolmap reads a cut-off cameras.bin without a word and leaves zeros for what is missing."""
    wanted = 8 + sum(24 + 8 * len(camera.params) for camera in model.cameras.values())
    if file.is_file() and file.stat().st_size < wanted:
        raise ValueError("cameras.bin is truncated")


def _limit(folder: Path) -> None:
    if sys.platform.startswith("linux"):
        import resource

        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        held = pages * resource.getpagesize()
        files = sum(path.stat().st_size for path in folder.iterdir() if path.is_file())
        limit = held + _MEMORY + _MEMORY_PER_BYTE * files
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        # A cut frames.bin keeps pycolmap counting what is not there for minutes.
        seconds = int(time.process_time()) + _CPU_SECONDS + files // _BYTES_PER_SECOND
        # The soft limit ends it with SIGXCPU, which the caller tells from other ends.
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))


if __name__ == "__main__":
    Path(sys.argv[2]).parent.mkdir(parents=True, exist_ok=True)
    sys.exit(main())
