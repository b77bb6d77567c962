"""A person cancels in the middle of every attempt, and the next run goes on from there."""

from pathlib import Path

import psutil
import pytest

from gaga_core.placing.ladder import LadderConfig, Placement, place_stage
from gaga_core.placing.photos import PhotoSet, list_photos, prepare_photos
from gaga_core.placing.sfm import SfmConfig
from gaga_core.progress import run_stage
from tests.core.placing.photo_scenes import write_photos

_SFM = SfmConfig(feature_side=320, n_features=1500, doubled=False)
_ALL = LadderConfig(enough=1.01)  # so that every attempt is made


def prepared(folder: Path, workspace: Path) -> PhotoSet:
    workspace.mkdir()
    stage = prepare_photos(list_photos(folder), workspace / "photos", root=folder, longest_side=320)
    return run_stage(stage)


def cancelled_at(photos: PhotoSet, workspace: Path, words: str) -> None:
    """Close the stage at the first progress that says ``words``."""
    stage = place_stage(photos, workspace, _SFM, ladder=_ALL)
    seen = next(step for step in stage if words in step.message)
    stage.close()
    assert words in seen.message


def outcome(best: Placement) -> tuple[str, tuple[str, ...], int]:
    return best.title, best.facts.names, len(best.facts.points)


@pytest.mark.capture
def test_cancel_in_every_attempt(tmp_path: Path) -> None:
    write_photos(tmp_path / "in", 6)
    photos = prepared(tmp_path / "in", tmp_path / "whole")
    whole = run_stage(place_stage(photos, tmp_path / "whole", _SFM, ladder=_ALL))
    assert len(whole.attempts) == 3
    workspace = tmp_path / "stopped"
    photos = prepared(tmp_path / "in", workspace)
    for words in ("photos", "attempt 2 of 3", "attempt 3 of 3", "photos placed"):
        cancelled_at(photos, workspace, words)
        assert psutil.Process().children(recursive=True) == []
    again = run_stage(place_stage(photos, workspace, _SFM, ladder=_ALL))
    assert outcome(again.best) == outcome(whole.best)
    assert [a["placed"] for a in again.attempts] == [a["placed"] for a in whole.attempts]
