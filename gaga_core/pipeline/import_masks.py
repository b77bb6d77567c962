"""Import of 2D masks that another program made: into SCENE/masks/<name>/<stem>.png."""

import dataclasses
import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError, counted
from gaga_core.io.files import safe_name
from gaga_core.io.folder.scene_folder import SceneFolder, select_views
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.masks.label_maps import view_key, write_labels
from gaga_core.io.masks.other_programs import ImportedMasks, MaskList, recognise
from gaga_core.masks import dense_labels, resize_labels
from gaga_core.progress import Progress, Stage
from gaga_core.segmentation.base import MOST_LABELS, FlattenConfig, flatten, scored_masks

STAGE = "Import masks"
SHAPE_TOLERANCE = 0.01  # relative difference of the sides' ratio that is taken for rounding
_TAILS = re.compile(r"[._-](masks?|seg|segmentation|labels?|anns?|annotations?|instances?)$", re.I)
_LISTED = 5  # names in a sentence
_MOST = 0.75  # share of the numbered masks that must have a photo of their number


@dataclass(frozen=True)
class ImportReport:
    """Result of an import."""

    recognised: str  # one sentence: the form they came in
    name: str  # of the new mask folder
    folder: str
    views: tuple[str, ...]  # that have masks now
    without: tuple[str, ...]  # train photos that have no masks now, misfits included
    unmatched: tuple[str, ...]  # masks that belong to no view
    resized: tuple[str, ...]  # views whose masks had another size (nearest neighbour)
    misfits: tuple[str, ...]  # views whose masks have another shape than the photo: left out
    n_masks: int  # in all views
    has_tests: bool  # there are photos for tests, which need none

    def notes(self) -> list[str]:
        """Sentences for people."""
        found = [self.recognised]
        which = "for training " if self.has_tests else ""
        of_them = ", those of another shape included" if self.misfits else ""
        for names, what, text in (
            (self.unmatched, "mask", "matched no photo by name"),
            (
                self.misfits,
                "photo",
                "got none, because the masks have another shape than the photo",
            ),
            (self.resized, "photo", "had masks of another size, which were resized"),
            (self.without, "photo", f"{which}got no masks{of_them}"),
        ):
            if names:
                more = ", ..." if len(names) > _LISTED else ""
                found.append(
                    f"{counted(len(names), what)} {text} ({', '.join(names[:_LISTED])}{more})."
                )
        return found

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        return asdict(self) | {"notes": self.notes()}


def import_masks(
    folder: SceneFolder,
    source: Path,
    name: str | None = None,
    *,
    config: FlattenConfig | None = None,
    replace: bool = False,
) -> Stage[ImportReport]:
    """Write the masks of ``source`` as ``folder.root / "masks" / name``, one map a view.

    ``source`` is whatever `io.mask_import.recognise` knows. Views are found by the name of their
    photo (`match_views`). Lists of masks are flattened (section 4.1) as ``config`` says, but for
    those of EntitySeg, whose masks the published code keeps however little of them is visible;
    those without scores are all taken as sure. Maps of another size are resized to the view's where
    the shape fits. The folder appears whole or not at all. Raises ``GagaError`` when nothing was
    recognised, no mask fits a view, or ``name`` is there already (unless ``replace``).
    """
    cameras = select_views(folder, "all")
    found = recognise(source, [camera.name for camera in cameras])
    name = name or safe_name(found.name)
    target = folder.root / "masks" / name
    _check_target(source, target, replace=replace)
    matched, unmatched = match_views([c.name for c in cameras], found.views)
    if not matched:
        raise GagaError(
            f"None of the {len(found.views)} masks in {source} has the name of a photo of this "
            f"scene (first: {next(iter(found.views), 'none')}, photos: {cameras[0].name}, ...)."
        )
    config = config or FlattenConfig()
    if found.keeps_covered:
        config = dataclasses.replace(config, min_visible=0.0)
    counts: dict[str, int] = {}  # masks by view
    odd: dict[str, list[str]] = {"resized": [], "misfits": []}
    with staging_folder(folder.root / "masks") as staging:
        (staging / name).mkdir()
        for i, camera in enumerate(cameras):
            yield Progress(STAGE, i, len(cameras), camera.name)
            if camera.name not in matched:
                continue
            labels = _one_map(found.views[matched[camera.name]](), config)
            if not fits(labels.shape, camera):
                odd["misfits"].append(camera.name)
                continue
            if labels.shape != (camera.height, camera.width):
                labels = resize_labels(labels, camera.width, camera.height)
                odd["resized"].append(camera.name)
            dense, ids = dense_labels(labels)
            if len(ids) > 1 and int(ids[-1]) > MOST_LABELS:
                labels = dense
            write_labels(staging / name / f"{view_key(camera.name)}.png", labels)
            counts[camera.name] = len(ids) - 1
        photos = folder.train_photos or folder.train
        report = ImportReport(
            recognised=found.said,
            name=name,
            folder=str(target),
            views=tuple(counts),
            without=tuple(photo for photo in photos if photo not in counts),
            unmatched=unmatched,
            resized=tuple(odd["resized"]),
            misfits=tuple(odd["misfits"]),
            n_masks=sum(counts.values()),
            has_tests=bool(folder.test),
        )
        if not report.views:
            raise GagaError(
                f"No masks in {source} have the shape of their photo (first: {report.misfits[0]}). "
                "Make them from the same photos."
            )
        text = json.dumps(report.to_json(), indent=1) + "\n"
        (staging / name / "import.json").write_text(text, encoding="utf-8")
        publish_all(staging, [name], folder.root / "masks")
    return report


def _check_target(source: Path, target: Path, *, replace: bool) -> None:
    if Path(target.name).name != target.name or target.name.startswith("."):
        raise GagaError(f"{target.name!r} is no name for a folder of masks. Choose another.")
    if source.resolve() == target.resolve():
        raise GagaError(f"{source} is the mask folder itself: there is nothing to import.")
    if target.exists() and not replace:
        raise GagaError(
            f"There are masks called {target.name} already. Choose another name, or replace them."
        )


def _one_map(masks: ImportedMasks, config: FlattenConfig) -> IntArray:
    if isinstance(masks, MaskList):
        scored = scored_masks(masks.masks, masks.scores, masks.height, masks.width)
        return flatten(scored, config)
    return masks


def fits(shape: tuple[int, ...], camera: Camera) -> bool:
    """Whether a map (H, W) has the shape of the view, up to rounding of a shrunk side."""
    height, width = shape
    if min(height, width) < 1:
        return False
    ratio = (width / height) / (camera.width / camera.height)
    one_pixel = 1.0 / min(height, width)
    return abs(ratio - 1) <= max(SHAPE_TOLERANCE, one_pixel)


def match_views(
    views: Iterable[str], keys: Iterable[str]
) -> tuple[dict[str, str], tuple[str, ...]]:
    """The mask of each view by its name, and the masks that belong to none.

    A mask belongs to the photo of its path without suffix, or of its stem where no other photo has
    that; or of its name with the suffix (a.jpg.png), without a tail such as _mask; to the only
    photo whose name starts with it up to the first dot (programs that cut names there); or to the
    only photo of its number, where that explains most of them. Folders of a mask that photos do
    not lie in (images/a.jpg of a COCO file) do not matter where no other mask has the rest.
    """
    names, keys = list(views), list(keys)
    exact = {view_key(name): name for name in names}
    rules = (
        exact,
        _unique((Path(name).stem, name) for name in names),
        {name: name for name in names},
        _unique((Path(name).name, name) for name in names),
        _unique((Path(name).name.split(".")[0], name) for name in names),
    )
    ends = Counter(end for key in keys for end in _ends(key))
    matched: dict[str, str] = {}
    left = []
    # Exact names first, so that no guess takes a photo from the mask that is called like it.
    for key in sorted(keys, key=lambda key: (key not in exact, key)):
        words = [end for end in _ends(key) if end == key or ends[end] == 1]
        words = [form for word in words for form in (word, _TAILS.sub("", word))]
        candidates = [rule.get(word) for rule in rules for word in words]
        free = [name for name in candidates if name is not None and name not in matched]
        if free:
            matched[free[0]] = key
        else:
            left.append(key)
    matched |= _by_number([name for name in names if name not in matched], left)
    used = set(matched.values())
    return matched, tuple(sorted(key for key in left if key not in used))


def _ends(key: str) -> Iterator[str]:
    """A path, then it without its first folder, and so on to its name."""
    parts = key.split("/")
    return ("/".join(parts[i:]) for i in range(len(parts)))


def _by_number(names: Iterable[str], keys: Iterable[str]) -> dict[str, str]:
    """Masks that are called by a number, for the only photo that ends with it.

    None at all when few of them have a photo, or when masks count from 0 and photos do not: then
    the numbers are places in a list, and each mask would go to a wrong photo.
    """
    by_number = _unique((_number(Path(name).stem), name) for name in names)
    numbers = {str(int(key)): key for key in keys if key.isdecimal()}
    found = {by_number[n]: key for n, key in numbers.items() if n in by_number}
    counts_places = "0" in numbers and "0" not in by_number
    return {} if counts_places or len(found) < _MOST * len(numbers) else found


def _unique(pairs: Iterable[tuple[str, str]]) -> dict[str, str]:
    found: dict[str, list[str]] = {}
    for word, name in pairs:
        if word:
            found.setdefault(word, []).append(name)
    return {word: names[0] for word, names in found.items() if len(names) == 1}


def _number(stem: str) -> str:
    digits = re.search(r"(\d+)$", stem)
    return str(int(digits.group(1))) if digits else ""
