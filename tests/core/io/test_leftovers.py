"""What a kill leaves is removed at the next start; long names work; children end with parents."""

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
from gaga_core.io.folder.staging import staging_folder

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
