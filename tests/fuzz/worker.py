"""Runs cases of one reader: the part of the attack that may die.

Sends a `Case` before each one and a text after one that ends in anything but a result or plain
sentences, or that took too much; after each one its `Cost`; at last `END`.
"""

import faulthandler
import os
import random
import shutil
import signal
import sys
import time
import traceback
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, NamedTuple

from gaga_core.errors import LONGEST_LINE, LONGEST_SENTENCE, GagaError
from tests.fuzz.formats import changed, inventory
from tests.fuzz.mutate import mutated
from tests.fuzz.targets import TARGETS, Target

MOST_SECONDS = 20.0
_LONGEST_WAIT = 240.0  # s on the clock: nothing takes that long on a machine however busy
MOST_MEMORY = 3_000_000_000  # bytes in use at a time
_MOST_ASKED = 6 << 30  # bytes: more are not given to a case
_BYTES = "bytes"  # the rule of cases that know no format: every second one
END = "end"


class Case(NamedTuple):
    """A case that begins."""

    number: int
    rule: str


class Cost(NamedTuple):
    """What a case took."""

    rule: str
    seconds: float  # of processors, or of waiting while no process of the machine waited for one
    n_bytes: int


@dataclass(frozen=True)
class Cases:
    """The cases ``first`` to ``first + count - 1`` of the reader ``name`` with a seed."""

    name: str
    seed: int
    first: int
    count: int
    folder: Path  # holds the good files, the damaged ones and a home


def damaged_case(target: Target, name: str, folder: Path, seed: int) -> str:
    """Copy the good files of ``folder`` and damage one, the same for the same seed.

    Returns the name of the rule. Next to the ``case`` lies an ``outside``, empty but for links.
    """
    place, outside = folder / "case", folder / "outside"
    for old in (place, outside):
        shutil.rmtree(old, ignore_errors=True)
    shutil.copytree(folder / "good", place)
    outside.mkdir()
    rng = random.Random(zlib.crc32(name.encode()) ^ (seed << 32))
    files = sorted(p for p in place.glob(target.damaged or "**/*") if p.is_file())
    victim = rng.choice(files)
    if seed % 2:
        opened = place / (target.damaged.split("/")[0] if "/" in target.damaged else "")
        return changed(victim, opened, outside, rng)
    victim.write_bytes(mutated(victim.read_bytes(), rng))
    return _BYTES


def run_cases(cases: Cases, said: Connection) -> None:
    """Run them, in a process of their own. What it writes to its error stream goes to a file."""
    target, folder = TARGETS[cases.name], cases.folder
    errors = (folder / "stderr").open("w", encoding="utf-8")
    os.dup2(errors.fileno(), sys.stderr.fileno())
    os.environ["GAGA_HOME"] = str(folder / "home")
    if not (folder / "good").exists():
        (folder / "good").mkdir(parents=True)
        target.make(folder / "good")
    shutil.rmtree(folder / "case", ignore_errors=True)
    shutil.copytree(folder / "good", folder / "case")
    target.read(folder / "case")  # kernels are loaded, and the good files are good
    import resource  # not on Windows

    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + _MOST_ASKED, used + _MOST_ASKED))
    for number in range(cases.first, cases.first + cases.count):
        seed = cases.seed * 1_000_003 + number
        rule = damaged_case(target, cases.name, folder, seed)
        said.send(Case(number, rule))
        os.environ["GAGA_HOME"] = str(folder / "home")
        before = inventory(folder / "outside")
        Path("/proc/self/clear_refs").write_text("5")  # the peak counts from here: proc(5)
        with watched(errors) as took:
            for fault in faults_of(target, folder / "case"):
                said.send(fault)
        cost = Cost(rule, took[0], _peak())
        if cost.seconds > MOST_SECONDS:
            said.send(f"time: {cost.seconds:.1f} s")
        if cost.n_bytes > MOST_MEMORY:
            said.send(f"memory: {cost.n_bytes / 1e9:.1f} GB")
        if inventory(folder / "outside") != before:
            said.send(f"files outside were changed: {[*inventory(folder / 'outside')]}")
        said.send(cost)
    said.send(END)


@contextmanager
def watched(
    errors: IO[str], most: float = MOST_SECONDS, longest_wait: float = _LONGEST_WAIT
) -> Iterator[list[float]]:
    """Measure the seconds of what is done here; they stand in the list when it has ended.

    The process ends with its traceback in ``errors`` after ``most`` seconds of processors, or
    ``longest_wait`` on the clock. Time in which processes of the machine waited for a processor or
    a disk counts only as far as this one computed, so a busy machine makes no case a slow one.
    """
    faulthandler.register(signal.SIGPROF, errors, all_threads=True, chain=True)
    faulthandler.dump_traceback_later(longest_wait, exit=True, file=errors)
    signal.setitimer(signal.ITIMER_PROF, most)
    computed, start, stalled = sum(os.times()[:4]), time.monotonic(), _stalled()
    took: list[float] = []
    yield took
    alone = time.monotonic() - start - (_stalled() - stalled)
    took.append(max(alone, sum(os.times()[:4]) - computed))
    signal.setitimer(signal.ITIMER_PROF, 0)
    faulthandler.cancel_dump_traceback_later()


def _stalled() -> float:
    """Seconds in which a process of the machine waited for a processor or a disk, since its start.

    0 where the system does not count them (https://docs.kernel.org/accounting/psi.html).
    """
    files = [Path("/proc/pressure") / name for name in ("cpu", "io")]
    lines = [file.read_text(encoding="ascii").splitlines()[0] for file in files if file.exists()]
    return sum(int(line.rpartition("total=")[2]) for line in lines) / 1e6


def faults_of(target: Target, place: Path) -> list[str]:
    """What is wrong with how a case ends: a text each."""
    try:
        with warnings.catch_warnings():
            # It would stand before what a command says. What the program ignores comes first.
            warnings.simplefilter("error", RuntimeWarning, append=True)
            result = target.read(place)
        shown = result if isinstance(result, list) else []
        return [fault for line in shown for fault in _wrong_in(line, LONGEST_LINE)]
    except GagaError as error:
        cause: BaseException | None = error
        while cause is not None and not (isinstance(cause, MemoryError) and not _of_pillow(cause)):
            cause = cause.__cause__ or cause.__context__
        asked = [] if cause is None else [f"asks for too much memory: {cause}\n{_trace(cause)}"]
        return [*_wrong_in(str(error), LONGEST_SENTENCE), *asked]
    except Exception as error:  # noqa: BLE001  whatever escapes is what we look for
        return [_trace(error)]


def _of_pillow(error: MemoryError) -> bool:
    """Whether Pillow refused it: so it does with lines that its decoders cannot count."""
    return "PIL" in Path([*traceback.walk_tb(error.__traceback__)][-1][0].f_code.co_filename).parts


def _trace(error: BaseException) -> str:
    return "".join(traceback.format_exception(error))


def _wrong_in(text: str, longest: int) -> list[str]:
    """Why a text is not plain."""
    wrong = []
    if len(text) > longest:
        wrong.append(f"a text of {len(text):,} characters: {text[:300]!r}")
    if not text.isprintable():
        wrong.append(f"a text that is not plain: {text[:300]!r}")
    return wrong


def _peak() -> int:
    """Most bytes of memory that this process used since its peak was cleared, or a child ever."""
    import resource

    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    own = next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))
    return max(int(own), resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss) * 1024
