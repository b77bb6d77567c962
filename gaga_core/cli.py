"""``gaga``: everything that the window does, without a window.

Results go to standard output (``--json`` for machines), messages and progress to standard error.
Exit status 0 only on success; Ctrl-C leaves nothing half-written.
"""

import json
import logging
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import Positional, arg, subcommand

import gaga_core
from gaga_core import cli_output as out
from gaga_core.errors import GagaError


@dataclass(frozen=True)
class Associate:
    """Associate the 2D masks of all views: every Gaussian and pixel gets a group id."""

    scene: Positional[Path]
    """Scene folder (images/, sparse/0/, masks/, point_cloud.ply)."""
    masks: Path | None = None
    """Folder of label maps; default: the only one in SCENE/masks."""
    model: Path | None = None
    """The 3D Gaussians; default: the newest model of the scene folder."""
    preset: Literal["robust", "paper"] = "robust"
    """robust: guarded, several passes. paper: the published method to the letter."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Write SCENE/gaga/: bank, labels per Gaussian, group maps of the masks, report."""
        from gaga_core import pipeline
        from gaga_core.grouping.associate import AssociateConfig
        from gaga_core.io.scene_folder import open_scene_folder

        folder = open_scene_folder(self.scene, model=self.model)
        config = AssociateConfig.of(self.preset)
        stage = pipeline.associate_scene(folder, masks=self.masks, config=config)
        report = out.follow(stage)
        for note in report.notes:
            out.say(note)
        if (folder.work / "project.json").is_file():
            out.say(
                "The saved project of this scene keeps its own groups until you associate there."
            )
        out.result(report.to_json(), as_json=self.json)
        return 0


@dataclass(frozen=True)
class Render:
    """Render views of a scene: color, group ids, or depth."""

    scene: Positional[Path]
    """Scene folder."""
    out: Path
    """Folder to write <view>.png into (groups: 16-bit group ids, depth: 16-bit thousandths)."""
    what: Literal["rgb", "groups", "depth"] = "rgb"
    """What a pixel says."""
    views: tuple[str, ...] = ("test",)
    """train, test, all, or names of views."""
    model: Path | None = None
    """The 3D Gaussians; default: the newest model of the scene folder."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Write one picture a view."""
        from gaga_core import pipeline
        from gaga_core.io.scene_folder import open_scene_folder

        folder = open_scene_folder(self.scene, model=self.model)
        stage = pipeline.render_views(folder, self.out, what=self.what, views=self.views)
        written = out.follow(stage)
        out.result({"folder": str(self.out), "pictures": len(written)}, as_json=self.json)
        return 0


@dataclass(frozen=True)
class Evaluate:
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
    json: bool = False
    """Print the report as JSON."""

    def run(self) -> int:
        """Print IoU, precision and recall, with void as a class and without."""
        if self.protocol == "lerf-mask":
            return self._lerf_mask()
        from gaga_core.evaluate.metrics import evaluate
        from gaga_core.io.scene_folder import open_scene_folder

        stems = None
        if self.scene is not None and self.views != "all":
            folder = open_scene_folder(self.scene)
            names = folder.test if self.views == "test" else folder.train
            stems = [Path(name).stem for name in names]
        report = evaluate(self.pred, self.gt, stems=stems)
        if report.missing:
            out.say(f"{len(report.missing)} predictions are missing and count as 0.")
        if self.json:
            out.result(report.to_json(), as_json=True)
            return 0
        headings, *rows = report.table()
        out.table(headings, rows)
        return 0

    def _lerf_mask(self) -> int:
        from gaga_core.evaluate.lerf_mask import evaluate_lerf_mask

        report = evaluate_lerf_mask(self.pred, self.gt)
        if report.missing:
            out.say(f"{len(report.missing)} predictions are missing and count as 0.")
        if self.json:
            out.result(report.to_json(), as_json=True)
            return 0
        headings, *rows = report.table()
        out.table(headings, rows)
        return 0


@dataclass(frozen=True)
class Compare:
    """Run all variants of the association on one scene: presets, ablations, bounds, few views."""

    scene: Positional[Path]
    """Scene folder with masks."""
    gt: Path
    """Folder of true label maps."""
    masks: Path | None = None
    """Folder of label maps; default: the only one in SCENE/masks."""
    seeds: tuple[int, ...] = (0,)
    """Draws of the training views for the sparse rows."""
    json: bool = False
    """Print the table as JSON."""

    def run(self) -> int:
        """Print one table and write SCENE/gaga/variants.json."""
        from gaga_core.compare import CompareConfig, compare_variants
        from gaga_core.io.scene_folder import open_scene_folder

        folder = open_scene_folder(self.scene)
        stage = compare_variants(folder, self.gt, self.masks, CompareConfig(seeds=self.seeds))
        table = out.follow(stage)
        if self.json:
            out.result(table.to_json(), as_json=True)
            return 0
        headings, *rows = table.table()
        out.table(headings, rows)
        return 0


@dataclass(frozen=True)
class Edit:
    """Apply recorded edits to a model and write the edited .ply."""

    input: Positional[Path]
    """Scene folder, .ply file or saved project."""
    output: Positional[Path]
    """The .ply to write."""
    script: Path
    """JSON list of edits, for example [{"op": "delete", "groups": [3]}]."""
    groups: bool = False
    """Add a column with the group id of each Gaussian."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Write what is visible after the edits."""
        from gaga_core.project import open_path_stage
        from gaga_core.scene.export import export_scene_stage
        from gaga_core.scene.script import parse_script, run_script

        script = _read_json(self.script)
        parse_script(script)  # a mistake is told before a large model is read
        scene = out.follow(open_path_stage(self.input)).scene
        titles = run_script(scene, script)
        written = out.follow(export_scene_stage(scene, self.output, groups=self.groups))
        values = {"file": str(self.output), "edits": list(titles), "gaussians": written}
        out.result(values, as_json=self.json)
        return 0


@dataclass(frozen=True)
class Export:
    """Export a scene with its edits: the whole, or one .ply per object, or the group maps."""

    scene: Positional[Path]
    """Scene folder, .ply file or saved project."""
    out: Path
    """A .ply for --what scene, a folder otherwise."""
    what: Literal["scene", "objects"] = "scene"
    """scene: one .ply of all that is visible. objects: one .ply per group and groups.json."""
    only: tuple[int, ...] = ()
    """Group ids (objects); default: all."""
    groups: bool = False
    """Add a column with the group id of each Gaussian (scene)."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Write plain 3DGS files that other tools open."""
        from gaga_core.project import open_path_stage
        from gaga_core.scene.export import export_objects_stage, export_scene_stage

        scene = out.follow(open_path_stage(self.scene)).scene
        if self.what == "scene":
            written = out.follow(export_scene_stage(scene, self.out, groups=self.groups))
            out.result({"file": str(self.out), "gaussians": written}, as_json=self.json)
            return 0
        stage = export_objects_stage(scene, self.out, self.only or None, source=str(self.scene))
        manifest = out.follow(stage)
        count = len(list(self.out.glob("*.ply")))
        out.result({"manifest": str(manifest), "files": count}, as_json=self.json)
        return 0


@dataclass(frozen=True)
class Run:
    """Run every stage that is missing in a scene folder."""

    scene: Positional[Path]
    """Scene folder."""
    preset: Literal["robust", "paper"] = "robust"
    """Preset of the association."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Bring the folder to the state that the window needs."""
        from gaga_core import pipeline
        from gaga_core.grouping.associate import AssociateConfig
        from gaga_core.io.scene_folder import open_scene_folder

        folder = open_scene_folder(self.scene)
        stage = pipeline.run_missing(folder, config=AssociateConfig.of(self.preset))
        done = out.follow(stage)
        out.result({"scene": str(self.scene), "stages_run": list(done)}, as_json=self.json)
        return 0


@dataclass(frozen=True)
class Info:
    """Say what a .ply file, scene folder or project holds."""

    file: Positional[Path]
    """What to look at."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Print counts, columns, views and groups."""
        from gaga_core.info import describe

        out.result(out.follow(describe(self.file)), as_json=self.json)
        return 0


@dataclass(frozen=True)
class Doctor:
    """Check what this machine can do, and what is missing."""

    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Print one line a finding; exit status 1 when something needed is missing."""
        from gaga_core.doctor import examine

        findings = examine()
        values = {f.name: f.text if f.ok else f"PROBLEM: {f.text}" for f in findings}
        out.result(values, as_json=self.json)
        return 0 if all(f.ok for f in findings) else 1


@dataclass(frozen=True)
class Demo:
    """Make the demo scene: a furnished room with photos, masks and true instance maps."""

    folder: Positional[Path]
    """Where to make it."""
    seed: int = 0
    """Another seed, another arrangement."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Write a whole scene folder."""
        from gaga_core.demo import make_demo_stage

        made = out.follow(make_demo_stage(self.folder, seed=self.seed))
        out.result({"scene": str(made)}, as_json=self.json)
        return 0


Command = (
    Annotated[Associate, subcommand("associate")]
    | Annotated[Render, subcommand("render")]
    | Annotated[Evaluate, subcommand("evaluate")]
    | Annotated[Compare, subcommand("compare")]
    | Annotated[Edit, subcommand("edit")]
    | Annotated[Export, subcommand("export")]
    | Annotated[Run, subcommand("run")]
    | Annotated[Info, subcommand("info")]
    | Annotated[Doctor, subcommand("doctor")]
    | Annotated[Demo, subcommand("demo")]
)


def _read_json(path: Path) -> object:
    try:
        content: object = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise GagaError(f"{path} cannot be read: {error.strerror}. Check the path.") from error
    except ValueError as error:
        raise GagaError(f"{path} is no JSON ({error}). Mend it and run again.") from error
    return content


@dataclass(frozen=True)
class Main:
    """Group any Gaussians: associate, render, evaluate, edit and export 3D Gaussian scenes."""

    command: Annotated[Command, arg(name="")]


def main(arguments: list[str] | None = None) -> int:
    """Entry point of ``gaga``; returns the exit status."""
    logging.basicConfig(format="gaga: %(message)s", level=logging.WARNING, stream=sys.stderr)
    given = sys.argv[1:] if arguments is None else arguments
    if given in (["--version"], ["-V"]):
        sys.stdout.write(f"gaga {gaga_core.__version__}\n")
        return 0
    parsed = tyro.cli(
        Main,
        prog="gaga",
        args=given,
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes),
    )
    try:
        return parsed.command.run()
    except GagaError as error:
        out.fail(str(error))
        return 1
    except KeyboardInterrupt:
        out.fail("Stopped. Nothing was left half-written.")
        return 130


if __name__ == "__main__":
    sys.exit(main())
