"""Benchmark data sets as they lie on disk: one reader a layout, one description for all."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.camera import MOST_PIXELS, Camera, is_usable, natural_order
from gaga_core.errors import GagaError
from gaga_core.io.arrays_file import read_array, read_arrays
from gaga_core.io.cameras.colmap import has_colmap, read_colmap
from gaga_core.io.files import read_names
from gaga_core.io.folder.scene_folder import (
    SceneFolder,
    find_mask_folders,
    find_model,
    open_scene_folder,
)
from gaga_core.io.folder.splits import PARTS, REPLICA_AFTER, REPLICA_EVERY, split_views
from gaga_core.io.images import IMAGE_SUFFIXES, open_image, pictures_in
from gaga_core.io.json_file import read_bytes
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.masks import Loader, MaskSet

# How a data set is scored; qualitative: pictures and a film, and scores where there is truth.
Protocol = Literal["instance", "lerf-mask", "3d-ovs", "qualitative"]
_K = TypeVar("_K", int, str)
_MOST_TEXT = 64 << 20  # bytes of numbers in text; the poses of 100,000 frames have half of it
_WIDEST = 1600  # pixels of a photo of Mip-NeRF 360: wider ones are used in a smaller folder
_DM_NERF_KEY = "ins_2d_label_id"
# What the truth of ScanNet is: all instances of DM-NeRF's frames as published, or those of its
# classes, or the raw ones.
_FULL, _SOME, _RAW = "ins_full", f"{_DM_NERF_KEY} (only DM-NeRF's classes)", "instance-filt (raw)"
_REPLICA_TRUTH, _REPLICA_ARCHIVE = "semantic_instance", "Replica_Instance_Segmentation"


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
    missing: tuple[str, ...] = ()  # one sentence for each file that the scene lacks

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


@dataclass(frozen=True, eq=False)
class _Found:
    """A scene as the reader of a layout found it."""

    cameras: Iterable[Camera]
    photos: Mapping[str, Path]  # by view name
    truth_from: str = ""
    truth: Mapping[str, Loader] = field(default_factory=dict)
    prompts: PromptTruth | None = None
    parted: Collection[str] | None = None  # views of the split, default: those of the photos


@dataclass(frozen=True)
class _Layout:
    """One way in which a data set lies on disk."""

    title: str
    wants: str  # what a scene's folder must hold, for messages
    fits: Callable[[Path], bool]  # whether a folder is a scene of it, perhaps a partial one
    read: Callable[[Path], _Found]


@dataclass(frozen=True)
class KnownDataset:
    """A data set that can be read, and the layouts in which people have it."""

    title: str
    protocol: Protocol
    layouts: tuple[_Layout, ...]
    scenes: tuple[str, ...] = ()  # in the order of the published tables, where known


def open_dataset(
    name: str,
    root: Path,
    scenes: Sequence[str] = (),
    *,
    models: Path | None = None,
) -> Dataset:
    """Look at the data set ``name`` in ``root``: its scenes, or ``root`` itself if it is a scene.

    ``scenes`` are folder names, default all; ``models`` holds trained splats as
    ``<scene>/point_cloud.ply`` or ``<scene>/point_cloud/iteration_*/``. A scene that cannot be
    opened, or is asked for and not there, is listed in ``failed`` with one sentence. Raises
    ``GagaError`` when ``root`` holds no scene of that data set.
    """
    if name not in DATASETS:
        raise GagaError(f"There is no data set {name!r}. Choose one of {', '.join(DATASETS)}.")
    kind = DATASETS[name]
    if not root.is_dir():
        raise GagaError(f"{root} is not a folder. Choose the folder of the data set {kind.title}.")
    if models is not None and not models.is_dir():
        raise GagaError(f"{models} is not a folder. Choose the folder of the trained models.")
    found = _find_scenes(root, kind)
    if not found:
        wanted = ", or ".join(layout.wants for layout in kind.layouts)
        raise GagaError(f"{root} holds no scene of {kind.title}: it must have {wanted}.")
    opened: list[DatasetScene] = []
    failed = {
        scene: f"There is no scene {scene} of {kind.title} in {root}."
        for scene in scenes
        if scene not in found
    }
    for scene, (folder, layout) in found.items():
        if scenes and scene not in scenes:
            continue
        try:
            model = None if models is None else find_model(models / scene)
            opened.append(_scene_of(folder, model, layout))
        except GagaError as error:
            failed[scene] = str(error)
    return Dataset(name, kind.title, kind.protocol, root, tuple(opened), failed)


def _find_scenes(root: Path, kind: KnownDataset) -> dict[str, tuple[Path, _Layout]]:
    """Scenes by name, in the published order, then by name: ``root`` itself, or its folders, or
    theirs (archives often unpack into a folder of their own)."""

    def inside(folder: Path) -> list[Path]:
        return [p for p in sorted(folder.iterdir()) if p.is_dir() and p.name[0] != "."]

    folders = inside(root)
    for level in ([root], folders, [inner for folder in folders for inner in inside(folder)]):
        found: dict[str, tuple[Path, _Layout]] = {}
        for folder in level:
            layout = next((layout for layout in kind.layouts if layout.fits(folder)), None)
            if layout is not None:
                found.setdefault(folder.name, (folder, layout))
        if found:
            first = [scene for scene in kind.scenes if scene in found]
            order = first + [scene for scene in sorted(found) if scene not in first]
            return {scene: found[scene] for scene in order}
    return {}


def _scene_of(root: Path, model: Path | None, layout: _Layout) -> DatasetScene:
    """The description of a scene, with what it lacks; only views that have a camera count."""
    found = layout.read(root)
    cameras = tuple(sorted(found.cameras, key=lambda camera: natural_order(camera.name)))
    posed = {camera.name for camera in cameras}
    split = split_views(root, found.photos if found.parted is None else found.parted)
    train, test = (tuple(n for n in part if n in posed) for part in (split.train, split.test))
    others = [path for path in sorted(root.glob("raw_*_mask")) if path.is_dir()]  # Gaga's, and
    others += [path for path in (root / "object_mask",) if path.is_dir()]  # Gaussian Grouping's
    folder = SceneFolder(
        root=root,
        model_path=model or find_model(root) or find_model(root / "output"),
        cameras=cameras,
        image_paths={name: path for name, path in found.photos.items() if name in posed},
        mask_folders=find_mask_folders(root) | {path.name: path for path in others},
        train=train,
        test=test,
        split=split.rule,
    )
    prompts = found.prompts
    if prompts is not None:  # a view that is trained on is not scored
        scored = {key: name for key, name in prompts.views.items() if name in set(test)}
        prompts = replace(prompts, views=scored)
    truth = MaskSet({n: load for n, load in found.truth.items() if n in posed}, str(root))
    scene = DatasetScene(folder, layout.title, truth, prompts, found.truth_from)
    wanted = {*split.train, *split.test, *split.unknown}
    return replace(scene, missing=tuple(_missing(scene, wanted)))


def _missing(scene: DatasetScene, wanted: set[str]) -> Iterable[str]:
    """One sentence for each file that is missing."""
    folder = scene.folder
    unposed = sorted(wanted - {camera.name for camera in folder.cameras})
    if unposed:
        yield (
            f"{len(unposed)} of {len(wanted)} views of {scene.name} have no camera "
            f"(first: {unposed[0]})."
        )
    if not folder.train:
        yield f"{scene.name} has no train views."
    if not folder.test:
        yield f"{scene.name} has no test views."
    photos = [camera.name for camera in folder.cameras if camera.name not in folder.image_paths]
    if photos:
        yield (
            f"{len(photos)} of {len(folder.cameras)} photos of {scene.name} are missing "
            f"(first: {photos[0]})."
        )
    unmapped = [name for name in folder.test if name not in scene.truth]
    if scene.prompts is None and scene.truth_from and unmapped:
        yield (
            f"{len(unmapped)} of {len(folder.test)} test views of {scene.name} have no true "
            f"label map (first: {unmapped[0]})."
        )


# --- shared by the readers


def _photos_of(root: Path, *folders: str) -> dict[str, Path]:
    """Photos of the first of the folders that has some; ``GagaError`` when none has."""
    for photos in (pictures_in(root / folder) for folder in folders):
        if photos:
            return photos
    raise GagaError(f"{root} has no photos in {folders[0]}/. Copy them there.")


def _numbered(folder: Path, suffixes: Sequence[str] = IMAGE_SUFFIXES) -> dict[int, Path]:
    """Files by the number that their stem ends with (``rgb_12.png`` -> 12); others are left out."""
    if not folder.is_dir():
        return {}
    found = {}
    for path in sorted(folder.iterdir()):
        digits = path.stem.rsplit("_", 1)[-1]
        if path.suffix.lower() in suffixes and digits.isdecimal() and path.name[0] != ".":
            found[int(digits)] = path
    return found


def _by_stem(names: Iterable[str]) -> dict[str, str]:
    """Names by their stem; of ``a.b.jpg`` the stem is ``a.b``."""
    return {Path(name).stem: name for name in names}


def _truth_of(
    names: Mapping[_K, str],
    maps: Mapping[_K, Path],
    read: Callable[[Path], IntArray] = read_labels,
) -> dict[str, Loader]:
    """Loaders of the maps by the name of the view that has the same key."""
    return {names[key]: partial(read, path) for key, path in maps.items() if key in names}


def _prompts_of(folder: Path, views: Mapping[str, str]) -> PromptTruth:
    """Prompts are the stems of all masks in the sub-folders that are the keys of ``views``."""
    found = {path.stem for key in views for path in pictures_in(folder / key).values()}
    return PromptTruth(folder, views, tuple(sorted(found)))


def _colmap_cameras(root: Path, cure: str = "Copy it there.") -> tuple[Camera, ...]:
    """Cameras of the COLMAP model in sparse/0; ``GagaError`` with ``cure`` without one."""
    if not has_colmap(root / "sparse" / "0"):
        raise GagaError(f"{root} has no COLMAP model in sparse/0. {cure}")
    return read_colmap(root / "sparse" / "0").cameras


def _picture_size(path: Path) -> tuple[int, int]:
    """Width and height of a picture; ``GagaError`` when it is none."""
    return open_image(path).size


def _read_numbers(path: Path, shape: tuple[int, ...]) -> DoubleArray:
    """Numbers of a text file in ``shape`` (-1 = as many as there are); ``GagaError`` otherwise."""
    raw = read_bytes(path, "Copy it again.", _MOST_TEXT)
    try:
        values = np.array(raw.decode().split(), np.float64).reshape(shape)
    except ValueError as error:
        wanted = " x ".join("any" if n < 0 else str(n) for n in shape)
        raise GagaError(f"{path} must hold {wanted} numbers. Copy it again.") from error
    return values


def _posed_cameras(
    K: DoubleArray,  # (3, 3) pixels
    size: tuple[int, int],
    poses: Iterable[tuple[str, DoubleArray]],  # names, world_from_cam (4, 4) OpenCV axes
) -> list[Camera]:
    """Cameras of the poses that are usable (ScanNet writes -inf for frames that it lost)."""
    cameras = []
    for name, world_from_cam in poses:
        if not is_usable(K, world_from_cam):
            continue
        rotation, pose = world_from_cam[:3, :3], np.eye(4)
        pose[:3, :3] = rotation.T
        pose[:3, 3] = -rotation.T @ world_from_cam[:3, 3]
        cameras.append(Camera(K, pose, *size, name))
    return cameras


# --- Replica as Semantic-NeRF renders it (Zhi et al., ICCV 2021), and as Gaga's scripts rearrange
# it. Semantic-NeRF: ``<scene>/Sequence_1/{rgb/rgb_<i>.png, semantic_instance/
# semantic_instance_<i>.png, traj_w_c.txt}``, 900 frames; row i of the trajectory is world_from_cam
# (4 x 4, OpenCV axes); the field of view is 90 degrees across and the principal point (W-1)/2,
# (H-1)/2 in its convention of pixel centres at whole numbers. Train frames are 0, 5, 10, ..., test
# frames 2 later (180 each). The instance maps come as an archive of their own:
# Replica_Instance_Segmentation/<scene>/Sequence_1. Gaga: ``<scene>/{images|input}/
# {train|test}_rgb_<i>.png`` with a COLMAP model of its own and
# ``semantic_instance/{train|test}_semantic_instance_<i>.png``.


def _read_semantic_nerf(root: Path) -> _Found:
    """A COLMAP model in ``root/sparse/0`` wins over the trajectory, because splats trained on it
    live in its frame."""
    sequence = root / "Sequence_1" if (root / "Sequence_1").is_dir() else root
    every = _numbered(sequence / "rgb")
    if not every:
        raise GagaError(f"{sequence} has no photos rgb/rgb_<number>.png. Unpack the scene there.")
    chosen = {i: path for i, path in every.items() if i % REPLICA_EVERY in (0, REPLICA_AFTER)}
    names = {i: path.name for i, path in chosen.items()}
    photos = {path.name: path for path in chosen.values()}
    # The instance maps: in the scene, or in the archive's folder next to or above it.
    own, tail = sequence / _REPLICA_TRUTH, Path(root.name) / "Sequence_1" / _REPLICA_TRUTH
    places = [own, *(up / _REPLICA_ARCHIVE / tail for up in (root.parent, root.parent.parent))]
    maps = _numbered(next((place for place in places if place.is_dir()), own))
    if has_colmap(root / "sparse" / "0"):
        cameras = [camera for camera in _colmap_cameras(root) if camera.name in photos]
    else:
        poses = _read_numbers(sequence / "traj_w_c.txt", (-1, 4, 4))
        width, height = _picture_size(next(iter(chosen.values())))
        # Our pixel centres lie at +0.5, so (W-1)/2 in theirs is W/2 in ours.
        K = np.array([[width / 2, 0, width / 2], [0, width / 2, height / 2], [0, 0, 1.0]])
        posed = ((name, poses[i]) for i, name in names.items() if i < len(poses))
        cameras = _posed_cameras(K, (width, height), posed)
    return _Found(cameras, photos, _REPLICA_TRUTH, _truth_of(names, maps))


def _read_gaga_replica(root: Path) -> _Found:
    photos = _photos_of(root, "images", "input")
    cameras = _colmap_cameras(root, "Reconstruct the cameras first.")
    names = {Path(n).stem.replace("_rgb_", "_semantic_instance_"): n for n in photos}
    maps = {path.stem: path for path in pictures_in(root / _REPLICA_TRUTH).values()}
    return _Found(cameras, photos, _REPLICA_TRUTH, _truth_of(names, maps))


# --- ScanNet: raw as its reader exports it, as DM-NeRF's script selects it, and as Gaga's does.
# Raw: ``<scene>/{color/<n>.jpg, pose/<n>.txt, intrinsic/intrinsic_{color,depth}.txt,
# instance-filt/<n>.png}``. DM-NeRF (Wang et al., ICLR 2023): ``<scene>/{train,test}/{s}_images,
# {s}_pose, {s}_ins/<n>.npz`` with instance ids in ``ins_2d_label_id``, -1 = void, of the classes
# that DM-NeRF keeps; ``{s}_ins_full/<n>.png``, all instances, are the truth where they are. Gaga:
# ``<scene>/{s}/{s}_images, {s}_ins_full/<n>.png`` (ids of the raw maps) with a COLMAP model over
# ``images/``. Poses are world_from_cam (4 x 4, OpenCV axes); frames that tracking lost have -inf.


def _read_raw_scannet(root: Path) -> _Found:
    """It has no split of its own: unless train_split.txt and test_split.txt are there, every 8th
    usable frame is a test view."""
    photos = _numbered(root / "color")
    if not photos:
        raise GagaError(f"{root} has no photos color/<number>.jpg. Export the scene's frames.")
    cameras = _scannet_cameras(root, photos, _numbered(root / "pose", (".txt",)))
    names = {n: path.name for n, path in photos.items()}
    truth = _truth_of(names, _numbered(root / "instance-filt"))
    by_name = {path.name: path for path in photos.values()}
    return _Found(cameras, by_name, _RAW, truth, parted=[camera.name for camera in cameras])


def _read_dm_nerf(root: Path) -> _Found:
    photos: dict[int, Path] = {}
    poses: dict[int, Path] = {}
    truth: dict[str, Loader] = {}
    full: dict[str, Loader] = {}  # of all instances
    for part in PARTS:
        folder = root / part
        found = _numbered(folder / f"{part}_images")
        if not found:
            raise GagaError(f"{root} has no photos in {part}/{part}_images. Copy them there.")
        names = {n: path.name for n, path in found.items()}
        truth |= _truth_of(names, _numbered(folder / f"{part}_ins", (".npz",)), _read_instances)
        full |= _truth_of(names, _numbered(folder / f"{part}_ins_full"))
        poses |= _numbered(folder / f"{part}_pose", (".txt",))
        photos |= found
    cameras = _scannet_cameras(root, photos, poses)
    by_name = {path.name: path for path in photos.values()}
    return _Found(cameras, by_name, _FULL if full else _SOME, full or truth)


def _read_gaga_scannet(root: Path) -> _Found:
    photos = _photos_of(root, "images", "input")
    cameras = _colmap_cameras(root, "Reconstruct the cameras first.")
    files = [p for part in PARTS for p in pictures_in(root / part / f"{part}_ins_full").values()]
    truth = _truth_of(_by_stem(photos), {path.stem: path for path in files})
    return _Found(cameras, photos, _FULL, truth)


def _read_instances(path: Path) -> IntArray:
    """Label map (H, W) of an ``.npz`` of DM-NeRF: its ids are one lower, its void is -1."""
    ids = read_arrays(path, "Copy it again.").get(_DM_NERF_KEY)
    is_map = ids is not None and ids.ndim == 2 and ids.dtype.kind in "iu"
    if ids is None or not is_map or ids.max(initial=0) >= np.iinfo(np.int32).max:
        raise GagaError(f"{path} holds no label map {_DM_NERF_KEY}. Copy it again.")
    return np.maximum(ids, -1).astype(np.int32) + 1


def _scannet_cameras(
    root: Path, photos: Mapping[int, Path], poses: Mapping[int, Path]
) -> list[Camera]:
    """Cameras of the frames: the COLMAP model of ``root/sparse/0`` if there is one (splats trained
    on it live in its frame), else ScanNet's poses."""
    if has_colmap(root / "sparse" / "0"):
        names = {path.name for path in photos.values()}
        return [camera for camera in _colmap_cameras(root) if camera.name in names]
    if not poses:
        raise GagaError(f"{root} has no poses <number>.txt. Export the scene's poses.")
    size = _picture_size(next(iter(photos.values())))
    K = _intrinsics(root / "intrinsic", *size)
    posed = ((p.name, _read_numbers(poses[n], (4, 4))) for n, p in photos.items() if n in poses)
    return _posed_cameras(K, size, posed)


def _intrinsics(folder: Path, width: int, height: int) -> DoubleArray:
    """K (3, 3) for photos of this size: of the color or the depth camera, whichever is nearer in
    size (photos shrunk to 640 x 480 go with the depth camera, as in DM-NeRF), scaled to fit."""
    files = [folder / f"intrinsic_{kind}.txt" for kind in ("color", "depth")]
    found = [_read_numbers(file, (4, 4))[:3, :3] for file in files if file.is_file()]
    if not found:
        raise GagaError(f"{folder} has no intrinsic_color.txt. Export the scene's intrinsics.")
    if not all(is_usable(K, np.eye(4)) for K in found):
        raise GagaError(f"{folder} has intrinsics that no camera has. Export the scene again.")
    K = min(found, key=lambda k: abs(np.log(2 * k[0, 2] / width)) if k[0, 2] > 0 else np.inf)
    # The principal point lies near the middle, so twice it tells the size that K is meant for.
    scale = width / (2 * K[0, 2]) if min(K[0, 2], K[1, 2]) > 0 else 1.0
    if 0.8 < scale < 1.25:
        return K
    return np.diag([scale, height / (2 * K[1, 2]), 1.0]) @ K


# --- LERF-Mask (Ye et al., ECCV 2024): COLMAP scenes with masks of text prompts.
# ``<scene>/{images, images_train, sparse/0, test_mask/<i>/<text prompt>.png, object_mask}``. The
# test views are the photos that are not in images_train, by name; ``<i>`` counts them. A folder
# that is missing (teatime has none for view 1) has no truth, so that view is not scored.


def _read_lerf_mask(root: Path) -> _Found:
    photos, train = _photos_of(root, "images"), _by_stem(_photos_of(root, "images_train"))
    if not has_colmap(root / "sparse" / "0"):
        raise GagaError(f"{root} has no COLMAP model in sparse/0. Copy it there.")
    test = [name for name in sorted(photos) if Path(name).stem not in train]
    truth = root / "test_mask"
    keys = [f.name for f in truth.iterdir() if f.name.isdecimal()] if truth.is_dir() else []
    views = {key: test[int(key)] for key in sorted(keys, key=int) if int(key) < len(test)}
    if not views:
        raise GagaError(f"{root} has no masks test_mask/<number>/<text prompt>.png. Copy them.")
    prompts = _prompts_of(truth, views)
    return _Found(_colmap_cameras(root), photos, "test_mask", prompts=prompts)


# --- 3D-OVS (Liu et al., NeurIPS 2023): forward-facing scenes with masks of every class.
# ``<scene>/{images/<i>.jpg, segmentations/classes.txt, segmentations/<i>/<class>.png}`` with
# ``poses_bounds.npy`` (LLFF) or a COLMAP model. The views that have masks are the test views; all
# classes of classes.txt are expected in each.


def _read_ovs3d(root: Path) -> _Found:
    photos, truth = _photos_of(root, "images"), root / "segmentations"
    if not (truth / "classes.txt").is_file():
        raise GagaError(f"{root} has no segmentations/classes.txt. Copy the scene again.")
    stems = _by_stem(photos)
    keys = sorted(path.name for path in truth.iterdir() if path.is_dir())
    views = {key: stems[key] for key in keys if key in stems}
    if not views:
        raise GagaError(f"{root} has no masks segmentations/<photo>/<class>.png. Copy them.")
    named = [f"{key}/{word}.png" for key in views for word in read_names(truth / "classes.txt")]
    absent = [name for name in named if not (truth / name).is_file()]
    if absent:
        raise GagaError(
            f"{len(absent)} of {len(named)} class masks are not in {truth} "
            f"(first: {absent[0]}). Copy the scene again."
        )
    with_model = has_colmap(root / "sparse" / "0")
    cameras = _colmap_cameras(root) if with_model else _llff_cameras(root, photos)
    return _Found(cameras, photos, "segmentations", prompts=_prompts_of(truth, views))


def _llff_cameras(root: Path, photos: Mapping[str, Path]) -> list[Camera]:
    """Cameras of ``poses_bounds.npy`` in the order of the photos' names.

    A row is a 3 x 5 matrix and two bounds: world_from_cam whose axes point down, right, backwards,
    then height, width and focal length in pixels (Mildenhall et al., LLFF, SIGGRAPH 2019).
    """
    path = root / "poses_bounds.npy"
    rows = read_array(path, "Copy it again.")
    if rows.ndim != 2 or rows.shape[1] != 17 or rows.dtype.kind != "f":
        raise GagaError(f"{path} must hold 17 numbers a photo. Copy it again.")
    if len(rows) != len(photos):
        raise GagaError(
            f"{path} has {len(rows)} poses for {len(photos)} photos. "
            "Copy the scene again, or add a COLMAP model (sparse/0)."
        )
    pixels = rows[:, [9, 14]]  # width and focal length
    if not ((pixels >= 1) & (pixels <= MOST_PIXELS)).all():  # nor NaN
        raise GagaError(f"{path} has widths or focal lengths that cannot be. Copy it again.")
    cameras = []
    for row, (name, photo) in zip(rows.astype(np.float64), sorted(photos.items()), strict=True):
        matrix = row[:15].reshape(3, 5)
        width, height = _picture_size(photo)
        focal = matrix[2, 4] * width / matrix[1, 4]  # the photos may have been shrunk
        K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
        pose = np.eye(4)
        pose[:3] = np.stack([matrix[:, 1], matrix[:, 0], -matrix[:, 2], matrix[:, 3]], axis=1)
        cameras += _posed_cameras(K, (width, height), [(name, pose)])
    return cameras


# --- Mip-NeRF 360 (Barron et al., CVPR 2022) and any scene with a COLMAP model.
# ``<scene>/{images[_2|_4|_8], sparse/0}``; every 8th photo by name is a test view unless split.json
# says otherwise. Photos at a quarter of the size (images_4) are used where they are there, as the
# paper does; else those wider than 1600 pixels are used in a smaller folder, as the 3DGS trainer
# shrinks them. There are no true maps, except where ``gt/instance`` holds some (the layout of our
# own scenes): the data set is shown, not scored.


def _read_mipnerf360(root: Path) -> _Found:
    known = open_scene_folder(root).cameras
    if not known:
        raise GagaError(f"{root} has no COLMAP model in sparse/0. Copy it there.")
    photos, size = pictures_in(root / "images_4"), (0, 0)
    if photos:
        size = _picture_size(next(iter(photos.values())))
    else:  # the widest that are not too wide, else the smallest there are
        for found in (pictures_in(root / name) for name in ("images", "images_2", "images_8")):
            if found:
                photos, size = found, _picture_size(next(iter(found.values())))
                if size[0] <= _WIDEST:
                    break
    if not photos:
        raise GagaError(f"{root} has no photos in images/. Copy them there.")
    stems = _by_stem(camera.name for camera in known)
    by_name = {stems[path.stem]: path for path in photos.values() if path.stem in stems}
    maps = {path.stem: path for path in pictures_in(root / "gt" / "instance").values()}
    truth = _truth_of(stems, maps)
    cameras = [_at_size(camera, *size) for camera in known]
    names = [camera.name for camera in known]
    return _Found(cameras, by_name, "gt/instance" if truth else "", truth, parted=names)


def _at_size(camera: Camera, width: int, height: int) -> Camera:
    """The camera at the size of the photos used; one of another shape stays as it is."""
    same_shape = abs(camera.width * height - camera.height * width) <= camera.width + camera.height
    return camera.resized(width, height) if same_shape else camera


DATASETS: Mapping[str, KnownDataset] = {
    "replica": KnownDataset(
        "Replica",
        "instance",
        (
            _Layout(
                "Semantic-NeRF",
                "<scene>/Sequence_1/rgb, semantic_instance and traj_w_c.txt",
                lambda p: (p / "Sequence_1" / "rgb").is_dir() or (p / "traj_w_c.txt").is_file(),
                _read_semantic_nerf,
            ),
            _Layout(
                "Gaga",
                "<scene>/images/train_rgb_*.png, semantic_instance and sparse/0",
                lambda p: any(p.glob("images/t*_rgb_*")) or any(p.glob("input/t*_rgb_*")),
                _read_gaga_replica,
            ),
        ),
        (*(f"office_{k}" for k in range(5)), *(f"room_{k}" for k in range(3))),  # Semantic-NeRF's
    ),
    "scannet": KnownDataset(
        "ScanNet",
        "instance",
        (
            _Layout(
                "DM-NeRF",
                "<scene>/{train,test}/{train,test}_{images,pose,ins} and intrinsic/",
                lambda p: any((p / "train" / f"train_{k}").is_dir() for k in ("ins", "pose")),
                _read_dm_nerf,
            ),
            _Layout(
                "Gaga",
                "<scene>/images, {train,test}/{train,test}_ins_full and sparse/0",
                lambda p: (p / "train" / "train_ins_full").is_dir(),
                _read_gaga_scannet,
            ),
            _Layout(
                "ScanNet",
                "<scene>/color, pose, intrinsic and instance-filt",
                lambda p: (p / "color").is_dir(),
                _read_raw_scannet,
            ),
        ),
        tuple(  # DM-NeRF's choice
            f"scene{n}_00" for n in ("0010", "0012", "0024", "0033", "0038", "0088", "0113", "0192")
        ),
    ),
    "lerf-mask": KnownDataset(
        "LERF-Mask",
        "lerf-mask",
        (
            _Layout(
                "LERF-Mask",
                "<scene>/images, images_train, sparse/0 and test_mask/<number>/<text prompt>.png",
                lambda p: (p / "test_mask").is_dir() or (p / "images_train").is_dir(),
                _read_lerf_mask,
            ),
        ),
        ("figurines", "ramen", "teatime"),
    ),
    "3d-ovs": KnownDataset(
        "3D-OVS",
        "3d-ovs",
        (
            _Layout(
                "3D-OVS",
                "<scene>/images, segmentations/classes.txt and poses_bounds.npy or sparse/0",
                lambda p: (p / "segmentations").is_dir(),
                _read_ovs3d,
            ),
        ),
        ("bed", "bench", "room", "sofa", "lawn"),
    ),
    "mipnerf360": KnownDataset(
        "Mip-NeRF 360",
        "qualitative",
        (
            _Layout(
                "COLMAP",
                "<scene>/images and sparse/0",
                lambda p: (p / "sparse").is_dir() and (p / "images").is_dir(),
                _read_mipnerf360,
            ),
        ),
    ),
}
