"""``python -m tests.fuzz SECONDS [BATCH [SEED ...]]``: the long attack; status 1 on a finding."""

import sys
import tempfile
from pathlib import Path

from tests.fuzz.attack import all_targets, attack

_SEEDS = (1, 2, 3, 4)
_BATCH = 180  # every reader with four seeds: 20,376 files


def main(seconds: float, batch: int, seeds: tuple[int, ...]) -> int:
    """Attack all readers and print what was found."""
    with tempfile.TemporaryDirectory() as folder:
        result = attack(Path(folder), seconds, seeds, all_targets(), batch)
    for finding in result.findings:
        sys.stdout.write(f"{finding}\n")
    sys.stdout.write(f"{result.n_cases:,} files, {len(result.findings)} findings\n")
    return 1 if result.findings else 0


if __name__ == "__main__":
    numbers = [int(argument) for argument in sys.argv[1:]]
    seconds, batch, *seeds = [*numbers, _BATCH][: max(len(numbers), 2)]
    sys.exit(main(seconds, batch, tuple(seeds) or _SEEDS))
