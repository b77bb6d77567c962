"""Things that are expensive to make, and scene folders with true masks, for tests to copy."""

import hashlib
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock

from gaga_core.camera import Camera
from gaga_core.io.cameras.colmap import write_colmap
from gaga_core.io.masks.label_maps import write_labels
from gaga_core.io.splats.ply import write_ply
from tests.core.grouping.true_masks import permuted, true_map
from tests.scenes import Synthetic


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """The folder that ``make`` fills, once in a test run, whichever process asks first.

    All processes of the run share it, so tests copy it before they write.
    """
    base = factory.getbasetemp()
    root = (base.parent if base.name.startswith("popen-") else base) / f"made-{name}"
    root.mkdir(exist_ok=True)
    target, mark = root / "made", root / "complete"
    with FileLock(root / "lock"):
        if not mark.exists():
            make(target)
            mark.touch()
    return target


def contents(root: Path) -> dict[str, str]:
    """Digest of every file below ``root``, and "" of every folder, by relative path."""
    paths = {path.relative_to(root).as_posix(): path for path in root.rglob("*")}
    return {
        name: hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
        for name, path in paths.items()
    }


def write_true_scene(
    root: Path,
    scene: Synthetic,
    test: Sequence[int] = (),
    *,
    cameras: Sequence[Camera] | None = None,
    top: int = 900,
) -> None:
    """A scene folder whose masks are perfect, under ids of each view's own.

    masks/sim and gt/instance hold them; the views ``test`` are held out in split.json.
    """
    views = scene.cameras if cameras is None else cameras
    write_ply(root / "point_cloud.ply", scene.gaussians)
    write_colmap(root / "sparse" / "0", views, np.zeros((1, 3)), np.zeros((1, 3), np.uint8))
    for i, camera in enumerate(views):
        truth = true_map(scene, camera)
        write_labels(root / "masks" / "sim" / camera.name, permuted(truth, i, top=top))
        write_labels(root / "gt" / "instance" / camera.name, truth)
    names = [camera.name for camera in views]
    held_out = [names[i] for i in test]
    split = {"train": [name for name in names if name not in held_out], "test": held_out}
    (root / "split.json").write_text(json.dumps(split))
