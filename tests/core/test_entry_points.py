"""What packages above the core register with it: kernels for the cache, probes for the doctor."""

import importlib.util
import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
_KERNELS = (
    "import gaga_core.kernels as k, json, sys;"
    "print(json.dumps([k._DIGEST, [str(p) for p in k.kernel_packages()], 'above' in sys.modules]))"
)
_DOCTOR = (
    "import json; from gaga_core.cli.files import _registered;"
    "print(json.dumps([[f.name, f.text, f.ok] for f in _registered()]))"
)


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A folder of packages with one, ``above``, that registers kernels and probes."""
    (tmp_path / "above").mkdir()
    (tmp_path / "above" / "__init__.py").write_text("")
    (tmp_path / "above" / "add_kernels.py").write_text("A = 1\n")
    said = 'import json, os\nprint(json.dumps({"ok": False, "text": "broken"}), flush=True)\n'
    (tmp_path / "above" / "crash.py").write_text(said + "os.abort()\n")
    (tmp_path / "above" / "fine.py").write_text(
        said + 'print(json.dumps({"ok": True, "text": "all is well"}))\n'
    )
    (tmp_path / "above" / "mute.py").write_text("")
    info = tmp_path / "above-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: above\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[gaga_core.kernels]\nabove = above\ngone = no_such_package\n"
        "[gaga_core.probes]\nzz_crash = above.crash\nzz_fine = above.fine\nzz_mute = above.mute\n"
    )
    return tmp_path


def run_in(site: Path, code: str) -> list[object]:
    """What ``code`` prints in a Python that finds the packages of ``site``."""
    path = os.pathsep.join([str(site), str(ROOT), str(ROOT / "app")])
    environment = {**os.environ, "PYTHONPATH": path}
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def test_registered_kernels_name_the_cache_and_are_not_imported(site: Path) -> None:
    digest, folders, is_imported = run_in(site, _KERNELS)
    assert str(site / "above") in folders  # type: ignore[operator]
    assert not is_imported
    (site / "above" / "add_kernels.py").write_text("A = 2\n")
    changed = run_in(site, _KERNELS)[0]
    assert changed != digest, "code that was compiled from another source is never run"
    (site / "above" / "other.py").write_text("A = 3\n")
    assert run_in(site, _KERNELS)[0] == changed, "only kernels count"


def test_the_doctor_tells_what_probes_say_even_when_one_crashes(site: Path) -> None:
    found = run_in(site, _DOCTOR)
    assert ["zz_crash", "broken", False] in found
    assert ["zz_fine", "all is well", True] in found
    assert ["zz_mute", "no answer", False] in found


def test_the_window_registers_its_kernels_and_opengl() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    points = project["entry-points"]
    assert points["gaga_core.kernels"] == {"window": "gaga_studio"}
    assert points["gaga_core.probes"] == {"opengl": "gaga_studio.gpu.probe"}
    assert importlib.util.find_spec(points["gaga_core.probes"]["opengl"]) is not None


@pytest.mark.gl
def test_the_probe_of_opengl_ends_with_the_driver() -> None:
    command = [sys.executable, "-m", "gaga_studio.gpu.probe"]
    path = os.pathsep.join([str(ROOT), str(ROOT / "app")])
    done = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=True
    )
    first, last = (json.loads(line) for line in done.stdout.splitlines())
    assert not first["ok"]
    assert "install a graphics driver" in first["text"]
    assert last["ok"]
    assert "·" in last["text"]
