"""The index of pictures: what is looked at, what is kept, how texts are ranked."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import FloatArray, IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.progress import Progress, run_stage
from gaga_core.query.embed import load_embedder
from gaga_core.query.group_facts import group_digests
from gaga_core.query.index import (
    KEEP,
    GroupIndex,
    IndexConfig,
    IndexedViews,
    Shown,
    TextVectors,
    best_views,
    cut_out,
    index_stage,
    load_index,
    n_stale,
    relevancy,
    save_index,
    shown_groups,
)
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.scene import Scene
from tests.core.query.tiny_query_models import write_clip
from tests.scenes import objects_scene

_COLORS = {1: (200, 20, 20), 2: (20, 200, 20), 3: (20, 20, 200), 4: (200, 200, 20)}


@dataclass
class MeanColor:
    """An embedder whose space is color: a picture's vector is its mean color."""

    fingerprint: str = "mean color"
    n_pictures: int = 0
    asked: list[str] = field(default_factory=list)

    def pictures(self, pictures: Sequence[UInt8Array]) -> FloatArray:
        self.n_pictures += len(pictures)
        return _unit(np.array([p.reshape(-1, 3).mean(axis=0) for p in pictures]) - 110)

    def texts(self, texts: Sequence[str]) -> FloatArray:
        self.asked += texts
        known = {"red": (1, 0, 0), "green": (0, 1, 0), "blue": (0, 0, 1), "yellow": (1, 1, 0)}
        rows = [next((c for w, c in known.items() if w in t), (1, 1, 1)) for t in texts]
        return _unit(np.array(rows, np.float64))


def _unit(rows: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> FloatArray:
    return (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32)


def _map(size: tuple[int, int] = (60, 80)) -> IntArray:
    labels = np.zeros(size, np.int32)
    labels[5:25, 5:25], labels[30:50, 5:25] = 1, 2
    labels[5:25, 40:60], labels[30:55, 40:70] = 3, 4
    return labels


def _picture(labels: IntArray) -> UInt8Array:
    picture = np.full((*labels.shape, 3), 128, np.uint8)
    for group, color in _COLORS.items():
        picture[labels == group] = color
    return picture


def _views(n: int = 3) -> IndexedViews:
    camera = Camera(np.eye(3), np.eye(4), 80, 60)
    cameras = [replace(camera, name=f"{i}.png") for i in range(n)]
    return IndexedViews(cameras, lambda _: _map(), lambda _: _picture(_map()))


def _built(embedder: MeanColor, previous: GroupIndex | None = None, salt: int = 0) -> GroupIndex:
    groups = np.array([1, 2, 3, 4], np.int32)
    digests = np.array([11, 22, 33, 44 + salt], np.int64)
    return run_stage(index_stage(groups, digests, _views(), embedder, previous=previous))


# --- crops ----------------------------------------------------------------------------------------


def test_boxes_and_areas_of_a_label_map() -> None:
    shown = {one.group: one for one in shown_groups(0, _map())}
    assert set(shown) == {1, 2, 3, 4}
    assert shown[4].box == (40, 30, 70, 55)
    assert shown[4].score == 30 * 25
    cut = np.zeros((60, 80), np.int32)
    cut[:20, 5:25] = 1  # touches the upper border
    assert 0 < shown_groups(0, cut)[0].score < 20 * 20


def test_best_views_show_most_and_the_first_of_equals() -> None:
    shown = [Shown(1, v, (0, 0, 9, 9), s) for v, s in enumerate((5.0, 9.0, 1.0, 9.0))]
    chosen = best_views([*shown, Shown(2, 0, (0, 0, 9, 9), 3.0)], 2)
    assert {group: [one.view for one in best] for group, best in chosen.items()} == {
        1: [1, 3],
        2: [0],
    }


def test_a_cut_out_is_square_keeps_the_object_and_dims_the_rest() -> None:
    labels = _map()
    picture = np.zeros((60, 80, 3), np.uint8)
    picture[labels == 4] = (250, 0, 0)
    one = next(s for s in shown_groups(0, labels) if s.group == 4)
    plain, dimmed = cut_out(picture, labels, one, 64)
    assert plain.shape == dimmed.shape == (64, 64, 3)
    assert plain[32, 32].tolist() == dimmed[32, 32].tolist() == [250, 0, 0]
    corner = dimmed[32, 1].astype(int)  # left of the object, inside the margin
    assert abs(int(corner[0]) - round((1 - KEEP) * 128)) <= 2
    assert plain[32, 1].max() <= 2


# --- building -------------------------------------------------------------------------------------


def test_groups_are_ranked_by_what_they_look_like() -> None:
    embedder = MeanColor()
    index = _built(embedder)
    texts = TextVectors(index.model, lambda: embedder)
    for group, word in enumerate(("red", "green", "blue", "yellow"), start=1):
        scores = relevancy(index, texts.nouns([word])[0], texts.anything())
        assert index.groups[scores.argmax()] == group
        assert ((scores >= 0) & (scores <= 1)).all()
        assert scores.max() > 0.5
    assert np.allclose(np.linalg.norm(index.vectors, axis=1), 1, atol=1e-5)
    assert index.thumbnails[0].mean(axis=(0, 1)).argmax() == 0


def test_what_fits_anything_as_well_scores_a_half_and_what_no_view_shows_nothing() -> None:
    axes = np.eye(3, dtype=np.float32)
    vectors = np.concatenate([_unit(np.array([[1, 1, 0], [1, 0, 0.0]])), np.zeros((1, 3), "f4")])
    pictures = np.zeros((3, 64, 64, 3), np.uint8)
    index = GroupIndex("m", np.array([1, 2, 3], np.int32), np.arange(3), vectors, pictures)
    half, high, none = relevancy(index, axes[0], axes[1:])
    assert half == pytest.approx(0.5)
    assert high > 0.9
    assert none == 0


def test_progress_grows_to_its_end() -> None:
    groups, steps = np.array([1, 2, 3, 4], np.int32), list[Progress]()
    run_stage(index_stage(groups, np.arange(4), _views(), MeanColor()), steps.append)
    done = [step.done for step in steps]
    assert done == sorted(done)
    assert done[-1] == steps[-1].total
    assert {step.total for step in steps} == {steps[-1].total}


def test_only_what_changed_is_looked_at_again() -> None:
    embedder = MeanColor()
    first = _built(embedder)
    n = embedder.n_pictures
    assert n == 4 * 3 * 2  # groups x views x (plain, dimmed)
    again = _built(embedder, first)
    assert embedder.n_pictures == n
    assert np.array_equal(again.vectors, first.vectors)
    changed = _built(embedder, first, salt=1)
    assert embedder.n_pictures == n + 3 * 2
    assert np.array_equal(changed.vectors, first.vectors)
    other = MeanColor(fingerprint="another model")
    _built(other, first)
    assert other.n_pictures == n


def test_a_group_that_only_changed_its_number_is_not_looked_at_again() -> None:
    embedder = MeanColor()
    first = _built(embedder)
    n = embedder.n_pictures
    groups, digests = np.array([7, 9], np.int32), np.array([33, 11], np.int64)
    moved = run_stage(index_stage(groups, digests, _views(), embedder, previous=first))
    assert embedder.n_pictures == n
    assert np.array_equal(moved.vectors, first.vectors[[2, 0]])
    assert n_stale(first, digests) == 0
    assert n_stale(first, np.array([33, 99], np.int64)) == 1
    assert n_stale(None, digests) == 2


def test_an_index_that_saw_nothing_is_no_obstacle_to_the_next() -> None:
    embedder = MeanColor()
    blank = replace(_views(), labels_of=lambda _: np.zeros((60, 80), np.int32))
    groups, digests = np.array([1, 2], np.int32), np.array([5, 6], np.int64)
    empty = run_stage(index_stage(groups, digests, blank, embedder))
    assert empty.vectors.shape[0] == 2
    digests = np.array([5, 7], np.int64)
    index = run_stage(index_stage(groups, digests, _views(), embedder, previous=empty))
    assert index.vectors.shape == (2, 3)
    assert not index.vectors[0].any()
    assert index.vectors[1].any()


def test_an_index_survives_the_disk_and_damage_is_told(tmp_path: Path) -> None:
    index = _built(MeanColor())
    path = tmp_path / "index.npz"
    assert load_index(path) is None
    save_index(path, index)
    again = load_index(path)
    assert again is not None
    assert again.model == index.model
    for name in ("groups", "digests", "vectors", "thumbnails"):
        assert np.array_equal(getattr(again, name), getattr(index, name)), name
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(GagaError, match="damaged"):
        load_index(path)
    save_index(path, replace(index, vectors=index.vectors * np.float32(1e38)))
    with pytest.raises(GagaError, match="vectors"):  # products with them would overflow
        load_index(path)
    np.savez(path, groups=np.arange(3))
    with pytest.raises(GagaError, match="damaged"):
        load_index(path)


def test_texts_are_embedded_once_and_kept_on_disk(tmp_path: Path) -> None:
    embedder = MeanColor()
    path = tmp_path / "texts.npz"
    texts = TextVectors("mean color", lambda: embedder, path)
    first = texts.of(["red", "green", "red"])
    assert embedder.asked == ["red", "green"]
    assert np.array_equal(first[0], first[2])

    def refuse() -> MeanColor:
        raise AssertionError("the model must not be loaded for texts that are known")

    offline = TextVectors("mean color", refuse, path)
    assert np.array_equal(offline.of(["green"])[0], first[1])
    other = TextVectors("another", lambda: MeanColor("another"), path)
    assert other.of(["green"]).shape == (1, 3)


# --- digests --------------------------------------------------------------------------------------


def test_digests_change_with_what_a_group_looks_like_and_with_nothing_else() -> None:
    made = objects_scene(3, 100)
    scene = Scene.of(made.gaussians, made.labels)
    groups, before = group_digests(scene)
    assert groups.tolist() == [1, 2, 3]
    assert len(set(before.tolist())) == 3
    history = History(scene)
    of_two = np.flatnonzero(scene.labels == 2)
    for build, changes in (
        (lambda: edits.rename(scene, 2, "ball"), False),
        (lambda: edits.select(scene, of_two), False),
        (lambda: edits.hide(scene, of_two), False),
        (lambda: edits.delete(scene, of_two[:1]), True),
        (lambda: edits.set_labels(scene, of_two[:1], 0), True),
        (lambda: edits.transform(scene, of_two, np.eye(3, 4) + np.eye(3, 4, 3)), True),
    ):
        edit = build()
        assert edit is not None
        history.do(edit)
        after = group_digests(scene)[1]
        assert (after[1] != before[1]) == changes, edit.title
        assert np.array_equal(after[[0, 2]], before[[0, 2]]), edit.title
        history.undo()
        assert np.array_equal(group_digests(scene)[1], before)
    renumbered = Scene.of(made.gaussians, np.array([0, 8, 5, 9], np.int32)[made.labels])
    ids, digests = group_digests(renumbered)
    assert ids.tolist() == [5, 8, 9]
    assert digests.tolist() == before[[1, 0, 2]].tolist()


# --- models ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("siglip", [False, True])
def test_a_folder_with_a_model_embeds_pictures_and_texts(tmp_path: Path, siglip: bool) -> None:
    model = load_embedder(write_clip(tmp_path / "model", siglip=siglip), "cpu")
    pictures = [_picture(_map())[:60, :60], np.zeros((10, 10, 3), np.uint8)]
    rows, words = model.pictures(pictures), model.texts(["a red chair", "FOX"])
    assert rows.shape == words.shape == (2, 32 if siglip else 16)
    assert np.allclose(np.linalg.norm(rows, axis=1), 1, atol=1e-5)
    assert np.allclose(model.pictures(pictures), rows)
    assert np.allclose(model.pictures(pictures[1:]), rows[1:], atol=1e-5)  # batches do not matter
    assert np.allclose(model.texts(["fox"]), words[1:], atol=1e-5)
    config = IndexConfig(crop=32)
    groups, digests = np.array([1, 2, 3, 4], np.int32), np.arange(4)
    index = run_stage(index_stage(groups, digests, _views(1), model, config=config))
    assert index.vectors.shape == (4, rows.shape[1])
    other = load_embedder(write_clip(tmp_path / "other", siglip=siglip, seed=1), "cpu")
    assert other.fingerprint != model.fingerprint


def test_our_preprocessing_is_that_of_transformers(tmp_path: Path) -> None:
    transformers = pytest.importorskip("transformers", reason="transformers is not installed")
    import torch

    model = load_embedder(write_clip(tmp_path / "model"), "cpu")
    rng = np.random.default_rng(0)
    picture = rng.integers(0, 255, (50, 50, 3), dtype=np.uint8)
    processor = transformers.CLIPImageProcessorPil(
        size={"shortest_edge": 32}, crop_size={"height": 32, "width": 32}
    )
    given = processor(images=[picture], return_tensors="pt")
    with torch.inference_mode():
        found = transformers.CLIPModel.from_pretrained(tmp_path / "model").get_image_features(
            **given
        )
    theirs = getattr(found, "pooler_output", found)[0].numpy()
    assert np.allclose(model.pictures([picture])[0], theirs / np.linalg.norm(theirs), atol=2e-3)


def test_folders_that_hold_no_such_model_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("transformers", reason="transformers is not installed")
    with pytest.raises(GagaError, match=r"no config\.json"):
        load_embedder(tmp_path)
    (tmp_path / "config.json").write_text('{"model_type": "bert"}')
    with pytest.raises(GagaError, match="no CLIP or SigLIP"):
        load_embedder(tmp_path)
    (tmp_path / "config.json").write_text('{"model_type": "clip"}')
    with pytest.raises(GagaError, match="cannot be loaded"):
        load_embedder(tmp_path)
    whole = write_clip(tmp_path / "whole")
    weights = whole / "model.safetensors"
    weights.write_bytes(weights.read_bytes()[:-100])
    with pytest.raises(GagaError, match="Copy the whole folder again"):
        load_embedder(whole)
