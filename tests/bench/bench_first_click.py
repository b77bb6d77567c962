"""The first click on each object of a scene whose groups were made without masks.

ycb_crowd is opened as the window opens it, its objects are found from regions, and each true object
is clicked once in the held-out view that shows most of it, at the pixel of it nearest to the middle
of what shows: with the tool Pick, which selects the group, and with the tool Object, which knows
the groups and more. An object is selected whole from an IoU of 0.75 on; IoU is of splats, each by
the weight with which the views show it. Left out where the scene is not on this machine
(GAGA_TEST_DATA). ``GAGA_CROWD_RUN=FOLDER`` takes what `gaga run` made of the 64 photos in place of
the given poses and splats.
"""

import os
import tempfile
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import numpy as np

from gaga_core.arrays import BoolArray, FloatArray, IntArray
from gaga_core.grouping.votes import vote_labels
from gaga_core.io.folder.scene_folder import SceneFolder
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.masks import resize_labels
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_studio.features.commands import new_session, run
from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings
from tests.app.tools.hand import Hand
from tests.bench.figures import Figure, data_folder

_NAMES = ("images", "sparse", "split.json", "point_cloud.ply")
_FIRST = 2  # id of the first object; before it are void and the table
_HELD_OUT = 8  # every so many views
_WHOLE = 0.75  # IoU
_PATIENCE_S = 3600.0


class _Truth(NamedTuple):
    """What the photos show of the objects."""

    maps: dict[str, IntArray]  # of each view, as large as it
    labels: IntArray  # (N,) of the splats
    weight: FloatArray  # (N,) with which the views show them


def figures() -> list[Figure]:
    """How many of the 26 objects one click selects whole."""
    crowd = data_folder("ycb_crowd")
    if not crowd.is_dir():
        return []
    with (
        tempfile.TemporaryDirectory() as scratch,
        patch.dict(os.environ, GAGA_HOME=f"{scratch}/home"),
    ):
        session = new_session(Settings())
        try:
            made = os.environ.get("GAGA_CROWD_RUN")
            session.open(Path(made) if made else _linked(crowd, Path(scratch) / "crowd"))
            _wait(session)
            if not made:
                for command in ("object.masks_quick", "object.associate"):
                    assert run(command, session)
                    _wait(session)
            return _clicks(session, crowd / "gt" / "instance")
        finally:
            session.shut_down()


def _clicks(session: Session, truth_folder: Path) -> list[Figure]:
    project = session.project
    assert project is not None
    assert project.folder is not None
    truth = _truth(session, project.folder, truth_folder)
    found = []
    for tool in ("pick", "object"):
        assert run(f"tool.{tool}", session)
        _wait(session)
        ious = np.array([_iou(session, truth, k) for k in _objects(truth)])
        name = f"first click: ycb_crowd, tool {tool.capitalize()}"
        whole = float((ious >= _WHOLE).sum())
        found.append(Figure(f"{name}, selected whole", whole, "of 26", ">= 20"))
        found.append(Figure(f"{name}, mean IoU", float(ious.mean()), ""))
    return found


def _truth(session: Session, folder: SceneFolder, truth_folder: Path) -> _Truth:
    scene = session.scene
    assert scene is not None
    maps = {}
    for camera in folder.cameras:
        of_photo = read_labels(truth_folder / f"{Path(camera.name).stem}.png")
        maps[camera.name] = resize_labels(of_photo, camera.width, camera.height)
    n = 1 + max(int(m.max()) for m in maps.values())
    votes = run_stage(
        vote_labels(scene.gaussians, folder.cameras, lambda c: maps[c.name] + 1, n, choose("cpu"))
    )
    return _Truth(maps, np.maximum(votes.labels - 1, 0).astype(np.int32), votes.weight)


def _objects(truth: _Truth) -> list[int]:
    return list(range(_FIRST, 1 + max(int(m.max()) for m in truth.maps.values())))


def _iou(session: Session, truth: _Truth, k: int) -> float:
    """IoU of what one click on object ``k`` selects."""
    run("select.none", session)
    held_out = sorted(truth.maps)[::_HELD_OUT]
    view = max(held_out, key=lambda name: int((truth.maps[name] == k).sum()))
    rows, columns = np.nonzero(truth.maps[view] == k)
    away = (rows - rows.mean()) ** 2 + (columns - columns.mean()) ** 2
    nearest = int(away.argmin())
    camera = next(c for c in session.cameras if c.name == view)
    session.rig.go_to(camera, animated=False)
    hand = Hand(session, (camera.width, camera.height))
    hand.click(columns[nearest] + 0.5, rows[nearest] + 0.5)
    _wait(session)
    chosen: BoolArray = np.zeros(len(truth.labels), np.bool_)
    chosen[session.selected_indices()] = True
    true = truth.labels == k
    both, either = truth.weight[chosen & true].sum(), truth.weight[chosen | true].sum()
    return float(both / either)


def _linked(crowd: Path, folder: Path) -> Path:
    """The scene without masks or truth; nothing is written next to the real files."""
    folder.mkdir()
    for name in _NAMES:
        (folder / name).symlink_to(crowd / name)
    return folder


def _wait(session: Session) -> None:
    assert session.jobs.wait(_PATIENCE_S)
