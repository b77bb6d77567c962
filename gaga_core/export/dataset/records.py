"""One picture of a data set and its labels: drawn, written, and read again."""

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from isal import isal_zlib

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray, UInt16Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.export.dataset import label_kernels as kernels
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write
from gaga_core.io.images import write_rgb
from gaga_core.io.json_file import read_json
from gaga_core.raster.cpu.rasterizer import CpuRasterizer, Labelled, Outlines

Split = Literal["train", "val"]
SPLITS: tuple[Split, ...] = ("train", "val")
RECORD_VERSION = 2  # raise it when pictures or labels change: older ones are made again
VOID_BELOW = 0.3  # summed weight under which a pixel shows no group, as in group maps
_DEEPEST = 65_535  # of a 16-bit picture
_QUALITY = 95  # of JPEG
_FAST = 1  # level of compression: a depth takes 1.2 ms (zlib 4.0) and less room
_UP = 2  # PNG's filter of rows that are differences to the one above
_CURE = "Remove it, and run the command again."
_MOST_DIGITS = 7  # characters of a count of a picture of 65,536 x 65,536
_SMALL = 10  # pixels: of an object that would be smaller than this alone nothing is written

Box = tuple[int, int, int, int]  # x, y, width, height


class Shown(msgspec.Struct, frozen=True):
    """One object in one picture."""

    group: int
    area: int  # pixels that show it
    box: Box  # of these; zeros when it is hidden
    counts: str  # of these, COCO's compressed run lengths
    whole_area: int  # pixels that would show it if nothing stood before it
    whole_box: Box
    whole_counts: str
    cam_from_object: list[float]  # (4, 4) by rows, scene units

    @property
    def visible_share(self) -> float:
        """Share of the object's pixels in the picture that are seen, 0..1."""
        return self.area / max(self.whole_area, 1)


class Record(msgspec.Struct, frozen=True):
    """One picture; its files are ``images``, ``ids`` and ``depth`` / split / name."""

    version: int
    key: str  # digest of all that decides the picture but which splats an object has
    digests: dict[str, str]  # by group that is seen or would be: which splats it had
    name: str
    scene: str
    placement: str
    split: Split
    width: int
    height: int
    K: list[float]  # (3, 3) by rows
    cam_from_world: list[float]  # (4, 4) by rows
    depth_scale: float  # scene units of 1 in the depth picture
    coverage: float  # share of the picture that photos showed
    light: list[float]  # (3, 4) by rows: the colors' affine map
    objects: list[Shown]
    is_left_out: bool = False  # photos do not cover it: it has no files

    @property
    def camera(self) -> Camera:
        """The picture's camera."""
        K, pose = np.array(self.K).reshape(3, 3), np.array(self.cam_from_world).reshape(4, 4)
        return Camera(K, pose, self.width, self.height, self.name)

    def file(self, kind: str) -> str:
        """Path of one of its files in the data set: of images, ids or depth."""
        return f"{kind}/{self.split}/{self.name}.{'jpg' if kind == 'images' else 'png'}"


def record_path(root: Path, name: str) -> Path:
    """Where the record of a picture lies."""
    return root / "records" / f"{name}.json"


def read_record(root: Path, name: str) -> Record | None:
    """The record of a picture; None where there is none of this version that can be read."""
    try:
        found = read_json(record_path(root, name), Record, _CURE)
    except GagaError:
        return None
    kinds = () if found.is_left_out else ("images", "ids", "depth")
    is_whole = all((root / found.file(kind)).is_file() for kind in kinds)
    return found if found.version == RECORD_VERSION and found.name == name and is_whole else None


def draw(
    engine: CpuRasterizer,
    gaussians: Gaussians,
    camera: Camera,
    labels: IntArray,  # (N,)
    objects: IntArray,  # (G,) ascending: those whose whole outline is wanted
    background: FloatArray,  # (3,)
) -> Labelled:
    """Draw color, depth, visible ids and whole outlines."""
    return engine.labelled(gaussians, camera, labels, objects, VOID_BELOW, background)


def shown_objects(drawn: Outlines, poses: Mapping[int, DoubleArray], camera: Camera) -> list[Shown]:
    """The objects of a picture by id; ``poses``: world_from_object (4, 4) of each."""
    n, (height, width) = len(drawn.objects), drawn.labels.shape
    empty = np.tile(np.array([0, height, width, 0, 0], np.int64), (n, 1))
    seen, whole = empty.copy(), empty
    rows = np.full(int(max(drawn.labels.max(initial=0), drawn.objects.max(initial=0))) + 1, -1)
    rows[drawn.objects] = np.arange(n)
    # Down the columns, as run lengths go: a run ends where anything changes.
    labels = np.ascontiguousarray(drawn.labels.T)
    bits = np.ascontiguousarray(drawn.bits.transpose(1, 0, 2))
    changes = np.ones((width, height), np.bool_)
    changes[:, 1:] = labels[:, 1:] != labels[:, :-1]
    for word in range(bits.shape[2]):
        changes[:, 1:] |= bits[:, 1:, word] != bits[:, :-1, word]
    at = np.flatnonzero(changes)
    starts = np.append(at, height * width)
    runs = (starts, labels.ravel()[at], bits.reshape(-1, bits.shape[2])[at])
    kernels.tally_objects(*runs, height, rows.astype(np.int32), seen, whole)
    text = np.empty(_MOST_DIGITS * (height * width + 2), np.uint8)

    def counts(label: int, k: int, box: LongArray) -> str:
        columns = box[[2, 4]] if box[0] else np.zeros(2, np.int64)
        first, last = np.searchsorted(starts, columns * height).tolist()
        n_characters = kernels.run_lengths(*runs, label, k, first, last, text)
        return text[:n_characters].tobytes().decode("ascii")

    found = []
    for k, group in enumerate(drawn.objects.tolist()):
        if whole[k, 0] >= _SMALL:
            found.append(
                Shown(
                    group=group,
                    area=int(seen[k, 0]),
                    box=_box(seen[k]),
                    counts=counts(group, k, seen[k]),
                    whole_area=int(whole[k, 0]),
                    whole_box=_box(whole[k]),
                    whole_counts=counts(-1, k, whole[k]),
                    cam_from_object=(camera.cam_from_world @ poses[group]).ravel().tolist(),
                )
            )
    return found


def _box(tally: LongArray) -> Box:
    area, top, left, bottom, right = tally.tolist()
    return (left, top, right - left, bottom - top) if area else (0, 0, 0, 0)


def write_picture(root: Path, record: Record, drawn: Labelled | None) -> None:
    """Write the picture's files, and its record at last: a picture without one is made again."""
    if drawn is not None:
        _write_files(root, record, drawn)
    with atomic_write(record_path(root, record.name)) as temporary:
        temporary.write_bytes(msgspec.json.encode(record))


def _write_files(root: Path, record: Record, drawn: Labelled) -> None:
    image = lit(drawn.image, np.array(record.light).reshape(3, 4))
    write_rgb(root / record.file("images"), image, _QUALITY)
    ids = drawn.outlines.labels
    if ids.max(initial=0) > _DEEPEST:
        raise GagaError("Ids of objects above 65,535 do not fit into pictures of ids.")
    deep = np.rint(drawn.median_depth / np.float32(record.depth_scale))
    for kind, values in (("ids", ids), ("depth", np.minimum(deep, _DEEPEST))):
        with atomic_write(root / record.file(kind)) as temporary:
            temporary.write_bytes(_gray_png(values.astype(np.uint16), is_smooth=kind == "depth"))


def lit(image: FloatArray, light: DoubleArray) -> FloatArray:
    """A picture (H, W, 3) in another light: the colors' affine map (3, 4)."""
    image = np.clip(image, 0, 1)
    if np.array_equal(light, np.eye(3, 4)):
        return image
    return image @ light[:, :3].T.astype(np.float32) + light[:, 3].astype(np.float32)


def _gray_png(values: UInt16Array, *, is_smooth: bool) -> bytes:
    """A 16-bit PNG of ``values`` (H, W), rows as they are, or ``is_smooth`` as differences to the
    row above: a depth then has runs of equal bytes. Pillow tries five filters of each row."""
    height, width = values.shape
    rows = np.zeros((height, 1 + 2 * width), np.uint8)
    rows[:, 1:] = values.astype(">u2").view(np.uint8)
    if is_smooth:
        rows[1:, 1:] = rows[1:, 1:] - rows[:-1, 1:]
        rows[1:, 0] = _UP

    def chunk(kind: bytes, data: bytes) -> bytes:
        check = isal_zlib.crc32(kind + data)
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", check)

    head = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    body = chunk(b"IDAT", isal_zlib.compress(rows.tobytes(), _FAST))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + body + chunk(b"IEND", b"")


def depth_scale(drawn: Labelled) -> float:
    """Scene units of 1 in a 16-bit picture of the depth: it ends at the deepest pixel."""
    deepest = float(drawn.median_depth.max(initial=0))
    return deepest / _DEEPEST if deepest > 0 else 1.0


def object_poses(
    centres: Mapping[int, DoubleArray], motions: Mapping[int, DoubleArray]
) -> dict[int, DoubleArray]:
    """world_from_object (4, 4) by group: its frame has the world's axes where it stood."""
    poses = {}
    for group, centre in centres.items():
        own = np.eye(4)
        own[:3, 3] = centre
        poses[group] = motions.get(group, np.eye(4)) @ own
    return poses
