"""LERF-Mask (Ye et al., ECCV 2024): COLMAP scenes with masks of text prompts.

``<scene>/{images, images_train, sparse/0, test_mask/<i>/<text prompt>.png, object_mask}``. The test
views are the photos that are not in images_train, by name; ``<i>`` counts them. A folder that is
missing (teatime has none for view 1) has no truth, so that view is not scored.
"""

from collections.abc import Iterable
from pathlib import Path

from gaga_core.errors import GagaError
from gaga_core.io.cameras.colmap import has_colmap, read_colmap
from gaga_core.io.datasets.base import (
    DatasetScene,
    DatasetViews,
    Layout,
    PromptTruth,
    photos_of,
    scene_of,
)
from gaga_core.io.folder.splits import split_views


def read_lerf_mask(root: Path, model: Path | None = None) -> DatasetScene:
    """A scene of LERF-Mask; ``GagaError`` when photos, train photos, cameras or masks are gone."""
    photos, train = photos_of(root / "images"), photos_of(root / "images_train")
    for folder, found in (("images", photos), ("images_train", train)):
        if not found:
            raise GagaError(f"{root} has no photos in {folder}/. Copy them there.")
    if not has_colmap(root / "sparse" / "0"):
        raise GagaError(f"{root} has no COLMAP model in sparse/0. Copy it there.")
    stems = {Path(name).stem for name in train}
    test = [name for name in sorted(photos) if Path(name).stem not in stems]
    truth = root / "test_mask"
    keys = [f.name for f in truth.iterdir() if f.name.isdecimal()] if truth.is_dir() else []
    views = {key: test[int(key)] for key in sorted(keys, key=int) if int(key) < len(test)}
    if not views:
        raise GagaError(f"{root} has no masks test_mask/<number>/<text prompt>.png. Copy them.")
    prompts = PromptTruth(truth, views, prompts_of(truth, views))
    cameras = read_colmap(root / "sparse" / "0").cameras
    found_views = DatasetViews(cameras, photos, split_views(root, photos))
    return scene_of(root, model, "LERF-Mask", found_views, prompts=prompts, truth_from="test_mask")


def prompts_of(folder: Path, keys: Iterable[str]) -> tuple[str, ...]:
    """Stems of all masks in the sub-folders ``keys`` of ``folder``, by name."""
    found = {path.stem for key in keys for path in photos_of(folder / key).values()}
    return tuple(sorted(found))


LAYOUTS = (
    Layout(
        "LERF-Mask",
        "<scene>/images, images_train, sparse/0 and test_mask/<number>/<text prompt>.png",
        lambda root: (root / "test_mask").is_dir() or (root / "images_train").is_dir(),
        read_lerf_mask,
    ),
)
