"""Which program wrote a file of poses, and its reader: by content, one registry."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaga_core.errors import GagaError, option
from gaga_core.io.arrays_file import read_array
from gaga_core.io.cameras.cameras_json import read_cameras_json
from gaga_core.io.cameras.colmap import has_colmap, read_colmap
from gaga_core.io.cameras.given import (
    GivenPose,
    GivenPoses,
    Photos,
    brown_lens,
    cam_from,
    checked,
    rigid,
)
from gaga_core.io.cameras.phones import read_polycam, read_record3d, read_scanner_app, read_stray
from gaga_core.io.cameras.photogrammetry import (
    read_bundler,
    read_metashape,
    read_opf,
    read_p4d,
    read_pix4d,
    read_realityscan_csv,
    read_realityscan_xmp,
)
from gaga_core.io.cameras.transforms_json import read_transforms_json
from gaga_core.io.files import open_file

_HEAD = 1 << 16  # bytes of a file that are looked at
_MOST_FILES = 4000  # of a folder that are looked at
_SAME = 0.01  # of a rotation matrix: half a degree
_LLFF = 17  # numbers of a pose: 3 x 5, and two bounds


def read_cameras_of_3dgs(path: Path, photos: Photos) -> GivenPoses:
    """Poses of the cameras.json of a 3DGS training."""
    poses = []
    for camera in read_cameras_json(path):
        if (name := photos.find(camera.name)) is not None:
            fx, fy, cx, cy = (float(camera.K[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
            lens = brown_lens((camera.width, camera.height), (fx, fy), (cx, cy))
            poses.append(GivenPose(name, lens, camera.cam_from_world))
    return checked(GivenPoses("3DGS cameras.json", path, tuple(poses)), photos)


def read_colmap_poses(folder: Path, photos: Photos) -> GivenPoses:
    """Poses of a COLMAP model with their lenses; of rigs the place of each photo."""
    model = read_colmap(folder, with_lenses=True)
    named = ((photos.find(camera.name), camera, i) for i, camera in enumerate(model.cameras))
    poses = tuple(
        GivenPose(name, model.lenses[i], camera.cam_from_world)
        for name, camera, i in named
        if name is not None
    )
    return checked(GivenPoses("COLMAP", folder, poses), photos)


def read_llff(path: Path, photos: Photos) -> GivenPoses:
    """Poses of LLFF's poses_bounds.npy, of the photos in the order of their names.

    Columns are down, right, backwards, place, and height, width, focal length in pixels.
    """
    rows = read_array(path, "Copy it again.")
    is_table = rows.ndim == 2 and rows.shape[1] == _LLFF and rows.dtype.kind in "iuf"
    if not is_table or not np.isfinite(rows[:, :15]).all():
        raise GagaError(f"{path}: expected {_LLFF} numbers for each photo. Copy it again.")
    names = sorted(photos.paths)
    if len(names) != len(rows):
        raise GagaError(
            f"{path} has poses of {len(rows)} photos without names, but {photos.folder} has "
            f"{len(names)} photos. Give exactly those that it was made for."
        )
    poses = []
    for name, row in zip(names, rows[:, :15].reshape(-1, 3, 5).astype(np.float64), strict=True):
        down, right, back, place, (height, width, focal) = row.T
        lens = brown_lens((round(width), round(height)), (focal, focal), (width / 2, height / 2))
        turn = np.stack([right, down, -back], axis=1)
        poses.append(GivenPose(name, lens, cam_from(rigid(turn, place))))
    return checked(GivenPoses("LLFF", path, tuple(poses)), photos)


@dataclass(frozen=True)
class PoseFormat:
    """A form of poses: how it is recognized, and its reader."""

    name: str
    is_it: Callable[[Path, bytes], bool]  # by path and its first bytes; b"" for a folder
    read: Callable[[Path, Photos], GivenPoses]


def _has(*words: bytes) -> Callable[[Path, bytes], bool]:
    return lambda _, head: all(word in head for word in words)


def _holds(pattern: str, *words: bytes) -> Callable[[Path, bytes], bool]:
    """A folder with files of that name; the first of them has these words."""

    def is_it(path: Path, head: bytes) -> bool:
        if head or not path.is_dir():
            return False
        first = next(iter(sorted(path.glob(pattern))), None)
        return first is not None and all(word in _head(first) for word in words)

    return is_it


def _is_stray(_: Path, head: bytes) -> bool:
    words = [word.strip() for word in head.split(b"\n", 1)[0].split(b",")]
    return words[:2] == [b"timestamp", b"frame"] and b"qw" in words


def _is_record3d(path: Path, head: bytes) -> bool:
    """Its keys come in any order, with thousands of numbers between them."""
    words = (b'"K"', b'"poses"', b'"perFrameIntrinsicCoeffs"')
    found = [word in head for word in words]
    return all(found[:2]) or (path.stem == "metadata" and any(found))


FORMATS = (
    PoseFormat("transforms.json", _has(b'"frames"', b'"transform_matrix"'), read_transforms_json),
    PoseFormat("COLMAP", lambda path, head: not head and has_colmap(path), read_colmap_poses),
    PoseFormat("RealityScan CSV", _has(b"#name", b"heading"), read_realityscan_csv),
    PoseFormat("RealityScan XMP", _holds("*.xmp", b"xcr:Position"), read_realityscan_xmp),
    PoseFormat("Bundler", lambda _, head: head.startswith(b"# Bundle file"), read_bundler),
    PoseFormat("Metashape", _has(b"<document", b"<chunk"), read_metashape),
    PoseFormat("Pix4D", _has(b"fileName imageWidth imageHeight"), read_pix4d),
    PoseFormat("Pix4D project", _has(b"<pix4d"), read_p4d),
    PoseFormat("OPF", _has(b"application/opf-project+json"), read_opf),
    PoseFormat("Polycam", _holds("*.json", b'"t_00"', b'"fx"'), read_polycam),
    PoseFormat("3D Scanner App", _holds("frame_*.json", b"cameraPoseARFrame"), read_scanner_app),
    PoseFormat("Stray Scanner", _is_stray, read_stray),
    PoseFormat("Record3D", _is_record3d, read_record3d),
    PoseFormat("3DGS", _has(b'"rotation"', b'"position"', b'"fx"'), read_cameras_of_3dgs),
    PoseFormat("LLFF", lambda p, head: head[:6] == b"\x93NUMPY" and "poses" in p.stem, read_llff),
)
_SUFFIXES = (".json", ".csv", ".out", ".xml", ".txt", ".p4d", ".opf", ".npy", "")
_ORIGINALS = "input"  # photos with the lens's distortion; the model next to images/ is without it
_FOLDERS = ("sparse/0", "sparse", "colmap/sparse/0", "corrected_cameras", "cameras")


def format_of(path: Path) -> PoseFormat | None:
    """The form of poses that a file or folder has; None when it is none."""
    head = _head(path) if path.is_file() else b""
    if not head and not path.is_dir():
        return None
    return next((form for form in FORMATS if form.is_it(path, head)), None)


def _head(path: Path) -> bytes:
    try:
        with open_file(path) as file:
            return file.read(_HEAD)
    except OSError:
        return b""


def read_poses(path: Path, folder: Path) -> GivenPoses:
    """Poses in ``path``, a file or a folder of files, of the photos in ``folder``.

    Raises ``GagaError`` with one sentence when it is of no known form, damaged, or about others.
    """
    if not path.exists():
        raise GagaError(f"{path} does not exist. Check the path of the poses.")
    form = format_of(path)
    if form is None and path.is_dir() and (inside := _candidates(path)):
        path, form = inside[0]
    if form is None:
        raise GagaError(
            f"{path} is no file of poses that is known. Known are "
            f"{', '.join(dict.fromkeys(form.name for form in FORMATS))}."
        )
    return form.read(path, Photos(folder))


def find_poses(folder: Path) -> GivenPoses | None:
    """The poses that lie next to the photos in ``folder``, in it, or in its parent; None without.

    Raises ``GagaError`` when two programs left some, or when those that are there cannot be used:
    a choice of the user, not of ours.
    """
    for place in (folder, folder.parent):
        found = _candidates(place, is_own=place == folder)
        if place != folder and folder.name == _ORIGINALS and (place / "images").is_dir():
            found = [(path, form) for path, form in found if form.name != "COLMAP"]
        readable: list[GivenPoses] = []
        errors: list[GagaError] = []
        for path, form in found:
            photos = Photos(folder)
            try:
                readable.append(form.read(path, photos))
            except GagaError as error:
                # Others' poses may lie in a parent folder.
                if len(photos.missing) < len(photos.paths) or not photos.missing:
                    errors.append(error)
        one = readable[0] if readable else None
        other = next((g for g in readable[1:] if not _agree(readable[0], g)), None)
        if one is not None and other is not None:
            raise GagaError(
                f"{one.file} ({one.program}) and {other.file} ({other.program}) both have poses "
                f"of the photos. Name one with {option('--poses-from')}, or "
                f"{option('--poses', 'ignore')}."
            )
        if one is not None:
            return one
        if errors:
            raise GagaError(f"{errors[0]} Or leave it out: {option('--poses', 'ignore')}.")
    return None


def _agree(one: GivenPoses, other: GivenPoses) -> bool:
    """Whether two files say the same of how the cameras are turned to each other."""
    a, b = ({p.name: p.cam_from_world[:3, :3] for p in given.poses} for given in (one, other))
    names = [name for name in a if name in b]
    if len(names) < min(len(a), len(b)):
        return False
    turns = np.array([a[name].T @ b[name] for name in names])
    return bool(np.abs(turns - turns[0]).max() < _SAME)


def _candidates(place: Path, *, is_own: bool = True) -> list[tuple[Path, PoseFormat]]:
    """Files and folders of poses in ``place``; of Blender's three files the first."""
    try:
        files = [p for p in sorted(place.iterdir()) if p.suffix.lower() in _SUFFIXES]
    except OSError:
        return []
    files = [p for p in files[:_MOST_FILES] if p.is_file()]
    paths = [*files, *(place / name for name in _FOLDERS if (place / name).is_dir())]
    paths += [place] if is_own else []
    if (place / "gaga" / "report.json").is_file():  # a scene folder: an earlier run wrote its own
        paths = [path for path in paths if path.name != "cameras.json"]
    found = [(path, form) for path in paths if (form := format_of(path)) is not None]
    blender = [path for path, _ in found if path.name.startswith("transforms_")]
    calibrated = {form.name for _, form in found}
    return [
        (path, form)
        for path, form in found
        if path not in blender[:-1]
        if not (form.name == "Pix4D project" and "Pix4D" in calibrated)
    ]
