"""``python -m gaga_core.io.colmap_worker MODEL OUT.npz``: read a COLMAP model through pycolmap.

Run in a process of its own: on damaged files the C++ reader may abort or ask for absurd memory,
and neither may end the window. Prints one line about the failure and exits with 1.
"""

import sys
from pathlib import Path

import numpy as np
import pycolmap

_MEMORY = 8 << 30  # bytes of address space; a damaged count asks for far more


def main() -> int:
    """Read the model in argv[1], write arrays to argv[2]."""
    _limit_memory()
    try:
        model = pycolmap.Reconstruction(sys.argv[1])
        images = sorted(model.images.values(), key=lambda image: str(image.name))
        used = [model.cameras[image.camera_id] for image in images]
        poses = [np.asarray(image.cam_from_world().matrix()) for image in images]
    except (ValueError, IndexError, KeyError, RuntimeError, MemoryError, OverflowError) as error:
        sys.stdout.write(str(error).splitlines()[0][:200] if str(error) else "damaged")
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


def _limit_memory() -> None:
    if sys.platform.startswith("linux"):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))


if __name__ == "__main__":
    Path(sys.argv[2]).parent.mkdir(parents=True, exist_ok=True)
    sys.exit(main())
