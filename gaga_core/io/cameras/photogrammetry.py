"""Poses of photogrammetry programs: RealityScan, Bundler, Metashape, Pix4D, OPF."""

import csv
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated
from xml.etree.ElementTree import Element

import msgspec
import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.errors import GagaError
from gaga_core.io.cameras.given import (
    MOST_BYTES,
    OPENGL,
    GivenPose,
    GivenPoses,
    Lens,
    Photos,
    brown_lens,
    cam_from,
    cam_from_opengl,
    checked,
    file_near,
    numbers,
    read_xml,
    rigid,
)
from gaga_core.io.json_file import PathText, read_bytes, read_foreign_json

_Number = Annotated[float, msgspec.Meta(ge=-1e18, le=1e18)]
_MAP_UP = (0.0, 0.0, 1.0)  # of worlds in map coordinates
_FILM = 36.0  # millimetres: the longer side of a 35 mm negative
_EARTH = 6e6  # metres: places on the ground are farther from its middle
_K4 = "The lens has k4, which is left out."
_XCR = "{http://www.capturingreality.com/ns/xcr/1.1#}"


def text_of(path: Path) -> str:
    """The text of a file of poses, as far as it is any."""
    return read_bytes(path, "Export it again.", MOST_BYTES).decode("utf-8-sig", errors="replace")


# --- RealityScan and RealityCapture


def read_realityscan_csv(path: Path, photos: Photos) -> GivenPoses:
    """Poses of "Internal/External camera parameters": angles in degrees as of aerial photos.

    ``f`` is in millimetres of a 35 mm negative, ``px`` and ``py`` are shares of the longer side
    from the middle, as the program's own template has them.
    """
    rows = list(csv.reader(line for line in text_of(path).splitlines() if line.strip()))
    head = next((i for i, row in enumerate(rows) if row[0].strip().lower() == "#name"), None)
    if head is None:
        raise GagaError(f"{path} has no line that begins with #name. Export it again.")
    names = [column.strip().lower().removesuffix("_35mm") for column in rows[head]]
    names = [name.removesuffix("_norm") for name in names]
    if missing := {"x", "y", "alt", "heading", "pitch", "roll"} - set(names):
        raise GagaError(
            f"{path} has no column {', '.join(sorted(missing))}. Export Internal/External camera "
            "parameters."
        )
    poses, notes = [], set()
    for row in rows[head + 1 :]:
        name = photos.find(row[0].strip())
        if name is None:
            continue
        values = numbers(" ".join(row[1:]), len(names) - 1, f"{path}, {row[0]}")
        of = dict(zip(names[1:], values, strict=True))
        turn = turned_z(-of["heading"]) @ turned_x(of["pitch"]) @ turned_y(of["roll"])
        pose = cam_from_opengl(rigid(turn, np.array([of["x"], of["y"], of["alt"]])))
        k, t = [of.get(f"k{i}", 0.0) for i in (1, 2, 3, 4)], (of.get("t1", 0.0), of.get("t2", 0.0))
        lens = None
        if of.get("f", 0.0) > 0:
            centre = of.get("px", 0.0), of.get("py", 0.0)
            lens = _film_lens(photos.size(name), of["f"], centre, k, t)
        notes |= {_K4} if k[3] else set()
        poses.append(GivenPose(name, lens, pose))
    found = GivenPoses("RealityScan", path, tuple(poses), False, _MAP_UP, notes=tuple(notes))
    return checked(found, photos)


def read_realityscan_xmp(folder: Path, photos: Photos) -> GivenPoses:
    """Poses of the XMP files next to the photos; those without a pose are passed over."""
    poses, notes = [], set()
    for file in sorted(folder.glob("*.xmp")):
        if (name := photos.find(file.stem)) is None:
            continue
        entry = next((e for e in read_xml(file).iter() if _xcr(e, "FocalLength35mm")), None)
        rotation, position = (_xcr(entry, key) for key in ("Rotation", "Position"))
        if entry is None or not rotation or not position:
            continue
        turn = np.array(numbers(rotation, 9, f"{file}, Rotation")).reshape(3, 3)
        place = np.array(numbers(position, 3, f"{file}, Position"))
        bent = _xcr(entry, "DistortionCoeficients") or "0 0 0 0 0 0"
        k1, k2, k3, k4, t1, t2 = numbers(bent, 6, f"{file}, DistortionCoeficients")
        focal = numbers(_xcr(entry, "FocalLength35mm"), 1, f"{file}, FocalLength35mm")[0]
        u, v = (
            numbers(_xcr(entry, f"PrincipalPoint{axis}") or "0", 1, f"{file}, PrincipalPoint")[0]
            for axis in "UV"
        )
        lens = _film_lens(photos.size(name), focal, (u, v), [k1, k2, k3], (t1, t2))
        notes |= {_K4} if k4 else set()
        poses.append(GivenPose(name, lens, rigid(turn, -turn @ place)))
    found = GivenPoses("RealityScan", folder, tuple(poses), False, _MAP_UP, notes=tuple(notes))
    return checked(found, photos)


def _xcr(entry: Element | None, key: str) -> str | None:
    """A value of RealityScan's XMP: an attribute, or an element."""
    if entry is None:
        return None
    return entry.get(_XCR + key) or entry.findtext(_XCR + key)


def _film_lens(
    size: tuple[int, int],
    millimetres: float,
    centre: tuple[float, float],  # shares of the longer side
    radial: list[float],
    tangential: tuple[float, float],
) -> Lens:
    side = max(size)
    focal = millimetres / _FILM * side
    middle = size[0] / 2 + centre[0] * side, size[1] / 2 + centre[1] * side
    # Its t1 and t2 stand the other way round than OpenCV's p1 and p2.
    return brown_lens(size, (focal, focal), middle, radial[:3], tangential[::-1])


def turned_x(degrees: float) -> DoubleArray:
    """Rotation (3, 3) around x."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def turned_y(degrees: float) -> DoubleArray:
    """Rotation (3, 3) around y."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def turned_z(degrees: float) -> DoubleArray:
    """Rotation (3, 3) around z."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


# --- Bundler


def read_bundler(path: Path, photos: Photos) -> GivenPoses:
    """Poses of a bundle.out; the photos are those of list.txt next to it, in its order."""
    words = text_of(path).split("\n", 1)[-1].split()
    if len(words) < 2 or not words[0].isdigit():
        raise GagaError(f"{path} is damaged: it does not say how many cameras it has.")
    n = int(words[0])
    lists = [p for p in (path.with_name("list.txt"), path.with_suffix(".txt")) if p.is_file()]
    lists += sorted(path.parent.glob("*list*.txt"))
    if not lists:
        raise GagaError(f"{path} does not name its photos. Put list.txt next to it.")
    names = [line.split()[0] for line in text_of(lists[0]).splitlines() if line.strip()]
    if len(names) != n:
        raise GagaError(f"{path} has {n} cameras, but {lists[0].name} names {len(names)} photos.")
    poses = []
    for i, said in enumerate(names):
        where = f"{path}, camera {i} ({said})"
        values = np.array(numbers(" ".join(words[2 + 15 * i : 17 + 15 * i]), 15, where))
        focal, k1, k2 = values[:3].tolist()
        if focal == 0 or (name := photos.find(said)) is None:  # 0: it was not placed
            continue
        width, height = photos.size(name)
        lens = Lens("RADIAL", width, height, (focal, width / 2, height / 2, k1, k2))
        pose = OPENGL @ rigid(values[3:12].reshape(3, 3), values[12:])
        poses.append(GivenPose(name, lens, pose))
    return checked(GivenPoses("Bundler", path, tuple(poses)), photos)


# --- Metashape


def read_metashape(path: Path, photos: Photos) -> GivenPoses:
    """Poses of *Export Cameras* (XML) in the coordinates of the chunk's transform.

    That is in metres where the chunk was scaled by references. Raises ``GagaError`` for lenses
    that are no frame and no fisheye.
    """
    root = read_xml(path)
    chunks = [c for c in root.iter("chunk") if c.find("cameras") is not None]
    if len(chunks) != 1:
        raise GagaError(f"{path} has {len(chunks)} chunks with cameras. Export one chunk.")
    chunk, notes = chunks[0], set[str]()
    sensors = {e.get("id"): e for e in chunk.iter("sensor")}
    of_chunk = chunk.find("transform")
    of_parts = {e.get("id"): e.find("transform") for e in chunk.iter("component")}
    scaled = False
    poses: list[GivenPose] = []
    lenses: dict[str | None, Lens | None] = {}
    for camera in chunk.iter("camera"):
        where = f"{path}, camera {camera.get('label')}"
        if camera.findtext("transform") is None or camera.get("enabled") in ("0", "false"):
            continue
        if (name := photos.find(camera.get("label") or "")) is None:
            continue
        pose = np.array(numbers(camera.findtext("transform"), 16, where)).reshape(4, 4)
        own = of_parts.get(camera.get("component_id")) if of_chunk is None else of_chunk
        world, is_scaled = _world_of(own, path)
        scaled |= is_scaled
        moved = world @ pose
        moved[:3, :3] /= np.cbrt(np.linalg.det(moved[:3, :3]))
        key = camera.get("sensor_id")
        if key not in lenses:
            lenses[key] = _metashape_lens(sensors.get(key), path, notes)
        poses.append(GivenPose(name, lenses[key], cam_from(moved)))
    up = _metashape_up(poses) if scaled else None
    return checked(
        GivenPoses("Metashape", path, tuple(poses), scaled, up, notes=tuple(sorted(notes))), photos
    )


def _metashape_up(poses: list[GivenPose]) -> tuple[float, float, float]:
    """z of a local world; in earth-centred coordinates the way from the middle of the earth."""
    places = [np.linalg.inv(pose.cam_from_world)[:3, 3] for pose in poses] or [np.zeros(3)]
    middle = np.median(places, axis=0)
    if np.linalg.norm(middle) < _EARTH:
        return _MAP_UP
    x, y, z = (middle / np.linalg.norm(middle)).tolist()
    return x, y, z


def _world_of(transform: Element | None, path: Path) -> tuple[DoubleArray, bool]:
    """The similarity (4, 4) from a chunk to its world, and whether there is one with a scale."""
    world = np.eye(4)
    if transform is None or transform.findtext("rotation") is None:
        return world, False
    scale = numbers(transform.findtext("scale") or "1", 1, f"{path}, scale")[0]
    turn = np.array(numbers(transform.findtext("rotation"), 9, f"{path}, rotation"))
    place = transform.findtext("translation") or "0 0 0"
    world[:3, :3] = scale * turn.reshape(3, 3)
    world[:3, 3] = numbers(place, 3, f"{path}, translation")
    if not scale > 0:
        raise GagaError(f"{path}: the scale of the chunk is not positive. Export it again.")
    return world, transform.findtext("scale") is not None


def _metashape_lens(sensor: Element | None, path: Path, notes: set[str]) -> Lens | None:
    if sensor is None:
        return None
    kind = sensor.get("type", "frame")
    if kind not in ("frame", "fisheye", "equidistant_fisheye"):
        raise GagaError(f"{path}: the sensor {sensor.get('label')} is {kind}, which is not read.")
    size, found = sensor.find("resolution"), list(sensor.iter("calibration"))
    adjusted = [c for c in found if c.get("class") == "adjusted"] or found
    if size is None or not adjusted:
        return None
    width, height = (
        int(numbers(size.get(key), 1, f"{path}, resolution")[0]) for key in ("width", "height")
    )
    of = {
        e.tag: numbers(e.text, 1, f"{path}, {e.tag}")[0]
        for e in adjusted[-1]
        if e.tag in ("f", "fx", "fy", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2")
    }
    focal = of.get("f", of.get("fy", 0.0))
    fx = of.get("fx", focal + of.get("b1", 0.0))
    centre = width / 2 + of.get("cx", 0.0), height / 2 + of.get("cy", 0.0)
    k = [of.get(f"k{i}", 0.0) for i in (1, 2, 3, 4)]
    notes |= {"The lens is skewed (b2), which is left out."} if of.get("b2") else set()
    if "fisheye" in kind:
        notes |= {"p1 and p2 of the fisheye are left out."} if of.get("p1") else set()
        return Lens("OPENCV_FISHEYE", width, height, (fx, focal, *centre, *k))
    notes |= {_K4} if k[3] else set()
    # Its p1 and p2 stand the other way round than OpenCV's.
    tangential = of.get("p2", 0.0), of.get("p1", 0.0)
    return brown_lens((width, height), (fx, focal), centre, k[:3], tangential)


# --- Pix4D


_PIX4D = re.compile(r"^(?P<name>\S.*?)\s+(?P<w>\d+)\s+(?P<h>\d+)\s*$")


def read_pix4d(path: Path, photos: Photos) -> GivenPoses:
    """Poses of NAME_calibrated_camera_parameters.txt: metres from the project's offset, z up."""
    lines = [line.strip() for line in text_of(path).splitlines() if line.strip()]
    poses: list[GivenPose] = []
    i = 0
    while i < len(lines):
        found = _PIX4D.match(lines[i])
        i += 1
        if found is None or found["name"].replace(".", "").replace("-", "").isdigit():
            continue
        where = f"{path}, {found['name']}"
        rows = [numbers(line, n, where) for line, n in zip(lines[i:], _PIX4D_ROWS, strict=False)]
        if len(rows) < len(_PIX4D_ROWS):
            raise GagaError(f"{where}: the file ends in the middle of a camera. Export it again.")
        i += len(rows)
        if (name := photos.find(found["name"])) is None:
            continue
        K, turn, place = np.array(rows[:3]), np.array(rows[6:9]), np.array(rows[5])
        t1, t2 = rows[4]
        # Pix4D's T1 goes with 2xy in x, as OpenCV's p1 does.
        focal, centre = (K[0, 0], K[1, 1]), (K[0, 2], K[1, 2])
        lens = brown_lens((int(found["w"]), int(found["h"])), focal, centre, rows[3], (t1, t2))
        poses.append(GivenPose(name, lens, rigid(turn, -turn @ place)))
    return checked(GivenPoses("Pix4D", path, tuple(poses), True, _MAP_UP), photos)


_PIX4D_ROWS = (3, 3, 3, 3, 2, 3, 3, 3, 3)  # numbers of each line of a camera


def read_p4d(path: Path, photos: Photos) -> GivenPoses:
    """Poses of a Pix4D project: those of its calibrated camera parameters.

    The .p4d itself holds none. Raises ``GagaError`` when they are not where Pix4D writes them.
    """
    stem = path.stem
    name = f"{stem}_calibrated_camera_parameters.txt"
    for folder in (path.parent / stem / "1_initial" / "params", path.parent / stem, path.parent):
        if (folder / name).is_file():
            return read_pix4d(folder / name, photos)
    raise GagaError(
        f"{path} holds no calibrated cameras. Put {name} next to it, which Pix4D writes to "
        f"{stem}/1_initial/params."
    )


# --- OPF, the open photogrammetry format


class _Resource(msgspec.Struct, frozen=True):
    uri: PathText
    format: str = ""


class _Item(msgspec.Struct, frozen=True):
    type: str = ""
    resources: list[_Resource] = []


class _Project(msgspec.Struct, frozen=True):
    items: list[_Item] = []


class _Internals(msgspec.Struct, frozen=True):
    type: str
    principal_point_px: tuple[_Number, _Number]
    focal_length_px: _Number = 0.0
    radial_distortion: tuple[_Number, _Number, _Number] = (0.0, 0.0, 0.0)
    tangential_distortion: tuple[_Number, _Number] = (0.0, 0.0)


class _Sensor(msgspec.Struct, frozen=True):
    id: int | str
    internals: _Internals


class _OpfCamera(msgspec.Struct, frozen=True):
    id: int | str
    sensor_id: int | str
    orientation_deg: tuple[_Number, _Number, _Number]
    position: tuple[_Number, _Number, _Number]


class _Calibrated(msgspec.Struct, frozen=True):
    sensors: list[_Sensor]
    cameras: list[_OpfCamera]


class _Listed(msgspec.Struct, frozen=True):
    id: int | str
    uri: PathText


class _CameraList(msgspec.Struct, frozen=True):
    cameras: list[_Listed]


def read_opf(path: Path, photos: Photos) -> GivenPoses:
    """Poses of the calibrated cameras of a project.opf: angles omega, phi, kappa, metres, z up."""
    project = read_foreign_json(path, _Project)
    resources = [r for item in project.items for r in item.resources]
    files: Mapping[str, Path | None] = {
        kind: next((file_near(path, r.uri) for r in resources if kind in r.format), None)
        for kind in ("calibrated-cameras", "camera-list")
    }
    for kind, file in files.items():
        if file is None:
            raise GagaError(f"{path} names no file of {kind}, or it is not there. Export it again.")
    calibrated_file, list_file = files["calibrated-cameras"], files["camera-list"]
    assert calibrated_file is not None
    assert list_file is not None
    calibrated = read_foreign_json(calibrated_file, _Calibrated, most_bytes=MOST_BYTES)
    listed = read_foreign_json(list_file, _CameraList, most_bytes=MOST_BYTES)
    uris = {camera.id: camera.uri for camera in listed.cameras}
    sensors = {sensor.id: sensor.internals for sensor in calibrated.sensors}
    poses = []
    for camera in calibrated.cameras:
        if camera.id not in uris or camera.sensor_id not in sensors:
            raise GagaError(f"{path}: camera {camera.id} has no photo or no sensor. Export again.")
        if (name := photos.find(uris[camera.id])) is None:
            continue
        inside = sensors[camera.sensor_id]
        if inside.type != "perspective":
            raise GagaError(f"{path}: the lens of {name} is {inside.type}, which is not read.")
        omega, phi, kappa = camera.orientation_deg
        turn = turned_x(omega) @ turned_y(phi) @ turned_z(kappa)
        focal = inside.focal_length_px
        radial, tangential = inside.radial_distortion, inside.tangential_distortion
        centre = inside.principal_point_px
        lens = brown_lens(photos.size(name), (focal, focal), centre, radial, tangential)
        pose = cam_from_opengl(rigid(turn, np.array(camera.position)))
        poses.append(GivenPose(name, lens, pose))
    return checked(GivenPoses("OPF", path, tuple(poses), True, _MAP_UP), photos)
