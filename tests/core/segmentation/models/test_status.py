"""What is told of models on this machine: here or not, how long a photo takes."""

import json
import time
from itertools import count
from pathlib import Path

import pytest

from gaga_core.segmentation.models import status
from gaga_core.segmentation.models.catalogue import CATALOGUE, known_model
from gaga_core.segmentation.models.status import all_models, status_of
from tests.core.segmentation.models.conftest import TINY


def test_an_estimate_comes_before_the_first_use_and_a_measurement_after(models: Path) -> None:
    estimate = status.seconds_a_photo(TINY)
    assert estimate is not None
    assert 0.05 < estimate[0] < 3600
    assert not estimate[1]
    larger = status.seconds_a_photo(known_model("sam2.1-large"))
    assert larger is not None
    ratio = known_model("sam2.1-large").gigaflop / TINY.gigaflop
    assert larger[0] / estimate[0] == pytest.approx(ratio), "this machine is timed once"
    assert status.seconds_a_photo(known_model("sam-huge")) is None, "its work is not known"
    for seconds in (12.5, 9.25):
        status.record(TINY.name, seconds)
        assert status.seconds_a_photo(TINY) == (seconds, True)
    status.record(TINY.name, 0.0)
    assert status.measured(TINY.name) == 9.25


@pytest.mark.parametrize("seconds", [0.0, 3.0])
def test_any_clock_gives_an_estimate(
    models: Path, monkeypatch: pytest.MonkeyPatch, seconds: float
) -> None:
    """One that stands still; one of a machine so busy that one look takes longer than all were to
    take, whose speed was 0."""
    ticks = count(step=round(seconds * 1e9))
    monkeypatch.setattr(time, "thread_time_ns", lambda: next(ticks))
    monkeypatch.setattr(time, "perf_counter_ns", lambda: next(ticks))
    for _ in range(2):
        estimate = status.seconds_a_photo(TINY)
        assert estimate is not None
        assert estimate[0] > 0
    (models / "speed.json").write_text("{")
    assert status.measured(TINY.name) is None, "damaged: measured again"
    assert status.seconds_a_photo(TINY) is not None


@pytest.mark.parametrize("step_ns", [15_625_000, 10**12])
def test_a_clock_that_moves_in_steps_tells_the_same_speed(
    models: Path, monkeypatch: pytest.MonkeyPatch, step_ns: int
) -> None:
    """That of Windows: most looks at it saw no time pass, so the machine seemed without limit; and
    one that does not move while it is looked at."""
    fine = status.seconds_a_photo(TINY)
    (models / "speed.json").unlink()
    clock = time.thread_time_ns
    monkeypatch.setattr(time, "thread_time_ns", lambda: clock() // step_ns * step_ns)
    coarse = status.seconds_a_photo(TINY)
    assert fine is not None
    assert coarse is not None
    assert 1 / 4 < coarse[0] / fine[0] < 40, "a busy machine shares the time that passes"


def test_the_list_tells_every_model_and_a_folder_put_there_by_hand(models: Path) -> None:
    folder = models / TINY.name
    folder.mkdir(parents=True)
    (folder / "config.json").write_text(json.dumps({"model_type": "sam2"}))
    (folder / "model.safetensors").write_bytes(b"w")
    assert [entry.model for entry in all_models()] == list(CATALOGUE)
    entry = status_of(TINY)
    assert entry.path == folder
    assert entry.lock is None
    assert entry.to_json()["commit"] == ""
    for other in all_models():
        assert json.loads(json.dumps(other.to_json()))["page"] == other.model.page
        assert (other.seconds is None) <= (not other.is_measured)
        assert other.model.purpose == "masks" or other.seconds is None
    assert status_of(known_model("sam3")).model.is_gated


def test_known_models_have_one_name_each_and_say_what_a_person_must_know() -> None:
    for field in ("name", "hub"):
        assert len({getattr(model, field) for model in CATALOGUE}) == len(CATALOGUE)
    assert all(known_model(model.hub) is known_model(model.name) is model for model in CATALOGUE)
    assert {model.purpose for model in CATALOGUE} == {"masks", "words", "boxes", "matches"}
    assert all(m.megabytes > 0 and m.licence for m in CATALOGUE)
    assert all(m.page.startswith("https://") for m in CATALOGUE)
