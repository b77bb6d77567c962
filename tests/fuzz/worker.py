"""Runs cases of one reader: the part of the attack that may die.

Sends the number of each case before it runs, and a text after one that ends in anything but a
result or one sentence; at last `END`. The memory of the process and the time of a case are limited.
"""

import faulthandler
import os
import random
import resource
import shutil
import sys
import traceback
import zlib
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from gaga_core.errors import GagaError
from tests.fuzz.mutate import mutated
from tests.fuzz.targets import TARGETS, Target

MOST_MEMORY, MOST_SECONDS = 4 << 30, 60
END = -1


@dataclass(frozen=True)
class Cases:
    """The cases ``first`` to ``first + count - 1`` of the reader ``name`` with a seed."""

    name: str
    seed: int
    first: int
    count: int
    folder: Path  # holds the good files, the damaged ones and a home


def damaged_case(target: Target, name: str, good: Path, place: Path, seed: int) -> Path:
    """A copy of the good folder in ``place`` with one file damaged, the same for the same seed."""
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(good, place)
    rng = random.Random(zlib.crc32(name.encode()) ^ (seed << 32))
    files = sorted(p for p in place.glob(target.damaged or "**/*") if p.is_file())
    victim = rng.choice(files)
    victim.write_bytes(mutated(victim.read_bytes(), rng))
    return place


def run_cases(cases: Cases, said: Connection) -> None:
    """Run them, in a process of their own. What it writes to its error stream goes to a file."""
    target, good = TARGETS[cases.name], cases.folder / "good"
    os.environ["GAGA_HOME"] = str(cases.folder / "home")
    errors = (cases.folder / "stderr").open("w", encoding="utf-8")
    os.dup2(errors.fileno(), sys.stderr.fileno())
    if not good.exists():
        good.mkdir(parents=True)
        target.make(good)
    target.read(good)  # kernels are loaded, and the good files are good
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_MEMORY, used + MOST_MEMORY))
    for number in range(cases.first, cases.first + cases.count):
        said.send(number)
        seed = cases.seed * 1_000_003 + number
        place = damaged_case(target, cases.name, good, cases.folder / "case", seed)
        faulthandler.dump_traceback_later(MOST_SECONDS, exit=True, file=errors)
        try:
            target.read(place)
        except GagaError as error:
            if "\n" in str(error):
                said.send(f"more than one line: {error!r}")
        except Exception:  # noqa: BLE001  whatever escapes is what we look for
            said.send(traceback.format_exc())
        finally:
            faulthandler.cancel_dump_traceback_later()
    said.send(END)
