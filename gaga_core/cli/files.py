"""Commands over single files: edit, info, doctor, demo."""

from dataclasses import dataclass, replace
from pathlib import Path

from tyro.conf import Positional

from gaga_core.cli import output as out
from gaga_core.cli.export import say_losses, up_of
from gaga_core.io.json_file import read_json

_MOST_SCRIPT = 1 << 30  # bytes: recorded edits of a million splats take megabytes each


@dataclass(frozen=True)
class EditCommand:
    """Apply recorded edits to a model and write the edited one."""

    input: Positional[Path]
    """Scene folder, file of splats (.ply, .splat, .spz, .sog, .ksplat, .glb, .gltf) or
    saved project."""
    output: Positional[Path]
    """The .ply, .compressed.ply, .splat, .spz, .sog, .glb or .html to write."""
    script: Path
    """JSON list of edits, for example [{"op": "delete", "groups": [3]}]."""
    groups: bool = False
    """Add a column with the group id of each Gaussian."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Write what is visible after the edits."""
        from gaga_core.io.splat_files import SplatFormat, form_of
        from gaga_core.pipeline.describe import describe_project
        from gaga_core.scene.export import export_losses, export_scene_stage
        from gaga_core.scene.export_options import ExportOptions
        from gaga_core.scene.project import open_path_stage
        from gaga_core.scene.script import parse_script, run_script
        from gaga_core.scene.web_page import content_of

        form_of(self.output)  # a mistake is told before a large model is read
        script = read_json(
            self.script, list[object], "Fix the script and run again.", most_bytes=_MOST_SCRIPT
        )
        parse_script(script)
        project = out.follow(open_path_stage(self.input))
        scene = project.scene
        titles = run_script(scene, script, views=lambda: project.training_views)
        behind: frozenset[int] = frozenset()
        if form_of(self.output) is SplatFormat.HTML:
            behind = describe_project(project).background  # and names objects
        page = replace(content_of(project), background=behind)
        options = ExportOptions(up=up_of(project), page=page)
        say_losses(export_losses(scene, form_of(self.output), groups=self.groups))
        stage = export_scene_stage(scene, self.output, groups=self.groups, options=options)
        written = out.follow(stage).n_splats
        values = {"file": str(self.output), "edits": list(titles), "gaussians": written}
        out.result(values, as_json=self.json)
        return 0


@dataclass(frozen=True)
class InfoCommand:
    """Say what a file of splats, scene folder or project holds."""

    file: Positional[Path]
    """What to look at."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Print counts, columns, views and groups."""
        from gaga_core.cli.info import describe

        values = out.follow(describe(self.file))
        if not self.json:
            values["folders"] = out.folder_names(values["folders"], values["objects"])
            values["objects"] = out.object_names(values["objects"])
        out.result(values, as_json=self.json)
        return 0


@dataclass(frozen=True)
class DoctorCommand:
    """Check what this machine can do, and what is missing."""

    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Print one line a finding; exit status 1 when something needed is missing."""
        from gaga_core.cli.doctor import examine

        findings = examine()
        values = {f.name: f.text if f.ok else f"PROBLEM: {f.text}" for f in findings}
        out.result(values, as_json=self.json)
        return 0 if all(f.ok for f in findings) else 1


@dataclass(frozen=True)
class DemoCommand:
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
