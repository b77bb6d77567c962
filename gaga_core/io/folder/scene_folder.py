"""A scene folder: photos, COLMAP model, splats, masks, and what we write (the project's layout).

SCENE/images/                     photos
SCENE/sparse/0/                   COLMAP model, .bin or .txt
SCENE/cameras.json                cameras of a 3DGS training, where there is no COLMAP model
SCENE/point_cloud.ply             or point_cloud/iteration_*/point_cloud.ply (newest)
SCENE/masks/<provider>/<stem>.png label map per view; <folder>/<stem>.png for images/<folder>/
SCENE/foreground/<stem>.png       optional, of each photo: black = background that is left out
SCENE/sensor_depth/<stem>.png     optional, of each photo: 16 bit, thousandths of the scene unit
SCENE/split.json                  optional {"train": [names], "test": [names]}; see `splits`
SCENE/gaga/                       all that we write
"""

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec
import numpy as np

from gaga_core.camera import Camera, natural_order
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.cameras.cameras_json import read_cameras_json
from gaga_core.io.cameras.colmap import has_colmap, read_colmap
from gaga_core.io.depth_maps import DEPTH
from gaga_core.io.files import write_text
from gaga_core.io.folder.splits import split_views
from gaga_core.io.folder.staging import finish_publishing
from gaga_core.io.images import IMAGE_SUFFIXES
from gaga_core.io.json_file import read_foreign_json, read_json
from gaga_core.io.masks.label_maps import view_key, view_keys
from gaga_core.io.splats.splat_files import read_splats_stage
from gaga_core.progress import Stage

T = TypeVar("T")
WORLD = "world.json"  # in gaga/
FOREGROUND = "foreground"  # folder of a scene: masks of the object


# Of a scene folder: photos and what other programs, or a placement, made of them.
SCENE_INPUTS = ("input", "images", "foreground", "masks", "gt", "depth", "sparse", "split.json")


@dataclass(frozen=True, eq=False)
class SceneFolder:
    """Content of a scene folder. Pictures, masks and splats are not read yet."""

    root: Path
    model_path: Path | None  # the splats, None if there are none yet
    cameras: tuple[Camera, ...]  # by name
    image_paths: Mapping[str, Path]  # by view name; only photos that are on disk
    mask_folders: Mapping[str, Path] = field(default_factory=dict)  # by provider
    train: tuple[str, ...] = ()
    test: tuple[str, ...] = ()
    split: str = ""  # what parted train and test views: `gaga_core.io.folder.splits`
    is_metric: bool = False  # a unit of its world is a metre
    up: tuple[float, float, float] | None = None  # unit, world; None = by the cameras

    @property
    def train_photos(self) -> tuple[str, ...]:
        """The train views whose photo is on disk: those that masks are made for."""
        return tuple(name for name in self.train if name in self.image_paths)

    @property
    def work(self) -> Path:
        """The folder of everything that we write."""
        return self.root / "gaga"

    @property
    def foreground(self) -> dict[str, Path]:
        """Masks of the object by view name; empty where no background is left out."""
        return self._maps(FOREGROUND)

    @property
    def depth(self) -> dict[str, Path]:
        """Measured depth (`depth_maps.read_scene_depth`) by view name; empty in most scenes."""
        return self._maps(DEPTH)

    def _maps(self, folder: str) -> dict[str, Path]:
        root = self.root / folder
        paths = {camera.name: root / f"{view_key(camera.name)}.png" for camera in self.cameras}
        return {name: path for name, path in paths.items() if path.is_file()}

    def require_image(self, name: str) -> Path:
        """Path of a view's photo; ``GagaError`` when it is gone."""
        if name in self.image_paths:
            return self.image_paths[name]
        missing = sum(1 for camera in self.cameras if camera.name not in self.image_paths)
        raise GagaError(
            f"{missing} of {len(self.cameras)} photos are not in {self.root / 'images'} "
            f"(first: {name}). Put the photos back where the COLMAP model expects them."
        )


def place_aside(root: Path) -> Path:
    """Where groups of splats that were replaced are kept: the first of gaga-before, gaga-before-2,
    ... that is not there."""
    names = (f"gaga-before-{k}" if k > 1 else "gaga-before" for k in count(1))
    return next(place for name in names if not (place := root / name).exists())


def is_scene_folder(path: Path) -> bool:
    """Whether ``path`` looks like a scene folder."""
    if not path.is_dir():
        return False
    return (
        (path / "images").is_dir() or find_sparse(path) is not None or find_model(path) is not None
    )


def _has_pictures(folder: Path) -> bool:
    with suppress(PermissionError):  # it is not for us
        return folder.is_dir() and any(p.suffix.lower() in IMAGE_SUFFIXES for p in folder.iterdir())
    return False


def _no_scene(root: Path) -> str:
    if _has_pictures(root):
        return (
            f"{root} holds photos, but no splats and no cameras of them yet. Make them first: "
            "gaga run, or Make splats in the window."
        )
    inside = sorted(p.name for p in root.iterdir() if _has_pictures(p)) if root.is_dir() else []
    if inside:
        return (
            f"{root} is not a scene folder, but {' and '.join(inside[:3])} in it "
            f"{'hold' if len(inside) > 1 else 'holds'} pictures. Open the one with the photos."
        )
    return (
        f"{root} is not a scene folder: it has no point_cloud.ply, images/ or sparse/, and no "
        "photos. Choose the folder that holds them."
    )


def open_scene_folder(root: Path, model: Path | None = None) -> SceneFolder:
    """Look at a scene folder. ``model`` overrides the splats.

    A folder needs splats or a COLMAP model; photos may be missing: viewing needs none. Without a
    COLMAP model, cameras come from ``cameras.json``, which trainings of 3DGS leave next to their
    splats. Raises ``GagaError`` with one sentence otherwise.
    """
    root = Path(root)
    if not root.exists():
        raise GagaError(f"{root} does not exist. Check the path.")
    if not is_scene_folder(root):
        raise GagaError(_no_scene(root))
    if model is not None and not model.is_file():
        raise GagaError(f"{model} does not exist. Choose the file of the splats.")
    finish_publishing(root / "gaga")
    sparse = find_sparse(root)
    found = read_colmap(sparse).cameras if sparse is not None else _trained_cameras(root)
    model_path = model or find_model(root)
    masks = find_mask_folders(root)
    cameras = tuple(sorted(found, key=lambda camera: natural_order(camera.name)))
    parted = split_views(root, (camera.name for camera in cameras))
    images = _image_paths(root / "images", cameras)
    return SceneFolder(
        root,
        model_path,
        cameras,
        images,
        masks,
        parted.train,
        parted.test,
        parted.rule,
        *known_world(root),
    )


class World(msgspec.Struct, frozen=True):
    """What the program that placed the photos knew of the world: SCENE/gaga/world.json."""

    is_metric: bool = False
    up: tuple[float, float, float] | None = None
    program: str = ""


def write_world(root: Path, world: World) -> None:
    """Keep what is known of the world of a scene's cameras."""
    write_text(root / "gaga" / WORLD, msgspec.json.encode(world).decode())


def known_world(root: Path) -> tuple[bool, tuple[float, float, float] | None]:
    """Whether a unit is a metre, and the vertical if it is known; neither in most scenes."""
    file = root / "gaga" / WORLD
    try:
        world = read_json(file, World, "") if file.is_file() else World()
    except GagaError:  # damaged: as if nothing were known
        return False, None
    length = 0.0 if world.up is None else float(np.linalg.norm(world.up))
    return world.is_metric, world.up if length > 0.5 else None  # a unit vector, if it is any


def find_sparse(root: Path) -> Path | None:
    """The folder of the scene's COLMAP model; None when there is none."""
    return next((folder for folder in sparse_folders(root) if has_colmap(folder)), None)


def sparse_folders(root: Path) -> tuple[Path, ...]:
    """Folders of a scene in which a COLMAP model is looked for, the first first."""
    return (root / "sparse" / "0", root / "sparse", root / "colmap" / "sparse" / "0")


def find_model(root: Path) -> Path | None:
    """The splats of a scene or of a trained model's folder: the newest; None if there are none."""
    direct = root / "point_cloud.ply"
    if direct.is_file():
        return direct

    def iteration(path: Path) -> int:
        digits = path.parent.name.removeprefix("iteration_")
        return int(digits) if digits.isdigit() else -1

    trained = sorted(root.glob("point_cloud/iteration_*/point_cloud.ply"), key=iteration)
    return trained[-1] if trained else None


def find_mask_folders(root: Path) -> dict[str, Path]:
    """Folders of label maps in ``root/masks`` by name."""
    folder = root / "masks"
    if not folder.is_dir():
        return {}
    found = {p.name: p for p in sorted(folder.iterdir()) if p.is_dir() and p.name[0] != "."}
    return {name: path for name, path in found.items() if any(path.rglob("*.png"))}


def mask_path_of(folder: SceneFolder, masks: str | Path | None) -> Path:
    """The folder of label maps meant by ``masks``: a provider's name, a path, None = the only one.

    Raises ``GagaError`` when there is none, or no telling which.
    """
    providers = folder.mask_folders
    if masks is None:
        if not providers:
            raise GagaError(f"There are no masks in {folder.root / 'masks'}. Make masks first.")
        if len(providers) > 1:
            names = ", ".join(sorted(providers))
            raise GagaError(f"There are several mask folders: {names}. Choose one of them.")
        return next(iter(providers.values()))
    if str(masks) in providers:
        return providers[str(masks)]
    for path in (Path(masks), folder.root / masks):
        if path.is_dir():
            return path
    known = ", ".join(sorted(providers)) or "none"
    raise GagaError(f"There is no mask folder {masks}. In this scene: {known}.")


def select_views(folder: SceneFolder, views: str | Sequence[str]) -> tuple[Camera, ...]:
    """Cameras of "train", "test", "all", or of names (with or without suffix, comma-separated).

    A name without its folder will do where only one view has it. Raises ``GagaError`` when a name
    is unknown or means several views, or when two of the views would share their files.
    """
    cameras = _selected(folder, views)
    view_keys(camera.name for camera in cameras)
    return cameras


def _selected(folder: SceneFolder, views: str | Sequence[str]) -> tuple[Camera, ...]:
    by_name = {camera.name: camera for camera in folder.cameras}
    if not by_name:
        raise GagaError(f"There are no cameras in {folder.root}. Add a COLMAP model (sparse/0).")
    if not isinstance(views, str) and len(views) == 1:
        views = views[0]
    if views == "all":
        return folder.cameras
    if isinstance(views, str) and views in ("train", "test"):
        names = folder.train if views == "train" else folder.test
        if not names:
            raise GagaError(f"No views are set apart as {views} in {folder.root}.")
        return tuple(by_name[name] for name in names)
    wanted = views.split(",") if isinstance(views, str) else views
    found = {name: _meant(name, by_name) for name in wanted}
    unknown = [name for name, cameras in found.items() if not cameras]
    if unknown or not found:
        raise GagaError(f"There is no view {', '.join(unknown)} among {len(by_name)} views.")
    for name, cameras in found.items():
        if len(cameras) > 1:
            several = ", ".join(camera.name for camera in cameras[:5])
            raise GagaError(f"{len(cameras)} views are called {name}: {several}. Name its folder.")
    return tuple(cameras[0] for cameras in found.values())


def _meant(name: str, by_name: Mapping[str, Camera]) -> tuple[Camera, ...]:
    """The views that a name means: by the whole name, without the suffix, or without the folder."""
    if name in by_name:
        return (by_name[name],)
    forms: tuple[Callable[[str], str], ...] = (
        view_key,
        lambda known: Path(known).name,
        lambda known: Path(known).stem,
    )
    for form in forms:
        if found := tuple(camera for known, camera in by_name.items() if form(known) == name):
            return found
    return ()


def read_model(folder: SceneFolder) -> Stage[Gaussians]:
    """Read the scene's splats."""
    if folder.model_path is None:
        raise GagaError(
            f"There is no model in {folder.root}. Put a point_cloud.ply there, or name one."
        )
    return (yield from read_splats_stage(folder.model_path))


class AssociateEntry(msgspec.Struct, frozen=True):
    """What is read again of the entry "associate" of report.json."""

    mask_folder: str = ""  # label maps that were read, from the scene folder on if they lie in it
    groups_with_gaussians: Annotated[int, msgspec.Meta(ge=0)] | None = None
    notes: tuple[str, ...] = ()  # for the user


def read_report_entry(path: Path, key: str, kind: type[T]) -> T | None:
    """The entry of a stage in report.json; None when it is not there or cannot be read."""
    try:
        return msgspec.convert(_report(path).get(key), kind)
    except ValueError:  # a wrong type, or text that no UTF-8 can hold
        return None


def _report(path: Path) -> dict[str, object]:
    """All entries of report.json; none when it cannot be read."""
    try:
        return read_foreign_json(path, dict[str, object])
    except GagaError:
        return {}


def with_entry(path: Path, key: str, value: dict[str, object]) -> str:
    """The text of report.json with one entry replaced; an unreadable report starts again."""
    return json.dumps({**_report(path), key: value}, indent=2) + "\n"


def _trained_cameras(root: Path) -> tuple[Camera, ...]:
    """Cameras of the ``cameras.json`` in a training's output folder; none without one."""
    path = root / "cameras.json"
    return tuple(read_cameras_json(path)) if path.is_file() else ()


def _image_paths(folder: Path, cameras: tuple[Camera, ...]) -> dict[str, Path]:
    """Photos of the views; a photo of the same stem with another suffix will do."""
    if not folder.is_dir():
        return {}
    files = [p for p in folder.rglob("*") if p.suffix.lower() in IMAGE_SUFFIXES]
    by_name = {p.relative_to(folder).as_posix(): p for p in files}
    by_stem = {Path(name).with_suffix("").as_posix(): p for name, p in by_name.items()}
    paths = {}
    for camera in cameras:
        stem = Path(camera.name).with_suffix("").as_posix()
        path = by_name.get(camera.name) or by_stem.get(camera.name) or by_stem.get(stem)
        if path is not None:
            paths[camera.name] = path
    return paths
