"""What is read again of a report, whatever its entries hold."""

import json
from pathlib import Path

import pytest

from gaga_core.io.folder.scene_folder import AssociateEntry, read_report_entry, with_entry
from gaga_core.pipeline.place import notes_of, placement_of

_GOOD = {"names": ["a", "b"], "why_out": {"b": "dark"}, "links": [[0, 1, 40]], "notes": ["x"]}


@pytest.mark.parametrize(
    "damage",
    [
        {"names": 3},
        {"links": [[0, 1]]},
        {"links": [[-1, 1, 4]]},
        {"why_out": ["b"]},
    ],
)
def test_a_damaged_placement_is_none(damage: dict[str, object]) -> None:
    assert placement_of({"sfm": _GOOD}) is not None
    assert placement_of({"sfm": {**_GOOD, **damage}}) is None


def test_links_to_photos_that_are_not_there_are_left_out() -> None:
    found = placement_of({"sfm": {**_GOOD, "links": [[0, 1, 40], [1, 7, 30]]}})
    assert found is not None
    assert found.links == ((0, 1, 40),)


def test_damaged_remarks_are_none() -> None:
    assert notes_of({**_GOOD, "checks": [{"text": "good"}]}) == ("x", "good")
    assert notes_of({**_GOOD, "notes": [3]}) == ()
    assert notes_of({**_GOOD, "checks": ["good"]}) == ()


def test_one_damaged_entry_does_not_cost_the_others(tmp_path: Path) -> None:
    file = tmp_path / "report.json"
    content = {"associate": {"mask_folder": 3}, "lift": {"x": float("nan")}}
    file.write_text(json.dumps(content))
    assert read_report_entry(file, "associate", AssociateEntry) is None
    again = json.loads(with_entry(file, "run", {"seconds": 1.0}))
    assert set(again) == {"associate", "lift", "run"}


def test_half_a_surrogate_pair_is_damage_and_a_whole_one_is_text(tmp_path: Path) -> None:
    file = tmp_path / "report.json"
    file.write_text('{"reconstruct": {"sfm": "\\ud83d\\ude00"}}')  # one character in two halves
    assert read_report_entry(file, "reconstruct", dict[str, object]) == {"sfm": "\U0001f600"}
    file.write_text('{"reconstruct": {"sfm": "\\ud83d"}}')
    assert read_report_entry(file, "reconstruct", dict[str, object]) is None
