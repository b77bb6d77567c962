"""The tables of a benchmark: ours next to published figures, and how each was made."""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray
from gaga_core.cli.main import main
from gaga_core.errors import GagaError
from gaga_core.evaluate.benchmark.run import run_benchmark
from gaga_core.evaluate.benchmark.tables import BenchmarkReport, InstanceScores
from gaga_core.evaluate.published import INSTANCE, departures, published_drop
from gaga_core.evaluate.settings import BenchmarkConfig
from gaga_core.grouping.bank_file import read_groups
from gaga_core.grouping.votes import splat_groups
from gaga_core.io.datasets import DATASETS, open_dataset
from gaga_core.io.folder.scene_folder import read_model, select_views
from gaga_core.io.folder.splits import SCANNET_LISTS
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.pipeline.settings import GroupSettings, IdentitySettings
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.datasets import (
    gaga_replica,
    gaga_scannet,
    lerf_mask,
    mipnerf360,
    scrambled,
    semantic_nerf,
    tiny,
    write_map,
)


def test_tables_tell_ours_and_the_published_figures(report: BenchmarkReport) -> None:
    first, void_free, sparse, apart = (table.table() for table in report.tables())
    for row, bare, scene in zip(first[1:3], void_free[1:3], report.scenes, strict=True):
        scores = scene.runs[0].scores
        assert isinstance(scores, InstanceScores)
        for cells, score in ((row, scores.with_void), (bare, scores.without_void)):
            figures = (score.iou, score.precision, score.recall)
            assert cells[1:4] == [f"{100 * value:.2f}" for value in figures]
    values = [[float(cell) for cell in row[1:4]] for row in first[1:3]]
    assert first[3][0] == "mean of 2 scenes"
    assert [float(cell) for cell in first[3][1:4]] == pytest.approx(np.mean(values, 0), abs=0.006)
    assert len(first) == 4  # two of eight scenes: the published means stand apart
    assert {row[0]: row[1:] for row in apart[1:]}["Gaga, SAM"] == ["46.21", "39.53", "50.62"]
    assert len(apart) == 1 + len(INSTANCE["replica"])
    assert len(void_free) == 4
    assert [row[0] for row in sparse] == ["train views", "100%", "50%"]
    whole, half = (float(row[2]) for row in sparse[1:])
    assert whole == float(first[3][1])
    assert sparse[2][3] == f"{100 * (whole - half) / whole:.1f} %"
    run = report.scenes[0].run(0.5)
    assert run is not None
    assert run.n_views == 2
    saved = json.loads((Path(report.out) / "office_0.json").read_text())
    assert [entry["share"] for entry in saved["runs"]] == [1.0, 0.5]
    assert report.to_json()["means"] == {
        "1.0": pytest.approx(whole / 100, abs=1e-4),
        "0.5": pytest.approx(half / 100, abs=1e-4),
    }


def test_each_table_names_how_identities_were_made(replica: Path, tmp_path: Path) -> None:
    """Preset paper trains them as published; the groups alone are scored with "none"."""
    assert BenchmarkConfig(preset="paper").lifted_by == "paper"
    assert BenchmarkConfig(preset="robust").lifted_by == "vote"
    with pytest.raises(GagaError, match="no lift"):
        BenchmarkConfig(lift="magic")  # type: ignore[arg-type]
    few = IdentitySettings(pixels=16384, lift_iterations=50)
    named = BenchmarkConfig(preset="released", identities=few, groups=GroupSettings(threshold=0.2))
    how = "identities by paper, 16,384 pixels a view, 50 steps"
    assert named.title == f"released, threshold 0.2, {how}"
    assert BenchmarkConfig(preset="released").title == "released, identities by paper"
    config = BenchmarkConfig(preset="paper", lift="none")
    data = open_dataset("replica", replica, ("office_0",))
    bare = run_stage(run_benchmark(data, tmp_path, config))
    assert bare.tables()[0].table()[0][0] == "Replica, paper, labels by vote"
    root = Path(bare.out) / "office_0" / "views_all"
    gaussians = run_stage(read_model(data.scenes[0].folder))
    own = replace(data.scenes[0].folder, root=root)
    labels = read_groups(own, len(gaussians))[0]
    for camera in select_views(own, "test"):
        written = read_labels(root / "groups" / Path(camera.name).with_suffix(".png").name)
        assert np.array_equal(written, splat_groups(choose(), gaussians, camera, labels))


def test_published_figures_stand_next_to_ours_only_when_measured_alike(
    report: BenchmarkReport,
) -> None:
    """All scenes, the publisher's split and truth, masks of its segmenters: else apart."""
    office = report.scenes[0]
    names = DATASETS["replica"].scenes
    whole = replace(report, scenes=tuple(replace(office, scene=name) for name in names))
    assert whole.departures() == []
    title = "published (comparison on Replica): Gaga, SAM"
    first = [row[0] for row in whole.tables()[0].table()]
    assert title in first
    assert "published, SAM" not in whole.tables()[-1].table()[0]  # splats of all views
    assert "--retrain-sparse" in " ".join(whole.tables()[-1].notes)
    whole = replace(whole, is_retrained=True)
    assert "published, SAM" in whole.tables()[-1].table()[0]
    usual = office.conditions
    changes = {
        "split.json": replace(usual, split="split.json"),
        "instance-filt (raw)": replace(usual, truth="instance-filt (raw)"),
        "regions": replace(usual, masks="regions"),
        "samples": replace(usual, masks="samples (made elsewhere)"),
        "raw_sam_mask": replace(usual, masks="raw_sam_mask (regions (no model))"),
        "SAM 2.1": replace(usual, masks="sam (SAM 2.1 Hiera tiny)"),
        "SAM-HQ": replace(usual, masks="sam (SAM-HQ ViT-H)"),
        "ViT-B": replace(usual, masks="sam (SAM ViT-B)"),
        "sam_vit_l": replace(usual, masks="own (sam (sam_vit_l_0b3195.pth))"),
        "32 points": replace(usual, masks="sam (SAM ViT-H, 32 points a side, predicted IoU 0.88)"),
    }
    of_paper = "mine (SAM ViT-H, 64 points a side, predicted IoU 0.7)"
    for masks in (of_paper, "raw_sam_mask (made elsewhere)", "raw_entityseg_mask (made elsewhere)"):
        assert departures("replica", "office_0", replace(usual, masks=masks)) == ()
    for value, conditions in changes.items():
        other = replace(office, conditions=conditions)
        one = replace(whole, scenes=(other, *whole.scenes[1:]))
        assert title not in [row[0] for row in one.tables()[0].table()]
        assert "published, SAM" not in one.tables()[2].table()[0]
        assert any(value in note for note in one.tables()[-1].notes)
        assert "Gaga, SAM" in [row[0] for row in one.tables()[-1].table()]
    fewer = replace(whole, scenes=whole.scenes[1:])
    assert title not in [row[0] for row in fewer.tables()[0].table()]


def test_every_table_says_how_it_was_made(report: BenchmarkReport) -> None:
    for table in report.tables()[:3]:
        said = "\n".join(table.notes)
        assert "Split: names train_* and test_* (office_0)." in said
        assert "Truth: semantic_instance." in said
        assert "Masks: raw_sam_mask (made elsewhere)." in said
        assert "Counted" in said
        assert "Scenes: 2 of the 8 of the published means, without office_1" in said
        assert "Splats: as found" in said
    assert "splats of all training views are used" in "\n".join(report.tables()[2].notes)


def test_published_drops_are_those_that_the_paper_prints() -> None:
    """5.61 % is printed for 30 % of the views of Replica with masks of SAM."""
    assert round(100 * published_drop("replica", "SAM", 0.3), 2) == 5.61


def test_the_means_of_scannet_are_over_the_seven_scenes_of_the_paper(
    report: BenchmarkReport,
) -> None:
    """Further scenes, the eighth of DM-NeRF among them, have tables of their own."""
    names = DATASETS["scannet"].scenes
    assert len(names) == 7
    scene = report.scenes[0]
    alike = replace(scene.conditions, truth="ins_full", split=SCANNET_LISTS)
    of_paper = tuple(replace(scene, scene=name, conditions=alike) for name in names)
    further = tuple(replace(scene, scene=f"scene{n}_00") for n in ("0024", "0050"))
    both = replace(report, dataset="scannet", title="ScanNet", scenes=(*of_paper, *further))
    alone = replace(both, scenes=of_paper)
    assert both.tables()[: len(alone.tables())] == alone.tables()
    assert "mean of 7 scenes" in [row[0] for row in both.tables()[0].table()]
    assert any("published" in row[0] for row in both.tables()[0].table())
    rest = both.tables()[len(alone.tables()) :]
    assert [row[0] for row in rest[0].table()[1:]] == [
        "scene0024_00",
        "scene0050_00",
        "mean of 2 scenes",
    ]
    assert not any("published" in cell for table in rest for row in table.table() for cell in row)


_TABLES: Mapping[str, tuple[Callable[[Path], object], tuple[str, ...]]] = {
    "replica": (gaga_replica, DATASETS["replica"].scenes),
    "scannet": (gaga_scannet, (*DATASETS["scannet"].scenes, "scene0024_00", "scene0050_00")),
    "lerf-mask": (lerf_mask, DATASETS["lerf-mask"].scenes),
    "mipnerf360": (mipnerf360, ("bonsai", "garden")),
}


@pytest.mark.parametrize("dataset", _TABLES)
def test_each_data_set_of_the_paper_prints_its_rows(
    dataset: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Scenes of the true names; published rows next to ours where the protocol is the same."""
    write, names = _TABLES[dataset]
    for name in names:
        write(tmp_path / "data" / name)
    how = ("--preset", "released", "--lift", "vote", "--json")
    assert main(["benchmark", dataset, str(tmp_path / "data"), *how]) == 0
    first, *others = json.loads(capsys.readouterr().out)["tables"]
    rows = [row[0] for row in first[1:]]
    own = [name for name in names if name in DATASETS[dataset].scenes] or list(names)
    beside = [f"published ({p.table}): {p.method}, {p.masks}" for p in INSTANCE.get(dataset, ())]
    if dataset == "mipnerf360":
        assert rows == own
        return
    assert rows == [*own, f"mean of {len(own)} scenes", *beside]
    assert ", released, identities by vote" in first[0][0]
    heads = [table[0][0] for table in others]
    assert any("further scenes" in head for head in heads) == (len(own) < len(names))
    # Prompts were answered by words: LERF-Mask's figures are apart, with the reason.
    apart = [table for table in others if "measured in another way" in table[0][0]]
    assert len(apart) == (dataset == "lerf-mask")
    assert [row[0] for table in apart for row in table[1:]] == (own if apart else [])


# --- One scene of Replica as its publishers lay it out scores the same, padded names or not.


_CROSSING = (2, 10, 30, 100)  # numbers whose order as text is another one
_LAYOUTS: dict[str, Callable[[Path], dict[int, str]]] = {
    "Gaga, padded": gaga_replica,
    "Gaga, not padded": lambda root: gaga_replica(root, numbers=_CROSSING, digits=0),
    "Semantic-NeRF": lambda root: semantic_nerf(root, first=0),
    "Semantic-NeRF, padded": lambda root: semantic_nerf(root, first=0, digits=4),
    "Gaga, the other way round": lambda root: gaga_replica(root, numbers=(3, 2, 1, 0)),
}


def _scores(root: Path, layout: str) -> DoubleArray:
    """IoU, precision, recall of the preset paper in percent, with void and without.

    The masks of the first view join two balls: what the bank makes of it depends on the order.
    """
    names = _LAYOUTS[layout](root / "data" / "office_0")
    first = np.where(tiny().labels[0] == 2, 1, tiny().labels[0]).astype(np.int32)
    stem = Path(names[0]).stem
    write_map(root / "data" / "office_0" / "raw_sam_mask" / f"{stem}.png", scrambled(first, 0))
    config = BenchmarkConfig(preset="paper", lift="none")
    report = run_stage(run_benchmark(open_dataset("replica", root / "data"), root / "out", config))
    assert not report.failed
    scores = report.scenes[0].runs[0].scores
    assert isinstance(scores, InstanceScores)
    both = (scores.with_void, scores.without_void)
    return np.array([100 * v for s in both for v in (s.iou, s.precision, s.recall)])


@pytest.fixture(scope="module")
def padded(
    tmp_path_factory: pytest.TempPathFactory,
) -> DoubleArray:
    return _scores(tmp_path_factory.mktemp("padded"), "Gaga, padded")


@pytest.mark.parametrize("layout", list(_LAYOUTS)[1:-1])
def test_layout_and_padding_change_no_score(
    layout: str, padded: DoubleArray, tmp_path: Path
) -> None:
    assert np.abs(_scores(tmp_path, layout) - padded).max() < 0.1


def test_the_order_of_views_would_show(padded: DoubleArray, tmp_path: Path) -> None:
    """Views in another order do give other scores: the tests above would see it."""
    assert np.abs(_scores(tmp_path, "Gaga, the other way round") - padded).max() > 1
