"""Compiling before work begins: once, with progress, and nothing left to compile afterwards."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gaga_core import kernels
from gaga_core.pipeline import compile_kernels
from gaga_core.progress import Progress, Stage, run_stage

# In a process of its own: here other tests have compiled everything already.
_NOTHING_LEFT = """
import gc
import numba
import numpy as np
from dataclasses import replace
from functools import partial
from gaga_core.grouping.associate import AssociateConfig, associate_stage
from gaga_core.masks import MaskSet
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.training.start import first_splats_stage
from gaga_core.training.settings import TrainConfig
from gaga_core.training.train import train
from gaga_core.training.views import TrainView, TrainViews
from gaga_core.scene.objects import object_table
from gaga_core.scene.selection.by_screen import pick, rectangle, screen
from gaga_core.scene.selection.click import click_graph_stage
from gaga_core.scene.scene import Scene
from gaga_core.pipeline.compile_kernels import warm_up_stage
from tests.scenes import objects_scene

def compiled():
    found = {o for o in gc.get_objects() if isinstance(o, numba.core.registry.CPUDispatcher)}
    return {
        f"{d.__module__}.{d.__name__}": len(d.nopython_signatures)
        for d in found if d.__module__.startswith("gaga_core")
    }

run_stage(warm_up_stage())
before = compiled()
assert sum(before.values()) > 10, before
made = objects_scene(4, 300, sh_degree=2)
for array in (made.gaussians.means, made.gaussians.sh, made.labels):
    array.setflags(write=False)  # as a memory-mapped file is
cpu, g = choose(), made.gaussians
labels = {c.name: cpu.label_splat(g, c, made.labels).labels for c in made.cameras}
masks = MaskSet({name: partial(labels.get, name) for name in labels}, "test")
for preset in ("paper", "robust"):
    run_stage(associate_stage(g, made.cameras, masks, cpu, AssociateConfig.of(preset)))
regions = replace(masks, are_regions=True)
run_stage(associate_stage(g, made.cameras, regions, cpu, AssociateConfig.of("robust")))
cpu.render(g, made.cameras[0], channels=np.zeros((len(g), 7), np.float32))
cpu.render(g, made.cameras[0])
scene = Scene.of(g, made.labels)
screen(scene, made.cameras[0]).inside(rectangle((0, 0, 99, 99), 160, 120))
pick(scene, made.cameras[0], 80.5, 60.5)
pictures = [(cpu.render(g, c).image.clip(0, 1) * 255).astype(np.uint8) for c in made.cameras[:3]]
first, *rest = (TrainView(c, p) for c, p in zip(made.cameras, pictures))
views, settings = TrainViews(tuple(rest), (first,)), replace(TrainConfig.of("draft"), iterations=20)
points, colors = g.means[::4].astype(np.float64), np.full((len(g.means[::4]), 3), 99, np.uint8)
initial = run_stage(first_splats_stage(points, colors, rest, settings, cpu))
train(initial, views, settings, cpu)
object_table(scene)
clicks = run_stage(click_graph_stage(scene, made.cameras, cpu))
clicks.splats(np.ones(len(clicks.points), np.bool_))
after = compiled()
new = {name: (n, before.get(name, 0)) for name, n in after.items() if n != before.get(name, 0)}
assert not new, new
"""


def test_after_the_warm_up_nothing_is_left_to_compile() -> None:
    run = subprocess.run(
        [sys.executable, "-c", _NOTHING_LEFT],
        cwd=Path(__file__).parents[3],
        env=os.environ,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr


@pytest.fixture
def own_stamp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_kernels_are_compiled_once_the_stage_has_ended(own_stamp: Path) -> None:
    stage = compile_kernels.warm_up_stage()
    first = next(stage)
    stage.close()  # cancelled
    assert (first.stage, first.done) == (kernels.STAGE, 0)
    assert not kernels.is_compiled()
    steps: list[Progress] = []
    run_stage(compile_kernels.warm_up_stage(), steps.append)
    assert kernels.is_compiled()
    shares = [step.done / step.total for step in steps]
    assert shares == sorted(set(shares))
    assert (shares[0], shares[-1]) == (0, 1)
    window = compile_kernels._STEPS["window"]
    assert max(cost for _, cost, _ in window) > sum(cost for _, cost, _ in window) / 2
    assert all(kernels.is_compiled(part) for part in kernels.PARTS)


def test_only_the_parts_that_are_asked_for_are_compiled(own_stamp: Path) -> None:
    steps: list[Progress] = []
    run_stage(compile_kernels.warm_up_stage("window"), steps.append)
    assert kernels.is_compiled()
    assert not kernels.is_compiled("training")
    assert not any("training" in step.message or "assoc" in step.message for step in steps)
    n_before = len(steps)
    run_stage(compile_kernels.after_warm_up(_work(), "window"), steps.append)
    assert [step.stage for step in steps[n_before:]] == ["Work"]


def test_what_is_compiled_takes_no_time_and_has_no_share(own_stamp: Path) -> None:
    window = compile_kernels._STEPS["window"]
    whole = compile_kernels.usual_seconds("window")
    assert whole == pytest.approx(sum(cost for _, cost, _ in window) / 10)
    stage = compile_kernels.warm_up_stage("window")
    assert [next(stage).done for _ in range(2)] == [0, window[0][1]]
    stage.close()  # cancelled in the second step
    assert compile_kernels.usual_seconds("window") == pytest.approx(whole - window[0][1] / 10)
    steps: list[Progress] = []
    run_stage(compile_kernels.warm_up_stage("window"), steps.append)
    assert [step.done for step in steps[:3]] == [0, 0, window[1][1]]
    assert steps[-1].done == sum(cost for _, cost, _ in window[1:])
    assert compile_kernels.usual_seconds("window") == 0


def test_another_processor_or_numba_compiles_again(
    own_stamp: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kernels.mark_compiled()
    assert kernels.is_compiled()
    monkeypatch.setattr("numba.__version__", "0.0")
    assert not kernels.is_compiled()


def test_a_place_that_cannot_be_written_is_no_error(
    own_stamp: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own_stamp.write_text("a file where the folder should be")
    kernels.mark_compiled()
    assert not kernels.is_compiled()


def _work() -> Stage[str]:
    yield Progress("Work", 0, 1)
    return "done"


def test_work_waits_for_the_warm_up_only_the_first_time(
    own_stamp: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for stages in ([kernels.STAGE, "Work"], ["Work"]):
        steps: list[Progress] = []
        assert run_stage(compile_kernels.after_warm_up(_work()), steps.append) == "done"
        assert list(dict.fromkeys(step.stage for step in steps)) == stages
