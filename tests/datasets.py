"""Miniature data sets of every layout, made from one tiny true scene: cameras, photos, maps and
splats are known, so whatever a reader or a benchmark says can be checked."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.arrays import DoubleArray, IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.io.cameras.colmap import write_colmap
from gaga_core.io.masks.label_maps import write_labels
from gaga_core.io.splats.ply import write_ply
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from tests.scenes import objects_scene

N_BALLS = 4
FLOOR = N_BALLS + 1
N_VIEWS = 8
WIDTH, HEIGHT = 80, 60


@dataclass(frozen=True, eq=False)
class Tiny:
    """A true scene: view k of every layout is camera k here."""

    gaussians: Gaussians
    cameras: tuple[Camera, ...]
    labels: tuple[IntArray, ...]  # (H, W) true ids: balls 1..4, floor 5, 0 = void
    photos: tuple[UInt8Array, ...]  # (H, W, 3)


@cache
def tiny() -> Tiny:
    """Four balls on a floor, eight views all around, 90 degrees across."""
    scene = objects_scene(N_BALLS, 150, n_cameras=N_VIEWS, seed=3)
    K = np.array([[WIDTH / 2, 0, WIDTH / 2], [0, WIDTH / 2, HEIGHT / 2], [0, 0, 1.0]])
    cameras = tuple(
        replace(camera, K=K, width=WIDTH, height=HEIGHT, name=f"{i}.png")
        for i, camera in enumerate(scene.cameras)
    )
    raster = CpuRasterizer()
    ids = np.where(scene.labels > 0, scene.labels, FLOOR).astype(np.int32)
    labels, photos = [], []
    for camera in cameras:
        shown = raster.label_splat(scene.gaussians, camera, ids)
        labels.append(np.where(shown.confidence > 0.4, shown.labels, 0).astype(np.int32))
        image = raster.render(scene.gaussians, camera).image
        photos.append((np.clip(image, 0, 1) * 255).astype(np.uint8))
    return Tiny(scene.gaussians, cameras, tuple(labels), tuple(photos))


def scrambled(labels: IntArray, seed: int) -> IntArray:
    """The same regions under ids of this view's own, as a 2D segmenter gives them."""
    ids = np.random.default_rng(seed).permutation(40)[:FLOOR] + 1
    lookup = np.concatenate([[0], ids]).astype(np.int32)
    return lookup[labels]


def write_photo(path: Path, photo: UInt8Array) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(photo).save(path)


def write_map(path: Path, labels: IntArray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_labels(path, labels)


def write_binary(path: Path, labels: IntArray, wanted: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((labels == wanted).astype(np.uint8) * np.uint8(255)).save(path)


def write_sparse(root: Path, names: Mapping[int, str]) -> None:
    cameras = [replace(tiny().cameras[k], name=name) for k, name in names.items()]
    points = tiny().gaussians.means[::10].astype(np.float64)
    colors = np.full((len(points), 3), 128, np.uint8)
    write_colmap(root / "sparse" / "0", cameras, points, colors)


def write_model(root: Path) -> None:
    path = root / "point_cloud" / "iteration_30000" / "point_cloud.ply"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_ply(path, tiny().gaussians)


def write_raw_masks(root: Path, stems: Mapping[int, str], name: str = "raw_sam_mask") -> None:
    for k, stem in stems.items():
        write_map(root / name / f"{stem}.png", scrambled(tiny().labels[k], k))


def _numbers(path: Path, values: DoubleArray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, values)


def semantic_nerf(
    root: Path, *, masks: bool = True, first: int = 10, digits: int = 0
) -> dict[int, str]:
    """Replica as Semantic-NeRF has it: frames 10, 15, ... and 12, 17, ...; view k's name.

    Frames may begin at another ``first``, and be padded with zeros to ``digits``.
    """
    frames = {k: first + 5 * (k // 2) + 2 * (k % 2) for k in range(N_VIEWS)}
    names = {k: f"rgb_{i:0{digits}d}" for k, i in frames.items()}
    sequence = root / "Sequence_1"
    n_frames = max(frames.values()) + 1
    poses = np.tile(np.eye(4), (n_frames, 1, 1))
    for k, i in frames.items():
        poses[i] = tiny().cameras[k].world_from_cam
        tail = f"semantic_instance_{i:0{digits}d}.png"
        write_map(sequence / "semantic_instance" / tail, tiny().labels[k])
    view_of = {i: k for k, i in frames.items()}
    for i in range(first, n_frames):
        photo = tiny().photos[view_of.get(i, 0)]
        write_photo(sequence / "rgb" / f"rgb_{i:0{digits}d}.png", photo)
    _numbers(sequence / "traj_w_c.txt", poses.reshape(n_frames, 16))
    write_model(root)
    if masks:
        write_raw_masks(root, names)
    return {k: f"{name}.png" for k, name in names.items()}


def gaga_replica(
    root: Path, *, masks: bool = True, numbers: Sequence[int] = range(N_VIEWS), digits: int = 4
) -> dict[int, str]:
    """Replica as Gaga's script has it; pairs of views have ``numbers``, padded to ``digits``."""
    tags = {k: ("test" if k % 2 else "train", numbers[k // 2]) for k in range(N_VIEWS)}
    names = {k: f"{part}_rgb_{i:0{digits}d}.png" for k, (part, i) in tags.items()}
    for k, (part, i) in tags.items():
        write_photo(root / "images" / names[k], tiny().photos[k])
        tail = f"{part}_semantic_instance_{i:0{digits}d}.png"
        write_map(root / "semantic_instance" / tail, tiny().labels[k])
    write_sparse(root, names)
    write_model(root)
    if masks:
        write_raw_masks(root, {k: Path(name).stem for k, name in names.items()})
    return names


def raw_scannet(root: Path) -> dict[int, str]:
    """ScanNet as its reader exports it; tracking lost frame 90."""
    names = {k: f"{10 * k}.jpg" for k in range(N_VIEWS)}
    for k, name in names.items():
        write_photo(root / "color" / name, tiny().photos[k])
        write_map(root / "instance-filt" / f"{10 * k}.png", tiny().labels[k])
        _numbers(root / "pose" / f"{10 * k}.txt", tiny().cameras[k].world_from_cam)
    write_photo(root / "color" / "90.jpg", tiny().photos[0])
    _numbers(root / "pose" / "90.txt", np.full((4, 4), -np.inf))
    _write_intrinsics(root)
    write_model(root)
    write_raw_masks(root, {k: str(10 * k) for k in names})
    return names


def _write_intrinsics(root: Path) -> None:
    K = np.eye(4)
    K[:3, :3] = tiny().cameras[0].K
    color = np.diag([4.0, 4.0, 1, 1]) @ K  # of the camera's full size, and a little narrower
    color[[0, 1], [0, 1]] *= 1.1
    _numbers(root / "intrinsic" / "intrinsic_color.txt", color)
    _numbers(root / "intrinsic" / "intrinsic_depth.txt", K)


def dm_nerf(root: Path) -> dict[int, str]:
    """ScanNet as DM-NeRF has it: ids from 0, void -1."""
    names = {k: f"{7 * k}.jpg" for k in range(N_VIEWS)}
    for part in ("train", "test"):
        numbers = []
        for k in range(N_VIEWS):
            if (k % 4 == 2) != (part == "test"):
                continue
            write_photo(root / part / f"{part}_images" / names[k], tiny().photos[k])
            pose = tiny().cameras[k].world_from_cam
            _numbers(root / part / f"{part}_pose" / f"{7 * k}.txt", pose)
            ids = root / part / f"{part}_ins" / f"{7 * k}.npz"
            ids.parent.mkdir(exist_ok=True)
            np.savez_compressed(ids, ins_2d_label_id=(tiny().labels[k] - 1).astype(np.int16))
            numbers.append(7 * k)
        np.savetxt(root / f"{part}_split.txt", numbers)  # as 1.4e+01
    _write_intrinsics(root)
    (root / "ins_rgb.hdf5").write_bytes(b"")
    write_model(root)
    write_raw_masks(root, {k: str(7 * k) for k in names})
    return names


def gaga_scannet(root: Path) -> dict[int, str]:
    """ScanNet as Gaga's script has it."""
    names = {k: f"{7 * k}.jpg" for k in range(N_VIEWS)}
    for part in ("train", "test"):
        chosen = [k for k in range(N_VIEWS) if (k % 4 == 2) == (part == "test")]
        for k in chosen:
            write_photo(root / "images" / names[k], tiny().photos[k])
            write_photo(root / part / f"{part}_images" / names[k], tiny().photos[k])
            write_map(root / part / f"{part}_ins_full" / f"{7 * k}.png", tiny().labels[k])
        text = "".join(f"{7 * k}\n" for k in chosen)
        (root / f"{part}_split.txt").write_text(text)
    write_sparse(root, names)
    write_model(root)
    write_raw_masks(root, {k: str(7 * k) for k in names})
    return names


PROMPTS = {1: "red ball", 2: "ball no. 2", 3: "old ball"}  # true id -> phrase; one has dots


def lerf_mask(root: Path) -> dict[int, str]:
    """LERF-Mask: test views 2, 4 and 6; the second has no truth."""
    names = {k: f"frame_{k:05d}.jpg" for k in range(N_VIEWS)}
    test = [2, 4, 6]
    for k, name in names.items():
        write_photo(root / "images" / name, tiny().photos[k])
        write_map(root / "object_mask" / f"frame_{k:05d}.png", tiny().labels[k])
        if k not in test:
            write_photo(root / "images_train" / name, tiny().photos[k])
    for i, k in enumerate(test):
        if i == 1:
            continue
        for wanted, text in PROMPTS.items():
            write_binary(root / "test_mask" / str(i) / f"{text}.png", tiny().labels[k], wanted)
    write_sparse(root, names)
    write_model(root)
    write_raw_masks(root, {k: f"frame_{k:05d}" for k in names})
    return names


def ovs3d(root: Path, *, sparse: bool = True) -> dict[int, str]:
    """3D-OVS: test views 0 and 4; cameras from COLMAP or as LLFF writes them."""
    names = {k: f"{k:02d}.jpg" for k in range(N_VIEWS)}
    for k, name in names.items():
        write_photo(root / "images" / name, tiny().photos[k])
    for k in (0, 4):
        for wanted, text in PROMPTS.items():
            path = root / "segmentations" / f"{k:02d}" / f"{text}.png"
            write_binary(path, tiny().labels[k], wanted)
    (root / "segmentations" / "classes.txt").write_text("\n".join(PROMPTS.values()) + "\n")
    if sparse:
        write_sparse(root, names)
    else:
        np.save(root / "poses_bounds.npy", _llff_rows())
    write_model(root)
    write_raw_masks(root, {k: f"{k:02d}" for k in names})
    return names


def _llff_rows() -> DoubleArray:
    """Rows of poses_bounds.npy for photos of twice the size: axes down, right, backwards."""
    rows = []
    for camera in tiny().cameras:
        right, down, forward, centre = camera.world_from_cam[:3].T
        hwf = np.array([2 * HEIGHT, 2 * WIDTH, 2 * camera.K[0, 0]])
        matrix = np.stack([down, right, -forward, centre, hwf], axis=1)
        rows.append(np.concatenate([matrix.ravel(), [0.1, 10.0]]))
    return np.array(rows)


def mipnerf360(root: Path, *, truth: bool = False) -> dict[int, str]:
    """A COLMAP scene; photos at a quarter of the cameras' size in images_4 too."""
    names = {k: f"DSC.{k:03d}.JPG" for k in range(N_VIEWS)}
    for k, name in names.items():
        write_photo(root / "images" / name, tiny().photos[k])
        if truth:
            write_map(root / "gt" / "instance" / f"{Path(name).stem}.png", tiny().labels[k])
    write_sparse(root, names)
    write_model(root)
    for k, name in names.items():
        path = root / "masks" / "sam" / f"{Path(name).stem}.png"
        write_map(path, scrambled(tiny().labels[k], k))
    return names


# Name of the data set, and what writes a scene of it, by layout.
LAYOUTS: Mapping[str, tuple[str, Callable[[Path], dict[int, str]]]] = {
    "Semantic-NeRF": ("replica", semantic_nerf),
    "Replica, Gaga": ("replica", gaga_replica),
    "ScanNet": ("scannet", raw_scannet),
    "DM-NeRF": ("scannet", dm_nerf),
    "ScanNet, Gaga": ("scannet", gaga_scannet),
    "LERF-Mask": ("lerf-mask", lerf_mask),
    "3D-OVS": ("3d-ovs", ovs3d),
    "COLMAP": ("mipnerf360", mipnerf360),
}
