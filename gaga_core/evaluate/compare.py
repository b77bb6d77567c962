"""All variants of the method on one scene folder, in one table (supplement; ablation)."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.arrays import IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.evaluate import baselines
from gaga_core.evaluate.baselines import Inputs, MaskGroups
from gaga_core.evaluate.group_scores import VOID_LEFT_OUT, Score, score_pairs
from gaga_core.evaluate.published import (
    ABLATION,
    THRESHOLD_MIOU,
    THRESHOLD_TABLE,
    iou_drop,
    sparse_views,
)
from gaga_core.evaluate.settings import ABLATIONS, TITLES, CompareConfig
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import AssociateConfig, associate_stage
from gaga_core.grouping.votes import splat_groups
from gaga_core.identity.field import IdentityField
from gaga_core.identity.lift import lift_groups, mode_of_preset, task_of_association
from gaga_core.io.folder.scene_folder import SceneFolder, mask_path_of, read_model, select_views
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.images import read_rgb
from gaga_core.io.masks.label_maps import mask_folder
from gaga_core.masks import MaskSet
from gaga_core.pipeline.lift import decode_groups
from gaga_core.progress import Progress, Stage, part
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer

# --- One table of several variants of the method on one scene.


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
            text.append(published_text(variant) if share == 1.0 else "")
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
        if any(published_text(v) and not _miou_at(v) for v in variants):
            found.append(
                "Published: IoU/P/R of the paper's ablation on Replica, void as a label; masks of "
                "SAM, of SAM 2 for its tracks."
            )
            others = ", ".join(
                f"{row.method} ({row.masks}) {published_text(name)}"
                for name, row in ABLATION.items()
                if name not in variants
            )
            found.append(f"Published rows that are not in this table: {others}.")
        if any(_miou_at(v) for v in variants):
            found.append("Published at thresholds: mIoU of figurines/ramen/teatime (LERF-Mask).")
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


_TITLES = {**TITLES, **{name: f"paper, {name}" for name in ABLATIONS}}
_BANKS: Mapping[str, AssociateConfig] = {
    "robust": AssociateConfig.of("robust"),
    "paper": AssociateConfig.of("paper"),
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

    def can_run(self, variant: str) -> bool:
        """Whether all that a row needs is there."""
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
    gt: Path,
    masks: str | Path | None = None,
    config: CompareConfig | None = None,
    *,
    gaussians: Gaussians | None = None,
    rasterizer: Rasterizer | None = None,
) -> Stage[VariantTable]:
    """Run every variant on one scene and score its group maps of the held-out views.

    Each variant labels the Gaussians from the masks of the train views; the labels are splatted
    into the test views (all views when none is set apart) and scored with Algorithm 1 against the
    true maps in ``gt``. Rows that have a memory bank are lifted as ``config.lifted_by`` says, and
    what their rendered encodings decode to is scored; their titles say so. Written:
    ``folder.work / "variants.json"``. Nothing else of the scene's groups changes. A row that needs
    what is not there (masks of test views, true maps of train views, a video model and photos) is
    left out. Raises ``GagaError`` when nothing can be scored.
    """
    config = config or CompareConfig()
    if gaussians is None:
        gaussians = yield from read_model(folder)
    names = [camera.name for camera in folder.cameras]
    truth, mask_set = mask_folder(gt, names), mask_folder(mask_path_of(folder, masks), names)
    held_out = select_views(folder, "test" if folder.test else "all")
    scored = tuple(camera for camera in held_out if camera.name in truth)
    if not scored:
        raise GagaError(f"{gt} has no true map of the {len(held_out)} test views. Choose another.")
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


def _run(task: _Task, variant: str, share: float, seed: int) -> Stage[VariantRow]:
    if variant == "per-frame":
        return (yield from _per_frame(task))
    cameras: Sequence[Camera] = task.train
    if share < 1.0:
        chosen = set(sparse_views([camera.name for camera in cameras], share, seed))
        cameras = [camera for camera in cameras if camera.name in chosen]
    start = time.perf_counter()
    labels, codes, mode = yield from _answer(task, variant, cameras)
    seconds = time.perf_counter() - start
    predicted = []
    for i, camera in enumerate(task.scored):
        yield Progress("Score", i, len(task.scored), camera.name)
        if codes is not None:
            predicted.append(decode_groups(task.rasterizer, task.gaussians, camera, codes))
        else:
            predicted.append(splat_groups(task.rasterizer, task.gaussians, camera, labels))
    with_void, without_void = score_pairs(zip(task.true_maps, predicted, strict=True))
    return VariantRow(
        variant=variant,
        title=_TITLES[variant] + (f", identities by {mode}" if mode else ""),
        with_void=with_void,
        without_void=without_void,
        n_groups=len(np.unique(labels[labels > 0])),
        seconds=seconds,
        n_views=len(cameras),
        share=share,
        seed=seed,
    )


def _answer(
    task: _Task, variant: str, cameras: Sequence[Camera]
) -> Stage[tuple[IntArray, IdentityField | None, str]]:
    """Labels (N,) of the Gaussians that one variant gives; lifted, their encodings and how."""
    config = _BANKS.get(variant)
    if config is None:
        return (yield from _labels_of(task, variant, cameras)), None, ""
    found = yield from associate_stage(task.gaussians, cameras, task.masks, task.rasterizer, config)
    lift = task.config.lifted_by
    if lift == "none":
        return found.labels, None, ""
    mode = mode_of_preset(config.preset) if lift == "preset" else lift
    grouping = found.labels, found.confidence, found.bank
    lifting = task_of_association(
        task.gaussians, cameras, task.masks, grouping, task.rasterizer, task.config.identities
    )
    identity, _ = yield from lift_groups(lifting, mode)
    return identity.labels, identity.field, mode


def _labels_of(task: _Task, variant: str, cameras: Sequence[Camera]) -> Stage[IntArray]:
    """Labels (N,) of the Gaussians that one baseline gives."""
    masks = baselines.true_maps(task.truth) if variant == "true-maps" else task.masks
    inputs = Inputs.of(task.gaussians, cameras, masks, task.rasterizer)
    if variant == "lifting":
        return (yield from baselines.lifting(inputs, task.config.lifting_iterations))
    stages: Mapping[str, Callable[[], Stage[MaskGroups]]] = {
        "none": lambda: baselines.no_association(inputs),
        "chained": lambda: baselines.chained_3d_iou(inputs),
        "tracker": lambda: baselines.overlap_tracker(inputs),
        "sam2": lambda: _sam2_tracks(task, inputs),
        "true-masks": lambda: baselines.true_masks(inputs, task.truth),
        "true-maps": lambda: baselines.true_masks(inputs, task.truth),
    }
    groups = yield from stages[variant]()
    return (yield from baselines.label_gaussians(inputs, groups))


def _sam2_tracks(task: _Task, inputs: Inputs) -> Stage[MaskGroups]:
    """Loaded here: only this variant needs torch."""
    from gaga_core.segmentation.video_tracks import load_follower

    def photo_of(camera: Camera) -> UInt8Array:
        picture = Image.fromarray(read_rgb(task.photos[camera.name]))
        return np.asarray(picture.resize((camera.width, camera.height)))

    assert task.config.video_model is not None
    follow = load_follower(task.config.video_model)
    return (yield from baselines.video_tracks(inputs, photo_of, follow))


def _per_frame(task: _Task) -> Stage[VariantRow]:
    """The masks of the scored views themselves, each frame matched to its truth."""
    start = time.perf_counter()
    predicted = []
    for i, camera in enumerate(task.scored):
        yield Progress("Score", i, len(task.scored), camera.name)
        labels = task.masks.load(camera.name, camera.width, camera.height)
        predicted.append(baselines.match_frame(labels, task.true_maps[i]))
    with_void, without_void = score_pairs(zip(task.true_maps, predicted, strict=True))
    return VariantRow(
        variant="per-frame",
        title=TITLES["per-frame"],
        with_void=with_void,
        without_void=without_void,
        n_groups=without_void.n_predicted,
        seconds=time.perf_counter() - start,
        n_views=0,
    )
