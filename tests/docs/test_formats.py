"""docs/formats.md lists exactly the fields that are written."""

import json
import re
from collections.abc import Iterable
from dataclasses import asdict, replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from gaga_core.export.dataset.settings import DatasetConfig
from gaga_core.export.export import export_objects_stage
from gaga_core.identity.field import LiftFigures
from gaga_core.io.folder.scene_folder import SceneFolder, open_scene_folder
from gaga_core.io.splats.ply import write_ply
from gaga_core.pipeline.align import Aligned, write_aligned
from gaga_core.pipeline.associate import associate_scene
from gaga_core.pipeline.dataset import dataset_stage
from gaga_core.pipeline.lift import lift_scene
from gaga_core.pipeline.segment import segment_scene
from gaga_core.progress import run_stage
from gaga_core.query.index import GroupIndex, save_index
from gaga_core.scene import edits
from gaga_core.scene.bake import with_groups
from gaga_core.scene.camera_path import (
    CameraPath,
    Keyframe,
    KeyframeEntry,
    PathEntry,
    Shot,
    save_path,
)
from gaga_core.scene.captures.alignment import Alignment
from gaga_core.scene.captures.changes import Change
from gaga_core.scene.edits.history import History
from gaga_core.scene.export_manifest import Manifest, ManifestEntry
from gaga_core.scene.lod.build import build_lod_stage
from gaga_core.scene.project import ProjectFile, open_path_stage, save_project
from gaga_core.scene.scene import State
from gaga_core.segmentation.choose import provider_named
from gaga_core.segmentation.models.catalogue import known_model
from gaga_core.segmentation.models.download import LockedFile, write_lock
from gaga_core.segmentation.models.hub import Listing
from gaga_core.training.checkpoint import Best, Exposures, TrainState, save_checkpoint
from gaga_core.training.densification import ScreenSums
from gaga_core.training.optimizer import Splats
from gaga_studio.features.autosave import Autosave, RecoveryNote
from gaga_studio.features.commands import new_session
from gaga_studio.session.settings import Settings, save_settings, settings_file
from tests.app.folders import write_scene
from tests.docs.pages import DOCS, fields, tables
from tests.docs.schemas import FOLDER, TYPES, schema
from tests.scenes import random_gaussians

_PAGE = DOCS / "formats.md"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> SceneFolder:
    """A small scene folder, associated and lifted."""
    root = tmp_path_factory.mktemp("formats") / "table"
    write_scene(root, n_objects=3)
    folder = open_scene_folder(root)
    run_stage(associate_scene(folder))
    run_stage(lift_scene(folder, "vote"))
    return open_scene_folder(root)


def _check(heading: str, written: Iterable[str]) -> None:
    """Every written name is listed, and every required one is written."""
    required, optional = fields(_PAGE, heading)
    names = set(written)
    patterns = [_pattern(name) for name in required | optional]
    unlisted = {n for n in names if not any(p.fullmatch(n) for p in patterns)}
    missing = {r for r in required if not any(_pattern(r).fullmatch(n) for n in names)}
    assert not unlisted, f"{heading}: written, but not on the page"
    assert not missing, f"{heading}: on the page, but not written"


def _pattern(name: str) -> re.Pattern[str]:
    return re.compile(re.sub(r"<\w+>", r"\\w+", name))


def _json(path: Path) -> dict[str, dict[str, object]]:
    return json.loads(path.read_text(encoding="utf-8"))


def _names(path: Path) -> list[str]:
    with np.load(path) as arrays:
        return list(arrays.files)


def _shot() -> Shot:
    return Shot((0.0, -3.0, 1.0), (1.0, 0.0, 0.0, 0.0), 0.9, 0.7, 3.0, False)


def test_labelled_data(made: SceneFolder, tmp_path: Path) -> None:
    config = DatasetConfig(views=2, width=96, height=72, coverage=0.0, moved=0, removed=0)
    run_stage(dataset_stage([made.root], tmp_path, config))
    _check("dataset.json", _json(tmp_path / "dataset.json"))
    (scene,) = (tmp_path / "scenes").iterdir()
    _check("scenes/*.json", _json(scene))
    for path in (tmp_path / "records").iterdir():
        record = _json(path)
        _check("records/*.json", record)
        for one in record["objects"]:
            assert isinstance(one, dict)
            _check("Object of a picture", one)


def test_a_project_and_its_scene(made: SceneFolder, tmp_path: Path) -> None:
    project = run_stage(open_path_stage(made.root))
    scene = project.scene
    history = History(scene)
    history.do(edits.keep_selection(scene, "some", np.arange(5)))
    save_project(project, tmp_path / "out.gaga")
    document = _json(tmp_path / "out.gaga" / "project.json")
    _check("project.json", document)
    (file,) = (tmp_path / "out.gaga").glob("scene-*.npz")
    _check("scene-*.npz", _names(file))
    banks = {n.removeprefix("bank_") for n in _names(file) if n.startswith("bank_")}
    assert banks == set(_names(made.work / "bank.npz"))
    bits = re.findall(r"(\d) (\w+)", dict(_rows("scene-*.npz"))["`state`"][-1])
    assert {name.upper(): int(bit) for bit, name in bits} == {s.name: s.value for s in State}


def test_a_level_of_detail(tmp_path: Path) -> None:
    run_stage(build_lod_stage(random_gaussians(100), tmp_path / "lod", "digest"))
    _check("lod.json", _json(tmp_path / "lod" / "lod.json"))


def _rows(heading: str) -> list[tuple[str, list[str]]]:
    return [(cells[0], cells[1:]) for cells in tables(_PAGE)[heading]]


def test_what_an_association_writes(made: SceneFolder) -> None:
    _check("bank.npz", _names(made.work / "bank.npz"))
    _check("labels.npz", _names(made.work / "labels.npz"))
    report = _json(made.work / "report.json")
    known, _ = fields(_PAGE, "report.json")
    assert set(report) <= known
    _check("Entry associate", report["associate"])


def test_what_a_lift_writes(made: SceneFolder) -> None:
    _check("identity.npz", _names(made.work / "identity.npz"))
    _check("Entry lift", _json(made.work / "report.json")["lift"])
    _, optional = fields(_PAGE, "Entry lift")
    assert optional == set(asdict(LiftFigures()))


def test_what_masks_are_written_with(made: SceneFolder, tmp_path: Path) -> None:
    write_scene(tmp_path / "bare", masks=False, n_objects=2)
    folder = open_scene_folder(tmp_path / "bare")
    run_stage(segment_scene(folder, provider_named("regions"), views=folder.train[0]))
    _check("provider.json", _json(folder.root / "masks" / "regions" / "provider.json"))


def test_what_exported_objects_come_with(made: SceneFolder, tmp_path: Path) -> None:
    project = run_stage(open_path_stage(made.root))
    manifest = run_stage(export_objects_stage(project.scene, tmp_path / "objects"))
    content = _json(manifest)
    _check("groups.json", content)
    for entry in content["groups"]:
        assert isinstance(entry, dict)
        _check("Entry of groups", entry)


def test_a_camera_path(tmp_path: Path) -> None:
    path = CameraPath((Keyframe(_shot(), 1.0), Keyframe(_shot(), 2.0)))
    content = _json(save_path(path, tmp_path / "path.json"))
    _check("Camera path", content)
    for keyframe in content["keyframes"]:
        assert isinstance(keyframe, dict)
        _check("Keyframe", keyframe)


def test_what_an_alignment_writes(tmp_path: Path) -> None:
    alignment = Alignment(np.eye(4), "photos", 40, 0.9, 0.01, 0.5, 0.001, 0.001)
    change = Change("moved", "mug", 3, 5, 0.4)
    write_aligned(tmp_path / "align.json", Aligned("a", "b", alignment, (change,)))
    content = json.loads((tmp_path / "align.json").read_text(encoding="utf-8"))
    _check("align-*.json", content)
    _check("Alignment", content["alignment"])
    _check("Change", content["changes"][0])


def test_preferences_with_their_defaults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GAGA_HOME", str(tmp_path))
    save_settings(Settings())
    written = _json(settings_file())
    _check("settings.json", written)
    for name, (default, *_) in _rows("settings.json"):
        value = written[name.strip("`")]
        assert default == (value if isinstance(value, str) else json.dumps(value)), name


def test_what_autosave_leaves(
    made: SceneFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAGA_HOME", str(tmp_path))
    session = new_session(Settings())
    session.take(run_stage(open_path_stage(made.root)))
    scene = session.need().scene
    session.need().do(edits.delete(scene, np.arange(3)))
    sure = np.ones(scene.n_opened, np.float32)
    edit = edits.set_grouping(scene, np.ones(len(scene), np.int32), scene.bank, confidence=sure)
    session.need().do(edit)
    saver = Autosave(every_s=0.0)
    saver.tick(session)
    saver.wait()
    (note,) = (tmp_path / "recovery").glob("*/recovery.json")
    _check("recovery.json", _json(note))
    _check("history.npz", _names(note.with_name("history.npz")))
    saver.finish()


def test_the_checkpoint_of_a_training(tmp_path: Path) -> None:
    gaussians = random_gaussians(7, sh_degree=1)
    zeros = np.zeros(7, np.float32)
    exposure = np.zeros((2, 2, 3))
    state = TrainState(
        iteration=1,
        splats=Splats(gaussians, gaussians, gaussians),
        sums=ScreenSums(zeros, np.zeros(7, np.int32)),
        exposures=Exposures(exposure, exposure, exposure),
        losses=np.zeros(3, np.float32),
        measured=np.zeros((0, 3)),
        best=Best(1, 20.0, gaussians),
    )
    save_checkpoint(tmp_path / "train.npz", state, "digest")
    _check("Checkpoint of a training", _names(tmp_path / "train.npz"))


def test_the_index_of_pictures(tmp_path: Path) -> None:
    index = GroupIndex(
        "model",
        np.array([1], np.int32),
        np.array([5], np.int64),
        np.ones((1, 4), np.float32),
        np.zeros((1, 96, 96, 3), np.uint8),
    )
    save_index(tmp_path / "index.npz", index)
    _check("index.npz", _names(tmp_path / "index.npz"))


def test_the_columns_of_a_ply(tmp_path: Path) -> None:
    gaussians = random_gaussians(5, sh_degree=3)
    codes = {f"obj_dc_{i}": np.zeros(5, np.float32) for i in range(16)}
    full = with_groups(gaussians, np.arange(5, dtype=np.int32))
    write_ply(tmp_path / "all.ply", replace(full, extra={**full.extra, **codes}))
    head = (tmp_path / "all.ply").read_bytes().split(b"end_header")[0].decode()
    names = re.findall(r"^property \w+ (\w+)", head, re.M)
    listed = [n for cells in tables(_PAGE)["PLY columns"] for n in re.findall(r"`(\w+)", cells[0])]
    patterns = [re.compile(name + r"\d*") for name in listed if not name.startswith(".")]
    assert all(any(p.fullmatch(n) for p in patterns) for n in names)
    standard = [n for n in names if not n.startswith(("f_rest", "obj_dc", "group"))]
    order = [n for n in listed if n in standard]
    assert order == standard, "the columns are listed in the order in which they are written"


_STRUCTS: dict[str, type[msgspec.Struct]] = {
    "project.json": ProjectFile,
    "recovery.json": RecoveryNote,
    "Camera path": PathEntry,
    "Keyframe": KeyframeEntry,
    "groups.json": Manifest,
    "Entry of groups": ManifestEntry,
}


@pytest.mark.parametrize("heading", list(_STRUCTS))
def test_what_is_read_is_what_the_page_lists(heading: str) -> None:
    required, optional = fields(_PAGE, heading)
    assert set(_STRUCTS[heading].__struct_fields__) == required | optional


def test_what_a_lock_of_a_model_holds(tmp_path: Path) -> None:
    listing = Listing(known_model("sam2.1-tiny"), "https://hub", "main", "5c3e", "apache-2.0", ())
    file = LockedFile("config.json", 2, "0" * 64, "git")
    write_lock(tmp_path, listing, "Apache-2.0", "2026-11-22T11:00:00+00:00", [file])
    lock = _json(tmp_path / "model.lock.json")
    _check("model.lock.json", lock)
    (written,) = lock["files"]
    _check("File of a model", written)


@pytest.mark.parametrize("name", list(TYPES))
def test_a_schema_is_that_of_the_reader(name: str) -> None:
    assert (FOLDER / f"{name}.json").read_text(encoding="utf-8") == schema(name), (
        "python -m tests.docs.schemas writes it again"
    )


def test_every_schema_is_listed() -> None:
    listed = re.findall(r"\(schemas/(\w+)\.json\)", _PAGE.read_text(encoding="utf-8"))
    assert sorted(listed) == list(TYPES) == sorted(path.stem for path in FOLDER.iterdir())


@pytest.mark.parametrize("name", list(TYPES))
def test_no_type_crashes_its_reader(name: str) -> None:
    """msgspec 0.22 crashes on a bounded value in a union with a tuple of fixed length."""
    nodes: list[object] = [msgspec.inspect.type_info(TYPES[name])]
    seen: set[int] = set()
    while nodes:
        node = nodes.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        if isinstance(node, msgspec.inspect.UnionType):
            bounded = [t for t in node.types if _is_bounded(t)]
            fixed = [t for t in node.types if isinstance(t, msgspec.inspect.TupleType)]
            assert not (bounded and fixed), f"{bounded} | {fixed}"
        nodes += _inside(node)


def _is_bounded(node: object) -> bool:
    if isinstance(node, msgspec.inspect.Metadata):
        return _is_bounded(node.type)
    names = ("gt", "ge", "lt", "le", "multiple_of", "min_length", "max_length", "pattern")
    return any(getattr(node, name, None) is not None for name in names)


def _inside(node: object) -> list[object]:
    """The types within a type."""
    found: list[object] = []
    for name in ("type", "item_type", "key_type", "value_type", "cls"):
        part = getattr(node, name, None)
        found += [part] if isinstance(part, msgspec.inspect.Type) else []
    for name in ("types", "item_types"):
        found += list(getattr(node, name, ()))
    return [*found, *(field.type for field in getattr(node, "fields", ()))]
