"""Labelled data of new views: what labels cost, whether they are true, and what they teach.

Scenes are generated from scanned objects (`tools.scenes`): the photos and the truth of any view
come from surfaces four times as dense and clean as the noisy splats that the data set is made of.
The detector is a small convolutional network for peaks of object centres, trained from nothing
with the same number of steps: on the few labelled photos, on pictures of the data set, and on both,
as often on one as on the other. Where views stand, how many share a placement and how many are in
another light was chosen on the scene of seed 9.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from gaga_core.arrays import DoubleArray, FloatArray
from gaga_core.export.dataset.records import VOID_BELOW, Record, lit, read_record
from gaga_core.export.dataset.settings import DatasetConfig
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.images import read_rgb, write_rgb
from gaga_core.io.masks.coco import segments_of
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.pipeline import dataset
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.scene.project import Project, open_path_stage
from tests.bench.figures import Figure, data_folder, peak_mib, timed
from tools.scenes.arrange import KINDS, arrange, cameras
from tools.scenes.draw import Look, discs, gaussians_of
from tools.scenes.make import SceneConfig, make_scene

_SCANS = data_folder("ycb_meshes")
_SCENES = tuple(SceneConfig(seed, "train", "table", views=40) for seed in (41,))
_LABELLED = 8  # photos of 40; the detector is tried on the others
_SEEDS = 5
_PICTURES, _STEPS, _BATCH = 240, 400, 8  # on seed 9 photos alone gain nothing from step 200 on
_SIZE = (160, 120)  # pixels, of what the detector sees
_CELL = 4  # pixels
_CONFIG = DatasetConfig(views=_PICTURES, removed=0.0, fill=False)
_JUDGED, _LEAST = 8, 100  # pictures of a scene, and pixels of a visible mask
_TIMED = 12  # pictures of 640 x 480
_COUNTS = (200, 800)  # pictures whose peak memory is compared


def figures() -> list[Figure]:
    """The cost on the demo scene, then truth and detector where the scans are."""
    found = [_cost(demo_project()), _growth()]
    if not _SCANS.is_dir():
        return found
    ious: dict[float, list[float]] = {0.0: [], 0.3: [], 1.0: []}
    scores = list[list[list[float]]]()
    with tempfile.TemporaryDirectory() as folder:
        for config in _SCENES:
            root, out = Path(folder) / f"{config.seed}", Path(folder) / f"{config.seed}-data"
            make_scene(root, _SCANS, config)
            project = true_project(root)
            run_stage(dataset.dataset_stage([project], out, _CONFIG, ("coco",)))
            for strength, of_noise in ious.items():
                of_noise.extend(visible_ious(out, config, strength))
            scores.append(detector_scores(root, out, project))
    photos, ours, both = np.array(scores).mean(axis=0).T  # by seed
    return [
        *found,
        *(
            Figure(f"data: IoU of ids with the truth, noise {k}", float(np.mean(v)), "IoU", bar)
            for (k, v), bar in zip(ious.items(), (">= 0.95", ">= 0.95", ""), strict=True)
        ),
        Figure("detector: AP on unseen photos, of photos", float(photos.mean()), "AP"),
        Figure("detector: its spread over seeds", float(photos.std()), "AP"),
        Figure("detector: AP on unseen photos, of data", float(ours.mean()), "AP"),
        Figure("detector: spread over seeds, of data", float(ours.std()), "AP"),
        Figure("detector: AP on unseen photos, of both", float(both.mean()), "AP"),
        Figure("detector: spread over seeds, of both", float(both.std()), "AP"),
        *(
            Figure(f"detector: worst gain of a seed by {k}", float(gain.min()), "AP", ">= 0")
            for k, gain in (("data", ours - photos), ("both", both - photos))
        ),
    ]


# --- what labels cost


def demo_project() -> Project:
    """The demo scene with its groups as they are found."""
    from gaga_core.grouping.associate import AssociateConfig
    from gaga_core.io.demo_scene import ensure_demo
    from gaga_core.pipeline.associate import associate_scene

    root = Path(tempfile.gettempdir()) / "gaga-bench-demo"
    run_stage(ensure_demo(root))
    if not (root / "gaga" / "labels.npz").is_file():
        run_stage(associate_scene(open_scene_folder(root), config=AssociateConfig.of("robust")))
    return run_stage(open_path_stage(root))


def _cost(project: Project) -> Figure:
    base = run_stage(dataset._base_stage(project, "scene", choose("cpu")))
    config = DatasetConfig(coverage=0.0, moved=0.0, removed=0.0)
    still = base.room.arranged(0, 0, moves=False, removes=False)
    series = dataset._Series(base, still, 0, config, {"as-it-is": "train"})
    painter = dataset._Painter(series, {})
    views = [painter.picture(k)[0].camera for k in range(_TIMED)]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)

        def alone() -> None:
            for k, camera in enumerate(views):
                again = replace(camera)  # the engine keeps its last view
                image = painter.engine.render(painter.gaussians, again).image
                write_rgb(out / f"{k}.jpg", lit(image, series.light(k)), 95)

        def labelled() -> None:
            for k, camera in enumerate(views):
                drawn = painter.draw(replace(camera))
                record = painter.recorded(k, camera, 1.0, drawn)
                dataset._finished(out, record, drawn, series.poses)

        alone()
        labelled()
        ratio = float(np.median([timed(labelled)[1] / timed(alone)[1] for _ in range(5)]))
    return Figure("data: pictures with labels, times drawing alone", ratio, "x", "<= 1.3")


def _growth() -> Figure:
    """Peaks of two processes of their own: the second makes four times as many pictures."""
    peaks = []
    for n in _COUNTS:
        code = f"from tests.bench.bench_dataset import made_peak; print(made_peak({n}))"
        peaks.append(float(subprocess.check_output([sys.executable, "-c", code]).split()[-1]))
    ratio = peaks[1] / peaks[0]
    return Figure("data: peak memory of 800 pictures, times that of 200", ratio, "x", "<= 1.05")


def made_peak(n: int) -> float:
    """Most memory (MiB) of this process, which makes ``n`` pictures with all labels."""
    config = DatasetConfig(n, 160, 120, coverage=0.0, fill=False)
    with tempfile.TemporaryDirectory() as folder:
        run_stage(dataset.dataset_stage([demo_project()], Path(folder) / "data", config))
    return peak_mib()


# --- truth


def true_project(root: Path) -> Project:
    """A generated scene with its true labels and names, and few photos."""
    named = json.loads((root / "objects.json").read_text())["objects"]
    names = sorted(path.name for path in (root / "images").iterdir())
    train = names[:: len(names) // _LABELLED][:_LABELLED]
    split = {"train": train, "test": [name for name in names if name not in train]}
    (root / "split.json").write_text(json.dumps(split))
    project = run_stage(open_path_stage(root))
    project.scene.labels = np.load(root / "gt" / "splat_labels.npy").astype(np.int32)
    project.scene.names = {one["id"]: one["name"] for one in named}
    return project


def visible_ious(out: Path, config: SceneConfig, strength: float) -> list[float]:
    """IoU of ids with the truth of views of the scene as it is, by object and view.

    Ids are of splats of such noise, a quarter as dense as the surfaces that say the truth
    (`make_scene` takes photos of the same).
    """
    rng = np.random.default_rng((0, config.seed, KINDS.index(config.kind)))
    placed = arrange(_SCANS, config.split, config.kind, rng)
    cameras(placed, config.views, (config.width, config.height), rng)
    look = Look.drawn(len(placed.blocks), rng)
    rng.uniform(0.3, 1.0)
    clean, labels = gaussians_of(discs(placed, look, 4.0, rng), 0.0, rng)
    splats, ids = gaussians_of(discs(placed, look, 1.0, rng), strength, rng)
    found, engine = list[float](), CpuRasterizer()
    still = [record for record in records(out) if record.placement == "as-it-is"]
    for record in still[:_JUDGED]:
        truth = engine.label_splat(clean, record.camera, labels).labels
        nobody = np.zeros(0, np.int32)
        seen = engine.labelled(splats, record.camera, ids, nobody, VOID_BELOW).outlines.labels
        for k in range(1, len(placed.objects) + 1):
            true, ours = truth == k, seen == k
            if true.sum() >= _LEAST:
                found.append(float((ours & true).sum() / (ours | true).sum()))
    return found


def records(out: Path) -> list[Record]:
    """All pictures of a data set."""
    read = (read_record(out, path.stem) for path in sorted((out / "records").iterdir()))
    return [one for one in read if one is not None and not one.is_left_out]


# --- the detector

Sample = tuple[FloatArray, list[tuple[int, float, float, float, float]]]  # picture, class and box


def detector_scores(root: Path, out: Path, project: Project) -> list[list[float]]:
    """Average precision on unseen photos by seed: of labelled photos, of the data, and of both."""
    groups = sorted(project.scene.names)
    assert project.folder is not None
    photos = {c.name: _photo(root, c.name, groups) for c in project.folder.cameras}
    few = [photos[name] for name in project.folder.train]
    unseen = [photos[name] for name in project.folder.test]
    data = [_of_record(out, record, groups) for record in records(out)]
    torch.set_num_threads(1)
    sets = (few, data, few * (len(data) // len(few)) + data)
    return [[_tried(one, unseen, len(groups), s) for one in sets] for s in range(_SEEDS)]


def _photo(root: Path, name: str, groups: Sequence[int]) -> Sample:
    labels = read_labels(root / "gt" / "instance" / f"{Path(name).stem}.png")
    boxes = [(groups.index(s.group), *s.box) for s in segments_of(labels) if s.group in groups]
    return _sample(root / "images" / name, boxes, labels.shape[::-1])


def _of_record(out: Path, record: Record, groups: Sequence[int]) -> Sample:
    boxes = [(groups.index(o.group), *o.box) for o in record.objects if o.area > 60]
    return _sample(out / record.file("images"), boxes, (record.width, record.height))


def _sample(
    path: Path, boxes: Sequence[tuple[int, int, int, int, int]], size: tuple[int, ...]
) -> Sample:
    from PIL import Image

    picture = Image.fromarray(read_rgb(path)).resize(_SIZE)
    scale = np.array([_SIZE[0] / size[0], _SIZE[1] / size[1]] * 2)
    scaled = [(k, *(np.array(box) * scale).tolist()) for k, *box in boxes]
    pixels = np.asarray(picture, np.float32).transpose(2, 0, 1) / 255 - 0.5
    return pixels, scaled  # type: ignore[return-value]


def _tried(train: Sequence[Sample], test: Sequence[Sample], n: int, seed: int) -> float:
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    net = _net(n)
    steps = torch.optim.Adam(net.parameters(), 2e-3)
    targets = [_target(boxes, n) for _, boxes in train]
    for _ in range(_STEPS):
        chosen = rng.integers(len(train), size=_BATCH)
        picture = torch.from_numpy(np.stack([train[k][0] for k in chosen]))
        wanted = torch.from_numpy(np.stack([targets[k] for k in chosen]))
        logits = net(picture)
        # Cells of centres are few: they weigh more.
        loss = torch.nn.functional.binary_cross_entropy_with_logits(
            logits, wanted, pos_weight=torch.tensor(20.0)
        )
        steps.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        steps.step()
    net.eval()
    with torch.no_grad():
        maps = [net(torch.from_numpy(picture[None])).sigmoid()[0].numpy() for picture, _ in test]
    return _average_precision(maps, [boxes for _, boxes in test])


def _net(n: int) -> torch.nn.Module:
    layers: list[torch.nn.Module] = []
    for a, b, stride, dilation in ((3, 16, 2, 1), (16, 32, 2, 1), (32, 32, 1, 2), (32, 32, 1, 4)):
        layers += [
            torch.nn.Conv2d(a, b, 3, stride, padding=dilation, dilation=dilation),
            torch.nn.BatchNorm2d(b),
            torch.nn.ReLU(),
        ]
    return torch.nn.Sequential(*layers, torch.nn.Conv2d(32, n, 1))


def _target(boxes: Sequence[tuple[int, float, float, float, float]], n: int) -> FloatArray:
    """1 in the cells around the middle of each box (n, H, W)."""
    target = np.zeros((n, _SIZE[1] // _CELL, _SIZE[0] // _CELL), np.float32)
    for k, x, y, w, h in boxes:
        row, column = int((y + h / 2) / _CELL), int((x + w / 2) / _CELL)
        target[k, max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2] = 1
    return target


def _average_precision(
    maps: Sequence[FloatArray], truth: Sequence[list[tuple[int, float, float, float, float]]]
) -> float:
    """Area under precision over recall: the peak of each class in each photo, right in its box."""
    scores, right, n_true = list[float](), list[bool](), 0
    for found, boxes in zip(maps, truth, strict=True):
        n_true += len(boxes)
        of = {k: box for k, *box in boxes}
        for k, values in enumerate(found):
            row, column = np.unravel_index(values.argmax(), values.shape)
            u, v = (column + 0.5) * _CELL, (row + 0.5) * _CELL
            scores.append(float(values.max()))
            x, y, w, h = of.get(k, [0, 0, 0, 0])
            right.append(k in of and bool(x <= u <= x + w and y <= v <= y + h))
    order = np.argsort(scores)[::-1]
    hits: DoubleArray = np.cumsum(np.array(right)[order]).astype(np.float64)
    precision = hits / np.arange(1, len(hits) + 1)
    return float((precision * np.array(right)[order]).sum() / max(n_true, 1))
