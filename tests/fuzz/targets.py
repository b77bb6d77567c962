"""Every reader, with a good file to damage."""

import io
import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.arrays import FloatArray, UInt8Array
from gaga_core.cli.main import main
from gaga_core.edit_script import run_script
from gaga_core.errors import GagaError
from gaga_core.evaluate.benchmark.files import read_runs, write_runs
from gaga_core.evaluate.benchmark.tables import BenchmarkRun, InstanceScores, PromptScores
from gaga_core.evaluate.group_scores import Score
from gaga_core.export.export import export_objects_stage
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.bank_file import load_bank, read_groups, save_bank
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.identity import train as identity_training
from gaga_core.identity.classifier_io import with_encodings, write_classifier
from gaga_core.identity.field import (
    Identity,
    IdentityField,
    encoding_colors,
    load_identity,
    save_identity,
)
from gaga_core.identity.training_step import Training
from gaga_core.io.cameras.cameras_json import read_cameras_json, write_cameras_json
from gaga_core.io.cameras.colmap import read_colmap, write_colmap
from gaga_core.io.datasets import open_dataset
from gaga_core.io.folder.scene_folder import AssociateEntry, open_scene_folder, read_report_entry
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.images import read_rgb, write_rgb
from gaga_core.io.json_file import read_json
from gaga_core.io.masks.label_maps import read_further_labels, read_labels, write_labels
from gaga_core.io.masks.other_programs import MaskList, recognise
from gaga_core.io.splats.splat_files import read_splats, write_splats
from gaga_core.io.video import VideoConfig, write_video_stage
from gaga_core.pipeline.associate import views_to_add
from gaga_core.pipeline.lift import read_identity
from gaga_core.pipeline.place import notes_of, placement_of, read_entry
from gaga_core.placing.checks import check_model
from gaga_core.placing.diagnosis import MatchFacts, is_still, linked_groups
from gaga_core.placing.metrics import SfmFacts, summarize
from gaga_core.placing.photos import Photo, PhotoSet, list_photos, prepare_photos, read_photo_set
from gaga_core.placing.video import expected_frames, extract_frames, extract_moving_frames
from gaga_core.progress import run_stage
from gaga_core.query.index import (
    THUMBNAIL,
    GroupIndex,
    TextVectors,
    load_index,
    n_stale,
    relevancy,
    save_index,
)
from gaga_core.scene.camera_path import CameraPath, Keyframe, Shot, load_path, save_path
from gaga_core.scene.edits.history import History
from gaga_core.scene.folders import Folders
from gaga_core.scene.lod.build import build_lod_stage
from gaga_core.scene.lod.cut import choose_cut, drawn_nodes
from gaga_core.scene.lod.edited import merged_again, node_facts
from gaga_core.scene.lod.tree import open_lod, write_streamed_sog_stage
from gaga_core.scene.project import open_path_stage, save_project, saved_scene
from gaga_core.scene.scene import Scene, Weight
from gaga_core.segmentation.models.catalogue import known_model
from gaga_core.segmentation.models.download import LockedFile, read_lock, write_lock
from gaga_core.segmentation.models.hub import Listing
from gaga_core.training.checkpoint import (
    Best,
    TrainState,
    iteration_of,
    load_checkpoint,
    save_checkpoint,
)
from gaga_studio.features import autosave
from gaga_studio.session.settings import Settings, load_settings, save_settings
from tests.core.io.mask_forms import FORMS
from tests.core.io.splat_parts import ksplat, sog_parts, zipped
from tests.datasets import LAYOUTS
from tests.gltf_files import write_gltf
from tests.scenes import orbit_cameras, random_gaussians


@dataclass(frozen=True)
class Target:
    """A reader: ``make`` writes good files into a folder, ``read`` reads them in a copy of it.

    The lines of text that ``read`` returns are checked as what a person sees.
    """

    make: Callable[[Path], object]
    read: Callable[[Path], object]
    damaged: str = ""  # pattern of the files to damage; "" = all
    share: int = 1  # it gets 1 / share of the cases: 10 where each reading starts a process


def _splats(suffix: str) -> Target:
    name = f"a{suffix}"
    return Target(
        lambda folder: write_splats(folder / name, _gaussians()),
        lambda folder: _used(read_splats(folder / name)),
    )


def _sog_folder(folder: Path) -> None:
    for name, content in sog_parts().items():
        (folder / name).write_bytes(content)


def _gaussians() -> Gaussians:
    return random_gaussians(300, sh_degree=1)


def _used(gaussians: Gaussians) -> float:
    """Touch every value, so that memory that is not there shows."""
    with np.errstate(all="ignore"):
        return sum(float(np.nansum(np.abs(c))) for c in (gaussians.means, gaussians.sh))


def _masks(form: str) -> Target:
    def make(folder: Path) -> None:
        FORMS[form][0](folder / form)

    def read(folder: Path) -> None:
        for load in recognise(folder / form).views.values():
            found = load()
            if isinstance(found, MaskList):
                for mask in found.masks:
                    mask.sum()

    return Target(make, read)


def _bank(folder: Path) -> None:
    log = tuple(Decision(f"{i}.jpg", i, i % 5 + 1, i < 5, 0.3, 0, 0.1, 40) for i in range(60))
    bank = MemoryBank((np.arange(300) % 5 + 1).astype(np.int32), 5, log, preset="paper")
    save_bank(folder / "bank.npz", bank)


def _project(folder: Path) -> None:
    write_splats(folder / "a.ply", _gaussians())
    project = run_stage(open_path_stage(folder / "a.ply"))
    project.scene.labels[:] = np.arange(300) % 7
    project.scene.names = {1: "one", 2: "two"}
    project.scene.folders = Folders.of(("a/b",), {1: "a/b", 3: "c"})
    save_project(project)


def _exported(folder: Path) -> None:
    scene = Scene.of(_gaussians(), np.arange(300, dtype=np.int32) % 4)
    scene.names, scene.colors = {1: "one"}, {2: (1.0, 0.0, 0.5)}
    scene.weights = {3: Weight("mass", 0.35)}
    scene.folders = Folders.of((), {1: "a/b", 3: "c"})
    run_stage(export_objects_stage(scene, folder / "out"))


def _scene_folder(folder: Path) -> None:
    write_colmap(folder / "sparse/0", orbit_cameras(3), np.ones((3, 3)), np.ones((3, 3), np.uint8))
    write_cameras_json(folder / "cameras.json", orbit_cameras(3))
    (folder / "split.json").write_text('{"train": ["000", "002.png"], "test": ["001.png"]}')


def _binary_colmap(folder: Path) -> None:
    import pycolmap

    write_colmap(folder, orbit_cameras(3), np.ones((3, 3)), np.ones((3, 3), np.uint8))
    pycolmap.Reconstruction(str(folder)).write_binary(str(folder))
    for path in folder.glob("*.txt"):
        path.unlink()


def _script(folder: Path) -> None:
    ops: list[dict[str, object]] = [
        {"op": "select", "groups": [1, 2]},
        {"op": "move", "groups": [1], "by": [0.1, 0, 0]},
        {"op": "rotate", "groups": [2], "axis": [0, 0, 1], "degrees": 45},
        {"op": "recolor", "groups": [3], "color": [0.9, 0.1, 0.1], "strength": 0.5},
        {"op": "rename", "groups": [3], "name": "cup"},
        {"op": "transform", "groups": [1], "matrix": np.eye(4)[:3].tolist()},
        {"op": "duplicate", "groups": [2], "by": [1, 0, 0]},
        {"op": "clean", "groups": [1]},
        {"op": "fill", "groups": [1]},
        {"op": "undo", "times": 2},
        {"op": "redo", "times": 1},
        {"op": "delete", "groups": [2]},
    ]
    (folder / "edits.json").write_text(json.dumps(ops))
    recorded = Scene.of(random_gaussians(60, sh_degree=0), (np.arange(60) % 4).astype(np.int32))
    history = History(recorded)
    run_script(recorded, ops[:4], history)
    (folder / "recorded.json").write_text(json.dumps(history.recorded()))


def _run_script(folder: Path) -> None:
    content = [read_json(path, list[object], "") for path in sorted(folder.glob("*.json"))]
    for script in content:
        labels = (np.arange(60) % 4).astype(np.int32)
        run_script(Scene.of(random_gaussians(60, sh_degree=0), labels), script)


def _make_settings(folder: Path) -> None:
    os.environ["GAGA_HOME"] = str(folder)
    save_settings(Settings())


def _read_settings(folder: Path) -> None:
    os.environ["GAGA_HOME"] = str(folder)
    load_settings()


def _model_lock(folder: Path) -> None:
    listing = Listing(known_model("sam2.1-tiny"), "https://hub", "main", "5c3e", "apache-2.0", ())
    file = LockedFile("config.json", 2, "0" * 64, "git")
    write_lock(folder, listing, "Apache-2.0", "2026-11-22T11:00:00+00:00", [file])


def _write_map(path: Path) -> None:
    labels = (np.arange(600).reshape(20, 30) % 9).astype(np.int32)
    write_labels(path, labels, [labels[::2], labels % 3])


def _report(folder: Path) -> None:
    sfm = {"names": ["a", "b"], "why_out": {"b": "dark"}, "links": [[0, 1, 40]], "notes": ["x"]}
    entries: dict[str, object] = {"reconstruct": {"sfm": {**sfm, "checks": [{"text": "good"}]}}}
    entries |= {"associate": {"mask_folder": "masks/sim", "groups_with_gaussians": 3}}
    (folder / "gaga").mkdir()
    (folder / "gaga" / "report.json").write_text(json.dumps(entries))


def _read_report(folder: Path) -> None:
    entry = read_entry(folder)
    placement_of(entry)
    sfm = entry.get("sfm")
    notes_of(sfm if isinstance(sfm, dict) else {})
    read_report_entry(folder / "gaga" / "report.json", "associate", AssociateEntry)


def _runs(folder: Path) -> None:
    score = InstanceScores(Score(0.5, 0.6, 0.7, 0.5, 3, 4), Score(0.5, 0.6, 0.7, 0.5, 3, 4))
    prompts = PromptScores(0.5, 0.4, {"cup": (0.5, 0.4)})
    runs = [BenchmarkRun(1.0, score, 8, 4, 2.0), BenchmarkRun(0.5, prompts, 4, 4, 2.0, ("a",))]
    write_runs(folder / "runs.json", {"preset": "paper"}, {run.share: run for run in runs})


# --- targets that open, change and write


_EDITS: list[dict[str, object]] = [
    {"op": "select_all"},
    {"op": "move", "by": [0.1, 0, 0]},
    {"op": "select", "groups": [1, 2]},
    {"op": "rotate", "axis": [0, 0, 1], "degrees": 45},
    {"op": "recolor", "color": [0.9, 0.1, 0.1], "strength": 0.5},
    {"op": "duplicate", "by": [1, 0, 0]},
    {"op": "delete", "groups": [1]},
    {"op": "show_all"},
    {"op": "crop", "min": [-9, -9, -9], "max": [9, 9, 9]},
]


def _edit_and_save(opened: Path, folder: Path) -> None:
    """Open a project, edit it, undo and redo everything, save it in two places, open it again."""
    project = run_stage(open_path_stage(opened))
    history = History(project.scene)
    for edit in _EDITS:
        with suppress(GagaError):
            run_script(project.scene, [edit], history)
    _walk(history)
    run_stage(export_objects_stage(project.scene, folder / "out"))
    save_project(project, folder / "elsewhere", copies_model=True)
    run_stage(open_path_stage(folder / "elsewhere"))
    save_project(project, overwrites=True)


def _walk(history: History) -> None:
    """Undo and redo everything, one by one and at once."""
    while history.can_undo:
        history.undo()
    while history.can_redo:
        history.redo()
    history.go_to(0)
    history.go_to(len(history.entries()))


_FIXTURE = Path(__file__).resolve().parents[1] / "fixtures" / "before_consolidation"


def _made_scene(folder: Path) -> None:
    """A scene folder with masks and groups, a file that was added to it, and an autosave."""
    shutil.copytree(_FIXTURE, folder, dirs_exist_ok=True)
    case, scene = folder.with_name("case").as_posix(), folder / "associated"
    for file in folder.rglob("*.json"):
        file.write_text(file.read_text(encoding="utf-8").replace("@FIXTURE@", case))
    kept = folder / "recovery" / autosave.FILE
    with np.load(kept) as npz:
        arrays = dict(npz)
    text = arrays["edits"].tobytes().decode().replace("@FIXTURE@", case)
    np.savez(kept, **arrays | {"edits": np.frombuffer(text.encode(), np.uint8)})
    shutil.rmtree(scene / "sparse")  # COLMAP starts a process: a target of its own
    cameras = [replace(c, name=f"{i:03}.png") for i, c in enumerate(orbit_cameras(6))]
    write_cameras_json(scene / "cameras.json", cameras)
    (scene / "images").mkdir()
    for camera in cameras:
        write_rgb(scene / "images" / camera.name, np.full((30, 40, 3), 90, np.uint8))
    report = {"associate": {"mask_folder": "masks/made", "groups_with_gaussians": 3}}
    (scene / "gaga" / "report.json").write_text(json.dumps(report))
    (scene / "split.json").write_text('{"train": ["000", "001.png"], "test": ["004.png"]}')
    left = scene / "gaga" / ".gaga-abcdefgh"  # what a killed program has left
    (left / "masks" / "new").mkdir(parents=True)
    (left / "new.npz").write_bytes((scene / "gaga" / "labels.npz").read_bytes())
    (left / "masks" / "new" / "a.png").write_bytes((scene / "images" / "000.png").read_bytes())
    (left / "publish.json").write_text('["masks/new", "new.npz"]')
    os.utime(scene / "gaga" / "identity.npz")  # a lift comes after its association


def _read_recovery(folder: Path) -> None:
    """What the window does after a crash: project and undo history, walked through, saved."""
    place = folder / "recovery"
    project = run_stage(open_path_stage(place))
    found = autosave.read_history(place, saved_scene(place), project.scene)
    if found is not None:
        history = History(project.scene)
        history.resume(found.record)
        _walk(history)
    save_project(project, folder / "elsewhere", copies_model=True)


def _read_notes(folder: Path) -> None:
    home = folder / "home"
    os.environ["GAGA_HOME"] = str(home)
    (home / "recovery").mkdir(parents=True)
    (folder / "recovery").rename(home / "recovery" / "1-a")
    found, _ = autosave.left_over()
    assert all(one.age for one in found)


def _read_groups(folder: Path) -> None:
    """Open a scene folder with the groups of an association, and what the stages read of it."""
    scene = folder / "associated"
    project = run_stage(open_path_stage(scene))
    assert project.folder is not None
    for read in (
        lambda: views_to_add(project.folder),
        lambda: read_groups(project.folder, len(project.scene)),
        lambda: read_identity(project.folder, len(project.scene)),
        lambda: run_script(project.scene, [{"op": "labels", "from": "votes"}]),
        lambda: run_script(project.scene, [{"op": "split_here", "group": 1}]),
        lambda: load_bank(scene / "gaga" / "bank.npz"),
    ):
        with suppress(GagaError):
            read()
    with staging_folder(project.folder.work) as staging:
        (staging / "masks").mkdir()
        (staging / "masks" / "a.png").write_bytes(b"new")
        (staging / "labels.npz").write_bytes(b"new")
        publish_all(staging, ["masks", "labels.npz"], project.folder.work)


def _describe(folder: Path) -> list[str]:
    """The lines that ``gaga info`` of a project writes."""
    out, errors = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(errors):
        main(["info", str(folder / "a.gaga")])
    return [line for stream in (out, errors) for line in stream.getvalue().split("\n")]


# --- targets of single files and folders


def _identity(folder: Path) -> None:
    rng = np.random.default_rng(0)
    codes, weight = rng.normal(size=(300, 16)), rng.normal(size=(5, 16))
    field = IdentityField(codes.astype("f4"), weight.astype("f4"), np.zeros(5, np.float32))
    labels, confidence = field.classify(field.encodings)
    save_identity(folder / "identity.npz", Identity(field, labels, confidence, "paper"))


def _read_identity(folder: Path) -> None:
    identity = load_identity(folder / "identity.npz")
    identity.field.classify(identity.field.encodings)
    encoding_colors(identity.field.encodings)


def _classified(folder: Path) -> None:
    codes = np.random.default_rng(0).normal(size=(300, 16)).astype("f4")
    write_splats(folder / "a.ply", with_encodings(_gaussians(), codes))
    write_classifier(folder / "classifier.pth", codes[:5], codes[0, :5].copy())


def _index(folder: Path) -> None:
    rows = np.random.default_rng(0).normal(size=(4, 8)).astype("f4")
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    pictures = np.zeros((4, THUMBNAIL, THUMBNAIL, 3), np.uint8)
    groups = np.arange(4, dtype=np.int32)
    save_index(folder / "index.npz", GroupIndex("m", groups, groups.astype("i8"), rows, pictures))
    names = np.array(["a cup", "a pot"])
    np.savez(folder / "texts.npz", model=np.array("m"), texts=names, vectors=rows[:2])


def _read_index(folder: Path) -> None:
    index = load_index(folder / "index.npz")
    texts = TextVectors("m", _NoModel, folder / "texts.npz")
    if index is not None:
        relevancy(index, texts.of(["a cup"])[0], texts.of(["a pot"]))
        n_stale(index, index.digests)


class _NoModel:
    """The same vector for everything."""

    fingerprint = "m"

    def texts(self, texts: Sequence[str]) -> FloatArray:
        return np.ones((len(texts), 8), np.float32)

    def pictures(self, pictures: Sequence[UInt8Array]) -> FloatArray:
        return np.ones((len(pictures), 8), np.float32)


def _streamed(folder: Path) -> None:
    splats = random_gaussians(40_000, sh_degree=0)
    tree = run_stage(build_lod_stage(splats, folder / "lod", "digest"))
    run_stage(write_streamed_sog_stage(folder / "web", tree, splats))


def _read_lod(folder: Path) -> None:
    splats = random_gaussians(40_000, sh_degree=0)
    tree = open_lod(folder / "lod", "digest", len(splats), 1)
    if tree is None:
        return
    for camera in orbit_cameras(2):
        cut = choose_cut(tree, tree.boxes, camera, 10_000)
        for node in drawn_nodes(tree, cut.divided):
            merged, rows = tree.read(int(node), splats)
            _used(merged)
            splats.means[rows]
    scene = Scene.of(splats, (np.arange(len(splats)) % 9).astype(np.int32))
    node_facts(tree, scene)
    for node in (0, tree.n_nodes - 1):
        merged_again(tree, node, scene)


def _checkpoints(folder: Path) -> None:
    state = TrainState.first(_gaussians(), 3, 20)
    state.best = Best(4, 20.0, _gaussians())
    save_checkpoint(folder / "training.npz", state, "digest")
    rng = np.random.default_rng(0)
    shapes = [(300, 16), (5, 16), (5,)]
    values = [rng.normal(size=shape).astype("f4") for shape in shapes]
    moments = tuple(np.zeros(shape, "f4") for shape in shapes for _ in range(2))
    training = Training(values[0], values[1], values[2], moments, 3)
    identity_training.save_checkpoint(folder / "identity.npz", training, "digest")


def _read_checkpoints(folder: Path) -> None:
    iteration_of(folder / "training.npz")
    state = load_checkpoint(folder / "training.npz", "digest", views=3, iterations=20)
    if state is not None:
        _used(state.splats.values)
    identity_training.load_checkpoint(folder / "identity.npz", "digest", 300, 4)


def _film(folder: Path) -> None:
    rng = np.random.default_rng(0)
    still = rng.integers(0, 255, (64, 160, 3)).astype(np.uint8)
    config = VideoConfig(96, 64, fps=10)
    frames = write_video_stage(folder / "a.mp4", 8, lambda i: still[:, 3 * i : 3 * i + 96], config)
    run_stage(frames)


def _read_film(folder: Path) -> None:
    expected_frames(folder / "a.mp4")
    run_stage(extract_moving_frames(folder / "a.mp4", folder / "moving", longest_side=64))
    run_stage(extract_frames(folder / "a.mp4", folder / "clock", fps=2, longest_side=64))


def _photos(folder: Path) -> None:
    rng = np.random.default_rng(0)
    for i, suffix in enumerate((".jpg", ".png", ".webp", ".bmp", ".tif", ".jpeg")):
        blocks = rng.integers(0, 255, (4, 6, 3)).astype(np.uint8)
        Image.fromarray(blocks.repeat(12, 0).repeat(12, 1)).save(folder / f"{i}{suffix}")


def _read_photos(folder: Path) -> None:
    target = folder.parent / "home" / "prepared"
    shutil.rmtree(target, ignore_errors=True)
    sources = list_photos(folder)
    run_stage(prepare_photos(sources, target, root=folder, longest_side=40))
    for photo in sources:
        with suppress(GagaError):
            read_rgb(photo)
        with suppress(GagaError):
            read_labels(photo)
        with suppress(GagaError):
            read_further_labels(photo)


def _dataset(layout: str) -> Target:
    name, write = LAYOUTS[layout]

    def read(folder: Path) -> None:
        for scene in open_dataset(name, folder).scenes:
            for load in list(scene.truth.loaders.values())[:2]:
                with suppress(GagaError):
                    load()

    is_slow = layout in ("Replica, Gaga", "ScanNet, Gaga", "LERF-Mask", "3D-OVS", "COLMAP")
    return Target(lambda f: write(f / "office_0"), read, share=10 if is_slow else 2)


def _camera_path(folder: Path) -> None:
    shot = Shot((0, 0, 0), (1, 0, 0, 0), 1.0, 0.8, 2.0)
    keys = [Keyframe(replace(shot, eye=(float(i), 0.0, 1.0))) for i in range(4)]
    save_path(CameraPath(tuple(keys), even_speed=True), folder / "path.json")


def _read_camera_path(folder: Path) -> None:
    path = load_path(folder / "path.json")
    for second in np.linspace(0, min(path.seconds, 1e6), 5) if path.keyframes else ():
        path.shot(float(second))


def _placement_facts(folder: Path) -> None:
    n = np.zeros(4, np.int64)
    poses = np.tile(np.eye(4)[:3], (4, 1, 1))
    pairs, ones = np.array([[0, 1], [1, 2], [2, 3]]), np.ones
    views, points = np.array([[0, 1], [1, 2]]), ones((5, 3))
    seen = np.arange(5)
    np.savez(
        folder / "facts.npz", names=np.array([*"abcd"]), all_names=np.array([*"abcde"]),
        poses=poses, focal=ones((4, 2)), sizes=ones((4, 2), np.int64), points=points,
        track_lengths=ones(5, np.int64), seen_points=seen, seen_views=seen % 4,
        seen_errors=ones(5), match_views=views, match_points=views, match_rays=ones((2, 2, 3)),
        pairs=pairs, pair_matches=n[:3] + 80, model_sizes=n[:1] + 4,
    )  # fmt: skip
    np.savez(
        folder / "matches.npz", names=np.array([*"abcd"]), n_features=n + 90, coverage=ones(4),
        pairs=pairs, pair_matches=n[:3] + 80, still=ones(3), turns=np.tile(np.eye(3), (3, 1, 1)),
    )  # fmt: skip
    photos = tuple(Photo(f"{name}.jpg", f"/{name}.jpg", 40, 30) for name in "abcd")
    (folder / "photos.json").write_text(json.dumps(PhotoSet(photos).to_json()))


def _read_placement_facts(folder: Path) -> None:
    photos = read_photo_set(folder / "photos.json")
    photos.cameras()
    facts = SfmFacts.load(folder / "facts.npz")
    summary = summarize(facts)
    check_model(facts, summary)
    matches = MatchFacts.load(folder / "matches.npz")
    linked_groups(matches, 15)
    is_still(matches)


TARGETS: Mapping[str, Target] = {
    **{f"splats{s}": _splats(s) for s in (".ply", ".compressed.ply", ".splat", ".spz", ".glb")},
    "splats.ksplat": Target(
        lambda f: (f / "a.ksplat").write_bytes(ksplat(2, 1)[0]),
        lambda f: _used(read_splats(f / "a.ksplat")),
    ),
    "splats.sog": Target(
        lambda f: zipped(f / "a.sog", sog_parts()), lambda f: _used(read_splats(f / "a.sog"))
    ),
    "splats in a SOG folder": Target(_sog_folder, read_splats),
    **{f"masks {form}": _masks(form) for form in FORMS},
    "bank": Target(_bank, lambda f: load_bank(f / "bank.npz")),
    "exported objects": Target(
        _exported, lambda f: run_stage(open_path_stage(f / "out")), "out/groups.json"
    ),
    "project": Target(
        _project, lambda f: run_stage(open_path_stage(f / "a.gaga")), "a.gaga/*"
    ),
    "scene folder": Target(_scene_folder, open_scene_folder, share=10),
    "cameras.json": Target(
        lambda f: write_cameras_json(f / "cameras.json", orbit_cameras(3)),
        lambda f: read_cameras_json(f / "cameras.json"),
    ),
    "colmap text": Target(
        lambda f: write_colmap(f, orbit_cameras(3), np.ones((3, 3)), np.ones((3, 3), np.uint8)),
        read_colmap,
        share=10,
    ),
    "colmap binary": Target(_binary_colmap, read_colmap, share=10),
    "label map": Target(lambda f: _write_map(f / "a.png"), lambda f: read_labels(f / "a.png")),
    "further label maps": Target(
        lambda f: _write_map(f / "a.png"), lambda f: read_further_labels(f / "a.png")
    ),
    "photo": Target(lambda f: _write_map(f / "a.png"), lambda f: read_rgb(f / "a.png")),
    "script": Target(_script, _run_script),
    "report": Target(_report, _read_report),
    "benchmark runs": Target(_runs, lambda f: read_runs(f / "runs.json", {"preset": "paper"})),
    "settings": Target(_make_settings, _read_settings),
    "model lock": Target(_model_lock, read_lock),
    "project edited and saved": Target(
        _project, lambda f: _edit_and_save(f / "a.gaga", f), "a.gaga/*"
    ),
    "scene edited and saved": Target(
        _made_scene, lambda f: _edit_and_save(f / "associated", f), "associated/**/*"
    ),
    "groups of a scene": Target(_made_scene, _read_groups, "associated/**/*"),
    "recovery": Target(_made_scene, _read_recovery, "recovery/*"),
    "recovery note": Target(_made_scene, _read_notes, "recovery/*.json"),
    "command info": Target(_project, _describe, "a.gaga/*"),
    "identity": Target(_identity, _read_identity),
    "classifier": Target(_classified, lambda f: run_stage(open_path_stage(f / "a.ply"))),
    "index": Target(_index, _read_index),
    "gltf folder": Target(
        lambda f: write_gltf(f / "a.gltf", _gaussians()), lambda f: _used(read_splats(f / "a.gltf"))
    ),
    "streamed SOG": Target(_streamed, lambda f: _used(read_splats(f / "web")), "web/**/*", 10),
    "level of detail": Target(_streamed, _read_lod, "lod/*", 10),
    "checkpoints": Target(_checkpoints, _read_checkpoints),
    "film": Target(_film, _read_film, share=10),
    "photos": Target(_photos, _read_photos, share=2),
    "camera path": Target(_camera_path, _read_camera_path),
    "placement facts": Target(_placement_facts, _read_placement_facts),
    **{f"data set {layout}": _dataset(layout) for layout in LAYOUTS},
}  # fmt: skip
