"""Runs cases of one reader: the part of the attack that may die.

``python -m tests.fuzz.worker TARGET SEED FIRST COUNT FOLDER``: writes each number before its case
runs, and a line ``! number traceback`` after one that ends in anything but a result or one
sentence. The memory of the process and the time of a case are limited.
"""

import faulthandler
import os
import random
import resource
import shutil
import sys
import traceback
import zlib
from pathlib import Path

from gaga_core.errors import GagaError
from tests.fuzz.mutate import mutated
from tests.fuzz.targets import TARGETS, Target

MOST_MEMORY, MOST_SECONDS = 4 << 30, 60


def damaged_case(target: Target, name: str, good: Path, place: Path, seed: int) -> Path:
    """A copy of the good folder in ``place`` with one file damaged, the same for the same seed."""
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(good, place)
    rng = random.Random(zlib.crc32(name.encode()) ^ (seed << 32))
    files = sorted(p for p in place.glob(target.damaged or "**/*") if p.is_file())
    victim = rng.choice(files)
    victim.write_bytes(mutated(victim.read_bytes(), rng))
    return place


def main(name: str, seed: int, first: int, count: int, folder: Path) -> None:
    """Run the cases ``first`` to ``first + count - 1``."""
    target, good = TARGETS[name], folder / "good"
    os.environ["GAGA_HOME"] = str(folder / "home")
    if not good.exists():
        good.mkdir(parents=True)
        target.make(good)
    target.read(good)  # kernels are loaded, and the good files are good
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_MEMORY, used + MOST_MEMORY))
    for number in range(first, first + count):
        _say(str(number))
        place = damaged_case(target, name, good, folder / "case", seed * 1_000_003 + number)
        faulthandler.dump_traceback_later(MOST_SECONDS, exit=True)
        try:
            target.read(place)
        except GagaError as error:
            if "\n" in str(error):
                _say(f"! {number} more than one line: {error!r}")
        except Exception:  # noqa: BLE001  whatever escapes is what we look for
            _say(f"! {number} {traceback.format_exc()!r}")
        finally:
            faulthandler.cancel_dump_traceback_later()
    _say("end")


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]), Path(sys.argv[5]))
