"""From photos to a scene folder: complete, taken up after a stop, never over a person's files."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaga_core.errors import GagaError
from gaga_core.io.cameras.cameras_json import read_cameras_json
from gaga_core.io.folder.lock import OWNER, working_in
from gaga_core.io.folder.scene_folder import (
    AssociateEntry,
    open_scene_folder,
    read_report_entry,
    with_entry,
)
from gaga_core.io.splats.ply import read_ply
from gaga_core.pipeline.place import (
    WORKSPACE,
    WrongModelError,
    find_photos,
    notes_of,
    placement_of,
    read_entry,
    refuse,
    write_entry,
)
from gaga_core.pipeline.reconstruct import (
    KERNELS,
    STEPS,
    SURFACES,
    TRAINS,
    Estimate,
    PhotoFind,
    photos_again,
    photos_since,
    reconstruct_scene,
    require_its_photos,
)
from gaga_core.pipeline.run import missing_stages, run_folder
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.placing.checks import Verdict
from gaga_core.progress import Progress, run_stage
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.scene.orientation import estimate_up
from gaga_core.scene.project import open_path_stage
from gaga_core.training.losses import psnr
from gaga_core.training.views import load_views_stage
from tests.core.conftest import PlacedRoom

TINY = ReconstructConfig(iterations=30, max_side=96)
SFM = ReconstructConfig(only="sfm")


@pytest.fixture
def photos(placed_room: PlacedRoom, tmp_path: Path) -> Path:
    """A folder with the room's photos."""
    folder = tmp_path / "photos"
    shutil.copytree(placed_room.workspace.parent / "in", folder)
    return folder


@pytest.fixture(scope="module")
def made(placed_room: PlacedRoom, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene folder that had nothing but photos, reconstructed in full."""
    scene = tmp_path_factory.mktemp("made") / "scene"
    shutil.copytree(placed_room.workspace.parent / "in", scene / "images")
    assert missing_stages(open_scene_folder(scene))[0] == "reconstruct"
    result = run_stage(reconstruct_scene(None, scene, TINY))
    assert result.stages_run == ("sfm", "train")
    return scene


def titles(photos: Path | None, scene: Path, config: ReconstructConfig) -> set[str]:
    told: list[Progress] = []
    run_stage(reconstruct_scene(photos, scene, config), told.append)
    return {step.stage for step in told}


def test_photos_become_a_scene_folder(made: Path, tmp_path: Path) -> None:
    names = sorted(path.name for path in made.iterdir())
    assert names == ["cameras.json", "gaga", "images", "input", "point_cloud.ply", "sparse"]
    folder = open_scene_folder(made)
    assert len(folder.cameras) == len(folder.image_paths) == 8
    assert estimate_up(folder.cameras).tolist() == [0, 0, 1], "photos tell no world: z is up"
    for camera in folder.cameras:
        with Image.open(folder.image_paths[camera.name]) as image:
            assert image.size == (camera.width, camera.height)
    listed = read_cameras_json(made / "cameras.json")
    for one, other in zip(listed, folder.cameras, strict=True):
        assert np.allclose(one.position, other.position, atol=1e-6)
    assert "reconstruct" not in missing_stages(folder)
    alone = run_stage(open_path_stage(Path(shutil.copy(made / "point_cloud.ply", tmp_path))))
    assert np.allclose(alone.up, [0, 0, 1]), "the file tells it without its photos"


@pytest.mark.parametrize("antialiased", [False, True])
def test_the_report_has_the_held_out_quality_that_the_file_gives(
    made: Path, tmp_path: Path, antialiased: bool
) -> None:
    """In the mode that the file asks for: that of the training."""
    if antialiased:
        made = Path(shutil.copytree(made, tmp_path / "scene"))
        (made / "point_cloud.ply").unlink()
        run_stage(reconstruct_scene(None, made, replace(TINY, antialiased=True)))
    entry = read_entry(made)
    sfm, train = entry["sfm"], entry["train"]
    assert isinstance(sfm, dict)
    assert isinstance(train, dict)
    assert (sfm["photos"], sfm["registered"], sfm["checks"]) == (8, 8, [])
    folder, splats = open_scene_folder(made), read_ply(made / "point_cloud.ply")
    assert train["splats"] == len(splats)
    assert splats.is_antialiased == antialiased
    views = run_stage(load_views_stage(folder.cameras, folder.image_paths, folder.test, 96)).test
    raster = CpuRasterizer()
    measured = [
        psnr(np.clip(raster.render(splats, v.camera).image, 0, 1), v.target()) for v in views
    ]
    # The only held-out photo chose which splats are kept: it does not tell how good they are.
    assert (len(folder.test), train["held_out"]) == (1, None)
    kept = next(m for m in train["curve"] if m["iteration"] == train["kept_iteration"])
    assert kept["psnr"] == pytest.approx(np.mean(measured), abs=0.05)
    assert kept["psnr"] >= max(m["psnr"] for m in train["curve"]) - 0.3


def test_what_is_there_is_not_made_again(made: Path) -> None:
    before = {p: p.stat().st_mtime_ns for p in made.rglob("*")}
    assert titles(None, made, TINY) == set()
    assert {p: p.stat().st_mtime_ns for p in made.rglob("*")} == before


def test_a_placed_scene_is_only_trained(made: Path, tmp_path: Path) -> None:
    scene = tmp_path / "scene"
    shutil.copytree(made, scene)
    (scene / "point_cloud.ply").unlink()
    assert missing_stages(open_scene_folder(scene))[0] == "reconstruct"
    result = run_stage(reconstruct_scene(None, scene, TINY))
    assert result.stages_run == ("train",)
    again, before = read_ply(scene / "point_cloud.ply"), read_ply(made / "point_cloud.ply")
    assert np.array_equal(again.means, before.means)  # the same seed


def test_a_stopped_run_goes_on_where_it_was(photos: Path, tmp_path: Path) -> None:
    scene = tmp_path / "scene"
    stage = reconstruct_scene(photos, scene, SFM)
    for step in stage:
        if step.stage == "Place photos":
            break
    stage.close()
    assert [path.name for path in scene.iterdir()] == [WORKSPACE]
    assert titles(photos, scene, SFM) == {"Place photos", "Undistort photos"}
    assert not (scene / WORKSPACE).exists()
    assert len(open_scene_folder(scene).cameras) == 8


def test_other_photos_or_settings_start_anew(photos: Path, tmp_path: Path) -> None:
    scene = tmp_path / "scene"
    stage = reconstruct_scene(photos, scene, SFM)
    for step in stage:
        if step.stage == "Find features":
            break
    stage.close()
    (photos / "007.jpg").unlink()
    stage = reconstruct_scene(photos, scene, SFM)
    assert next(stage).stage == "Look at photos"
    stage.close()


def test_a_scene_of_other_photos_is_no_result(photos: Path, tmp_path: Path) -> None:
    """It was said that nothing was left to do, and nothing of the photos was in it."""
    scene, others = tmp_path / "scene", tmp_path / "others" / photos.name
    run_stage(reconstruct_scene(photos, scene, SFM))
    (tmp_path / "link").symlink_to(photos)
    for same in (photos, scene / "images", tmp_path / "link"):
        assert run_stage(reconstruct_scene(same, scene, SFM)).stages_run == ()
    shutil.copytree(photos, others)  # of the same names: the first are still there
    for made in (scene, tmp_path / "foreign"):
        with pytest.raises(GagaError, match="nothing is made of"):
            run_stage(reconstruct_scene(others, made, SFM))
        with pytest.raises(GagaError, match="nothing is made of"):
            run_stage(run_folder(made, photos=others))
        with pytest.raises(GagaError, match="does not exist"):
            run_stage(reconstruct_scene(tmp_path / "none", made, SFM))
        if made == scene:
            shutil.copytree(scene / "sparse", tmp_path / "foreign" / "sparse")
            for path in others.iterdir():
                path.rename(path.with_stem(f"other_{path.stem}"))
    moved = photos.rename(tmp_path / "moved")
    next(moved.iterdir()).unlink()  # it was blurred
    assert run_stage(reconstruct_scene(moved, scene, SFM)).stages_run == ()


def test_what_another_program_makes_is_not_made_next_to_it(photos: Path, tmp_path: Path) -> None:
    """It was called stopped, and both trained in one folder."""
    scene = tmp_path / "scene"
    stage = reconstruct_scene(photos, scene, SFM)
    next(step for step in stage if step.stage == "Find features")
    other = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    note = scene / WORKSPACE / OWNER
    note.write_text(note.read_text().replace(f"{os.getpid()}", f"{other.pid}"))
    with pytest.raises(GagaError, match=r"is making .* now"):
        run_stage(reconstruct_scene(photos, scene, SFM))
    assert working_in(scene / WORKSPACE) is not None
    other.communicate(b"\n")
    assert working_in(scene / WORKSPACE) is None
    assert next(reconstruct_scene(photos, scene, SFM)).stage
    stage.close()
    assert not note.exists(), "it is stopped, and goes on in any program"


def test_a_recording_may_be_given_again(made: Path, tmp_path: Path) -> None:
    """Its frames lie in the scene, which the report names as where they are from."""
    scene, recording = shutil.copytree(made, tmp_path / "scene"), tmp_path / "a.r3d"
    recording.touch()
    known = read_entry(scene)["sfm"]
    assert isinstance(known, dict)
    write_entry(scene, {"sfm": known | {"source": str(scene / "input")}})
    require_its_photos(recording, scene)
    write_entry(scene, {"sfm": known | {"source": str(tmp_path)}})
    with pytest.raises(GagaError, match="nothing is made of"):
        require_its_photos(recording, scene)


def test_a_stop_before_anything_is_finished_leaves_nothing(photos: Path, tmp_path: Path) -> None:
    scene = tmp_path / "scene"
    stage = reconstruct_scene(photos, scene, SFM)
    next(stage)
    assert scene.exists()
    stage.close()
    assert not scene.exists()


def test_the_originals_in_a_scene_folder_are_kept(made: Path, placed_room: PlacedRoom) -> None:
    originals = placed_room.workspace.parent / "in"
    kept = {path.name: path.read_bytes() for path in (made / "input").iterdir()}
    assert kept == {path.name: path.read_bytes() for path in originals.iterdir()}
    assert find_photos(made) == made / "input"


def test_splats_are_made_again_of_the_originals_with_what_came_since(
    made: Path, tmp_path: Path
) -> None:
    """Not of the pictures without distortion, nor with the poses of these."""
    scene = tmp_path / "scene"
    for name in ("gaga", "images", "input", "sparse"):
        shutil.copytree(made / name, scene / name)
    again = photos_again(scene)
    assert again is not None
    assert (again.photos, again.poses) == (scene / "input", "")
    assert again.scene == tmp_path / "scene-2"
    assert photos_since(scene, scene / "input") == 0
    first = min((scene / "input").iterdir())
    first.rename(first.with_stem("new"))
    assert photos_since(scene, scene / "input") == 1, "as many as before, but one is another"
    (scene / "input").rename(source := tmp_path / "photos")
    write_entry(scene, {"sfm": {"source": str(source)}})
    again = photos_again(scene)
    assert again is not None
    assert again.photos == source
    for path in source.iterdir():
        path.unlink()
    again = photos_again(scene)
    assert again is not None
    assert again.photos == scene / "images", "those that it was made of are gone"


def test_other_pictures_in_the_scene_are_not_replaced(photos: Path, tmp_path: Path) -> None:
    scene = tmp_path / "scene"
    (scene / "images").mkdir(parents=True)
    kept = scene / "images" / "mine.jpg"
    shutil.copy(photos / "000.jpg", kept)
    with pytest.raises(GagaError, match="holds other pictures already"):
        run_stage(reconstruct_scene(photos, scene, SFM))
    assert [path.name for path in scene.rglob("*")] == ["images", "mine.jpg"]


def test_a_wrong_focal_length_is_refused_unless_accepted(photos: Path, tmp_path: Path) -> None:
    scene, wrong = tmp_path / "scene", ReconstructConfig(only="sfm", focal=1500)
    with pytest.raises(GagaError, match=r"not to be trusted.*--focal"):
        run_stage(reconstruct_scene(photos, scene, wrong))
    assert not (scene / "sparse").exists()
    accepted = ReconstructConfig(only="sfm", focal=1500, accept_wrong=True)
    result = run_stage(reconstruct_scene(photos, scene, accepted))
    sfm = result.report["sfm"]
    assert isinstance(sfm, dict)
    assert "error" in {check["level"] for check in sfm["checks"]}
    assert any("focal length" in note for note in result.notes)


def test_an_advice_that_several_checks_give_is_said_once() -> None:
    cure = "Try more photos, or others."
    wrong = [Verdict(k, "error", f"{k.title()} is off. {cure}") for k in ("pairs", "doubled")]
    with pytest.raises(WrongModelError) as refused:
        refuse(wrong, "It is wrong.", ReconstructConfig())
    assert refused.value.finding == f"It is wrong. Pairs is off. {cure} Doubled is off."


def test_too_few_photos_leave_nothing(photos: Path, tmp_path: Path) -> None:
    for path in sorted(photos.iterdir())[1:]:
        path.unlink()
    shutil.copy(photos / "000.jpg", photos / "again.jpg")
    with pytest.raises(GagaError, match=r"1 usable photo among 2 files.*again\.jpg"):
        run_stage(reconstruct_scene(photos, tmp_path / "scene", SFM))
    assert not (tmp_path / "scene").exists()
    with pytest.raises(GagaError, match="no folder of photos"):
        run_stage(reconstruct_scene(tmp_path / "none", tmp_path / "scene", SFM))
    assert not (tmp_path / "scene").exists()


def test_the_strategy_the_cap_the_exposure_and_the_look_reach_the_training() -> None:
    plain, chosen = ReconstructConfig().train(), ReconstructConfig(strategy="mcmc", max_splats=5000)
    assert (plain.density.strategy, plain.opacity_decay) == ("gradient", 0.0)
    assert (plain.antialiased, ReconstructConfig(antialiased=True).train().antialiased) == (
        False,
        True,
    )
    assert (plain.exposure, ReconstructConfig(exposure=True).train().exposure) == (False, True)
    assert (chosen.train().density.strategy, chosen.train().density.max_splats) == ("mcmc", 5000)
    assert chosen.train().opacity_decay > 0


def test_settings_are_checked() -> None:
    for wrong in ({"focal": -1.0}, {"iterations": 0}, {"max_side": 3}, {"video_fps": 0.0}):
        with pytest.raises(GagaError, match="--"):
            replace(ReconstructConfig(), **wrong)
    assert ReconstructConfig(max_side=200).train().longest_side == 200


# --- One estimate for all steps.


def _estimated(
    speeds: Mapping[str, float],
    rates: Mapping[str, float],
    iteration: int = 0,
    kernels_s: float = 30.0,
) -> tuple[list[tuple[float, float, float]], dict[str, float]]:
    """Share, seconds left and true seconds left at each word of a run, and the rates after it.

    ``speeds``: by how much longer than expected each step takes; the training as its splats grow.
    """
    config, now, seen = ReconstructConfig(), 0.0, []
    found = PhotoFind(Path("shots"), Path("scene"), 50, (1200, 800))
    found = replace(found, going_on=config if iteration else None, iteration=iteration)
    settings, n_pixels = config.train(), found.n_pixels(config)
    clock = [0.0]
    estimate = Estimate(found, config, rates, lambda: clock[0], kernels_s)
    usual = found.expected(config, {}, kernels_s)
    steps = {step: seconds * speeds[step] for step, seconds in usual.items()}
    whole = sum(steps.values()) + 2 * (len(steps) - 2)
    for step in steps:
        first = iteration / settings.iterations if step == TRAINS else 0.0
        start = settings.spent(n_pixels, first)
        for k in range(101):
            share = first + (1 - first) * k / 100
            spent = settings.spent(n_pixels, share) if step == TRAINS else share
            start = start if step == TRAINS else 0.0
            clock[0] = now + steps[step] * (spent - start) / (1 - start)
            seen.append((*estimate.follow(Progress(step, round(share * 1e6), 10**6)), clock[0]))
            if step == TRAINS and k % 10 == 5:  # what is done within a step has shares of its own
                measured = estimate.follow(Progress("Measure on held-out views", 0, 2))
                assert measured == pytest.approx(seen[-1][:2])
        now += steps[step]
        for k in range(3):  # what is not counted
            clock[0] = now + k
            seen.append((*estimate.follow(Progress("Read photos", k, 3)), clock[0]))
        now += 2
    return [(share, left, whole + 2 - at) for share, left, at in seen], estimate.rates()


def _worst(seen: list[tuple[float, float, float]], since: float = 0.1) -> float:
    """The largest factor by which the time left was wrong, from a tenth on, to the last seconds."""
    whole = seen[0][2]
    off = [max(left / true, true / left) for _, left, true in seen if left > 0 and true > 10]
    n = sum(true > (1 - since) * whole for _, _, true in seen)
    return max(off[n:])


def test_a_machine_that_gets_busy_moves_the_time_left() -> None:
    """Something else takes three quarters of it from two fifths of the training on; the bar goes on
    at every word (it stood still at 35 % for two minutes)."""
    found, clock = PhotoFind(Path("shots"), Path("scene"), 50, (1200, 800), is_placed=True), [0.0]
    config = ReconstructConfig()
    spent = partial(config.train().spent, found.n_pixels(config))
    estimate = Estimate(found, config, {}, lambda: clock[0])
    shares = [estimate.follow(Progress(SURFACES, 1, 1))[0]]
    for k in range(1, 96):
        part = spent(k / 100)
        busy = max(part - 0.4, 0.0)
        clock[0] = 100 * (part + 3 * busy)
        share, left = estimate.follow(Progress(TRAINS, k, 100))
        shares.append(share)
        if part > 0.8:
            assert left == pytest.approx(400 * (1 - part), rel=0.25)
    assert (np.diff(shares) > 0).all()
    assert shares[-1] < 1


@pytest.mark.parametrize("speed", [0.3, 1.0, 4.0])
def test_the_time_left_is_right_from_a_tenth_on_and_the_bar_never_goes_back(speed: float) -> None:
    speeds = dict.fromkeys(STEPS, speed)
    seen, rates = _estimated(speeds, {})
    shares = [share for share, _, _ in seen]
    assert shares == sorted(shares)
    assert 0 <= shares[0] < 0.01
    assert _worst(seen) < 1.5
    assert rates == pytest.approx(speeds, rel=0.1)


def test_what_a_machine_took_is_what_it_is_expected_to_take_next() -> None:
    """Steps that are off by different factors, which the first run could not know."""
    speeds = dict(zip(STEPS, (1.0, 3.0, 0.5, 6.0, 1.0, 2.0, 1.0, 2.0), strict=True))
    first, rates = _estimated(speeds, {})
    assert _worst(first, since=0.0) > 1.5
    second, again = _estimated(speeds, rates)
    assert _worst(second, since=0.0) < 1.25
    assert again == pytest.approx(rates, rel=0.1)
    resumed, _ = _estimated(speeds, rates, iteration=ReconstructConfig().train().iterations // 2)
    assert _worst(resumed) < 1.5


def test_kernels_of_a_first_run_tell_how_busy_the_machine_is() -> None:
    """They were not counted: 70 s, and half a minute later as many, and later twice as many."""
    seen, rates = _estimated(dict.fromkeys(STEPS, 3.5), {})
    after = [row for row in seen if row[2] < seen[0][2] - 30 * 3.5]
    assert _worst(after, since=0.0) < 1.5
    assert rates[KERNELS] == pytest.approx(3.5)
    idle, _ = _estimated(dict.fromkeys(STEPS, 1.0), {})
    assert _worst(idle, since=0.0) < 1.5


def test_a_stopped_training_tells_what_the_rest_takes() -> None:
    """It went on with 47 s left and had 111 s at a quarter: nothing was kept of a stopped run."""
    config, clock = ReconstructConfig(), [0.0]
    found = PhotoFind(None, Path("scene"), 12, (1200, 800), is_placed=True)
    settings, n_pixels = config.train(), found.n_pixels(config)
    whole, last = 3.5 * found.seconds(config), settings.iterations // 3
    estimate = Estimate(found, config, {}, lambda: clock[0])
    for i in range(last + 1):
        clock[0] = whole * settings.spent(n_pixels, i / settings.iterations)
        estimate.follow(Progress(TRAINS, i, settings.iterations))
    rates = estimate.rates()
    assert rates == {TRAINS: pytest.approx(3.5, rel=0.1)}
    rest = replace(found, going_on=config, iteration=last)
    left = whole * (1 - settings.spent(n_pixels, last / settings.iterations))
    later = rest.expected(config, rates)[TRAINS]
    assert later == pytest.approx(left, rel=0.1)
    goes_on = Estimate(rest, config, rates, lambda: clock[0])
    for i in range(last, settings.iterations + 1):
        clock[0] = whole * settings.spent(n_pixels, i / settings.iterations)
        goes_on.follow(Progress(TRAINS, i, settings.iterations))
    assert goes_on.rates() == {TRAINS: pytest.approx(3.5, rel=0.1)}
    barely = Estimate(rest, config, rates, lambda: clock[0])
    for i in (last, last + 1):
        barely.follow(Progress(TRAINS, i, settings.iterations))
        clock[0] += 1000
    assert barely.rates() == rates, "what has hardly begun tells nothing"


def test_the_share_of_a_training_that_goes_on_is_that_of_all_its_iterations() -> None:
    """Its bar began at 0 next to "Go on training from 33 %"."""
    config = ReconstructConfig()
    found = PhotoFind(None, Path("scene"), 12, (1200, 800), is_placed=True, iteration=660)
    found = replace(found, going_on=replace(config, iterations=2000))
    assert found.going_on is not None
    clock = iter(range(100))
    estimate = Estimate(found, found.going_on, {}, lambda: float(next(clock)))
    shares = [estimate.follow(Progress("Read photos", 0, 3))[0]]
    shares += [estimate.follow(Progress(TRAINS, i, 2000))[0] for i in (660, 724, 1000, 2000)]
    assert shares == [0.33, 0.33, 0.362, 0.5, 1.0]
    again = Estimate(found, config, {}, lambda: 0.0)  # other settings
    assert again.follow(Progress(TRAINS, 0, 2000))[0] == 0
    assert found.seconds(config) == replace(found, iteration=0).seconds(config)


# --- What is read again of a report, whatever its entries hold.


_GOOD = {"names": ["a", "b"], "why_out": {"b": "dark"}, "links": [[0, 1, 40]], "notes": ["x"]}


@pytest.mark.parametrize(
    "damage",
    [
        {"names": 3},
        {"links": [[0, 1]]},
        {"links": [[-1, 1, 4]]},
        {"why_out": ["b"]},
    ],
)
def test_a_damaged_placement_is_none(damage: dict[str, object]) -> None:
    assert placement_of({"sfm": _GOOD}) is not None
    assert placement_of({"sfm": {**_GOOD, **damage}}) is None


def test_links_to_photos_that_are_not_there_are_left_out() -> None:
    found = placement_of({"sfm": {**_GOOD, "links": [[0, 1, 40], [1, 7, 30]]}})
    assert found is not None
    assert found.links == ((0, 1, 40),)


def test_damaged_remarks_are_none() -> None:
    assert notes_of({**_GOOD, "checks": [{"text": "good"}]}) == ("x", "good")
    assert notes_of({**_GOOD, "notes": [3]}) == ()
    assert notes_of({**_GOOD, "checks": ["good"]}) == ()


def test_one_damaged_entry_does_not_cost_the_others(tmp_path: Path) -> None:
    file = tmp_path / "report.json"
    content = {"associate": {"mask_folder": 3}, "lift": {"x": float("nan")}}
    file.write_text(json.dumps(content))
    assert read_report_entry(file, "associate", AssociateEntry) is None
    again = json.loads(with_entry(file, "run", {"seconds": 1.0}))
    assert set(again) == {"associate", "lift", "run"}


def test_half_a_surrogate_pair_is_damage_and_a_whole_one_is_text(tmp_path: Path) -> None:
    file = tmp_path / "report.json"
    file.write_text('{"reconstruct": {"sfm": "\\ud83d\\ude00"}}')  # one character in two halves
    assert read_report_entry(file, "reconstruct", dict[str, object]) == {"sfm": "\U0001f600"}
    file.write_text('{"reconstruct": {"sfm": "\\ud83d"}}')
    assert read_report_entry(file, "reconstruct", dict[str, object]) is None
