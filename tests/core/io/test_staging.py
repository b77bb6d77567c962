"""Results of several files: all of them, also when their program was killed while it moved them."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write, remove_leftovers
from gaga_core.io.folder.staging import finish_publishing, publish_all, staging_folder

_NAMES = ["maps", "bank.npz", "deep/er/report.json"]


def _results(staging: Path, content: str) -> None:
    for name in ("maps/a.png", "maps/b.png", "bank.npz", "deep/er/report.json"):
        (staging / name).parent.mkdir(parents=True, exist_ok=True)
        (staging / name).write_text(content)


def _write_results(target: Path) -> None:
    with staging_folder(target) as staging:
        _results(staging, "new")
        publish_all(staging, _NAMES, target)


def _contents(target: Path) -> dict[str, str]:
    files = [path for path in target.rglob("*") if path.is_file()]
    return {str(path.relative_to(target)): path.read_text() for path in files}


@pytest.mark.parametrize("n_moved", range(len(_NAMES) + 1))
def test_a_plan_that_was_cut_off_is_finished(tmp_path: Path, n_moved: int) -> None:
    target, left = tmp_path / "it", tmp_path / "it" / ".gaga-abcd1234"
    _results(target, "old")
    _results(left, "new")
    (left / "publish.json").write_text(json.dumps(_NAMES))
    for name in _NAMES[:n_moved]:
        if (target / name).is_dir():
            (target / name).rename(left / f"{name}.old")
        (left / name).rename(target / name)
    for path in [left, *left.rglob("*")]:
        os.utime(path, (1e9, 1e9))
    assert remove_leftovers(target) == 0  # though it is old
    assert finish_publishing(target) == 1
    assert set(_contents(target).values()) == {"new"}
    assert len(_contents(target)) == 4
    assert not left.exists()
    assert finish_publishing(target) == 0


@pytest.mark.parametrize("name", ["../out", "/tmp/out", "a/../../out", ""])
def test_a_plan_that_leads_out_of_its_folder_moves_nothing(tmp_path: Path, name: str) -> None:
    target, left = tmp_path / "it", tmp_path / "it" / ".gaga-abcd1234"
    _results(left, "new")
    (target / "out").write_text("inside")
    (left / "publish.json").write_text(json.dumps(["bank.npz", name]))
    before = _contents(tmp_path)
    assert finish_publishing(target) == 0
    assert _contents(tmp_path) == before


def test_the_next_results_come_after_those_that_were_cut_off(tmp_path: Path) -> None:
    left = tmp_path / ".gaga-abcd1234"
    _results(left, "cut off")
    (left / "publish.json").write_text(json.dumps(_NAMES))
    with staging_folder(tmp_path) as staging:
        assert (tmp_path / "bank.npz").read_text() == "cut off"
        (staging / "bank.npz").write_text("next")
        publish_all(staging, ["bank.npz"], tmp_path)
    assert (tmp_path / "bank.npz").read_text() == "next"
    assert (tmp_path / "maps" / "a.png").read_text() == "cut off"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bank.npz", "deep", "maps"]


@pytest.mark.skipif(sys.platform == "win32", reason="a lock file does it there")
def test_one_program_moves_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import fcntl

    monkeypatch.setattr("gaga_core.io.folder.staging._PATIENCE_S", 0.1)
    other = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(other, fcntl.LOCK_EX)
    with pytest.raises(GagaError, match="Another program"):
        _write_results(tmp_path)
    assert list(tmp_path.iterdir()) == []
    os.close(other)
    _write_results(tmp_path)
    assert len(_contents(tmp_path)) == 4


# --- What a kill leaves is removed at the next start; long names work; children end with parents.


_LEAVE = """
import sys, time
from pathlib import Path
from gaga_core.io.files import atomic_write
from gaga_core.io.folder.staging import staging_folder
target = Path(sys.argv[1])
with staging_folder(target) as staging, atomic_write(target / "a.ply") as temporary:
    temporary.write_bytes(b"half")
    (staging / "half.png").write_bytes(b"half")
    print("writing", flush=True)
    time.sleep(600)
"""
_WRITE = """
import sys
from pathlib import Path
from gaga_core.io.files import atomic_write
with atomic_write(Path(sys.argv[1]) / "b.ply") as temporary:
    temporary.write_bytes(b"whole")
"""
_CHILD = """
import sys, time
from gaga_core.io.folder.processes import end_with_parent
end_with_parent()
print("up", flush=True)
sys.stdout.close()
exec("while True: pass") if sys.argv[1] == "busy" else time.sleep(600)
"""
_PARENT = f"""
import subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", {_CHILD!r}, sys.argv[1]], stdout=subprocess.PIPE)
child.stdout.readline()
print(child.pid, flush=True)
time.sleep(600)
"""


def _age(folder: Path) -> None:
    for path in [*folder.rglob("*"), *folder.rglob(".*")]:
        os.utime(path, (1e9, 1e9))


def test_a_killed_program_leaves_nothing_for_ever(tmp_path: Path) -> None:
    target = tmp_path / "out"
    with subprocess.Popen(
        [sys.executable, "-c", _LEAVE, str(target)], stdout=subprocess.PIPE, text=True
    ) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "writing\n"
        program.send_signal(signal.SIGKILL)
    assert len(list(target.iterdir())) == 2
    (target / ".mine.part").write_text("of another program")
    (target / ".gaga-notes").mkdir()
    assert remove_leftovers(target) == 0  # they may still be written to
    _age(target)
    subprocess.run([sys.executable, "-c", _WRITE, str(target)], check=True)
    names = {path.name for path in target.iterdir()}
    assert names == {"b.ply", ".mine.part", ".gaga-notes"}


def test_a_folder_that_is_written_to_is_not_left_over(tmp_path: Path) -> None:
    with staging_folder(tmp_path) as staging:
        (staging / "old.png").write_bytes(b"")
        _age(tmp_path)
        (staging / "new.png").write_bytes(b"")
        assert remove_leftovers(tmp_path) == 0
        assert staging.exists()


@pytest.mark.parametrize("name", ["n" * 250 + ".ply", "ü" * 120 + ".ply"])
def test_the_longest_names_are_written(tmp_path: Path, name: str) -> None:
    with atomic_write(tmp_path / name) as temporary:
        temporary.write_bytes(b"whole")
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_name_that_is_too_long_is_a_sentence(tmp_path: Path) -> None:
    with (
        pytest.raises(GagaError, match="too long"),
        atomic_write(tmp_path / ("n" * 300)) as temporary,
    ):
        temporary.write_bytes(b"whole")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a busy child ends when it may")
@pytest.mark.parametrize("what", ["busy", "asleep"])
def test_children_end_with_their_parent(what: str) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", _PARENT, what], stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        assert psutil.pid_exists(child)
        parent.send_signal(signal.SIGKILL)
    end = time.monotonic() + 10
    while _runs(child) and time.monotonic() < end:
        time.sleep(0.05)
    assert not _runs(child)


def _runs(pid: int) -> bool:
    try:
        return bool(psutil.Process(pid).status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False
