"""Whether CUDA is taken: what a machine without it is told, what is remembered, what may hang."""

import importlib.util
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gaga_core import raster
from gaga_core.cli.files import examine
from gaga_core.cli.main import main
from gaga_core.errors import GagaError
from gaga_core.raster import base, probe
from gaga_core.raster.probe import SelfTest
from tests.app.folders import write_scene


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No verdict is known, none is left behind, and the environment chooses nothing."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path))
    monkeypatch.delenv("GAGA_BACKEND")
    monkeypatch.setattr(probe, "_tried", {})


@pytest.fixture
def promising(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine on which a glance finds nothing missing."""
    monkeypatch.setattr(probe, "find_obstacle", lambda: "")
    monkeypatch.setattr(probe, "machine_key", lambda: "torch=1 gsplat=2")


def answering(monkeypatch: pytest.MonkeyPatch, answer: SelfTest) -> list[bool]:
    """The child's answer; returns a list that grows by ``may_compile`` with every question."""
    asked: list[bool] = []

    def ask(may_compile: bool, seconds: float) -> SelfTest:
        asked.append(may_compile)
        return answer

    monkeypatch.setattr(probe, "_ask_child", ask)
    return asked


def as_child(monkeypatch: pytest.MonkeyPatch, folder: Path, program: str) -> None:
    """Run ``program`` in the child's place."""
    if os.name != "posix":
        pytest.skip("the child is replaced by a shell script")
    (folder / "child.py").write_text(program)
    script = folder / "python"
    script.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{folder / "child.py"}" "$@"\n')
    script.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(script))


def test_a_machine_without_a_driver_draws_on_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probe, "_driver_library", lambda: None)
    assert raster.choose().name == "cpu"
    name, reason = raster.backend_report(wait=False)
    assert (name, reason) == ("cpu", "there is no NVIDIA driver on this machine")
    with pytest.raises(GagaError, match=r"no NVIDIA driver .* Choose the backend cpu\."):
        raster.choose("cuda")


def test_reasons_name_the_first_thing_to_mend(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probe, "_driver_library", object)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert "gsplat is not installed" in probe.find_obstacle()
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    monkeypatch.setattr(probe, "_version", lambda package: "2.13.0+cpu")
    assert "without CUDA" in probe.find_obstacle()
    monkeypatch.setattr(probe, "_version", lambda package: "2.13.0+cu130")
    assert probe.find_obstacle() == ""


def test_choosing_without_cuda_imports_neither_torch_nor_gsplat() -> None:
    program = (
        "import sys; from gaga_core import raster; from gaga_core.raster import probe;"
        "probe._driver_library = lambda: None;"
        "raster.choose(); raster.backend_report();"
        "sys.exit(any(m in sys.modules for m in ('torch', 'gsplat')))"
    )
    environment = {k: v for k, v in os.environ.items() if k != "GAGA_BACKEND"}
    done = subprocess.run([sys.executable, "-c", program], env=environment, check=False)
    assert done.returncode == 0


def test_the_probe_prints_its_verdict() -> None:
    """The real child, on this machine: a line of JSON whatever it finds."""
    command = [sys.executable, "-m", "gaga_core.raster.probe"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = SelfTest(**json.loads(done.stdout.splitlines()[-1]))
    assert found.reason
    assert done.stderr == "" or found.usable
    assert not found.usable or probe.find_obstacle() == ""


def test_torch_of_this_machine_is_asked_by_the_self_test(monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    if torch.cuda.is_available():
        pytest.skip("a CUDA device answers here")
    assert not probe.self_test(may_compile=False).usable
    monkeypatch.setattr(torch.version, "cuda", "13.0")
    found = probe.self_test(may_compile=False)
    assert (found.usable, found.reason, found.final) == (False, "no CUDA device answers", False)


@pytest.mark.usefixtures("promising")
@pytest.mark.parametrize("usable", [True, False])
def test_a_verdict_is_kept_until_something_is_installed_anew(
    usable: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = answering(monkeypatch, SelfTest(usable, "as it is"))
    assert probe.verdict() == probe.verdict(wait=False) == SelfTest(usable, "as it is")
    assert asked == [False]
    assert probe.cache_file().is_file()
    monkeypatch.setattr(probe, "machine_key", lambda: "torch=2 gsplat=2")
    assert not probe.verdict(wait=False).usable
    assert asked == [False]
    assert probe.verdict().usable == usable
    assert asked == [False, False]
    probe.verdict(fresh=True)
    assert len(asked) == 3


@pytest.mark.usefixtures("promising")
def test_an_answer_that_may_change_is_not_kept_on_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor asked twice in one process, unless the person asks for CUDA by name."""
    asked = answering(monkeypatch, SelfTest(False, "not compiled", final=False))
    for _ in range(3):
        assert raster.choose().name == "cpu"
    assert asked == [False]
    assert not probe.cache_file().exists()
    with pytest.raises(GagaError, match="not compiled"):
        raster.choose("cuda")
    assert asked == [False, True]


@pytest.mark.usefixtures("promising")
def test_a_damaged_or_locked_cache_is_no_obstacle(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = answering(monkeypatch, SelfTest(True, "a device"))
    probe.cache_file().parent.mkdir(parents=True)
    for damaged in ("", "[1]", '{"key": "torch=1 gsplat=2"}', '{"key": 1, "verdict": {"a": 1}}'):
        probe.cache_file().write_text(damaged)
        assert probe.verdict(wait=False).usable == bool(asked)
        assert probe.verdict().usable
        monkeypatch.setattr(probe, "_tried", {})
        asked.clear()
    probe.cache_file().unlink()
    probe.cache_file().mkdir()  # cannot be written
    assert probe.verdict().usable


@pytest.mark.usefixtures("promising")
def test_a_self_test_that_hangs_ends_in_time_with_its_children(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A compiler that the child started must not live on, nor keep us waiting."""
    mark = tmp_path / "pid"
    as_child(
        monkeypatch,
        tmp_path,
        "import pathlib, subprocess, time\n"
        "compiler = subprocess.Popen(['sleep', '60'])\n"
        f"pathlib.Path({str(mark)!r}).write_text(str(compiler.pid))\n"
        "time.sleep(60)\n",
    )
    monkeypatch.setattr(probe, "QUICK_SECONDS", 1.0)
    start = time.monotonic()
    found = probe.verdict()
    assert time.monotonic() - start < 10
    assert (found.usable, found.final) == (False, False)
    assert found.reason == "the self-test did not finish within 1 s"
    assert mark.is_file()
    assert _has_ended(int(mark.read_text()))


def _has_ended(pid: int) -> bool:
    for _ in range(50):
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
        except OSError:
            return True
        if state == "Z":  # killed, and nobody has asked for its status yet
            return True
        time.sleep(0.05)
    return False


@pytest.mark.usefixtures("promising")
@pytest.mark.parametrize(
    ("program", "reason"),
    [
        ("raise RuntimeError('nvcc is broken')", "the self-test failed: RuntimeError: nvcc is br"),
        ("import os; os.kill(os.getpid(), 11)", "the self-test failed: exit status -11"),
        ("print('building'); print('{\"usable\": 1}')", "the self-test failed: exit status 0"),
    ],
)
def test_a_self_test_that_breaks_says_how(
    program: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    as_child(monkeypatch, tmp_path, program)
    found = probe.verdict()
    assert not found.usable
    assert found.reason.startswith(reason)
    assert raster.choose().name == "cpu"


@pytest.mark.usefixtures("promising")
def test_what_the_child_prints_before_its_verdict_is_skipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = '{"usable": true, "reason": "NVIDIA X", "final": true}'
    as_child(monkeypatch, tmp_path, f"print('gsplat: compiling'); print('{answer}')")
    assert raster.backend_report() == ("cuda", "NVIDIA X")


@pytest.mark.usefixtures("promising")
def test_cuda_that_was_there_yesterday_falls_back(monkeypatch: pytest.MonkeyPatch) -> None:
    answering(monkeypatch, SelfTest(True, "a device"))

    def gone() -> base.Rasterizer:
        raise GagaError("No CUDA device answers. Choose the backend cpu.")

    monkeypatch.setattr(raster, "_cuda", gone)
    assert raster.choose().name == "cpu"
    with pytest.raises(GagaError, match="No CUDA device"):
        raster.choose("cuda")


@pytest.mark.usefixtures("promising")
def test_the_environment_may_choose(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = answering(monkeypatch, SelfTest(True, "a device"))
    monkeypatch.setenv("GAGA_BACKEND", "cpu")
    assert raster.choose().name == "cpu"
    assert raster.backend_report() == ("cpu", "GAGA_BACKEND says so")
    assert asked == []
    assert raster.choose("reference").name == "reference"


def test_doctor_says_who_draws_and_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probe, "_driver_library", lambda: None)
    finding = next(f for f in examine() if f.name == "rasterizer")
    assert finding.text == "cpu (cuda: there is no NVIDIA driver on this machine)"
    assert finding.ok


def test_commands_take_a_backend(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(probe, "_driver_library", lambda: None)
    write_scene(tmp_path / "scene")
    arguments = ["render", str(tmp_path / "scene"), "--what", "depth", "--out", str(tmp_path / "d")]
    assert main([*arguments, "--backend", "cuda"]) == 1
    assert "CUDA cannot draw here: there is no NVIDIA driver" in capsys.readouterr().err
    assert not (tmp_path / "d").exists()
    for backend in ("auto", "cpu"):
        assert main([*arguments, "--backend", backend]) == 0
    assert list((tmp_path / "d").glob("*.png"))


def test_without_a_device_or_gsplat_the_backend_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    from gaga_core.raster.cuda import CudaRasterizer

    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(GagaError, match="gsplat cannot be loaded"):
        CudaRasterizer("cpu")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(GagaError, match="No CUDA device answers"):
        CudaRasterizer()
