"""Every form of splat file: what comes back is what went in, within what the form rounds."""

import gzip
import json
import struct
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from gaga_core.cli.main import main
from gaga_core.color import SH_C0, sh_basis
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.masks.coco import decode_rle
from gaga_core.io.splats.splat_files import (
    SplatFormat,
    form_of,
    losses,
    read_splats,
    write_splats,
    write_splats_stage,
)
from gaga_core.io.splats.spz import AXES, axes_map, fraction_bits, states_axes, turned
from gaga_core.progress import run_stage
from tests.core.io.splat_parts import angles, covariances, write_unchecked
from tests.peer_tools import node_tool
from tests.scenes import random_gaussians

COMPACT = [SplatFormat.COMPRESSED_PLY, SplatFormat.SPLAT, SplatFormat.SPZ, SplatFormat.SPZ4]
_SQRT2 = float(np.sqrt(2))


def written(folder: Path, gaussians: Gaussians, form: SplatFormat) -> Path:
    path = folder / f"a{form.suffix}"
    write_splats(path, gaussians, form)
    return path


def round_trip(folder: Path, gaussians: Gaussians, form: SplatFormat) -> Gaussians:
    return read_splats(written(folder, gaussians, form))


def in_order_of(back: Gaussians, gaussians: Gaussians, form: SplatFormat) -> Gaussians:
    """``back`` with its rows matched to ``gaussians`` by the nearest centre (compressed PLY)."""
    if form is not SplatFormat.COMPRESSED_PLY:
        return back
    d = np.linalg.norm(gaussians.means[:, None] - back.means[None], axis=2)
    nearest = d.argmin(axis=1)
    assert len(set(nearest.tolist())) == len(back)
    return back.take(nearest)


def opacity_error(a: Gaussians, b: Gaussians) -> float:
    return float(np.abs(a.opacities - b.opacities).max())


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("form", COMPACT)
def test_a_round_trip_stays_within_the_steps_of_the_form(
    tmp_path: Path, form: SplatFormat, seed: int
) -> None:
    degree = (3, 0, 2, 1)[seed]
    extent = (1.0, 30.0, 0.02, 700.0)[seed]
    whole = random_gaussians(300, seed=seed, sh_degree=degree, extent=extent)
    sh = np.clip(whole.sh, -0.98, 0.98)
    whole = replace(whole, sh=sh, log_scales=np.clip(whole.log_scales, -9.9, 5.8))
    back = in_order_of(round_trip(tmp_path, whole, form), whole, form)
    spread = np.ptp(whole.means, axis=0).max()
    sizes = np.ptp(whole.log_scales, axis=0).max()
    colors = np.ptp(whole.sh[:, 0], axis=0).max()
    tiny = 1e-6 * max(extent, 1)
    # Half a step each: of positions, log sizes, DC, and what rotations may turn (radians).
    bits = fraction_bits(whole.means)
    steps = {
        SplatFormat.SPLAT: (0.0, 1e-6, 0.5 / 255 / SH_C0, 0.02),
        SplatFormat.COMPRESSED_PLY: (spread / 2046, sizes / 2046, colors / 510, 6 * _SQRT2 / 2046),
        SplatFormat.SPZ: (2.0**-bits / 2, 1 / 32, 0.5 / 255 / 0.15, 6 * _SQRT2 / 1022),
    }
    means, logs, dc, turn = steps[SplatFormat.SPZ if form is SplatFormat.SPZ4 else form]
    assert np.abs(back.means - whole.means).max() <= means + tiny
    assert np.abs(back.log_scales - whole.log_scales).max() <= logs + 1e-5
    assert np.abs(back.sh[:, 0] - whole.sh[:, 0]).max() <= dc + 1e-5
    assert angles(back.quats, whole.quats).max() <= turn
    assert opacity_error(back, whole) <= 0.5 / 255 + 1e-6
    if form is SplatFormat.SPLAT:
        assert back.sh_degree == 0
    elif degree:
        first, more = (4.01, 4.01) if form is SplatFormat.COMPRESSED_PLY else (4.51, 8.51)
        unit = 8 / 256 / 8 if form is SplatFormat.COMPRESSED_PLY else 1 / 128
        error = np.abs(back.sh[:, 1:] - whole.sh[:, 1:])
        assert error[:, :3].max() <= first * unit
        assert error[:, 3:].max(initial=0) <= more * unit


@pytest.mark.parametrize("form", COMPACT)
def test_what_was_rounded_once_is_not_rounded_again(tmp_path: Path, form: SplatFormat) -> None:
    once = round_trip(tmp_path, random_gaussians(700, seed=3, sh_degree=2), form)
    twice = round_trip(tmp_path, once, form)
    if form is SplatFormat.COMPRESSED_PLY:  # the order may change again within a box
        twice = in_order_of(twice, once, form)
    np.testing.assert_allclose(twice.means, once.means, atol=1e-3)
    np.testing.assert_allclose(twice.sh, once.sh, atol=1e-2)
    np.testing.assert_allclose(twice.opacities, once.opacities, atol=1e-6)


@pytest.mark.parametrize("form", [SplatFormat.SPZ, SplatFormat.SPZ4])
def test_spz_is_written_in_our_axes_and_says_so(tmp_path: Path, form: SplatFormat) -> None:
    g = random_gaussians(50, seed=2, sh_degree=4)
    path = tmp_path / "a.spz"
    write_splats(path, g, form)
    assert states_axes(path)
    data = path.read_bytes() if form is SplatFormat.SPZ4 else gzip.decompress(path.read_bytes())
    assert struct.pack("<III", 0xADBE0003, 4, 6) in data
    np.testing.assert_allclose(read_splats(path).means, g.means, atol=1e-3)


@pytest.mark.parametrize("axes", AXES[1:])
def test_every_axes_show_the_same_scene(axes: str) -> None:
    """Turned to ours, covariances and colors are those of the scene in the file's axes."""
    g = random_gaussians(40, seed=5, sh_degree=4)
    ours = turned(g, axes)
    matrix = axes_map(axes)
    np.testing.assert_allclose(ours.means, g.means @ matrix.T, atol=1e-6)
    there, here = covariances(g), covariances(ours)
    np.testing.assert_allclose(here, matrix @ there @ matrix.T, atol=1e-4 * np.abs(there).max())
    direction = np.array([[0.6, -0.64, 0.48]])
    before = np.einsum("s,nsc->nc", sh_basis(direction, 4)[0], g.sh)
    after = np.einsum("s,nsc->nc", sh_basis(direction @ matrix.T, 4)[0], ours.sh)
    np.testing.assert_allclose(after, before, atol=1e-5)
    names = {"R": (0, 1), "L": (0, -1), "D": (1, 1), "U": (1, -1), "F": (2, 1), "B": (2, -1)}
    for file_axis, letter in enumerate(axes):
        row, sign = names[letter]
        assert matrix[row, file_axis] == sign


@pytest.mark.parametrize(
    "form", [SplatFormat.SPZ, SplatFormat.SPZ4, SplatFormat.COMPRESSED_PLY, SplatFormat.SOG]
)
def test_the_antialiased_look_survives(tmp_path: Path, form: SplatFormat) -> None:
    mip = replace(random_gaussians(20), comments=("SplatRenderMode: mip",))
    assert round_trip(tmp_path, mip, form).is_antialiased
    assert not round_trip(tmp_path, random_gaussians(20), form).is_antialiased


def test_the_sentences_name_what_is_lost(tmp_path: Path) -> None:
    g = random_gaussians(30, sh_degree=3)
    extra = {"group": np.arange(30, dtype=np.int32), "nx": np.zeros(30, np.float32)}
    g = replace(g, extra=MappingProxyType(extra), comments=("antialiased 1",))
    assert losses(g, SplatFormat.PLY) == ()
    said = " ".join(losses(g, SplatFormat.SPLAT))
    assert "degree 3" in said
    assert "group" in said
    assert "normals" not in said
    assert "antialiased" in said
    assert "metre" not in said
    assert "metre" in " ".join(losses(g.with_metres(), SplatFormat.SPLAT))
    g.sh[3, 5, 1] = 2.0
    assert "1 splat." in " ".join(losses(g, SplatFormat.SPZ))
    assert "clipped" not in " ".join(losses(g, SplatFormat.COMPRESSED_PLY))


def test_names_ask_for_forms() -> None:
    names = ("a.ply", "a.compressed.ply", "A.SPLAT", "b.c.spz", "d.sog", "e.GLB", "f/meta.json")
    assert [form_of(Path(n)) for n in names] == [
        SplatFormat.PLY, SplatFormat.COMPRESSED_PLY, SplatFormat.SPLAT, SplatFormat.SPZ,
        SplatFormat.SOG, SplatFormat.GLB, SplatFormat.SOG,
    ]  # fmt: skip
    with pytest.raises(GagaError, match="choose a name"):
        form_of(Path("a.ksplat"))


@pytest.mark.parametrize("form", list(SplatFormat))
def test_a_cancelled_export_leaves_the_former_file(tmp_path: Path, form: SplatFormat) -> None:
    path = tmp_path / f"a{form.suffix}"
    path.write_bytes(b"before")
    stage = write_splats_stage(path, random_gaussians(70_000), form)
    steps = [next(stage), next(stage)]
    stage.close()
    assert steps
    assert path.read_bytes() == b"before"
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_a_file_is_known_by_what_it_holds(tmp_path: Path) -> None:
    path = written(tmp_path, random_gaussians(40), SplatFormat.SPZ)
    other = path.rename(tmp_path / "wrong.ply")
    assert len(read_splats(other)) == 40
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(GagaError, match="not a splat file"):
        read_splats(tmp_path / "notes.txt")


def test_commands_write_what_the_name_asks_for_and_say_what_is_lost(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    g = random_gaussians(60, sh_degree=1)
    labels = {"group": np.arange(60, dtype=np.int32) % 2 + 1}
    write_splats(tmp_path / "a.ply", replace(g, extra=MappingProxyType(labels)))
    source, target = str(tmp_path / "a.ply"), tmp_path / "b.splat"
    assert main(["export", source, "--out", str(target)]) == 0
    assert "degree 1" in capsys.readouterr().err
    assert len(read_splats(target)) == 60
    objects = tmp_path / "objects"
    command = ["export", source, "--out", str(objects), "--what", "objects", "--form", "spz4"]
    assert main([*command, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == 2
    files = [entry["file"] for entry in json.loads((objects / "groups.json").read_text())["groups"]]
    assert [len(read_splats(objects / name)) for name in files] == [30, 30]
    assert main(["export", source, "--out", str(tmp_path / "b.obj")]) == 1
    assert "choose a name" in capsys.readouterr().err
    assert main(["info", str(target), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["gaussians"] == 60


def test_splats_that_are_no_numbers_are_left_out(tmp_path: Path) -> None:
    g = random_gaussians(100)
    g.means[7] = np.nan
    write_unchecked(tmp_path / "a.splat", g)
    assert len(read_splats(tmp_path / "a.splat")) == 99


READ = tuple(form for form in SplatFormat if form is not SplatFormat.HTML)


@pytest.mark.parametrize("form", READ)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3e38, 1e19])
def test_numbers_that_no_reader_takes_are_not_written(
    tmp_path: Path, form: SplatFormat, value: float
) -> None:
    for column in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        g = random_gaussians(100)
        getattr(g, column).reshape(100, -1)[7, -1] = value
        if column == "logit_opacities" and not np.isnan(value):
            continue  # legal: an opacity of exactly 0 or 1
        with pytest.raises(GagaError, match="is not written: 1 of 100 splats"):
            write_splats(tmp_path / f"a{form.suffix}", g, form)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("form", READ)
def test_rotations_of_no_length_are_written_as_none_and_said(
    tmp_path: Path, form: SplatFormat, caplog: pytest.LogCaptureFixture
) -> None:
    g = random_gaussians(9000)
    g.quats[5000:5004] = 0
    file = written(tmp_path, g, form)
    assert "4 rotations of no length were set to none" in caplog.text
    assert not g.quats[5000:5004].any(), "what is open stays"
    caplog.clear()
    back = read_splats(file)
    assert "of no length" not in caplog.text
    near = np.linalg.norm(back.means[:, None] - g.means[5000:5004], axis=2).argmin(axis=0)
    assert angles(back.quats[near], np.tile([1.0, 0, 0, 0], (4, 1))).max() < 0.05


@pytest.mark.skipif(find_spec("gsply") is None, reason="gsply (extra dev) is not installed")
def test_gsply_reads_and_writes_the_same(tmp_path: Path) -> None:
    """In a process of its own: its kernels run with numba's own threads."""
    g = random_gaussians(500, seed=8, sh_degree=3)
    ours = {
        form: written(tmp_path, g, form) for form in (SplatFormat.SPZ, SplatFormat.COMPRESSED_PLY)
    }
    ours[SplatFormat.SPZ4] = tmp_path / "four.spz"
    write_splats(ours[SplatFormat.SPZ4], g, SplatFormat.SPZ4)
    code = f"""
import gsply, numpy as np
for path, read in {[(str(p), "plyread" if p.suffix == ".ply" else "spz") for p in ours.values()]}:
    data = gsply.plyread(path) if read == "plyread" else gsply.read_spz(path)
    np.savez(path + ".npz", means=data.means, scales=data.scales, quats=data.quats,
             opacities=np.ravel(data.opacities), sh0=data.sh0, shN=data.shN)
"""
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    for path in ours.values():
        mine = read_splats(path)
        theirs = dict(np.load(f"{path}.npz"))
        np.testing.assert_allclose(mine.means, theirs["means"], atol=1e-5)
        np.testing.assert_allclose(mine.log_scales, theirs["scales"], atol=1e-5)
        np.testing.assert_allclose(mine.sh[:, 0], theirs["sh0"], atol=1e-5)
        assert angles(mine.quats, theirs["quats"]).max() < 2e-3
        opacities = 1 / (1 + np.exp(-theirs["opacities"]))
        np.testing.assert_allclose(mine.opacities, opacities, atol=1e-4)
        rest = theirs["shN"].reshape(500, -1, 3)
        np.testing.assert_allclose(mine.sh[:, 1:], rest, atol=0.016)


_TRANSFORM = node_tool("@playcanvas/splat-transform/bin/cli.mjs")


@pytest.mark.skipif(_TRANSFORM is None, reason="splat-transform is not installed (make peers)")
def test_splat_transform_reads_and_writes_the_same_spz(tmp_path: Path) -> None:
    """Ours to its .ply, and its .spz of that to ours: the same axes there and back."""
    assert _TRANSFORM is not None
    g = random_gaussians(300, seed=8, sh_degree=2)
    ours, ply, theirs = tmp_path / "ours.spz", tmp_path / "their.ply", tmp_path / "their.spz"
    write_splats(ours, g, SplatFormat.SPZ)
    for source, target in ((ours, ply), (ply, theirs)):
        call = [*_TRANSFORM, "-w", str(source), str(target)]
        subprocess.run(call, check=True, capture_output=True, timeout=120)
    mine = read_splats(ours)
    for back in (read_splats(ply), read_splats(theirs)):
        nearest = np.linalg.norm(mine.means[:, None] - back.means[None], axis=2).argmin(axis=1)
        other = back.take(nearest)
        np.testing.assert_allclose(other.means, mine.means, atol=2e-3)
        np.testing.assert_allclose(other.log_scales, mine.log_scales, atol=0.04)
        np.testing.assert_allclose(other.sh, mine.sh, atol=0.05)
        assert angles(mine.quats, other.quats).max() < 0.01
    assert not states_axes(theirs)


# --- A file that another program cuts while it is read ends in one sentence, never in a signal.


# In a process of its own: reading mapped pages behind the end of a file is a SIGBUS.
_READ = """
import os, sys
from pathlib import Path
from gaga_core.errors import GagaError
from gaga_core.io.splats.splat_files import read_splats_stage

path, step = Path(sys.argv[1]), int(sys.argv[2])
stage = read_splats_stage(path)
try:
    for _ in range(step):
        next(stage)
    os.truncate(path, path.stat().st_size // 3)
    while True:
        next(stage)
except GagaError as error:
    print("refused:", error)
except StopIteration as end:
    print("read:", len(end.value), bool((end.value.means != 0).any(axis=1).all()))
"""


@pytest.mark.parametrize("name", ["a.ply", "a.compressed.ply", "a.splat", "a.spz"])
@pytest.mark.parametrize("step", [1, 2])
def test_a_file_cut_while_it_is_read(tmp_path: Path, name: str, step: int) -> None:
    n = 70_000
    path = tmp_path / name
    run_stage(write_splats_stage(path, random_gaussians(n)))
    done = subprocess.run(
        [sys.executable, "-c", _READ, str(path), str(step)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    answer = done.stdout.strip()
    assert answer.startswith("refused: ") or answer == f"read: {n} True"


@pytest.mark.parametrize(
    ("counts", "size"),
    [
        ([2**62, 2**62, 2**62, 2**62, 768], (24, 32)),  # adds up to 768 in 64 bits
        ([2**63 - 1, 2**63 - 1, 770], (24, 32)),
        ([2**62], (2**31, 2**31)),
        ([768], (-24, -32)),
        ([np.iinfo(np.int64).max], (24, 32)),
    ],
)
def test_runs_that_wrap_around_are_refused(counts: list[int], size: tuple[int, int]) -> None:
    with pytest.raises(GagaError):
        decode_rle(counts, size)
