"""Searching: measuring the groups of a large scene, and ranking many of them."""

import numpy as np

from gaga_core.arrays import FloatArray
from gaga_core.gaussians import Gaussians
from gaga_core.query.group_facts import GroupFacts, group_digests, group_facts
from gaga_core.query.index import GroupIndex, relevancy
from gaga_core.query.search import search_words
from gaga_core.scene.scene import Scene
from tests.bench.figures import Figure, median_ms
from tests.scenes import orbit_cameras

_N, _GROUPS, _DIM = 1_000_000, 500, 768
_CAMERAS = orbit_cameras(32)


def figures() -> list[Figure]:
    """CPU time of the facts of 1M splats in 500 groups, and of ranking these groups."""
    scene = _scene()
    facts = group_facts(scene, _CAMERAS)
    index, text, anything = _index()
    camera = _CAMERAS[0]
    words = "largest red one left of the blue one"
    return [
        Figure("query: facts of 1M splats", _ms(lambda: group_facts(scene, _CAMERAS)), "CPU-ms",
               "<= 100"),
        Figure("query: digests of 1M splats", _ms(lambda: group_digests(scene)), "CPU-ms"),
        Figure("query: 500 groups ranked by the index",
               _ms(lambda: relevancy(index, text, anything)), "CPU-ms", "<= 50"),
        Figure("query: 500 groups ranked by words",
               _ms(lambda: search_words(words, facts, {}, camera=camera)), "CPU-ms", "<= 50"),
        Figure("query: 500 groups ranked by name", _ms(lambda: _by_name(facts)), "CPU-ms",
               "<= 50"),
    ]  # fmt: skip


def _ms(work: object) -> float:
    assert callable(work)
    return median_ms(work, runs=7, warm_up=2)


def _by_name(facts: GroupFacts) -> object:
    names = {g: f"thing number {g} of wood" for g in range(1, _GROUPS + 1)}
    return search_words("wooden thing", facts, names, camera=_CAMERAS[0])


def _scene() -> Scene:
    """Balls of one color each, on a ground that 2 % of the splats make."""
    rng = np.random.default_rng(0)
    centres = rng.uniform(-2, 2, (_GROUPS + 1, 3))
    colors = rng.uniform(-1.5, 1.5, (_GROUPS + 1, 3))
    labels = rng.integers(0, _GROUPS + 1, _N).astype(np.int32)
    means = centres[labels] + rng.normal(0, 0.05, (_N, 3))
    gaussians = Gaussians(
        means=means.astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (_N, 1)),
        log_scales=rng.normal(-5, 0.5, (_N, 3)).astype(np.float32),
        logit_opacities=rng.normal(1, 2, _N).astype(np.float32),
        sh=(colors[labels] + rng.normal(0, 0.1, (_N, 3))).astype(np.float32)[:, None, :],
    )
    return Scene.of(gaussians, labels)


def _index() -> tuple[GroupIndex, FloatArray, FloatArray]:
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(_GROUPS + 5, _DIM))
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    vectors = rows.astype(np.float32)
    thumbnails = np.zeros((_GROUPS, 64, 64, 3), np.uint8)
    groups = np.arange(1, _GROUPS + 1, dtype=np.int32)
    index = GroupIndex("", groups, np.arange(_GROUPS), vectors[:_GROUPS], thumbnails)
    return index, vectors[_GROUPS], vectors[_GROUPS + 1 :]
