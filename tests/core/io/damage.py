"""Readers on damaged files: one sentence or a result, never a traceback."""

import random
from collections.abc import Callable
from pathlib import Path

from gaga_core.errors import GagaError


def one_sentence_or_result(path: Path, read: Callable[[], object], seed: int) -> int:
    """Flip and cut bytes of ``path`` in many ways; returns how often it was refused."""
    good, rng = path.read_bytes(), random.Random(seed)
    said = []
    for i in range(250):
        bad = bytearray(good)
        if i % 3 == 0:
            bad = bad[: rng.randrange(len(bad))]
        for _ in range(rng.choice((1, 3, 20)) if i % 3 else 0):
            bad[rng.randrange(len(bad))] = rng.randrange(256)
        path.write_bytes(bad)
        try:
            read()
        except GagaError as error:
            said.append(str(error))
    path.write_bytes(good)
    assert not any("\n" in text for text in said)
    return len(said)
