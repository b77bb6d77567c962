"""Poses of photos that another program has found: the one typed result of all their readers."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree

import numpy as np
from PIL import ExifTags

from gaga_core.arrays import AnyArray, DoubleArray
from gaga_core.camera import MOST_PIXELS, is_usable
from gaga_core.errors import GagaError, counted
from gaga_core.io.depth_maps import DepthMap, is_map, why_unread
from gaga_core.io.images import image_header, pictures_in
from gaga_core.io.json_file import read_bytes

MOST_BYTES = 1 << 30  # of a file of poses: a photo takes some 2 kB
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # cameras that look along -z, with y up
_ASPECT = 0.01  # relative: photos that were made smaller differ in it by rounding
_NAMED = 3  # names in a sentence
_FAR = 1e4  # times the extent of the cameras: splats in float32 need the origin nearer
# COLMAP's lens models: how many focal lengths stand before the principal point.
FOCALS = {
    **dict.fromkeys(("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_FISHEYE"), 1),
    **dict.fromkeys(("SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "SIMPLE_DIVISION"), 1),
    **dict.fromkeys(("PINHOLE", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV"), 2),
    **dict.fromkeys(("THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE", "DIVISION"), 2),
    **dict.fromkeys(("FISHEYE", "EUCM"), 2),
}
_TANGENTIAL = ("OPENCV", "FULL_OPENCV")
_CLOCKWISE = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
_TURNS = {1: 0, 6: 1, 3: 2, 8: 3}  # right angles clockwise to stand upright, by the EXIF tag


PINHOLES = ("SIMPLE_PINHOLE", "PINHOLE")  # models of COLMAP without distortion


@dataclass(frozen=True)
class Lens:
    """A lens in COLMAP's words: focal lengths, principal point (pixels, the middle of the first
    pixel at 0.5), then what bends the rays."""

    model: str  # a key of `FOCALS`
    width: int  # pixels
    height: int
    params: tuple[float, ...]

    def resized(self, width: int, height: int) -> "Lens":
        """The same lens for a picture of another size."""
        x, y = width / self.width, height / self.height
        if x == y == 1:
            return self
        n = FOCALS[self.model]
        scales = ((x, y) if n == 2 else ((x + y) / 2,)) + (x, y)
        first = tuple(p * s for p, s in zip(self.params, scales, strict=False))
        return Lens(self.model, width, height, first + self.params[n + 2 :])

    def turned(self) -> "Lens":
        """The same lens for the picture turned clockwise by a right angle."""
        n = FOCALS[self.model]
        focal, (cx, cy), rest = self.params[:n], self.params[n : n + 2], list(self.params[n + 2 :])
        if self.model in _TANGENTIAL:  # p1 and p2 behind k1 and k2
            rest[2:4] = rest[3], -rest[2]
        centre = self.height - cy, cx
        return Lens(self.model, self.height, self.width, (*focal[::-1], *centre, *rest))

    @property
    def is_bent(self) -> bool:
        """Whether it is more than a pinhole."""
        return self.model not in PINHOLES

    @property
    def K(self) -> DoubleArray:  # noqa: N802  the field's name
        """Its pinhole part (3, 3)."""
        n = FOCALS[self.model]
        fx, fy, (cx, cy) = self.params[0], self.params[n - 1], self.params[n : n + 2]
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


def brown_lens(
    size: tuple[int, int],
    focal: tuple[float, float],
    centre: tuple[float, float],
    radial: Iterable[float] = (),
    tangential: tuple[float, float] = (0.0, 0.0),
) -> Lens:
    """The simplest lens with a polynomial k1, k2, k3 and p1, p2 in OpenCV's order."""
    k1, k2, k3 = (*radial, 0.0, 0.0, 0.0)[:3]
    pinhole = (*focal, *centre)
    if k3:
        return Lens("FULL_OPENCV", *size, (*pinhole, k1, k2, *tangential, k3, 0.0, 0.0, 0.0))
    if any((k1, k2, *tangential)):
        return Lens("OPENCV", *size, (*pinhole, k1, k2, *tangential))
    return Lens("PINHOLE", *size, pinhole)


@dataclass(frozen=True, eq=False)
class GivenPose:
    """Place and lens of a photo, as a program found them."""

    name: str  # of the photo, from the folder of photos on
    lens: Lens | None  # for the photo as it is; None where the program does not say
    cam_from_world: DoubleArray  # (4, 4) rigid, OpenCV axes
    mask: Path | None = None  # black = background; like depth it lies as the photo is stored
    depth: DepthMap | None = None
    turns: int = 0  # right angles clockwise by which photo, mask and depth stand upright


@dataclass(frozen=True, eq=False)
class GivenPoses:
    """Poses of photos in the world of the program that found them."""

    program: str  # its name, or that of the format
    file: Path
    poses: tuple[GivenPose, ...]
    is_metric: bool = False  # a unit of the world is a metre
    up: tuple[float, float, float] | None = None  # unit, world; None = not known
    missing: tuple[str, ...] = ()  # photos in the file that are not in the folder
    notes: tuple[str, ...] = ()  # what could not be taken over

    @property
    def has_masks(self) -> bool:
        """Whether a photo has one."""
        return any(pose.mask is not None for pose in self.poses)

    @property
    def told(self) -> str:
        """One line: whose poses these are, of how many photos, and what is known of the world."""
        known = [*(["metres"] if self.is_metric else []), *(["the vertical"] if self.up else [])]
        for kind, what in (("mask", "mask"), ("depth", "depth map")):
            n = sum(getattr(pose, kind) is not None for pose in self.poses)
            known += [counted(n, what)] if n else []
        listed = " and ".join([*([", ".join(known[:-1])] if known[:-1] else []), *known[-1:]])
        of = f", with {listed}" if known else ""
        file = "" if self.program == self.file.name else f" in {self.file.name}"
        return f"{self.program}: poses of {counted(len(self.poses), 'photo')}{file}{of}"


class Photos:
    """The photos that poses are given for, found by what a file calls them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        found = pictures_in(folder, "**/*")
        self.paths = {name: p for name, p in found.items() if not is_map(PurePosixPath(name))}
        self.missing: list[str] = []

    @cached_property
    def _by_key(self) -> dict[str, list[str]]:
        found: dict[str, list[str]] = {}
        for name in self.paths:
            path = PurePosixPath(name.lower())
            for key in {path.name, path.stem}:
                found.setdefault(key, []).append(name)
        return found

    def find(self, said: str) -> str | None:
        """The photo that a file calls ``said``, with folders of any machine and with or without
        suffix; None, and noted as missing, without one. Raises ``GagaError`` when several fit."""
        parts = PurePosixPath(said.replace("\\", "/").lower()).parts
        if not parts:
            return None
        of_stem = self._by_key.get(PurePosixPath(parts[-1]).stem, [])
        names = self._by_key.get(parts[-1]) or of_stem
        if len(names) > 1:  # in several folders: the one whose folders agree furthest
            shared = [_shared(parts, PurePosixPath(name.lower()).parts) for name in names]
            names = [n for n, k in zip(names, shared, strict=True) if k == max(shared)]
        if len(names) > 1:
            raise GagaError(
                f"{said} may be {' or '.join(names[:2])} in {self.folder}. Rename one of them."
            )
        if not names:
            self.missing.append(said)
            return None
        return names[0]

    def size(self, name: str) -> tuple[int, int]:
        """Width and height as the photo is stored, before a tag turns it."""
        with image_header(self.paths[name]) as image:
            return image.size

    def turns(self, name: str) -> int:
        """Right angles clockwise that its tag turns the photo by. ``GagaError``: it mirrors it."""
        with image_header(self.paths[name]) as image:
            tag = image.getexif().get(ExifTags.Base.Orientation, 1) if image.format != "PNG" else 1
        if tag not in _TURNS and tag in range(2, 8):
            raise GagaError(f"{self.paths[name]} is stored mirrored. Save it upright.")
        return _TURNS.get(tag, 0)

    def stems(self) -> dict[str, str]:
        """Names of the photos by their stems."""
        return {PurePosixPath(name).stem: name for name in self.paths}


def _shared(a: tuple[str, ...], b: tuple[str, ...]) -> int:
    """Folders that two paths have in common, from their ends."""
    n = 0
    for one, other in zip(a[-2::-1], b[-2::-1], strict=False):
        if one != other:
            break
        n += 1
    return n


def rigid(rotation: AnyArray, translation: AnyArray) -> DoubleArray:
    """A pose (4, 4) of its rotation (3, 3) and translation (3,)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    return pose


def cam_from(world_from_cam: AnyArray) -> DoubleArray:
    """The inverse (4, 4) of a rigid pose with OpenCV axes."""
    turn = np.asarray(world_from_cam, np.float64)[:3, :3].T
    return rigid(turn, -turn @ np.asarray(world_from_cam, np.float64)[:3, 3])


def cam_from_opengl(world_from_cam: AnyArray) -> DoubleArray:
    """`cam_from` of a camera that looks along its -z, with y up."""
    return cam_from(np.asarray(world_from_cam, np.float64) @ OPENGL)


def checked(given: GivenPoses, photos: Photos) -> GivenPoses:
    """``given`` for the photos as they are, near the origin.

    Raises ``GagaError`` when a pose is none, a photo has two, or a photo has another shape than
    the lens was measured for.
    """
    poses: dict[str, GivenPose] = {}
    for pose in given.poses:
        if not (
            np.isfinite(pose.cam_from_world).all() and is_usable(np.eye(3), pose.cam_from_world)
        ):
            raise GagaError(f"{given.file}: the pose of {pose.name} is no rotation and place.")
        if pose.name in poses:
            raise GagaError(f"{given.file} has two poses of {pose.name}. Export it again.")
        poses[pose.name] = _for_photo(pose, photos, given.file)
    if not poses:
        listed = ", ".join(photos.missing[:_NAMED])
        raise GagaError(
            f"{given.file} names no photo that is in {photos.folder}"
            + (f" ({listed})." if listed else ".")
        )
    found = replace(given, poses=tuple(poses[name] for name in sorted(poses)))
    why = next((w for p in found.poses if p.depth and (w := why_unread(p.depth.path))), "")
    if why:
        without = tuple(replace(pose, depth=None) for pose in found.poses)
        found = replace(found, poses=without, notes=(*found.notes, why))
    return _near_origin(replace(found, missing=(*given.missing, *photos.missing)))


def _for_photo(pose: GivenPose, photos: Photos, file: Path) -> GivenPose:
    """``pose`` for the photo as it stands upright.

    Programs that pass over the EXIF tag measured it as it is stored: its shape tells.
    """
    lens, turns = pose.lens, photos.turns(pose.name)
    width, height = photos.size(pose.name)
    if lens is not None:
        sizes = (lens.width, lens.height, *lens.params)
        if not (np.isfinite(sizes).all() and min(sizes[:2]) > 0 and max(sizes[:2]) <= MOST_PIXELS):
            raise GagaError(f"{file}: the lens of {pose.name} has no usable size.")
        if turns % 2 and not _is_shape(lens, (width, height)):
            turns, width, height = 0, height, width  # measured upright
        if not _is_shape(lens, (width, height)):
            raise GagaError(
                f"{file} is about pictures of {lens.width} x {lens.height} pixels, but {pose.name} "
                f"has {width} x {height}. Give the photos that it was made from."
            )
        lens = lens.resized(width, height)
        if not is_usable(lens.K, np.eye(4)):
            raise GagaError(f"{file}: the focal length of {pose.name} is not usable.")
    cam_from_world = pose.cam_from_world
    for _ in range(turns):
        cam_from_world = _CLOCKWISE @ cam_from_world
        lens = None if lens is None else lens.turned()
    return replace(pose, lens=lens, cam_from_world=cam_from_world, turns=turns)


def _is_shape(lens: Lens, size: tuple[int, int]) -> bool:
    return abs(lens.width * size[1] / (lens.height * size[0]) - 1) <= _ASPECT


def _near_origin(given: GivenPoses) -> GivenPoses:
    """Coordinates of a map (UTM, earth-centred) moved to the cameras, by whole units."""
    places = np.array([np.linalg.inv(pose.cam_from_world)[:3, 3] for pose in given.poses])
    extent = max(float(np.ptp(places, axis=0).max()), 1e-9)
    middle = np.round(np.median(places, axis=0))
    if np.abs(middle).max() < _FAR * extent or np.abs(middle).max() < _FAR:
        return given
    shift = rigid(np.eye(3), middle)
    poses = tuple(replace(p, cam_from_world=p.cam_from_world @ shift) for p in given.poses)
    note = f"The origin was moved by {', '.join(f'{v:.0f}' for v in middle)}: it lay far away."
    return replace(given, poses=poses, notes=(*given.notes, note))


def file_near(file: Path, said: str | None) -> Path | None:
    """The file that another file names by a path from its folder on; None unless it is there."""
    if not said:
        return None
    path = (file.parent / said.replace("\\", "/")).resolve()
    return path if path.is_file() and path.is_relative_to(file.parent.resolve()) else None


def read_xml(path: Path) -> ElementTree.Element:
    """The root of an XML file. Raises ``GagaError`` when it is damaged or declares entities."""
    raw = read_bytes(path, "Export it again.", MOST_BYTES)
    if b"<!ENTITY" in raw or b"<!DOCTYPE" in raw:
        raise GagaError(f"{path} declares entities, which no file of poses needs. Export it again.")
    try:
        return ElementTree.fromstring(raw)
    except (ElementTree.ParseError, ValueError) as error:
        raise GagaError(f"{path} is damaged ({error}). Export it again.") from error


def numbers(text: str | None, n: int, where: str) -> list[float]:
    """``n`` finite numbers of a text. Raises ``GagaError`` that says ``where`` they are not."""
    try:
        found = [float(word) for word in (text or "").replace(",", " ").split()]
    except ValueError:
        found = []
    if len(found) != n or not np.isfinite(found).all():
        raise GagaError(f"{where}: expected {n} numbers. Export it again.")
    return found
