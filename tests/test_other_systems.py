"""What Windows lacks is not asked for when a module is imported, of the program or of the tests.

What runs on other machines, the workflow and the hooks before a commit, names only what is there.
"""

import os
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest
import yaml

_ROOT = Path(__file__).resolve().parents[1]

_CHILD = """
import importlib, multiprocessing, os, signal, sys
from multiprocessing import context, reduction
from pathlib import Path
import asyncio, dask.distributed, numba, PIL.Image, psutil, pytest, scipy.spatial, torch
for name in ("fcntl", "grp", "pty", "pwd", "resource", "termios"):
    sys.modules[name] = None
for name in ("fork", "getuid", "killpg", "mkfifo", "sched_getaffinity", "setsid", "sysconf"):
    delattr(os, name)
for name in ("SIGALRM", "SIGKILL", "SIGSTOP", "SIGUSR1", "SIGXFSZ"):
    delattr(signal, name)
for name in ("ForkContext", "ForkProcess", "ForkServerContext", "ForkServerProcess"):
    delattr(context, name)
reduction.HAVE_SEND_HANDLE = False  # what a fork server needs
for name in ("fork", "forkserver"):
    del context._concrete_contexts[name]
failed = []
for folder, package in (("gaga_core",) * 2, ("app/gaga_studio", "gaga_studio"), ("tests",) * 2):
    for file in sorted(Path(folder).rglob("*.py")):
        parts = file.relative_to(folder).with_suffix("").parts
        if parts[-1] == "__main__":
            continue
        name = ".".join((package, *parts)).removesuffix(".__init__")
        try:
            importlib.import_module(name)
        except (Exception, pytest.skip.Exception) as error:
            if not isinstance(error, pytest.skip.Exception):
                failed.append(f"{name}: {type(error).__name__}: {error}")
sys.exit("\\n".join(failed) or 0)
"""


def test_every_module_is_imported_without_what_windows_lacks() -> None:
    """Those of the program and those of the tests, which must be collected there."""
    child = [sys.executable, "-c", _CHILD]
    done = subprocess.run(child, cwd=_ROOT, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_workflow_and_hooks_name_only_what_is_there() -> None:
    workflow = yaml.safe_load((_ROOT / ".github/workflows/test.yml").read_text(encoding="utf-8"))
    steps = [step for job in workflow["jobs"].values() for step in job["steps"]]
    words = [word for step in steps for word in step.get("run", "").split()]
    paths = [word for word in words if word.startswith(("tests/", ".ci/")) or ".txt" in word]
    assert len(paths) > 5
    assert [path for path in paths if not (_ROOT / path).exists()] == []
    targets = re.findall(r"^([\w-]+):", (_ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
    made = [goal for word, goal in pairwise(words) if word == "make"]
    assert made
    assert set(made) <= set(targets)

    config = yaml.safe_load((_ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    hooks = [hook for repository in config["repos"] for hook in repository["hooks"]]
    tools = Path(sys.executable).parent
    files = [
        p for name in ("app", "gaga_core", "tests", "tools") for p in (_ROOT / name).rglob("*.py")
    ]
    files += [*_ROOT.glob("*.toml"), *_ROOT.glob(".*.yaml"), _ROOT / "Makefile"]
    lines = [line for file in files for line in file.read_bytes().splitlines(keepends=True)]
    assert len(lines) > 1000
    for hook in hooks:
        if hook["language"] == "pygrep":
            found = re.compile(hook["entry"].encode())
            assert [line for line in lines if found.search(line)] == [], hook["id"]
        else:
            folder, _, tool = hook["entry"].split()[0].rpartition("/")
            assert folder == ".venv/bin"
            assert list(tools.glob(f"{tool}*")), tool


@pytest.mark.skipif(sys.platform != "linux", reason="system packages of Debian")
def test_a_library_that_is_there_is_not_asked_for(tmp_path: Path) -> None:
    """A long list of libraries was read to the first hit, and its writer's failure counted."""
    listed = tmp_path / "ldconfig"
    script = (_ROOT / ".ci" / "system-libraries").read_text(encoding="utf-8")
    names = [name.replace("\\", "") for name in re.findall(r"has '(.+?)'", script)]
    assert "libX11.so.6" in names
    lines = "\n".join([*names, *(f"libother{i}.so" for i in range(20_000))])
    listed.write_text(f"#!/bin/sh\ncat <<'END'\n{lines}\nEND\n", encoding="utf-8")
    asked = tmp_path / "apt-get"
    asked.write_text('#!/bin/sh\necho "$@"\nexit 1\n', encoding="utf-8")
    for command in (listed, asked):
        command.chmod(0o755)
    done = subprocess.run(
        [_ROOT / ".ci" / "system-libraries", "window"],
        env=os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHON": sys.executable},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
