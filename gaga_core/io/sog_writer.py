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
from scipy.sparse import csr_array

from gaga_core.arrays import AnyArray, FloatArray, IntArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write
from gaga_core.io.packing import bytes_of_logits, three_of_quats, to_bytes, unit_quats
from gaga_core.io.sog import META
from gaga_core.io.staging import publish_all, staging_folder
from gaga_core.progress import Progress, Stage

MOST_DEGREE = 3  # of SH
_N_CODES = 256
_CODE_ROUNDS = 12  # of Lloyd's algorithm for a table of numbers
_PER_ROW = 64  # palette entries in a row of pixels
PALETTE = 65536  # entries at most: labels have 16 bits
_COARSE = 256  # clusters of the first level
_ROUNDS = 4  # of Lloyd's algorithm in each
_CELLS = 1 << 22  # distances that are held at once
_SAMPLE = 1 << 18  # numbers or splats that tables are made from
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
    logs = np.sign(gaussians.means) * np.log1p(np.abs(gaussians.means.astype(np.float64)))
    low, high = logs.min(axis=0), logs.max(axis=0)
    words = np.rint((logs - low) / np.where(high > low, high - low, 1) * 65535).astype(np.uint16)
    yield "means_l.webp", _webp((words & 255).astype(np.uint8))
    yield "means_u.webp", _webp((words >> 8).astype(np.uint8))
    largest, three = three_of_quats(unit_quats(gaussians.quats))
    parts = to_bytes((three * np.float32(np.sqrt(2)) * 0.5 + 0.5) * 255)
    yield "quats.webp", _webp(parts, (252 + largest).astype(np.uint8))
    sizes = _table(gaussians.log_scales)
    yield "scales.webp", _webp(_nearest(sizes, gaussians.log_scales))
    colors = _table(gaussians.sh[:, 0])
    alpha = bytes_of_logits(gaussians.logit_opacities)
    yield "sh0.webp", _webp(_nearest(colors, gaussians.sh[:, 0]), alpha)
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
        entries, labels = _palette(rest)
        table = _table(entries)
        yield "shN_centroids.webp", _webp_of(_rows(_nearest(table, entries)))
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


def _table(values: FloatArray) -> FloatArray:
    """256 numbers, ascending, near which the values lie: Lloyd's algorithm from quantiles."""
    # Sorted first: a step through channels that take turns could meet one of them alone.
    ordered = np.sort(values, axis=None)
    flat = np.append(_sampled(ordered), ordered[-1]).astype(np.float64)
    distinct = np.unique(flat)
    if len(distinct) <= _N_CODES:
        return np.pad(distinct, (0, _N_CODES - len(distinct)), mode="edge").astype(np.float32)
    even = np.linspace(flat[0], flat[-1], _N_CODES)
    table = (np.quantile(flat, np.linspace(0, 1, _N_CODES)) + even) / 2  # rare values count, too
    sums = np.concatenate([[0.0], np.cumsum(flat)])
    for _ in range(_CODE_ROUNDS):
        edges = np.concatenate([[0], np.searchsorted(flat, (table[1:] + table[:-1]) / 2)])
        ends = np.concatenate([edges[1:], [len(flat)]])
        counts = ends - edges
        means = (sums[ends] - sums[edges]) / np.maximum(counts, 1)
        table = np.sort(np.where(counts > 0, means, table))
    return table.astype(np.float32)


def _nearest(table: FloatArray, values: FloatArray) -> UInt8Array:
    """Place 0..255 of the nearest number of an ascending table."""
    between = (table[1:] + table[:-1]) / 2
    places: UInt8Array = np.searchsorted(between, values).astype(np.uint8)
    return places


def _palette(rest: FloatArray) -> tuple[FloatArray, IntArray]:
    """Entries (E, S - 1, 3) and the one (N,) of each splat.

    Splats with few different SH keep them all. Else k-means in two levels: each of a few coarse
    clusters is divided into its share of the entries, so that the time grows with N alone.
    """
    flat = np.ascontiguousarray(rest.reshape(len(rest), -1), np.float32)
    entries, labels = np.unique(flat, axis=0, return_inverse=True)
    if len(entries) <= PALETTE:
        return entries.reshape(-1, *rest.shape[1:]), labels.reshape(-1).astype(np.int32)
    rng = np.random.default_rng(0)
    coarse = _closest(_means_of(_sampled(flat), _COARSE, rng), flat)
    order = np.argsort(coarse, kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(coarse, minlength=_COARSE))[:-1])
    room = PALETTE - _COARSE  # a cluster has one entry at least
    found: list[FloatArray] = []
    labels, n_before = np.zeros(len(flat), np.int64), 0
    for part in (part for part in parts if len(part)):
        means = _means_of(flat[part], 1 + room * len(part) // len(flat), rng)
        labels[part] = n_before + _closest(means, flat[part])
        found.append(means)
        n_before += len(means)
    return np.concatenate(found).reshape(-1, *rest.shape[1:]), labels.astype(np.int32)


def _means_of(rows: FloatArray, k: int, rng: np.random.Generator) -> FloatArray:
    """At most ``k`` rows (K, D) near which the rows (R, D) lie: Lloyd's algorithm."""
    if len(rows) <= k:
        return rows
    means = rows[rng.permutation(len(rows))[:k]]
    for _ in range(_ROUNDS):
        near = _closest(means, rows)
        counts = np.bincount(near, minlength=k)
        belongs = csr_array((np.ones(len(rows), np.float32), (near, np.arange(len(rows)))))
        sums = belongs @ rows
        sums = np.pad(sums, ((0, k - len(sums)), (0, 0)))
        means = np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], means)
        means = means.astype(np.float32)
    return means


def _closest(means: FloatArray, rows: FloatArray) -> IntArray:
    """The nearest of ``means`` (K, D) to each row (R, D)."""
    lengths = (means * means).sum(axis=1)
    step = max(_CELLS // len(means), 1)
    pieces = [
        (lengths - 2 * (rows[at : at + step] @ means.T)).argmin(axis=1)
        for at in range(0, len(rows), step)
    ]
    nearest: IntArray = np.concatenate([*pieces, np.zeros(0, np.int64)]).astype(np.int32)
    return nearest


def _sampled(rows: AnyArray) -> AnyArray:
    """At most `_SAMPLE` rows, evenly taken."""
    return rows[:: -(-len(rows) // _SAMPLE)]
