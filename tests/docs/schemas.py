"""JSON schemas of our own files, from the types that read them; ``python -m tests.docs.schemas``
writes them to docs/schemas."""

import json
from collections.abc import Mapping
from functools import reduce
from operator import or_
from types import GenericAlias
from typing import Any

import msgspec
import numpy as np

from gaga_core.edit_script.operations import OPERATION_TYPES
from gaga_core.export.dataset.formats import DatasetFile, SceneSet
from gaga_core.export.dataset.records import Record
from gaga_core.io.cameras.cameras_json import CameraEntry
from gaga_core.io.folder.scene_folder import World
from gaga_core.io.folder.splits import SplitFile
from gaga_core.io.masks.label_maps import MaskRecord
from gaga_core.io.masks.other_programs import MaskEntry
from gaga_core.io.splats.sog import LodMeta
from gaga_core.scene.camera_path import PathEntry
from gaga_core.scene.edits.values import AnyEdit, Kept
from gaga_core.scene.edits.wire import ColumnEntry, IntsEntry, SetEntry
from gaga_core.scene.export_manifest import Manifest
from gaga_core.scene.index_set import IndexSet, PackedInts
from gaga_core.scene.lod.tree import LodFile
from gaga_core.scene.project import ProjectFile
from gaga_core.segmentation.models.download import ModelLock
from gaga_studio.features.autosave import RecoveryNote
from gaga_studio.session.settings import Settings
from tests.docs.pages import DOCS

TYPES: Mapping[str, object] = {
    "camera_path": PathEntry,
    "cameras": list[CameraEntry],
    "dataset": DatasetFile,
    "edit_script": GenericAlias(list, (reduce(or_, OPERATION_TYPES.values()),)),
    "groups": Manifest,
    "lod": LodFile,
    "lod_meta": LodMeta,
    "mask_list": list[MaskEntry],
    "model_lock": ModelLock,
    "picture_record": Record,
    "project": ProjectFile,
    "provider": MaskRecord,
    "recorded_edit": AnyEdit,
    "recovery": RecoveryNote,
    "scene_set": SceneSet,
    "settings": Settings,
    "split": SplitFile,
    "world": World,
}
FOLDER = DOCS / "schemas"


def schema(name: str) -> str:
    """The text of a schema (JSON Schema 2020-12)."""
    content: dict[str, Any] = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": name,
    }
    content |= msgspec.json.schema(TYPES[name], schema_hook=_own_form)
    if TYPES[name] is AnyEdit:
        for entry in (SetEntry, IntsEntry, ColumnEntry):
            content["$defs"] |= msgspec.json.schema(entry)["$defs"]
    # The end of the text is $ in JSON Schema, and \\Z in Python, where $ lets a line end follow.
    return json.dumps(content, indent=1).replace("\\\\Z", "$") + "\n"


def _own_form(kind: type) -> dict[str, object]:
    """The schema of a value that has a form of its own, or is checked where it is used."""
    if kind is np.ndarray:
        return {"description": "numbers, or rows of numbers", "type": "array"}
    if kind is Kept:
        columns = {"type": "array", "items": {"$ref": "#/$defs/ColumnEntry"}}
        number = {"type": "integer", "description": "of a value that only a history has"}
        return {"anyOf": [columns, number]}
    if kind in (IndexSet, PackedInts):
        return {"$ref": f"#/$defs/{'SetEntry' if kind is IndexSet else 'IntsEntry'}"}
    assert kind is object
    return {"description": "checked where it is used"}


def main() -> None:
    """Write all schemas."""
    FOLDER.mkdir(exist_ok=True)
    for name in TYPES:
        (FOLDER / f"{name}.json").write_text(schema(name), encoding="utf-8")


if __name__ == "__main__":
    main()
