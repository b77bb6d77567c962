"""All variants of the method on a scene folder or a data set, in one table (the ablation)."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.arrays import IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.evaluate import baselines
from gaga_core.evaluate.baselines import Inputs, MaskGroups
from gaga_core.evaluate.benchmark.files import made_by
from gaga_core.evaluate.benchmark.run import masks_of_scene, with_splats
from gaga_core.evaluate.group_scores import VOID_LEFT_OUT, Score, score_pairs
from gaga_core.evaluate.published import (
    ABLATION,
    THRESHOLD_MIOU,
    THRESHOLD_TABLE,
    Conditions,
    absent_scenes,
    departures,
    iou_drop,
    sparse_views,
)
from gaga_core.evaluate.settings import (
    ABLATIONS,
    TITLES,
    BenchmarkConfig,
    CompareConfig,
    how_labelled,
)
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import AssociateConfig, associate_stage
from gaga_core.grouping.votes import splat_groups
from gaga_core.identity.field import IdentityField
from gaga_core.identity.lift import lift_groups, task_of_association
from gaga_core.io.datasets import Dataset, DatasetScene
from gaga_core.io.folder.scene_folder import SceneFolder, mask_path_of, read_model, select_views
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.images import read_rgb
from gaga_core.io.masks.label_maps import mask_folder
from gaga_core.masks import MaskSet
from gaga_core.pipeline.lift import decode_groups
from gaga_core.progress import Progress, Stage, part
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer
from gaga_core.segmentation.base import Picture
from gaga_core.segmentation.choose import provider_named

# --- One table of several variants of the method on one scene.


_ONE_SCENE = "they are means over the eight scenes of Replica"
HEADINGS = (
    "variant",
    "views",
    "IoU",
    "precision",
    "recall",
    "IoU, void",
    "P, void",
    "R, void",
    "groups",
    "seconds",
    "published",
    "IoU drop",
)


@dataclass(frozen=True)
class VariantRow:
    """One variant on one choice of train views."""

    variant: str  # id: "robust", "tracker", ...
    title: str  # for people
    with_void: Score
    without_void: Score
    n_groups: int  # groups that own a Gaussian; of a frame's masks for the per-frame bound
    seconds: float  # wall time of association and vote, without reading and scoring
    n_views: int  # train views used
    share: float = 1.0  # of the train views
    seed: int = 0  # of the choice of views

    @property
    def key(self) -> tuple[str, float]:
        """Rows of one key differ only in their seed."""
        return self.variant, self.share


@dataclass(frozen=True)
class VariantTable:
    """All rows, in the order run, and what they were scored on."""

    scene: str
    images: tuple[str, ...]  # names of the scored views
    rows: tuple[VariantRow, ...]
    apart: tuple[str, ...] = (_ONE_SCENE,)  # why published figures are not next to ours

    def of(self, variant: str, share: float = 1.0) -> tuple[VariantRow, ...]:
        """Rows of one variant, one a seed."""
        return tuple(row for row in self.rows if row.key == (variant, share))

    def drop(self, variant: str, share: float) -> float | None:
        """IoU drop (void left out), mean over seeds; None when a run is missing."""
        whole, sparse = self.of(variant), self.of(variant, share)
        if not whole or not sparse or share == 1.0:
            return None
        iou = _mean([row.without_void.iou for row in sparse])
        return iou_drop(whole[0].without_void.iou, iou)

    def to_json(self) -> dict[str, object]:
        """Plain values; ``drops`` holds the IoU drops by variant and share."""
        drops = [
            {"variant": variant, "share": share, "iou_drop": self.drop(variant, share)}
            for variant, share in self._keys()
            if share != 1.0
        ]
        rows = [asdict(row) | _published(row) for row in self.rows]
        return {"scene": self.scene, "images": list(self.images), "rows": rows, "drops": drops}

    def table(self) -> list[list[str]]:
        """Rows of text, headings first; several seeds of a choice of views are averaged.

        Columns "published" and "IoU drop" are left out where no row has them.
        """
        result = [list(HEADINGS)]
        for variant, share in self._keys():
            rows, drop = self.of(variant, share), self.drop(variant, share)
            seeds = f", {len(rows)} seeds" if len(rows) > 1 else ""
            title = rows[0].title if share == 1.0 else f"{rows[0].title}, {share:.0%}{seeds}"
            text = [title, str(rows[0].n_views)]
            for scores in ([r.without_void for r in rows], [r.with_void for r in rows]):
                for name in ("iou", "precision", "recall"):
                    text.append(f"{100 * _mean([getattr(s, name) for s in scores]):.1f}")
            text.append(f"{_mean([row.n_groups for row in rows]):.0f}")
            text.append(f"{_mean([row.seconds for row in rows]):.1f}")
            text.append(published_text(variant) if share == 1.0 and not self.apart else "")
            text.append("" if drop is None else f"{100 * drop:.1f} %")
            result.append(text)
        kept = [
            column
            for column, heading in enumerate(HEADINGS)
            if heading not in ("published", "IoU drop") or any(row[column] for row in result[1:])
        ]
        return [[row[column] for column in kept] for row in result]

    def notes(self) -> list[str]:
        """How predictions are counted, and what the column "published" means where there is one."""
        variants = [variant for variant, share in self._keys() if share == 1.0]
        found = [VOID_LEFT_OUT, "Columns with void: it is a label, and every id is a prediction."]
        if any("identities by" in row.title for row in self.rows):
            found.append("Scored: rendered identities where a row says so, else the groups.")
        if any(name in ABLATION for name in variants):
            ablations = [] if self.apart else [name for name in variants if name in ABLATION]
            others = ", ".join(
                f"{row.method} ({row.masks}) {published_text(name)}"
                for name, row in ABLATION.items()
                if name not in ablations
            )
            what = "Published: IoU/P/R of the paper's ablation on Replica, void as a label"
            found.append(f"{what}." if ablations else f"{what}: {others}.")
            if ablations and others:
                found.append(f"Published rows that are not run here, but quoted: {others}.")
            found += [f"Published figures are apart: {why}." for why in self.apart]
            found.append(QUOTED)
        if any(_miou_at(v) for v in variants):
            figures = ", ".join(
                f"{t:g} {published_text(f'threshold {t:g}')}" for t in THRESHOLD_MIOU
            )
            found.append(
                f"Published at thresholds: mIoU of figurines/ramen/teatime: {figures}. "
                "Next to ours: gaga benchmark lerf-mask --threshold."
            )
        return found

    def _keys(self) -> list[tuple[str, float]]:
        return list(dict.fromkeys(row.key for row in self.rows))


def published_text(variant: str) -> str:
    """What the paper prints for a variant: on its own scenes, with masks of SAM, void as a label.

    IoU/P/R, "46.2/39.5/50.6"; at an overlap threshold mIoU of three scenes; empty where it prints
    nothing.
    """
    found = ABLATION.get(variant)
    values = found.values if found is not None else tuple(_miou_at(variant).values())
    return "/".join(f"{value:.1f}" for value in values)


def _published(row: VariantRow) -> dict[str, object]:
    """The published figures of a row, for machines; nothing where there are none."""
    if row.share != 1.0:
        return {}
    of_threshold, found = _miou_at(row.variant), ABLATION.get(row.variant)
    if of_threshold:
        return {"published": {"table": THRESHOLD_TABLE, "miou": dict(of_threshold)}}
    if found is None:
        return {}
    iou, precision, recall = found.values
    scores = {"iou": iou, "precision": precision, "recall": recall}
    return {"published": {"table": found.table, "masks": found.masks, **scores}}


def _miou_at(variant: str) -> Mapping[str, float]:
    """Published mIoU by scene at the overlap threshold of a variant "threshold 0.2"."""
    kind, _, value = variant.partition(" ")
    return THRESHOLD_MIOU.get(float(value), {}) if kind == "threshold" else {}


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


QUOTED = (
    "Run here: all rows of the table. Gaussian Grouping is run as its identity training on given "
    "tracks; its own tracker needs weights and is quoted."
)
_TITLES = {**TITLES, **{name: f"paper, {name}" for name in ABLATIONS}}
_BANKS: Mapping[str, AssociateConfig] = {
    "robust": AssociateConfig.of("robust"),
    "paper": AssociateConfig.of("paper"),
    "released": AssociateConfig.of("released"),
    "paper-sam2": AssociateConfig.of("paper"),
    "all-gaussians": ABLATIONS["no depth"].config("paper"),
    **{name: change.config("paper") for name, change in ABLATIONS.items()},
}


@dataclass(frozen=True, eq=False)
class _Task:
    """Input of every run."""

    gaussians: Gaussians
    train: tuple[Camera, ...]
    scored: tuple[Camera, ...]  # held-out views that have a true map
    masks: MaskSet  # of train and scored views
    truth: MaskSet
    true_maps: Sequence[IntArray]  # (H, W) of each scored view
    rasterizer: Rasterizer
    config: CompareConfig
    photos: Mapping[str, Path]  # by view name
    further: Mapping[str, MaskSet]  # masks that a row has for its own

    def masks_of(self, variant: str) -> MaskSet:
        """The masks of the train views that a row associates."""
        return self.further.get(variant, self.masks)

    def can_run(self, variant: str) -> bool:
        """Whether all that a row needs is there."""
        if variant in ("paper-sam2", "gaussian-grouping"):
            return variant in self.further
        if variant == "rendered":
            return bool(self.config.bound_by)
        if variant == "per-frame":
            return all(camera.name in self.masks for camera in self.scored)
        if variant == "sam2":
            has_photos = all(camera.name in self.photos for camera in self.train)
            return self.config.video_model is not None and has_photos
        if variant in ("true-masks", "true-maps"):
            return any(camera.name in self.truth for camera in self.train)
        return True


def compare_variants(
    folder: SceneFolder,
    gt: Path | MaskSet,
    masks: str | Path | None = None,
    config: CompareConfig | None = None,
    *,
    rasterizer: Rasterizer | None = None,
) -> Stage[VariantTable]:
    """Run every variant on one scene and score its group maps of the held-out views.

    Each variant labels the Gaussians from the masks of the train views; the labels are splatted
    into the test views (all views when none is set apart) and scored with Algorithm 1 against the
    true maps ``gt``, a folder or the maps. All rows are lifted as ``config.lifted_by`` says, and
    what their rendered encodings decode to is scored; their titles say so. Written:
    ``folder.work / "variants.json"``. Nothing else of the scene's groups changes. A row that needs
    what is not there (masks of test views, true maps of train views, a video model and photos) is
    left out. Raises ``GagaError`` when nothing can be scored.
    """
    config = config or CompareConfig()
    gaussians = yield from read_model(folder)
    names = [camera.name for camera in folder.cameras]
    truth = mask_folder(gt, names) if isinstance(gt, Path) else gt
    mask_set, others = mask_folder(mask_path_of(folder, masks), names), folder.mask_folders
    own = {"paper-sam2": config.sam2_masks, "gaussian-grouping": config.tracks}
    further = {row: mask_folder(others[n], names) for row, n in own.items() if n in others}
    held_out = select_views(folder, "test" if folder.test else "all")
    scored = tuple(camera for camera in held_out if camera.name in truth)
    if not scored:
        where = gt if isinstance(gt, Path) else truth.source or "The data set"
        raise GagaError(
            f"{where} has no true map of the {len(held_out)} test views. Choose another."
        )
    task = _Task(
        gaussians=gaussians,
        train=select_views(folder, "train" if folder.train else "all"),
        scored=scored,
        masks=mask_set,
        truth=truth,
        true_maps=[truth.load(c.name, c.width, c.height) for c in scored],
        rasterizer=rasterizer or choose(),
        config=config,
        photos=folder.image_paths,
        further=further,
    )
    runs = [run for run in config.runs() if task.can_run(run[0])]
    if not runs and config.variants == ("sam2",):
        what = "no photos" if config.video_model is not None else "no SAM 2 model (--video-model)"
        raise GagaError(
            f"SAM 2 tracks cannot be made: there are {what}. Add them, or choose another row."
        )
    if not runs:
        lacking = "the masks of test views or true maps of train views are missing. Add them."
        raise GagaError(f"{', '.join(config.variants)}: {lacking}")
    rows = []
    for i, (variant, share, seed) in enumerate(runs):
        title = _TITLES[variant] if share == 1.0 else f"{_TITLES[variant]}, {share:.0%}"
        stage = _run(task, variant, share, seed)
        rows.append((yield from part(stage, i, len(runs), "Compare variants", prefix=f"{title}: ")))
    table = VariantTable(folder.root.name, tuple(c.name for c in task.scored), tuple(rows))
    with staging_folder(folder.work) as staging:
        text = json.dumps(table.to_json(), indent=2) + "\n"
        (staging / "variants.json").write_text(text, encoding="utf-8")
        publish_all(staging, ["variants.json"], folder.work)
    return table


def compare_dataset(
    dataset: Dataset,
    out: Path,
    benchmark: BenchmarkConfig | None = None,
    config: CompareConfig | None = None,
) -> Stage[tuple[VariantTable, ...]]:
    """The table of each scene of a data set, and after several that of the means.

    ``benchmark`` says which masks, and how splats are trained where a scene has none. Results go to
    ``out``/<scene>. Published figures are next to the means where all scenes are there and were
    measured alike (`published.departures`). Raises ``GagaError`` when no scene can be compared.
    """
    config, benchmark = config or CompareConfig(), benchmark or BenchmarkConfig()
    engine, tables, apart = choose(), list[VariantTable](), list[str]()
    for i, scene in enumerate(dataset.scenes):
        stage = _compared_scene(scene, out / scene.name, benchmark, config, engine)
        found, of = yield from part(
            stage, i, len(dataset.scenes), "Compare variants", prefix=f"{scene.name}: "
        )
        tables.append(found)
        apart += departures(dataset.name, scene.name, of)
    if not tables:
        raise GagaError(next(iter(dataset.failed.values()), "There is no scene to compare."))
    absent = absent_scenes(dataset.name, [table.scene for table in tables])
    apart += [f"scenes: without {', '.join(absent)}"] if absent else []
    apart += [] if dataset.name == "replica" else [_ONE_SCENE]
    if config.lift_of("paper") != "paper":
        apart.append("identities: by vote here, trained there")
    if len(tables) > 1:
        tables.append(_mean_table(tables, tuple(dict.fromkeys(apart))))
    return tuple(tables)


def _compared_scene(
    scene: DatasetScene,
    out: Path,
    benchmark: BenchmarkConfig,
    config: CompareConfig,
    rasterizer: Rasterizer,
) -> Stage[tuple[VariantTable, Conditions]]:
    """The table of one scene, and under which conditions it was made."""
    scene, splats = yield from with_splats(scene, benchmark, out, rasterizer)
    masks = yield from masks_of_scene(scene, benchmark, out, rasterizer)
    folder = replace(scene.folder, root=out, split=scene.folder.split)
    stage = compare_variants(folder, scene.truth, masks, config, rasterizer=rasterizer)
    table = yield from stage
    of = Conditions(
        split=scene.folder.split,
        n_train=len(scene.folder.train),
        n_test=len(table.images),
        truth=scene.truth_from,
        masks=made_by(masks),
        splats=splats,
    )
    return table, of


def _mean_table(tables: Sequence[VariantTable], apart: tuple[str, ...]) -> VariantTable:
    """Means over the scenes of all rows that every scene has; times and views are sums."""
    rows = []
    for first in tables[0].rows:
        same = [
            row
            for table in tables
            for row in table.rows
            if (row.key, row.seed) == (first.key, first.seed)
        ]
        if len(same) == len(tables):
            rows.append(
                replace(
                    first,
                    with_void=_mean_score([row.with_void for row in same]),
                    without_void=_mean_score([row.without_void for row in same]),
                    n_groups=round(_mean([row.n_groups for row in same])),
                    seconds=sum(row.seconds for row in same),
                    n_views=sum(row.n_views for row in same),
                )
            )
    images = tuple(f"{table.scene}/{name}" for table in tables for name in table.images)
    return VariantTable(f"mean of {len(tables)} scenes", images, tuple(rows), apart)


def _mean_score(scores: Sequence[Score]) -> Score:
    """Means of the figures, sums of the counts."""
    return Score(
        iou=_mean([score.iou for score in scores]),
        precision=_mean([score.precision for score in scores]),
        recall=_mean([score.recall for score in scores]),
        pooled_iou=_mean([score.pooled_iou for score in scores]),
        n_true=sum(score.n_true for score in scores),
        n_predicted=sum(score.n_predicted for score in scores),
    )


def _run(task: _Task, variant: str, share: float, seed: int) -> Stage[VariantRow]:
    if variant in ("per-frame", "rendered"):
        return (yield from _per_frame(task, variant))
    cameras: Sequence[Camera] = task.train
    if share < 1.0:
        chosen = set(sparse_views([camera.name for camera in cameras], share, seed))
        cameras = [camera for camera in cameras if camera.name in chosen]
    start = time.perf_counter()
    labels, codes, void = yield from _answer(task, variant, cameras)
    seconds = time.perf_counter() - start
    predicted, preset = [], _preset_of(variant)
    lift = task.config.lift_of(preset)
    if variant not in _BANKS and lift != "paper":
        lift = "none"  # baselines are trained as published, or vote
    how = "its own training" if variant == "lifting" else ""
    how = how or how_labelled(preset, lift, task.config.trained)
    for i, camera in enumerate(task.scored):
        yield Progress("Score", i, len(task.scored), camera.name)
        if codes is not None:
            shown = decode_groups(task.rasterizer, task.gaussians, camera, codes)
            predicted.append(np.where(shown == void, np.int32(0), shown))
        else:
            predicted.append(splat_groups(task.rasterizer, task.gaussians, camera, labels))
    with_void, without_void = score_pairs(zip(task.true_maps, predicted, strict=True))
    return VariantRow(
        variant=variant,
        title=f"{_TITLES[variant]}, {how}",
        with_void=with_void,
        without_void=without_void,
        n_groups=len(np.unique(labels[labels > 0])),
        seconds=seconds,
        n_views=len(cameras),
        share=share,
        seed=seed,
    )


def _preset_of(variant: str) -> str:
    """The preset of a row; baselines are trained as the preset paper is."""
    if variant == "gaussian-grouping":
        return "released"
    config = _BANKS.get(variant)
    return "paper" if config is None else config.preset


def _answer(
    task: _Task, variant: str, cameras: Sequence[Camera]
) -> Stage[tuple[IntArray, IdentityField | None, int]]:
    """Labels (N,) of the Gaussians that one variant gives; lifted, their encodings, and the class
    of these that stands for void."""
    config = _BANKS.get(variant)
    if config is None:
        return (yield from _baseline(task, variant, cameras))
    masks = task.masks_of(variant)
    found = yield from associate_stage(task.gaussians, cameras, masks, task.rasterizer, config)
    mode = task.config.lift_of(config.preset)
    if mode == "none":
        return found.labels, None, 0
    grouping = found.labels, found.confidence, found.bank
    settings = task.config.trained.config(config.preset, mode)
    lifting = task_of_association(
        task.gaussians, cameras, masks, grouping, task.rasterizer, settings
    )
    identity, _ = yield from lift_groups(lifting, mode)
    return identity.labels, identity.field, 0


def _baseline(
    task: _Task, variant: str, cameras: Sequence[Camera]
) -> Stage[tuple[IntArray, IdentityField | None, int]]:
    """`_answer` of a row without a memory bank."""
    masks = baselines.true_maps(task.truth) if variant == "true-maps" else task.masks_of(variant)
    inputs = Inputs.of(task.gaussians, cameras, masks, task.rasterizer)
    is_trained = task.config.lift_of("paper") == "paper"
    if variant == "lifting":
        found = yield from baselines.lifting(inputs, task.config.lifting_iterations)
        return found.labels, found.field if is_trained else None, 0
    stages: Mapping[str, Callable[[], Stage[MaskGroups]]] = {
        "none": lambda: baselines.no_association(inputs),
        "gaussian-grouping": lambda: baselines.given_tracks(inputs),
        "chained": lambda: baselines.chained_3d_iou(inputs),
        "tracker": lambda: baselines.overlap_tracker(inputs),
        "sam2": lambda: _sam2_tracks(task, inputs),
        "true-masks": lambda: baselines.true_masks(inputs, task.truth),
        "true-maps": lambda: baselines.true_masks(inputs, task.truth),
    }
    groups = yield from stages[variant]()
    if not is_trained:
        return (yield from baselines.label_gaussians(inputs, groups)), None, 0
    config = task.config.trained.config(_preset_of(variant), "paper").paper
    field = yield from baselines.train_groups(inputs, groups, config)
    labels = field.labels()
    return np.where(labels == groups.void, np.int32(0), labels), field, groups.void


def _sam2_tracks(task: _Task, inputs: Inputs) -> Stage[MaskGroups]:
    """Loaded here: only this variant needs torch."""
    from gaga_core.segmentation.video_tracks import load_follower

    def photo_of(camera: Camera) -> UInt8Array:
        picture = Image.fromarray(read_rgb(task.photos[camera.name]))
        return np.asarray(picture.resize((camera.width, camera.height)))

    assert task.config.video_model is not None
    follow = load_follower(task.config.video_model)
    return (yield from baselines.video_tracks(inputs, photo_of, follow))


def _per_frame(task: _Task, variant: str) -> Stage[VariantRow]:
    """The masks of the scored views themselves, or those that are made of their rendered pictures
    (as published), each frame matched to its truth."""
    start = time.perf_counter()
    predicted = []
    provider = provider_named(task.config.bound_by) if variant == "rendered" else None
    for i, camera in enumerate(task.scored):
        yield Progress("Score", i, len(task.scored), camera.name)
        if provider is None:
            labels = task.masks.load(camera.name, camera.width, camera.height)
        else:
            image = task.rasterizer.render(task.gaussians, camera).image
            picture = Picture(np.ascontiguousarray(np.clip(image, 0, 1) * 255, np.uint8))
            labels = yield from part(
                provider.label_map(picture), i, len(task.scored), "Score", prefix="masks of "
            )
        predicted.append(baselines.match_frame(labels, task.true_maps[i]))
    with_void, without_void = score_pairs(zip(task.true_maps, predicted, strict=True))
    return VariantRow(
        variant=variant,
        title=TITLES[variant],
        with_void=with_void,
        without_void=without_void,
        n_groups=without_void.n_predicted,
        seconds=time.perf_counter() - start,
        n_views=0,
    )
