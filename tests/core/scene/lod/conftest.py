"""A tree over a scene of several levels, built once."""

from dataclasses import dataclass

import numpy as np
import pytest

from gaga_core.gaussians import Gaussians
from gaga_core.progress import run_stage
from gaga_core.scene.lod.build import build_lod_stage
from gaga_core.scene.lod.tree import LodTree
from tests.scenes import random_gaussians

N = 90_001  # three levels, none of them full


@dataclass(frozen=True)
class Built:
    gaussians: Gaussians
    tree: LodTree


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    gaussians = random_gaussians(N, sh_degree=1)
    small = gaussians.log_scales - np.float32(1.5)
    scene = Gaussians(
        gaussians.means, gaussians.quats, small, gaussians.logit_opacities, gaussians.sh
    )
    folder = tmp_path_factory.mktemp("model") / "gaga" / "lod"
    return Built(scene, run_stage(build_lod_stage(scene, folder, "digest")))
