"""Masks of the object in the photos, when the background must not count.

A folder of masks keeps features to the object. Without one, a backdrop is looked for when the
photos are placed: the room behind a turntable, or a plain one. What lies outside of a mask is
trained to be transparent; the photos are not changed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from PIL import Image
from scipy.ndimage import (
    binary_dilation,
    binary_erosion,
    binary_opening,
    distance_transform_edt,
    gaussian_filter,
    gaussian_gradient_magnitude,
    label,
    watershed_ift,
)

from gaga_core.arrays import AnyArray, BoolArray, FloatArray, LongArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.io.images import IMAGE_SUFFIXES, read_rgb
from gaga_core.placing.metrics import SfmFacts
from gaga_core.placing.photos import Photo, PhotoSet, shrunk
from gaga_core.progress import Progress, Stage, mapped, run_stage

_STAGE = "Look for the background"
_LOOK_SIDE = 320  # pixels: the backdrop is looked for at this size
_MOST_PHOTOS = 40  # photos that it is looked for in
_CANDIDATES = 12  # of which the colors are tried
# What it costs to compare a photo with a color, and to find a mask, in the time in which a photo is
# read: of 69 photos of a turntable.
_COMPARED, _MASKED = 0.5, 4.5
_SAME = 9.0  # of 255: noise, compression and what is left of the exposure
_ONE_COLOR = 40.0  # of 255: a plain backdrop with its shading
_PLAIN_BORDER = 0.6  # share of the border of the pictures: sky is above only
_KNOWN = 0.1  # share of the photos that must show a pixel of the backdrop, 3 at least ...
_AGREE = 0.5  # ... and of those the share that must agree on its color
_LONG_TRACK = 3  # views of a point that is no chance
_MOST_POINTS, _FAR = 0.95, 1.5  # points beyond this quantile of distances times this are wrong
_GAP = 0.06  # x width: half of a gap between points that is closed ...
_CLOSED = 0.7  # ... but for this share: edges have no points
_SHADE, _GRAY = 0.6, 0.08  # of a plain backdrop's brightness in a shadow; ratios of its channels
_SMOOTH = 16  # of `_steps`, 4 levels a pixel: shadows have no sharper edges, objects do
_LEAST_TURN = 60.0  # degrees that cameras must go around for colors to say something
_MOST_OUTSIDE = 0.15  # share of a model's points on a plain backdrop
_LEAST_SHARE = 0.01  # share of the picture that object and backdrop have at least
_LEAST_PART = 0.02  # x the largest part: smaller ones are specks
_CONSTANT = 0.9  # share of all photos in which a pixel has one color: a room, or plain and round
_NEAR_POINT = 5  # pixels from a point of any photo in which no room stands still
_NAMED = 3


def masks_from_folder(photos: PhotoSet, folder: Path, target: Path) -> Stage[None]:
    """Write the masks of ``folder`` (NAME.png or NAME.jpg.png, not black = object) for COLMAP.

    Raises ``GagaError`` when a photo has none, or one without any object.
    """
    files = {path.name.lower(): path for path in folder.glob("*") if path.is_file()}
    found = {photo.name: _mask_of(photo, files) for photo in photos.photos}
    missing = [Path(p.source).name for p in photos.photos if found[p.name] is None]
    if missing:
        raise GagaError(
            f"{len(missing)} of {len(photos.photos)} photos have no mask in {folder}: "
            f"{_listed(missing)}. Add NAME.png for each photo, black where the background is."
        )
    yield from write_masks(photos, {n: (p, 0) for n, p in found.items() if p is not None}, target)


def write_masks(
    photos: PhotoSet,
    masks: Mapping[str, tuple[Path, int]],  # by prepared photo; right angles that turn it upright
    target: Path,
) -> Stage[None]:
    """Write ``masks`` (not black = object) for COLMAP; a photo without one is all object.

    Raises ``GagaError`` when one is all black.
    """
    target.mkdir(parents=True, exist_ok=True)
    empty = []
    for i, photo in enumerate(photos.photos):
        yield Progress("Read masks", i, len(photos.photos), photo.name)
        path, turns = masks.get(photo.name, (None, 0))
        mask = np.ones((1, 1), bool)
        if path is not None:
            mask = np.rot90(read_rgb(path).max(axis=2) > 0, -turns)
            empty += [] if mask.any() else [path]
        _write(target, photo, mask)
    if empty:
        raise GagaError(
            f"{len(empty)} of {len(photos.photos)} photos have a black mask in {empty[0].parent}: "
            f"{_listed([path.name for path in empty])}. Black is the background only."
        )


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:_NAMED]) + (" ..." if len(names) > _NAMED else "")


@dataclass(frozen=True)
class Backdrop:
    """A background that the photos were freed from."""

    kind: Literal["static", "plain"]  # of a camera that stood still; of one color behind an object
    share: float  # of all pictures that it covers

    @property
    def note(self) -> str:
        """What a person should know."""
        seen = (
            "The camera stood still while the object turned"
            if self.kind == "static"
            else "The object is in front of a plain backdrop"
        )
        return f"{seen}: the background, {self.share:.0%} of the pictures, was left out."


def backdrop_stage(
    photos: PhotoSet,
    pictures: Path,
    facts: SfmFacts,
    target: Path,
    *,
    is_static: bool,  # whether matches say that the camera stood still
) -> Stage[Backdrop | None]:
    """Write masks of the object for the photos of ``facts``, where a backdrop is behind it.

    A backdrop has colors that stay the same at a pixel, after the exposure of each photo is taken
    out, while the cameras of ``facts`` go around the object: a room behind a turntable, or a plain
    backdrop. From what surely is backdrop or object, regions grow to the edges of each picture
    (watershed, Meyer 1991). None, and nothing is written, where there is no backdrop.
    """
    placed = [photo for photo in photos.photos if photo.name in set(facts.names)]
    if len({(photo.width, photo.height) for photo in placed}) > 1:
        return None
    if not is_static and _turned_around(facts) < _LEAST_TURN:
        return None
    n, n_compared = len(placed), len(_compared(len(placed)))
    colors = _COMPARED * n_compared * len(_candidates(n_compared))
    total = round(n + 2 * colors + _MASKED * n)

    def colored(step: Progress, begin: float) -> Progress:
        return Progress(_STAGE, begin + colors * step.done / step.total, total)

    stack = []
    for i, photo in enumerate(placed):
        yield Progress(_STAGE, i, total, photo.name)
        stack.append(shrunk(read_rgb(pictures / photo.name), _LOOK_SIDE))
    looks = np.array(stack)
    gains = exposure_gains(looks)
    shape = looks.shape[1:3]
    hulls, seen = _hulls(facts, shape), _seen_pixels(facts, shape)
    if not is_static and not _has_plain_border(looks, gains, hulls):
        yield Progress(_STAGE, total, total)  # most often: it is told as done, and so measured
        return None
    found = _color_stage(looks, gains, hulls)
    color, known = yield from mapped(found, partial(colored, begin=n))
    found = _color_stage(looks, gains, np.zeros_like(hulls), _CONSTANT)
    _, changing = yield from mapped(found, partial(colored, begin=n + colors))
    np.logical_not(changing, out=changing)
    occupied = np.zeros(shape, bool)
    occupied[tuple(np.concatenate(list(seen.values())).T)] = True
    changing |= binary_dilation(occupied, iterations=_NEAR_POINT)
    extended = None
    if not is_static:
        extended = _extended(color, known)
        # A plain round object has colors that stay, too; what a backdrop has goes to the border.
        odd = binary_opening(known & (np.abs(color - extended).max(axis=2) > 3 * _SAME))
        known &= ~(odd & ~_at_border(odd))
    masks, outside = [], []
    for i, photo in enumerate(placed):
        yield Progress(_STAGE, total - _MASKED * (n - i), total, photo.name)
        points = seen[photo.name]
        may_be = hulls[i] & (known | changing)
        mask = object_mask(looks[i] / gains[i], color, known, may_be, extended)
        masks.append(mask)
        outside.append(1 - float(mask[tuple(points.T)].mean()) if len(points) else 0.0)
    share = 1 - float(np.mean(masks))
    if not _LEAST_SHARE < share < 1 - _LEAST_SHARE:
        return None
    if not is_static and float(np.mean(outside)) > _MOST_OUTSIDE:
        return None
    target.mkdir(parents=True, exist_ok=True)
    for photo, mask in zip(placed, masks, strict=True):
        _write(target, photo, mask)
    return Backdrop("static" if is_static else "plain", share)


def _turned_around(facts: SfmFacts) -> float:
    """Largest angle, degrees, between the directions of two cameras."""
    axes = facts.poses[:, 2, :3]
    return float(np.degrees(np.arccos(np.clip((axes @ axes.T).min(), -1, 1))))


def exposure_gains(looks: UInt8Array) -> FloatArray:
    """Gain (N, 1, 1, 3) of each photo and channel against the median of all ``looks`` (N, H, W, 3).

    By the median over pixels, so an object that changes in less than half of them does no harm.
    """
    rows = _compared(len(looks))
    logs = np.log(looks[:, ::2, ::2].astype(np.float32) + 4)
    gains = np.zeros((len(looks), 1, 1, 3), np.float32)
    for _ in range(3):
        middle = np.median(logs[rows] - gains[rows], axis=0)
        gains = np.median(logs - middle, axis=(1, 2), keepdims=True).astype(np.float32)
    return np.exp(gains)


def backdrop_color(
    looks: UInt8Array,  # (N, H, W, 3)
    gains: FloatArray,  # (N, 1, 1, 3)
    hulls: BoolArray,  # (N, H, W) where the object may be
    agree: float = _AGREE,  # share of photos
) -> tuple[FloatArray, BoolArray]:
    """The color (H, W, 3) of the backdrop, and at which pixels (H, W) it is known.

    What most photos agree on of those in which the object is elsewhere: in front of it a plain
    object looks as if it stood still.
    """
    return run_stage(_color_stage(looks, gains, hulls, agree))


def _compared(n: int) -> LongArray:
    """Rows (K,) of the ``n`` photos in which a backdrop is looked for."""
    return np.linspace(0, n - 1, min(n, _MOST_PHOTOS)).astype(int)


def _candidates(n_compared: int) -> range:
    """Those of them of which the colors are tried."""
    return range(0, n_compared, max(1, n_compared // _CANDIDATES))


def _color_stage(
    looks: UInt8Array, gains: FloatArray, hulls: BoolArray, agree: float = _AGREE
) -> Stage[tuple[FloatArray, BoolArray]]:
    """`backdrop_color`, with a word of each color that is tried."""
    rows = _compared(len(looks))
    some, free = looks[rows] / gains[rows], ~hulls[rows]
    n_free, most = free.sum(axis=0), np.zeros(looks.shape[1:3], np.int64)
    color = np.zeros(looks.shape[1:], np.float32)
    tried = _candidates(len(some))
    for i, k in enumerate(tried):
        yield Progress(_STAGE, i, len(tried))
        near = (np.abs(some - some[k]).max(axis=3) < _SAME) & free
        count = near.sum(axis=0)
        better = (count > most) & free[k]
        mean = np.einsum("nhwc,nhw->hwc", some, near.astype(np.float32))
        color[better] = mean[better] / count[better, None]
        most[better] = count[better]
    known = (n_free >= max(3, _KNOWN * len(rows))) & (most > agree * n_free)
    return color, known


def _border(values: AnyArray) -> AnyArray:
    """The outermost pixels of (H, W, ...), one after the other."""
    parts = [values[:3], values[-3:], values[:, :3], values[:, -3:]]
    return np.concatenate([part.reshape(-1, *values.shape[2:]) for part in parts])


def _at_border(mask: BoolArray) -> BoolArray:
    """The parts of ``mask`` (H, W) that reach the border."""
    parts, n = label(mask)
    reach = np.isin(np.arange(n + 1), _border(parts)) & (np.arange(n + 1) > 0)
    return np.asarray(reach[parts])


def _has_plain_border(looks: UInt8Array, gains: FloatArray, hulls: BoolArray) -> bool:
    """Whether most photos agree on the border, in about one color.

    Looked for in the border alone: most photos have no backdrop, and all pixels take seconds.
    """
    at_border = (np.array([_border(values) for values in maps])[:, None] for maps in (looks, hulls))
    borders, covered = at_border  # (N, 1, P, 3), (N, 1, P)
    color, sure = backdrop_color(borders, gains, covered)
    if not sure.any():
        return False
    alike = np.abs(color - np.median(color[sure], axis=0)).max(axis=2) < _ONE_COLOR
    return float((sure & alike).mean()) >= _PLAIN_BORDER


def _extended(color: FloatArray, known: BoolArray) -> FloatArray:
    """The plain backdrop behind the object: a smooth continuation of what is seen of it."""
    usual = np.median(_border(color)[_border(known)], axis=0)
    sure = known & (np.abs(color - usual).max(axis=2) < _ONE_COLOR)
    result = np.where(sure[..., None], color, 0)
    for sigma in (4, 16, 64):  # the finest that knows something
        weight = gaussian_filter(sure.astype(np.float32), sigma)
        smooth = gaussian_filter(np.where(sure[..., None], color, 0), (sigma, sigma, 0))
        known = (weight > 0.01) & ~result.any(axis=2)
        result[known] = (smooth / np.maximum(weight, 1e-6)[..., None])[known]
    return np.where(result.any(axis=2, keepdims=True), result, np.median(color[sure], axis=0))


def _hulls(facts: SfmFacts, shape: tuple[int, int]) -> BoolArray:
    """Where the model's points may be in each view (V, H, W): closed gaps, a bit wider."""
    points = facts.points[facts.track_lengths >= _LONG_TRACK]
    away = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    points = points[away <= _FAR * np.quantile(away, _MOST_POINTS)]
    found, gap = [], _GAP * shape[1]
    for pose, focal, size in zip(facts.poses, facts.focal, facts.sizes, strict=True):
        inside = points @ pose[:, :3].T + pose[:, 3]
        cells = ((inside[:, 1::-1] / inside[:, 2:] * (focal / size)[::-1] + 0.5) * shape).astype(
            int
        )
        cells = cells[((cells >= 0) & (cells < shape)).all(axis=1) & (inside[:, 2] > 0)]
        empty = np.ones(shape, bool)
        empty[tuple(cells.T)] = False
        wide = distance_transform_edt(empty) < gap
        found.append(distance_transform_edt(wide) > _CLOSED * gap)
    return np.array(found)


def _seen_pixels(facts: SfmFacts, shape: tuple[int, int]) -> dict[str, LongArray]:
    """Rows and columns (K, 2) in a picture of ``shape`` of the points that each photo sees."""
    poses = facts.poses[facts.seen_views]
    inside = np.einsum("oij,oj->oi", poses[:, :, :3], facts.points[facts.seen_points])
    inside += poses[:, :, 3]
    sizes, focal = facts.sizes[facts.seen_views], facts.focal[facts.seen_views]
    at = inside[:, :2] / inside[:, 2:] * focal / sizes + 0.5  # shares of the width and height
    cells = np.clip(at[:, ::-1] * shape, 0, np.array(shape) - 1).astype(np.int64)
    return {name: cells[facts.seen_views == i] for i, name in enumerate(facts.names)}


def object_mask(
    picture: FloatArray,  # (H, W, 3) 0..255, exposure taken out
    color: FloatArray,  # (H, W, 3) of the backdrop
    known: BoolArray,  # (H, W) where that is known
    may_be: BoolArray,  # (H, W) where what is no backdrop is object
    extended: FloatArray | None = None,  # (H, W, 3) a plain backdrop's color behind the object
) -> BoolArray:
    """Where the object is (H, W): regions that grow from sure pixels to the picture's edges."""
    apart = np.abs(picture - color).max(axis=2)
    is_backdrop = known & (apart < _SAME)
    if extended is not None:  # what is connected with the border: the object may be as white
        like = is_backdrop | (np.abs(picture - extended).max(axis=2) < _SAME)
        ratio = (picture + _SAME) / (extended + _SAME)
        low, high = ratio.min(axis=2), ratio.max(axis=2)
        shaded = (high - low < _GRAY) & (low > _SHADE) & (high < 1 + _GRAY)
        like |= shaded & (_steps(picture) < _SMOOTH)
        is_backdrop |= _at_border(like)
    outside = binary_erosion(is_backdrop, border_value=1)
    differs = known & (apart > 3 * _SAME)
    if extended is not None:
        differs |= ~known & (np.abs(picture - extended).max(axis=2) > 3 * _SAME)
    inside = binary_erosion(differs | (may_be & ~is_backdrop), iterations=2, border_value=1)
    if not inside.any():
        return inside
    markers = inside.astype(np.int16) * 2 + (outside & ~inside)
    grown = watershed_ift(_steps(picture), markers) == 2
    parts, n = label(binary_opening(grown))
    sizes = np.bincount(parts.ravel(), minlength=n + 1)
    sizes[0] = 0
    kept = sizes >= max(_LEAST_PART * sizes.max(), 1)
    return np.asarray(kept[parts])


def _steps(picture: FloatArray) -> UInt8Array:
    """Strength of the edges (H, W)."""
    found = [gaussian_gradient_magnitude(picture[..., c], 1.0) for c in range(3)]
    return np.clip(4 * np.max(found, axis=0), 0, 255).astype(np.uint8)


def _mask_of(photo: Photo, files: dict[str, Path]) -> Path | None:
    source = Path(photo.source)
    names = [f"{source.name}.png", f"{photo.name}.png"]
    names += [
        f"{Path(n).stem}{suffix}" for n in (source.name, photo.name) for suffix in IMAGE_SUFFIXES
    ]
    return next((files[name.lower()] for name in names if name.lower() in files), None)


def _write(target: Path, photo: Photo, mask: BoolArray) -> None:
    """As large as the photo, under the name that COLMAP looks for."""
    image = Image.fromarray(mask.astype(np.uint8) * np.uint8(255))
    image = image.resize((photo.width, photo.height), Image.Resampling.BICUBIC)
    image.point(lambda value: 255 * (value > 127)).save(target / f"{photo.name}.png")
