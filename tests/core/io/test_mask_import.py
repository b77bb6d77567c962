"""Masks of other programs: the same true masks in every form people have, read back."""

import json
import re
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaga_core.arrays import BoolArray
from gaga_core.cli.main import main
from gaga_core.errors import GagaError
from gaga_core.io.folder.scene_folder import SceneFolder
from gaga_core.io.images import open_image
from gaga_core.io.masks.coco import encode_rle
from gaga_core.io.masks.label_maps import read_labels, write_labels
from gaga_core.io.masks.other_programs import recognise
from gaga_core.pipeline.import_masks import ImportReport, fits, import_masks, match_views
from gaga_core.progress import run_stage
from gaga_core.segmentation.base import FlattenConfig
from tests.core.io.mask_forms import (
    FORMS,
    NAMES,
    SCORED,
    TRUE,
    H,
    W,
    box,
    label_pngs,
    sam_json,
    scene,
    write,
)
from tests.datasets import mipnerf360, tiny


@pytest.mark.parametrize("form", FORMS)
def test_every_form_gives_the_masks_it_was_made_from(form: str, tmp_path: Path) -> None:
    write_form, said = FORMS[form]
    source = tmp_path / form
    wanted = write_form(source)
    report = run_stage(import_masks(scene(tmp_path / "scene"), source, "theirs"))
    assert re.search(said, report.recognised)
    assert report.views == NAMES
    assert report.without == report.unmatched == report.resized == report.misfits == ()
    out = tmp_path / "scene" / "masks" / "theirs"
    for stem, labels in wanted.items():
        assert np.array_equal(read_labels(out / f"{stem}.png"), labels)
        assert open_image(out / f"{stem}.png").mode.startswith("I;16")
    n_masks = sum(len(np.unique(labels[labels > 0])) for labels in wanted.values())
    assert report.n_masks == n_masks
    saved = json.loads((out / "import.json").read_text())
    assert saved["recognised"] == report.recognised


@pytest.mark.parametrize(
    ("folder", "name", "said"),
    [
        ("object_mask", "object_mask", "Gaussian Grouping, ids already tracked"),
        ("raw_entityseg_mask", "entityseg", "entityseg masks, not associated yet"),
        ("sam_mask", "sam_mask", "associated already"),
        ("CropFormer_out", "entityseg", "of EntitySeg"),
        ("anything", "imported", "3 label maps"),
    ],
)
def test_known_folders_are_called_what_they_are(
    folder: str, name: str, said: str, tmp_path: Path
) -> None:
    label_pngs(tmp_path / folder)
    (tmp_path / folder / "info.json").write_text('{"num_mask": 3}')
    found = recognise(tmp_path / folder)
    assert found.name == name
    assert said in found.said


def test_least_score_is_a_setting(tmp_path: Path) -> None:
    sam_json(tmp_path / "s")
    config = FlattenConfig(min_score=0.0)
    run_stage(import_masks(scene(tmp_path), tmp_path / "s", "all", config=config))
    assert read_labels(tmp_path / "masks" / "all" / "a.b.png").max() == 3


def test_one_picture_alone_can_be_imported(tmp_path: Path) -> None:
    for form, suffix in (("labels", "png"), ("sam json", "json"), ("npz", "npz")):
        wanted = FORMS[form][0](tmp_path / form)
        file = tmp_path / form / f"frame_007.{suffix}"
        report = run_stage(import_masks(scene(tmp_path), file, form.replace(" ", "-")))
        assert report.views == ("frame_007.png",)
        assert len(report.without) == 2
        made = read_labels(Path(report.folder) / "frame_007.png")
        assert np.array_equal(made, wanted["frame_007"])


def test_names_are_matched_exactly_first_and_then_as_programs_write_them() -> None:
    def matched(views: list[str], keys: list[str]) -> tuple[dict[str, str], tuple[str, ...]]:
        return match_views(views, dict.fromkeys(keys))

    views = ["a.b.jpg", "frame_007.png", "frame_010.png"]
    assert matched(views, ["a.b", "frame_010", "x"]) == (
        {"a.b.jpg": "a.b", "frame_010.png": "frame_010"}, ("x",)
    )  # fmt: skip
    assert matched(views, ["a", "a.b"]) == ({"a.b.jpg": "a.b"}, ("a",))
    assert matched(views, ["a"])[0] == {"a.b.jpg": "a"}
    assert matched(views, ["a.b.jpg", "frame_007_mask"])[0] == {
        "a.b.jpg": "a.b.jpg", "frame_007.png": "frame_007_mask"
    }  # fmt: skip
    assert matched(views, ["7", "000010"])[0] == {"frame_007.png": "7", "frame_010.png": "000010"}
    assert matched(["s.1.jpg", "s.2.jpg"], ["s"]) == ({}, ("s",))  # which of the two?
    assert matched(["a1.jpg", "b1.jpg"], ["1"]) == ({}, ("1",))
    assert matched(["7.jpg", "07.jpg"], ["7", "07"])[0] == {"7.jpg": "7", "07.jpg": "07"}
    photos = [f"IMG_{i:04d}.jpg" for i in range(1, 9)]
    assert len(matched(photos, [str(i) for i in range(1, 11)])[0]) == 8
    assert matched(photos, [str(i) for i in range(8)])[0] == {}  # places in a list
    assert matched([f"f{10 * i}.jpg" for i in range(9)], [str(i) for i in range(9)])[0] == {}
    assert matched(["x_mask.png", "x.png"], ["x_mask", "x"])[0] == {
        "x_mask.png": "x_mask", "x.png": "x"
    }  # fmt: skip


def test_sizes_that_fit_are_resized_and_others_are_named(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    folder.mkdir()
    double = TRUE["a.b"].repeat(2, axis=0).repeat(2, axis=1)
    write_labels(folder / "a.b.png", double)
    write_labels(folder / "frame_007.png", TRUE["frame_007"].T)
    write_labels(folder / "other.png", TRUE["frame_007"])
    report = run_stage(import_masks(scene(tmp_path), folder, "s"))
    assert report.resized == report.views == ("a.b.jpg",)
    assert report.misfits == ("frame_007.png",)
    assert report.unmatched == ("other",)
    assert report.without == ("frame_007.png", "frame_010.png")
    assert np.array_equal(read_labels(tmp_path / "masks/s/a.b.png"), TRUE["a.b"])
    assert len(report.notes()) == 5
    camera = scene(tmp_path).cameras[0]
    assert fits((15, 20), camera)
    assert fits((7, 10), camera)  # 7.5 was cut
    assert not fits((40, 30), camera)
    assert not fits((30, 30), camera)


def test_ids_beyond_16_bits_are_numbered_anew(tmp_path: Path) -> None:
    (tmp_path / "s").mkdir()
    np.save(tmp_path / "s" / "frame_007.npy", TRUE["a.b"].astype(np.int64) * 1_000_000)
    run_stage(import_masks(scene(tmp_path), tmp_path / "s", "s"))
    assert np.array_equal(read_labels(tmp_path / "masks/s/frame_007.png"), TRUE["a.b"])


_EMPTY = {"size": [H, W], "counts": [H * W]}  # a run-length mask


def refused(root: Path, source: Path, name: str | None = "new") -> str:
    """The sentence of an import that fails, and leaves nothing."""
    before = sorted(root.rglob("*"))
    with pytest.raises(GagaError) as caught:
        run_stage(import_masks(scene(root), source, name))
    assert sorted(root.rglob("*")) == before
    return str(caught.value)


def test_what_is_no_masks_is_refused_in_one_sentence(tmp_path: Path) -> None:
    root = tmp_path / "scene"
    root.mkdir()
    s = tmp_path / "s"
    s.mkdir()
    assert "holds no masks" in refused(root, s)
    assert "does not exist" in refused(root, tmp_path / "nowhere")
    photo = np.random.default_rng(0).integers(0, 255, (100, 100, 3), np.uint8)
    Image.fromarray(photo).save(s / "a.b.png")
    assert "not a label map" in refused(root, s)
    Image.fromarray(photo).save(s / "a.b.jpg")
    (s / "a.b.png").unlink()
    assert "JPEG" in refused(root, s)
    (s / "a.b.jpg").unlink()
    objects = np.array([{"segmentation": 1}], dtype=object)
    np.save(s / "a.b.npy", objects, allow_pickle=True)
    assert "plain arrays" in refused(root, s)
    (s / "a.b.npy").unlink()
    np.savez(s / "a.b.npz", points=np.zeros((3, 2)))
    assert "points (3, 2)" in refused(root, s)
    np.savez(s / "a.b.npz", masks=np.zeros((3, H, W), np.bool_), scores=np.zeros(2))
    assert "3 masks but 2 scores" in refused(root, s)
    (s / "a.b.npz").unlink()
    for content, said in (
        ({"hello": 1}, "neither COCO nor a list"),
        ([{"segmentation": {"size": [H, W], "counts": [1, 2]}}], "covers 3 pixels"),
        (
            [{"segmentation": {"counts": [1, 2]}}],
            "[0].segmentation: object missing required field size",
        ),
        ([{"segmentation": [[1, 2, 3, 4, 5, 6]]}], "height and width"),
        ([{"segmentation": _EMPTY, "score": 10**400}], "a score that is no number"),
        ([{"segmentation": {"size": [True, W], "counts": [W]}}], "expected int, got bool"),
        (
            {
                "image": {"height": H, "width": W},
                "annotations": [{"segmentation": [[1, 2, 3, 4, 5, 10**400]]}],
            },
            "no list of numbers",
        ),
        ({"images": [{"id": 1}], "annotations": []}, "an id and a file_name"),
        ({"images": [], "annotations": [{"image_id": 3, "segmentation": []}]}, "unknown image"),
    ):
        write(s / "a.b.json", content)
        assert said in refused(root, s)
    (s / "a.b.json").write_text("[")
    assert "not JSON" in refused(root, s)
    (s / "a.b.json").unlink()
    label_pngs(s)
    for stem in TRUE:
        (s / f"{stem}.png").rename(s / f"other_{stem}.png")
    assert "has the name of a photo" in refused(root, s)


@pytest.mark.parametrize("form", ["sam json", "sa-1b", "npz", "npy", "coco.json", "mask folders"])
def test_damage_is_a_plain_sentence(form: str, tmp_path: Path) -> None:
    """Files with flipped, cut or doubled bytes are read, or refused in one sentence."""
    rng = np.random.default_rng(5)
    source = tmp_path / form
    FORMS[form][0](source)
    files = [source] if source.is_file() else sorted(p for p in source.rglob("*") if p.is_file())
    for trial in range(60):
        file = files[trial % len(files)]
        whole = bytearray(file.read_bytes())
        damaged = whole.copy()
        at = int(rng.integers(len(whole)))
        if trial % 3 == 0:
            damaged = whole[:at]
        elif trial % 3 == 1:
            damaged[at : at + 3] = rng.bytes(3)
        else:
            damaged[at:at] = damaged[at : at + 20]
        file.write_bytes(damaged)
        with suppress(GagaError):
            run_stage(import_masks(scene(tmp_path / "scene"), source, f"t{trial}"))
        file.write_bytes(whole)


def test_masks_that_are_there_are_not_lost(tmp_path: Path) -> None:
    label_pngs(tmp_path / "s")
    folder = scene(tmp_path / "scene")
    run_stage(import_masks(folder, tmp_path / "s", "mine"))
    assert "already" in refused(tmp_path / "scene", tmp_path / "s", "mine")
    assert "no name" in refused(tmp_path / "scene", tmp_path / "s", "..")
    own = tmp_path / "scene" / "masks" / "mine"
    assert "nothing to import" in refused(tmp_path / "scene", own, "mine")
    (tmp_path / "s" / "a.b.png").unlink()
    report = run_stage(import_masks(folder, tmp_path / "s", "mine", replace=True))
    assert not (own / "a.b.png").exists()
    assert report.without == ("a.b.jpg",)


def test_a_cancelled_import_leaves_nothing(tmp_path: Path) -> None:
    label_pngs(tmp_path / "s")
    stage = import_masks(scene(tmp_path / "scene"), tmp_path / "s", "mine")
    next(stage)
    next(stage)
    stage.close()
    assert not (tmp_path / "scene").exists()


def test_several_known_folders_are_not_guessed_among(tmp_path: Path) -> None:
    for name in ("raw_sam_mask", "raw_entityseg_mask"):
        label_pngs(tmp_path / name)
    said = refused(tmp_path / "scene_that_is_not", tmp_path)
    assert "several folders of masks: raw_entityseg_mask, raw_sam_mask" in said


def test_folders_of_label_maps_are_no_folders_of_masks(tmp_path: Path) -> None:
    (tmp_path / "masks").mkdir()
    label_pngs(tmp_path / "masks" / "sam")
    assert "holds folders of pictures: sam" in refused(tmp_path / "scene", tmp_path / "masks")


def test_the_command_imports_and_says_what_it_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = mipnerf360(tmp_path / "scene")
    for k, name in names.items():
        file = tmp_path / "theirs" / f"{Path(name).stem}.json"
        found = [{"segmentation": _rle_of(tiny().labels[k] == i)} for i in (1, 2)]
        write(file, found)
    base = ["masks", str(tmp_path / "scene"), "--from", str(tmp_path / "theirs")]
    assert main([*base, "--name", "new", "--json"]) == 0
    said = capsys.readouterr()
    assert "8 JSON lists of masks" in said.err
    assert len(json.loads(said.out)["views"]) == 8
    labels = read_labels(tmp_path / "scene" / "masks" / "new" / "DSC.003.png")
    assert np.array_equal(labels > 0, np.isin(tiny().labels[3], (1, 2)))
    assert main([*base, "--name", "new"]) == 1
    assert "already" in capsys.readouterr().err
    assert main([*base, "--name", "new", "--redo"]) == 0


def _rle_of(mask: BoolArray) -> dict[str, object]:
    return {"size": list(mask.shape), "counts": encode_rle(mask)}


def test_previews_beside_label_maps_are_left_alone(tmp_path: Path) -> None:
    label_pngs(tmp_path / "s")
    for stem in TRUE:
        Image.fromarray(np.zeros((H, W, 3), np.uint8)).save(tmp_path / "s" / f"{stem}.jpg")
    report = run_stage(import_masks(scene(tmp_path), tmp_path / "s"))
    assert report.recognised.startswith("3 label maps")
    assert np.array_equal(read_labels(tmp_path / "masks/imported/a.b.png"), TRUE["a.b"])
    bare = SceneFolder(tmp_path, None, (), {})
    with pytest.raises(GagaError, match="no cameras"):
        run_stage(import_masks(bare, tmp_path / "s"))


def test_reports_are_plain(tmp_path: Path) -> None:
    label_pngs(tmp_path / "s")
    report: ImportReport = run_stage(import_masks(scene(tmp_path), tmp_path / "s"))
    assert report.name == "imported"
    assert json.loads(json.dumps(report.to_json()))["n_masks"] == report.n_masks


@pytest.mark.parametrize(("name", "n"), [("entityseg_lists", 2), ("identity_lists", 1)])
def test_entityseg_keeps_masks_that_others_cover(name: str, n: int, tmp_path: Path) -> None:
    """Published: the rule that drops masks of which a tenth or less is visible is for SAM alone."""
    below, above = box(4, 4, 20, 20), box(4, 4, 20, 19)
    (tmp_path / name).mkdir()
    for stem in SCORED:
        masks, scores = np.stack([below, above]), np.array([0.6, 0.9])
        np.savez(tmp_path / name / f"{stem}.npz", pred_masks=masks, pred_scores=scores)
    report = run_stage(import_masks(scene(tmp_path), tmp_path / name, "new"))
    assert report.n_masks == n * len(SCORED)
