"""``python -m tests.fuzz SECONDS``: the long attack; status 1 on a finding."""

import argparse
import os
import sys
import tempfile
from pathlib import Path

from tests.fuzz.attack import all_targets, attack


def main(seconds: float, batch: int, seeds: list[int], processes: int) -> int:
    """Attack all readers for so long and print what was found."""
    with tempfile.TemporaryDirectory() as folder:
        readers = all_targets()
        result = attack(Path(folder), seconds, seeds, readers, batch, processes, sys.stdout)
    counts = ", ".join(f"{n:,} {rule}" for rule, n in result.rules.most_common())
    (slowest, where), (most, which) = result.seconds, result.n_bytes
    sys.stdout.write(
        f"{result.n_cases:,} files ({counts}), {len(result.findings)} findings\n"
        f"at most {slowest:.1f} s ({where}) and {most / 1e9:.2f} GB ({which})\n"
    )
    return 1 if result.findings else 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser("python -m tests.fuzz", description=__doc__)
    parser.add_argument("seconds", type=float)
    # The start of a worker takes as long as about 30 cases.
    parser.add_argument("--batch", type=int, default=120, help="cases of a worker")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4])
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    sys.exit(main(**vars(parser.parse_args())))
