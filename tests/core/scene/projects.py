"""Projects that are opened, edited, saved and compared."""

from pathlib import Path

import numpy as np

from gaga_core.io.splats.ply import write_ply
from gaga_core.progress import run_stage
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.project import Project, open_path_stage
from gaga_core.scene.scene import Scene, Weight
from tests.scenes import objects_scene

COLUMNS = ("labels", "state", "placement", "source")


def opened(path: Path) -> Project:
    return run_stage(open_path_stage(path))


def model_in(folder: Path) -> Path:
    synthetic = objects_scene()
    path = folder / "model.ply"
    write_ply(path, synthetic.gaussians)
    return path


def edited(project: Project) -> Project:
    """Moves, colors, names, copies and deletions, as a person would leave them."""
    scene = project.scene
    labels = objects_scene().labels
    history = History(scene)
    history.do(edits.set_labels(scene, np.arange(len(scene)), labels, "Groups"))
    turn = np.array([[0, -1, 0, 0.5], [1, 0, 0, 0], [0, 0, 1, 0.25]])
    history.do(edits.transform(scene, np.flatnonzero(labels == 2), turn, "Move"))
    history.do(edits.duplicate(scene, np.flatnonzero(labels == 3)))
    history.do(edits.delete(scene, np.flatnonzero(labels == 4)))
    history.do(edits.rename(scene, 1, "a mug, blue"))
    history.do(edits.set_color(scene, 2, (0.1, 0.5, 1.0)))
    history.do(edits.set_weight(scene, 2, Weight("density", 800.0)))
    history.do(edits.put_in_folder(scene, (1, 2), "Kitchen/Cups"))
    history.do(edits.new_folder(scene, "Empty"))
    return project


def assert_same(a: Scene, b: Scene) -> None:
    for name in COLUMNS:
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
    for name in ("matrix", "color", "opacity"):
        assert np.array_equal(getattr(a.placements, name), getattr(b.placements, name))
    assert a.names == b.names
    assert a.colors == b.colors
    assert a.weights == b.weights
    assert a.folders == b.folders
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        assert np.array_equal(getattr(a.gaussians, name), getattr(b.gaussians, name)), name
