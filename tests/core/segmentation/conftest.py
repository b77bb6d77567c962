"""Tiny models with random weights, saved as people have them on disk; made once a test run."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import UInt8Array

NO_TRANSFORMERS = "transformers is not installed: pip install .[models]"

SAM_KINDS = ("sam", "sam_hq", "sam2", "sam2_video", "sam3_tracker")
UNIVERSAL_KINDS = ("mask2former", "maskformer", "eomt")


@pytest.fixture(scope="session")
def model_folder(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The folder of a tiny model by its type."""
    pytest.importorskip("transformers", reason=NO_TRANSFORMERS)
    from tests.core.segmentation.tiny_models import save_tiny

    base = tmp_path_factory.mktemp("models")

    def folder(kind: str) -> Path:
        path = base / kind
        if not path.is_dir():
            save_tiny(kind, path)
        return path

    return folder


@pytest.fixture(scope="session")
def photo() -> UInt8Array:
    """A picture (90, 120, 3) of four flat tiles with noise."""
    rng = np.random.default_rng(0)
    tiles = rng.integers(0, 255, (2, 2, 3))
    image = np.repeat(np.repeat(tiles, 45, axis=0), 60, axis=1) + rng.normal(0, 12, (90, 120, 3))
    return np.clip(image, 0, 255).astype(np.uint8)
