"""``gaga segment`` as a person or a script uses it."""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.progress import run_stage
from gaga_core.scene.project import open_path_stage
from tests.app.folders import write_scene
from tests.core.cli.calls import Capture, answer, refusal
from tests.core.segmentation.tiny_models import save_tiny
from tests.scenes import Synthetic

_VIEW = 0


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Synthetic]:
    root = tmp_path_factory.mktemp("segment") / "scene"
    return root, write_scene(root, masks=False)


def _nearest(scene: Synthetic) -> tuple[int, str]:
    """The ball that is nearest to a view, and the place of its middle as the command takes it."""
    camera = scene.cameras[_VIEW]
    middles = [scene.gaussians.means[scene.labels == k].mean(axis=0) for k in range(1, 6)]
    pixels, depth = camera.project(np.array(middles, np.float64))
    ball = int(depth.argmin())
    u, v = pixels[ball].tolist()
    return ball + 1, f"{camera.name},{u:.1f},{v:.1f}"


def test_a_click_makes_a_named_object(made: tuple[Path, Synthetic], capsys: Capture) -> None:
    root, scene = made
    ball, place = _nearest(scene)
    values = answer(capsys, "segment", str(root), "--click", place, "--name", "red ball")
    project = run_stage(open_path_stage(Path(str(values["project"]))))
    group = values["group"]
    assert isinstance(group, int)
    assert project.scene.names[group] == "red ball"
    chosen, true = project.scene.labels == group, scene.labels == ball
    assert values["splats"] == int(chosen.sum())
    assert (chosen & true).sum() / (chosen | true).sum() > 0.8


def test_a_box_without_a_change(made: tuple[Path, Synthetic], capsys: Capture) -> None:
    root, scene = made
    ball, _ = _nearest(scene)
    camera = scene.cameras[_VIEW]
    pixels, _ = camera.project(scene.gaussians.means[scene.labels == ball].astype(np.float64))
    (u0, v0), (u1, v1) = pixels.min(axis=0) - 4, pixels.max(axis=0) + 4
    box = f"{camera.name},{u0:.1f},{v0:.1f},{u1:.1f},{v1:.1f}"
    values = answer(capsys, "segment", str(root), "--box", box, "--dry-run")
    assert isinstance(values["splats"], int)
    assert 0.8 < values["splats"] / (scene.labels == ball).sum() < 1.3
    assert "project" not in values


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ([], "Say where the object is"),
        (["--not", "{view},80,60"], "Say where the object is"),
        (["--click", "{view},80"], "is not VIEW,U,V."),
        (["--click", "{view},80,sixty"], "is not VIEW,U,V."),
        (["--box", "{view},80,60,90"], "is not VIEW,U0,V0,U1,V1."),
        (["--click", "nowhere.png,80,60"], "nowhere.png"),
        (["--click", "{view},80,600"], "outside: the view has 160 x 120 pixels."),
        (["--click", "{view},80,1"], "There is no surface at (80, 1)"),
    ],
)
def test_what_cannot_be_done_is_told(
    made: tuple[Path, Synthetic], capsys: Capture, given: list[str], said: str
) -> None:
    root, scene = made
    view = scene.cameras[_VIEW].name
    assert said in refusal(capsys, "segment", str(root), *(g.format(view=view) for g in given))


@pytest.mark.parametrize(
    ("model", "given", "said"),
    [
        ("no-such-model", [], "There is no mask provider 'no-such-model'"),
        ("regions", [], "There is no mask provider 'regions'"),
        ("{tiny}", ["--box", "{view},10,10,90,90"], "Give --click instead of --box."),
    ],
)
def test_what_a_model_cannot_do_is_told(
    made: tuple[Path, Synthetic],
    tmp_path: Path,
    capsys: Capture,
    model: str,
    given: list[str],
    said: str,
) -> None:
    root, scene = made
    view, tiny = scene.cameras[_VIEW].name, tmp_path / "sam2"
    save_tiny("sam2", tiny)
    given = [g.format(view=view) for g in given]
    arguments = ("--click", _nearest(scene)[1], "--model", model.format(tiny=tiny), *given)
    assert said in refusal(capsys, "segment", str(root), *arguments)


def test_a_lone_file_has_numbered_views(made: tuple[Path, Synthetic], capsys: Capture) -> None:
    model = str(made[0] / "point_cloud.ply")
    assert "views 0 to 18" in refusal(capsys, "segment", model, "--click", "19,240,240")
