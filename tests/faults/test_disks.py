"""Full and read-only disks: one sentence, the old result, and nothing else."""

from pathlib import Path

import pytest

from tests.faults.disks import download_on_a_disk, run_on_a_disk
from tests.faults.processes import Child, make, run_whole
from tests.faults.programs import PROGRAMS


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *((name, "full") for name in ("export", "export objects", "associate", "train")),
        *((name, "read-only") for name in ("export", "train")),
    ],
)
def test_a_disk_that_takes_nothing(name: str, kind: str, tmp_path: Path) -> None:
    root, place = tmp_path / "it", tmp_path / "disk"
    place.mkdir()
    make(name, root)
    if PROGRAMS[name].has_versions:
        run_whole(name, root, "A")
    child = Child(run_on_a_disk, name, root, place, kind, "B")
    said = child.says()
    child.end()
    if said and said[0] == "cannot":
        pytest.skip(f"no disk can be mounted here: {said[1]}")
    _, sentence, before, after, stray = said
    assert ("The disk is full" if kind == "full" else "no permission") in sentence
    assert after == before
    assert stray == []


def test_a_disk_that_gets_full_in_the_middle_of_a_download(tmp_path: Path) -> None:
    made, place = tmp_path / "it", tmp_path / "disk"
    place.mkdir()
    make("model", made)
    sizes = [file.stat().st_size for file in (made / "repository").iterdir()]
    child = Child(download_on_a_disk, made, place)
    said = child.says()
    child.end()
    if said and said[0] == "cannot":
        pytest.skip(f"no disk can be mounted here: {said[1]}")
    _, sentence, kept, fetched = said
    assert "The disk is full" in sentence
    assert 0 < kept < sum(sizes)
    assert kept + fetched == sum(sizes)
