"""Asking a scene folder: index and names kept beside it, a detector in a view, models by name."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import AnyArray, FloatArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.color import rgb_from_dc
from gaga_core.errors import GagaError
from gaga_core.pipeline.search import (
    INDEX_FILE,
    TEXTS_FILE,
    Pictures,
    find_in_view,
    index_scene,
    pictures_of,
    refresh_index,
    search,
    stale_groups,
    suggested_names,
    train_views,
)
from gaga_core.progress import run_stage
from gaga_core.query.detector import Boxes, DetectConfig, as_boxes
from gaga_core.query.embed import find_any, folder_of
from gaga_core.raster import choose
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.project import Project, open_path_stage
from gaga_core.scene.scene import Scene
from gaga_core.segmentation.models.catalogue import KNOWN_DETECTORS, KNOWN_EMBEDDERS
from tests.app.folders import write_scene
from tests.core.query.tiny_query_models import write_clip
from tests.scenes import Synthetic, objects_scene

_GRID = np.stack(np.meshgrid(*[np.linspace(0, 255, 6)] * 3), axis=-1).reshape(-1, 3)


class ColorWords:
    """An embedder whose space is color: "ball 3" is the color of ball 3 of the made scene."""

    fingerprint = "color words"

    def __init__(self, made: Synthetic) -> None:
        self.n_pictures = self.n_texts = 0
        self._colors = {}
        for k in range(1, int(made.labels.max()) + 1):
            own = made.gaussians.sh[made.labels == k, 0]
            self._colors[f"ball {k}"] = rgb_from_dc(own).mean(axis=0) * 255

    def pictures(self, pictures: Sequence[UInt8Array]) -> FloatArray:
        self.n_pictures += len(pictures)
        thirds = [slice(p.shape[0] // 3, 2 * p.shape[0] // 3) for p in pictures]
        middle = [p[third, third] for p, third in zip(pictures, thirds, strict=True)]
        return _near_colors([m.reshape(-1, 3).mean(axis=0) for m in middle])

    def texts(self, texts: Sequence[str]) -> FloatArray:
        self.n_texts += len(texts)
        found = [next((c for w, c in self._colors.items() if t.endswith(w)), None) for t in texts]
        return _near_colors([np.full(3, -300.0) if c is None else c for c in found])


def _near_colors(colors: Sequence[AnyArray]) -> FloatArray:
    """Unit vectors that are the more alike the nearer two colors are."""
    gap = ((np.array(colors, np.float64)[:, None] - _GRID) ** 2).sum(axis=2)
    values = np.exp(-(gap - gap.min(axis=1, keepdims=True)) / 50.0**2)
    result: FloatArray = values / np.linalg.norm(values, axis=1, keepdims=True)
    return result.astype(np.float32)


@pytest.fixture
def made(tmp_path: Path) -> tuple[Synthetic, Project]:
    """A scene folder whose true groups are in gaga/labels.npz."""
    synthetic = write_scene(tmp_path / "scene", masks=False)
    work = tmp_path / "scene" / "gaga"
    work.mkdir()
    confidence = np.ones(len(synthetic.labels), np.float32)
    np.savez(work / "labels.npz", labels=synthetic.labels, confidence=confidence)
    return synthetic, run_stage(open_path_stage(tmp_path / "scene"))


def test_an_index_answers_nouns_that_are_in_no_name(made: tuple[Synthetic, Project]) -> None:
    synthetic, project = made
    words = ColorWords(synthetic)
    cameras = train_views(project)
    assert 0 < len(cameras) < 8  # test views take no part
    assert pictures_of(project, lambda: words) is None
    before = search(project.scene, "ball 3", cameras=cameras)
    assert before.unknown == ("ball 3",)
    run_stage(refresh_index(project, words))
    pictures = pictures_of(project, lambda: words)
    assert pictures is not None
    for group in range(1, 6):
        answer = search(project.scene, f"ball {group}", cameras=cameras, pictures=pictures)
        assert answer.groups[0] == group
        assert not answer.unknown
    project.scene.names[2] = "ball 3"  # what a person calls so comes first
    named = search(project.scene, "ball 3", cameras=cameras, pictures=pictures)
    assert named.groups[0] == 2


def test_an_index_is_kept_and_only_what_changed_is_looked_at(
    made: tuple[Synthetic, Project],
) -> None:
    synthetic, project = made
    words = ColorWords(synthetic)
    index = run_stage(refresh_index(project, words))
    work = project.default_path
    assert (work / INDEX_FILE).is_file()
    n = words.n_pictures
    run_stage(refresh_index(project, words))
    assert words.n_pictures == n
    assert stale_groups(project.scene, index) == 0
    history = History(project.scene)
    edit = edits.delete(project.scene, np.flatnonzero(project.scene.labels == 4)[:40])
    assert edit is not None
    history.do(edit)
    assert stale_groups(project.scene, index) == 1
    run_stage(refresh_index(project, words))
    assert 0 < words.n_pictures - n <= 8
    history.undo()
    n = words.n_pictures
    (work / INDEX_FILE).write_bytes(b"damaged")
    with pytest.raises(GagaError, match="damaged"):
        pictures_of(project, lambda: words)
    again = run_stage(refresh_index(project, words))  # built again, all of it
    assert words.n_pictures > n
    assert np.allclose(again.vectors, index.vectors, atol=1e-5)


def test_without_groups_or_views_it_is_said_what_is_missing(
    made: tuple[Synthetic, Project],
) -> None:
    synthetic, project = made
    words = ColorWords(synthetic)
    with pytest.raises(GagaError, match="needs the views"):
        run_stage(index_scene(project.scene, (), words))
    with pytest.raises(GagaError, match="no groups"):
        run_stage(index_scene(Scene.of(synthetic.gaussians), synthetic.cameras, words))
    assert words.n_pictures == 0


def test_cancelling_an_index_keeps_the_last_one(made: tuple[Synthetic, Project]) -> None:
    synthetic, project = made
    words = ColorWords(synthetic)
    run_stage(refresh_index(project, words))
    files = {p.name: p.read_bytes() for p in project.default_path.iterdir() if p.is_file()}
    project.scene.labels = np.where(project.scene.labels == 1, 2, project.scene.labels)
    n_steps = sum(1 for _ in refresh_index(project, ColorWords(synthetic)))
    assert n_steps > 4
    for name, content in files.items():
        (project.default_path / name).write_bytes(content)
    stage = refresh_index(project, words)
    for _ in range(n_steps - 2):
        next(stage)
    stage.close()
    now = {p.name: p.read_bytes() for p in project.default_path.iterdir() if p.is_file()}
    assert now == files


def test_moved_objects_are_looked_at_where_they_stand(made: tuple[Synthetic, Project]) -> None:
    """After a move the photos lie, so the splats are rendered."""
    synthetic, project = made
    scene, words = project.scene, ColorWords(synthetic)
    photos = 0

    def photo(camera: Camera) -> UInt8Array:
        nonlocal photos
        photos += 1
        return np.zeros((camera.height, camera.width, 3), np.uint8)

    run_stage(index_scene(scene, train_views(project), words, photo_of=photo))
    assert photos > 0
    photos = 0
    shift = np.concatenate([np.eye(3), np.array([[0], [0], [0.3]])], axis=1)
    edit = edits.transform(scene, np.flatnonzero(scene.labels == 1), shift)
    assert edit is not None
    History(scene).do(edit)
    index = run_stage(index_scene(scene, train_views(project), words, photo_of=photo))
    assert photos == 0
    assert len(index) == 5


def test_groups_are_named_once_and_texts_need_no_model_again(
    made: tuple[Synthetic, Project], monkeypatch: pytest.MonkeyPatch
) -> None:
    synthetic, project = made
    words = ColorWords(synthetic)
    run_stage(refresh_index(project, words))
    pictures = pictures_of(project, lambda: words)
    assert pictures is not None
    nouns = tuple(f"ball {k}" for k in range(1, 6))
    monkeypatch.setattr("gaga_core.query.auto_names.NOUNS", nouns)
    project.scene.names = {2: "my ball"}
    found = suggested_names(project.scene, pictures)
    assert found
    assert 2 not in found
    assert all(name == f"ball {group}" for group, name in found.items())
    assert (project.default_path / TEXTS_FILE).is_file()

    def refuse() -> ColorWords:
        raise AssertionError("known texts need no model")

    kept = pictures_of(project, refuse)
    assert kept is not None
    assert suggested_names(project.scene, kept) == found


# --- in a view ------------------------------------------------------------------------------------


class BoxOf:
    """A detector that knows where a ball is drawn: the box of the true group map."""

    def __init__(self, made: Synthetic, group: int, score: float = 0.8) -> None:
        self._made, self._group, self._score = made, group, score
        self.pictures: list[UInt8Array] = []

    def detect(self, picture: UInt8Array, phrase: str, config: DetectConfig) -> Boxes:
        self.pictures.append(picture)
        camera = self._made.cameras[len(self.pictures) - 1]
        frame = choose("cpu").label_splat(self._made.gaussians, camera, self._made.labels)
        rows, columns = np.nonzero(frame.labels == self._group)
        if len(rows) == 0:
            return as_boxes(np.zeros((0, 4), np.float32), [], picture.shape[:2])
        box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        return as_boxes([box], [self._score], picture.shape[:2])


def test_a_box_in_a_view_means_the_group_that_is_drawn_there() -> None:
    made = objects_scene(6, 300)
    scene = Scene.of(made.gaussians, made.labels)
    for group in (1, 3, 5):
        detector = BoxOf(made, group)
        answer = run_stage(find_in_view(scene, made.cameras[:1], "a ball", detector))
        assert answer.groups[0] == group
        assert "“a ball”" in answer.sentence
        assert detector.pictures[0].shape == (120, 160, 3)
    several = run_stage(find_in_view(scene, made.cameras[:3], "a ball", BoxOf(made, 2)))
    assert several.groups[0] == 2
    assert several.scores[0] == 1
    nothing = run_stage(find_in_view(scene, made.cameras[:1], "a fox", BoxOf(made, 99)))
    assert (len(nothing.groups), nothing.n_meant) == (0, 0)
    assert nothing.sentence.startswith("The detector finds no")
    with pytest.raises(ValueError, match="views"):
        run_stage(find_in_view(scene, (), "a ball", BoxOf(made, 1)))


def test_hidden_objects_are_not_found_in_a_view() -> None:
    made = objects_scene(6, 300)
    scene = Scene.of(made.gaussians, made.labels)
    edit = edits.hide(scene, np.flatnonzero(scene.labels == 3))
    assert edit is not None
    History(scene).do(edit)
    answer = run_stage(find_in_view(scene, made.cameras[:1], "a ball", BoxOf(made, 3)))
    assert 3 not in answer.groups


# --- models by name -------------------------------------------------------------------------------


def test_models_are_found_by_path_by_name_and_in_the_hub_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("transformers", reason="transformers is not installed")
    monkeypatch.setenv("GAGA_MODELS", str(tmp_path / "models"))
    cache = tmp_path / "hub"
    with pytest.raises(GagaError, match="CLIP ViT-B/32 is not on this computer") as caught:
        folder_of("clip-base", KNOWN_EMBEDDERS, cache)
    for said in ("openai/clip-vit-base-patch32", "605 MB", "MIT", str(tmp_path / "models")):
        assert said in str(caught.value)
    with pytest.raises(GagaError, match="one of grounding-dino-tiny"):
        folder_of("yolo", KNOWN_DETECTORS, cache)
    assert find_any(KNOWN_EMBEDDERS, cache) is None
    snapshot = cache / "models--openai--clip-vit-base-patch32" / "snapshots" / ("a" * 40)
    write_clip(snapshot)
    refs = snapshot.parents[1] / "refs"
    refs.mkdir()
    (refs / "main").write_text("a" * 40)
    assert folder_of("clip-base", KNOWN_EMBEDDERS, cache) == snapshot
    assert find_any(KNOWN_EMBEDDERS, cache) == snapshot
    own = write_clip(tmp_path / "models" / "clip-base")
    assert folder_of("clip-base", KNOWN_EMBEDDERS, cache) == own
    assert folder_of(snapshot, KNOWN_EMBEDDERS, cache) == snapshot
    mine = write_clip(tmp_path / "models" / "my-clip")
    assert folder_of("my-clip", KNOWN_EMBEDDERS, cache) == mine


def test_pictures_only_score_groups_that_they_know(made: tuple[Synthetic, Project]) -> None:
    synthetic, project = made
    words = ColorWords(synthetic)
    index = run_stage(refresh_index(project, words))
    pictures = pictures_of(project, lambda: words)
    assert pictures is not None
    labels = project.scene.labels.copy()
    labels[:50] = 77  # a group that came later
    project.scene.labels = labels
    project.scene.revision.labels += 1
    answer = search(
        project.scene,
        "ball 1",
        cameras=train_views(project),
        pictures=Pictures(index, pictures.texts),
    )
    assert answer.groups[0] == 1
    assert 77 not in answer.groups
