"""A .sog of two splats, made byte by byte from its format."""

import io
import json
import zipfile
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.arrays import AnyArray


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
