"""Laws of what a file may ask of the machine before it is read."""

import os
import sys
from pathlib import Path

import pytest

from gaga_core.errors import GagaError
from gaga_core.io.files import check_memory, machine_memory, open_file


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no named pipes in folders")
def test_a_named_pipe_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="no regular file"):
        open_file(tmp_path / "pipe")


def test_a_small_file_may_take_a_gibibyte_and_no_more(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"x" * 1000)
    check_memory(path, 1 << 30, "a picture")
    with pytest.raises(GagaError, match=r"1,000 bytes and says that it holds 9 splats.* 1,074 MB"):
        check_memory(path, (1 << 30) + 1, "9 splats")


def test_a_large_file_may_take_fifty_times_its_size_and_half_of_the_memory(tmp_path: Path) -> None:
    path = tmp_path / "a"
    with path.open("wb") as file:
        file.truncate(machine_memory())  # a sparse file
    check_memory(path, machine_memory() // 2, "splats")
    with pytest.raises(GagaError, match="of memory here"):
        check_memory(path, machine_memory() // 2 + 1, "splats")
    with path.open("wb") as file:
        file.truncate(30 << 20)
    check_memory(path, 1500 << 20, "splats")
    with pytest.raises(GagaError):
        check_memory(path, (1500 << 20) + 1, "splats")
