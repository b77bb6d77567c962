"""Parts of the program folder that are compressed: packages are unpacked when they are imported."""

import importlib
import io
import shutil
import sys
import tarfile
from pathlib import Path

import pytest
import zstandard

from gaga_core.errors import GagaError
from gaga_core.io.packed import import_packed, unpacked_folder


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(sys, "meta_path", [*sys.meta_path])
    return tmp_path / "cache" / "gaga-studio"


def _pack(folder: Path, name: str, digest: str, value: int) -> Path:
    text = f"VALUE = {value}\n".encode()
    content = io.BytesIO()
    with tarfile.open(fileobj=content, mode="w") as archive:
        member = tarfile.TarInfo(f"{name}/__init__.py")
        member.size = len(text)
        archive.addfile(member, io.BytesIO(text))
    folder.mkdir(exist_ok=True)
    path = folder / f"{name}-{digest}.tar.zst"
    path.write_bytes(zstandard.compress(content.getvalue()))
    return path


def test_a_package_is_unpacked_when_it_is_imported_first(tmp_path: Path, cache: Path) -> None:
    _pack(tmp_path / "packed", "gaga_packed_one", "a1", 7)
    import_packed(tmp_path / "packed")
    assert importlib.util.find_spec("gaga_packed_none") is None
    assert not cache.exists(), "nothing is unpacked before it is needed"
    assert importlib.import_module("gaga_packed_one").VALUE == 7
    assert [path.name for path in cache.iterdir()] == ["gaga_packed_one-a1"]


def test_a_new_version_takes_the_place_of_the_former(tmp_path: Path, cache: Path) -> None:
    first = unpacked_folder(_pack(tmp_path / "packed", "one", "a1", 1))
    second = unpacked_folder(_pack(tmp_path / "packed", "one", "b2", 2))
    other = unpacked_folder(_pack(tmp_path / "packed", "two", "c3", 3))
    assert not first.exists()
    assert (second / "one" / "__init__.py").read_text() == "VALUE = 2\n"
    assert sorted(cache.iterdir()) == sorted([second, other]), "nothing else is left"
    stamp = second.stat().st_mtime_ns
    assert unpacked_folder(tmp_path / "packed" / "one-b2.tar.zst") == second
    assert second.stat().st_mtime_ns == stamp, "it is not unpacked again"


def test_a_former_version_that_is_removed_in_part_is_not_taken_for_whole(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its files may be in use, or the program may end in between."""
    first = _pack(tmp_path / "packed", "one", "a1", 1)
    unpacked_folder(first)

    def removes_some(folder: str, *_: object, **__: object) -> None:
        for file in Path(folder).rglob("__init__.py"):
            file.unlink()

    with monkeypatch.context() as broken:
        broken.setattr(shutil, "rmtree", removes_some)
        unpacked_folder(_pack(tmp_path / "packed", "one", "b2", 2))
    assert (unpacked_folder(first) / "one" / "__init__.py").is_file()


def test_an_import_that_could_not_unpack_is_tried_again(tmp_path: Path, cache: Path) -> None:
    _pack(tmp_path / "packed", "gaga_packed_two", "a1", 7)
    import_packed(tmp_path / "packed")
    cache.parent.write_text("a file")
    for _ in range(2):
        with pytest.raises(GagaError, match="cache"):
            importlib.import_module("gaga_packed_two")
    cache.parent.unlink()
    assert importlib.import_module("gaga_packed_two").VALUE == 7


def test_a_cache_that_cannot_be_written_is_a_sentence(tmp_path: Path, cache: Path) -> None:
    cache.parent.write_text("a file")
    with pytest.raises(GagaError, match="cache"):
        unpacked_folder(_pack(tmp_path / "packed", "one", "a1", 1))
