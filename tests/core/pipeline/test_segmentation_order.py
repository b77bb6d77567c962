"""The order of photos: what tells most first, and a run that stops early keeps it."""

from pathlib import Path

import numpy as np

from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.pipeline.segment import coverage_order, greedy_cover, segment_scene, visible
from gaga_core.pipeline.settings import SegmentConfig
from gaga_core.progress import run_stage
from tests.app.folders import write_scene
from tests.core.segmentation.fake_provider import Quarters
from tests.scenes import objects_scene
from tests.shares import falls


def test_every_photo_adds_most_to_those_before_it() -> None:
    """The law of the greedy cover, on random views."""
    sees = np.random.default_rng(3).random((9, 400)) < np.linspace(0.05, 0.6, 9)[:, None]
    order = greedy_cover(sees)
    assert sorted(order) == list(range(9))
    times = np.zeros(400)
    for at, chosen in enumerate(order):
        gains = {int(i): float((sees[i] * 0.5**times).sum()) for i in order[at:]}
        assert gains[int(chosen)] >= max(gains.values()) - 1e-3
        times += sees[chosen]


def test_copies_of_a_photo_come_last() -> None:
    scene = objects_scene(n_objects=4, per_object=60, n_cameras=6)
    cameras = [*[scene.cameras[0]] * 3, *scene.cameras[1:]]
    order = run_stage(coverage_order(scene.gaussians, cameras)).tolist()
    first_five = order[:5]
    assert len({0, 1, 2} & set(first_five)) <= 1, "one of the three equal photos says it all"


def test_what_stands_in_front_hides_what_is_behind() -> None:
    camera = objects_scene(n_objects=1, per_object=10, n_cameras=1).cameras[0]
    ray = np.array([camera.unproject(camera.width / 2, camera.height / 2, d) for d in (2.0, 5.0)])
    aside = camera.unproject(4.0, 4.0, 5.0)
    behind_the_camera = camera.unproject(camera.width / 2, camera.height / 2, -2.0)
    shown = visible(np.array([*ray, aside, behind_the_camera]), camera)
    assert shown.tolist() == [True, False, True, False]


def test_a_run_that_stops_early_keeps_the_telling_photos(tmp_path: Path) -> None:
    write_scene(tmp_path / "balls", masks=False)
    few_photos = open_scene_folder(tmp_path / "balls")
    other, ordered = Quarters(setting=2, name="all"), SegmentConfig(order="coverage")
    whole = run_stage(segment_scene(few_photos, other, config=ordered))
    assert sorted(whole.made) == sorted(few_photos.train)
    config = SegmentConfig(order="coverage", stop_after=1e-9)
    stopped = run_stage(segment_scene(few_photos, Quarters(), config=config))
    assert stopped.made == whole.made[:1]
    assert sorted(stopped.left) == sorted(set(few_photos.train) - set(stopped.made))
    assert any("have no masks yet" in note for note in stopped.notes)
    rest = run_stage(segment_scene(few_photos, Quarters(), config=ordered))
    assert rest.kept == stopped.made
    assert rest.left == ()


def test_reading_splats_for_the_order_takes_no_share_back(tmp_path: Path) -> None:
    write_scene(tmp_path / "balls", masks=False)
    config = SegmentConfig(order="coverage")
    heard = list(segment_scene(open_scene_folder(tmp_path / "balls"), Quarters(), config=config))
    assert any(word.message.endswith(".ply") for word in heard), "splats are read for it"
    assert falls(heard) == []
