"""JSON schemas of our own files, from the types that read them; ``python -m tests.docs.schemas``
writes them to docs/schemas."""

import json
from collections.abc import Mapping

import msgspec

from gaga_core.edit_script.computed import ComputedOperation
from gaga_core.edit_script.folders import FolderOperation
from gaga_core.edit_script.operations import ObjectOperation
from gaga_core.edit_script.regions import RegionOperation
from gaga_core.io.cameras.cameras_json import CameraEntry
from gaga_core.io.folder.splits import SplitFile
from gaga_core.io.masks.label_maps import MaskRecord
from gaga_core.io.masks.other_programs import MaskEntry
from gaga_core.io.splats.sog import LodMeta
from gaga_core.scene.camera_path import PathEntry
from gaga_core.scene.edits.json import AnyEntry
from gaga_core.scene.export_manifest import Manifest
from gaga_core.scene.lod.tree import LodFile
from gaga_core.scene.project_file import ProjectFile
from gaga_core.segmentation.models.download import ModelLock
from gaga_studio.actions.autosave import RecoveryNote
from gaga_studio.session.settings import Settings
from tests.docs.pages import DOCS

TYPES: Mapping[str, object] = {
    "camera_path": PathEntry,
    "cameras": list[CameraEntry],
    "edit_script": list[ObjectOperation | ComputedOperation | FolderOperation | RegionOperation],
    "groups": Manifest,
    "lod": LodFile,
    "lod_meta": LodMeta,
    "mask_list": list[MaskEntry],
    "model_lock": ModelLock,
    "project": ProjectFile,
    "provider": MaskRecord,
    "recorded_edit": AnyEntry,
    "recovery": RecoveryNote,
    "settings": Settings,
    "split": SplitFile,
}
FOLDER = DOCS / "schemas"


def schema(name: str) -> str:
    """The text of a schema (JSON Schema 2020-12)."""
    content = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": name}
    content |= msgspec.json.schema(TYPES[name], schema_hook=_anything)
    return json.dumps(content, indent=1) + "\n"


def _anything(kind: type) -> dict[str, object]:
    """The schema of a value that is checked where it is used."""
    assert kind is object
    return {"description": "checked where it is used"}


def main() -> None:
    """Write all schemas."""
    FOLDER.mkdir(exist_ok=True)
    for name in TYPES:
        (FOLDER / f"{name}.json").write_text(schema(name), encoding="utf-8")


if __name__ == "__main__":
    main()
