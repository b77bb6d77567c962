"""One scene of Replica as its publishers lay it out scores the same, padded names or not."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray
from gaga_core.evaluate.benchmark.run import run_benchmark
from gaga_core.evaluate.benchmark.tables import InstanceScores
from gaga_core.evaluate.settings import BenchmarkConfig
from gaga_core.io.datasets import open_dataset
from gaga_core.progress import run_stage
from tests.datasets import gaga_replica, scrambled, semantic_nerf, tiny, write_map

_CROSSING = (2, 10, 30, 100)  # numbers whose order as text is another one
_LAYOUTS: dict[str, Callable[[Path], dict[int, str]]] = {
    "Gaga, padded": gaga_replica,
    "Gaga, not padded": lambda root: gaga_replica(root, numbers=_CROSSING, digits=0),
    "Semantic-NeRF": lambda root: semantic_nerf(root, first=0),
    "Semantic-NeRF, padded": lambda root: semantic_nerf(root, first=0, digits=4),
    "Gaga, the other way round": lambda root: gaga_replica(root, numbers=(3, 2, 1, 0)),
}


def _scores(root: Path, layout: str) -> DoubleArray:
    """IoU, precision, recall of the preset paper in percent, with void and without.

    The masks of the first view join two balls: what the bank makes of it depends on the order.
    """
    names = _LAYOUTS[layout](root / "data" / "office_0")
    first = np.where(tiny().labels[0] == 2, 1, tiny().labels[0]).astype(np.int32)
    stem = Path(names[0]).stem
    write_map(root / "data" / "office_0" / "raw_sam_mask" / f"{stem}.png", scrambled(first, 0))
    config = BenchmarkConfig(preset="paper", lift="none")
    report = run_stage(run_benchmark(open_dataset("replica", root / "data"), root / "out", config))
    assert not report.failed
    scores = report.scenes[0].runs[0].scores
    assert isinstance(scores, InstanceScores)
    both = (scores.with_void, scores.without_void)
    return np.array([100 * v for s in both for v in (s.iou, s.precision, s.recall)])


@pytest.fixture(scope="module")
def padded(
    tmp_path_factory: pytest.TempPathFactory,
) -> DoubleArray:
    return _scores(tmp_path_factory.mktemp("padded"), "Gaga, padded")


@pytest.mark.parametrize("layout", list(_LAYOUTS)[1:-1])
def test_layout_and_padding_change_no_score(
    layout: str, padded: DoubleArray, tmp_path: Path
) -> None:
    assert np.abs(_scores(tmp_path, layout) - padded).max() < 0.1


def test_the_order_of_views_would_show(padded: DoubleArray, tmp_path: Path) -> None:
    """Views in another order do give other scores: the tests above would see it."""
    assert np.abs(_scores(tmp_path, "Gaga, the other way round") - padded).max() > 1
