"""Identity encodings in the files of Gaussian Grouping and Gaga.

Encodings are the columns ``obj_dc_0`` to ``obj_dc_15`` of a .ply; the layer is ``classifier.pth``,
the state of a torch ``Conv2d(16, K, 1)``.
"""

import pickle
import zipfile
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from gaga_core.arrays import FloatArray, check_shape
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.identity.field import IdentityField
from gaga_core.identity.linear_kernels import D
from gaga_core.io.files import atomic_write, explain_os_error

CLASSIFIER_FILE = "classifier.pth"  # next to the .ply, as Gaussian Grouping and Gaga leave it
COLUMNS = tuple(f"obj_dc_{c}" for c in range(D))


def encodings_of(gaussians: Gaussians) -> FloatArray | None:
    """Encodings (N, D) of a model that has ``obj_dc`` columns; None when it has none.

    Raises ``GagaError`` when some of the 16 are missing or hold no numbers.
    """
    found = [name for name in COLUMNS if name in gaussians.extra]
    if not found:
        return None
    columns = [gaussians.extra[name] for name in found]
    if len(found) < D or any(column.dtype.kind not in "fiu" for column in columns):
        raise GagaError(
            f"The model has {len(found)} of the {D} columns obj_dc_0 to obj_dc_{D - 1}. "
            "Export it again with identity."
        )
    return np.stack([column.astype(np.float32) for column in columns], axis=1)


def with_encodings(gaussians: Gaussians, encodings: FloatArray) -> Gaussians:
    """The model with ``encodings`` (N, D) as its ``obj_dc`` columns, after all others."""
    check_shape("encodings", encodings, (len(gaussians), D), np.float32)
    others = {name: column for name, column in gaussians.extra.items() if name not in COLUMNS}
    codes = {name: np.ascontiguousarray(encodings[:, c]) for c, name in enumerate(COLUMNS)}
    return replace(gaussians, extra=MappingProxyType(others | codes))


def read_classifier(path: Path) -> tuple[FloatArray, FloatArray]:
    """Weight (K, D) and bias (K,) of a ``classifier.pth``; nothing in the file is executed.

    Raises ``GagaError`` when it is missing, damaged, or holds something else.
    """
    import torch

    try:
        with path.open("rb") as file:
            state = torch.load(file, map_location="cpu", weights_only=True)
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    except (
        pickle.UnpicklingError,
        zipfile.BadZipFile,
        RuntimeError,
        ValueError,
        TypeError,
        AttributeError,
        LookupError,
        EOFError,
        OverflowError,
        MemoryError,
    ) as error:
        raise GagaError(f"{path} is damaged, or no classifier. Choose another file.") from error
    found = [state.get(name) for name in ("weight", "bias")] if isinstance(state, dict) else []
    tensors = [value for value in found if isinstance(value, torch.Tensor)]
    if len(tensors) != 2 or not all(value.is_floating_point() for value in tensors):
        raise GagaError(f"{path} holds no weight and bias. Choose a classifier.pth.")
    weight, bias = (value.detach().to(torch.float32).numpy() for value in tensors)
    n = weight.shape[0] if weight.ndim else 0
    if n == 0 or weight.size != n * D or weight.shape[:2] != (n, D) or bias.shape != (n,):
        raise GagaError(
            f"{path} has weights of shape {weight.shape}; expected (groups + 1, {D}, 1, 1)."
        )
    if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
        raise GagaError(
            f"{path} is damaged: it holds numbers that are not finite. Choose another file."
        )
    return np.ascontiguousarray(weight.reshape(n, D)), np.ascontiguousarray(bias)


def write_classifier(path: Path, weight: FloatArray, bias: FloatArray) -> None:
    """Write weight (K, D) and bias (K,) as the ``classifier.pth`` that those projects load."""
    import torch

    check_shape("weight", weight, ("K", D), np.float32)
    check_shape("bias", bias, (len(weight),), np.float32)
    state = {"weight": torch.tensor(weight.reshape(-1, D, 1, 1)), "bias": torch.tensor(bias)}
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        torch.save(state, file)


def field_of_model(gaussians: Gaussians, path: Path) -> IdentityField | None:
    """The identities of a model that was trained elsewhere; None without encodings or classifier.

    ``path`` is its .ply, ``classifier.pth`` lies next to it. Raises ``GagaError`` where one of them
    is damaged.
    """
    classifier = path.parent / CLASSIFIER_FILE
    encodings = encodings_of(gaussians) if classifier.is_file() else None
    return None if encodings is None else IdentityField(encodings, *read_classifier(classifier))
