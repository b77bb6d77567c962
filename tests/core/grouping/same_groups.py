"""Groups, repairs, scores and surfaces of small scenes: digests, as one line of JSON.

``python -m tests.core.grouping.same_groups``, for `test_same_groups` under several processors.
"""

import hashlib
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from types import MappingProxyType

import numpy as np

from gaga_core.arrays import AnyArray, IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.evaluate.group_scores import score_pairs
from gaga_core.fill.surfaces import FillConfig, surfaces_around
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import AssociateConfig, associate_stage
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.grouping.repair.reassociate import NEW, Move, reassociate_stage
from gaga_core.grouping.repair.split_group import split_group_stage
from gaga_core.grouping.repair.view_evidence import Evidence
from gaga_core.grouping.votes import splat_groups
from gaga_core.masks import MaskSet
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.scene.cleanup import clean_object
from gaga_core.scene.scene import Scene
from gaga_core.segmentation.regions import FURTHER_STEPS, regions_at
from tests.core.fill.tables import BOX, table_with_box
from tests.core.grouping.true_masks import true_map
from tests.scenes import Synthetic, objects_scene
from tools.scenes.rooms import Bench, bench_scene

CPU = choose("cpu")
Result = tuple[str, AnyArray]


def results() -> Iterator[Result]:
    yield from _rooms()
    scene = objects_scene(5, 400, n_cameras=8, seed=4)
    for preset in ("paper", "robust"):
        yield from _repaired(scene, AssociateConfig.of(preset), preset)
    yield from _of_true_regions(objects_scene(9, 900, n_cameras=10, seed=2))
    yield from _of_depths()
    yield from _of_photos()
    yield from _filled()


def _log(bank: MemoryBank) -> AnyArray:
    return np.array([(d.view, str(d.mask), str(d.group)) for d in bank.log])


@cache
def _room() -> Bench:
    return bench_scene("room", 0, n_splats=12_000, n_train=10, n_test=2, size=(160, 120))


def _rooms() -> Iterator[Result]:
    bench = _room()
    for preset in ("paper", "robust"):
        config = AssociateConfig.of(preset)
        stage = associate_stage(bench.gaussians, bench.train, bench.masks, CPU, config)
        found = run_stage(stage)
        yield f"{preset} groups", found.labels
        yield f"{preset} log", _log(found.bank)
        shown = [splat_groups(CPU, bench.gaussians, c, found.labels) for c in bench.test]
        yield f"{preset} maps", np.stack(shown)
        pairs = [(bench.truth[c.name], own) for c, own in zip(bench.test, shown, strict=True)]
        yield f"{preset} scores", np.array([str(score) for score in score_pairs(pairs)])
        scene = Scene.of(bench.gaussians, found.labels)
        for group in np.argsort(-np.bincount(found.labels)[1:], kind="stable")[:8] + 1:
            preview = clean_object(scene, int(group))
            yield f"{preset} clean {group}", np.r_[preview.add, -1, preview.remove]


def _repaired(scene: Synthetic, config: AssociateConfig, preset: str) -> Iterator[Result]:
    for merged in ((), (0, 5)):
        maps = {}
        for i, camera in enumerate(scene.cameras):
            labels = true_map(scene, camera)
            if i in merged:
                labels[labels == 2] = 1
            maps[camera.name] = labels
        masks = MaskSet({name: partial(maps.__getitem__, name) for name in maps})
        name = f"{preset} {merged}"
        yield name + " maps", np.stack(list(maps.values()))
        found = run_stage(associate_stage(scene.gaussians, scene.cameras, masks, CPU, config))
        yield name + " labels", found.labels
        evidence = Evidence.of(scene.gaussians, scene.cameras, masks, config)
        for group in range(1, int(found.labels.max()) + 1):
            log = [d for d in found.bank.log if d.group == group]
            rows = np.flatnonzero(found.labels == group).astype(np.int32)
            try:
                split = run_stage(split_group_stage(evidence, log, rows, CPU))
            except GagaError as error:
                yield name + f" split {group}", np.array(str(error))
            else:
                yield name + f" split {group}", split.rows
        for move in (Move("000.png", 4, NEW), Move("003.png", 3, 1)):
            of = found.bank, found.labels, found.confidence
            repair = run_stage(reassociate_stage(evidence, *of, move, CPU))
            yield name + f" {move}", repair.labels


def _views(cameras: Sequence[Camera]) -> list[Camera]:
    """Views from poses without last bits."""
    return [replace(c, cam_from_world=np.round(c.cam_from_world, 9)) for c in cameras]


def _of_true_regions(scene: Synthetic) -> Iterator[Result]:
    """Objects of regions that end at another column in each view."""
    cameras, maps = _views(scene.cameras), {}
    for i, camera in enumerate(cameras):
        true = true_map(scene, camera)
        right = np.arange(camera.width) > camera.width * (3 + i) // 13
        maps[camera.name] = np.where(true > 0, 2 * true + right, 0).astype(np.int32)
    yield from _objects(scene.gaussians, cameras, maps, "true regions")


def _of_depths() -> Iterator[Result]:
    """Depths of a box on a table, every bit of them, and objects whose regions are steps of it."""
    table = table_with_box()
    sizes = np.round(table.gaussians.log_scales, 3)  # logarithms have other last bits elsewhere
    gaussians, cameras, maps = replace(table.gaussians, log_scales=sizes), _views(table.cameras), {}
    for camera in cameras:
        frame = CPU.render(gaussians, camera)
        planes = (frame.alpha, frame.expected_depth, frame.median_depth)
        yield f"depth of {camera.name}", np.stack(planes)
        maps[camera.name] = np.ceil(frame.median_depth / 0.2).astype(np.int32)
    yield from _objects(gaussians, cameras, maps, "steps of depth")


def _of_photos() -> Iterator[Result]:
    """Objects of a generated room without masks: the regions of its photos, at three levels."""
    room, rng = _room(), np.random.default_rng(0)
    columns = ("means", "quats", "log_scales", "logit_opacities")
    gaussians = replace(
        room.gaussians, **{name: np.round(getattr(room.gaussians, name), 3) for name in columns}
    )
    is_stripe = np.floor(20 * gaussians.means[:, 2]) % 2
    palette = np.round(rng.uniform(0.1, 0.7, (int(room.labels.max()) + 1, 3)), 3)
    colors = (palette[room.labels] + 0.2 * is_stripe[:, None]).astype(np.float32)
    maps, further = {}, {}
    for camera in (cameras := _views(room.train[:6])):
        frame = CPU.render(gaussians, camera, channels=colors)
        yield f"photo {camera.name}", frame.image
        photo = (np.clip(frame.image, 0, 1) * 255).astype(np.uint8)
        cuts = regions_at((1.0, *FURTHER_STEPS), photo, frame.median_depth)
        yield f"regions of {camera.name}", np.stack(cuts)
        maps[camera.name], *further[camera.name] = cuts
    yield from _objects(gaussians, cameras, maps, "photos", further)


def _objects(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    maps: Mapping[str, IntArray],
    name: str,
    further: Mapping[str, Sequence[IntArray]] = MappingProxyType({}),
) -> Iterator[Result]:
    loaders = {view: partial(maps.__getitem__, view) for view in maps}
    others = {view: partial(further.__getitem__, view) for view in further}
    masks = MaskSet(loaders, are_regions=True, further=others)
    config = AssociateConfig.of("robust")
    found = run_stage(associate_stage(gaussians, cameras, masks, CPU, config))
    assert found.bank.levels is not None
    yield f"objects of {name}", found.labels
    yield f"levels of {name}", found.bank.levels.labels
    yield f"confidence of {name}", found.confidence


def _filled() -> Iterator[Result]:
    table = table_with_box(sh_degree=1)
    is_box = table.labels == BOX
    planes = surfaces_around(table.gaussians, table.labels, is_box, ~is_box, FillConfig())
    for k, plane in enumerate(planes):
        yield f"plane {k}", plane.splats


def main() -> None:
    found = {name: hashlib.sha256(value.tobytes()).hexdigest()[:12] for name, value in results()}
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    main()
