"""The index of a scene: one vector a group, from its best views, and how texts are ranked by it.

A group's vector is the mean of those of its crops, plain and with dimmed surroundings. Only groups
whose splats have changed are looked at again. The relevancy of a text is its similarity against
that of phrases that fit anything, the least favourable one (LERF, Kerr et al., ICCV 2023).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.arrays import (
    MOST_GROUP,
    DoubleArray,
    FloatArray,
    IntArray,
    LongArray,
    UInt8Array,
)
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.io.arrays_file import TEXT, Column, read_columns
from gaga_core.io.files import atomic_write
from gaga_core.progress import Progress, Stage
from gaga_core.query.embed import Embedder

# --- Pictures of a group: in which views it shows best, cut out square, its surroundings dimmed.


MARGIN = 0.10  # of the box on each side
KEEP = 0.30  # of the surroundings; the rest is grey
_CUT = 0.35  # what a view is worth in which the group is cut by the picture's border
_MIN_SIDE = 8  # pixels; a group that is smaller in a view is not looked at
_GREY = 128


@dataclass(frozen=True)
class Shown:
    """A group in one view."""

    group: int
    view: int
    box: tuple[int, int, int, int]  # left, top, right, bottom, pixels
    score: float  # pixels, less when the border cuts the group


def shown_groups(view: int, labels: IntArray) -> tuple[Shown, ...]:
    """Where each group shows in a label map (H, W); 0 is none."""
    from scipy.ndimage import find_objects

    height, width = labels.shape
    ids, dense = np.unique(labels, return_inverse=True)
    area = np.bincount(dense.ravel(), minlength=len(ids))
    places = find_objects(dense.reshape(labels.shape) + 1)
    found = []
    for group, n, place in zip(ids, area, places, strict=True):
        if group <= 0 or place is None:
            continue
        rows, columns = place
        if min(rows.stop - rows.start, columns.stop - columns.start) < _MIN_SIDE:
            continue
        cut = rows.start == 0 or columns.start == 0 or rows.stop == height or columns.stop == width
        box = (columns.start, rows.start, columns.stop, rows.stop)
        found.append(Shown(int(group), view, box, float(n) * (_CUT if cut else 1.0)))
    return tuple(found)


def best_views(shown: Sequence[Shown], n_best: int) -> Mapping[int, tuple[Shown, ...]]:
    """Of every group the ``n_best`` views that show most of it, the best first."""
    by_group: dict[int, list[Shown]] = {}
    for one in shown:
        by_group.setdefault(one.group, []).append(one)
    order = {g: sorted(all_, key=lambda s: (-s.score, s.view)) for g, all_ in by_group.items()}
    return {group: tuple(found[:n_best]) for group, found in sorted(order.items())}


def cut_out(
    picture: UInt8Array, labels: IntArray, one: Shown, side: int
) -> tuple[UInt8Array, UInt8Array]:
    """A group cut out of a picture (H, W, 3): as it is, and with its surroundings dimmed.

    Both (side, side, 3): the box with `MARGIN` around it, made square with grey.
    """
    height, width = labels.shape
    left, top, right, bottom = one.box
    dx, dy = round(MARGIN * (right - left)), round(MARGIN * (bottom - top))
    left, top = max(0, left - dx), max(0, top - dy)
    right, bottom = min(width, right + dx), min(height, bottom + dy)
    cut = picture[top:bottom, left:right]
    own = labels[top:bottom, left:right] == one.group
    grey: FloatArray = KEEP * cut.astype(np.float32) + (1 - KEEP) * np.float32(_GREY)
    dimmed = np.where(own[:, :, None], cut, np.rint(grey).astype(np.uint8))
    return _square(cut, side), _square(dimmed, side)


def _square(picture: UInt8Array, side: int) -> UInt8Array:
    height, width = picture.shape[:2]
    n = max(height, width)
    board = np.full((n, n, 3), _GREY, np.uint8)
    y, x = (n - height) // 2, (n - width) // 2
    board[y : y + height, x : x + width] = picture
    return np.asarray(Image.fromarray(board).resize((side, side), Image.Resampling.BICUBIC))


STAGE = "Index the objects"
THUMBNAIL = 64  # pixels a side
_CURE = "Remove it and build the index again."
_UNIT = 1.001  # largest component of a vector of length 1, rounded
_FILE = {  # arrays of the index
    "model": TEXT,
    "groups": Column(np.int32, ("G",), low=0, high=MOST_GROUP),
    "digests": Column(np.int64, ("G",)),
    "vectors": Column(np.float32, ("G", "D"), low=-_UNIT, high=_UNIT),
    "thumbnails": Column(np.uint8, ("G", THUMBNAIL, THUMBNAIL, 3)),
}
_TEXTS = {  # and of the file of texts
    "model": TEXT,
    "texts": replace(TEXT, shape=("T",)),
    "vectors": Column(np.float32, ("T", "D"), low=-_UNIT, high=_UNIT),
}
_ANYTHING = ("object", "things", "stuff", "texture")  # what every crop is a picture of
_SHARPNESS = 50.0  # how fast relevancy grows with a difference of cosines
_TEMPLATE = "a photo of a {}"


@dataclass(frozen=True, eq=False)
class IndexedViews:
    """Data that an index is made from."""

    cameras: Sequence[Camera]
    labels_of: Callable[[Camera], IntArray]  # group map (H, W) at the camera's size
    picture_of: Callable[[Camera], UInt8Array]  # (H, W, 3) at the camera's size


@dataclass(frozen=True)
class IndexConfig:
    """Settings of the crops of groups."""

    n_views: int = 4  # best views of a group
    crop: int = 224  # pixels a side
    batch: int = 4  # crops between two steps of progress

    def __post_init__(self) -> None:
        if min(self.n_views, self.crop, self.batch) < 1:
            raise ValueError(f"index: numbers must be positive: {self}")


@dataclass(frozen=True, eq=False)
class GroupIndex:
    """Vectors of groups, and what they were made from."""

    model: str  # fingerprint of the embedder
    groups: IntArray  # (G,) ascending
    digests: LongArray  # (G,) of the splats of each group when it was looked at
    vectors: FloatArray  # (G, D) length 1; 0 = no view shows the group
    thumbnails: UInt8Array  # (G, THUMBNAIL, THUMBNAIL, 3)

    def __len__(self) -> int:
        return len(self.groups)


def index_stage(
    groups: IntArray,
    digests: LongArray,
    views: IndexedViews,
    embedder: Embedder,
    *,
    previous: GroupIndex | None = None,
    config: IndexConfig | None = None,
) -> Stage[GroupIndex]:
    """Index ``groups`` (G,), whose splats have ``digests`` (G,), as ``views`` show them.

    What ``previous`` knows of the same splats with the same model is taken over. Yields between
    views and between batches of crops; closing it leaves ``previous`` as it was.
    """
    config = config or IndexConfig()
    known = _known(previous, embedder.fingerprint)
    new = [int(g) for g, d in zip(groups, digests, strict=True) if int(d) not in known]
    found: dict[int, tuple[FloatArray, UInt8Array]] = {}
    if new:
        found = yield from _look_at(new, views, embedder, config)
    dims = {len(vector) for vector, _ in (*found.values(), *known.values())} - {0}
    if len(dims) > 1:
        raise GagaError(f"The index is of another model of the same name. {_CURE}")
    dim = max(dims, default=0)
    nothing = (np.zeros(dim, np.float32), np.full((THUMBNAIL, THUMBNAIL, 3), 128, np.uint8))
    rows = [
        known[int(d)] if int(d) in known else found.get(int(g), nothing)
        for g, d in zip(groups, digests, strict=True)
    ]
    n = len(rows)
    # Of an index that saw no group at all the vectors are empty.
    vectors = np.array([row[0] if len(row[0]) else nothing[0] for row in rows])
    vectors = vectors.astype(np.float32).reshape(n, dim)
    pictures = np.array([row[1] for row in rows], np.uint8)
    thumbnails = pictures.reshape(n, THUMBNAIL, THUMBNAIL, 3)
    return GroupIndex(embedder.fingerprint, groups, digests, vectors, thumbnails)


def n_stale(index: GroupIndex | None, digests: LongArray) -> int:
    """How many of the groups with these digests ``index`` does not know (yet, or any more)."""
    known = np.zeros(0, np.int64) if index is None else index.digests
    return int((~np.isin(digests, known)).sum())


def relevancy(index: GroupIndex, text: FloatArray, anything: FloatArray) -> DoubleArray:
    """How well each indexed group (G,) fits a text's vector (D,), 0..1; 1/2 = as well as the
    phrases ``anything`` (P, D) that fit all. A group that no view shows scores 0."""
    own = index.vectors @ text
    rival = index.vectors @ anything.T
    ahead = _SHARPNESS * (own[:, None] - rival).min(axis=1).astype(np.float64)
    seen = np.abs(index.vectors).max(axis=1, initial=0) > 0
    return np.where(seen, 1 / (1 + np.exp(-np.clip(ahead, -60, 60))), 0.0)


class TextVectors:
    """Vectors of texts by a model that is loaded when a text is new, kept in a file.

    ``path`` None keeps them in memory only; vectors of another ``dim`` are not read from it.
    ``load`` is called at most once.
    """

    def __init__(
        self, model: str, load: Callable[[], Embedder], path: Path | None = None, dim: int = 0
    ) -> None:
        self.model = model
        self._load = load
        self._path = path
        self._embedder: Embedder | None = None
        self._kept = _read_texts(path, model, **({"D": dim} if dim else {}))

    def of(self, texts: Sequence[str]) -> FloatArray:
        """Vectors (n, D) of ``texts``."""
        missing = [text for text in dict.fromkeys(texts) if text not in self._kept]
        if missing:
            self._embedder = self._embedder or self._load()
            rows = self._embedder.texts(missing)
            self._kept |= dict(zip(missing, rows, strict=True))
            self._save()
        return np.stack([self._kept[text] for text in texts])

    def anything(self) -> FloatArray:
        """Vectors (P, D) of phrases that fit any crop."""
        return self.of([_TEMPLATE.format(word) for word in _ANYTHING])

    def nouns(self, nouns: Sequence[str]) -> FloatArray:
        """Vectors (n, D) of nouns, each in a sentence as the models were trained on."""
        return self.of([_TEMPLATE.format(noun) for noun in nouns])

    def _save(self) -> None:
        if self._path is None:
            return
        names = sorted(self._kept)
        vectors = np.stack([self._kept[name] for name in names])
        with atomic_write(self._path) as temporary, temporary.open("wb") as file:
            np.savez(file, model=np.array(self.model), texts=np.array(names), vectors=vectors)


def save_index(path: Path, index: GroupIndex) -> None:
    """Write ``index`` to an .npz in one step."""
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **vars(index) | {"model": np.array(index.model)})


def load_index(path: Path) -> GroupIndex | None:
    """The index in ``path``; None when there is none yet. ``GagaError`` when it is damaged."""
    if not path.is_file():
        return None
    arrays = read_columns(path, _CURE, _FILE)
    columns = (arrays[name] for name in ("groups", "digests", "vectors", "thumbnails"))
    return GroupIndex(str(arrays["model"]), *columns)


def _known(previous: GroupIndex | None, model: str) -> dict[int, tuple[FloatArray, UInt8Array]]:
    """Rows of the former index by digest; an id may have changed, the splats have not."""
    if previous is None or previous.model != model:
        return {}
    rows = zip(previous.digests, previous.vectors, previous.thumbnails, strict=True)
    return {int(digest): (vector, picture) for digest, vector, picture in rows}


def _look_at(
    groups: Sequence[int],
    views: IndexedViews,
    embedder: Embedder,
    config: IndexConfig,
) -> Stage[dict[int, tuple[FloatArray, UInt8Array]]]:
    """Vector and thumbnail of each of ``groups`` that some view shows."""
    wanted, cameras = set(groups), views.cameras
    maps: list[IntArray] = []
    shown: list[Shown] = []
    total = 2 * len(cameras)
    for i, camera in enumerate(cameras):
        yield Progress(STAGE, i, total, f"Find objects in {camera.name}")
        maps.append(views.labels_of(camera))
        shown += [one for one in shown_groups(i, maps[i]) if one.group in wanted]
    chosen = best_views(shown, config.n_views)
    by_view: dict[int, list[Shown]] = {}
    for best in chosen.values():
        for one in best:
            by_view.setdefault(one.view, []).append(one)
    sums: dict[int, FloatArray] = {}
    thumbnails: dict[int, UInt8Array] = {}
    side = (THUMBNAIL, THUMBNAIL)
    firsts = {(best[0].group, best[0].view) for best in chosen.values()}
    for i, camera in enumerate(cameras):
        ones = by_view.get(i, [])
        picture = views.picture_of(camera) if ones else None
        for start in range(0, len(ones), config.batch):
            assert picture is not None
            yield Progress(STAGE, len(cameras) + i, total, f"Look at objects in {camera.name}")
            batch = ones[start : start + config.batch]
            pairs = [cut_out(picture, maps[i], one, config.crop) for one in batch]
            vectors = embedder.pictures([crop for pair in pairs for crop in pair])
            for k, one in enumerate(batch):
                both = vectors[2 * k] + vectors[2 * k + 1]
                sums[one.group] = sums.get(one.group, np.zeros_like(both)) + both
                if (one.group, one.view) in firsts:
                    small = Image.fromarray(pairs[k][0]).resize(side, Image.Resampling.BICUBIC)
                    thumbnails[one.group] = np.asarray(small)
    yield Progress(STAGE, total, total, f"{len(sums)} objects")
    lengths = {g: max(float(np.linalg.norm(total_)), 1e-12) for g, total_ in sums.items()}
    return {g: ((total_ / lengths[g]).astype("f4"), thumbnails[g]) for g, total_ in sums.items()}


def _read_texts(path: Path | None, model: str, **lengths: int) -> dict[str, FloatArray]:
    """Vectors kept in ``path`` by text; none when they are of another model or damaged.

    ``lengths``: D, where it is known.
    """
    if path is None or not path.is_file():
        return {}
    try:
        arrays = read_columns(path, _CURE, _TEXTS, **lengths)
    except GagaError:
        return {}
    if str(arrays["model"]) != model:
        return {}
    return dict(zip(arrays["texts"].tolist(), arrays["vectors"], strict=True))
