"""Writing SOG version 2: one .sog (a zip), or the pictures next to a meta.json in a folder.

Positions keep 16 bits on a scale of ``sign(x) ln(1 + |x|)``, sizes and colors the nearest of 256
numbers that suit the scene, rotations 8 bits a part, SH the nearest of a palette. `sog` reads it.
"""

import io
import json
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.arrays import UInt8Array
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.code_books import log_words, nearest, palette_of, quat_bytes, table_of
from gaga_core.io.files import atomic_write
from gaga_core.io.packing import bytes_of_logits
from gaga_core.io.sog import META
from gaga_core.io.staging import publish_all, staging_folder
from gaga_core.progress import Progress, Stage

MOST_DEGREE = 3  # of SH
_PER_ROW = 64  # palette entries in a row of pixels
_MOST = 16383  # pixels of a side of a WebP


def write_sog_stage(path: Path, gaussians: Gaussians) -> Stage[None]:
    """Write a .sog, or with a path that ends in meta.json the folder around it, with progress.

    Whole or not at all. Raises ``GagaError`` when the place cannot be written.
    """
    path = Path(path)
    if path.name != META:
        with atomic_write(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
            for done, (name, content) in enumerate(_files(gaussians)):
                yield _step(path, gaussians, done)
                # A zip holds the time of its parts: the same scene gives the same bytes.
                archive.writestr(zipfile.ZipInfo(name), content)
        return
    with staging_folder(path.parent) as staging:
        names = []
        for done, (name, content) in enumerate(_files(gaussians)):
            yield _step(path, gaussians, done)
            (staging / name).write_bytes(content)
            names.append(name)
        publish_all(staging, names, path.parent)


def _step(path: Path, gaussians: Gaussians, done: int) -> Progress:
    n, n_files = len(gaussians), 6 + 2 * bool(gaussians.sh_degree)
    return Progress("Write splats", n * done // n_files, n, path.name)


def _files(gaussians: Gaussians) -> Iterator[tuple[str, bytes]]:
    """Names and contents of the files; meta.json, which tells of the others, comes last."""
    n = len(gaussians)
    if n > _MOST * _MOST:
        raise GagaError(f"{n:,} splats do not fit into a SOG. Export objects.")
    words, low, high = log_words(gaussians.means)
    yield "means_l.webp", _webp((words & 255).astype(np.uint8))
    yield "means_u.webp", _webp((words >> 8).astype(np.uint8))
    largest, parts = quat_bytes(gaussians.quats)
    yield "quats.webp", _webp(parts, (252 + largest).astype(np.uint8))
    sizes = table_of(gaussians.log_scales)
    yield "scales.webp", _webp(nearest(sizes, gaussians.log_scales))
    colors = table_of(gaussians.sh[:, 0])
    alpha = bytes_of_logits(gaussians.logit_opacities)
    yield "sh0.webp", _webp(nearest(colors, gaussians.sh[:, 0]), alpha)
    meta: dict[str, object] = {
        "version": 2,
        "asset": {"generator": "gaga-studio"},
        "count": n,
        **({"model": "antialiased"} if gaussians.is_antialiased else {}),
        "means": {
            "mins": low.tolist(),
            "maxs": high.tolist(),
            "files": _names("means_l", "means_u"),
        },
        "scales": {"codebook": sizes.tolist(), "files": _names("scales")},
        "quats": {"files": _names("quats")},
        "sh0": {"codebook": colors.tolist(), "files": _names("sh0")},
    }
    degree = min(gaussians.sh_degree, MOST_DEGREE)
    if degree:
        rest = gaussians.sh[:, 1 : (degree + 1) ** 2]
        entries, labels = palette_of(rest)
        table = table_of(entries)
        yield "shN_centroids.webp", _webp_of(_rows(nearest(table, entries)))
        pixels = np.stack([labels & 255, labels >> 8, np.zeros_like(labels)], axis=1)
        yield "shN_labels.webp", _webp(pixels.astype(np.uint8))
        meta["shN"] = {
            "count": len(entries),
            "bands": degree,
            "codebook": table.tolist(),
            "files": _names("shN_centroids", "shN_labels"),
        }
    yield META, json.dumps(meta).encode()


def _names(*stems: str) -> list[str]:
    return [f"{stem}.webp" for stem in stems]


def _webp(rgb: UInt8Array, alpha: UInt8Array | None = None) -> bytes:
    """A lossless picture with a pixel a splat: (N, 3) and (N,)."""
    n = len(rgb)
    width = -(-int(np.ceil(np.sqrt(n))) // 4) * 4
    pixels = np.zeros((-(-n // width), width, 4), np.uint8)
    pixels[..., 3] = 255
    flat = pixels.reshape(-1, 4)
    flat[:n, :3] = rgb
    if alpha is not None:
        flat[:n, 3] = alpha
    return _webp_of(pixels)


def _webp_of(pixels: UInt8Array) -> bytes:
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "WEBP", lossless=True, exact=True, quality=75, method=3)
    return out.getvalue()


def _rows(codes: UInt8Array) -> UInt8Array:
    """Palette entries (E, S - 1, 3) as a picture of 64 entries a row."""
    n, n_rest = codes.shape[:2]
    pixels = np.zeros((-(-n // _PER_ROW) * _PER_ROW, n_rest, 4), np.uint8)
    pixels[..., 3] = 255
    pixels[:n, :, :3] = codes
    return pixels.reshape(-1, _PER_ROW * n_rest, 4)
