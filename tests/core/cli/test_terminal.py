"""Names that a file brings give a terminal no commands, and no page of one line."""

import json
import logging
import os
import re
import sys
import unicodedata
from contextlib import suppress
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from gaga_core.cli.main import main
from gaga_core.errors import LONGEST_LINE, PlainFormatter
from gaga_core.io.cameras.colmap import write_colmap
from gaga_core.io.images import write_rgb
from gaga_core.io.masks.label_maps import write_labels
from gaga_core.io.splats.ply import write_ply
from gaga_core.progress import Progress, Stage, run_stage, show_stage
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.scene.folders import Folders
from gaga_core.scene.project import open_path_stage, save_project
from tests.core.cli.calls import Capture
from tests.core.grouping.true_masks import true_map
from tests.scenes import objects_scene

BAD = "\x1b]0;x\x07\x9b2J\u202e\x7f\r\ngaga: forged [red]:bomb:"
LONG = "x" * 100_000
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="files cannot have such names")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene folder where the folder, photos, masks and a script have such names."""
    base, scene = tmp_path_factory.mktemp("terminal"), objects_scene(3, 60, n_cameras=4)
    root, raster = base / f"scene{BAD}", CpuRasterizer()
    cameras = [replace(c, name=f"{BAD}{i}.png") for i, c in enumerate(scene.cameras)]
    for folder in ("images", f"masks/{BAD}", "masks/other", "sparse/0"):
        (root / folder).mkdir(parents=True)
    for camera in cameras:
        write_rgb(root / "images" / camera.name, raster.render(scene.gaussians, camera).image)
        write_labels(root / f"masks/{BAD}" / camera.name, true_map(scene, camera))
        write_labels(root / "masks/other" / f"q{camera.name}", true_map(scene, camera))
    points = scene.gaussians.means[::7].astype(np.float64)
    write_colmap(root / "sparse/0", cameras, points, np.full((len(points), 3), 128, np.uint8))
    write_ply(root / "point_cloud.ply", scene.gaussians)
    (base / "script.json").write_text(json.dumps([{"op": BAD + LONG}]))
    return root


@pytest.fixture(scope="module")
def project(place: Path) -> Path:
    """A project whose groups and folders have such names."""
    project = run_stage(open_path_stage(place / "point_cloud.ply"))
    project.scene.labels[:] = np.arange(len(project.scene)) % 4
    project.scene.names |= {1: BAD, 2: LONG, 3: BAD + LONG}
    project.scene.folders = Folders.of([BAD, LONG], {1: BAD})
    return save_project(project, place.parent / "project.gaga")


_COMMANDS = (
    "info ROOT", "info PROJECT", "query PROJECT object", "query PROJECT BAD", "query PROJECT LONG",
    "associate ROOT", "associate ROOT --masks ROOT/masks/BAD", "associate ROOT --masks BAD",
    "associate ROOT --masks ROOT/masks/other", "lift ROOT", "info ROOT", "render ROOT --views BAD",
    "render ROOT --out OUT", "evaluate --pred OUT --gt ROOT/masks/BAD", "run ROOT",
    "compare ROOT --gt ROOT/masks/other", "masks ROOT --list", "masks ROOT --views BAD",
    "edit PROJECT OUT.ply SCRIPT", "export PROJECT --out OUT/BAD.ply", "lod ROOT",
    "export PROJECT --out OUT/objects --what objects", "export PROJECT --out OUT/p --folder BAD",
    "export ROOT --out OUT/masks --what masks", "segment ROOT --click BAD,1,1", "info LONG",
    "reconstruct LONG OUT/new", "benchmark replica ROOT", "models get BAD", "models where LONG",
    "models get --lock SCRIPT", "BAD", "info ROOT --BAD", "render ROOT --fps BAD",
)  # fmt: skip


@pytest.mark.parametrize("command", _COMMANDS)
def test_names_of_files_give_a_terminal_no_commands(
    command: str, place: Path, project: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    words = {"ROOT": str(place), "PROJECT": str(project), "OUT": str(place.parent / "out")}
    words |= {"SCRIPT": str(place.parent / "script.json"), "BAD": BAD, "LONG": LONG}
    of_word = re.compile("|".join(words))
    arguments = [of_word.sub(lambda found: words[found[0]], word) for word in command.split()]
    status = None
    with suppress(SystemExit):
        status = main(arguments)
    captured = capfd.readouterr()
    for said in (captured.out, captured.err):
        lines = said.split("\n")
        assert [c for c in "".join(lines) if unicodedata.category(c) in ("Cc", "Cf", "Cs")] == []
        assert max(map(len, lines)) <= LONGEST_LINE
        assert not any(line.startswith("gaga: forged") for line in lines)
    assert "Traceback" not in captured.err
    assert "Warning:" not in captured.err
    assert status is not None or "\u2500" in captured.err, "a sentence, or the usage"


def test_values_for_machines_are_whole(project: Path, capsys: Capture) -> None:
    assert main(["info", str(project), "--json"]) == 0
    said = capsys.readouterr().out
    assert said.replace("\n", "").isprintable()
    names = {entry["name"] for entry in json.loads(said)["objects"]}
    assert {BAD, LONG, BAD + LONG} <= names


def test_progress_and_the_log_give_no_commands_either() -> None:
    def stage() -> Stage[None]:
        yield Progress(f"a {BAD}", 1, 2, BAD + LONG)

    file = StringIO()
    show_stage(stage(), Console(file=file, force_terminal=True, width=300))
    assert "\x1b]" not in file.getvalue()
    assert not {"\x9b", "\u202e", "\x07"} & set(file.getvalue())
    record = logging.LogRecord("", 0, "", 0, "%s", (BAD + LONG,), None)
    said = PlainFormatter("gaga: %(message)s").format(record)
    assert said.isprintable()
    assert len(said) <= LONGEST_LINE


def test_what_the_output_has_no_code_for_is_escaped(project: Path) -> None:
    """Such as a name in Japanese where the terminal is set to ASCII."""
    import subprocess

    code = "from gaga_core.cli.output import *; prepare_streams(); line('日本'); table([['日本']])"
    said = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert said.startswith("\\u65e5\\u672c\n")
