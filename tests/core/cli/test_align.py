"""``gaga align``: two scene folders of one place, from photos on disk to the similarity."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaga_core.io.cameras.colmap import write_colmap
from gaga_core.scene.captures.alignment import difference
from gaga_core.scene.frame import carried_cameras, inverse
from tests.core.cli.calls import Capture, answer, refusal
from tests.core.placing.photo_scenes import photograph, walk_cameras
from tests.core.scene.captures.test_alignment import any_similarity


def write_scene(
    folder: Path, every: int, *, seed: int = 0, world: np.ndarray | None = None
) -> None:
    """Half of the photos of a corner of a room, placed: from ``every`` on each second one."""
    (folder / "images").mkdir(parents=True)
    (folder / "sparse" / "0").mkdir(parents=True)
    cameras = walk_cameras(10)[every::2]
    for camera in cameras:
        picture = Image.fromarray(photograph(camera, seed=seed))
        picture.save(folder / "images" / camera.name, quality=95)
    placed = cameras if world is None else carried_cameras(cameras, world)
    write_colmap(folder / "sparse" / "0", placed, np.zeros((0, 3)), np.zeros((0, 3), np.uint8))


@pytest.fixture
def halves(tmp_path: Path) -> tuple[Path, Path, np.ndarray]:
    world = any_similarity(np.random.default_rng(3))
    write_scene(tmp_path / "a", 0)
    write_scene(tmp_path / "b", 1, world=world)
    return tmp_path / "a", tmp_path / "b", world


def test_two_halves_come_together(halves: tuple[Path, Path, np.ndarray], capsys: Capture) -> None:
    first, second, world = halves
    said = answer(capsys, "align", str(first), str(second))
    file = Path(str(said.pop("file")))
    assert file == first / "gaga" / "align-b.json"
    assert json.loads(file.read_text(encoding="utf-8")) == said
    found = said["alignment"]
    assert isinstance(found, dict)
    turn, scale = difference(inverse(world), np.array(found["first_from_second"]))
    assert np.degrees(turn) < 0.5
    assert scale < 0.005
    assert said["changes"] is None  # there are no splats
    assert sorted(p.name for p in first.iterdir()) == ["gaga", "images", "sparse"]


def test_scenes_of_other_places_are_refused_in_words(tmp_path: Path, capsys: Capture) -> None:
    write_scene(tmp_path / "a", 0)
    write_scene(tmp_path / "b", 1, seed=1)
    said = refusal(capsys, "align", str(tmp_path / "a"), str(tmp_path / "b"))
    assert "place it by hand" in said
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["images", "sparse"]
