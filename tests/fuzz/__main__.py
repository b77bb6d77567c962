"""``python -m tests.fuzz SECONDS [SEED ...]``: the long attack; status 1 on a finding."""

import sys
import tempfile
from pathlib import Path

from tests.fuzz.attack import all_targets, attack


def main(seconds: float, seeds: tuple[int, ...]) -> int:
    """Attack all readers and print what was found."""
    with tempfile.TemporaryDirectory() as folder:
        result = attack(Path(folder), seconds, seeds, all_targets())
    for finding in result.findings:
        sys.stdout.write(f"{finding}\n")
    sys.stdout.write(f"{result.n_cases:,} files, {len(result.findings)} findings\n")
    return 1 if result.findings else 0


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]), tuple(int(a) for a in sys.argv[2:]) or (1, 2, 3, 4)))
