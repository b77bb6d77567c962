"""``python -m tests.fuzz SECONDS [BATCH [SEED ...]]``: the long attack; status 1 on a finding."""

import os
import sys
import tempfile
from pathlib import Path

from tests.fuzz.attack import all_targets, attack

_SEEDS = (1, 2, 3, 4)
_BATCH = 120  # cases of a worker: its start takes as long as about 30


def main(seconds: float, batch: int, seeds: tuple[int, ...]) -> int:
    """Attack all readers with a worker on each core and print what was found."""
    n_workers = os.cpu_count() or 1
    with tempfile.TemporaryDirectory() as folder:
        result = attack(Path(folder), seconds, seeds, all_targets(), batch, n_workers)
    for finding in result.findings:
        sys.stdout.write(f"{finding}\n")
    counts = ", ".join(f"{n:,} {rule}" for rule, n in result.rules.most_common())
    (slowest, where), (most, which) = result.seconds, result.n_bytes
    sys.stdout.write(
        f"{result.n_cases:,} files ({counts}), {len(result.findings)} findings\n"
        f"at most {slowest:.1f} s ({where}) and {most / 1e9:.2f} GB ({which})\n"
    )
    return 1 if result.findings else 0


if __name__ == "__main__":
    numbers = [int(argument) for argument in sys.argv[1:]]
    seconds, batch, *seeds = [*numbers, _BATCH][: max(len(numbers), 2)]
    sys.exit(main(seconds, batch, tuple(seeds) or _SEEDS))
