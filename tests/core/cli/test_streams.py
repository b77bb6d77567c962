"""Where the results of ``gaga`` go: a pipe that its reader closes, a disk that is full."""

import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from gaga_core.io.splats.ply import write_ply
from tests.scenes import random_gaussians


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of splats."""
    path = tmp_path_factory.mktemp("streams") / "scene.ply"
    write_ply(path, random_gaussians(50))
    return path


@pytest.mark.parametrize(
    ("arguments", "closed", "other"),
    [
        (["--help"], "stdout", "stderr"),
        (["info", "{scene}"], "stdout", "stderr"),
        (["info", "nowhere"], "stderr", "stdout"),
    ],
)
def test_a_reader_that_closes_the_pipe_ends_the_command_quietly(
    scene: Path, arguments: list[str], closed: str, other: str
) -> None:
    """`gaga --help | head` printed a traceback."""
    process = subprocess.Popen(
        [sys.executable, "-m", "gaga_core.cli.main", *(a.format(scene=scene) for a in arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    getattr(process, closed).close()
    assert getattr(process, other).read() == ""
    assert process.wait(timeout=60) == 141


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_results_on_a_full_disk_are_one_sentence() -> None:
    """`gaga info SCENE --json > FILE` printed a traceback there."""
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "gaga_core.cli.main", "--help"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=60,
            check=False,
        )
    assert done.returncode == 1
    assert done.stderr == "gaga: The disk is full: not all results were written. Free some space.\n"


@pytest.mark.skipif(sys.platform == "win32", reason="no such redirection")
@pytest.mark.parametrize(
    ("closed", "call", "status"),
    [(">&-", "info {scene}", 0), ("2>&-", "info nowhere", 1), (">&- 2>&-", "info {scene}", 0)],
)
def test_streams_that_are_closed_from_the_start_end_no_command(
    scene: Path, closed: str, call: str, status: int
) -> None:
    """`gaga info SCENE >&-` printed a traceback."""
    command = shlex.join([sys.executable, "-m", "gaga_core.cli.main"])
    done = subprocess.run(
        ["sh", "-c", f"{command} {call.format(scene=shlex.quote(str(scene)))} {closed}"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == status
    assert "Traceback" not in done.stderr
    if status and "2>" not in closed:
        assert done.stderr.startswith("gaga: ")
    if not status and not closed.startswith(">"):
        assert "gaussians" in done.stdout
