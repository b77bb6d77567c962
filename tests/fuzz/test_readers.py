"""A short attack on some readers by every rule; ``make fuzz`` is the long one."""

import random
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaga_core.errors import GagaError
from tests.fuzz.attack import attack
from tests.fuzz.formats import LINKS, RULES, inventory, linked
from tests.fuzz.mutate import mutated
from tests.fuzz.targets import TARGETS, Target
from tests.fuzz.worker import faults_of

_CASES = 20  # of each reader
_READERS = (
    *(
        f"splats.{form}"
        for form in ("ply", "compressed.ply", "splat", "spz", "sog", "glb", "ksplat")
    ),
    "bank",
    "masks coco.json",
    "project",
    "index",
    "photo",
    "settings",
    "scene folder",
)


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="no peaks of memory here")
def test_damaged_files_give_a_result_or_one_sentence(tmp_path: Path) -> None:
    result = attack(tmp_path, 0.0, [7], _READERS, _CASES)
    assert result.findings == []
    assert result.n_cases == _CASES * (len(_READERS) - 1) + _CASES // 10
    assert result.rules.keys() == {"bytes", LINKS, *RULES}


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no clock of a process here")
@pytest.mark.parametrize("what", ["while True: pass", "os.read(os.pipe()[0], 1)"])
def test_what_never_ends_ends_with_its_traceback(what: str, tmp_path: Path) -> None:
    limits = (0.2, 60.0) if "while" in what else (60.0, 0.2)
    lines = ["import os, sys", "from tests.fuzz.worker import watched"]
    lines += [f"with watched(sys.stderr, *{limits}):", f"    {what}"]
    ended = subprocess.run(
        [sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, check=False
    )
    assert ended.returncode == (-signal.SIGPROF if "while" in what else 1)
    assert 'File "<string>", line 4' in ended.stderr


def test_a_seed_gives_the_same_damage_again() -> None:
    good = b'{"a": [1, 2, {"b": "text"}]}'
    made = [mutated(good, random.Random(seed)) for seed in range(300)]
    assert made == [mutated(good, random.Random(seed)) for seed in range(300)]
    assert len(set(made)) > 200


@pytest.mark.parametrize(
    ("name", "target"),
    [
        ("values", "splats.glb"), ("arrays", "bank"), ("entries", "splats.sog"),
        ("headers", "splats.ply"), ("headers", "splats.spz"), ("pictures", "photo"),
    ],
)  # fmt: skip
def test_rules_change_files_and_a_seed_gives_the_same_again(
    name: str, target: str, tmp_path: Path
) -> None:
    TARGETS[target].make(tmp_path)
    (file,) = tmp_path.iterdir()
    good, rule = file.read_bytes(), RULES[name]
    assert rule.fits(file, good)
    made = [rule.change(good, random.Random(seed), tmp_path) for seed in range(20)]
    assert made == [rule.change(good, random.Random(seed), tmp_path) for seed in range(20)]
    assert len({good, *made}) > 10


def test_links_lead_out_of_the_folder_and_what_is_changed_there_shows(tmp_path: Path) -> None:
    led_out = 0
    for seed in range(40):
        opened, outside = tmp_path / f"{seed}" / "opened", tmp_path / f"{seed}" / "outside"
        (opened / "a").mkdir(parents=True)
        outside.mkdir()
        victim = opened / "a" / "b.txt"
        victim.write_text("good")
        linked(victim, opened, outside, random.Random(seed))
        before = inventory(outside)
        if before:
            led_out += 1
            victim.write_text("changed")
            assert inventory(outside) != before
    assert led_out > 3


def _says(text: str) -> Callable[[Path], object]:
    return lambda _: [text]


def _asks_for_too_much(_: Path) -> None:
    try:
        raise MemoryError("10 GB")
    except MemoryError as error:
        raise GagaError("The file is damaged.") from error


@pytest.mark.parametrize(
    ("read", "fault"),
    [
        (_says("one plain sentence"), None),
        (_says("x" * 10_001), "10,001 characters"),
        (_says("\x1b[31mred"), "not plain"),
        (_asks_for_too_much, "too much memory"),
        (lambda _: np.float32(1e30) * np.float32(1e30), "RuntimeWarning"),
        (Image.open, "Error"),
    ],
)
def test_faults_of_readers_are_found(
    read: Callable[[Path], object], fault: str | None, tmp_path: Path
) -> None:
    found = faults_of(Target(lambda _: None, read), tmp_path)
    assert len(found) == (fault is not None)
    assert fault is None or fault in found[0]
