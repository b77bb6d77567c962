"""An array of a file is what its column says, or it is refused before anything is cast."""

import re
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

import gaga_core
from gaga_core.arrays import MOST_GROUP, AnyArray
from gaga_core.errors import GagaError
from gaga_core.grouping.bank_file import bank_arrays, load_bank, read_labels
from gaga_core.grouping.levels import Levels
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.identity.field import Identity, IdentityField, load_identity, save_identity
from gaga_core.io.arrays_file import TEXT, Column, checked, read_columns
from gaga_core.query.index import GroupIndex, load_index, save_index
from gaga_core.scene.project import groups_of_file
from gaga_core.training.checkpoint import TrainState, load_checkpoint, save_checkpoint
from tests.scenes import random_gaussians

N = 6
_COLUMNS = {
    "ids": Column(np.int32, ("N",), low=0, high=MOST_GROUP),
    "rows": Column(np.int32, ("N",), low=0, below="P"),
    "matrix": Column(np.float64, ("P", 3, 4), low=-1e18, high=1e18),
    "shares": Column(np.float32, ("N",)),
    "sizes": Column(np.float64, ("N",)),
    "flags": Column(np.bool_, ("N",)),
    "count": Column(np.int64, low=0),
    "bytes": Column(np.uint8, ("N", 3)),
    "names": Column(np.str_, ("names",)),
    "mode": TEXT,
}
_GOOD: dict[str, AnyArray] = {
    "ids": np.arange(N, dtype=np.int32),
    "rows": np.array([0, 1, 0, 1, 1, 0], np.int32),
    "matrix": np.tile(np.eye(3, 4), (2, 1, 1)),
    "shares": np.linspace(0, 1, N, dtype=np.float32),
    "sizes": np.linspace(-1, 1, N),
    "flags": np.arange(N) % 2 == 0,
    "count": np.array(7),
    "bytes": np.arange(3 * N, dtype=np.uint8).reshape(N, 3),
    "names": np.array(["a.jpg", "bö.jpg"]),
    "mode": np.array("paper"),
}


def wrong_ones(good: AnyArray, column: Column) -> Mapping[str, AnyArray]:
    """What an array can be instead, none of which is right for any column of text or numbers."""
    shape = good.shape
    found: dict[str, AnyArray] = {
        "complex": np.ones(shape, np.complex128),
        "bytes": np.full(shape, b"x"),
        "date": np.zeros(shape, "M8[s]"),
        "void": np.zeros(shape, "V4"),
        "record": np.zeros(shape, [("a", "f4")]),
        "another shape": np.stack([good, good]),
        "no value": np.zeros((*shape, 0)),
    }
    kind = np.dtype(column.dtype).kind
    if shape:
        found["shorter"] = good[:-1] if kind != "U" else good[:, None]
    if kind == "U":
        return found | {"numbers": np.ones(shape), "no text": np.full(shape, "\ud800")}
    found["text"] = np.full(shape, "1")
    if kind == "b":
        return found | {"numbers": np.ones(shape)}
    for value in (np.nan, np.inf, -np.inf, 1e300, -1e300):
        found[str(value)] = np.full(shape, value)
        if shape:
            found[f"one {value}"] = np.where(
                np.arange(good.size).reshape(shape) == 1, value, good.astype(float)
            )
    if kind in "iu":
        for value in (-(2**63), -(2**31), -5, 2**31 - 1, 2**31, 2**40):
            if column.below or column.high is not None or np.iinfo(column.dtype).max < value:
                found[f"{value}"] = np.full(shape, value)
        found["fraction"] = np.full(shape, 0.5)
    return found


_WRONG = [
    (name, what) for name, column in _COLUMNS.items() for what in wrong_ones(_GOOD[name], column)
    if not (name == "matrix" and what == "shorter")  # no ids then
]  # fmt: skip


@pytest.mark.parametrize(("name", "what"), _WRONG)
def test_what_no_column_allows_is_a_sentence(tmp_path: Path, name: str, what: str) -> None:
    file = tmp_path / "a.npz"
    value = wrong_ones(_GOOD[name], _COLUMNS[name])[what]
    np.savez(file, **(_GOOD | {name: value}))  # type: ignore[arg-type]
    with pytest.raises(GagaError, match=r"a\.npz is damaged.* Again\."):
        read_columns(file, "Again.", _COLUMNS, N=N)


@pytest.mark.parametrize("name", _COLUMNS)
def test_a_missing_array_is_a_sentence_unless_it_may_be(tmp_path: Path, name: str) -> None:
    file = tmp_path / "a.npz"
    np.savez(file, **{n: array for n, array in _GOOD.items() if n != name})  # type: ignore[arg-type]
    with pytest.raises(GagaError, match="damaged"):
        read_columns(file, "", _COLUMNS)
    maybe = Column(_COLUMNS[name].dtype, _COLUMNS[name].shape, optional=True)
    assert name not in read_columns(file, "", {name: maybe})


@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("is_fortran", [False, True])
def test_right_arrays_come_as_they_were(
    tmp_path: Path, order: Literal["little", "big"], is_fortran: bool
) -> None:
    file = tmp_path / "a.npz"
    stored = {name: array.astype(array.dtype.newbyteorder(order)) for name, array in _GOOD.items()}
    if is_fortran:
        stored = {name: np.asfortranarray(array) for name, array in stored.items()}
    stored["count"] = stored["count"].reshape(())
    stored["mode"] = stored["mode"].reshape(())
    np.savez(file, **stored, other=np.zeros(3))  # type: ignore[arg-type]
    found = read_columns(file, "", _COLUMNS)
    assert found.keys() == _GOOD.keys()
    for name, array in found.items():
        assert np.array_equal(array, _GOOD[name])
        assert array.flags.c_contiguous
        if array.dtype.kind != "U":
            assert array.dtype == np.dtype(_COLUMNS[name].dtype)


def test_arrays_without_values_have_no_kind() -> None:
    found = checked(
        {"a": np.zeros(0), "b": np.array([])}, {"a": _COLUMNS["ids"], "b": _COLUMNS["names"]}
    )
    assert found["a"].dtype == np.int32
    assert found["b"].dtype.kind == "U"


@pytest.mark.parametrize(("value", "fits"), [(np.nan, True), (1.0, True), (np.inf, False)])
def test_unknown_values_do_not_lift_limits(value: float, fits: bool) -> None:
    column, rays = Column(np.float64, ("M",), low=-1, high=1, unknown=True), np.array([0.5, value])
    with nullcontext() if fits else pytest.raises(ValueError, match="is not in -1 to 1"):
        assert np.array_equal(column.converted("rays", rays, {}), rays, equal_nan=True)


def test_arrays_are_read_in_one_place_and_nothing_is_unpickled() -> None:
    loads = re.compile(r"\b(?:np|numpy)\.(?:load|memmap|fromfile|genfromtxt)\(|pickle\.loads?\(")
    root = Path(gaga_core.__file__).parents[1]
    files = [file for part in ("gaga_core", "app") for file in (root / part).rglob("*.py")]
    texts = {file.relative_to(root).as_posix(): file.read_text(encoding="utf-8") for file in files}
    readers = {name for name, text in texts.items() if loads.search(text)}
    assert readers == {"gaga_core/io/arrays_file.py"}
    weights = [line for t in texts.values() for line in t.split("\n") if "torch.load(" in line]
    assert len(weights) > 1
    assert all("weights_only=True" in line for line in weights)


# --- every file that we write, each array of it replaced


def _bank(path: Path) -> None:
    log = tuple(Decision(f"{i}.jpg", i, i % 3 + 1, i < 3, 0.3, 0, 0.1, 40) for i in range(5))
    group = (np.arange(N) % 3 + 1).astype(np.int32)
    levels = Levels(np.stack([group, group]), 1, 2)
    bank = MemoryBank(group, 3, log, preset="paper", levels=levels)
    np.savez(path, **bank_arrays(bank))  # type: ignore[arg-type]


def _identity(path: Path) -> None:
    rng = np.random.default_rng(0)
    arrays = (rng.normal(size=size).astype(np.float32) for size in ((N, 16), (4, 16), 4))
    save_identity(
        path, Identity(IdentityField(*arrays), np.ones(N, np.int32), np.ones(N, "f4"), "vote")
    )


def _index(path: Path) -> None:
    groups, pictures = np.arange(N, dtype=np.int32), np.zeros((N, 64, 64, 3), np.uint8)
    save_index(path, GroupIndex("m", groups, groups.astype(int), np.ones((N, 4), "f4"), pictures))


def _labels(path: Path) -> None:
    share = np.ones(N, np.float32)
    np.savez(path, labels=np.ones(N, np.int32), confidence=share, weight=share)


def _training(path: Path) -> None:
    save_checkpoint(path, TrainState.first(random_gaussians(N, sh_degree=1), 2, 9), "d")


_FILES: dict[str, tuple[Callable[[Path], None], Callable[[Path], object]]] = {
    "bank": (_bank, lambda path: load_bank(path, N=N)),
    "identity": (_identity, load_identity),
    "index": (_index, load_index),
    "labels": (_labels, lambda path: read_labels(path, N)),
    "training": (_training, lambda path: load_checkpoint(path, "d", views=2, iterations=9)),
}


@pytest.mark.parametrize("name", _FILES)
def test_each_array_of_our_files_is_checked(tmp_path: Path, name: str) -> None:
    path = tmp_path / "a.npz"
    write, read = _FILES[name]
    write(path)
    assert read(path) is not None
    with np.load(path) as stored:
        whole = dict(stored)
    for key, array in whole.items():
        if key in ("digest", "colors") or array.size == 0:
            continue  # of another run; not read; without values
        wrong = {"shape": np.stack([array, array])}
        if array.dtype.kind != "U":
            wrong |= {"text": np.full(array.shape, "x"), "complex": array.astype(complex)}
        if array.dtype.kind in "iuf" and key != "digests":  # those can be any number
            wrong |= {"nan": np.full(array.shape, np.nan), "huge": np.full(array.shape, 1e300)}
            wrong["low"] = np.full(array.shape, -5 if array.dtype.kind != "f" else -np.inf)
        for value in wrong.values():
            np.savez(path, **(whole | {key: value}))
            with pytest.raises(GagaError, match=r"damaged|another model"):
                read(path)


@pytest.mark.parametrize("top", [MOST_GROUP + 1, 2**31 - 1, 2**40])
def test_high_ids_of_a_column_are_numbered_again(top: int) -> None:
    splats = random_gaussians(N)
    column = np.array([0, -3, top, 5, top, 7], np.int64)
    found = groups_of_file(replace(splats, extra={"group": column}), Path("a.ply"))
    assert found.labels.tolist() == [0, 0, 3, 1, 3, 2]
