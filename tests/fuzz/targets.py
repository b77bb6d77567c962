"""Every reader, with a good file to damage."""

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaga_core.edit_script import run_script
from gaga_core.evaluate.benchmark.files import read_runs, write_runs
from gaga_core.evaluate.benchmark.tables import BenchmarkRun, InstanceScores, PromptScores
from gaga_core.evaluate.group_scores import Score
from gaga_core.export.export import export_objects_stage
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.bank_file import load_bank, save_bank
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.io.cameras.cameras_json import read_cameras_json, write_cameras_json
from gaga_core.io.cameras.colmap import read_colmap, write_colmap
from gaga_core.io.folder.scene_folder import AssociateEntry, open_scene_folder, read_report_entry
from gaga_core.io.images import read_rgb
from gaga_core.io.json_file import read_json
from gaga_core.io.masks.label_maps import read_further_labels, read_labels, write_labels
from gaga_core.io.masks.other_programs import MaskList, recognise
from gaga_core.io.splats.splat_files import read_splats, write_splats
from gaga_core.pipeline.place import notes_of, placement_of, read_entry
from gaga_core.progress import run_stage
from gaga_core.scene.edits.history import History
from gaga_core.scene.folders import Folders
from gaga_core.scene.project import open_path_stage, save_project
from gaga_core.scene.scene import Scene
from gaga_core.segmentation.models.catalogue import known_model
from gaga_core.segmentation.models.download import LockedFile, read_lock, write_lock
from gaga_core.segmentation.models.hub import Listing
from gaga_studio.session.settings import Settings, load_settings, save_settings, settings_file
from tests.core.io.ksplat_parts import ksplat
from tests.core.io.mask_forms import FORMS
from tests.core.io.sog_parts import sog_parts, zipped
from tests.scenes import orbit_cameras, random_gaussians


@dataclass(frozen=True)
class Target:
    """A reader: ``make`` writes good files into a folder, ``read`` reads them."""

    make: Callable[[Path], object]
    read: Callable[[Path], object]
    damaged: str = ""  # pattern of the files to damage; "" = all
    is_slow: bool = False  # each reading starts a process: a tenth of the cases


def _splats(suffix: str) -> Target:
    name = f"a{suffix}"
    return Target(
        lambda folder: write_splats(folder / name, _gaussians()),
        lambda folder: _used(read_splats(folder / name)),
    )


def _sog_folder(folder: Path) -> None:
    for name, content in sog_parts().items():
        (folder / name).write_bytes(content)


def _gaussians() -> Gaussians:
    return random_gaussians(300, sh_degree=1)


def _used(gaussians: Gaussians) -> float:
    """Touch every value, so that memory that is not there shows."""
    return sum(float(np.nansum(np.abs(c))) for c in (gaussians.means, gaussians.sh))


def _masks(form: str) -> Target:
    def make(folder: Path) -> None:
        FORMS[form][0](folder / form)

    def read(folder: Path) -> None:
        for load in recognise(folder / form).views.values():
            found = load()
            if isinstance(found, MaskList):
                for mask in found.masks:
                    mask.sum()

    return Target(make, read)


def _bank(folder: Path) -> None:
    log = tuple(Decision(f"{i}.jpg", i, i % 5 + 1, i < 5, 0.3, 0, 0.1, 40) for i in range(60))
    bank = MemoryBank((np.arange(300) % 5 + 1).astype(np.int32), 5, log, preset="paper")
    save_bank(folder / "bank.npz", bank)


def _project(folder: Path) -> None:
    write_splats(folder / "a.ply", _gaussians())
    project = run_stage(open_path_stage(folder / "a.ply"))
    project.scene.labels[:] = np.arange(300) % 7
    project.scene.names = {1: "one", 2: "two"}
    project.scene.folders = Folders.of(("a/b",), {1: "a/b", 3: "c"})
    save_project(project)


def _exported(folder: Path) -> None:
    scene = Scene.of(_gaussians(), np.arange(300, dtype=np.int32) % 4)
    scene.names, scene.colors = {1: "one"}, {2: (1.0, 0.0, 0.5)}
    scene.folders = Folders.of((), {1: "a/b", 3: "c"})
    run_stage(export_objects_stage(scene, folder / "out"))


def _scene_folder(folder: Path) -> None:
    write_colmap(folder / "sparse/0", orbit_cameras(3), np.ones((3, 3)), np.ones((3, 3), np.uint8))
    write_cameras_json(folder / "cameras.json", orbit_cameras(3))
    (folder / "split.json").write_text('{"train": ["000", "002.png"], "test": ["001.png"]}')


def _binary_colmap(folder: Path) -> None:
    import pycolmap

    write_colmap(folder, orbit_cameras(3), np.ones((3, 3)), np.ones((3, 3), np.uint8))
    pycolmap.Reconstruction(str(folder)).write_binary(str(folder))
    for path in folder.glob("*.txt"):
        path.unlink()


def _script(folder: Path) -> None:
    ops: list[dict[str, object]] = [
        {"op": "select", "groups": [1, 2]},
        {"op": "move", "groups": [1], "by": [0.1, 0, 0]},
        {"op": "rotate", "groups": [2], "axis": [0, 0, 1], "degrees": 45},
        {"op": "recolor", "groups": [3], "color": [0.9, 0.1, 0.1], "strength": 0.5},
        {"op": "rename", "groups": [3], "name": "cup"},
        {"op": "transform", "groups": [1], "matrix": np.eye(4)[:3].tolist()},
        {"op": "duplicate", "groups": [2], "by": [1, 0, 0]},
        {"op": "clean", "groups": [1]},
        {"op": "fill", "groups": [1]},
        {"op": "undo", "times": 2},
        {"op": "redo", "times": 1},
        {"op": "delete", "groups": [2]},
    ]
    (folder / "edits.json").write_text(json.dumps(ops))
    recorded = Scene.of(random_gaussians(60, sh_degree=0), (np.arange(60) % 4).astype(np.int32))
    history = History(recorded)
    run_script(recorded, ops[:4], history)
    (folder / "recorded.json").write_text(json.dumps(history.recorded()))


def _run_script(folder: Path) -> None:
    content = [read_json(path, list[object], "") for path in sorted(folder.glob("*.json"))]
    for script in content:
        labels = (np.arange(60) % 4).astype(np.int32)
        run_script(Scene.of(random_gaussians(60, sh_degree=0), labels), script)


def _read_settings(folder: Path) -> None:
    settings_file().parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(folder / "settings.json", settings_file())
    load_settings()


def _make_settings(folder: Path) -> None:
    save_settings(Settings())
    shutil.copyfile(settings_file(), folder / "settings.json")


def _model_lock(folder: Path) -> None:
    listing = Listing(known_model("sam2.1-tiny"), "https://hub", "main", "5c3e", "apache-2.0", ())
    file = LockedFile("config.json", 2, "0" * 64, "git")
    write_lock(folder, listing, "Apache-2.0", "2026-11-22T11:00:00+00:00", [file])


def _write_map(path: Path) -> None:
    labels = (np.arange(600).reshape(20, 30) % 9).astype(np.int32)
    write_labels(path, labels, [labels[::2], labels % 3])


def _report(folder: Path) -> None:
    sfm = {"names": ["a", "b"], "why_out": {"b": "dark"}, "links": [[0, 1, 40]], "notes": ["x"]}
    entries: dict[str, object] = {"reconstruct": {"sfm": {**sfm, "checks": [{"text": "good"}]}}}
    entries |= {"associate": {"mask_folder": "masks/sim", "groups_with_gaussians": 3}}
    (folder / "gaga").mkdir()
    (folder / "gaga" / "report.json").write_text(json.dumps(entries))


def _read_report(folder: Path) -> None:
    entry = read_entry(folder)
    placement_of(entry)
    sfm = entry.get("sfm")
    notes_of(sfm if isinstance(sfm, dict) else {})
    read_report_entry(folder / "gaga" / "report.json", "associate", AssociateEntry)


def _runs(folder: Path) -> None:
    score = InstanceScores(Score(0.5, 0.6, 0.7, 0.5, 3, 4), Score(0.5, 0.6, 0.7, 0.5, 3, 4))
    prompts = PromptScores(0.5, 0.4, {"cup": (0.5, 0.4)})
    runs = [BenchmarkRun(1.0, score, 8, 4, 2.0), BenchmarkRun(0.5, prompts, 4, 4, 2.0, ("a",))]
    write_runs(folder / "runs.json", {"preset": "paper"}, {run.share: run for run in runs})


TARGETS: Mapping[str, Target] = {
    **{f"splats{s}": _splats(s) for s in (".ply", ".compressed.ply", ".splat", ".spz", ".glb")},
    "splats.ksplat": Target(
        lambda f: (f / "a.ksplat").write_bytes(ksplat(2, 1)[0]),
        lambda f: _used(read_splats(f / "a.ksplat")),
    ),
    "splats.sog": Target(
        lambda f: zipped(f / "a.sog", sog_parts()), lambda f: _used(read_splats(f / "a.sog"))
    ),
    "splats in a SOG folder": Target(_sog_folder, read_splats),
    **{f"masks {form}": _masks(form) for form in FORMS},
    "bank": Target(_bank, lambda f: load_bank(f / "bank.npz")),
    "exported objects": Target(
        _exported, lambda f: run_stage(open_path_stage(f / "out")), "out/groups.json"
    ),
    "project": Target(
        _project, lambda f: run_stage(open_path_stage(f / "a.gaga")), "a.gaga/*"
    ),
    "scene folder": Target(_scene_folder, open_scene_folder, is_slow=True),
    "cameras.json": Target(
        lambda f: write_cameras_json(f / "cameras.json", orbit_cameras(3)),
        lambda f: read_cameras_json(f / "cameras.json"),
    ),
    "colmap text": Target(
        lambda f: write_colmap(f, orbit_cameras(3), np.ones((3, 3)), np.ones((3, 3), np.uint8)),
        read_colmap,
        is_slow=True,
    ),
    "colmap binary": Target(_binary_colmap, read_colmap, is_slow=True),
    "label map": Target(lambda f: _write_map(f / "a.png"), lambda f: read_labels(f / "a.png")),
    "further label maps": Target(
        lambda f: _write_map(f / "a.png"), lambda f: read_further_labels(f / "a.png")
    ),
    "photo": Target(lambda f: _write_map(f / "a.png"), lambda f: read_rgb(f / "a.png")),
    "script": Target(_script, _run_script),
    "report": Target(_report, _read_report),
    "benchmark runs": Target(_runs, lambda f: read_runs(f / "runs.json", {"preset": "paper"})),
    "settings": Target(_make_settings, _read_settings),
    "model lock": Target(_model_lock, read_lock),
}  # fmt: skip
