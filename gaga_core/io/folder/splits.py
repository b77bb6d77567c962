"""Which views are for training and which for tests: the one owner of that choice.

Reconstruction, masks, association, benchmarks and the window all ask `split_views`, so that no
stage learns from a view that another one scores. Published data sets say it in different ways;
`RULES` lists them, and the first that a scene's folder answers to decides.
"""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from gaga_core.camera import natural_order
from gaga_core.io.files import read_names, write_text
from gaga_core.io.images import pictures_in
from gaga_core.io.json_file import read_json

PARTS = ("train", "test")
TEST_EVERY = 8  # every 8th view by alphabet, as the published loaders of 3DGS take them (LLFF)
REPLICA_EVERY, REPLICA_AFTER = 5, 2  # frames of Semantic-NeRF: 0, 5, ... and 2, 7, ...
EVERY_8TH = "every 8th view by name is a test view"
NAMES = "names train_* and test_*"
FRAMES = "frames 5 apart, tests 2 later (Semantic-NeRF)"
OVS3D = "views with true masks are test views (3D-OVS)"
SCANNET_LISTS, SCANNET_FOLDERS = "train_split.txt and test_split.txt", "train/ and test/ (DM-NeRF)"


@dataclass(frozen=True)
class ViewSplit:
    """Views for training and for tests; a view is never both."""

    train: tuple[str, ...] = ()  # by number in their names
    test: tuple[str, ...] = ()
    rule: str = ""  # what decided, for tables: "split.json", "images_train", ...
    unknown: tuple[str, ...] = ()  # names that the rule lists and no view has


class SplitFile(msgspec.Struct, frozen=True):
    """Content of split.json: names of views, with or without a suffix."""

    train: list[str | int | float]
    test: list[str | int | float]


_Lists = tuple[Sequence[str], Sequence[str]]  # names for training, names for tests
_Rule = Callable[[Path, Sequence[str]], _Lists | None]


def split_views(root: Path, names: Iterable[str]) -> ViewSplit:
    """Part the views ``names`` of the scene in ``root`` as its publisher does.

    In this order: split.json; *_split.txt; the folders train/ and test/ of DM-NeRF; images_train;
    the frames of Semantic-NeRF; the photos with masks of 3D-OVS; names train_* and test_*; else
    every 8th by alphabet is a test view. A view that is listed as both is a test view: nothing is
    trained on it. Raises ``GagaError`` where split.json is no split.
    """
    ordered = sorted(names, key=natural_order)
    for title, rule in RULES.items():
        lists = rule(root, ordered)
        if lists is not None:
            return _split_of(title, lists, ordered)
    test = sorted(ordered)[::TEST_EVERY] if len(ordered) > 1 else []
    return _split_of(EVERY_8TH, ([n for n in ordered if n not in set(test)], test), ordered)


def carry_split(photos: Path, scene: Path) -> None:
    """Write split.json into ``scene``, made of the folder ``photos``, where a file or folder next
    to those photos parts them. What their names say goes along by itself."""
    if not photos.is_dir() or scene in (photos, photos.parent):
        return
    root = photos.parent if photos.name in ("images", "input") else photos
    found = split_views(root, list(pictures_in(photos, "**/*")))
    if found.rule in (EVERY_8TH, NAMES):
        return
    text = json.dumps({"train": found.train, "test": found.test}, indent=1) + "\n"
    write_text(scene / "split.json", text)


def _split_of(rule: str, lists: _Lists, names: Sequence[str]) -> ViewSplit:
    known = _by_form(names)
    found: list[set[str]] = []
    unknown: list[str] = []
    for part in lists:
        views = {word: _meant(word, known) for word in part}
        unknown += [word for word, view in views.items() if view is None]
        found.append({view for view in views.values() if view is not None})
    train, test = found
    return ViewSplit(
        train=tuple(name for name in names if name in train and name not in test),
        test=tuple(name for name in names if name in test),
        rule=rule,
        unknown=tuple(unknown),
    )


def _by_form(names: Sequence[str]) -> Mapping[str, str]:
    """Views by their names, without suffix, and without folder where only one view has that."""
    short: dict[str, list[str]] = {}
    for name in names:
        short.setdefault(Path(name).stem, []).append(name)
    stems = {stem: views[0] for stem, views in short.items() if len(views) == 1}
    whole = {_without_suffix(name): name for name in names}
    return stems | whole | {name: name for name in names}


def _meant(word: str, known: Mapping[str, str]) -> str | None:
    return known.get(word) or known.get(_without_suffix(word))


def _without_suffix(name: str) -> str:
    path = Path(name)
    return (path.parent / path.stem).as_posix()


def _of_json(root: Path, names: Sequence[str]) -> _Lists | None:
    path = root / "split.json"
    if not path.is_file():
        return None
    cure = 'It must be {"train": [names], "test": [names]}. Fix or remove it.'
    split = read_json(path, SplitFile, cure)
    return [str(word) for word in split.train], [str(word) for word in split.test]


def _of_lists(root: Path, names: Sequence[str]) -> _Lists | None:
    """ScanNet: one name or number a line. Where one list is missing, it has the other views."""
    files = {part: root / f"{part}_split.txt" for part in PARTS}
    listed = {
        part: [_stem(word) for word in read_names(file)]
        for part, file in files.items()
        if file.is_file()
    }
    if not any(listed.values()):
        return None
    return _completed(listed.get("train"), listed.get("test"), names)


def _completed(
    train: Sequence[str] | None, test: Sequence[str] | None, names: Sequence[str]
) -> _Lists:
    """Both lists; one that is None holds the views that are not in the other."""
    known = _by_form(names)
    taken = {_meant(word, known) for word in (*(train or ()), *(test or ()))}
    rest = [name for name in names if name not in taken]
    return (rest if train is None else train), (rest if test is None else test)


def _stem(word: str) -> str:
    """The name of a line: numpy's savetxt may have written 12 as 1.2e+01."""
    try:
        return str(int(float(word)))
    except (ValueError, OverflowError):
        return word


def _of_folders(root: Path, names: Sequence[str]) -> _Lists | None:
    """ScanNet as DM-NeRF and Gaga select it: the photos lie in train/train_images and test/..."""
    found = [list(pictures_in(root / part / f"{part}_images", "**/*")) for part in PARTS]
    return (found[0], found[1]) if all(found) else None


def _of_train_photos(root: Path, names: Sequence[str]) -> _Lists | None:
    """LERF-Mask: what is not in images_train is a test view."""
    train = list(pictures_in(root / "images_train", "**/*"))
    return _completed(train, None, names) if train else None


def _of_frames(root: Path, names: Sequence[str]) -> _Lists | None:
    """Replica as Semantic-NeRF has it: every 5th frame trains, the one 2 later tests."""
    if not ((root / "Sequence_1").is_dir() or (root / "traj_w_c.txt").is_file()):
        return None
    numbers = {name: Path(name).stem.rsplit("_", 1)[-1] for name in names}
    place = {n: int(digits) % REPLICA_EVERY for n, digits in numbers.items() if digits.isdecimal()}
    return (
        [name for name, k in place.items() if k == 0],
        [name for name, k in place.items() if k == REPLICA_AFTER],
    )


def _of_segmentations(root: Path, names: Sequence[str]) -> _Lists | None:
    """3D-OVS: the photos with true masks are the test views."""
    truth = root / "segmentations"
    if not truth.is_dir():
        return None
    known = _by_form(names)
    test = [path.name for path in sorted(truth.iterdir()) if path.is_dir()]
    return _completed(None, [key for key in test if key in known], names)


def _of_names(root: Path, names: Sequence[str]) -> _Lists | None:
    """Replica as Gaga has it: train_rgb_0000.png, test_rgb_0000.png; or folders train/, test/."""
    train, test = ([name for name in names if _is_of(name, part)] for part in PARTS)
    return (train, test) if train and test else None


def _is_of(name: str, part: str) -> bool:
    path = Path(name)
    return path.name.startswith(f"{part}_") or part in path.parent.parts


RULES: Mapping[str, _Rule] = {
    "split.json": _of_json,
    SCANNET_LISTS: _of_lists,
    SCANNET_FOLDERS: _of_folders,
    "images_train": _of_train_photos,
    FRAMES: _of_frames,
    OVS3D: _of_segmentations,
    NAMES: _of_names,
}
