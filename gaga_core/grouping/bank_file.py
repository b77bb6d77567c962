"""Files of an association: bank.npz (owners, preset, decision log) and labels.npz."""

import hashlib
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import get_args

import numpy as np

from gaga_core.arrays import AnyArray, FloatArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.grouping.levels import Levels
from gaga_core.grouping.memory_bank import Decision, MemoryBank, Preset
from gaga_core.io.arrays_file import read_arrays
from gaga_core.io.files import atomic_write
from gaga_core.io.folder.scene_folder import SceneFolder

_COLUMNS = tuple(field.name for field in fields(Decision))


def bank_arrays(bank: MemoryBank) -> dict[str, AnyArray]:
    """The bank as named arrays: what `save_bank` writes. No pickles."""
    arrays: dict[str, AnyArray] = {
        "group": bank.group,
        "n_groups": np.array(bank.n_groups),
        "preset": np.array(bank.preset),
    }
    for name in _COLUMNS:
        arrays[f"log_{name}"] = np.array([getattr(d, name) for d in bank.log])
    if bank.levels is not None:
        arrays["levels"] = bank.levels.labels
        arrays["levels_chosen"] = np.array(bank.levels.chosen)
        arrays["levels_background"] = np.array(bank.levels.background)
    return arrays


def bank_of(arrays: dict[str, AnyArray]) -> MemoryBank:
    """The bank of `bank_arrays`; ``KeyError`` or ``ValueError`` when something is missing."""
    n_log = len(arrays[f"log_{_COLUMNS[0]}"])
    arrays = {"log_by_hand": np.zeros(n_log, np.bool_), **arrays}  # older banks have no such column
    columns = [arrays[f"log_{name}"].tolist() for name in _COLUMNS]
    log = tuple(Decision(*row) for row in zip(*columns, strict=True))
    levels = None
    if "levels" in arrays:
        labels = np.ascontiguousarray(arrays["levels"], np.int32)
        if labels.shape[1:] != arrays["group"].shape:
            raise ValueError(f"levels: {labels.shape} is not of {arrays['group'].shape} Gaussians")
        levels = Levels(labels, int(arrays["levels_chosen"]), int(arrays["levels_background"]))
    return MemoryBank(
        np.ascontiguousarray(arrays["group"], np.int32),
        int(arrays["n_groups"]),
        log,
        preset=_preset_of(arrays, log),
        levels=levels,
    )


def bank_digest(bank: MemoryBank) -> str:
    """Digest that identifies the groups of ``bank``: 32 hex digits."""
    state = hashlib.blake2b(np.ascontiguousarray(bank.group, np.int32).tobytes(), digest_size=16)
    state.update(f"{bank.n_groups} {bank.preset}".encode())
    for decision in bank.log:
        state.update(f"{decision.view} {decision.mask} {decision.group};".encode())
    return state.hexdigest()


def _preset_of(arrays: dict[str, AnyArray], log: Sequence[Decision]) -> Preset:
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


def load_bank(path: Path) -> MemoryBank:
    """Read a bank; ``GagaError`` when the file is damaged."""
    arrays = read_arrays(path, "Run Associate again.")
    try:
        return bank_of(arrays)
    except (ValueError, KeyError, TypeError) as error:
        raise GagaError(f"{path} is damaged. Run Associate again.") from error


def read_groups(folder: SceneFolder, n_gaussians: int) -> tuple[IntArray, FloatArray]:
    """Labels and confidence (N,) of the association; ``GagaError`` if there are none that fit."""
    path = folder.work / "labels.npz"
    if not path.is_file():
        raise GagaError(f"There are no groups in {folder.work} yet. Associate the masks first.")
    arrays = read_arrays(path, "Associate the masks again.")
    if not {"labels", "confidence"} <= set(arrays):
        raise GagaError(f"{path} is damaged. Associate the masks again.")
    labels = arrays["labels"].astype(np.int32)
    confidence = arrays["confidence"].astype(np.float32)
    if labels.shape != (n_gaussians,) or confidence.shape != (n_gaussians,):
        raise GagaError(
            f"{path} is for {len(labels)} Gaussians, the model has {n_gaussians}. "
            "Associate the masks again."
        )
    return labels, confidence
