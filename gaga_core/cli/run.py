"""The command that goes the whole way: from photos to objects."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from gaga_core.cli import output as out
from gaga_core.cli.output import GroupSwitches, IdentitySwitches
from gaga_core.errors import GagaError

if TYPE_CHECKING:
    from gaga_core.pipeline.run import RunConfig

# --- The command that goes the whole way: from photos to objects.


@dataclass(frozen=True)
class RunCommand:
    """From photos to objects: splats, masks, groups, encodings, pictures; all that are missing."""

    scenes: Positional[tuple[Path, ...]]
    """Scene folder, folder of photos or video; with --executor several, or a folder of many."""
    to: Path | None = None
    """Scene folder to make of photos or a video; default: next to them, as NAME-scene."""
    masks: Path | None = None
    """Folder of label maps that are there; default: the only one in SCENE/masks."""
    masks_from: str = ""
    """Who makes the masks (gaga masks --list); default: regions, where there are none yet."""
    model: Path | None = None
    """The 3D Gaussians; default: the newest model of the scene folder."""
    preset: Literal["robust", "paper"] | None = None
    """robust (default): groups by the consensus of all views, identities by vote. paper: the
    published method to the letter: association of section 3.2, identities trained for 10,000 steps,
    labels by their classifier. When given, groups of the other preset are made again."""
    groups: Annotated[GroupSwitches, arg(name="")] = field(default_factory=GroupSwitches)
    lift: Literal["vote", "refine", "paper"] | None = None
    """How groups become identities (see gaga lift); default: as the preset has it."""
    identities: Annotated[IdentitySwitches, arg(name="")] = field(default_factory=IdentitySwitches)
    quality: Literal["draft", "standard", "full"] = "draft"
    """Of splats that are still to be trained."""
    iterations: int | None = None
    """Training steps; default: as the quality says."""
    max_side: int | None = None
    """Longest side of the training pictures in pixels; default: as the quality says."""
    focal: float | None = None
    """Focal length in pixels of the photos as they are; default: from EXIF, else estimated."""
    place_minutes: float | None = None
    """Time for all attempts to place the photos; default: 20, 60 or 300 as the quality says."""
    foreground: Path | None = None
    """Folder of masks of the object, NAME.png, black = background: the background is left out."""
    turntable: bool = False
    """The object turned in front of a camera that stood still: leave the background out."""
    scene_number: Annotated[int, arg(name="scene")] = 1
    """Which scene to make, by size, when the photos show several."""
    accept_wrong: bool = False
    """Keep a placement of the photos that the checks refuse."""
    executor: Literal["none", "local", "dask", "ray"] = "none"
    """Who runs many scenes: processes here, or workers of dask or ray."""
    workers: int = 2
    """Scenes at once, where the workers are started here."""
    address: str = ""
    """Of a dask scheduler or a ray cluster that is running; default: start one here."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Bring the folder to the state that the window needs."""
        from gaga_core.pipeline.compile_kernels import after_warm_up
        from gaga_core.pipeline.reconstruct import read_entry, source_of
        from gaga_core.pipeline.run import JOIN, run_folder
        from gaga_core.pipeline.search import list_objects
        from gaga_core.scene.project import open_path_stage

        config = self._config()
        if self.executor != "none":
            return self._run_many(config, self.executor)
        given = self._only_scene()
        photos, scene = source_of(given)
        if self.to is not None:
            photos, scene = given, self.to
        if scene != given:
            out.say(f"The scene folder is {scene}.")
        before = read_entry(scene)
        stage = run_folder(scene, config, photos=photos, model=self.model)
        done = out.follow(after_warm_up(stage))
        for note in _new_notes(before, read_entry(scene)):
            out.say(note)
        if JOIN in done:
            _say_what_joined(scene)
        objects = list_objects(out.follow(open_path_stage(scene)))
        values: dict[str, object] = {
            "scene": str(scene),
            "stages_run": list(done),
            "groups": _n_groups(scene),
            "objects": objects if self.json else out.object_names(objects),
        }
        out.result(values, as_json=self.json)
        return 0

    def _only_scene(self) -> Path:
        """The one scene; ``GagaError`` when there are more, or none."""
        if len(self.scenes) != 1:
            raise GagaError(
                f"{len(self.scenes)} scenes need an executor. Add --executor local."
                if self.scenes
                else "Name a scene folder, a folder of photos or a video."
            )
        return self.scenes[0]

    def _config(self) -> "RunConfig":
        from gaga_core.pipeline.reconstruct import ReconstructConfig
        from gaga_core.pipeline.run import RunConfig

        if self.masks is not None and self.masks_from:
            raise GagaError("--masks and --masks-from exclude each other. Leave one out.")
        reconstruct = ReconstructConfig(
            quality=self.quality,
            iterations=self.iterations,
            max_side=self.max_side,
            focal=self.focal,
            place_minutes=self.place_minutes,
            foreground=None if self.foreground is None else str(self.foreground.absolute()),
            turntable=self.turntable,
            scene=self.scene_number,
            accept_wrong=self.accept_wrong,
        )
        return RunConfig(
            reconstruct=reconstruct,
            masks=self.masks,
            masks_from=self.masks_from,
            associate=self.groups.config(self.preset or "robust"),
            keeps_groups=self.preset is None,
            mode=self.lift,
            lift=self.identities.config(),
        )

    def _run_many(self, config: "RunConfig", engine: Literal["local", "dask", "ray"]) -> int:
        from gaga_core.pipeline.compile_kernels import after_warm_up
        from gaga_core.pipeline.executors import EngineConfig, list_tasks, run_scenes

        if self.model is not None or self.to is not None:
            raise GagaError("--model and --to are for one scene. Leave them out with --executor.")
        workers = EngineConfig(engine, self.workers, address=self.address)
        if not self.scenes:
            raise GagaError("Name a folder of scenes, or several scenes.")
        list_tasks(self.scenes)  # fails before kernels are compiled
        report = out.follow(after_warm_up(run_scenes(self.scenes, config, workers)))
        out.scores(report, as_json=self.json)
        out.say(f"With pictures: {report.page}")
        return 1 if report.failed else 0


def _new_notes(before: dict[str, object], after: dict[str, object]) -> list[str]:
    """Notes on the photos: which were left out, and warnings of the checks."""
    sfm = after.get("sfm")
    if sfm == before.get("sfm") or not isinstance(sfm, dict):
        return []
    from gaga_core.pipeline.place import notes_of

    return list(notes_of(sfm))


def _say_what_joined(scene: Path) -> None:
    """That new views joined the groups of the scene, how many, and what it means for a project."""
    from gaga_core.cli.scene import say_what_a_project_keeps
    from gaga_core.io.folder.scene_folder import AssociateEntry, read_report_entry

    entry = read_report_entry(scene / "gaga" / "report.json", "associate", AssociateEntry)
    out.say("New masks joined the groups that there were; these were not made again.")
    for note in () if entry is None else entry.notes:
        out.say(note)
    say_what_a_project_keeps(scene, adds=True)


def _n_groups(scene: Path) -> int | None:
    """Objects that the last association found; None without one."""
    from gaga_core.io.folder.scene_folder import AssociateEntry, read_report_entry

    entry = read_report_entry(scene / "gaga" / "report.json", "associate", AssociateEntry)
    return None if entry is None else entry.groups_with_gaussians


# --- The command that makes a scene of photos.


@dataclass(frozen=True)
class ReconstructCommand:
    """Make a scene folder of a folder of photos or of a video: place the photos, train splats."""

    photos: Positional[Path]
    """Folder of photos, or a video file."""
    scene: Positional[Path]
    """Scene folder to make or to complete; what is there already is not made again."""
    quality: Literal["auto", "draft", "standard", "full"] = "auto"
    """draft: minutes on a processor. full: the published schedule. auto: full on CUDA, else draft.
    """
    iterations: int | None = None
    """Training steps; default: as the quality says."""
    max_side: int | None = None
    """Longest side of the training pictures in pixels; default: as the quality says."""
    max_splats: int | None = None
    """No more splats than this; default: as the quality says."""
    strategy: Literal["gradient", "mcmc"] = "gradient"
    """How splats are added: where the gradient is large, or by sampling (MCMC, Kheradmand 2024)."""
    antialiased: bool = False
    """Splats that also look right from nearer and farther away, in viewers with a mip mode."""
    exposure: bool = False
    """Photos differ in brightness or white balance: train that along, and leave it out."""
    focal: float | None = None
    """Focal length in pixels of the photos as they are; default: from EXIF, else estimated."""
    video_fps: float | None = None
    """Frames to take of each second of a video; default: as it moves, the sharpest ones."""
    place_minutes: float | None = None
    """Time for all attempts to place the photos; default: 20, 60 or 300 as the quality says."""
    foreground: Path | None = None
    """Folder of masks of the object, NAME.png, black = background: the background is left out."""
    turntable: bool = False
    """The object turned in front of a camera that stood still: leave the background out."""
    scene_number: Annotated[int, arg(name="scene")] = 1
    """Which scene to make, by size, when the photos show several."""
    seed: int = 0
    """Equal seeds give equal scenes."""
    threads: int = 0
    """Processor threads; 0: all."""
    only: Literal["all", "sfm"] = "all"
    """sfm: place the photos and stop before the training."""
    accept_wrong: bool = False
    """Keep a placement of the photos that the checks refuse."""
    backend: Literal["auto", "cpu", "cuda"] = "auto"
    """Who trains: auto takes CUDA where a self-test has passed (see gaga doctor)."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Write images/, sparse/0/, cameras.json, point_cloud.ply and gaga/report.json."""
        from gaga_core.pipeline.reconstruct import ReconstructConfig, reconstruct_scene
        from gaga_core.raster import choose

        engine = choose(self.backend)
        automatic: Literal["draft", "full"] = "full" if engine.name == "cuda" else "draft"
        config = ReconstructConfig(
            quality=automatic if self.quality == "auto" else self.quality,
            iterations=self.iterations,
            max_side=self.max_side,
            max_splats=self.max_splats,
            strategy=self.strategy,
            antialiased=self.antialiased,
            exposure=self.exposure,
            focal=self.focal,
            video_fps=self.video_fps,
            place_minutes=self.place_minutes,
            foreground=None if self.foreground is None else str(self.foreground.absolute()),
            turntable=self.turntable,
            scene=self.scene_number,
            seed=self.seed,
            threads=self.threads,
            only=self.only,
            accept_wrong=self.accept_wrong,
        )
        stage = reconstruct_scene(self.photos, self.scene, config, rasterizer=engine)
        made = out.follow(stage)
        for note in made.notes:
            out.say(note)
        values = {"scene": str(self.scene), "stages_run": list(made.stages_run)}
        out.result(values | _figures(made.report, as_json=self.json), as_json=self.json)
        return 0


def _figures(report: dict[str, object], *, as_json: bool) -> dict[str, object]:
    """The report as it is for a machine; the figures that matter for a person."""
    if as_json:
        return report
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
