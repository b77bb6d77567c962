import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from gaga_core.arrays import AnyArray
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.splats.ply import read_ply, write_ply, write_ply_stage
from tests.core.io.splat_parts import write_unchecked
from tests.scenes import random_gaussians

COLUMNS = ("means", "quats", "log_scales", "logit_opacities", "sh")


def rich(n: int = 300, sh_degree: int = 3) -> Gaussians:
    """Splats with unknown columns of several dtypes, comments and odd float bits."""
    gaussians = random_gaussians(n, seed=4, sh_degree=sh_degree)
    gaussians.means[0, 0] = np.float32(-0.0)
    gaussians.logit_opacities[1] = np.inf  # an opacity of exactly 1
    rng = np.random.default_rng(1)
    extra: dict[str, AnyArray] = {
        "nx": rng.normal(size=n).astype(np.float32),
        "ny": rng.normal(size=n).astype(np.float32),
        "nz": rng.normal(size=n).astype(np.float32),
        "obj_dc_0": rng.normal(size=n).astype(np.float32),
        "group": rng.integers(0, 60000, n).astype(np.uint16),
        "quality": rng.normal(size=n),
        "flag": rng.integers(0, 255, n).astype(np.uint8),
    }
    comments = ("SplatRenderMode: mip", "made by a test")
    return replace(gaussians, extra=MappingProxyType(extra), comments=comments)


def assert_same(a: Gaussians, b: Gaussians) -> None:
    for name in COLUMNS:
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), name
    assert list(a.extra) == list(b.extra)
    for name, column in a.extra.items():
        assert column.dtype == b.extra[name].dtype
        assert column.tobytes() == b.extra[name].tobytes(), name
    assert a.comments == b.comments


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3, 4])
def test_what_was_written_is_read_back_bit_for_bit(tmp_path: Path, sh_degree: int) -> None:
    gaussians = rich(sh_degree=sh_degree)
    write_ply(tmp_path / "a.ply", gaussians)
    back = read_ply(tmp_path / "a.ply")
    assert_same(gaussians, back)
    for name in COLUMNS:
        assert getattr(back, name).flags.c_contiguous


def test_standard_columns_stand_where_other_tools_expect_them(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", random_gaussians(10, sh_degree=1))
    header = (tmp_path / "a.ply").read_bytes().split(b"end_header")[0].decode()
    names = [line.split()[-1] for line in header.splitlines() if line.startswith("property")]
    rest = [f"f_rest_{i}" for i in range(9)]
    assert names == [
        *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"),
        *rest,
        *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    ]


def test_rest_coefficients_are_stored_channel_by_channel(tmp_path: Path) -> None:
    gaussians = random_gaussians(5, sh_degree=2)
    write_ply(tmp_path / "a.ply", gaussians)
    raw = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")[1]
    row = np.frombuffer(raw, "<f4").reshape(5, -1)
    # f_rest_0 is at column 9; green starts after the 8 coefficients of red.
    assert np.array_equal(row[:, 9], gaussians.sh[:, 1, 0])
    assert np.array_equal(row[:, 9 + 8], gaussians.sh[:, 1, 1])


def test_mip_look_is_read_from_the_comments() -> None:
    assert rich().is_antialiased
    assert not random_gaussians(3).is_antialiased


def header_of(names: list[str], n: int, extra: str = "") -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {n}"]
    lines += [f"property float {name}" for name in names]
    return ("\n".join(lines) + "\n" + extra + "end_header\n").encode()


GOOD = [*"xyz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
GOOD += [f"rot_{i}" for i in range(4)]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "empty"),
        (b"\x89PNG\r\n\x1a\n" + b"0" * 90, "not a PLY"),
        (b"ply\nformat", "truncated or damaged"),
        (header_of(GOOD, 10) + b"\0" * 100, "truncated or damaged"),
        (header_of(GOOD, 0), "0 splats"),
        (header_of(GOOD[:-4], 1) + b"\0" * 400, "no rot_0, rot_1, rot_2, rot_3 column"),
        (header_of(["x", "y", "z"], 1) + b"\0" * 12, "no 3DGS model"),
        (header_of([*GOOD, "f_rest_0"], 1) + b"\0" * 60, "f_rest"),
        (header_of(GOOD, 3) + np.full(42, np.nan, "<f4").tobytes(), "not finite"),
    ],
)
def test_bad_files_get_one_plain_sentence(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "bad.ply"
    path.write_bytes(content)
    with pytest.raises(GagaError, match=says) as caught:
        read_ply(path)
    assert "bad.ply" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_file_and_folder_are_named(tmp_path: Path) -> None:
    with pytest.raises(GagaError, match="does not exist"):
        read_ply(tmp_path / "none.ply")
    with pytest.raises(GagaError, match="is a folder"):
        read_ply(tmp_path)


def test_a_few_broken_rows_are_left_out(tmp_path: Path) -> None:
    gaussians = random_gaussians(50)
    gaussians.means[7, 1] = np.nan
    gaussians.sh[9, 0, 2] = np.inf
    write_unchecked(tmp_path / "a.ply", gaussians)
    back = read_ply(tmp_path / "a.ply")
    kept = np.delete(np.arange(50), [7, 9])
    assert np.array_equal(back.means, gaussians.means[kept])


def test_ascii_and_big_endian_files_are_read(tmp_path: Path) -> None:
    import plyfile

    gaussians = random_gaussians(20, sh_degree=1)
    write_ply(tmp_path / "a.ply", gaussians)
    data = plyfile.PlyData.read(str(tmp_path / "a.ply"))
    plyfile.PlyData(data.elements, text=True).write(str(tmp_path / "t.ply"))
    plyfile.PlyData(data.elements, byte_order=">").write(str(tmp_path / "b.ply"))
    assert np.array_equal(read_ply(tmp_path / "b.ply").sh, gaussians.sh)
    assert np.allclose(read_ply(tmp_path / "t.ply").means, gaussians.means, rtol=1e-6)


@contextmanager
def file_size_limit(n_bytes: int) -> Iterator[None]:
    """A full disk in small: the system refuses to let files grow past ``n_bytes``."""
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)


def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "a.ply"
    write_ply(target, random_gaussians(10))
    before = target.read_bytes()
    with file_size_limit(20_000), pytest.raises(GagaError, match="disk is full"):
        write_ply(target, random_gaussians(5000))
    assert target.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]


def test_cancel_leaves_nothing(tmp_path: Path) -> None:
    stage = write_ply_stage(tmp_path / "a.ply", random_gaussians(10))
    next(stage)
    stage.close()
    assert list(tmp_path.iterdir()) == []


def test_a_place_without_permission_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(GagaError):
        write_ply(tmp_path / "file" / "a.ply", random_gaussians(3))


def test_real_files_survive_a_round_trip(ycb_table: Path, tmp_path: Path) -> None:
    source = ycb_table / "point_cloud.ply"
    write_ply(tmp_path / "a.ply", read_ply(source))
    assert (tmp_path / "a.ply").read_bytes() == source.read_bytes()
