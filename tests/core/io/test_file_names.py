"""Names of files, and renaming, as each system takes them."""

import os
import re
import sys
import unicodedata
from pathlib import Path, PureWindowsPath

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gaga_core.errors import GagaError
from gaga_core.io import files
from gaga_core.io.files import (
    atomic_write,
    check_memory,
    machine_memory,
    open_file,
    safe_name,
    same_name,
    too_long,
)
from gaga_core.io.masks.label_maps import view_key, view_keys

NAMES = st.text(max_size=300) | st.sampled_from(
    ["CON", "aux.txt", "Nul .a", "com¹", "a.", "a ", ".", "..", "", "a:b", "a/b", "a\\b", "é", "\0"]
)


def _is_valid_everywhere(name: str) -> bool:
    """Rules of Windows ("Naming Files, Paths, and Namespaces"), macOS and Linux, read anew."""
    letters = set(name)
    is_device = PureWindowsPath(f"x/{name}").is_reserved() or PureWindowsPath(name).is_reserved()
    return (
        0 < len(name.encode()) <= 255 - len(".ksplat.gz")
        and not letters & set('<>:"/\\|?*')
        and all(ord(letter) > 31 and unicodedata.category(letter) != "Cs" for letter in letters)
        and not re.search(r"[ .]$", name)
        and not is_device
    )


@settings(deadline=None)
@given(NAMES)
@example("CONIN$.png")
@example("x" * 250)
@example("\ud800")
def test_every_name_becomes_one_that_all_systems_take(name: str) -> None:
    safe = safe_name(name)
    assert _is_valid_everywhere(safe)
    assert _is_valid_everywhere(f"{safe}.png")
    assert safe_name(safe) == safe


@settings(deadline=None)
@given(st.lists(NAMES, unique=True, max_size=20))
def test_names_that_differ_stay_different(names: list[str]) -> None:
    assert len({safe_name(name) for name in names}) == len(names)
    changed = [safe_name(name) for name in names if safe_name(name) != name]
    assert len({same_name(name) for name in changed}) == len(changed)


@pytest.mark.parametrize("name", ["IMG_0001", "a b (2)", "blue, 2", "é", "00.rgb", "console"])
def test_usual_names_stay(name: str) -> None:
    assert safe_name(name) == name


@settings(deadline=None)
@given(st.text(min_size=1, max_size=80))
def test_files_of_a_view_have_such_names_in_every_folder(name: str) -> None:
    parts = view_key(name).split("/")
    assert parts == [""] or all(_is_valid_everywhere(f"{part}.png") for part in parts)


@pytest.mark.parametrize("pair", [("l/A.jpg", "l/a.jpg"), ("e\u0301.jpg", "\xe9.jpg")])
def test_views_of_one_file_where_case_does_not_count_are_refused(pair: tuple[str, str]) -> None:
    with pytest.raises(GagaError, match="differ only in"):
        view_keys(pair)


def test_a_path_that_windows_finds_too_long_is_a_sentence() -> None:
    class LongPathError(OSError):
        winerror = 206

    said = files.explain_os_error(LongPathError(22, "", "C:/" + "a folder/" * 40), Path("x"))
    assert "too long" in said


def test_a_rename_waits_for_a_file_that_is_in_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Windows says so with an error that other systems do not have; without end it is raised."""

    class InUseError(PermissionError):
        winerror = 32

    real, refused = os.replace, [2]

    def replace(source: Path, target: Path) -> None:
        if refused[0]:
            refused[0] -= 1
            raise InUseError(13, "used by another process")
        real(source, target)

    monkeypatch.setattr(files, "_WAITS_S", (0.0,) * 3)
    monkeypatch.setattr(os, "replace", replace)
    path = tmp_path / "a.txt"
    files.write_text(path, "new")
    assert path.read_text(encoding="utf-8") == "new"
    refused[0] = 9
    with pytest.raises(GagaError, match="no permission"), atomic_write(path) as temporary:
        temporary.write_text("newer", encoding="utf-8")
    assert path.read_text(encoding="utf-8") == "new"
    assert list(tmp_path.iterdir()) == [path]


# --- Laws of what a file may ask of the machine before it is read.


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


@pytest.mark.parametrize(("name", "n"), [("n" * 255, 255), ("n" * 300, 300), ("я" * 128, 256)])
def test_a_name_that_no_file_can_have_is_told(tmp_path: Path, name: str, n: int) -> None:
    said = too_long(tmp_path / name)
    assert bool(said) == (n > 255)
    assert not said or f"{n} bytes" in said
    if said:
        with pytest.raises(OSError, match="too long"):
            (tmp_path / name).write_text("")
