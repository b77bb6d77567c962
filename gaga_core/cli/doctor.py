"""``gaga doctor``: what this machine can do, and what to install where something is missing."""

import importlib.metadata
import platform
import subprocess
import sys
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path

from gaga_core.errors import GagaError
from gaga_core.io.ffmpeg import ffmpeg_program
from gaga_core.io.json_file import decode_json
from gaga_core.kernels import n_threads
from gaga_core.raster import backend_report

_PACKAGES = ("numpy", "numba", "scipy", "moderngl", "imgui-bundle", "glfw", "pycolmap", "torch")
_PROBE_SECONDS = 60
_EXTRAS = (  # package, the extra that brings it, what it is for
    ("transformers", "models", "masks by SAM and other models, search by words"),
    ("distributed", "executors", "many scenes at once with --executor dask"),
)


@dataclass(frozen=True)
class Finding:
    """One line of the report."""

    name: str
    text: str
    ok: bool


def examine() -> list[Finding]:
    """Look at Python, packages, graphics and compute; never raises."""
    findings = [
        Finding("python", f"{platform.python_version()} on {platform.platform()}", True),
        Finding("processor", f"{n_threads()} threads for the kernels", True),
    ]
    for package in _PACKAGES:
        try:
            findings.append(Finding(package, importlib.metadata.version(package), True))
        except importlib.metadata.PackageNotFoundError:
            findings.append(_missing(package))
    findings.append(_ffmpeg())
    findings += [_extra(*extra) for extra in _EXTRAS]
    findings += _registered()
    findings.append(_cuda())
    findings.append(_rasterizer())
    return findings


def _missing(package: str) -> Finding:
    """A package that is not there; the program of `make app` comes without torch."""
    if package == "torch" and getattr(sys, "frozen", False):
        where = Path(sys.executable).parent / "models"
        text = f"not installed (masks and words by models, CUDA): put its folder at {where}"
        return Finding(package, text, True)
    return Finding(package, "missing: install gaga-studio again with pip", False)


def _ffmpeg() -> Finding:
    """The program that reads and writes videos."""
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
        text = f"not installed ({purpose}): pip install 'gaga-studio[{extra}]'"
        return Finding(name, text, True)


def _registered() -> list[Finding]:
    """What other packages ask of the machine (entry points of the group ``gaga_core.probes``).

    Each is a module that prints a line of JSON with ``ok`` and ``text``; the last line counts, so
    that one which may crash says first what a crash means. It runs in a process of its own.
    """
    findings = []
    for entry in sorted(entry_points(group="gaga_core.probes"), key=lambda entry: entry.name):
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


def _rasterizer() -> Finding:
    """The rasterizer in use, tested again: a user runs this after fixing something."""
    name, reason = backend_report(fresh=True)
    return Finding("rasterizer", f"{name} ({'' if name == 'cuda' else 'cuda: '}{reason})", True)


def _probe(*arguments: str) -> dict[str, str | bool] | None:
    """The last line that a Python process prints, from JSON; None when it prints none."""
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
