"""Splat files of other programs, made byte by byte: what is read, and what is not believed."""

import gzip
import json
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zstandard

from gaga_core.color import SH_C0
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.splats.splat_files import read_splats
from gaga_core.io.splats.spz import states_axes
from gaga_core.progress import run_stage
from gaga_core.scene.project import open_path_stage
from tests.core.io.splat_parts import sog_parts, zipped


def test_a_splat_record_is_read_as_its_author_wrote_it(tmp_path: Path) -> None:
    record = struct.pack("<6f", 1, 2, 3, 0.1, 0.2, 0.4) + bytes(
        [255, 128, 0, 64, 192, 128, 64, 128]
    )
    (tmp_path / "a.splat").write_bytes(record)
    g = read_splats(tmp_path / "a.splat")
    np.testing.assert_allclose(g.means, [[1, 2, 3]])
    np.testing.assert_allclose(g.scales, [[0.1, 0.2, 0.4]], rtol=1e-6)
    np.testing.assert_allclose(g.sh[0, 0] * SH_C0 + 0.5, [1, 128 / 255, 0], atol=1e-6)
    np.testing.assert_allclose(g.opacities, [64 / 255], atol=1e-6)
    np.testing.assert_allclose(g.quats, [[0.5**0.5, 0, -(0.5**0.5), 0]], atol=1e-6)


def spz_sections() -> bytes:
    """One splat: at (1, -2, 0.5), half opaque, grey, SH of degree 1."""
    fixed = b"".join(int(v * 4096).to_bytes(3, "little", signed=True) for v in (1, -2, 0.5))
    word = (3 << 30) | (511 << 20)  # w largest, x = sqrt(1/2), so w = x
    sh = bytes([128 + 64, 128, 128, 128, 128 + 32, 128, 128, 128, 128 - 16])
    return (
        fixed
        + bytes([128])
        + bytes([127, 128, 255])
        + bytes([160, 0, 112])
        + struct.pack("<I", word)
        + sh
    )


def check_spz(g: Gaussians, *, has_other_axes: bool = False) -> None:
    """The splat of `spz_sections`, in our axes or in right, up, back."""
    flip = np.array([1, -1, -1]) if has_other_axes else np.ones(3)
    np.testing.assert_allclose(g.means, [[1, -2, 0.5]] * flip)
    np.testing.assert_allclose(g.log_scales, [[0, -10, -3]])
    np.testing.assert_allclose(g.opacities, [128 / 255], atol=1e-6)
    np.testing.assert_allclose(g.sh[0, 0, 2], 0.5 / 0.15, rtol=1e-6)
    np.testing.assert_allclose(g.quats, [[0.5**0.5, 0.5**0.5, 0, 0]], atol=1e-6)
    bands = flip[[1, 2, 0]]  # the basis functions of degree 1 are -y, z, -x
    np.testing.assert_allclose(g.sh[0, 1:], np.diag([0.5, 0.25, -0.125]) * bands[:, None])
    assert g.is_antialiased


def test_spz_of_version_3_and_4_from_its_bytes(tmp_path: Path) -> None:
    path = tmp_path / "a.spz"
    head = struct.pack("<IIIBBBB", 0x5053474E, 3, 1, 1, 12, 1, 0)
    path.write_bytes(gzip.compress(head + spz_sections()))
    check_spz(read_splats(path))
    path.write_bytes(head + spz_sections())  # nor does it have to be packed
    check_spz(read_splats(path))
    assert not states_axes(path)
    for number, other in ((4, True), (6, False), (0, True)):
        record = struct.pack("<IIIII", 0x12340001, 0, 0xADBE0003, 4, number)
        head = struct.pack("<IIIBBBB", 0x5053474E, 3, 1, 1, 12, 1 | 2, 0)
        for pack in (gzip.compress, bytes):
            path.write_bytes(pack(head + spz_sections() + record))
            assert states_axes(path)
            check_spz(read_splats(path), has_other_axes=other)
    path.write_bytes(head + spz_sections() + struct.pack("<III", 0xADBE0003, 4, 17))
    with pytest.raises(GagaError, match="axes of an unknown kind"):
        read_splats(path)
    path.write_bytes(head + spz_sections() + struct.pack("<II", 0xADBE0003, 4))
    with pytest.raises(GagaError, match="extensions do not fit"):
        read_splats(path)
    raw, parts = spz_sections(), []
    for size in (9, 1, 3, 3, 4, 9):
        parts.append(raw[:size])
        raw = raw[size:]
    packed = [zstandard.ZstdCompressor().compress(part) for part in parts]
    table = b"".join(struct.pack("<QQ", len(p), len(q)) for p, q in zip(packed, parts, strict=True))
    for axes, other in ((b"", False), (struct.pack("<III", 0xADBE0003, 4, 4), True)):
        extension = struct.pack("<II", 0xADBE0002, 4) + bytes(4) + axes
        toc = 32 + len(extension)
        head = struct.pack("<IIIBBBBI12x", 0x5053474E, 4, 1, 1, 12, 1 | 2, 6, toc)
        path.write_bytes(head + extension + table + b"".join(packed))
        check_spz(read_splats(path), has_other_axes=other)


def test_spz_of_version_2_has_three_bytes_a_rotation(tmp_path: Path) -> None:
    raw = spz_sections()
    head = struct.pack("<IIIBBBB", 0x5053474E, 2, 1, 0, 12, 0, 0)
    path = tmp_path / "a.spz"
    path.write_bytes(gzip.compress(head + raw[:16] + bytes([255, 127, 127])))
    g = read_splats(path)
    np.testing.assert_allclose(np.abs(g.quats), [[0, 1, 0, 0]], atol=0.01)
    assert not g.is_antialiased


def test_a_sog_is_read_from_a_zip_and_from_a_folder(tmp_path: Path) -> None:
    for name, content in sog_parts().items():
        (tmp_path / name).write_bytes(content)
    sources = [zipped(tmp_path / "a.sog", sog_parts()), tmp_path, tmp_path / "meta.json"]
    for source in sources:
        g = read_splats(source)
        np.testing.assert_allclose(g.means[0], np.expm1([1, 2, 3]), rtol=1e-6)
        np.testing.assert_allclose(g.means[1], 0)
        np.testing.assert_allclose(g.quats[0], [0.5**0.5, 0.5**0.5, 0, 0], atol=5e-3)
        np.testing.assert_allclose(g.quats[1], [0, 0, 0, 1], atol=5e-3)
        np.testing.assert_allclose(g.log_scales[0], [0, -0.01, -0.02], atol=1e-7)
        np.testing.assert_allclose(g.sh[0, 0], [0.1, 0.2, 0.3], atol=1e-7)
        np.testing.assert_allclose(g.sh[0, 2], [0.01, 0.02, 0.03], atol=1e-7)
        assert not g.sh[1, 1:].any()
        np.testing.assert_allclose(g.opacities, [128 / 255, 1], atol=1e-5)
        assert len(run_stage(open_path_stage(source)).scene) == 2


def _claims(n: int) -> bytes:
    return gzip.compress(struct.pack("<IIIBBBB", 0x5053474E, 3, n, 3, 12, 0, 0) + bytes(400))


def _claims_4(n: int) -> bytes:
    head = struct.pack("<IIIBBBBI12x", 0x5053474E, 4, n, 0, 12, 0, 5, 32)
    widths = (9, 1, 3, 3, 4)
    streams = [zstandard.ZstdCompressor().compress(bytes(100)) for _ in widths]
    table = b"".join(
        struct.pack("<QQ", len(s), n * w) for s, w in zip(streams, widths, strict=True)
    )
    return head + table + b"".join(streams)


def _huge_sog(parts: dict[str, bytes]) -> dict[str, bytes]:
    meta = json.loads(parts["meta.json"])
    meta["count"] = 200_000_000
    return {**parts, "meta.json": json.dumps(meta).encode()}


def _bomb(parts: dict[str, bytes]) -> dict[str, bytes]:
    return {**parts, "l.webp": bytes(1 << 28)}


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("a.spz", lambda p: p.write_bytes(_claims(4_000_000_000))),
        ("b.spz", lambda p: p.write_bytes(_claims_4(500_000))),
        ("a.sog", lambda p: zipped(p, _huge_sog(sog_parts()))),
        ("b.sog", lambda p: zipped(p, _bomb(sog_parts()))),
        ("a.splat", lambda p: p.write_bytes(b"x" * 33)),
        ("b.splat", lambda p: p.write_bytes(b"\xff" * 3200)),
        ("c.spz", lambda p: p.write_bytes(b"")),
        ("d.spz", lambda p: p.write_bytes(_claims(0))),
    ],
)
def test_promises_are_not_believed(
    tmp_path: Path, name: str, make: Callable[[Path], object]
) -> None:
    make(tmp_path / name)
    tracemalloc.start()
    with pytest.raises(GagaError) as refused:
        read_splats(tmp_path / name)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert "\n" not in str(refused.value)
    assert peak < 250e6
