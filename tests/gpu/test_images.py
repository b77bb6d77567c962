"""Pictures as textures: decoded elsewhere, limited in memory, told apart from broken files."""

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from gaga_core.arrays import UInt8Array
from gaga_core.errors import GagaError
from gaga_core.scene.object_picture import ObjectDrawing
from gaga_studio.gpu import images
from gaga_studio.gpu.images import ImageStore
from tests.scenes import orbit_cameras, random_gaussians

pytestmark = pytest.mark.gl


@pytest.fixture
def store(gl: Any) -> Iterator[ImageStore]:
    made = ImageStore(gl, budget_bytes=3 * 4 * 30 * 20)
    yield made
    made.release()
    assert gl.error == "GL_NO_ERROR"


def _solid(value: int, channels: int = 3) -> Callable[[], UInt8Array]:
    return lambda: np.full((20, 30, channels), value, np.uint8)


def _get(
    store: ImageStore, key: str, load: Callable[[], UInt8Array]
) -> tuple[int, int, int] | None:
    """Ask as a panel does, frame after frame, until nothing is loading any more."""
    for _ in range(2000):
        found = store.texture(key, load)
        if found is not None or not store.loading:
            return found or store.texture(key, load)
        time.sleep(0.001)
    return None


@pytest.mark.parametrize("channels", [3, 4])
def test_a_picture_arrives_the_right_way_up(gl: Any, store: ImageStore, channels: int) -> None:
    pixels = np.arange(5 * 7 * channels, dtype=np.uint8).reshape(5, 7, channels)
    found = _get(store, "a", lambda: pixels)
    assert found is not None
    assert found[1:] == (7, 5)
    texture = store._textures["a"]
    assert texture.glo == found[0]
    assert np.array_equal(np.frombuffer(texture.read(), np.uint8), pixels.ravel())


def test_loading_runs_in_another_thread_and_once(store: ImageStore) -> None:
    threads = []

    def load() -> UInt8Array:
        threads.append(threading.current_thread())
        return _solid(1)()

    assert store.texture("a", load) is None
    assert _get(store, "a", load) is not None
    assert _get(store, "a", load) == store.texture("a", load)
    assert len(threads) == 1
    assert threads[0] is not threading.current_thread()


def test_a_broken_picture_is_asked_for_once_until_dropped(store: ImageStore) -> None:
    calls = []

    def load() -> UInt8Array:
        calls.append(1)
        raise GagaError("This photo is gone.")

    for _ in range(3):
        assert _get(store, "a", load) is None
    assert len(calls) == 1
    assert store.cannot_read("a")
    assert not store.cannot_read("b")
    store.drop("a")
    assert _get(store, "a", _solid(3)) is not None


def test_something_that_is_no_picture_is_refused(store: ImageStore) -> None:
    assert _get(store, "flat", lambda: np.zeros((4, 4), np.uint8)) is None
    assert _get(store, "empty", lambda: np.zeros((0, 4, 3), np.uint8)) is None


def test_objects_are_drawn_as_the_processor_draws_them_some_each_frame(
    store: ImageStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    splats, camera = random_gaussians(600), orbit_cameras(1, width=30, height=20)[0]
    order = np.argsort(-(splats.means @ camera.cam_from_world[2, :3].astype(np.float32)))
    one = ObjectDrawing(splats.take(order), camera)
    for key in "ab":
        store.texture(key, lambda: one)
    while store._decoding or store._loads:
        time.sleep(0.001)
    monkeypatch.setattr(images, "_DRAWING_S", 0.0)
    for n_drawn in (1, 2):
        assert store.loading
        store.receive()
        assert len(store._textures) == n_drawn
    assert not store.loading
    data = store._textures["a"].read()
    drawn = np.frombuffer(data, np.uint8).reshape(camera.height, camera.width, 3).astype(int)
    assert np.abs(drawn - one.render()).mean() < 0.5


def test_the_least_recently_shown_goes_first(store: ImageStore) -> None:
    for key in "abc":
        _get(store, key, _solid(1))
    _get(store, "a", _solid(1))
    _get(store, "d", _solid(1))
    assert set(store._textures) == {"a", "c", "d"}


def test_clear_forgets_what_is_on_its_way(store: ImageStore) -> None:
    """The same key may stand for a photo of another scene afterwards."""
    may_go = threading.Event()

    def slow() -> UInt8Array:
        may_go.wait(10)
        return _solid(1)()

    store.texture("a", slow)
    time.sleep(0.01)
    threading.Timer(0.05, may_go.set).start()
    store.clear()
    found = _get(store, "a", lambda: np.zeros((6, 8, 3), np.uint8))
    assert found is not None
    assert found[1:] == (8, 6)
