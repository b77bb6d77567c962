"""Records of pictures as COCO, YOLO and BOP, with ids that never change."""

import json
import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import msgspec
import numpy as np
from PIL import Image
from plyfile import PlyData, PlyElement

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.errors import GagaError
from gaga_core.export.dataset.records import SPLITS, Record, Shown, Split, read_record
from gaga_core.export.dataset.settings import Form
from gaga_core.io.files import atomic_write
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.json_file import read_json
from gaga_core.io.masks.coco import decode_rle
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.io.meshes import TriangleMesh
from gaga_core.progress import Progress, Stage, part

DATASET_FILE = "dataset.json"
DATASET_VERSION = 1
_RGB = ("red", "green", "blue")
_HEAD = 400  # bytes in which the note of a model lies
_MM = 1000.0  # millimetres of a metre: BOP's unit
_CURE = "Remove the folder, and run the command again."
_STAGE = "Write the labels"
OURS: Mapping[Form, tuple[str, ...]] = {
    "coco": tuple(f"instances_{split}.json" for split in SPLITS),
    "yolo": ("labels", "data.yaml"),
    "bop": ("bop",),
}


class SceneObject(msgspec.Struct, frozen=True):
    """One object of one scene."""

    group: int
    name: str
    centre: list[float]  # (3,) origin of its frame, world
    lo: list[float]  # (3,) its box in its own frame
    hi: list[float]


class SceneSet(msgspec.Struct, frozen=True):
    """The pictures of one scene: scenes/<scene>.json."""

    scene: str
    source: str
    is_metric: bool
    names: list[str]  # of its pictures
    made: int  # by the last run
    left_out: int  # views that were not taken: photos do not cover them
    objects: list[SceneObject]
    notes: list[str] = []


class ClassRow(msgspec.Struct, frozen=True):
    """A class."""

    id: int  # from 1
    name: str


class ObjectRow(msgspec.Struct, frozen=True):
    """An object of a scene, whatever it is called: one row for ever."""

    id: int  # from 1
    scene: str
    group: int
    class_id: int


class DatasetFile(msgspec.Struct, frozen=True):
    """dataset.json."""

    version: int
    classes: list[ClassRow]
    objects: list[ObjectRow]
    pictures: dict[str, int] = {}  # by split
    scenes: list[str] = []
    settings: dict[str, object] = {}


def read_dataset_file(root: Path) -> DatasetFile:
    """The tables of a data set; empty ones where there is none yet."""
    if not (root / DATASET_FILE).is_file():
        return DatasetFile(DATASET_VERSION, [], [])
    found = read_json(root / DATASET_FILE, DatasetFile, _CURE)
    if found.version > DATASET_VERSION:
        raise GagaError(
            f"{root / DATASET_FILE} was written by a newer version. Update gaga-studio."
        )
    return found


def tables(before: DatasetFile, scenes: Sequence[SceneSet]) -> DatasetFile:
    """Ids of classes and objects: those that there were, and new ones after them.

    A class whose objects were all renamed alike is renamed, and keeps its id.
    """
    names = {(s.scene, o.group): o.name for s in scenes for o in s.objects}
    here = {s.scene for s in scenes}
    classes = {row.id: row.name for row in before.classes}
    objects = {(row.scene, row.group): row for row in before.objects}
    called: dict[int, set[str | None]] = {}
    for key, row in objects.items():
        # An object of a scene that is not of this run keeps its class; one that is gone has none.
        name = names.get(key) if row.scene in here else classes[row.class_id]
        if name is not None:
            called.setdefault(row.class_id, set()).add(name)
    used = set(names.values())
    for class_id, now in called.items():
        if len(now) == 1 and classes[class_id] not in used:
            (name,) = now
            if name is not None and name not in classes.values():
                classes[class_id] = name
    number = {name: class_id for class_id, name in classes.items()}
    for key, name in names.items():
        if name not in number:
            number[name] = len(classes) + 1
            classes[number[name]] = name
        old = objects.get(key)
        objects[key] = ObjectRow(old.id if old else len(objects) + 1, *key, number[name])
    rows = sorted(objects.values(), key=lambda row: row.id)
    return DatasetFile(DATASET_VERSION, [ClassRow(k, classes[k]) for k in sorted(classes)], rows)


@dataclass(frozen=True, eq=False)
class Source:
    """All that the formats are written from: the records are read one by one."""

    root: Path
    scenes: Sequence[SceneSet]
    tables: DatasetFile

    def records(self, split: Split | None = None) -> Iterator[Record]:
        """The records, scene by scene; of one split only."""
        for scene in self.scenes:
            for name in scene.names:
                record = read_record(self.root, name)
                if record is None:
                    raise GagaError(f"The labels of {name} are gone. Run the command again.")
                if split is None or record.split == split:
                    yield record

    def __len__(self) -> int:
        return sum(len(scene.names) for scene in self.scenes)

    def row_of(self) -> dict[tuple[str, int], ObjectRow]:
        """Rows of objects by scene and group."""
        return {(row.scene, row.group): row for row in self.tables.objects}


def write_forms_stage(source: Source, forms: Sequence[Form]) -> Stage[None]:
    """Write the formats, each whole or not at all; those that are not asked for are removed."""
    writers: dict[Form, Callable[[Source, Path], Stage[None]]] = {
        "coco": _coco_stage,
        "yolo": _yolo_stage,
        "bop": _bop_stage,
    }
    for i, (form, names) in enumerate(OURS.items()):
        if form in forms:
            with staging_folder(source.root) as staging:
                stage = writers[form](source, staging)
                yield from part(stage, i, len(OURS), _STAGE)
                publish_all(staging, sorted(path.name for path in staging.iterdir()), source.root)
            continue
        for name in names:
            path = source.root / name
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)


# --- COCO


def _coco_stage(source: Source, staging: Path) -> Stage[None]:
    """instances_<split>.json, written as it is read: pictures first, then annotations."""
    row_of, done = source.row_of(), 0
    for split in SPLITS:
        ids = dict[str, int]()
        with (staging / f"instances_{split}.json").open("w", encoding="utf-8") as file:
            file.write('{"info": {"description": "New views of 3D scenes", "version": "1.0"},\n')
            categories = [
                {"id": row.id, "name": row.name, "supercategory": "object"}
                for row in source.tables.classes
            ]
            file.write(f'"categories": {json.dumps(categories, ensure_ascii=False)},\n"images": [')
            for record in source.records(split):
                ids[record.name] = len(ids) + 1
                _append(file, len(ids) == 1, _coco_image(record, ids[record.name]))
            file.write('],\n"annotations": [')
            n = 0
            for record in source.records(split):
                yield Progress(_STAGE, done, len(source), "COCO")
                done += 1
                for one in record.objects:
                    if one.area:
                        n += 1
                        row = row_of[record.scene, one.group]
                        _append(file, n == 1, _annotation(record, one, row, n, ids[record.name]))
            file.write("]}\n")


def _append(file: TextIO, is_first: bool, entry: Mapping[str, object]) -> None:
    file.write(("\n" if is_first else ",\n") + json.dumps(entry, ensure_ascii=False))


def _coco_image(record: Record, number: int) -> dict[str, object]:
    return {
        "id": number,
        "file_name": record.file("images"),
        "width": record.width,
        "height": record.height,
        "scene": record.scene,
        "placement": record.placement,
        "camera_K": record.K,
        "cam_from_world": record.cam_from_world,
        "depth_file": record.file("depth"),
        "depth_scale": record.depth_scale,
        "ids_file": record.file("ids"),
    }


def _annotation(
    record: Record, one: Shown, row: ObjectRow, number: int, image: int
) -> dict[str, object]:
    size = [record.height, record.width]
    return {
        "id": number,
        "image_id": image,
        "category_id": row.class_id,
        "object_id": row.id,
        "group_id": one.group,
        "segmentation": {"size": size, "counts": one.counts},
        "area": one.area,
        "bbox": one.box,
        "iscrowd": 0,
        "amodal_segmentation": {"size": size, "counts": one.whole_counts},
        "amodal_area": one.whole_area,
        "amodal_bbox": one.whole_box,
        "visible_share": round(one.visible_share, 4),
        "cam_from_object": one.cam_from_object,
    }


# --- YOLO


def _yolo_stage(source: Source, staging: Path) -> Stage[None]:
    """labels/<split>/<name>.txt: class, middle and size of the visible box, shares of the picture;
    and data.yaml. A class's number is its id less one."""
    row_of = source.row_of()
    for split in SPLITS:
        (staging / "labels" / split).mkdir(parents=True)
    used = set[str]()
    for done, record in enumerate(source.records()):
        yield Progress(_STAGE, done, len(source), "YOLO")
        used.add(record.split)
        size = np.array([record.width, record.height] * 2)
        lines = []
        for one in record.objects:
            if one.area:
                x, y, w, h = one.box
                numbers = np.array([x + w / 2, y + h / 2, w, h]) / size
                number = row_of[record.scene, one.group].class_id - 1
                lines.append(f"{number} " + " ".join(f"{value:.6f}" for value in numbers) + "\n")
        path = staging / "labels" / record.split / f"{record.name}.txt"
        path.write_text("".join(lines), encoding="utf-8")
    names = "".join(
        f"  {row.id - 1}: {json.dumps(row.name, ensure_ascii=False)}\n"
        for row in source.tables.classes
    )
    # Its trainers refuse a data set without a folder of each.
    val = "images/val" if "val" in used else "images/train  # no picture is for validation"
    text = f"path: .\ntrain: images/train\nval: {val}\nnames:\n{names}"
    (staging / "data.yaml").write_text(text, encoding="utf-8")


# --- BOP (Hodan et al. 2018 and later), lengths in millimetres


def _bop_stage(source: Source, staging: Path) -> Stage[None]:
    """bop/: models/ as meshes, and <split>/<placement>/ with pictures, masks and poses."""
    bop, row_of = staging / "bop", source.row_of()
    _bop_models(source, bop / "models", row_of)
    folders = dict[tuple[str, str], Path]()
    counted = Counter[Split]()
    tables = dict[Path, dict[str, dict[str, object]]]()
    camera: dict[str, object] = {}
    last: Path | None = None
    for done, record in enumerate(_by_placement(source)):
        yield Progress(_STAGE, done, len(source), "BOP")
        key = (record.scene, record.placement)
        if key not in folders:
            folders[key] = bop / record.split / f"{counted[record.split]:06d}"
            counted[record.split] += 1
            for part in ("rgb", "depth", "mask", "mask_visib"):
                (folders[key] / part).mkdir(parents=True)
        folder = folders[key]
        if last not in (None, folder):  # one placement in memory at a time
            assert last is not None
            _write_bop_tables(last, tables.pop(last))
        last = folder
        into = tables.setdefault(folder, {"scene_camera": {}, "scene_gt": {}, "scene_gt_info": {}})
        number = len(into["scene_gt"])
        _bop_picture(source.root, record, folder, number, into, row_of)
        K = record.K
        camera = {
            **{"cx": K[2], "cy": K[5], "fx": K[0], "fy": K[4]},
            **{"width": record.width, "height": record.height},
            "depth_scale": record.depth_scale * _MM,
        }
    if last is not None:
        _write_bop_tables(last, tables.pop(last))
    (bop / "camera.json").write_text(json.dumps(camera, indent=2) + "\n", encoding="utf-8")


def _by_placement(source: Source) -> Iterator[Record]:
    """The records with those of one placement together."""
    for scene in source.scenes:
        of = dict[str, list[str]]()
        for name in scene.names:
            record = read_record(source.root, name)
            if record is None:
                raise GagaError(f"The labels of {name} are gone. Run the command again.")
            of.setdefault(record.placement, []).append(name)
        for names in of.values():
            for name in names:
                record = read_record(source.root, name)
                assert record is not None
                yield record


def _bop_picture(
    root: Path,
    record: Record,
    folder: Path,
    number: int,
    into: dict[str, dict[str, object]],
    row_of: Mapping[tuple[str, int], ObjectRow],
) -> None:
    _linked(root / record.file("images"), folder / "rgb" / f"{number:06d}.jpg")
    _linked(root / record.file("depth"), folder / "depth" / f"{number:06d}.png")
    world = np.array(record.cam_from_world).reshape(4, 4)
    into["scene_camera"][str(number)] = {
        "cam_K": record.K,
        "depth_scale": record.depth_scale * _MM,
        "cam_R_w2c": world[:3, :3].ravel().tolist(),
        "cam_t_w2c": (_MM * world[:3, 3]).tolist(),
    }
    depth = read_labels(root / record.file("depth"))  # 16-bit, as label maps are
    poses, facts = list[dict[str, object]](), list[dict[str, object]]()
    for k, one in enumerate(record.objects):
        pose = np.array(one.cam_from_object).reshape(4, 4)
        poses.append(
            {
                "cam_R_m2c": pose[:3, :3].ravel().tolist(),
                "cam_t_m2c": (_MM * pose[:3, 3]).tolist(),
                "obj_id": row_of[record.scene, one.group].id,
            }
        )
        size = (record.height, record.width)
        whole, seen = decode_rle(one.whole_counts, size), decode_rle(one.counts, size)
        for kind, mask in (("mask", whole), ("mask_visib", seen)):
            _save_mask(folder / kind / f"{number:06d}_{k:06d}.png", mask)
        facts.append(
            {
                "bbox_obj": one.whole_box,
                "bbox_visib": one.box if one.area else (-1, -1, -1, -1),
                "px_count_all": one.whole_area,
                "px_count_valid": int(np.count_nonzero(whole & (depth > 0))),
                "px_count_visib": one.area,
                "visib_fract": one.visible_share,
            }
        )
    into["scene_gt"][str(number)] = poses
    into["scene_gt_info"][str(number)] = facts


def _save_mask(path: Path, mask: BoolArray) -> None:
    Image.fromarray(mask.astype(np.uint8) * np.uint8(255)).save(path, compress_level=1)


def _linked(source: Path, target: Path) -> None:
    """The same file under another name; a copy where the disk has no links."""
    with suppress(OSError):
        os.link(source, target)
        return
    shutil.copyfile(source, target)


def _write_bop_tables(folder: Path, into: Mapping[str, Mapping[str, object]]) -> None:
    for name, entries in into.items():
        text = ",\n".join(f'"{key}": {json.dumps(value)}' for key, value in entries.items())
        (folder / f"{name}.json").write_text(f"{{\n{text}\n}}\n", encoding="utf-8")


def _bop_models(source: Source, folder: Path, row_of: Mapping[tuple[str, int], ObjectRow]) -> None:
    """models_info.json: boxes and diameters, millimetres."""
    folder.mkdir(parents=True)
    told = {}
    for scene in source.scenes:
        for one in scene.objects:
            lo, hi = _MM * np.array(one.lo), _MM * np.array(one.hi)
            number = row_of[scene.scene, one.group].id
            told[str(number)] = _extents(lo, hi)
            points = source.root / "models" / scene.scene / f"{one.group}.ply"
            if points.is_file():
                _linked(points, folder / f"obj_{number:06d}.ply")
    (folder / "models_info.json").write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


def write_model(path: Path, mesh: TriangleMesh, note: str) -> None:
    """Write a mesh, or points where it has no faces, of an object's frame in scene units, as a
    model of BOP, in millimetres. ``note``: of what it was made, see `is_model_of`."""
    fields = [(name, "<f4") for name in "xyz"] + [(name, "u1") for name in _RGB]
    rows = np.zeros(len(mesh.vertices), fields)
    for k, axis in enumerate("xyz"):
        rows[axis] = _MM * mesh.vertices[:, k]
        rows[_RGB[k]] = 128 if mesh.colors is None else mesh.colors[:, k]
    elements = [PlyElement.describe(rows, "vertex")]
    if len(mesh.faces):
        faces = np.zeros(len(mesh.faces), [("vertex_indices", "<i4", (3,))])
        faces["vertex_indices"] = mesh.faces
        elements.append(PlyElement.describe(faces, "face"))
    with atomic_write(path) as temporary:
        PlyData(elements, comments=[note]).write(str(temporary))


def is_model_of(path: Path, note: str) -> bool:
    """Whether a model is there that was made of the same."""
    try:
        with path.open("rb") as file:
            return f"comment {note}\n".encode() in file.read(_HEAD)
    except OSError:
        return False


def model_box(path: Path) -> tuple[DoubleArray, DoubleArray]:
    """Lowest and highest corner (3,) of a model, scene units."""
    rows = PlyData.read(str(path))["vertex"]
    points = np.stack([rows[axis] for axis in "xyz"], axis=1).astype(np.float64) / _MM
    return points.min(axis=0), points.max(axis=0)


def _extents(lo: DoubleArray, hi: DoubleArray) -> dict[str, float]:
    size = hi - lo
    names = [f"{kind}_{axis}" for kind in ("min", "size") for axis in "xyz"]
    numbers = np.concatenate([lo, size]).tolist()
    return {"diameter": float(np.linalg.norm(size)), **dict(zip(names, numbers, strict=True))}


def write_tables(root: Path, file: DatasetFile) -> None:
    """Write dataset.json."""
    with atomic_write(root / DATASET_FILE) as temporary:
        temporary.write_bytes(msgspec.json.format(msgspec.json.encode(file), indent=1) + b"\n")
