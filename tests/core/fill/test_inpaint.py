"""Colors of a hole by an inpainting model: real TorchScript files, and files that are none."""

import hashlib
import sys
from multiprocessing import active_children
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import pytest
import torch

from gaga_core.color import rgb_from_dc
from gaga_core.edit_script import run_script
from gaga_core.errors import GagaError
from gaga_core.fill.fill import Filling, fill_stage, filled_edit
from gaga_core.fill.inpaint import Inpainter, trial_stage, why_no_model
from gaga_core.fill.surfaces import FillConfig
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.scene.edits.history import History
from gaga_core.scene.scene import Scene
from tests.core.fill import models
from tests.core.fill.tables import BOX, HALF, STEP, Table, table_with_box
from tests.core.scene.edits.edit_walk import snapshot

CPU = choose("cpu")


@pytest.fixture(scope="module")
def table() -> Table:
    return table_with_box()


@pytest.fixture(scope="module")
def red(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return models.saved(models.Red(), tmp_path_factory.mktemp("models") / "red.pt")


@pytest.fixture(autouse=True)
def _fast(programs: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Models run in processes that have torch; that of `found` starts as a user's does."""
    monkeypatch.setattr("gaga_core.fill.inpaint.SpawnContext", lambda: programs)


@pytest.fixture(scope="module")
def found(table: Table, red: Path) -> Filling:
    scene = Scene.of(table.gaussians, table.labels)
    config = FillConfig(lighten=False, model=str(red))
    return run_stage(fill_stage(scene, table.labels == BOX, table.cameras, CPU, config))


def test_the_hole_is_as_the_model_paints_it_and_nothing_else_changes(
    table: Table, found: Filling
) -> None:
    rgb = rgb_from_dc(found.splats.sh[:, 0])
    inner = np.abs(found.splats.means[:, :2]).max(axis=1) < HALF - 2 * STEP
    assert inner.sum() > 50
    assert rgb[inner].mean(axis=0) == pytest.approx([1, 0, 0], abs=0.03)
    assert len(found.stained) == 0, "what views saw keeps its color"
    assert np.array_equal(found.removed, np.flatnonzero(table.labels == BOX))
    assert found.model == "red.pt"


def test_cells_that_are_known_keep_their_colors_and_sides_are_what_a_model_takes(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(0)
    color = rng.random((37, 90, 3))
    known, hole = np.ones((37, 90), np.bool_), np.zeros((37, 90), np.bool_)
    hole[10:20, 30:50] = True
    known[10:20, 30:50] = known[30:] = False  # a hole, and what is no surface
    color[30:] = 0.9
    with Inpainter(models.saved(models.Mean(), tmp_path / "mean.pt")) as model:
        run_stage(model.loaded_stage())
        painted = run_stage(model.painted_stage(color, known, hole))
    assert np.array_equal(painted[~hole], color[~hole])
    assert painted[hole] == pytest.approx(np.full((200, 3), 0.5), abs=0.03)
    run_stage(trial_stage(tmp_path / "mean.pt"))


def test_the_title_names_it(table: Table, found: Filling) -> None:
    scene = Scene.of(table.gaussians, table.labels)
    history = History(scene)
    assert history.do(filled_edit(scene, found, "Delete and fill box"))
    assert history.undo_title == "Delete and fill box, colors by red.pt"


def test_a_script_names_the_file_and_its_digest(
    table: Table, found: Filling, red: Path, tmp_path: Path
) -> None:
    digest = hashlib.sha256(red.read_bytes()).hexdigest()

    def run(**fields: str) -> Scene:
        scene = Scene.of(table.gaussians, table.labels)
        scene.names = {BOX: "box"}
        before, history = snapshot(scene), History(scene)
        script = [{"op": "fill", "groups": ["box"], "lighten": False, **fields}]
        try:
            titles = run_script(scene, script, history, views=lambda: table.cameras)
        except GagaError:
            assert snapshot(scene) == before
            raise
        assert titles == ("Delete and fill box, colors by red.pt",)
        return scene

    first, again = (run(model=str(red), sha256=d) for d in (digest, digest.upper()))
    assert snapshot(first) == snapshot(again)
    assert len(first) - len(table.labels) == len(found.splats)
    with pytest.raises(GagaError, match=rf"red.pt is another file: its SHA-256 is {digest}, not 0"):
        run(model=str(red), sha256="0" * 64)
    with pytest.raises(GagaError, match=r"The inpainting model .*gone\.pt is not there"):
        run(model=str(tmp_path / "gone.pt"))
    with pytest.raises(GagaError, match='give "model", too'):
        run(sha256=digest)
    with pytest.raises(GagaError, match='"sha256" must be 64 hexadecimal digits'):
        run(model=str(red), sha256="abc")


@pytest.mark.parametrize(
    ("model", "sentence"),
    [
        (models.NotANumber(), "returned values that are not finite"),
        (models.Half(), r"returned \(1, 3, 32, 32\) for an image of \(1, 3, 64, 64\)"),
        (models.Bytes(), "returned colors from 255 to 255: 0 to 1 was expected"),
        (models.Pair(), "returned tuple for an image"),
        (models.ImageOnly(), "failed: .*expected at most 2 argument"),
    ],
)
def test_a_model_of_another_kind_is_one_sentence(
    model: torch.nn.Module, sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(GagaError, match=f"The inpainting model odd.pt {sentence}") as caught:
        run_stage(trial_stage(models.saved(model, tmp_path / "odd.pt")))
    assert "\n" not in str(caught.value)


def test_a_file_that_is_none_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "text.pt").write_text("weights")
    torch.save({"weights": torch.zeros(3)}, tmp_path / "state.pt")
    for name in ("text.pt", "state.pt"):
        with pytest.raises(GagaError, match=f"{name} is no inpainting model: it must be a Torch"):
            run_stage(trial_stage(tmp_path / name))
    with pytest.raises(GagaError, match="is not there"):
        Inpainter(tmp_path)


def test_without_torch_it_says_so(red: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert why_no_model() == ""
    with models.no_torch():
        assert "needs PyTorch" in why_no_model()
        with pytest.raises(GagaError, match="needs PyTorch"):
            Inpainter(red)
    assert why_no_model() == ""
    monkeypatch.setitem(sys.modules, "torch", None)
    assert why_no_model() == "", "the disk is asked once: the window asks in every frame"


def test_a_digest_needs_a_model() -> None:
    with pytest.raises(ValueError, match="model_sha256"):
        FillConfig(model_sha256="0" * 64)


def test_a_model_that_never_ends_is_ended_with_the_stage(table: Table, tmp_path: Path) -> None:
    endless = models.saved(models.Endless(), tmp_path / "endless.pt")
    scene = Scene.of(table.gaussians, table.labels)
    config = FillConfig(lighten=False, model=str(endless))
    stage = fill_stage(scene, table.labels == BOX, table.cameras[::3], CPU, config)
    while next(stage).message != "endless.pt paints":
        pass
    (process,) = active_children()
    start = monotonic()
    next(stage)
    stage.close()
    assert monotonic() - start < 2
    assert not process.is_alive()
    assert active_children() == []


def test_a_process_that_dies_is_one_sentence(red: Path) -> None:
    with Inpainter(red) as model:
        run_stage(model.loaded_stage())
        (process,) = active_children()
        process.kill()
        with pytest.raises(GagaError, match=r"red\.pt ended with status -9"):
            run_stage(model.painted_stage(np.zeros((8, 8, 3)), *np.zeros((2, 8, 8), np.bool_)))
