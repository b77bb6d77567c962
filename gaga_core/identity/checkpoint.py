"""A training run on disk: what it takes to go on as if it had never stopped."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gaga_core.arrays import AnyArray
from gaga_core.errors import GagaError
from gaga_core.identity.linear_kernels import D
from gaga_core.identity.rows import Batch
from gaga_core.identity.training import Training
from gaga_core.io.arrays_file import read_arrays
from gaga_core.io.files import atomic_write

_VALUES = ("encodings", "weight", "bias")
_MOMENTS = tuple(f"{kind}_{name}" for name in _VALUES for kind in ("mean", "square"))

FILE = "identity.checkpoint.npz"  # of an unfinished run of mode "paper", in the work folder


def digest_of(batches: Sequence[Batch], settings: str) -> str:
    """Digest of the data that a run trains on and of its settings: equal only for the same run."""
    digest = hashlib.sha256(settings.encode())
    for batch in batches:
        weights = batch.rows.by_pixel
        for array in (batch.labels, weights.indices, weights.weights, weights.indptr):
            digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def save_checkpoint(path: Path, training: Training, digest: str) -> None:
    """Write the state of a run; ``GagaError`` when the place cannot be written."""
    arrays: dict[str, AnyArray] = {name: getattr(training, name) for name in _VALUES}
    arrays |= dict(zip(_MOMENTS, training.moments, strict=True))
    arrays |= {"step": np.array(training.step), "digest": np.array(digest)}
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def load_checkpoint(path: Path, digest: str, n_gaussians: int, n_groups: int) -> Training | None:
    """The state of the run with this ``digest``; None when the file is of another run.

    Raises ``GagaError`` when the file is damaged.
    """
    cure = "Remove it to train from the start."
    arrays = read_arrays(path, cure)
    try:
        if str(arrays["digest"]) != digest:
            return None
        values = [np.ascontiguousarray(arrays[name], np.float32) for name in _VALUES]
        moments = tuple(np.ascontiguousarray(arrays[name], np.float32) for name in _MOMENTS)
        training = Training(values[0], values[1], values[2], moments, int(arrays["step"]))
    except (ValueError, KeyError, TypeError) as error:
        raise GagaError(f"{path} is damaged. {cure}") from error
    shapes = ((n_gaussians, D), (n_groups + 1, D), (n_groups + 1,))
    fits = all(value.shape == shape for value, shape in zip(values, shapes, strict=True))
    same = all(m.shape == shapes[i // 2] for i, m in enumerate(moments))
    if not (fits and same and training.step >= 0):
        raise GagaError(f"{path} is damaged. {cure}")
    return training
