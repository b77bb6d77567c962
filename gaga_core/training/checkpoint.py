"""A training on disk: what it takes to go on as if it had never stopped."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, FloatArray
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.arrays_file import TEXT, Column, damage, read_columns
from gaga_core.io.files import atomic_write
from gaga_core.raster.base import ImageLoss
from gaga_core.training.densification import ScreenSums
from gaga_core.training.optimizer import COLUMNS, Splats, of_columns
from gaga_core.training.settings import TrainConfig
from gaga_core.training.views import TrainViews

# --- Exposure and white balance of each photo, trained with the splats and kept out of them.


_BETA1, _BETA2 = 0.9, 0.99


@dataclass(frozen=True, eq=False)
class Exposures:
    """A gain and an offset for each view and channel: photo = gain x picture + offset.

    Their means over the views are 1 and 0, so that the splats keep the photos' mean look. The
    arrays are changed in place.
    """

    values: DoubleArray  # (V, 2, 3) gain, offset
    first: DoubleArray  # (V, 2, 3) Adam's running mean of the gradient
    second: DoubleArray  # (V, 2, 3) and of its square

    @staticmethod
    def neutral(n_views: int) -> "Exposures":
        """All photos as they are."""
        values = np.zeros((n_views, 2, 3))
        values[:, 0] = 1
        return Exposures(values, np.zeros_like(values), np.zeros_like(values))

    def loss_of(self, view: int, loss: ImageLoss, gradient: DoubleArray) -> ImageLoss:
        """``loss`` behind the exposure of ``view``; its gradient by that is written to
        ``gradient`` (2, 3)."""
        gain, offset = self.values[view].astype(np.float32)

        def compare(image: FloatArray, target: FloatArray) -> tuple[float, FloatArray]:
            value, by_seen = loss(image * gain + offset, target)
            gradient[0] = (by_seen * image).sum(axis=(0, 1), dtype=np.float64)
            gradient[1] = by_seen.sum(axis=(0, 1), dtype=np.float64)
            return value, by_seen * gain

        return compare

    def step(self, view: int, gradient: DoubleArray, rate: float, n_before: int) -> None:
        """Move the exposure of ``view``, after ``n_before`` such steps of it."""
        first, second = self.first[view], self.second[view]
        first += (1 - _BETA1) * (gradient - first)
        second += (1 - _BETA2) * (gradient**2 - second)
        over = 1 - _BETA1 ** (n_before + 1), 1 - _BETA2 ** (n_before + 1)
        self.values[view] -= rate * (first / over[0]) / (np.sqrt(second / over[1]) + 1e-15)
        self.values[:] -= self.values.mean(axis=0) - np.array([[1.0] * 3, [0.0] * 3])


_FORMAT = 1
_PARTS = ("values", "first", "second")
_SHAPES: tuple[tuple[int | str, ...], ...] = (("N", 3), ("N", 4), ("N", 3), ("N",), ("N", "S", 3))
_FILE = {
    "iteration": Column(np.int64, low=0),
    "gradient": Column(np.float32, ("N",)),
    "n_views": Column(np.int32, ("N",), low=0),
    "losses": Column(np.float32, ("iterations",)),
    "measured": Column(np.float64, ("M", 3), unknown=True),  # dB of equal pictures
    "best": Column(np.float64, (2,), unknown=True, optional=True),
}
for _part in _PARTS:
    _FILE[f"exposures_{_part}"] = Column(np.float64, ("views", 2, 3))
    for _name, _shape in zip(COLUMNS, _SHAPES, strict=True):
        _FILE[f"{_part}_{_name}"] = Column(np.float32, _shape)
_OF_BEST = {"N": "kept", "S": "kept S"}  # earlier: of other splats, perhaps of a lower degree
for _name, _shape in zip(COLUMNS, _SHAPES, strict=True):
    _kept = tuple(_OF_BEST.get(str(side), side) for side in _shape)
    _FILE[f"best_{_name}"] = Column(np.float32, _kept, optional=True)
_NO_EFFECT = ("snapshot_seconds", "checkpoint_seconds")  # settings that change no result


@dataclass(frozen=True, eq=False)
class Best:
    """The latest splats that drew the choosing held-out views as well as any so far."""

    iteration: int
    psnr: float  # dB, the best mean over these views so far; theirs is the same but for noise
    gaussians: Gaussians  # as they were then; never changed


@dataclass(eq=False)
class TrainState:
    """A training between two iterations."""

    iteration: int  # done so far
    splats: Splats
    sums: ScreenSums
    exposures: Exposures
    losses: FloatArray  # (iterations,) those to come are 0
    measured: DoubleArray  # (M, 3) iteration, held-out PSNR in dB, SSIM
    best: Best | None = None  # where `TrainConfig.keeps_best` asks for it

    @staticmethod
    def first(gaussians: Gaussians, n_views: int, iterations: int) -> "TrainState":
        """The start of a training of so many ``iterations``; ``gaussians`` are copied."""
        return TrainState(
            0,
            Splats.of(gaussians),
            ScreenSums.empty(len(gaussians)),
            Exposures.neutral(n_views),
            np.zeros(iterations, np.float32),
            np.zeros((0, 3)),
        )


def digest_of(initial: Gaussians, views: TrainViews, config: TrainConfig, n_workers: int) -> str:
    """Digest of all that a training starts from: equal only for the same training."""
    settings = {k: v for k, v in asdict(config).items() if k not in _NO_EFFECT}
    digest = hashlib.blake2b(json.dumps([_FORMAT, n_workers, settings]).encode())
    for name in COLUMNS:
        digest.update(np.ascontiguousarray(getattr(initial, name)).data)
    for view in (*views.train, *views.test):
        camera = view.camera
        digest.update(camera.name.encode())
        more = [array for array in (view.alpha, view.depth) if array is not None]
        for array in (camera.K, camera.cam_from_world, view.picture, *more):
            digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def save_checkpoint(path: Path, state: TrainState, digest: str) -> None:
    """Write ``state`` in place of what is there; ``GagaError`` when that is impossible."""
    arrays: dict[str, AnyArray] = {
        "digest": np.array(digest),
        "iteration": np.array(state.iteration),
    }
    for part in _PARTS:
        columns = getattr(state.splats, part)
        arrays |= {f"{part}_{name}": getattr(columns, name) for name in COLUMNS}
        arrays[f"exposures_{part}"] = getattr(state.exposures, part)
    arrays |= {"gradient": state.sums.gradient, "n_views": state.sums.n_views}
    arrays |= {"losses": state.losses, "measured": state.measured}
    if state.best is not None:
        arrays |= {f"best_{name}": getattr(state.best.gaussians, name) for name in COLUMNS}
        arrays["best"] = np.array([state.best.iteration, state.best.psnr])
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def load_checkpoint(path: Path, digest: str, *, views: int, iterations: int) -> TrainState | None:
    """The state of the training with this ``digest``; None when there is none, or of another.

    ``views`` and ``iterations`` are how many it has. Raises ``GagaError`` when the file is damaged.
    """
    if not path.is_file():
        return None
    cure = "Remove it to train from the start."
    if str(read_columns(path, cure, {"digest": TEXT})["digest"]) != digest:
        return None
    arrays = read_columns(path, cure, _FILE, views=views, iterations=iterations)
    with damage(path, cure):
        parts = [of_columns([arrays[f"{part}_{name}"] for name in COLUMNS]) for part in _PARTS]
        if arrays["iteration"] > iterations:
            raise ValueError(f"iteration: {arrays['iteration']} of {iterations}")
        return TrainState(
            int(arrays["iteration"]),
            Splats(*parts),
            ScreenSums(arrays["gradient"], arrays["n_views"]),
            Exposures(*(arrays[f"exposures_{part}"] for part in _PARTS)),
            arrays["losses"],
            arrays["measured"],
            _best(arrays),
        )


def _best(arrays: Mapping[str, AnyArray]) -> Best | None:
    if "best" not in arrays:
        return None
    iteration, psnr = arrays["best"]
    columns = of_columns([arrays[f"best_{name}"] for name in COLUMNS])
    return Best(int(iteration), float(psnr), columns)


def splats_of(path: Path) -> Gaussians | None:
    """The splats of a checkpoint, without reading the rest; None when there are none."""
    names = [f"values_{name}" for name in COLUMNS]
    try:
        arrays = read_columns(path, "", {name: _FILE[name] for name in names})
    except GagaError:
        return None
    return of_columns([arrays[name] for name in names])


def iteration_of(path: Path) -> int | None:
    """Iterations done in a checkpoint, without reading the rest; None when there is none."""
    try:
        return int(read_columns(path, "", {"iteration": _FILE["iteration"]})["iteration"])
    except GagaError:
        return None
