"""The paper with identities as published, 10,000 steps, on the scenes of `bench_quality_parts`.

Next to it robust as it comes, by vote. Some CPU-minutes a seed: not part of `quality_parts`.
"""

import numpy as np

from tests.bench.bench_quality_parts import KEYS, SEEDS, Spread, with_identities
from tests.bench.figures import Figure
from tools.scenes.parts import parts_scene


def figures() -> list[Figure]:
    """Scores of the trained paper with their spread, and what robust gains over it."""
    scenes = [parts_scene(seed) for seed in SEEDS]
    trained = [with_identities(scene, "paper", "paper") for scene in scenes]
    robust = [with_identities(scene, "robust") for scene in scenes]
    rows = []
    for key in KEYS:
        spread = Spread.of(trained, key)
        rows.append(Figure(f"parts: paper, trained, {key}", spread.mean, "points"))
        rows.append(Figure(f"parts: paper, trained, {key}, spread", spread.deviation, "points"))
        pairs = zip(robust, trained, strict=True)
        gains = [100 * (getattr(ours, key) - getattr(theirs, key)) for ours, theirs in pairs]
        title = f"parts: robust over paper trained, {key}"
        rows.append(Figure(title, float(np.mean(gains)), "points"))
        rows.append(Figure(f"{title}, worst seed", min(gains), "points", ">= 0"))
    return rows
