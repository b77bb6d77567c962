"""What a data set is, and what the readers of all layouts share."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera, natural_order
from gaga_core.errors import GagaError
from gaga_core.io.files import explain_os_error
from gaga_core.io.folder.scene_folder import SceneFolder, find_mask_folders, find_model
from gaga_core.io.folder.splits import ViewSplit
from gaga_core.io.images import IMAGE_SUFFIXES, open_image
from gaga_core.masks import Loader, MaskSet

# How a data set is scored; qualitative: pictures and a film, and scores where there is truth.
Protocol = Literal["instance", "lerf-mask", "3d-ovs", "qualitative"]


@dataclass(frozen=True)
class PromptTruth:
    """True binary masks of text prompts: ``folder/<key>/<text prompt>.png``."""

    folder: Path
    views: Mapping[str, str]  # key (name of a folder there) -> view name
    prompts: tuple[str, ...]  # by name; not every view shows every prompt


@dataclass(frozen=True, eq=False)
class DatasetScene:
    """One scene. Pictures, maps and splats are not read yet."""

    folder: SceneFolder  # cameras, photos, masks, the split, and where the Gaussians are
    layout: str  # "Semantic-NeRF", ...
    truth: MaskSet = field(default_factory=MaskSet)  # true label maps by view name, 0 = void
    prompts: PromptTruth | None = None
    truth_from: str = ""  # what the truth is, for tables: "ins_full", ...
    missing: tuple[str, ...] = ()  # one sentence a thing that the scene lacks

    @property
    def name(self) -> str:
        """Name of the scene's folder."""
        return self.folder.root.name


@dataclass(frozen=True, eq=False)
class Dataset:
    """The scenes of a data set, and those that could not be opened."""

    name: str  # "replica"
    title: str  # "Replica"
    protocol: Protocol
    root: Path
    scenes: tuple[DatasetScene, ...]
    failed: Mapping[str, str] = field(default_factory=dict)  # scene name -> one sentence


@dataclass(frozen=True)
class Layout:
    """One way in which a data set lies on disk."""

    title: str
    wants: str  # what a scene's folder must hold, for messages
    fits: Callable[
        [Path], bool
    ]  # whether a folder is a scene of this layout, perhaps a partial one
    read: Callable[[Path, Path | None], DatasetScene]  # scene, its splats if elsewhere


@dataclass(frozen=True, eq=False)
class DatasetViews:
    """What a reader found out about the views of a scene."""

    cameras: Sequence[Camera]
    photos: Mapping[str, Path]  # by view name
    split: ViewSplit  # may name views without a camera: they are told


def scene_of(
    root: Path,
    model: Path | None,
    layout: str,
    views: DatasetViews,
    *,
    truth: Mapping[str, Loader] | None = None,
    prompts: PromptTruth | None = None,
    truth_from: str = "",
) -> DatasetScene:
    """The description of a scene, with what it lacks; only views that have a camera count."""
    cameras = tuple(sorted(views.cameras, key=lambda camera: natural_order(camera.name)))
    posed = {camera.name for camera in cameras}
    train, test = (
        tuple(name for name in part if name in posed)
        for part in (views.split.train, views.split.test)
    )
    folder = SceneFolder(
        root=root,
        model_path=model or find_model(root) or find_model(root / "output"),
        cameras=cameras,
        image_paths={name: path for name, path in views.photos.items() if name in posed},
        mask_folders=all_mask_folders(root),
        train=train,
        test=test,
        split=views.split.rule,
    )
    if prompts is not None:  # a view that is trained on is not scored
        scored = {key: name for key, name in prompts.views.items() if name in set(test)}
        prompts = replace(prompts, views=scored)
    loaders = {name: load for name, load in (truth or {}).items() if name in posed}
    scene = DatasetScene(folder, layout, MaskSet(loaders, str(root)), prompts, truth_from)
    wanted = {*views.split.train, *views.split.test, *views.split.unknown}
    return replace(scene, missing=tuple(_missing(scene, wanted)))


def _missing(scene: DatasetScene, wanted: set[str]) -> list[str]:
    """One sentence a thing that is not there."""
    folder, found = scene.folder, []
    unposed = sorted(wanted - {camera.name for camera in folder.cameras})
    if unposed:
        found.append(
            f"{len(unposed)} of {len(wanted)} views of {scene.name} have no camera "
            f"(first: {unposed[0]})."
        )
    if not folder.train:
        found.append(f"{scene.name} has no train views.")
    if not folder.test:
        found.append(f"{scene.name} has no test views.")
    photos = [camera.name for camera in folder.cameras if camera.name not in folder.image_paths]
    if photos:
        found.append(
            f"{len(photos)} of {len(folder.cameras)} photos of {scene.name} are missing "
            f"(first: {photos[0]})."
        )
    if scene.prompts is None and scene.truth_from:
        unmapped = [name for name in folder.test if name not in scene.truth]
        if unmapped:
            found.append(
                f"{len(unmapped)} of {len(folder.test)} test views of {scene.name} have no true "
                f"label map (first: {unmapped[0]})."
            )
    return found


def all_mask_folders(root: Path) -> dict[str, Path]:
    """Label maps of a scene by name: ours (masks/<name>), Gaga's, Gaussian Grouping's."""
    others = [path for path in sorted(root.glob("raw_*_mask")) if path.is_dir()]
    others += [path for path in (root / "object_mask",) if path.is_dir()]
    return find_mask_folders(root) | {path.name: path for path in others}


def photos_of(folder: Path) -> dict[str, Path]:
    """Photos of a folder by name, hidden ones left out; empty when there is no such folder."""
    if not folder.is_dir():
        return {}
    files = (path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
    return {path.name: path for path in sorted(files) if not path.name.startswith(".")}


def numbered(folder: Path, suffixes: Sequence[str] = IMAGE_SUFFIXES) -> dict[int, Path]:
    """Files by the number that their stem ends with (``rgb_12.png`` -> 12); others are left out."""
    if not folder.is_dir():
        return {}
    found = {}
    for path in sorted(folder.iterdir()):
        digits = path.stem.rsplit("_", 1)[-1]
        if path.suffix.lower() in suffixes and digits.isdecimal() and path.name[0] != ".":
            found[int(digits)] = path
    return found


def picture_size(path: Path) -> tuple[int, int]:
    """Width and height of a picture; ``GagaError`` when it is none."""
    return open_image(path).size


def read_numbers(path: Path, shape: tuple[int, ...]) -> DoubleArray:
    """Numbers of a text file in ``shape`` (-1 = as many as there are); ``GagaError`` otherwise."""
    try:
        values = np.array(path.read_text(encoding="utf-8").split(), np.float64).reshape(shape)
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    except ValueError as error:
        wanted = " x ".join("any" if n < 0 else str(n) for n in shape)
        raise GagaError(f"{path} must hold {wanted} numbers. Copy it again.") from error
    return values


def posed_camera(
    K: DoubleArray,  # (3, 3) pixels
    world_from_cam: DoubleArray,  # (4, 4) OpenCV axes
    size: tuple[int, int],
    name: str,
) -> Camera | None:
    """Camera of a pose; None where the pose is not usable (ScanNet writes -inf for lost frames)."""
    rotation = world_from_cam[:3, :3]
    if not np.isfinite(world_from_cam).all() or abs(np.linalg.det(rotation) - 1) > 0.01:
        return None
    pose = np.eye(4)
    pose[:3, :3] = rotation.T
    pose[:3, 3] = -rotation.T @ world_from_cam[:3, 3]
    return Camera(K, pose, *size, name)


def by_stem(names: Iterable[str]) -> dict[str, str]:
    """Names by their stem; of ``a.b.jpg`` the stem is ``a.b``."""
    return {Path(name).stem: name for name in names}
