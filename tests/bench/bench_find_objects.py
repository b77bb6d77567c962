"""From photos with splats to objects, stage by stage: masks without a model, groups, identities.

The first 47 training photos of ycb_crowd, and all of them of the same scene in a million splats;
left out where the scene is not on this machine (GAGA_TEST_DATA).
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import AssociateConfig
from gaga_core.io.folder.scene_folder import open_scene_folder, read_model
from gaga_core.pipeline.associate import associate_scene
from gaga_core.pipeline.compile_kernels import after_warm_up
from gaga_core.pipeline.lift import lift_scene
from gaga_core.pipeline.segment import segment_scene
from gaga_core.progress import run_stage
from gaga_core.segmentation.choose import provider_named
from gaga_core.segmentation.regions import NAME
from tests.bench.figures import Figure, data_folder, timed

_PHOTOS = 47
_MANY = 1_000_000  # splats


def figures() -> list[Figure]:
    """CPU seconds of each stage, kernels compiled before."""
    crowd = data_folder("ycb_crowd")
    if not crowd.is_dir():
        return []
    scene = open_scene_folder(crowd)
    train = scene.train[:_PHOTOS]
    cameras = tuple(camera for camera in scene.cameras if camera.name in train)
    gaussians = run_stage(read_model(scene))
    robust = AssociateConfig.of("robust")
    with tempfile.TemporaryDirectory() as name:
        # The same photos with their results elsewhere: real data stays as it is.
        folder = replace(scene, root=Path(name), cameras=cameras, train=train, test=())
        first = replace(folder, cameras=cameras[:2], train=train[:2], root=Path(name) / "first")
        run_stage(after_warm_up(segment_scene(first, provider_named(NAME))))
        made, masks = timed(lambda: run_stage(segment_scene(folder, provider_named(NAME))))
        _, groups = timed(
            lambda: run_stage(associate_scene(folder, made.folder, robust, gaussians=gaussians))
        )
        _, identities = timed(lambda: run_stage(lift_scene(folder, gaussians=gaussians)))
        whole = replace(scene, root=Path(name) / "whole")
        all_made = run_stage(segment_scene(whole, provider_named(NAME)))
        fine = _split(gaussians, -(-_MANY // len(gaussians)))
        _, many = timed(
            lambda: run_stage(associate_scene(whole, all_made.folder, robust, gaussians=fine))
        )
    of = f"find objects: {_PHOTOS} photos"
    return [
        Figure(f"{of}, masks", masks, "CPU-s"),
        Figure(f"{of}, groups", groups, "CPU-s"),
        Figure(f"{of}, identities", identities, "CPU-s"),
        Figure(f"{of}, together", masks + groups + identities, "CPU-s", "<= 20"),
        Figure("find objects: 1M splats, groups", many, "CPU-s", "<= 38"),
    ]


def _split(gaussians: Gaussians, n: int) -> Gaussians:
    """The same surfaces of ``n`` times as many splats, each smaller by the root of ``n``."""
    fine = gaussians.take(np.repeat(np.arange(len(gaussians)), n))
    scales = np.exp(fine.log_scales)
    offset = np.random.default_rng(0).normal(size=scales.shape) * scales * np.sqrt(1 - 1 / n)
    fine.means[:] += Rotation.from_quat(fine.quats, scalar_first=True).apply(offset)
    fine.log_scales[:] -= np.log(n) / 2
    return fine
