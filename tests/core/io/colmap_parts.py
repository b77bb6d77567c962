"""Small COLMAP models to read."""

from pathlib import Path

import numpy as np

from gaga_core.io.cameras.colmap import write_colmap
from tests.scenes import orbit_cameras


def model_in(folder: Path, n: int = 10) -> Path:
    write_colmap(folder, orbit_cameras(n), np.ones((3, 3)), np.full((3, 3), 9, np.uint8))
    return folder


def bend(model: Path) -> None:
    """Give the cameras of a text model the lens distortion of OpenCV."""
    cameras = model / "cameras.txt"
    lines = cameras.read_text().replace(" PINHOLE ", " OPENCV ").splitlines()
    cameras.write_text("".join(f"{line} 0.1 0.01 0 0\n" for line in lines))
