"""Masks without any model: regions merged on color, contour and the splats' depth.

Superpixels (SLIC, Achanta 2012) are merged pair by pair, the most alike first, to a tree; it is cut
where a merge is unlikely: parts that differ, or a shape that objects do not have. Depth
adds the shape of the surface: objects meet what they stand on in a concave crease (Stein 2014,
"Convexity based object partitioning"), and their own edges are convex. Nothing here knows what an
object is: a quick start, not a match for Segment Anything.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from PIL import Image

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, UInt8Array, check_shape
from gaga_core.color import WHITE, XYZ_FROM_RGB, linear_of_srgb
from gaga_core.masks import resize_labels
from gaga_core.progress import Progress, Stage
from gaga_core.segmentation.base import ModelCard, Picture, fingerprint_of
from gaga_core.settings import setting

NAME = "regions"
FURTHER_STEPS = (0.7, 1.5, 2.0)  # of detail: maps that are written next to the one that is shown
_LINEAR = linear_of_srgb(np.arange(256) / 255).astype(np.float32)  # light of a byte
_LIGHT_TO_XYZ = (XYZ_FROM_RGB / WHITE[:, None]).astype(np.float32)
_SMOOTH_RADIUS = 3  # pixels
_SMOOTH_SPACE, _SMOOTH_VALUE = 5.0, 12.0  # sigmas: pixels, Lab units
_CONTOUR_SCALES = ((1.7, 0.6), (4.6, 0.8))  # sigma in pixels, weight: contour, and not texture
_ROUNDS = 6  # of SLIC
_BY_COLOR = 1.625  # times wider superpixels without depth: smaller ones follow grain
_REACH = 3  # pixels to both sides over which a crease is searched
_DEPTH_SIGMA = 1.5  # pixels of smoothing
_LOG_DEPTH = 90.0  # Lab units of superpixels for a step by the factor e
_NORMAL = 20.0  # Lab units of superpixels for a unit between normals
_NOISE_SIGMA = 12.0  # pixels around over which roughness is meaned
_ROUGH_MOST = 4.0  # half strengths: a true step counts no more than this as roughness
_ROUGH = 0.9  # share of the mean roughness around that is no crease


@dataclass(frozen=True)
class RegionsConfig:
    """Settings. ``detail`` is the one to play with; finer regions lie within the coarser ones."""

    detail: float = setting(1.0, "Detail", least=0.2, most=5.0)
    """2: about twice the regions, 0.5: about half of them. 0.2..5."""
    width: int = 480
    """Pixels of the width at which the work is done; larger photos are shrunk. 16 or more."""
    superpixel: float = 8.0
    """Side of the pieces that merging starts from, in pixels; 1.6 times as much without depth."""
    compactness: float = 87.0
    """How square these pieces are, in squared Lab units. Above 0."""
    mean: float = 0.83
    """Cost of a Lab unit between the mean colors of two regions. 0 or more."""
    histogram: float = 16.0
    """Cost of color histograms that share nothing. 0 or more."""
    contour: float = 0.44
    """Cost of a Lab unit of gradient along the common border. 0 or more."""
    size_power: float = 0.36
    """How easily small regions are lost: power of their share of the picture. 0..1."""
    crease: float = setting(35.0, "Weight of creases", least=0.0, most=100.0)
    """Cost of a sharp concave crease of the surface or a step in depth. 0 or more."""
    flat: float = 0.4
    """Share of the cost of colors that is left where the surface shows no crease. 0..1."""
    bend: float = 0.013
    """Second difference of 1 / depth, over its value, at which a crease counts half. Above 0."""
    fold: float = 0.3
    """Change of unit normals at which a crease counts half. Above 0."""
    none_without_depth: bool = False
    """Give 0 to pixels where the splats show nothing."""

    def __post_init__(self) -> None:
        for name in ("detail", "superpixel", "compactness", "bend", "fold"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: {getattr(self, name)} is not positive")
        for name in ("mean", "histogram", "contour", "size_power", "crease"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name}: {getattr(self, name)} is negative")
        if self.width < 16:
            raise ValueError(f"width: {self.width} is under 16")
        if not 0 <= self.flat <= 1:
            raise ValueError(f"flat: {self.flat} is not in [0, 1]")


def regions(
    image: UInt8Array,
    depth: FloatArray | None = None,
    normals: FloatArray | None = None,
    config: RegionsConfig | None = None,
) -> IntArray:
    """Split a photo (H, W, 3) uint8 into regions: label map (H, W) int32, dense ids from 1.

    ``depth`` (H, W) float32 is the camera depth that the splats show at each pixel in any unit (the
    median depth is the sharper one), 0 or not finite = nothing there. ``normals`` (H, W, 3) float32
    are unit, in the camera's frame and towards the camera, 0 = nothing there. No pixel is 0 unless
    ``config.none_without_depth``. Deterministic. Raises ``ValueError`` when shapes or dtypes do not
    fit.
    """
    return regions_at((1.0,), image, depth, normals, config)[0]


def regions_at(
    steps: Sequence[float],
    image: UInt8Array,
    depth: FloatArray | None = None,
    normals: FloatArray | None = None,
    config: RegionsConfig | None = None,
) -> list[IntArray]:
    """`regions` at several levels of detail, each so many times ``config.detail``.

    About as fast as one of them: the tree of merges is made once and cut several times.
    """
    config = config or RegionsConfig()
    check_shape("image", image, ("H", "W", 3), np.uint8)
    height, width = image.shape[:2]
    if depth is not None:
        check_shape("depth", depth, (height, width), np.float32)
    if normals is not None:
        check_shape("normals", normals, (height, width, 3), np.float32)
    if image.size == 0:
        return [np.zeros((height, width), np.int32) for _ in steps]
    small = _shrunk(image, config.width)
    inverse = None if depth is None else _inverse_depth(_sampled(depth, small))
    facing = None if normals is None else _sampled(normals, small)
    details = [step * config.detail for step in steps]
    found = []
    for cut in _small_regions(small, inverse, facing, config, details):
        labels = resize_labels(cut + 1, width, height)
        if depth is not None and config.none_without_depth:
            labels = np.where(_seen(depth), labels, np.int32(0))
        found.append(_dense(labels))
    return found


def _shrunk(image: UInt8Array, width: int) -> UInt8Array:
    """The photo at working size, pixels averaged; never enlarged."""
    height, full = image.shape[:2]
    if full <= width:
        return np.ascontiguousarray(image)
    size = (width, max(1, round(height * width / full)))
    return np.array(Image.fromarray(image).resize(size, Image.Resampling.BOX))


def _seen(depth: FloatArray) -> BoolArray:
    """Where there is a surface, (H, W)."""
    return np.isfinite(depth) & (depth > 0)


def _sampled(values: FloatArray, like: UInt8Array) -> FloatArray:
    """A map (H, W) or (H, W, C) at working size: nearest, for means across a step are nowhere."""
    rows = ((np.arange(like.shape[0]) + 0.5) * values.shape[0] / like.shape[0]).astype(np.int64)
    columns = ((np.arange(like.shape[1]) + 0.5) * values.shape[1] / like.shape[1]).astype(np.int64)
    return np.ascontiguousarray(values[rows[:, None], columns[None, :]])


def _inverse_depth(depth: FloatArray) -> FloatArray | None:
    """1 / depth, smoothed, 0 where there is nothing; None if there is nothing at all."""
    seen = _seen(depth)
    if not seen.any():
        return None
    inverse = np.zeros_like(depth)
    inverse[seen] = 1 / depth[seen]
    bell = _bell(_DEPTH_SIGMA)
    return _filtered(inverse, bell, bell)


def _small_regions(
    image: UInt8Array,
    inverse: FloatArray | None,  # (H, W)
    normals: FloatArray | None,  # (H, W, 3)
    config: RegionsConfig,
    details: Sequence[float],
) -> list[IntArray]:
    """Regions (H, W) at working size and each of ``details``: ids >= 0, not dense."""
    from gaga_core.segmentation import regions_kernels

    lab = np.empty((3, *image.shape[:2]), np.float32)
    regions_kernels.lab_planes(image, _LINEAR, _LIGHT_TO_XYZ, lab)
    smooth = np.empty_like(lab)
    space, value = 0.5 / _SMOOTH_SPACE**2, 0.5 / _SMOOTH_VALUE**2
    regions_kernels.smooth(lab, _SMOOTH_RADIUS, space, value, smooth)
    features, cues, creases = [smooth], [_contours(smooth)], []
    if inverse is not None:
        # In float64: logarithms of float32 round otherwise on other processors.
        nearness = np.maximum(inverse / inverse[inverse > 0].min(), 1).astype(np.float64)
        features.append((_LOG_DEPTH * np.log(nearness)).astype(np.float32)[None])
        bend = np.empty_like(inverse)
        regions_kernels.creases(inverse, _REACH, bend)
        creases.append(_above_noise(bend, config.bend))
    if normals is not None:
        features.append(np.moveaxis(np.float32(_NORMAL) * normals, 2, 0))
        fold = np.empty(normals.shape[:2], np.float32)
        regions_kernels.folds(normals, _REACH, fold)
        creases.append(_above_noise(fold, config.fold))
    if creases:
        cues.append(np.maximum.reduce(creases))
    side = config.superpixel * (1 if creases else _BY_COLOR)
    stacked = np.concatenate(features, axis=0, dtype=np.float32)
    pieces, n = _superpixels(stacked, side, config.compactness)
    costs = (config.mean, config.histogram, config.contour, config.size_power)
    weights = np.array([*costs, config.flat, config.crease])
    return merged(lab, pieces, n, np.stack(cues), weights, details)


def _bell(sigma: float) -> FloatArray:
    """Weights (2 R + 1,) of a Gaussian, pixels, as far as four times its deviation."""
    away = np.arange(-int(4 * sigma + 0.5), int(4 * sigma + 0.5) + 1)
    weights = np.exp(-0.5 * (away / sigma) ** 2)
    bell: FloatArray = (weights / weights.sum()).astype(np.float32)
    return bell


def _filtered(image: FloatArray, down: FloatArray, along: FloatArray) -> FloatArray:
    from gaga_core.segmentation import regions_kernels

    out = np.empty_like(image)
    regions_kernels.filtered(image, down, along, out)
    return out


def _above_noise(bend: FloatArray, half: float) -> FloatArray:
    """Strength 0..1 of creases (H, W): what stands out of the roughness around, ``half`` is 0.5.

    Surfaces of splats are rough, the more the less texture held them in training.
    """
    most, bell = np.float32(_ROUGH_MOST * half), _bell(_NOISE_SIGMA)
    rough = _filtered(np.minimum(bend, most), bell, bell)
    clear: FloatArray = np.maximum(bend - np.float32(_ROUGH) * rough, 0).astype(np.float32)
    strength: FloatArray = (clear / (clear + np.float32(half))).astype(np.float32)
    return strength


def _contours(smooth: FloatArray) -> FloatArray:
    """Gradient (H, W) in Lab units, of two scales, of a picture (3, H, W)."""
    found = np.zeros(smooth.shape[1:], np.float32)
    for sigma, weight in _CONTOUR_SCALES:
        bell, squared = _bell(sigma), np.zeros_like(found)
        away = np.arange(-(len(bell) // 2), len(bell) // 2 + 1)
        slope = (bell * away / sigma).astype(np.float32)  # times sigma: of that many pixels
        for channel, share in zip(smooth, (1, 2.25, 2.25), strict=True):
            for down, along in ((slope, bell), (bell, slope)):
                squared += np.float32(share) * _filtered(channel, down, along) ** 2
        found += np.float32(weight) * np.sqrt(squared)
    return found


def _superpixels(features: FloatArray, side: float, compactness: float) -> tuple[IntArray, int]:
    """Superpixels (H, W) from 0, some ``side`` pixels wide, and their number."""
    from gaga_core.segmentation import regions_kernels

    n_features, height, width = features.shape
    rows = max(1, round(height / side))
    columns = max(1, round(width / side))
    y = ((np.arange(rows) + 0.5) * height / rows).astype(np.int64)
    x = ((np.arange(columns) + 0.5) * width / columns).astype(np.int64)
    grid_y, grid_x = (axis.ravel() for axis in np.meshgrid(y, x, indexing="ij"))
    centres = np.column_stack([features[:, grid_y, grid_x].T, grid_y, grid_x]).astype(np.float32)
    nearness = compactness / side**2
    sums = np.empty((len(centres), n_features + 3))
    labels = np.empty((height, width), np.int32)
    for _ in range(_ROUNDS):
        regions_kernels.nearest_centres(features, centres, rows, columns, nearness, sums, labels)
    pieces, queue = np.empty_like(labels), np.empty(labels.size, np.int32)
    least = int(side**2 / 4)
    return pieces, regions_kernels.connected(labels, features, least, queue, pieces)


def _dense(labels: IntArray) -> IntArray:
    """Ids from 1 in the order of the first pixel of each region; 0 stays."""
    from gaga_core.segmentation import regions_kernels

    out = np.empty_like(labels)
    names = np.zeros(int(labels.max()) + 1, np.int32)
    regions_kernels.number(labels, names, out)
    return out


# --- The tree of the weights-free regions: superpixels merged pair by pair, and where to stop.


_LAB = np.array([0.62, 1.9, 1.9], np.float32)  # lightness changes with shading, hue less
_BINS = 6  # of lightness; two more for each of a and b
# How much a merge's shape favours it (fitted to photos of objects on a table and to drawn scenes):
# start, log share of the smaller and of the larger, how much better than the smaller the union
# fills its box, how well it does, log of its raggedness, share of the smaller's and of the larger's
# border that vanishes. With depth the creases suffice: cost alone decides.
_COLOR_GRANTS = np.array([0.73, 0.166, -0.25, 1.46, -1.31, 0.327, 0.7, 0.74])
_SHAPE_GRANTS = np.array([np.log(4.2), 0, 0, 0, 0, 0, 0, 0])


def merged(
    lab: FloatArray,
    pieces: IntArray,
    n: int,
    cues: FloatArray,
    weights: DoubleArray,
    details: Sequence[float],
) -> list[IntArray]:
    """Regions (H, W) of the ``n`` superpixels ``pieces`` (H, W) at each of ``details``.

    Ids >= 0, not dense. ``lab`` (3, H, W) float32, ``cues`` (1 or 2, H, W) float32: contour and
    crease at each pixel, ``weights`` (6,) of the cost, in the order of `regions_merge_kernels`.
    Those of a higher detail lie within those of a lower one.
    """
    from scipy import ndimage

    from gaga_core.segmentation import regions_kernels as kernels

    flat = pieces.ravel()
    area = np.bincount(flat, minlength=n).astype(np.float32)
    sums = [np.bincount(flat, lab[c].ravel(), n) * _LAB[c] for c in range(3)]
    color = np.column_stack(sums).astype(np.float32)
    bins, n_bins = _color_bins(lab)
    histogram = np.zeros((n, n_bins), np.float32)
    kernels.add_histograms(pieces, bins, histogram)
    crossings = (pieces[1:] != pieces[:-1]).sum() + (pieces[:, 1:] != pieces[:, :-1]).sum()
    most = min(int(crossings), n * (n - 1) // 2)
    sides, ends = np.empty((most, 2), np.int32), np.empty(2 * most, np.int32)
    length, strength = np.zeros(most, np.float32), np.zeros((most, len(cues)), np.float32)
    first = np.full(n, -1, np.int32)
    made = kernels.add_borders(pieces, cues, sides, length, strength, first, ends)
    sides, length, strength, ends = sides[:made], length[:made], strength[:made], ends[: 2 * made]
    at_first = area.copy()
    border = np.bincount(sides.ravel(), np.repeat(length, 2), n).astype(np.float32)
    joined, costs = np.empty((n - 1, 2), np.int32), np.empty(n - 1, np.float32)
    common = np.empty(n - 1, np.float32)
    made = kernels.merge_all(
        area, color, histogram, sides, length, strength, first, ends, weights, joined, costs, common
    )
    grants = _COLOR_GRANTS if len(cues) == 1 else _SHAPE_GRANTS
    # Pixels along the edge of the picture, corners twice; first and last column and row.
    sides = np.concatenate([pieces[0], pieces[-1], pieces[:, 0], pieces[:, -1]])
    edges = np.bincount(sides, minlength=n).astype(np.float32)
    spans = ndimage.find_objects(pieces + 1, max_label=n)
    boxes = np.array([(x.start, x.stop - 1, y.start, y.stop - 1) for y, x in spans], np.int32)
    found = []
    for detail in details:
        parent = np.arange(n, dtype=np.int32)
        tree = joined[:made], costs, common, at_first.copy(), border.copy()
        kernels.cut(*tree, edges.copy(), boxes.copy(), grants, -np.log(detail), parent)
        while not np.array_equal(parent, parent[parent]):
            parent = parent[parent]
        found.append(parent[pieces])
    return found


def _color_bins(lab: FloatArray) -> tuple[IntArray, int]:
    """Bin of each pixel among those that occur, and their number."""
    from gaga_core.segmentation import regions_kernels

    bins = np.empty(lab.shape[1:], np.int32)
    regions_kernels.color_bins(lab, _BINS, _BINS + 2, bins)
    occurs = np.bincount(bins.ravel()) > 0
    return (np.cumsum(occurs, dtype=np.int32) - np.int32(1))[bins], int(occurs.sum())


# --- The weights-free `regions` as a provider: at once, everywhere, also without torch.


_VERSION = 5  # grows whenever the same picture and settings get other regions


@dataclass(frozen=True)
class RegionsProvider:
    """Regions of like color, split where the rendered surface bends; objects only by luck."""

    config: RegionsConfig
    name: str = NAME
    cues: frozenset[str] = frozenset({"depth"})

    @property
    def card(self) -> ModelCard:
        """The card that is written next to the masks."""
        return ModelCard("regions (no model)", settings=asdict(self.config))

    @property
    def work_width(self) -> int:
        """Pixels of the width at which pictures are processed."""
        return self.config.width

    def fingerprint(self) -> str:
        """Hash of the settings."""
        return fingerprint_of(NAME, _VERSION, self.card.settings)

    def label_map(self, picture: Picture) -> Stage[IntArray]:
        """Regions of a picture; one step, under a second at 480 pixels of width."""
        return (yield from self.label_maps(picture))[0]

    def label_maps(self, picture: Picture) -> Stage[tuple[IntArray, ...]]:
        """The label map, and those at `FURTHER_STEPS` times its detail, for about the same time."""
        yield Progress("Segment", 0, 1, "merge regions")
        steps = (1.0, *FURTHER_STEPS)
        found = regions_at(steps, picture.image, picture.depth, picture.normals, self.config)
        return tuple(found)
