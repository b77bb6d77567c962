"""Files of an association: bank.npz (owners, preset, decision log) and labels.npz."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import get_args

import numpy as np

from gaga_core.arrays import MOST_GROUP, AnyArray, FloatArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.grouping.levels import Levels
from gaga_core.grouping.memory_bank import Decision, MemoryBank, Preset
from gaga_core.io.arrays_file import TEXT, Column, checked, damage, read_arrays, read_columns
from gaga_core.io.files import atomic_write
from gaga_core.io.folder.scene_folder import SceneFolder

_COLUMNS = tuple(field.name for field in fields(Decision))
_ID = Column(np.int64, low=0, high=MOST_GROUP)
_IDS = replace(_ID, shape=("log",))
_FIGURES = Column(np.float64, ("log",))
# Arrays of `bank_arrays`; N Gaussians, L levels.
_BANK = {
    "group": Column(np.int32, ("N",), low=-1, high=MOST_GROUP),
    "n_groups": _ID,
    "preset": replace(TEXT, optional=True),
    "log_view": replace(TEXT, shape=("log",)),
    "log_mask": replace(_IDS, high=None),
    "log_group": _IDS,
    "log_is_new": Column(np.bool_, ("log",)),
    "log_overlap": _FIGURES,
    "log_runner_up": _IDS,
    "log_runner_up_overlap": _FIGURES,
    "log_n_gaussians": replace(_IDS, high=None),
    "log_by_hand": Column(np.bool_, ("log",), optional=True),  # older banks have no such column
    "shared": Column(np.int32, ("S", 2), low=0, optional=True),  # only of preset "released"
    "levels": Column(np.int32, ("L", "N"), low=0, high=MOST_GROUP, optional=True),
    "levels_chosen": Column(np.int64, low=0, below="L", optional=True),
    "levels_background": replace(_ID, optional=True),
}
_GROUPS_CURE = "Run Associate again, or remove it."
_GROUPS = {  # arrays of labels.npz
    "labels": Column(np.int32, ("N",), low=0, high=MOST_GROUP),
    "confidence": Column(np.float32, ("N",), optional=True),
    "weight": Column(np.float32, ("N",), optional=True),
}


def bank_arrays(bank: MemoryBank) -> dict[str, AnyArray]:
    """The bank as named arrays: what `save_bank` writes. No pickles."""
    arrays: dict[str, AnyArray] = {
        "group": bank.group,
        "n_groups": np.array(bank.n_groups),
        "preset": np.array(bank.preset),
    }
    for name in _COLUMNS:
        arrays[f"log_{name}"] = np.array([getattr(d, name) for d in bank.log])
    if len(bank.shared) > 0:
        arrays["shared"] = bank.shared
    if bank.levels is not None:
        arrays["levels"] = bank.levels.labels
        arrays["levels_chosen"] = np.array(bank.levels.chosen)
        arrays["levels_background"] = np.array(bank.levels.background)
    return arrays


def bank_of(arrays: Mapping[str, AnyArray], **lengths: int) -> MemoryBank:
    """The bank of `bank_arrays`; ``KeyError`` or ``ValueError`` when something is missing.

    ``lengths``: N, where the number of Gaussians is known.
    """
    arrays = checked(arrays, _BANK, **lengths)
    n_log = len(arrays[f"log_{_COLUMNS[0]}"])
    arrays = {"log_by_hand": np.zeros(n_log, np.bool_), **arrays}
    columns = [arrays[f"log_{name}"].tolist() for name in _COLUMNS]
    log = tuple(Decision(*row) for row in zip(*columns, strict=True))
    levels = None
    if "levels" in arrays:
        chosen, background = (int(arrays[f"levels_{name}"]) for name in ("chosen", "background"))
        levels = Levels(arrays["levels"], chosen, background)
    shared = arrays.get("shared", np.zeros((0, 2), np.int32))
    if shared[:, :1].max(initial=-1) >= len(arrays["group"]) or shared.max(initial=0) > MOST_GROUP:
        raise ValueError("shared: names a Gaussian or a group that there is not")
    return MemoryBank(
        arrays["group"],
        int(arrays["n_groups"]),
        log,
        preset=_preset_of(arrays, log),
        levels=levels,
        shared=shared,
    )


def bank_digest(bank: MemoryBank) -> str:
    """Digest that identifies the groups of ``bank``: 32 hex digits."""
    state = hashlib.blake2b(np.ascontiguousarray(bank.group, np.int32).tobytes(), digest_size=16)
    state.update(f"{bank.n_groups} {bank.preset}".encode())
    for decision in bank.log:
        state.update(f"{decision.view} {decision.mask} {decision.group};".encode())
    return state.hexdigest()


def _preset_of(arrays: Mapping[str, AnyArray], log: Sequence[Decision]) -> Preset:
    """The preset of a bank. Version 0.1.0 did not store it, but the order of the views tells it:
    "paper" takes them by name, "robust" those with the widest coverage first."""
    if "preset" not in arrays:
        views = list(dict.fromkeys(decision.view for decision in log))
        return "paper" if views == sorted(views) else "robust"
    presets: tuple[Preset, ...] = get_args(Preset)
    for preset in presets:
        if preset == str(arrays["preset"]):
            return preset
    raise ValueError(f"preset: {arrays['preset']} is none of {presets}")


def save_bank(path: Path, bank: MemoryBank) -> None:
    """Write a bank; ``GagaError`` when the place cannot be written."""
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **bank_arrays(bank))  # type: ignore[arg-type]


def load_bank(path: Path, **lengths: int) -> MemoryBank:
    """Read a bank; ``GagaError`` when the file is damaged. ``lengths`` as in `bank_of`."""
    cure = "Run Associate again."
    arrays = read_arrays(path, cure)
    with damage(path, cure):
        return bank_of(arrays, **lengths)


def read_labels(path: Path, n_gaussians: int) -> dict[str, AnyArray]:
    """The ``labels`` (N,) of a labels.npz, and ``confidence`` and ``weight`` (N,) if it has them.

    Raises ``GagaError`` when the file is damaged or of a model with other than ``n_gaussians``.
    """
    arrays = read_columns(path, _GROUPS_CURE, _GROUPS)
    n = len(arrays["labels"])
    if n != n_gaussians:
        raise GagaError(
            f"{path} is of another model ({n:,} splats, not {n_gaussians:,}). {_GROUPS_CURE}"
        )
    return arrays


def read_groups(folder: SceneFolder, n_gaussians: int) -> tuple[IntArray, FloatArray]:
    """Labels and confidence (N,) of the association; ``GagaError`` if there are none that fit."""
    path = folder.work / "labels.npz"
    if not path.is_file():
        raise GagaError(f"There are no groups in {folder.work} yet. Associate the masks first.")
    arrays = read_labels(path, n_gaussians)
    if "confidence" not in arrays:
        raise GagaError(f"{path} has no confidence. {_GROUPS_CURE}")
    return arrays["labels"], arrays["confidence"]
