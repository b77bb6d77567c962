"""Fixtures that every test may use: real data, a GL context without display, a display."""

import gc
import os
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.display import xvfb

# Before torch and numpy are imported: their threads wait for each other by spinning, and several
# processes of tests share the processors.
os.environ.setdefault("OMP_NUM_THREADS", "1")
_OURS = ("gaga", ".gaga", "torchelastic", "dask")  # how names of what we leave would begin
# What is not in `make quick`: windows, programs, placement, training, fills, models, and files of
# tests that take more than three seconds in all.
_SLOW_FOLDERS = frozenset(
    (
        *("window", "captures", "faults", "fuzz", "soak", "web", "gpu", "docs", "tools"),
        *("pipeline", "placing", "training", "fill", "cli", "segmentation", "query"),
    )
)
_SLOW_FILES = frozenset(
    (
        *("test_api", "test_app_folder", "test_association", "test_autosave", "test_benchmark"),
        *("test_benchmark_prompts", "test_benchmark_splats", "test_cameras", "test_click_object"),
        *("test_commands", "test_compare", "test_entry_points", "test_fill", "test_first_steps"),
        *("test_masks", "test_operators", "test_packaging", "test_probe", "test_readme"),
        *("test_reconstruction", "test_requests", "test_search", "test_session"),
        *("test_splat_files", "test_two_writers"),
    )
)
_SLOW_FIXTURES = frozenset(("gl", "display", "ycb_table", "garden", "placed_room"))
_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def real_scene(name: str) -> Path:
    """Folder of a real scene; skips the test where it is absent."""
    folder = Path(os.environ.get("GAGA_TEST_DATA", _DATA)) / name
    if not folder.is_dir():
        pytest.skip(f"real scene {name} is not on this machine (set GAGA_TEST_DATA)")
    return folder


@pytest.fixture(scope="session")
def ycb_table() -> Path:
    return real_scene("ycb_table")


@pytest.fixture(scope="session")
def garden() -> Path:
    return real_scene("garden")


@pytest.fixture(autouse=True)
def own_home(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Settings, recent files and the demo go to a folder of the test run, never to the user's."""
    base = tmp_path_factory.getbasetemp() / "home"
    base.mkdir(exist_ok=True)
    monkeypatch.setenv("GAGA_HOME", str(base))


@pytest.fixture(scope="session", autouse=True)
def own_temporary_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What tests and their processes put into the temporary folder goes to one of the test run's;
    nothing of ours may be left there at the end, killed programs included."""
    folder = tmp_path_factory.getbasetemp() / "tmp"
    folder.mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", str(folder))
        patch.setattr(tempfile, "tempdir", str(folder))
        yield
    left = [path.name for start in _OURS for path in folder.glob(f"{start}*")]
    assert not left, f"left in the temporary folder: {', '.join(sorted(left))}"


@pytest.fixture
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Photos of two captures are aligned with few draws; the tests of aligning have all of them."""
    from gaga_core.scene.captures import by_photos

    monkeypatch.setattr(by_photos, "_CONFIG", replace(by_photos._CONFIG, draws=200, bootstrap=6))


@pytest.fixture(scope="session")
def gl() -> Iterator[Any]:
    """A moderngl context without any display (EGL, software rendering)."""
    import moderngl

    try:
        options: dict[str, Any] = {"backend": "egl"}
        context = moderngl.create_context(require=330, standalone=True, **options)
    except Exception as error:  # noqa: BLE001  any driver failure means the same here
        pytest.skip(f"no EGL context on this machine: {error}")
    yield context
    context.release()


@pytest.fixture(scope="session")
def display() -> Iterator[str]:
    """A display for window tests: Xvfb of our own, ended with the test run."""
    if shutil.which("Xvfb") is None:
        pytest.skip("no Xvfb on this machine: install the package xvfb")
    with xvfb() as name:
        yield name


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Collect tests without looking for garbage, a fifth of the time, and never look at what is
    loaded by then: it stays to the end."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def _is_quick(item: pytest.Item) -> bool:
    """Whether a test belongs to `make quick`."""
    slow_marks = ("window", "gl", "cuda", "slow", "capture")
    if any(item.get_closest_marker(mark) for mark in slow_marks):
        return False
    folders, fixtures = item.path.parent.parts, getattr(item, "fixturenames", ())
    if _SLOW_FOLDERS.intersection(folders) or _SLOW_FIXTURES.intersection(fixtures):
        return False
    return item.path.stem not in _SLOW_FILES


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark quick tests, and sort. Window tests first: a standalone EGL context that is current in
    this thread makes Xlib end the process when GLFW then makes its own current, whatever order the
    command line asks for. Quick ones last: no process ends with a long file while another waits."""
    for item in items:
        if _is_quick(item):
            item.add_marker("quick")

    def place(item: pytest.Item) -> tuple[bool, bool]:
        is_window = item.get_closest_marker("window") is not None
        return not is_window, item.get_closest_marker("quick") is not None

    items.sort(key=place)
