"""``gaga doctor``: what this machine can do, and what to install where something is missing."""

import importlib.metadata
import json
import platform
import subprocess
import sys
from dataclasses import dataclass

from gaga_core.errors import GagaError
from gaga_core.io.ffmpeg import ffmpeg_program
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
            findings.append(Finding(package, "missing: install gaga-studio again with pip", False))
    findings.append(_ffmpeg())
    findings += [_extra(*extra) for extra in _EXTRAS]
    findings.append(_opengl())
    findings.append(_cuda())
    findings.append(_rasterizer())
    return findings


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


def _opengl() -> Finding:
    """Ask the driver in a process of its own: a broken one may crash."""
    answer = _probe("-m", "gaga_studio.gpu.probe")
    if answer is None:
        text = "no OpenGL 3.3 context: install a graphics driver (on Debian: libgl1 libegl1)"
        return Finding("opengl", text, False)
    return Finding("opengl", f"{answer['version']} · {answer['renderer']}", True)


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
    """Who draws; asked again, since a person runs this after fixing something."""
    name, reason = backend_report(fresh=True)
    return Finding("rasterizer", f"{name} ({'' if name == 'cuda' else 'cuda: '}{reason})", True)


def _probe(*arguments: str) -> dict[str, str] | None:
    try:
        done = subprocess.run(
            [sys.executable, *arguments],
            capture_output=True,
            text=True,
            timeout=_PROBE_SECONDS,
            check=True,
        )
        answer: dict[str, str] = json.loads(done.stdout.splitlines()[-1])
    except (subprocess.SubprocessError, OSError, ValueError, IndexError):
        return None
    return answer
