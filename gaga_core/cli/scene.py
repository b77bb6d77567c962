"""Commands over a scene folder: the stages of the method, and their scores, benchmarks included."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional

from gaga_core.cli import output as out
from gaga_core.cli.output import (
    AnyScene,
    AsJson,
    Backend,
    Groups,
    Identities,
    Masks,
    Model,
    options,
)
from gaga_core.errors import GagaError
from gaga_core.evaluate.settings import (
    ABLATIONS,
    THRESHOLDS,
    TITLES,
    BenchmarkConfig,
    CompareConfig,
    FindConfig,
    Preset,
)
from gaga_core.pipeline.settings import AlignConfig, ReconstructConfig

_ROWS = ("seeds", "variants", "lift", "lifting_iterations", "sam2_masks", "tracks", "bound_by")


@dataclass(frozen=True)
class AssociateCommand:
    """Associate the 2D masks of all views: every Gaussian and pixel gets a group id."""

    scene: Positional[Path]
    """Scene folder (images/, sparse/0/, masks/, point_cloud.ply)."""
    groups: Groups
    masks: Masks = None
    model: Model = None
    preset: Preset = "robust"
    """robust: groups by the consensus of all views. paper: the memory bank as the paper's text has
    it. released: as its released code has it."""
    add: bool = False
    """Only views that took no part yet: their masks join the groups that there are, or open new
    ones, as the preset of these groups has it. What was decided stays."""
    backend: Backend = "auto"
    json: AsJson = False

    def run(self) -> int:
        """Write SCENE/gaga/: bank, labels per Gaussian, group maps of the masks, report."""
        from gaga_core.io.folder.scene_folder import open_scene_folder
        from gaga_core.pipeline import associate
        from gaga_core.raster import choose

        folder = open_scene_folder(self.scene, model=self.model)
        preset = associate.saved_preset(folder) if self.add else self.preset
        with out.possible():
            config = self.groups.config(preset)
        stage = associate.associate_scene(
            folder, self.masks, config, rasterizer=choose(self.backend), adds=self.add
        )
        report = out.follow(stage, compiles=True)
        for note in report.notes:
            out.say(note)
        out.say_what_a_project_keeps(folder.root, adds=self.add)
        return out.result(report.to_json(), as_json=self.json)


@dataclass(frozen=True)
class LiftCommand:
    """Give every Gaussian a 16-d identity encoding whose classifier names its group."""

    scene: Positional[Path]
    """Scene folder whose masks are associated."""
    identities: Identities
    mode: Literal["vote", "refine", "paper"] | None = None
    """vote: votes and least squares, no training. refine: a few steps on top. paper: from zeros,
    10,000 steps. Default: vote where the preset robust made the groups, else paper, after which
    the scene's labels are those of the classifier."""
    backend: Backend = "auto"
    json: AsJson = False

    def run(self) -> int:
        """Write SCENE/gaga/identity.npz."""
        from gaga_core.io.folder.scene_folder import open_scene_folder
        from gaga_core.pipeline.lift import lift_scene
        from gaga_core.raster import choose

        folder = open_scene_folder(self.scene)
        with out.possible():
            self.identities.config("robust", "paper")
        stage = lift_scene(folder, self.mode, self.identities, rasterizer=choose(self.backend))
        report = out.follow(stage)
        if (folder.work / "project.json").is_file():
            out.say("The saved project of this scene keeps its own labels until you lift there.")
        return out.result(report.to_json(), as_json=self.json)


@dataclass(frozen=True)
class AlignCommand:
    """Bring a second scene of the same place to the first, and list what came, went or moved."""

    first: AnyScene
    second: AnyScene
    config: Annotated[AlignConfig, options(AlignConfig, "by", "changes")]
    out: Path | None = None
    """JSON file for the result; default: gaga/align-SECOND.json in the first scene folder."""
    write: Path | None = None
    """Write both as one file of splats (.ply, .splat, .spz, .sog, .glb, .html), in the frame of the
    first."""
    json: AsJson = False

    def run(self) -> int:
        """Print the similarity, its residual, and one line a change."""
        from gaga_core.export.export import export_scene_stage
        from gaga_core.io.splats.splat_files import form_of
        from gaga_core.pipeline import align
        from gaga_core.scene.project import require_other_file

        if self.write is not None:
            form_of(self.write)  # a mistake is told before anything long begins
        opened = [out.follow(align.open_capture_stage(p)) for p in (self.first, self.second)]
        (first, a), (second, b) = opened
        if self.write is not None and (a is None or b is None):
            raise GagaError("--write needs splats in both scenes. Train them first.")
        if self.write is not None:
            for project in filter(None, (a, b)):
                require_other_file(project, self.write)
        stage = align.align_stage(first, second, self.config, align.workspace_of(self.first))
        found = out.follow(stage, compiles=True)
        target = self.out or align.result_path(self.first, found)
        align.write_aligned(target, found)
        written = {"file": str(target)}
        if self.write is not None and a is not None and b is not None:
            align.addition_of(a.scene, b, found.alignment.world).edit.apply(a.scene)
            out.follow(export_scene_stage(a.scene, self.write))
            written["splats"] = str(self.write)
        if self.json:
            return out.result(found.to_json() | written, as_json=True)
        out.line(found.sentence())
        for line in found.lines() if self.config.changes else ():
            out.line(line)
        return out.result(written, as_json=False)


@dataclass(frozen=True)
class RenderCommand:
    """Render views of a scene, or a film along a camera path: color, groups, depth."""

    scene: Positional[Path]
    """Scene folder; for a film also a splat file or a saved project, with its edits."""
    out: Path | None = None
    """Folder to write <view>.png into (groups: 16-bit group ids, depth: 16-bit thousandths)."""
    what: Literal["rgb", "groups", "depth", "identity", "encodings"] = "rgb"
    """What a pixel holds. identity: group ids decoded from the rendered identity encodings.
    encodings: these as colors, their three principal components, as the window shows them."""
    views: tuple[str, ...] = ("test",)
    """train, test, all, or names of views."""
    model: Model = None
    video: Path | None = None
    """Write a film instead of pictures: NAME.mp4 (H.264) or NAME.webm (VP9)."""
    path: Path | None = None
    """The film's camera path, as the window saves it; default: the one saved with the project."""
    split: Literal["", "rgb", "groups", "depth", "photo", "truth", "errors"] = ""
    """Of a film: what lies left of a line; --what lies right of it. With photo, truth (maps in
    gt/instance) or errors the film goes through the photos --views instead of along a path."""
    split_at: float = 0.5
    """Where the line is, 0 to 1 of the width."""
    sweep: bool = False
    """The line of --split goes from the left edge to the right one, and back."""
    size: tuple[int, int] = (1280, 720)
    """Width and height of the film, pixels."""
    fps: float = 30.0
    """Pictures a second of the film."""
    seconds: float = 2.0
    """Of each photo, in a film through the photos."""
    quality: int = 75
    """Of the film: 1 (small) to 100."""
    backend: Backend = "auto"
    json: AsJson = False

    def run(self) -> int:
        """Write one picture a view, or the film."""
        if self.video is not None:
            return self._film(self.video)
        if self.out is None:
            raise GagaError("Say where to write: --out FOLDER for pictures, --video FILE.mp4.")
        from gaga_core.io.folder.scene_folder import open_scene_folder
        from gaga_core.pipeline.render import render_views
        from gaga_core.raster import choose

        folder = open_scene_folder(self.scene, model=self.model)
        out.say_what_is_not_drawn(self.scene)
        engine = choose(self.backend)
        stage = render_views(folder, self.out, what=self.what, views=self.views, rasterizer=engine)
        written = out.follow(stage, compiles=True)
        return out.result({"folder": str(self.out), "pictures": len(written)}, as_json=self.json)

    def _film(self, target: Path) -> int:
        from gaga_core.evaluate.photo_film import PhotoFilmConfig, photo_film_stage
        from gaga_core.io.video import VideoConfig
        from gaga_core.pipeline.film import FilmConfig, Split, film_stage
        from gaga_core.raster import choose
        from gaga_core.scene.camera_path import load_path

        if self.what == "identity" or self.what == "encodings" or self.model is not None:
            raise GagaError("A film shows rgb, groups or depth of SCENE itself: leave --model out.")
        video = VideoConfig(*self.size, self.fps, self.quality)
        shown: dict[str, object] = {"file": str(target), "fps": self.fps}
        if self.split == "photo" or self.split == "truth" or self.split == "errors":
            photos = PhotoFilmConfig(
                self.split, self.what, self.split_at, self.sweep, self.seconds, video
            )
            project = out.open_project(self.scene)
            stage = photo_film_stage(project, target, photos, self.views, choose(self.backend))
        else:
            split = Split(self.split, self.split_at, self.sweep) if self.split else None
            config = FilmConfig(self.what, split=split, video=video)
            path = load_path(self.path) if self.path is not None else None
            project = out.open_project(self.scene)
            path = path if path is not None else project.placed_film
            if len(path.keyframes) < 2:
                raise GagaError(
                    "This project has no camera path. Make one in the window, or --path."
                )
            engine = choose(self.backend)
            stage = film_stage(project.scene, path, target, config, rasterizer=engine)
            pictures = len(path.frame_times(self.fps))
            shown |= {"seconds": round(path.seconds, 3), "pictures": pictures}
        out.follow(stage, compiles=True)
        return out.result(shown, as_json=self.json)


@dataclass(frozen=True)
class EvaluateCommand:
    """Compare predicted group maps with true instance maps (Algorithm 1 of the paper)."""

    pred: Path
    """Folder of predicted label maps."""
    gt: Path
    """Folder of true label maps; every file counts, a missing prediction as 0."""
    scene: Path | None = None
    """Scene folder whose split says which views count (with --views)."""
    views: Literal["train", "test", "all"] = "all"
    """Which views of --scene count; without --scene every file of --gt does."""
    protocol: Literal["instance", "lerf-mask"] = "instance"
    """instance: class-agnostic IoU, precision and recall. lerf-mask: <view>/<prompt>.png masks."""
    json: AsJson = False

    def run(self) -> int:
        """Print IoU, precision and recall, with void as a class and without."""
        from gaga_core.evaluate.group_scores import VOID_LEFT_OUT, evaluate
        from gaga_core.evaluate.prompt_scores import evaluate_lerf_mask
        from gaga_core.io.folder.scene_folder import open_scene_folder

        views = None
        if self.scene is not None and self.views != "all" and self.protocol == "instance":
            folder = open_scene_folder(self.scene)
            views = folder.test if self.views == "test" else folder.train
        by_prompt = self.protocol == "lerf-mask"
        report = (
            evaluate_lerf_mask(self.pred, self.gt)
            if by_prompt
            else evaluate(self.pred, self.gt, views=views)
        )
        if report.missing:
            out.say(f"{len(report.missing)} predictions are missing and count as 0.")
        out.scores(report, as_json=self.json)
        if not by_prompt:
            out.say(VOID_LEFT_OUT)
        return 0


@dataclass(frozen=True)
class CompareCommand:
    """Run all variants of the association on a scene, or on every scene of a data set and their
    mean: presets, ablations, bounds, few views."""

    scene: Positional[Path]
    """Scene folder with masks; with --dataset its folder, with one folder a scene."""
    config: Annotated[CompareConfig, options(CompareConfig, *_ROWS, variants=())]
    identities: Identities
    gt: Path | None = None
    """Folder of true label maps of a scene; a data set has its own."""
    dataset: Literal["", "replica", "scannet"] = ""
    """Which data set the folder is."""
    scenes: tuple[str, ...] = ()
    """Names of its scenes; default: all."""
    models: Path | None = None
    """Folder of its trained models, as <scene>/point_cloud/...; default: in the scenes."""
    masks: Masks = None
    ablations: bool = False
    """The paper with one setting changed at a time instead: overlap threshold, inlier factor f,
    depth, order of the views."""
    thresholds: bool = False
    """The paper at overlap thresholds from 0.01 to 0.5 instead."""
    video_model: str | None = None
    """Folder or name of a SAM 2.1 model (sam2.1-large): adds the row "sam2", masks followed through
    the photos."""
    json: AsJson = False

    def run(self) -> int:
        """Print one table a scene and that of the means; write SCENE/gaga/variants.json."""
        from gaga_core.evaluate.compare import VariantTable, compare_dataset, compare_variants
        from gaga_core.io.datasets import open_dataset
        from gaga_core.io.folder.scene_folder import open_scene_folder
        from gaga_core.query.embed import folder_of
        from gaga_core.segmentation.models.catalogue import KNOWN

        config, model = self.config, self.video_model
        if (self.gt is None) != bool(self.dataset):
            raise GagaError("Say what is true: --gt FOLDER for a scene, --dataset for a data set.")
        if bool(config.variants) + self.ablations + self.thresholds > 1:
            text = "--variants, --ablations and --thresholds each say which rows. Choose one."
            raise GagaError(text)
        rows = THRESHOLDS if self.thresholds else config.variants
        rows = tuple(ABLATIONS) if self.ablations else rows
        with out.possible():
            self.identities.config("robust", "paper")
        config = replace(
            config,
            variants=rows or tuple(TITLES),
            sparse=() if rows else config.sparse,
            identities=self.identities,
            video_model=None if model is None else folder_of(model, KNOWN),
        )
        failed: Mapping[str, str] = {}
        if self.gt is not None:
            folder = open_scene_folder(self.scene)
            stage = compare_variants(folder, self.gt, self.masks, config)
            tables: tuple[VariantTable, ...] = (out.follow(stage, compiles=True),)
        else:
            data = open_dataset(self.dataset, self.scene, self.scenes, models=self.models)
            failed, masks = data.failed, None if self.masks is None else str(self.masks)
            target = self.scene / "gaga-compare"
            stages = compare_dataset(data, target, BenchmarkConfig(masks=masks), config)
            tables = out.follow(stages, compiles=True)
        if self.json:
            several = {"tables": [table.to_json() for table in tables]}
            out.result(several if self.gt is None else tables[0].to_json(), as_json=True)
        for table in () if self.json else tables:
            out.line(table.scene)
            out.table(table.table())
        for note in tables[-1].notes():
            out.say(note)
        for scene, why in failed.items():
            out.say(f"{scene}: {why}")
        return 1 if failed else 0


_OF_RUNS = ("preset", "lift", "masks", "seed", "pred", "redo")


@dataclass(frozen=True)
class BenchmarkCommand:
    """Run the method over every scene of a data set and print the paper's table with ours."""

    dataset: Positional[Literal["replica", "scannet", "lerf-mask", "3d-ovs", "mipnerf360"]]
    """Which data set (mipnerf360: any scenes with a COLMAP model; scored where gt/instance holds
    true maps, else shown by a film and a contact sheet)."""
    folder: Positional[Path]
    """Its folder, with one folder a scene."""
    config: Annotated[BenchmarkConfig, options(BenchmarkConfig, *_OF_RUNS)]
    groups: Groups
    identities: Identities
    train: Annotated[
        ReconstructConfig,
        options(ReconstructConfig, "quality", "iterations", quality="standard"),
    ]
    scenes: tuple[str, ...] = ()
    """Names of scenes; default: all."""
    models: Path | None = None
    """Folder of the trained models, as <scene>/point_cloud/...; default: in the scenes. Where there
    is none, splats are trained on the training views alone."""
    detector: str | None = None
    """For text prompts: folder or name of a Grounding DINO or OWLv2 model (see gaga query)."""
    box_masks: str | None = None
    """With --detector: folder or name of a Segment Anything model. Then prompts are answered by the
    published rule: masks in the boxes, groups with more than 0.7 inside, probability over 0.2."""
    index_with: str | None = None
    """For text prompts, without a detector: folder or name of a CLIP or SigLIP model; without
    either, words for colors, sizes and places alone are understood."""
    sparse: str = ""
    """Percentages of the train views to run as well, such as 30,20,10,5."""
    retrain_sparse: bool = False
    """Train splats on each of those choices of views; default: use those of all training views."""
    out: Path | None = None
    """Folder of the results, one JSON a scene; default: gaga-benchmark in the data set's folder."""
    backend: Backend = "auto"
    json: AsJson = False

    def run(self) -> int:
        """Print the tables; exit status 1 when a scene has no result."""
        from gaga_core.evaluate.benchmark.run import run_benchmark
        from gaga_core.io.datasets import open_dataset
        from gaga_core.query.embed import KNOWN_DETECTORS, KNOWN_EMBEDDERS, folder_of
        from gaga_core.raster import choose

        pred, detector, index = self.config.pred, self.detector, self.index_with
        if pred is not None and not pred.is_dir():
            raise GagaError(f"{pred} is not a folder. Choose a folder of predictions.")
        config = replace(
            self.config,
            shares=_shares(self.sparse),
            find=FindConfig(
                detector=None if detector is None else folder_of(detector, KNOWN_DETECTORS),
                embedder=None if index is None else folder_of(index, KNOWN_EMBEDDERS),
                segmenter=self.box_masks,
            ),
            train=self.train,
            retrain_sparse=self.retrain_sparse,
            groups=self.groups,
            identities=self.identities,
        )
        with out.possible():
            self.groups.config(config.preset)
            self.identities.config(config.preset, "paper")
        dataset = open_dataset(self.dataset, self.folder, self.scenes, models=self.models)
        target = self.out or self.folder / "gaga-benchmark"
        engine = None if pred is not None else choose(self.backend)
        stage = run_benchmark(dataset, target, config, rasterizer=engine)
        report = out.follow(stage, compiles=pred is None)
        for sentence in report.sentences():
            out.say(sentence)
        if self.json:
            out.result(report.to_json(), as_json=True)
        for table in () if self.json else report.tables():
            out.table(table.table())
            for note in table.notes:
                out.line(f"  {note}")
        return 1 if report.failed else 0


def _shares(text: str) -> tuple[float, ...]:
    """Shares of a list of percentages."""
    try:
        return tuple(float(word) / 100 for word in text.split(",") if word.strip())
    except ValueError as error:
        raise GagaError(
            f"--sparse takes percentages such as 30,20,10,5; it got {text!r}."
        ) from error
