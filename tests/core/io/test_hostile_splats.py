"""Splats made to do harm: each ends in one sentence, or in numbers that can be computed with."""

import gzip
import json
import os
import struct
import tracemalloc
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.export.export import export_scene_stage
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import check_memory
from gaga_core.io.splats import glb, packing
from gaga_core.io.splats.ply import read_ply, write_ply
from gaga_core.io.splats.splat_files import read_splats, write_splats
from gaga_core.io.splats.spz import AXES
from gaga_core.progress import run_stage
from gaga_core.scene.lod.build import build_lod_stage
from gaga_core.scene.lod.tree import NODES, ORDER, level_file, open_lod, row_type
from gaga_core.scene.project import open_path_stage
from tests.core.io.splat_parts import ksplat, sog_parts, write_unchecked, zipped
from tests.scenes import random_gaussians

N = 9
FLOATS = ["nan", "inf", "-inf", "3.4e38", "-3.4e38", "1e25", "sNaN"]
SIGNALING = np.uint32(0x7FA00000)


def bytes_of(text: str) -> bytes:
    return SIGNALING.tobytes() if text == "sNaN" else struct.pack("<f", float(text))


def read_sane(path: Path) -> Gaussians | None:
    """What a file holds, without a warning, in numbers whose squares add up; None when refused."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            g = read_splats(path)
        except GagaError:
            return None
        for column in (g.means, g.quats, g.log_scales, g.sh):
            assert np.isfinite(np.square(column).sum())
        assert not np.isnan(g.logit_opacities).any()
        assert np.isfinite(np.square(g.scales)).all()
        assert g.quats.any(axis=1).all()
    return g


# --- headers


HEAD = "ply\nformat {form} 1.0\n{elements}end_header\n"
SOG_PARTS = ("means", "quats", "scales", "sh0", "shN")
PACKED = [f"property uint packed_{k}\n" for k in ("position", "rotation", "scale", "color")]
XYZ = "".join(f"property float {axis}\n" for axis in "xyz")


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize(
    "elements",
    [
        "element vertex -1\n",
        "element vertex 2\n",
        "element a -3\nelement vertex 1\n" + XYZ,
        f"element vertex {2**63}\n" + XYZ,
        f"element vertex {10**30}\n" + XYZ,
        f"element a {10**17}\nelement vertex 1\n" + XYZ,
        "element vertex 1.5\n" + XYZ,
        "element vertex\n" + XYZ,
        "element vertex 1\nelement vertex 2\n" + XYZ,
        "element vertex 1\nproperty list uchar float x\n" + XYZ,
        "element face 9\nproperty list uint int i\nelement vertex 1\n" + XYZ,
        "element vertex 1\nproperty\n",
        "element vertex 1\nproperty long x\n",
        "property float x\nelement vertex 1\n",
        "element chunk 1\nproperty list uchar float packed_position\nelement vertex 1\n" + XYZ,
        "element vertex 1\nproperty list uchar uint packed_position\n",
        "element chunk 0\nelement vertex 1\n" + "".join(PACKED),
        f"element chunk {2**40}\nproperty float packed_position\nelement vertex 1\n" + XYZ,
    ],
)
def test_headers_that_cannot_be_are_refused(tmp_path: Path, form: str, elements: str) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(HEAD.format(form=form, elements=elements).encode() + bytes(64))
    assert read_sane(path) is None


@pytest.mark.parametrize("header", ["<", ">"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_numbers_of_the_other_byte_order_are_read_right(
    tmp_path: Path, header: str, order: str, caplog: pytest.LogCaptureFixture
) -> None:
    path, g = tmp_path / "a.ply", random_gaussians(300, sh_degree=1)
    write_ply(path, g)
    head, _, body = path.read_bytes().partition(b"end_header\n")
    if header == ">":
        head = head.replace(b"little", b"big")
    body = np.frombuffer(body, "<f4").astype(f"{order}f4").tobytes()
    path.write_bytes(head + b"end_header\n" + body)
    assert np.array_equal(read_ply(path).sh, g.sh)
    assert ("byte order" in caplog.text) == (header != order)


def test_signaling_numbers_among_columns_of_unlike_types_do_not_warn(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    write_ply(path, random_gaussians(300, sh_degree=0))
    head, _, body = path.read_bytes().partition(b"end_header\n")
    names = [line.split()[-1] for line in head.decode().splitlines() if "property" in line]
    kinds = [(name, "<f8" if name == "scale_0" else "<f4") for name in names]
    rows = np.zeros(300, np.dtype(kinds))
    for name, column in zip(names, np.frombuffer(body, "<f4").reshape(300, -1).T, strict=True):
        rows[name] = column
    rows["scale_1"].view("<u4")[::2] = SIGNALING
    head = head.replace(b"float scale_0", b"double scale_0")
    path.write_bytes(head + b"end_header\n" + rows.tobytes())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(read_ply(path)) == 150


# --- numbers


@pytest.mark.parametrize("value", FLOATS)
@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_each_column_of_a_ply_with_a_wrong_number_loses_its_row(
    tmp_path: Path, value: str, kind: str, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.ply"
    write_ply(path, random_gaussians(N, sh_degree=1))
    head, _, body = path.read_bytes().partition(b"end_header\n")
    names = [line.split()[-1] for line in head.decode().splitlines() if "property" in line]
    head = head.replace(b"float", b"double") if kind == "f8" else head
    for i, name in enumerate(names):
        rows = np.frombuffer(body, "<f4").reshape(N, -1).astype(kind)
        if value == "sNaN" and kind == "f4":
            rows.view(np.uint32)[4, i] = SIGNALING
        else:
            rows[4, i] = 1e300 if (kind, value) == ("f8", "1e25") else float(value.lstrip("s"))
        path.write_bytes(head + b"end_header\n" + rows.tobytes())
        caplog.clear()
        found = read_sane(path)
        is_legal = name.startswith("n") or (name == "opacity" and "nan" not in value.lower())
        assert found is not None
        assert len(found) == N - (not is_legal), (name, value)
        assert ("left out" in caplog.text) == (not is_legal)


def test_sizes_beyond_all_range_and_rotations_of_no_length_are_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    g = random_gaussians(N)
    g.log_scales[2, 1] = 50.5
    g.quats[3:5] = 0
    write_unchecked(tmp_path / "a.ply", g)
    found = read_sane(tmp_path / "a.ply")
    assert found is not None
    assert found.quats[2:4].tolist() == [[1, 0, 0, 0]] * 2
    assert len(found) == N - 1
    assert "1 splat with" in caplog.text
    assert "2 rotations of no length" in caplog.text


def made(folder: Path, name: str) -> bytes:
    path = folder / name
    if name.endswith(".ksplat"):
        return ksplat(int(name[0]), 1)[0]
    write_splats(path, random_gaussians(N, sh_degree=1))
    return path.read_bytes()


@pytest.mark.parametrize("value", FLOATS)
@pytest.mark.parametrize(
    ("name", "start", "step"),
    [
        ("a.splat", 0, 4),
        ("a.glb", -1, 4),
        ("0.ksplat", 5136, 4),
        ("1.ksplat", 4112, 4),
        ("1.ksplat", 5120, 2),
        ("2.ksplat", 36, 4),
        ("a.compressed.ply", -1, 4),
        ("a.ply", -1, 4),
    ],
)
def test_no_float_of_any_format_gets_through(
    tmp_path: Path, name: str, start: int, step: int, value: str
) -> None:
    """The wrong number at every place in turn, from the first after the header on."""
    good = made(tmp_path, name)
    marks = {"a.glb": b"BIN\0", "a.ply": b"end_header\n", "a.compressed.ply": b"end_header\n"}
    if start < 0:
        start = good.index(marks[name]) + len(marks[name])
    for at in range(start, min(len(good) - 3, start + 400), step):
        (tmp_path / name).write_bytes(good[:at] + bytes_of(value) + good[at + 4 :])
        read_sane(tmp_path / name)


@pytest.mark.parametrize("value", [1e300, -1e300, 3.4e38, 100, -100, 1e20, "x", None, [], {}])
@pytest.mark.parametrize("version", [1, 2])
def test_no_number_of_a_sog_gets_through(tmp_path: Path, version: int, value: object) -> None:
    parts = sog_parts()
    for part in ("means", "scales", "sh0", "shN"):
        for name in ("mins", "maxs", "codebook", "count", "bands"):
            meta = json.loads(parts["meta.json"])
            if version == 1:
                ends = {"mins": [0, 0, 0, 0], "maxs": [1, 1, 1, 1]}
                meta = {"version": 1, **{k: {**meta[k], **ends} for k in SOG_PARTS}}
                meta["means"]["shape"] = [2]
                meta["shN"] |= {"mins": 0, "maxs": 1}
            if name in meta[part]:
                old = meta[part][name]
                meta[part][name] = [value] * len(old) if isinstance(old, list) else value
            zipped(tmp_path / "a.sog", {**parts, "meta.json": json.dumps(meta).encode()})
            read_sane(tmp_path / "a.sog")


@pytest.mark.parametrize("bits", [0x7C00, 0xFC00, 0x7E00, 0x7D00, 0x7BFF])
def test_halves_of_an_old_spz(tmp_path: Path, bits: int) -> None:
    body = np.full((N, 3), 0x3C00, "<u2")
    body[1, 2] = bits
    head = struct.pack("<IIIBBBB", 0x5053474E, 1, N, 0, 12, 0, 0)
    (tmp_path / "a.spz").write_bytes(gzip.compress(head + body.tobytes() + bytes(10 * N)))
    found = read_sane(tmp_path / "a.spz")
    assert found is not None
    assert len(found) == (N if bits == 0x7BFF else N - 1)


# --- memory


def gltf(primitives: int, accessors: int, n: int, nodes: int = 1) -> bytes:
    """Splats of ``n`` points whose columns all lie in the same bytes, in so many primitives."""
    splats = "KHR_gaussian_splatting"
    rests = [f"{splats}:SH_DEGREE_{d}_COEF_{k}" for d in range(4) for k in range(2 * d + 1)]
    names = ["POSITION", f"{splats}:SCALE", *rests[:accessors]]
    named = dict.fromkeys(names, 0) | {f"{splats}:ROTATION": 1, f"{splats}:OPACITY": 2}
    primitive = {"attributes": named, "extensions": {splats: {}}}
    kinds = (("VEC3", n), ("VEC4", n), ("SCALAR", n))
    content = {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}] * nodes,
        "meshes": [{"primitives": [primitive] * primitives}],
        "buffers": [{"byteLength": 16 * n}],
        "bufferViews": [{"buffer": 0, "byteLength": 16 * n}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "type": kind, "count": count}
            for kind, count in kinds
        ],
    }
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    body = bytes(16 * n)
    chunks = (
        struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0")
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks) + len(body)) + chunks + body


def sog_of(n: int) -> dict[str, bytes]:
    parts = sog_parts()
    meta = json.loads(parts["meta.json"])
    return {**parts, "meta.json": json.dumps({**meta, "count": n}).encode()}


def zeros_spz(path: Path, n: int) -> None:
    head = struct.pack("<IIIBBBB", 0x5053474E, 3, n, 0, 12, 0, 0)
    path.write_bytes(gzip.compress(head) + gzip.compress(bytes(n)) * 20)


BOMBS: dict[str, Callable[[Path], object]] = {
    "zeros.spz": lambda p: zeros_spz(p, 20_000_000),
    "claims.sog": lambda p: zipped(p, sog_of(64_000_000)),
    "primitives.glb": lambda p: p.write_bytes(gltf(9_000, 1, 3)),
    "places.glb": lambda p: p.write_bytes(gltf(1_000, 1, 3, nodes=100)),
    "shared.glb": lambda p: p.write_bytes(gltf(900, 16, 20_000)),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_small_file_takes_little_memory(tmp_path: Path, name: str) -> None:
    BOMBS[name](tmp_path / name)
    tracemalloc.start()
    with pytest.raises(GagaError, match=r"would take|too many"):
        read_splats(tmp_path / name)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 400e6


@pytest.mark.parametrize(
    "name", ["a.ply", "a.compressed.ply", "a.splat", "a.spz", "turned.spz", "a.sog", "a.glb"]
)
@pytest.mark.parametrize("sh_degree", [0, 3])
def test_memory_is_asked_for_as_it_is_taken(
    tmp_path: Path, name: str, sh_degree: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a reader has checked covers its peak, so no file takes more than was allowed."""
    path, n = tmp_path / name, 60_000
    g = random_gaussians(n, sh_degree=sh_degree)
    g.means[::3] = np.nan if name == "a.ply" else 0
    (write_unchecked if name == "a.ply" else write_splats)(path, g)
    if name.startswith("turned"):
        raw = gzip.decompress(path.read_bytes())
        path.write_bytes(gzip.compress(raw[:-4] + struct.pack("<I", AXES.index("RBU"))))
    asked = [0.0]

    def check(path: Path, n_bytes: float, what: str, n_stored: int = 0) -> None:
        asked.append(n_bytes)
        check_memory(path, n_bytes, what, n_stored)

    for module in (packing, glb):
        monkeypatch.setattr(module, "check_memory", check)
    tracemalloc.start()
    read_splats(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < max(asked) + 64e6  # parts that are worked on


# --- other files


@pytest.mark.parametrize(
    "name", ["a.ply", "a.splat", "a.spz", "a.sog", "a.ksplat", "a.glb", "a.gltf", "meta.json"]
)
def test_a_pipe_ends_in_a_sentence(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(GagaError):
        read_splats(tmp_path / name)


@pytest.mark.parametrize("kind", ["pipe", "link", "device", "circle"])
def test_a_part_that_is_no_file_of_the_folder_is_not_read(tmp_path: Path, kind: str) -> None:
    scene = tmp_path / "scene"
    scene.mkdir()
    for name, content in sog_parts().items():
        (scene / name).write_bytes(content)
    content = json.loads(gltf(1, 1, 3)[20:].partition(b"BIN")[0][:-4])
    content["buffers"][0]["uri"] = "l.webp"
    (scene / "a.gltf").write_text(json.dumps(content))
    (tmp_path / "outside").write_bytes((scene / "l.webp").read_bytes())
    (scene / "l.webp").unlink()
    if kind == "pipe":
        os.mkfifo(scene / "l.webp")
    else:
        outside = str(tmp_path / "outside")
        target = {"link": outside, "device": "/dev/zero", "circle": "l.webp"}[kind]
        (scene / "l.webp").symlink_to(target)
    for path in (scene / "meta.json", scene / "a.gltf"):
        with pytest.raises(GagaError):
            read_splats(path)


def test_a_part_that_is_missing_is_named(tmp_path: Path) -> None:
    """The file that names it was said not to exist."""
    for name, content in sog_parts().items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "l.webp").unlink()
    with pytest.raises(GagaError, match=r"l\.webp does not exist. It belongs to meta\.json"):
        read_splats(tmp_path / "meta.json")


# --- numbers at the ends of what is accepted


@pytest.mark.parametrize("name", ["a.ply", "a.spz", "a.sog", "a.html"])
@pytest.mark.parametrize(
    ("column", "value"),
    [("means", 1e17), ("log_scales", 40), ("log_scales", -1e17), ("quats", 1e17), ("sh", 9e17)]
    + [("logit_opacities", value) for value in (np.inf, -np.inf, 1e17)],
)
def test_accepted_numbers_are_exported_without_a_warning(
    tmp_path: Path, name: str, column: str, value: float
) -> None:
    g = random_gaussians(N)
    getattr(g, column)[:] = value
    write_ply(tmp_path / "in.ply", g)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        project = run_stage(open_path_stage(tmp_path / "in.ply"))
        run_stage(export_scene_stage(project.scene, tmp_path / name))
    assert (tmp_path / name).is_file()


# --- level of detail


@pytest.mark.parametrize("value", [-1, 6_000, 2**31 - 1, "nan", "means", "order", "twice", "nodes"])
def test_wrong_numbers_of_a_tree_are_refused_or_not_used(tmp_path: Path, value: int | str) -> None:
    g, folder = random_gaussians(6_000), tmp_path / "lod"
    run_stage(build_lod_stage(g, folder, "x"))
    file = folder / level_file(1)
    rows = np.fromfile(file, row_type(g.sh.shape[1]))
    if isinstance(value, int):
        rows["row"][7] = value
    elif value in ("nan", "means"):
        rows["means"][7] = np.nan if value == "nan" else 3.4e38
    rows.tofile(file)
    if value == "order":
        (folder / ORDER).write_bytes(b"\xff" * (4 * len(g)))
    if value == "twice":
        (folder / ORDER).write_bytes(bytes(4 * len(g)))
    if value == "nodes":
        np.save(folder / NODES, np.full_like(np.load(folder / NODES), np.nan))
    if isinstance(value, int) or value in ("order", "twice"):
        with pytest.raises(GagaError, match="Build the level"):
            check_tree(folder, g)
    else:
        check_tree(folder, g)


def check_tree(folder: Path, g: Gaussians) -> None:
    tree = open_lod(folder, "x", len(g), g.sh.shape[1])
    assert tree is not None
    assert np.isfinite(np.square(tree.boxes)).all()
    assert np.isfinite(tree.details).all()
    for node in range(tree.n_nodes):
        splats, rows = tree.read(node, g)
        assert np.isfinite(np.square(splats.means)).all()
        assert 0 <= rows.min() <= rows.max() < len(g)
