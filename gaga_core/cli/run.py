"""The commands that start from photos: ``gaga reconstruct`` and ``gaga run``."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional

from gaga_core.cli import output as out
from gaga_core.cli.output import (
    AsJson,
    Backend,
    Groups,
    Identities,
    Model,
    options,
)
from gaga_core.errors import GagaError
from gaga_core.evaluate.settings import Preset
from gaga_core.pipeline.settings import EngineConfig, Quality, ReconstructConfig

_PLACING = (
    *("focal", "poses", "poses_from", "place_minutes", "foreground", "turntable", "scene"),
    "accept_wrong",
)


_MOST_NAMES = 12  # of objects in the last line


@dataclass(frozen=True)
class RunCommand:
    """From photos to objects: splats, masks, groups, encodings, pictures; all that are missing."""

    scenes: Positional[tuple[Path, ...]]
    """Scene folder, folder of photos, video, or recording of a phone (.r3d, Stray Scanner); with
    --executor several, or a folder of many."""
    reconstruct: Annotated[
        ReconstructConfig,
        options(ReconstructConfig, "quality", "iterations", "max_side", *_PLACING),
    ]
    engine: Annotated[EngineConfig, options(EngineConfig, "workers", "address")]
    groups: Groups
    identities: Identities
    to: Path | None = None
    """Scene folder to make of photos or a video; default: next to them, as NAME-scene."""
    masks: Path | None = None
    """Folder of label maps that are there; default: the only one in SCENE/masks."""
    masks_from: str = ""
    """Who makes the masks (gaga masks --list); default: regions, where there are none yet."""
    model: Model = None
    preset: Preset | None = None
    """robust (default): groups by the consensus of all views, identities by vote. paper: the
    paper's text: association of section 3.2, identities trained for 10,000 steps, labels by their
    classifier. released: the same as its released code has it. When given, groups of another preset
    are made again."""
    lift: Literal["vote", "refine", "paper"] | None = None
    """How groups become identities (see gaga lift); default: as the preset has it."""
    executor: Literal["none", "local", "dask"] = "none"
    """Who runs many scenes: processes here, or workers of dask."""
    go_on: bool = False
    """Go on with a training that was stopped and whose splats were kept, then make the rest."""
    json: AsJson = False

    def run(self) -> int:
        """Bring the folder to the state that the window needs."""
        from gaga_core.pipeline.executors import list_tasks, run_scenes
        from gaga_core.pipeline.run import RunConfig

        if self.masks is not None and self.masks_from:
            raise GagaError("--masks and --masks-from exclude each other. Leave one out.")
        with out.possible():
            self.identities.config("robust", "paper")
            config = RunConfig(
                reconstruct=self.reconstruct,
                masks=self.masks,
                masks_from=self.masks_from,
                associate=self.groups.config(self.preset or "robust"),
                keeps_groups=self.preset is None,
                mode=self.lift,
                lift=self.identities,
            )
        if self.executor == "none":
            return self._run_one(config)
        if self.model is not None or self.to is not None:
            raise GagaError("--model and --to are for one scene. Leave them out with --executor.")
        if not self.scenes:
            raise GagaError("Name a folder of scenes, or several scenes.")
        engine = replace(self.engine, engine=self.executor)
        list_tasks(self.scenes)  # fails before kernels are compiled
        report = out.follow(run_scenes(self.scenes, config, engine), compiles=True)
        out.scores(report, as_json=self.json)
        out.say(f"With pictures: {report.page}")
        return 1 if report.failed else 0

    def _run_one(self, config: object) -> int:
        from gaga_core.io.folder.scene_folder import AssociateEntry, read_report_entry
        from gaga_core.pipeline.place import notes_of, read_entry
        from gaga_core.pipeline.reconstruct import go_on_stage, source_of
        from gaga_core.pipeline.run import JOIN, RunConfig, run_folder
        from gaga_core.pipeline.search import list_objects

        assert isinstance(config, RunConfig)
        if len(self.scenes) != 1:
            raise GagaError(
                f"{len(self.scenes)} scenes need an executor. Add --executor local."
                if self.scenes
                else "Name a scene folder, a folder of photos or a video."
            )
        given = self.scenes[0]
        photos, scene = source_of(given)
        if self.to is not None:
            photos, scene = given, self.to
        if scene != given:
            out.say(f"The scene folder is {scene}.")
        before = read_entry(scene).get("sfm")
        if self.go_on:
            out.follow(go_on_stage(scene))
        stage = run_folder(scene, config, photos=photos, model=self.model)
        done = out.follow(stage, compiles=True)
        placed = read_entry(scene).get("sfm")
        notes = list(notes_of(placed)) if isinstance(placed, dict) and placed != before else []
        entry = read_report_entry(scene / "gaga" / "report.json", "associate", AssociateEntry)
        if JOIN in done:
            notes.append("New masks joined the groups that there were; these were not made again.")
            notes += () if entry is None else entry.notes
        for note in notes:
            out.say(note)
        if JOIN in done:
            out.say_what_a_project_keeps(scene, adds=True)
        objects = list_objects(out.open_project(scene))
        values: dict[str, object] = {
            "scene": str(scene),
            "stages_run": list(done),
            "groups": None if entry is None else entry.groups_with_gaussians,
            "objects": objects if self.json else out.object_names(objects, _MOST_NAMES),
        }
        return out.result(values, as_json=self.json)


@dataclass(frozen=True)
class ReconstructCommand:
    """Make a scene folder of a folder of photos or of a video: place the photos, train splats."""

    photos: Positional[Path]
    """Folder of photos, video file, or recording of a phone (.r3d, folder of Stray Scanner)."""
    scene: Positional[Path]
    """Scene folder to make or to complete; what is there already is not made again."""
    config: Annotated[
        ReconstructConfig,
        options(
            ReconstructConfig,
            *("iterations", "max_side", "max_splats", "strategy", "antialiased", "exposure"),
            *("video_fps", *_PLACING, "seed", "threads", "only"),
        ),
    ]
    quality: Literal["auto"] | Quality = "auto"
    """draft: minutes on a processor. full: the published schedule. auto: full on CUDA, else draft.
    """
    backend: Backend = "auto"
    go_on: bool = False
    """Go on with a training that was stopped and whose splats were kept, with its settings."""
    json: AsJson = False

    def run(self) -> int:
        """Write images/, sparse/0/, cameras.json, point_cloud.ply and gaga/report.json."""
        from gaga_core.pipeline.reconstruct import go_on_stage, reconstruct_scene
        from gaga_core.raster import choose

        engine, quality = choose(self.backend), self.quality
        if quality == "auto":
            quality = "full" if engine.name == "cuda" else "draft"
        config = replace(self.config, quality=quality)
        if self.go_on:
            stage = go_on_stage(self.scene, rasterizer=engine)
        else:
            stage = reconstruct_scene(self.photos, self.scene, config, rasterizer=engine)
        made = out.follow(stage)
        for note in made.notes:
            out.say(note)
        if not made.stages_run:
            out.say(f"Nothing was missing in {self.scene}. Name a new folder for another quality.")
        values = {"scene": str(self.scene), "stages_run": list(made.stages_run)}
        figures = made.report if self.json else _figures(made.report)
        return out.result(values | figures, as_json=self.json)


def _figures(report: dict[str, object]) -> dict[str, object]:
    """The figures of the report that matter for a person."""
    shown: dict[str, object] = {}
    sfm, train = report.get("sfm"), report.get("train")
    held_out = train.get("held_out") if isinstance(train, dict) else None
    for values, keys in (
        (sfm, ("photos", "registered", "points", "reprojection", "track")),
        (train, ("splats", "iterations")),
        (held_out, ("psnr", "ssim")),
    ):
        if isinstance(values, dict):
            shown |= {key: values[key] for key in keys if values.get(key) is not None}
    return shown
