"""One picture of a data set and its labels: drawn, written, and read again."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from PIL import Image

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, UInt64Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write
from gaga_core.io.images import write_rgb
from gaga_core.io.json_file import read_json
from gaga_core.io.masks.coco import compress_counts
from gaga_core.raster.base import Frame, Rasterizer
from gaga_core.raster.cpu.rasterizer import CpuRasterizer, Outlines

Split = Literal["train", "val"]
SPLITS: tuple[Split, ...] = ("train", "val")
RECORD_VERSION = 1  # raise it when pictures or labels change: older ones are made again
VOID_BELOW = 0.3  # summed weight under which a pixel shows no group, as in group maps
_DEEPEST = 65_535  # of a 16-bit picture
_QUALITY = 95  # of JPEG
_FAST = 1  # compression of PNG: a depth takes a tenth of the time of the usual one
_CURE = "Remove it, and run the command again."
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


@dataclass(frozen=True, eq=False)
class Drawn:
    """A picture with its labels, before it is written."""

    frame: Frame
    outlines: Outlines


def draw(
    rasterizer: Rasterizer,
    gaussians: Gaussians,
    camera: Camera,
    labels: IntArray,  # (N,)
    objects: IntArray,  # (G,) ascending: those whose whole outline is wanted
    background: FloatArray,  # (3,)
) -> Drawn:
    """Draw color, depth, visible ids and whole outlines."""
    frame = rasterizer.render(gaussians, camera, background=background)
    engine = rasterizer if isinstance(rasterizer, CpuRasterizer) else CpuRasterizer()
    return Drawn(frame, engine.outlines(gaussians, camera, labels, objects, VOID_BELOW))


def shown_objects(drawn: Outlines, poses: Mapping[int, DoubleArray], camera: Camera) -> list[Shown]:
    """The objects of a picture by id; ``poses``: world_from_object (4, 4) of each."""
    found = []
    seen_at = _windows(drawn.labels)
    for k, group in enumerate(drawn.objects.tolist()):
        window = _window_of(drawn.bits, k)
        if window is None:
            continue
        rows, columns = window
        whole = drawn.bits[rows, columns, k // 64] >> np.uint64(k % 64) & np.uint64(1) > 0
        whole_area = int(np.count_nonzero(whole))
        if whole_area < _SMALL:
            continue
        seen = np.zeros_like(whole)
        if group in seen_at:
            seen = drawn.labels[rows, columns] == group
        shape, corner = drawn.labels.shape, (rows.start, columns.start)
        found.append(
            Shown(
                group=group,
                area=int(np.count_nonzero(seen)),
                box=_box(seen, corner),
                counts=compress_counts(window_counts(seen, corner, shape)),
                whole_area=whole_area,
                whole_box=_box(whole, corner),
                whole_counts=compress_counts(window_counts(whole, corner, shape)),
                cam_from_object=(camera.cam_from_world @ poses[group]).ravel().tolist(),
            )
        )
    return found


def _windows(labels: IntArray) -> set[int]:
    """Ids that are seen."""
    return set(np.flatnonzero(np.bincount(labels.ravel())).tolist())


def _window_of(bits: UInt64Array, k: int) -> tuple[slice, slice] | None:
    """Rows and columns of object k; None where it is not."""
    mask = bits[:, :, k // 64] & (np.uint64(1) << np.uint64(k % 64))
    rows = np.flatnonzero(np.bitwise_or.reduce(mask, axis=1))
    if len(rows) == 0:
        return None
    top, bottom = int(rows[0]), int(rows[-1]) + 1
    columns = np.flatnonzero(np.bitwise_or.reduce(mask[top:bottom], axis=0))
    return slice(top, bottom), slice(int(columns[0]), int(columns[-1]) + 1)


def _box(mask: BoolArray, corner: tuple[int, int]) -> Box:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return 0, 0, 0, 0
    y, x = int(rows[0]), int(columns[0])
    return corner[1] + x, corner[0] + y, int(columns[-1]) - x + 1, int(rows[-1]) - y + 1


def window_counts(mask: BoolArray, corner: tuple[int, int], shape: tuple[int, ...]) -> list[int]:
    """`coco.encode_rle` of a picture of ``shape`` that is empty but for ``mask`` at ``corner``."""
    height, width = mask.shape
    padded = np.zeros((width, height + 1), np.int8)  # a column of the picture ends a run
    padded[:, :height] = mask.T
    flat = padded.ravel()
    at = np.flatnonzero(np.diff(flat, prepend=np.int8(0)))
    column, row = at // (height + 1), at % (height + 1)
    edges = (corner[1] + column) * shape[0] + corner[0] + row
    if height == shape[0]:  # runs that go on at the top of the next column are one
        starts, ends = edges[0::2], edges[1::2]
        cut = np.flatnonzero(ends[:-1] == starts[1:])
        edges = np.stack([np.delete(starts, cut + 1), np.delete(ends, cut)], axis=1).ravel()
    total = shape[0] * shape[1]
    counts: list[int] = np.diff(edges, prepend=0).tolist()
    last = total - (int(edges[-1]) if len(edges) else 0)
    return [*counts, last] if last or not counts else counts


def write_picture(root: Path, record: Record, drawn: Drawn | None) -> None:
    """Write the picture's files, and its record at last: a picture without one is made again."""
    if drawn is not None:
        _write_files(root, record, drawn)
    with atomic_write(record_path(root, record.name)) as temporary:
        temporary.write_bytes(msgspec.json.encode(record))


def _write_files(root: Path, record: Record, drawn: Drawn) -> None:
    image, light = np.clip(drawn.frame.image, 0, 1), np.array(record.light, np.float32)
    if not np.array_equal(light, np.eye(3, 4).ravel()):
        image = image @ light.reshape(3, 4)[:, :3].T + light.reshape(3, 4)[:, 3]
    write_rgb(root / record.file("images"), image, _QUALITY)
    ids = drawn.outlines.labels
    if ids.max(initial=0) > _DEEPEST:
        raise GagaError("Ids of objects above 65,535 do not fit into pictures of ids.")
    deep = np.rint(drawn.frame.median_depth / np.float32(record.depth_scale))
    for kind, values in (("ids", ids), ("depth", np.minimum(deep, _DEEPEST))):
        with atomic_write(root / record.file(kind)) as temporary:
            picture = Image.fromarray(values.astype(np.uint16))
            picture.save(temporary, format="PNG", compress_level=_FAST)


def depth_scale(frame: Frame) -> float:
    """Scene units of 1 in a 16-bit picture of the depth: it ends at the deepest pixel."""
    deepest = float(frame.median_depth.max(initial=0))
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
