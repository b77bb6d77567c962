"""Objects without a model: regions of the photos, the preset robust, and what comes out.

IoU, precision and recall are of held-out views at the level of whole objects, void left out; best
level: of each true object with the group that covers it best at any level. What parts objects was
learned from scenes with truth (`tools.learn_objects`): among them ycb_table and ycb_crowd, and
generated rooms, tables, contents and objects of parts of other seeds than here, but not the demo.
Each figure is the mean over four draws (regions of two widths, of all views and of some), and the
worst of them: a result that only one of them reaches is luck.
Scenes that are not on this machine are left out (GAGA_TEST_DATA).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.evaluate.group_scores import HIT
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import AssociateConfig, Association, associate_stage
from gaga_core.grouping.votes import splat_groups
from gaga_core.io.folder.scene_folder import SceneFolder, read_model, select_views
from gaga_core.io.images import read_rgb
from gaga_core.masks import MaskSet
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.segmentation.regions import FURTHER_STEPS, RegionsConfig, regions_at
from tests.bench.figures import Figure
from tests.bench.known_scenes import held_out_score, known_scenes, true_labels
from tools.scenes.parts import PAINTED_KINDS, Painted, painted_scene

_BARS = {
    "ycb_table": (">= 0.87", ">= 0.82", ">= 0.95", ">= 0.97"),
    "ycb_crowd": (">= 0.87", ">= 0.82", ">= 0.95", ">= 0.97"),
    "demo": (">= 0.65", ">= 0.50", "", ""),
}
_WIDTHS = (480, 560)  # pixels
_SHARES = (1.0, 0.7)  # of the train views
_ROOM_SEED = 0
_FEW = (9, 12, 15)  # photos


@dataclass(frozen=True, eq=False)
class _Set:
    """A scene with photos and truth."""

    gaussians: Gaussians
    photos: Mapping[str, UInt8Array]  # of the train views
    train: tuple[Camera, ...]
    test: tuple[Camera, ...]
    truth: Mapping[str, IntArray]  # of the test views, 0 = void


def figures() -> list[Figure]:
    """Scores of each scene that is there."""
    found: list[Figure] = []
    for name, scene in _sets():
        values = np.array([scores for width in _WIDTHS for scores in _scores(scene, width)])
        kinds = ("IoU", "precision", "recall", "recall at the best level")
        bars = _BARS.get(name, ("",) * 4)
        for kind, value, worst, bar in zip(
            kinds, values.mean(axis=0), values.min(axis=0), bars, strict=True
        ):
            found.append(Figure(f"objects: {name}, {kind}", value, "", bar))
            found.append(Figure(f"objects: {name}, {kind}, worst", worst, ""))
        if name in ("demo", "room"):
            listed, recall = np.mean([_of_few(scene, n) for n in _FEW], axis=0)
            found += [
                Figure(
                    f"objects: {name}, 9 to 15 photos, groups a true object", listed, "", "<= 1.5"
                ),
                Figure(f"objects: {name}, 9 to 15 photos, recall", recall, ""),
            ]
    return found


def _of_few(scene: _Set | Painted, n: int) -> tuple[float, float]:
    """Listed groups for each true object, and recall, from ``n`` of the train views."""
    chosen = np.linspace(0, len(scene.train) - 1, n).round().astype(int)
    few = replace(scene, train=tuple(scene.train[k] for k in chosen))
    association = _associated(few, few.train, _regions(few, _WIDTHS[0]))
    score = held_out_score(scene.gaussians, association.labels, scene.test, scene.truth)
    n_true = len(np.setdiff1d(np.concatenate([*map(np.unique, scene.truth.values())]), [0]))
    return (len(np.setdiff1d(association.labels, [0])) - 1) / n_true, score.recall  # background


def _scores(scene: _Set | Painted, width: int) -> Iterator[tuple[float, float, float, float]]:
    """IoU, precision, recall, and recall at the best level, from regions of one width, of all views
    and of some of them."""
    masks = _regions(scene, width)
    for share in _SHARES:
        n_views = round(share * len(scene.train))
        drawn = np.random.default_rng(width).permutation(len(scene.train))[:n_views]
        association = _associated(scene, [scene.train[k] for k in np.sort(drawn)], masks)
        score = held_out_score(scene.gaussians, association.labels, scene.test, scene.truth)
        yield score.iou, score.precision, score.recall, _best_recall(scene, association)


def _sets() -> Iterator[tuple[str, _Set | Painted]]:
    for name, folder in known_scenes("ycb_table", "ycb_crowd", "demo"):
        yield name, _of_folder(folder)
    for kind in PAINTED_KINDS:
        yield kind, painted_scene(kind, _ROOM_SEED)


def _of_folder(folder: SceneFolder) -> _Set:
    train, test = select_views(folder, "train"), select_views(folder, "test")
    return _Set(
        run_stage(read_model(folder)),
        {camera.name: read_rgb(folder.require_image(camera.name)) for camera in train},
        train,
        test,
        {camera.name: true_labels(folder, camera) for camera in test},
    )


def _regions(scene: _Set | Painted, width: int) -> MaskSet:
    """Regions of the train views, at several levels of detail."""
    engine = choose("cpu")
    nothing = np.zeros((len(scene.gaussians), 1), np.float32)
    maps, further = {}, {}
    for camera in scene.train:
        depth = engine.render(scene.gaussians, camera, channels=nothing).median_depth
        config = RegionsConfig(width=width)
        steps, photo = (1.0, *FURTHER_STEPS), scene.photos[camera.name]
        maps[camera.name], *further[camera.name] = regions_at(steps, photo, depth, None, config)
    loaders = {name: partial(maps.__getitem__, name) for name in maps}
    others = {name: partial(further.__getitem__, name) for name in further}
    return MaskSet(loaders, "regions", are_regions=True, further=others)


def _associated(scene: _Set | Painted, views: Sequence[Camera], masks: MaskSet) -> Association:
    """The groups of the regions of some train views."""
    config = AssociateConfig.of("robust")
    return run_stage(associate_stage(scene.gaussians, views, masks, choose("cpu"), config))


def _best_recall(scene: _Set | Painted, association: Association) -> float:
    """Share of the true objects that a group of some level covers with an IoU above `HIT`, as a
    mean over the views that show the object."""
    assert association.bank.levels is not None
    best: dict[int, float] = {}
    for labels in association.bank.levels.labels:
        sums: dict[int, DoubleArray] = {}
        n_views: dict[int, int] = {}
        for camera in scene.test:
            true, shown = (
                scene.truth[camera.name],
                splat_groups(choose("cpu"), scene.gaussians, camera, labels),
            )
            area = np.bincount(shown[true > 0], minlength=int(labels.max()) + 1)
            for k in np.unique(true[true > 0]).tolist():
                own = np.bincount(shown[true == k], minlength=len(area))
                iou = own / np.maximum(int((true == k).sum()) + area - own, 1)
                iou[0] = 0
                sums[k] = sums.get(k, np.zeros(len(area))) + iou
                n_views[k] = n_views.get(k, 0) + 1
        for k, total in sums.items():
            best[k] = max(best.get(k, 0.0), float(total.max()) / n_views[k])
    return float(np.mean([value > HIT for value in best.values()]))
