"""The published protocols over whole data sets: every stage, every scene, one table.

A scene is associated from the masks of its train views, lifted, rendered in its test views and
scored as its data set is: Algorithm 1, masks of text prompts, or pictures for people. Splats that
are missing are trained on the train views alone. Results lie in one folder, a JSON a scene, written
after every run: what is finished is not run again while its settings, masks and model are the same.

A data set without truth is shown: a film around the scene and a contact sheet of its test views.

Mip-NeRF 360 is qualitative in the paper. The sheet has a row for each view: photo, picture, groups.
"""

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np
from PIL import Image

from gaga_core.arrays import IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import CancelledError, GagaError
from gaga_core.evaluate.benchmark.files import digest_of, made_by, read_runs, write_runs
from gaga_core.evaluate.benchmark.prompts import Find, Question, answer_prompts, find_by, words_of
from gaga_core.evaluate.benchmark.tables import (
    BenchmarkReport,
    BenchmarkRun,
    InstanceScores,
    PromptScores,
    SceneResult,
)
from gaga_core.evaluate.group_scores import UNANSWERED, score_stage
from gaga_core.evaluate.prompt_scores import lerf_mask_stage
from gaga_core.evaluate.published import Conditions, sparse_views
from gaga_core.evaluate.settings import BenchmarkConfig, changes_of
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import AssociateConfig
from gaga_core.grouping.bank_file import read_groups
from gaga_core.io.datasets import Dataset, DatasetScene
from gaga_core.io.files import atomic_write
from gaga_core.io.folder.scene_folder import SceneFolder, read_model, select_views
from gaga_core.io.images import read_rgb
from gaga_core.io.json_file import read_foreign_json
from gaga_core.io.masks.label_maps import label_files_of, read_labels
from gaga_core.io.splats.splat_files import read_splats_stage
from gaga_core.io.video import VideoConfig, ffmpeg_program
from gaga_core.masks import resize_labels
from gaga_core.pipeline.associate import associate_scene
from gaga_core.pipeline.film import FilmConfig, as_bytes, film_stage, painted_labels
from gaga_core.pipeline.lift import lift_scene, read_identity
from gaga_core.pipeline.reconstruct import train_scene
from gaga_core.pipeline.render import render_views
from gaga_core.pipeline.segment import segment_scene
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.progress import Progress, Stage, part
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.camera_path import CameraPath, Keyframe, Shot
from gaga_core.scene.objects import group_colors
from gaga_core.scene.scene import Scene
from gaga_core.segmentation.choose import provider_named
from gaga_core.training.settings import TrainConfig

# --- The scores of a scene's predictions: Algorithm 1, or masks of text prompts.


def score_scene(scene: DatasetScene, predictions: Path) -> Stage[BenchmarkRun]:
    """The scores of the predictions in a folder; those that are missing count as 0."""
    run = BenchmarkRun(1.0, None, 0, 0, 0.0)
    if scene.prompts is None:
        scores, missing = yield from _score_maps(scene, predictions)
        return replace(run, scores=scores, missing=missing, notes=scene.missing)
    prompts = scene.prompts
    with TemporaryDirectory() as nothing:
        folder = predictions if predictions.is_dir() else Path(nothing)
        report = yield from lerf_mask_stage(folder, prompts.folder, views=prompts.views)
    by_prompt = {p.prompt: (p.iou, p.boundary_iou) for p in report.prompts}
    by_words = PromptScores(report.miou, report.mean_boundary_iou, by_prompt)
    n, notes = len(report.unused), list(scene.missing)
    if n:
        notes.append(f"{n} predictions answer no prompt of the data set ({report.unused[0]}, ...).")
    return replace(run, scores=by_words, missing=report.missing, notes=tuple(notes))


def _score_maps(
    scene: DatasetScene, predictions: Path
) -> Stage[tuple[InstanceScores, tuple[str, ...]]]:
    """Algorithm 1 over the group maps ``<stem>.png`` of the test views that have a true map."""
    truth = scene.truth
    names = [name for name in scene.folder.test if name in truth]
    files: Mapping[str, Path] = {}
    if predictions.is_dir():
        files = label_files_of(predictions, names, [c.name for c in scene.folder.cameras])

    def pair(name: str) -> tuple[IntArray, IntArray]:
        true = truth.loaders[name]()
        file = files.get(name)
        if file is None:
            return true, np.full_like(true, UNANSWERED)
        return true, resize_labels(read_labels(file), true.shape[1], true.shape[0])

    both = yield from score_stage((pair(name) for name in names), len(names))
    return InstanceScores(*both), tuple(name for name in names if name not in files)


# --- Splats of a benchmark scene that has none, or none of so few views: trained on training
# views.


RECORD = "splats.json"  # what the splats next to it were made of


def trained_splats(
    folder: SceneFolder, config: ReconstructConfig, out: Path, rasterizer: Rasterizer
) -> Stage[Gaussians]:
    """Splats of the training views of ``folder`` alone, kept in ``out``.

    Test views take no part, not even to measure on; views of neither part likewise. What was made
    of the same photos and settings is read again. Raises ``GagaError`` without photos.
    """
    lacking = [name for name in folder.train if name not in folder.image_paths]
    if lacking or not folder.train:
        raise GagaError(
            f"There are no splats of {folder.root.name}, and {len(lacking)} of its "
            f"{len(folder.train)} training photos are missing, so none can be trained. Put the "
            "photos there, or name the folder of the trained models."
        )
    poses = [camera.cam_from_world.tolist() for camera in folder.cameras]
    wanted: dict[str, object] = {
        "config": asdict(config),
        "views": list(folder.train),
        "photos": [digest_of(folder.image_paths[name]) for name in folder.train],
        "poses": hashlib.sha256(str(poses).encode()).hexdigest()[:16],
    }
    model, recorded = out / "point_cloud.ply", dict[str, object]()
    with suppress(GagaError):  # where it is not known what they were made of
        recorded = read_foreign_json(out / RECORD, dict[str, object])
    if model.is_file() and recorded == wanted:
        return (yield from read_splats_stage(model))
    kept = {camera.name: camera for camera in folder.cameras}
    alone = replace(folder, cameras=tuple(kept[name] for name in folder.train), test=())
    gaussians = yield from train_scene(alone, config, rasterizer=rasterizer, out=out)
    with atomic_write(out / RECORD) as temporary:
        temporary.write_text(json.dumps(wanted, indent=1) + "\n", encoding="utf-8")
    return gaussians


TITLE = "Benchmark"
_TRACKED = "object_mask"  # associated by a tracker already: only on request


@dataclass(frozen=True, eq=False)
class _Task:
    """Input of all runs over one scene."""

    scene: DatasetScene
    config: BenchmarkConfig
    out: Path  # folder of this scene's results
    masks: Path | None  # of label maps; None where predictions are given
    find: Find | None
    rasterizer: Rasterizer


def run_benchmark(
    dataset: Dataset,
    out: Path,
    config: BenchmarkConfig | None = None,
    *,
    find: Find | None = None,
    rasterizer: Rasterizer | None = None,
) -> Stage[BenchmarkReport]:
    """Run and score every scene of ``dataset``; results go to ``out``.

    Written: ``<scene>.json`` after every run over it, and ``<scene>/`` with its group maps. A scene
    that fails is named with the reason and the others go on. ``find`` answers text prompts with
    group ids (data sets of prompts only; default: as ``config.find`` says).
    """
    config = config or BenchmarkConfig()
    results, failed = [], dict(dataset.failed)
    engine = rasterizer or choose("cpu" if config.pred is not None else "auto")
    for i, scene in enumerate(dataset.scenes):
        stage = _run_scene(dataset, scene, out, config, find, engine)
        n_scenes = len(dataset.scenes)
        try:
            result = yield from part(stage, i, n_scenes, TITLE, prefix=f"{scene.name}: ")
        except CancelledError:
            raise
        except GagaError as error:
            failed[scene.name] = str(error)
        else:
            results.append(result)
    few = ""
    if config.shares and config.retrain_sparse:
        few = "Few views: splats are trained again on those views alone, from the same points."
    elif config.shares:
        few = "Few views: the splats of all training views are used; only the masks are fewer."
    return BenchmarkReport(
        dataset=dataset.name,
        title=dataset.title,
        preset=config.title,
        scenes=tuple(results),
        failed=failed,
        out=str(out),
        protocol=dataset.protocol,
        sparse_splats=few,
        is_retrained=config.retrain_sparse,
        changes=changes_of(config.groups),
        threshold=config.groups.threshold,
    )


def _run_scene(
    dataset: Dataset,
    scene: DatasetScene,
    out: Path,
    config: BenchmarkConfig,
    find: Find | None,
    rasterizer: Rasterizer,
) -> Stage[SceneResult]:
    """All runs over one scene that are not finished yet."""
    folder = scene.folder
    scored = any(name in scene.truth for name in folder.test) or not scene.truth_from
    hopeless = config.pred is None and not folder.train
    if config.pred is not None and not scene.truth_from:
        raise GagaError(f"{scene.name} has no truth to score predictions with.")
    if hopeless or not folder.test or (scene.prompts is None and not scored):
        raise GagaError(" ".join(scene.missing))
    masks, splats = None, ""
    if config.pred is None:
        scene, splats = yield from with_splats(scene, config, out / scene.name, rasterizer)
        masks = yield from masks_of_scene(scene, config, out / scene.name, rasterizer)
    task = _Task(scene, config, out / scene.name, masks, find, rasterizer)
    settings = _settings(dataset, task)
    file = out / f"{scene.name}.json"
    known = {} if config.redo else read_runs(file, settings)
    finished = {share: run for share, run in known.items() if share in config.runs()}
    n_reused, gaussians = len(finished), None
    for i, share in enumerate(config.runs()):
        if share in finished:
            continue
        if config.pred is None and gaussians is None:
            gaussians = yield from read_model(scene.folder)
        model = gaussians
        if share < 1 and config.retrain_sparse:
            few = replace(folder, train=sparse_views(folder.train, share, config.seed))
            target = task.out / f"splats_{100 * share:g}"
            model = yield from trained_splats(few, config.train, target, rasterizer)
        stage = _run(task, share, model)
        known[share] = yield from part(stage, i, len(config.runs()), TITLE)
        write_runs(file, settings, known)
    runs = tuple(known[share] for share in config.runs())
    name = "" if masks is None else masks.name
    return SceneResult(scene.name, name, runs, n_reused, _conditions(task, splats))


def with_splats(
    scene: DatasetScene, config: BenchmarkConfig, out: Path, rasterizer: Rasterizer
) -> Stage[tuple[DatasetScene, str]]:
    """The scene with splats, trained here where it has none, and where they are from."""
    if scene.folder.model_path is not None:
        return scene, "as found next to the data; which views they were trained on is not known"
    target = out / "splats"
    yield from trained_splats(scene.folder, config.train, target, rasterizer)
    folder = replace(scene.folder, model_path=target / "point_cloud.ply")
    n, published = config.train.train().iterations, TrainConfig().iterations
    told = f"trained here on the training views alone, {n:,} iterations (published: {published:,})"
    return replace(scene, folder=folder), told


def _conditions(task: _Task, splats: str) -> Conditions:
    """Conditions of the scene's scores, for tables."""
    scene, config = task.scene, task.config
    queries = "" if scene.prompts is None or config.pred is not None else words_of(config.find)
    truth = scene.truth if scene.prompts is None else set(scene.prompts.views.values())
    return Conditions(
        split=scene.folder.split,
        n_train=len(scene.folder.train),
        n_test=sum(name in truth for name in scene.folder.test),
        truth=scene.truth_from,
        masks="" if task.masks is None else made_by(task.masks),
        splats=splats,
        queries="given" if task.find is not None and queries else queries,
    )


def _settings(dataset: Dataset, task: _Task) -> dict[str, object]:
    """Dependencies of the results of a scene."""
    folder, config = task.scene.folder, task.config
    values: dict[str, object] = {
        "dataset": dataset.name,
        "layout": task.scene.layout,
        "scene": str(folder.root.resolve()),
        "test": list(folder.test),
        "missing": list(task.scene.missing),
        "split": folder.split,
        "truth": task.scene.truth_from,
    }
    if config.pred is not None:
        predictions = config.pred / task.scene.name
        files = digest_of(predictions)
        return values | {"predictions": str(predictions.resolve()), "files": files}
    return values | {
        "train": list(folder.train),
        "preset": asdict(AssociateConfig.of(config.preset)),
        "lift": config.lifted_by,
        "groups": asdict(config.groups),
        "identities": asdict(config.identities),
        "find": "given"
        if task.find is not None
        else {name: str(folder or "") for name, folder in vars(config.find).items()},
        "seed": config.seed,
        "masks": "" if task.masks is None else str(task.masks.resolve()),
        "mask_files": digest_of(task.masks),
        "model": "" if folder.model_path is None else str(folder.model_path.resolve()),
        "model_file": digest_of(folder.model_path),
        "retrain": {
            "config": asdict(config.train),
            "photos": [digest_of(folder.image_paths.get(name)) for name in folder.train],
        }
        if config.retrain_sparse
        else None,
    }


def masks_of_scene(
    scene: DatasetScene, config: BenchmarkConfig, out: Path, rasterizer: Rasterizer
) -> Stage[Path]:
    """The label maps to associate: of the scene, or made here by the weights-free provider."""
    found = scene.folder.mask_folders
    if config.masks is not None:
        if config.masks in found:
            return found[config.masks]
        known = ", ".join(found) or "none"
        raise GagaError(f"There is no mask folder {config.masks} in {scene.name}. There: {known}.")
    names = [name for name in found if name != _TRACKED]
    if len(names) > 1:
        raise GagaError(
            f"{scene.name} has several mask folders: {', '.join(names)}. Choose one by name."
        )
    if names:
        return found[names[0]]
    own = replace(scene.folder, root=out)
    report = yield from segment_scene(own, provider_named("regions"), rasterizer=rasterizer)
    return report.folder


def _run(task: _Task, share: float, gaussians: Gaussians | None) -> Stage[BenchmarkRun]:
    """One run over one scene: group maps of the test views, and their scores."""
    config, folder = task.config, task.scene.folder
    if gaussians is None or task.masks is None:
        given = (config.pred or task.out) / task.scene.name
        return replace((yield from score_scene(task.scene, given)), share=share)
    train = folder.train if share == 1.0 else sparse_views(folder.train, share, config.seed)
    root = task.out / ("views_all" if share == 1.0 else f"views_{100 * share:g}")
    own, engine = replace(folder, root=root, train=train), task.rasterizer
    start, n_parts = time.perf_counter(), 4
    settings = config.groups.config(config.preset)
    stage = associate_scene(own, task.masks, settings, gaussians=gaussians, rasterizer=engine)
    yield from part(stage, 0, n_parts, TITLE)
    what: Literal["groups", "identity"] = "groups"
    if config.lifted_by != "none":
        what, lift = "identity", config.lifted_by
        lifting = lift_scene(own, lift, config.identities, gaussians=gaussians, rasterizer=engine)
        yield from part(lifting, 1, n_parts, TITLE)
    predictions = root / "groups"
    shown = render_views(own, predictions, what=what, gaussians=gaussians, rasterizer=engine)
    maps = yield from part(shown, 2, n_parts, TITLE)
    seconds = round(time.perf_counter() - start, 3)
    labels = read_groups(own, len(gaussians))[0]
    n_groups = len(np.unique(labels[labels > 0]))
    if not task.scene.truth_from:
        notes = yield from show_scene(own, gaussians, labels, maps, engine, root)
        return BenchmarkRun(share, None, len(train), n_groups, seconds, notes=notes)
    if task.scene.prompts is not None:
        question = _question(task, own, gaussians, labels, maps)
        if config.lifted_by != "none":
            question = replace(question, field=read_identity(own, len(gaussians)).field)
        find = task.find or find_by(config.find)
        predictions = yield from answer_prompts(question, task.scene.prompts, root, find)
    scored = yield from part(score_scene(task.scene, predictions), 3, n_parts, TITLE)
    return replace(scored, share=share, n_views=len(train), n_groups=n_groups, seconds=seconds)


def _question(
    task: _Task, folder: SceneFolder, gaussians: Gaussians, labels: IntArray, maps: Sequence[Path]
) -> Question:
    """Input of the method that answers the prompts."""
    prompts = task.scene.prompts
    wanted = set() if prompts is None else set(prompts.views.values())
    views = tuple(c for c in select_views(folder, "test") if c.name in wanted)
    if not views:
        raise GagaError(f"No view of {task.scene.name} with true masks has a camera.")
    shown = (camera.name for camera in select_views(folder, "test"))
    of_view = dict(zip(shown, maps, strict=True))
    return Question(
        scene=Scene.of(gaussians, labels),
        train=select_views(folder, "train"),
        views=views,
        maps={camera.name: of_view[camera.name] for camera in views},
        rasterizer=task.rasterizer,
    )


SHEET, FILM = "contact_sheet.png", "film.mp4"
_ROWS = 8  # test views on a sheet, spread over all
_WIDTH = 400  # pixels of a picture on it
_KEYS, _SECONDS = 12, 1.0  # of the film: keyframes among the training views, between two


def show_scene(
    folder: SceneFolder,  # its gaga/ holds what is written
    gaussians: Gaussians,
    labels: IntArray,  # (N,) groups
    maps: Sequence[Path],  # group maps of the test views, in their order
    rasterizer: Rasterizer,
    out: Path,
) -> Stage[tuple[str, ...]]:
    """Write `SHEET` and `FILM` into ``out``; returns sentences for people."""
    cameras = select_views(folder, "test")
    chosen = np.linspace(0, len(cameras) - 1, min(_ROWS, len(cameras))).round().astype(int)
    rows = []
    for i, k in enumerate(chosen):
        camera = cameras[k]
        yield Progress("Contact sheet", i, len(chosen), camera.name)
        photo = folder.image_paths.get(camera.name)
        rows.append(_row(camera, photo, gaussians, read_labels(maps[k]), rasterizer))
    with atomic_write(out / SHEET) as temporary:
        Image.fromarray(np.concatenate(rows)).save(temporary, format="PNG")
    told = f"shown, not scored: {out / SHEET}"
    try:
        ffmpeg_program("Writing a film")
    except GagaError as error:
        return (f"{told}.", str(error))
    yield from _film(folder, Scene.of(gaussians, labels), rasterizer, out / FILM)
    return (f"{told} and {FILM}.",)


def _row(
    camera: Camera,
    photo: Path | None,
    gaussians: Gaussians,
    groups: IntArray,  # (H, W)
    rasterizer: Rasterizer,
) -> UInt8Array:
    """Photo, picture and groups of one view, next to each other."""
    small = camera.resized(_WIDTH, max(1, round(camera.height * _WIDTH / camera.width)))
    size = (small.width, small.height)
    image = rasterizer.render(gaussians, small).image
    found = [np.zeros((small.height, small.width, 3), np.uint8)]
    if photo is not None:
        found = [np.asarray(Image.fromarray(read_rgb(photo)).resize(size))]
    found.append(as_bytes(image))
    painted = Image.fromarray(painted_labels(groups))
    found.append(np.asarray(painted.resize(size, Image.Resampling.NEAREST)))
    return np.concatenate(found, axis=1)


def _film(folder: SceneFolder, scene: Scene, rasterizer: Rasterizer, target: Path) -> Stage[Path]:
    """Along the training views: the picture on the left, its groups on the right."""
    cameras = select_views(folder, "train")
    chosen = np.linspace(0, len(cameras) - 1, min(_KEYS, len(cameras))).round().astype(int)
    middle = scene.gaussians.means.mean(axis=0)
    keys = tuple(
        Keyframe(
            Shot.of_camera(
                cameras[k], max(float(np.linalg.norm(cameras[k].position - middle)), 1e-6)
            ),
            _SECONDS,
        )
        for k in np.unique(chosen)
    )
    first = cameras[0]
    width = min(640, first.width) // 2 * 2
    height = max(16, round(first.height * width / first.width) // 2 * 2)
    config = FilmConfig(video=VideoConfig(max(2 * width, 16), height, fps=12))
    colors = group_colors(scene.labels)
    colors[scene.labels == 0] = 0

    def paint(camera: Camera) -> UInt8Array:
        K = camera.K.copy()
        K[0, 2] = camera.width // 2 / 2
        half = replace(camera, K=K, width=camera.width // 2)
        shown = [
            as_bytes(rasterizer.render(scene.gaussians, half, channels=channels).image)
            for channels in (None, colors)
        ]
        return np.concatenate(shown, axis=1)

    return (yield from film_stage(scene, CameraPath(keys), target, config, painter=paint))
