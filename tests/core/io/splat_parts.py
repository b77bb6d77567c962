"""What tests of splat files share: comparisons, damage, and files made byte by byte."""

import gzip
import inspect
import io
import json
import struct
import zipfile
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.arrays import AnyArray
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import quats_to_matrices
from gaga_core.io.splats.ply import write_ply_stage
from gaga_core.io.splats.splat import write_splat_stage
from gaga_core.io.splats.splat_files import SplatFormat, write_splats
from gaga_core.progress import run_stage


def covariances(g: Gaussians) -> np.ndarray:
    """(N, 3, 3) world."""
    axes = quats_to_matrices(g.quats) * np.exp(g.log_scales.astype(np.float64))[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def angles(a: AnyArray, b: AnyArray) -> AnyArray:
    """Angle (N,) of the rotation between quaternions of any sign and length."""
    a, b = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (a.astype(np.float64), b))
    return 2 * np.arccos(np.clip(np.abs((a * b).sum(axis=1)), 0, 1))


def write_unchecked(path: Path, gaussians: Gaussians) -> None:
    """A .ply or .splat as another program may write it, of numbers that our writers refuse."""
    write = {".ply": write_ply_stage, ".splat": write_splat_stage}[path.suffix]
    run_stage(inspect.unwrap(write)(path, gaussians))


def write_without_up(path: Path, gaussians: Gaussians) -> None:
    """An .spz without the extension that says which way is up, as other programs write it."""
    write_splats(path, gaussians, SplatFormat.SPZ)
    data = bytearray(gzip.decompress(path.read_bytes())[:-12])
    data[14] &= ~2  # the flag of the header
    path.write_bytes(gzip.compress(bytes(data)))


def ksplat(level: int, degree: int) -> tuple[bytes, np.ndarray]:
    """Five splats in two full buckets of two and one of one; and where they are."""
    n_rest = (0, 3, 8)[degree]
    kind, sh_kind = (("<f4", "<f4"), ("<f2", "<f2"), ("<f2", "u1"))[level]
    position = "<f4" if level == 0 else "<u2"
    fields = [("c", position, 3), ("s", kind, 3), ("q", kind, 4), ("rgba", "u1", 4)]
    rows = np.zeros(5, [*fields, *([("sh", sh_kind, 3 * n_rest)] if n_rest else [])])
    centres = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0]], "<f4")
    rows["c"] = 32767 + 100 * np.arange(15).reshape(5, 3) if level else np.eye(5, 3)
    where = np.eye(5, 3)
    if level:
        where = 100 * np.arange(15).reshape(5, 3) * (5.0 / 2 / 32767) + centres[[0, 0, 1, 1, 2]]
    rows["s"], rows["q"][:, 0], rows["rgba"] = 0.5, 1, (255, 128, 0, 128)
    if n_rest:
        values = np.arange(3 * n_rest) * 10
        rows["sh"] = values if level == 2 else values / 100
    head = bytearray(4096 + 1024)
    struct.pack_into("<BBxxIIIIHxx", head, 0, 0, 1, 1, 1, 5, 5, level)
    struct.pack_into("<ff", head, 36, -2.0, 2.0)
    struct.pack_into("<4IfHxx4IH", head, 4096, 5, 5, 2, 3, 5.0, 12, 32767, 0, 2, 1, degree)
    return bytes(head) + struct.pack("<I", 1) + centres.tobytes() + rows.tobytes(), where


def webp(pixels: AnyArray) -> bytes:
    out = io.BytesIO()
    Image.fromarray(pixels.astype(np.uint8)).save(out, "WEBP", lossless=True, exact=True)
    return out.getvalue()


def sog_parts() -> dict[str, bytes]:
    """Two splats in 4 x 1 pixels, SH of degree 1 from a palette of one entry."""
    low, high = np.zeros((1, 4, 4)), np.zeros((1, 4, 4))
    low[..., 3] = high[..., 3] = 255
    low[0, 0, :3], high[0, 0, :3] = 255, 255  # the greatest corner: log 1, 2, 3
    quats = np.zeros((1, 4, 4))
    quats[0, 0] = (255, 127, 127, 252)  # w largest, x = sqrt(1/2)
    quats[0, 1] = (127, 127, 127, 255)  # z largest
    scales = np.full((1, 4, 4), 255)
    scales[0, 0, :3] = (0, 1, 2)
    sh0 = np.zeros((1, 4, 4))
    sh0[0, 0], sh0[0, 1] = (10, 20, 30, 128), (0, 0, 0, 255)
    centroids = np.zeros((1, 192, 4))
    centroids[..., 3], centroids[0, 1] = 255, (1, 2, 3, 255)
    labels = np.zeros((1, 4, 4))
    labels[..., 3], labels[0, 1, 0] = 255, 7  # the second points past the palette: none
    codebook = [i / 100 for i in range(256)]
    meta = {
        "version": 2,
        "count": 2,
        "means": {"mins": [0, 0, 0], "maxs": [1, 2, 3], "files": ["l.webp", "u.webp"]},
        "quats": {"files": ["q.webp"]},
        "scales": {"codebook": [-v for v in codebook], "files": ["s.webp"]},
        "sh0": {"codebook": codebook, "files": ["c.webp"]},
        "shN": {"count": 1, "bands": 1, "codebook": codebook, "files": ["p.webp", "n.webp"]},
    }
    pictures = (low, high, quats, scales, sh0, centroids, labels)
    names = ("l", "u", "q", "s", "c", "p", "n")
    files = {f"{name}.webp": webp(pixels) for name, pixels in zip(names, pictures, strict=True)}
    return {"meta.json": json.dumps(meta).encode(), **files}


def zipped(path: Path, parts: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    return path
