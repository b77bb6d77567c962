"""Results of several files: all of them, also when their program was killed while it moved them."""

import json
import os
import sys
from pathlib import Path

import pytest

from gaga_core.errors import GagaError
from gaga_core.io.files import remove_leftovers
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
