"""Commands over single files: edit, info, lod, doctor, demo."""

import importlib.metadata
import platform
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from gaga_core.cli import output as out
from gaga_core.cli.output import AnyScene, AsJson
from gaga_core.errors import GagaError, cure_without

if TYPE_CHECKING:
    from gaga_core.progress import Stage
    from gaga_core.scene.project import Project

_MOST_SCRIPT = 1 << 30  # bytes: recorded edits of a million splats take megabytes each


@dataclass(frozen=True)
class EditCommand:
    """Apply recorded edits to a model and write the edited one."""

    input: AnyScene
    output: Positional[Path]
    """The .ply, .compressed.ply, .splat, .spz, .sog, .glb, .usd or .html to write."""
    script: Path
    """JSON list of edits, for example [{"op": "delete", "groups": [3]}]."""
    groups: bool = False
    """Add a column with the group id of each Gaussian."""
    json: AsJson = False

    def run(self) -> int:
        """Write what is visible after the edits."""
        from gaga_core.cli.export import say_losses
        from gaga_core.edit_script import parse_script, run_script
        from gaga_core.export.export import export_losses, export_scene_stage
        from gaga_core.export.options import ExportOptions
        from gaga_core.export.page import content_of
        from gaga_core.io.json_file import read_json
        from gaga_core.io.splats.splat_files import SplatFormat, form_of
        from gaga_core.pipeline.search import describe_project
        from gaga_core.scene.project import require_other_file

        form_of(self.output)  # a mistake is told before a large model is read
        script = read_json(
            self.script, list[object], "Fix the script and run again.", most_bytes=_MOST_SCRIPT
        )
        parse_script(script)
        project = out.open_project(self.input)
        require_other_file(project, self.output)
        scene = project.scene
        titles = run_script(scene, script, views=lambda: project.training_views)
        behind: frozenset[int] = frozenset()
        if form_of(self.output) is SplatFormat.HTML:
            behind = describe_project(project).background  # and names objects
        page = replace(content_of(project), background=behind)
        options = ExportOptions(up=project.up, page=page)
        say_losses(export_losses(scene, form_of(self.output), groups=self.groups))
        stage = export_scene_stage(scene, self.output, groups=self.groups, options=options)
        written = out.follow(stage).n_splats
        values = {"file": str(self.output), "edits": list(titles), "gaussians": written}
        return out.result(values, as_json=self.json)


@dataclass(frozen=True)
class InfoCommand:
    """Say what a file of splats, scene folder or project holds."""

    file: Positional[Path]
    """What to look at."""
    json: AsJson = False

    def run(self) -> int:
        """Print counts, columns, views and groups."""
        values = out.follow(describe(self.file))
        if not self.json:
            values["folders"] = out.folder_names(values["folders"], values["objects"])
            values["objects"] = out.object_names(values["objects"])
        return out.result(values, as_json=self.json)


@dataclass(frozen=True)
class LodCommand:
    """Build the level of detail of a large scene, which the window draws it by."""

    scene: AnyScene
    again: bool = False
    """Build it also when there is one of this model."""
    sog: Path | None = None
    """Folder to write the levels to as streamed SOG (lod-meta.json), which other viewers load."""
    json: AsJson = False

    def run(self) -> int:
        """Write gaga/lod in the scene folder, or NAME.gaga/lod next to a file.

        Of a saved project to which files were added: lod-added there, of all of them.
        """
        from gaga_core.io.splats.sog import LOD_META
        from gaga_core.pipeline.level_of_detail import (
            build_project_lod_stage,
            open_project_lod,
            rows_of,
            rows_of_files,
        )
        from gaga_core.scene.lod.tree import write_streamed_sog_stage
        from gaga_core.scene.project import require_other_file

        project = out.open_project(self.scene)
        if self.sog is not None:
            require_other_file(project, self.sog / LOD_META)
        tree = None if self.again else open_project_lod(project)
        is_new = tree is None or len(tree) < rows_of_files(project.scene)
        if tree is None or is_new:
            tree = out.follow(build_project_lod_stage(project))
        values: dict[str, object] = {}
        if self.sog is not None:
            stage = write_streamed_sog_stage(self.sog, tree, rows_of(project, len(tree)))
            values["streamed_sog"] = str(out.follow(stage))
        made = {
            "folder": str(tree.folder),
            "built": is_new,
            "gaussians": len(tree),
            "levels": list(tree.sizes),
            "megabytes": round(tree.file_bytes / 1e6, 1),
        }
        return out.result(made | values, as_json=self.json)


@dataclass(frozen=True)
class DoctorCommand:
    """Check what this machine can do, and what is missing."""

    json: AsJson = False

    def run(self) -> int:
        """Print one line a finding; exit status 1 when something needed is missing."""
        findings = examine()
        values = {f.name: f.text if f.ok else f"PROBLEM: {f.text}" for f in findings}
        out.result(values, as_json=self.json)
        return 0 if all(f.ok for f in findings) else 1


@dataclass(frozen=True)
class DemoCommand:
    """Write the demo scene: a furnished room with photos, masks and true instance maps."""

    folder: Positional[Path]
    """Where to put it."""
    json: AsJson = False

    def run(self) -> int:
        """Write a whole scene folder."""
        from gaga_core.io.demo_scene import copy_demo_stage

        made = out.follow(copy_demo_stage(self.folder))
        return out.result({"scene": str(made)}, as_json=self.json)


# --- ``gaga info``: what a file or folder holds, in plain values.


def describe(path: Path) -> "Stage[dict[str, object]]":
    """Open ``path`` (scene folder, file of splats or project) and describe it."""
    import numpy as np

    from gaga_core.pipeline.search import list_objects
    from gaga_core.scene.frame import lengths_text
    from gaga_core.scene.project import open_path_stage
    from gaga_core.scene.selection.algebra import world_means

    project = yield from open_path_stage(path)
    scene, gaussians = project.scene, project.scene.gaussians
    rows = np.flatnonzero(scene.visible).astype(np.int32)
    size = "nothing is visible"
    if len(rows):
        # Outliers far away are common; percentiles say how large the scene is to a person.
        low, high = np.percentile(world_means(scene, rows), [1, 99], axis=0)
        size = lengths_text((high - low).tolist(), is_metric=scene.frame.is_metric)
    values: dict[str, object] = {
        "model": str(project.model_path),
        "gaussians": len(gaussians),
        "visible": len(rows),
        "sh_degree": gaussians.sh_degree,
        "look": "antialiased" if gaussians.is_antialiased else "classic",
        "size": size,
        "extra_columns": [name for name in gaussians.extra if name not in ("nx", "ny", "nz")],
    }
    folder = project.folder
    if folder is not None:
        values |= {
            "views": len(folder.cameras),
            "photos_on_disk": len(folder.image_paths),
            "train_views": len(folder.train),
            "test_views": len(folder.test),
            "split": folder.split,
            "masks": list(folder.mask_folders),
        }
    if files := [item.path for item in scene.added if not item.is_made]:
        values["added_files"] = files
    objects = list_objects(project)
    return values | {
        "groups": len(objects),
        "objects": objects,
        "folders": {path: list(scene.folders.groups(path)) for path in scene.folders.paths},
        "level_of_detail": _level_of_detail(project),
        "saved_project": str(project.path) if project.path else _other_project(project),
    }


def _other_project(project: "Project") -> str:
    saved = project.saved_of_file
    return "none" if saved is None else f"{saved} (of this file; open it for its edits)"


def _level_of_detail(project: "Project") -> str:
    """Where the tree of merged splats is, if there is one that fits the model."""
    from gaga_core.pipeline.level_of_detail import open_project_lod

    try:
        tree = open_project_lod(project)
    except GagaError as error:
        return f"damaged: {error}"
    return "none" if tree is None else f"{len(tree.sizes)} levels in {tree.folder}"


# --- ``gaga doctor``: what this machine can do, and what to install where something is missing.


_PACKAGES = ("numpy", "numba", "scipy", "moderngl", "imgui-bundle", "glfw", "pycolmap", "torch")
_PROBE_SECONDS = 60
_EXTRAS = (  # package, the extra that brings it, what it is for
    ("transformers", "models", "masks by SAM and other models, search by words"),
    ("distributed", "executors", "many scenes at once with --executor dask"),
    ("coacd", "simulation", "convex parts of objects for simulators"),
    ("mujoco-core", "simulation", "objects that fall and come to rest"),
    ("usd-core", "usd", "OpenUSD, read and written"),
)


@dataclass(frozen=True)
class Finding:
    """One line of the report."""

    name: str
    text: str
    ok: bool


def examine() -> list[Finding]:
    """Look at Python, packages, graphics and compute; never raises."""
    from gaga_core.raster import backend_report
    from gaga_core.threads import n_threads

    findings = [
        Finding("python", f"{platform.python_version()} on {platform.platform()}", True),
        Finding("processor", f"{n_threads()} threads for the kernels", True),
    ]
    for package in _PACKAGES:
        try:
            findings.append(Finding(package, importlib.metadata.version(package), True))
        except importlib.metadata.PackageNotFoundError:
            findings.append(_missing(package))
    name, reason = backend_report(fresh=True)  # again: a user runs this after fixing something
    drawn = f"{name} ({'' if name == 'cuda' else 'cuda: '}{reason})"
    extras = [_extra(*extra) for extra in _EXTRAS]
    return [
        *(*findings, _ffmpeg(), *extras, *_registered(), _cuda()),
        Finding("rasterizer", drawn, True),
    ]


def _missing(package: str) -> Finding:
    """A package that is not there; the program of `make app` comes without torch."""
    if package == "torch" and getattr(sys, "frozen", False):
        text = f"not installed (masks and words by models, CUDA): {cure_without('models')}"
        return Finding(package, text, True)
    return Finding(package, "missing: install gaga-studio again with pip", False)


def _ffmpeg() -> Finding:
    """The program that reads and writes videos."""
    from gaga_core.io.video import ffmpeg_program

    try:
        program = ffmpeg_program()
        told = subprocess.run(
            [program, "-version"],
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=_PROBE_SECONDS,
            check=True,
        ).stdout
    except (GagaError, ImportError, subprocess.SubprocessError, OSError):
        text = "missing: videos can be neither read nor written; pip install imageio-ffmpeg"
        return Finding("ffmpeg", text, False)
    words = told.split()
    version = words[2] if len(words) > 2 else "unknown version"
    return Finding("ffmpeg", f"{version}: reads and writes videos", True)


def _extra(package: str, extra: str, purpose: str) -> Finding:
    """A package that can be done without: it is no fault that it is missing."""
    name = "dask" if package == "distributed" else package
    try:
        return Finding(name, f"{importlib.metadata.version(package)}: {purpose}", True)
    except importlib.metadata.PackageNotFoundError:
        text = f"not installed ({purpose}): {cure_without(extra)}"
        return Finding(name, text, True)


def _registered() -> list[Finding]:
    """What other packages ask of the machine (entry points of the group ``gaga_core.probes``).

    Each is a module that prints a line of JSON with ``ok`` and ``text``; the last line counts, so
    that one which may crash says first what a crash means. It runs in a process of its own.
    """
    findings = []
    for entry in sorted(
        importlib.metadata.entry_points(group="gaga_core.probes"), key=lambda entry: entry.name
    ):
        answer = _probe("-m", entry.value)
        ok, text = (bool(answer["ok"]), str(answer["text"])) if answer else (False, "no answer")
        findings.append(Finding(entry.name, text, ok))
    return findings


def _cuda() -> Finding:
    code = (
        "import json, torch; ok = torch.cuda.is_available();"
        "print(json.dumps({'device': torch.cuda.get_device_name(0) if ok else ''}))"
    )
    answer = _probe("-c", code)
    if answer and answer["device"]:
        return Finding("cuda", str(answer["device"]), True)
    return Finding("cuda", "none: everything runs on the processor, which is enough", True)


def _probe(*arguments: str) -> dict[str, str | bool] | None:
    """The last line that a Python process prints, from JSON; None when it prints none."""
    from gaga_core.io.json_file import decode_json

    try:
        done = subprocess.run(
            [sys.executable, *arguments],
            capture_output=True,
            text=True,
            timeout=_PROBE_SECONDS,
            check=False,  # one that crashed has said before what that means
        )
        answer: dict[str, str | bool] = decode_json(
            done.stdout.splitlines()[-1].encode(), dict[str, str | bool], "The probe", ""
        )
    except (subprocess.SubprocessError, OSError, GagaError, IndexError):
        return None
    return answer
