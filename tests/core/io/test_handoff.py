"""GLB, SOG and KSPLAT: what comes back, what other programs make of it, what is not believed."""

import base64
import json
import subprocess
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaga_core.color import SH_C0
from gaga_core.errors import GagaError
from gaga_core.export.solids import box_mesh, convex_collider
from gaga_core.gaussians import Gaussians
from gaga_core.io.meshes import MeshFile, write_mesh
from gaga_core.io.splats import packing
from gaga_core.io.splats.glb import Buffers
from gaga_core.io.splats.packing import unit_quats
from gaga_core.io.splats.splat_files import (
    SplatFormat,
    form_of,
    losses,
    read_splats,
    read_splats_stage,
    write_splats,
)
from gaga_core.progress import Progress, run_stage
from gaga_core.scene.project import open_path_stage
from gaga_core.scene.selection.bounds import oriented_box
from tests.core.io.splat_parts import angles, covariances, ksplat
from tests.gltf_files import glb_bytes, glb_of_spz, silent_spz
from tests.peer_tools import node_tool
from tests.scenes import random_gaussians
from tests.shares import falls, shares

_SHARED = Path(__file__).resolve().parents[3].parent / "shared" / "data" / "splats"
_TRANSFORM = node_tool("@playcanvas/splat-transform/bin/cli.mjs")
_VALIDATOR = node_tool("gltf-validator/index.js")


def _check_close(back: Gaussians, g: Gaussians, *, loosely: bool) -> None:
    assert len(back) == len(g)
    spread = np.ptp(np.sign(g.means) * np.log1p(np.abs(g.means)), axis=0).max()
    most = np.abs(g.means).max() + 1
    np.testing.assert_allclose(back.means, g.means, atol=most * spread / 65535 if loosely else 1e-6)
    np.testing.assert_allclose(back.log_scales, g.log_scales, atol=0.06 if loosely else 1e-5)
    assert angles(back.quats, g.quats).max() < (0.02 if loosely else 2e-3)
    np.testing.assert_allclose(back.opacities, g.opacities, atol=0.003 if loosely else 2e-6)
    np.testing.assert_allclose(back.sh[:, 0], g.sh[:, 0], atol=0.03 if loosely else 1e-6)


@pytest.mark.parametrize("degree", range(5))
def test_a_glb_keeps_every_number(tmp_path: Path, degree: int) -> None:
    g = random_gaussians(200, seed=degree, sh_degree=degree)
    path = tmp_path / "a.glb"
    write_splats(path, g)
    back = read_splats(path)
    _check_close(back, g, loosely=False)
    kept = (min(degree, 3) + 1) ** 2
    np.testing.assert_allclose(back.sh, g.sh[:, :kept], atol=1e-5)
    said = " ".join(losses(g, SplatFormat.GLB))
    assert ("degree 4" in said) == (degree == 4)
    assert "antialiased" in " ".join(
        losses(replace(g, comments=("antialiased 1",)), SplatFormat.GLB)
    )


@pytest.mark.parametrize(("is_metric", "said"), [(False, "scene units"), (True, "metres")])
def test_the_precision_of_positions_is_told_in_the_unit_of_the_file(
    is_metric: bool, said: str
) -> None:
    splats = random_gaussians(10).with_metres(is_metric)
    assert f" {said}, sizes" in losses(splats, SplatFormat.SPZ)[0]


def test_a_glb_of_another_program_is_placed_by_its_nodes(tmp_path: Path) -> None:
    """Two meshes: one turned and doubled by its node, one under a parent that moves it."""
    g = random_gaussians(30, seed=1, sh_degree=1)
    path = tmp_path / "a.glb"
    write_splats(path, g)
    buffers = Buffers.of(path.read_bytes(), path)
    gltf = json.loads(json.dumps(buffers.gltf))
    half = float(np.sqrt(0.5))
    gltf["nodes"] = [
        {"mesh": 0, "rotation": [0, 0, half, half], "scale": [2, 2, 2]},
        {"children": [2], "translation": [1, 2, 3]},
        {"mesh": 0, "matrix": np.eye(4).ravel().tolist()},
    ]
    gltf["scenes"][0]["nodes"] = [0, 1]
    path.write_bytes(glb_bytes(gltf, buffers.binaries[0]))
    back = read_splats(path)
    assert len(back) == 60
    there = g.means * [-1, -1, 1]  # left, up, front
    turned = 2 * np.stack([-there[:, 1], there[:, 0], there[:, 2]], axis=1) * [-1, -1, 1]
    np.testing.assert_allclose(back.means[:30], turned, atol=1e-5)
    np.testing.assert_allclose(back.log_scales[:30], g.log_scales + np.log(2), atol=1e-5)
    np.testing.assert_allclose(back.means[30:], g.means + np.array([-1, -2, 3]), atol=1e-5)
    gltf["nodes"][0]["scale"] = [1, 2, 1]
    path.write_bytes(glb_bytes(gltf, buffers.binaries[0]))
    with pytest.raises(GagaError, match="stretches"):
        read_splats(path)
    gltf["nodes"] = [{"children": [0], "mesh": 9}]  # found before a mesh is read
    gltf["scenes"][0]["nodes"] = [0]
    path.write_bytes(glb_bytes(gltf, buffers.binaries[0]))
    with pytest.raises(GagaError, match="circle"):
        read_splats(path)
    gltf["nodes"] = [{"mesh": 0}]
    for count, why in ((1_000, "beyond its buffer"), (4_000_000_000, "would take")):
        gltf["accessors"][0]["count"] = count
        path.write_bytes(glb_bytes(gltf, buffers.binaries[0]))
        with pytest.raises(GagaError, match=why):
            read_splats(path)


def test_a_gltf_takes_its_numbers_from_its_own_folder_or_text_only(tmp_path: Path) -> None:
    g = random_gaussians(40, sh_degree=1)
    write_splats(tmp_path / "a.glb", g)
    whole = Buffers.of((tmp_path / "a.glb").read_bytes(), tmp_path / "a.glb")
    binary, gltf = whole.binaries[0], {**whole.gltf}
    folder = tmp_path / "scene"
    (folder / "parts").mkdir(parents=True)
    (folder / "parts" / "the numbers.bin").write_bytes(binary)
    (tmp_path / "outside.bin").write_bytes(binary)
    (folder / "link.bin").symlink_to(tmp_path / "outside.bin")
    text = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()

    def read_with(uri: str) -> Gaussians:
        gltf["buffers"] = [{"byteLength": len(binary), "uri": uri}]
        (folder / "a.gltf").write_text(json.dumps(gltf), encoding="utf-8")
        return read_splats(folder / "a.gltf")

    expected = read_splats(tmp_path / "a.glb")
    for uri in ("parts/the%20numbers.bin", text):
        assert read_with(uri).means.tobytes() == expected.means.tobytes()
        assert read_with(uri).sh.tobytes() == expected.sh.tobytes()
    outside = ("../outside.bin", str(tmp_path / "outside.bin"), "file:///etc/passwd", "link.bin")
    for uri in (*outside, "https://example.org/a.bin", "parts/%2e%2e/%2e%2e/outside.bin"):
        with pytest.raises(GagaError, match="outside of its folder"):
            read_with(uri)
    with pytest.raises(GagaError, match="not next to it"):
        read_with("gone.bin")
    for uri in ("data:;base64,%%", "data:;base64,AAAA", "parts/the%20numbers.bin\0"):
        with pytest.raises(GagaError):
            read_with(uri)
    with pytest.raises(GagaError, match="too long"):
        read_with("n" * 5000)
    with pytest.raises(GagaError, match="too long"):  # not when the file is looked at before that
        run_stage(open_path_stage(folder / "a.gltf"))


@pytest.mark.parametrize(
    "name",
    [
        "KHR_gaussian_splatting_compression_spz_2",
        "KHR_gaussian_splatting_compression_spz",
        "KHR_spz_gaussian_splats_compression",
    ],
)
def test_splats_that_are_packed_as_spz_are_read_from_a_glb(tmp_path: Path, name: str) -> None:
    """Stored numbers are those of the glTF, unless the SPZ says which way its axes point."""
    g = random_gaussians(60, seed=4, sh_degree=2)
    spz, glb = tmp_path / "a.spz", tmp_path / "a.glb"
    write_splats(spz, replace(g, comments=("antialiased 1",)))
    here = read_splats(spz)  # rounded, our axes
    glb.write_bytes(glb_of_spz(spz.read_bytes(), name, {"translation": [1, 2, 3]}))
    back = read_splats(glb)
    np.testing.assert_allclose(back.means, here.means + np.array([-1, -2, 3]), atol=1e-6)
    np.testing.assert_allclose(back.sh, here.sh, atol=1e-6)
    assert angles(back.quats, here.quats).max() < 2e-3
    assert back.is_antialiased
    glb.write_bytes(glb_of_spz(silent_spz(spz.read_bytes()), name))
    back = read_splats(glb)  # left, up, front
    np.testing.assert_array_equal(back.means, here.means * [-1, -1, 1])
    turned = here.quats * np.array([1, -1, -1, 1], np.float32)  # of the ellipsoid's own axes, too
    assert angles(back.quats, turned).max() < 2e-3
    odd = [False, True, False, True, False, True, False, True, False]  # in x and y, by coefficient
    np.testing.assert_allclose(back.sh, np.where(np.array(odd)[:, None], -here.sh, here.sh))


def test_reading_pieces_of_a_glb_tells_one_share_that_never_falls(tmp_path: Path) -> None:
    """Each piece began again at 0."""
    spz, glb = tmp_path / "a.spz", tmp_path / "a.glb"
    write_splats(spz, random_gaussians(60, sh_degree=1))
    name = "KHR_gaussian_splatting_compression_spz_2"
    glb.write_bytes(glb_of_spz(spz.read_bytes(), name, n_times=3))
    words: list[Progress] = []
    run_stage(read_splats_stage(glb), words.append)
    assert falls(words) == []
    assert shares(words)[-1] == 1
    assert len(set(shares(words))) > 3 * 3, "within each"


def test_damaged_and_other_compressions_in_a_glb_are_one_sentence(tmp_path: Path) -> None:
    name = "KHR_gaussian_splatting_compression_spz_2"
    spz, glb = tmp_path / "a.spz", tmp_path / "a.glb"
    write_splats(spz, random_gaussians(60, sh_degree=1))
    whole = spz.read_bytes()
    glb.write_bytes(glb_of_spz(whole, "EXT_gaussian_splatting_compression_other"))
    with pytest.raises(GagaError, match=r"compression_other.*SPZ alone"):
        read_splats(glb)
    glb.write_bytes(glb_of_spz(whole[:-40], name))
    with pytest.raises(GagaError, match="truncated or damaged"):
        read_splats(glb)
    glb.write_bytes(glb_of_spz(b"no splats at all", name))
    with pytest.raises(GagaError, match="not an SPZ"):
        read_splats(glb)
    content = glb_of_spz(whole, name)
    for wrong in (b'"bufferView": 1', b'"bufferView":-1'):
        glb.write_bytes(content.replace(b'"bufferView": 0', wrong))
        with pytest.raises(GagaError, match="not a valid glTF"):
            read_splats(glb)


@pytest.mark.parametrize(
    "node",
    [
        {"matrix": [1e200, *[0] * 4, 1e200, *[0] * 4, 1e200, *[0] * 4, 1]},
        {"scale": [1e300, 1e300, 1e300]},
        {"scale": [1e14, 1e14, 1e14], "children": [1]},
        {"rotation": [0, 0, 0, 0]},
        {"rotation": [1e300, 0, 0, 0]},
        {"translation": [0, 1e308]},
    ],
)
def test_places_that_overflow_are_one_sentence_and_no_warning(
    tmp_path: Path, node: dict[str, Any]
) -> None:
    path = tmp_path / "a.glb"
    write_splats(path, random_gaussians(20))
    buffers = Buffers.of(path.read_bytes(), path)
    nodes = [{"mesh": 0, **node}, {"mesh": 0, "scale": [1e14, 1e14, 1e14]}]
    path.write_bytes(glb_bytes({**buffers.gltf, "nodes": nodes}, buffers.binaries[0]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(GagaError, match="not a valid glTF"):
            read_splats(path)


def test_quaternions_without_a_length_are_rows_that_are_left_out(tmp_path: Path) -> None:
    quats = np.tile(np.array([3e38, 3e38, 3e38, 0], np.float32), (4, 1))
    quats[1:] = np.array([[0, 0, 0, 0], [np.nan, 0, 0, 0], [2, 0, 0, 0]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        unit = unit_quats(quats)
    assert np.isnan(unit[[0, 2]]).all()
    assert unit[[1, 3]].tolist() == [[0, 0, 0, 0], [1, 0, 0, 0]]  # that of length 0 is told and set


@pytest.mark.parametrize("wrong", [7, "text", [], {}, [7], ["text"], [[]], None, [None]])
def test_a_glb_with_any_other_json_is_one_sentence(tmp_path: Path, wrong: object) -> None:
    path = tmp_path / "a.glb"
    write_splats(path, random_gaussians(3))
    buffers = Buffers.of(path.read_bytes(), path)
    for name in ("scenes", "nodes", "meshes", "accessors", "bufferViews", "buffers"):
        path.write_bytes(glb_bytes({**buffers.gltf, name: wrong}, buffers.binaries[0]))
        if name != "scenes" or wrong:  # scenes may be absent
            with pytest.raises(GagaError):
                read_splats(path)


@pytest.mark.skipif(_VALIDATOR is None, reason="gltf-validator is not installed (make peers)")
def test_the_validator_finds_nothing_wrong_with_splats_and_solids(tmp_path: Path) -> None:
    """But for what it does not know yet: the extension, and the names of its attributes."""
    splats, damaged, *solids = (
        tmp_path / f"{name}.glb" for name in ("splats", "damaged", "mesh", "collider", "box")
    )
    g = random_gaussians(100, sh_degree=3)
    write_splats(splats, g)
    damaged.write_bytes(splats.read_bytes().replace(b'"mode":0', b'"mode":9'))
    hull = convex_collider(g.means.astype(np.float64))
    rgb = np.linspace([0, 128, 255], [255, 0, 9], len(hull.vertices)).astype(np.uint8)
    box = oriented_box(g.means)
    assert box is not None
    for path, mesh in zip(solids, (replace(hull, colors=rgb), hull, box_mesh(box)), strict=True):
        write_mesh(path, mesh, MeshFile.GLB, "a </cup>\n\u00e9")
    issues = _validated(splats, damaged, *solids)
    names = "/meshes/0/primitives/0/attributes/KHR_gaussian_splatting:"
    found = [row for row in issues[0] if not row["pointer"].startswith(names)]
    assert [row["code"] for row in found] == ["UNSUPPORTED_EXTENSION"]
    assert {row["code"] for row in issues[0]} <= {
        "UNSUPPORTED_EXTENSION",
        "MESH_PRIMITIVE_INVALID_ATTRIBUTE",  # of the extension's own names
    }
    assert any("primitives/0/mode" in row["pointer"] for row in issues[1])
    assert issues[2:] == [[], [], []], "solids are plain glTF: not even a hint"


def _validated(*paths: Path) -> list[list[dict[str, Any]]]:
    """What Khronos' validator says of files; severity 0 error, 1 warning, 2 information, 3 hint."""
    assert _VALIDATOR is not None
    script = (
        "const v = require(process.argv[1]), read = require('fs').readFileSync;"
        "Promise.all(process.argv.slice(2).map(p => v.validateBytes(new Uint8Array(read(p)))))"
        ".then(all => console.log(JSON.stringify(all.map(r => r.issues))))"
    )
    call = [_VALIDATOR[0], "-e", script, _VALIDATOR[1], *map(str, paths)]
    answer = subprocess.run(call, check=True, capture_output=True, timeout=60)
    found = json.loads(answer.stdout)
    assert not any(issues["truncated"] for issues in found)
    return [issues["messages"] for issues in found]


@pytest.mark.parametrize("name", ["a.sog", "folder/meta.json"])
@pytest.mark.parametrize("degree", [0, 2, 3])
def test_a_sog_comes_back_within_its_steps(tmp_path: Path, name: str, degree: int) -> None:
    g = random_gaussians(500, seed=degree, sh_degree=degree)
    path = tmp_path / name
    assert form_of(path) is SplatFormat.SOG
    write_splats(path, g)
    back = read_splats(path)
    _check_close(back, g, loosely=True)
    np.testing.assert_allclose(back.sh, g.sh, atol=0.05)  # so few splats keep their own SH
    again = tmp_path / "again" / path.name
    again.parent.mkdir()
    write_splats(again, g)
    assert again.read_bytes() == path.read_bytes()


def test_a_table_of_numbers_is_made_from_all_channels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(packing, "_SAMPLE", 500)  # of 1500: every third number
    g = random_gaussians(500, seed=2)
    g.sh[:, 0] = np.linspace([-0.1, 0, 1], [0.1, 1, 3], 500)
    g.log_scales[:] = np.linspace([-5, -4, -8], [-4, -2, -6], 500)
    write_splats(tmp_path / "a.sog", g)
    _check_close(read_splats(tmp_path / "a.sog"), g, loosely=True)


def test_a_palette_is_shared_where_sh_are_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Splats of few kinds with a little noise: the palette finds the kinds."""
    rng = np.random.default_rng(5)
    kinds = rng.normal(0, 0.2, (40, 8, 3))
    chosen = rng.integers(0, 40, 4000)
    rest = (kinds[chosen] + rng.normal(0, 0.002, (4000, 8, 3))).astype(np.float32)
    monkeypatch.setattr(packing, "PALETTE", 512)
    monkeypatch.setattr(packing, "_COARSE", 100)
    entries, labels = packing.palette_of(rest)
    assert 400 < len(entries) <= 512
    assert np.abs(entries[labels] - rest).mean() < 0.003
    few, same = packing.palette_of(rest[chosen][:300])
    assert np.array_equal(few[same], rest[chosen][:300])


@pytest.mark.skipif(_TRANSFORM is None, reason="splat-transform is not installed (make peers)")
def test_splat_transform_reads_our_sog_and_writes_our_glb(tmp_path: Path) -> None:
    assert _TRANSFORM is not None
    g = random_gaussians(300, seed=2, sh_degree=2)
    sog, ply, glb = tmp_path / "a.sog", tmp_path / "a.ply", tmp_path / "their.glb"
    write_splats(sog, g)
    for target in (ply, glb):
        call = [*_TRANSFORM, "-w", str(sog), str(target)]
        subprocess.run(call, check=True, capture_output=True, timeout=120)
    mine = read_splats(sog)
    for path in (ply, glb):
        back = read_splats(path)
        nearest = np.linalg.norm(mine.means[:, None] - back.means[None], axis=2).argmin(axis=1)
        there, here = covariances(back.take(nearest)), covariances(mine)
        np.testing.assert_allclose(there, here, atol=1e-3 * np.abs(here).max())
        np.testing.assert_allclose(back.take(nearest).means, mine.means, atol=1e-5)
        np.testing.assert_allclose(back.take(nearest).opacities, mine.opacities, atol=0.003)
        np.testing.assert_allclose(back.take(nearest).sh, mine.sh, atol=1e-3)


@pytest.mark.parametrize("degree", range(3))
@pytest.mark.parametrize("level", range(3))
def test_a_ksplat_from_its_bytes(tmp_path: Path, level: int, degree: int) -> None:
    path = tmp_path / "a.ksplat"
    content, where = ksplat(level, degree)
    path.write_bytes(content)
    g = read_splats(path)
    np.testing.assert_allclose(g.means, where, atol=1e-4)
    np.testing.assert_allclose(g.log_scales, np.log(0.5), atol=1e-6)
    np.testing.assert_allclose(g.quats, [[1, 0, 0, 0]] * 5)
    np.testing.assert_allclose(g.opacities, 128 / 255, atol=1e-6)
    np.testing.assert_allclose(g.sh[:, 0, 0], 0.5 / SH_C0, rtol=1e-5)
    assert g.sh_degree == degree
    if degree:  # red has the first three of degree 1, green the next
        values = np.array([0, 3, 6]) * 10 / (255 / 4 if level == 2 else 100) - (
            2 if level == 2 else 0
        )
        np.testing.assert_allclose(g.sh[0, 1], values, atol=1e-3)
    if degree == 2:
        values = np.array([9, 14, 19]) * 10 / (255 / 4 if level == 2 else 100)
        np.testing.assert_allclose(g.sh[0, 4], values - (2 if level == 2 else 0), atol=1e-3)


@pytest.mark.skipif(not _SHARED.is_dir(), reason="the data next to the checkout is not here")
def test_a_ksplat_of_the_viewer_itself() -> None:
    g = read_splats(_SHARED / "tiny_fixtures" / "minimal.ksplat")
    assert len(g) > 0
    assert np.isfinite(g.means).all()
