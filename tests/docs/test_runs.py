"""What pages and examples show runs: Python, edit scripts, and the options of commands."""

import io
import json
import os
import re
import subprocess
import sys
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path

import msgspec
import pytest

from gaga_core.cli.main import main
from gaga_core.edit_script import run_script
from gaga_core.edit_script.operations import OPERATION_TYPES
from gaga_core.progress import run_stage
from gaga_core.scene.project import open_path_stage
from tests.docs.pages import DOCS, PAGES, ROOT, code_blocks, tables

_ARGUMENTS = {
    "list_objects": ["SCENE"],
    "isolate_object": ["SCENE", "1", "one.ply"],
    "compare_presets": ["SCENE"],
    "own_masks": ["SCENE"],
}


def test_the_python_of_the_page_on_scripting_runs_from_top_to_bottom(workplace: Path) -> None:
    names: dict[str, object] = {}
    for block in code_blocks(DOCS / "scripting.md", "python"):
        exec(compile(block, "scripting.md", "exec"), names)  # noqa: S102  it is ours
    assert (workplace / "edited.ply").is_file()
    assert (workplace / "SCENE" / "gaga" / "project.json").is_file()


def test_the_edit_scripts_of_the_pages_run(workplace: Path) -> None:
    for script in (json.loads(block) for page in PAGES for block in code_blocks(page, "json")):
        scene = run_stage(open_path_stage(workplace / "SCENE")).scene
        titles = run_script(scene, script)
        assert len(titles) == len(script), "every operation changes something"


@pytest.mark.parametrize("example", sorted(_ARGUMENTS))
def test_an_example_runs(example: str, workplace: Path) -> None:
    file = DOCS / "examples" / f"{example}.py"
    done = subprocess.run(
        [sys.executable, str(file), *_ARGUMENTS[example]],
        cwd=workplace,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


def test_every_example_is_run() -> None:
    assert {file.stem for file in (DOCS / "examples").glob("*.py")} == set(_ARGUMENTS)


def test_every_operation_of_edit_scripts_is_listed_with_its_fields() -> None:
    listed = {}
    for heading in (
        "Operations on objects",
        "Operations on folders and parents",
        "Operations on regions and whole scenes",
    ):
        for cells in tables(DOCS / "scripting.md")[heading]:
            listed[cells[0].strip("`")] = tuple(set(re.findall(r"`(\w+)`", c)) for c in cells[1:3])
    assert set(listed) == set(OPERATION_TYPES)
    for name, kind in OPERATION_TYPES.items():
        required = {field.encode_name for field in msgspec.structs.fields(kind) if field.required}
        assert listed[name] == (required, set(kind.__struct_encode_fields__) - required), name


@cache
def _help(command: str) -> str:
    """The help of a command, and of its actions ("gaga models get") where it has some."""
    text = _printed(command, "--help")
    actions = re.search(r"\{([a-z,]+)\}\n", text)
    if actions is None:
        return text
    return text + "".join(_printed(command, name, "--help") for name in actions[1].split(","))


def _printed(*arguments: str) -> str:
    out = io.StringIO()
    with redirect_stdout(out), pytest.raises(SystemExit):
        main(list(arguments))
    return out.getvalue()


def test_every_command_and_option_that_a_page_names_exists() -> None:
    """Options in code blocks are followed to the end of their line or their continuation."""
    seen = set()
    for page in PAGES:
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        for line in re.findall(r"\bgaga [a-z]+[^\n`·]*", text):
            command = line.split()[1]
            if command not in _commands():
                continue
            seen.add(command)
            for option in re.findall(r"(?<!\S)--[a-z][a-z-]*", line):
                assert re.search(rf"{option}(?![\w-])", _help(command)), f"{page.name}: {line}"
    assert seen == _commands(), "every command is described somewhere"


@cache
def _commands() -> frozenset[str]:
    out = io.StringIO()
    with redirect_stdout(out), pytest.raises(SystemExit):
        main(["--help"])
    found = re.search(r"\{([a-z,\s]+)\}", out.getvalue())
    assert found is not None
    return frozenset(re.sub(r"\s", "", found.group(1)).split(","))
