"""Runs a test against a real ``Studio``: its window, its session, the pixels of its picture."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import glfw
from imgui_bundle import ImVec2, glfw_utils, imgui
from imgui_bundle.immapp import testing

from gaga_core.arrays import UInt8Array
from gaga_core.scene.edits.history import History
from gaga_core.scene.scene import Scene
from gaga_studio.features import selection
from gaga_studio.features.commands import new_session
from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings
from gaga_studio.session.view import Mode, ToolName, ViewState
from gaga_studio.studio import Studio
from gaga_studio.system.window import WindowOptions

PATIENCE_S = 120.0  # longest wait for anything, unless a caller knows that more is needed
_LONGEST_PAUSE_S = 0.05  # between frames of a long wait: a window that draws slowly has as few
_SEEN = 4  # frames after which what was done is seen, a sheet that opens too
# Of the window and of the picture of the splats while nobody looks: filling pixels is most of a
# frame in software.
_UNSEEN_SCALE, _UNSEEN_PICTURE = 0.05, 0.1


class Driver:
    """The hands of a person: what tests do with the window."""

    def __init__(self, studio: Studio, engine: Any, patience_s: float = PATIENCE_S) -> None:
        self.studio = studio
        self.patience_s = patience_s
        self.engine = engine  # imgui.test_engine.TestContext
        self.fills_window = False  # or as much as `_UNSEEN_SCALE`
        self.sees = False  # the picture of the splats in full, or `_UNSEEN_PICTURE` of it
        self._on_main: Callable[[], Any] | None = None
        self._answer: Any = None
        self._error: Exception | None = None

    @property
    def session(self) -> Session:
        return self.studio.session

    @property
    def scene(self) -> Scene:
        return self.session.need().scene

    @property
    def history(self) -> History:
        return self.session.need().history

    # --- waiting

    def select(self, *groups: int) -> None:
        self.on_main(lambda: selection.select_groups(self.session, groups))
        self.frames(_SEEN)

    def frames(self, n: int = 2) -> None:
        self.engine.yield_(n)

    def until(self, is_done: Callable[[], bool], what: str) -> None:
        start = time.monotonic()
        while not is_done():
            waited = time.monotonic() - start
            assert waited < self.patience_s, f"{what}: not after {self.patience_s:.0f} s"
            self.frames(1)
            # For what is waited for: frames as fast as they come hold it up.
            time.sleep(min(0.01 + waited / 50, _LONGEST_PAUSE_S))

    def settle(self) -> None:
        """Until no job runs, no picture loads, the camera rests and the picture is full."""
        self.frames(3)
        self.until(lambda: self.studio.is_settled, "the window settles")
        self.frames(2)

    # --- acting

    def click(self, ref: str) -> None:
        """Click an item: "Objects/Table" or "**/Delete"; the window comes first."""
        self.engine.item_click(f"//{ref}")
        self.check(ref)
        self.frames(_SEEN)

    def menu(self, path: str) -> None:
        self.engine.set_ref("//##MainMenuBar")
        self.engine.menu_click(path)
        self.check(path)
        self.frames(_SEEN)

    def command(self, title: str) -> None:
        """Type the title of a command into the list of them, and take it."""
        self.keys(KEY.mod_ctrl, KEY.p)
        self.engine.key_chars(title)
        self.keys(KEY.enter)

    def focus(self, panel: str) -> None:
        """Bring a panel to the front of its tabs."""
        self.engine.window_focus(f"//{panel}")
        self.frames()

    def keys(self, *chord: imgui.Key) -> None:
        # Summed as numbers: "|" of these enum members fails in Python before 3.11.4.
        self.engine.key_press(sum(int(key) for key in chord))
        self.frames(_SEEN)

    def type_into(self, ref: str, text: str) -> None:
        self.engine.item_click(f"//{ref}")
        self.check(ref)
        self.engine.key_chars_replace_enter(text)
        self.frames(_SEEN)

    def answer_path(self, path: Path) -> None:
        """Type a path into the open file dialog and accept it."""
        self.frames()
        self.engine.item_click("//$FOCUSED/##Path")
        self.check("file dialog")
        self.engine.key_chars_replace_enter(str(path))
        self.frames()

    def type_place(self, path: Path) -> None:
        """Type a path into the open sheet of an export."""
        self.frames(3)
        self.engine.item_click("//**/##Path")
        self.check("Export")
        self.engine.key_chars_replace_enter(str(path))
        self.frames()

    def export_to(self, path: Path) -> None:
        """Type a path into the open sheet of an export and start it."""
        self.type_place(path)
        self.click("Export/###Export now")
        self.frames(3)

    def move_to(self, u: float, v: float) -> None:
        """Put the mouse on a pixel of the picture."""
        left, top = self.corner
        self.engine.mouse_move_to_pos(ImVec2(left + u, top + v))

    def click_picture(self, u: float, v: float, button: int = 0) -> None:
        self.move_to(u, v)
        self.engine.mouse_click(button)
        self.frames(_SEEN)

    def drop(self, ref: str, onto: str) -> None:
        self.engine.item_drag_and_drop(f"//{ref}", f"//{onto}")
        self.frames(_SEEN)

    def menu_of(self, ref: str, item: str) -> None:
        """Right-click an item, and click in its menu."""
        self.engine.item_click(f"//{ref}", 1)
        self.frames(_SEEN)
        self.click(f"$FOCUSED/{item}")

    def drag_picture(
        self, start: tuple[float, float], by: tuple[float, float], button: int = 0
    ) -> None:
        self.move_to(*start)
        self.engine.mouse_drag_with_delta(ImVec2(*by), button)
        self.frames()

    # --- looking

    @property
    def corner(self) -> tuple[float, float]:
        rect = self.engine.get_window_by_ref("//Viewport").inner_rect
        return rect.min.x, rect.min.y

    @property
    def size(self) -> tuple[int, int]:
        rect = self.engine.get_window_by_ref("//Viewport").inner_rect
        return round(rect.max.x - rect.min.x), round(rect.max.y - rect.min.y)

    def tool(self) -> ToolName:
        return self.session.tool

    def mode(self) -> Mode:
        return self.session.view.mode

    def exists(self, ref: str) -> bool:
        return bool(self.engine.item_exists(f"//{ref}"))

    def pixels(self) -> UInt8Array:
        """The picture (H, W, 3) after everything has settled, nothing under the mouse."""
        self.engine.mouse_move_to_pos(ImVec2(imgui.get_io().display_size.x - 4, 4))
        with self.looking():
            viewport = self.studio.viewport
            assert viewport is not None
            picture: UInt8Array = self.on_main(viewport.read_pixels)
        return picture

    @contextmanager
    def looking(self) -> Iterator[None]:
        """The whole picture of the splats inside the block, which begins and ends settled."""
        before, self.sees = self.sees, True
        self.settle()
        yield
        self.sees = before
        self.settle()

    def on_main(self, act: Callable[[], Any]) -> Any:
        """Do something in the thread that owns window and context: a test has one of its own.

        What it raises there is raised here.
        """
        self._on_main = act
        while self._on_main is not None:
            self.frames(1)
        error, self._error = self._error, None
        if error is not None:
            raise error
        return self._answer

    def after_frame(self) -> None:
        if self._on_main is None:
            return
        try:
            self._answer = self._on_main()
        except Exception as error:  # noqa: BLE001  or the test would wait for it without an end
            self._error = error
        self._on_main = None

    def resize(self, width: int, height: int) -> None:
        """Resize the window, as by dragging its corner."""
        handle = glfw_utils.glfw_window_hello_imgui()
        self.on_main(lambda: glfw.set_window_size(handle, width, height))
        self.frames(6)

    def project(self, point: Any) -> tuple[float, float]:
        """Pixel of a world point (3,) in the picture."""
        camera = self.session.rig.camera(*self.size)
        pixels, _ = camera.project(point[None])
        return float(pixels[0, 0]), float(pixels[0, 1])

    def capture(self, path: Path | str) -> None:
        self.settle()
        self.capture_now(path)

    def capture_now(self, path: Path | str) -> None:
        """Save the whole window as it is."""
        before, self.fills_window = self.fills_window, True
        self.frames(1)
        testing.capture(self.engine, str(path))
        self.fills_window = before

    def check(self, what: str) -> None:
        assert not self.engine.is_error(), f"the test engine could not act on {what}"


def drive(
    test: Callable[[Driver], None],
    *,
    path: Path | None = None,
    demo: bool = False,
    size: tuple[int, int] = (800, 500),
    settings: Settings | None = None,
    may_fail: bool = False,
    patience_s: float = PATIENCE_S,
    layout_file: Path | None = None,
    fills_window: bool = False,
) -> Studio:
    """Open a window, run ``test`` in it, close it; errors of the test are raised here.

    So are errors of panels, which the window itself survives, unless the window ``may_fail``.
    The layout is kept in ``layout_file``, if there is one. What measures frames ``fills_window``;
    others have it whole where they capture it.
    """
    # Preset paper trains identities for 10,000 steps unless the settings say otherwise.
    session = new_session(settings or Settings(first_steps_done=True, identities="none"))
    options = WindowOptions(size=size, settings_file=layout_file)
    studio = Studio(path, demo=demo, session=session, options=options)
    studio.ui.files.use_native = False
    params = studio.window.params()
    params.fps_idling.enable_idling = False
    studio.never_idle = True

    drivers: list[Driver] = []
    fill_little(
        studio,
        params,
        sees=lambda: bool(drivers) and (drivers[0].sees or drivers[0].fills_window),
        fills_window=lambda: drivers[0].fills_window if drivers else fills_window,
    )

    def run(engine: Any) -> None:
        # `Driver.until` ends a test that waits in vain; the engine's own limit is for all of it.
        engine.engine_io.config_watchdog_kill_test = 20 * patience_s
        driver = Driver(studio, engine, patience_s)
        driver.fills_window = fills_window
        drivers.append(driver)
        driver.settle()
        test(driver)

    def after_frame() -> None:
        for driver in drivers:
            driver.after_frame()

    params.callbacks.after_swap = after_frame
    with _failures() as failures:
        testing.run(test_function=run, runner_params=params)
    assert may_fail or not failures, "\n".join(failures)
    return studio


def fill_little(
    studio: Studio,
    params: Any,
    sees: Callable[[], bool] = lambda: False,
    fills_window: Callable[[], bool] = lambda: False,
) -> None:
    """Have few pixels drawn while nobody ``sees`` the picture of the splats or the window."""
    view_for = studio._pacing.view_for

    def unseen(view: ViewState, motion: object, n_splats: int) -> ViewState:
        made = view_for(view, motion, n_splats)
        if sees():
            return made
        # An outline looks at 48 places around each pixel, splats selected or not.
        scale = made.resolution_scale * _UNSEEN_PICTURE
        return replace(made, resolution_scale=scale, show_outline=False)

    def before_render() -> None:
        if not fills_window():
            imgui.get_main_viewport().framebuffer_scale = ImVec2(_UNSEEN_SCALE, _UNSEEN_SCALE)

    studio._pacing.view_for = unseen  # type: ignore[method-assign]
    params.callbacks.before_imgui_render = before_render


@contextmanager
def _failures() -> Iterator[list[str]]:
    """What the log says of panels that failed inside the block, with tracebacks."""
    found: list[str] = []
    handler = logging.Handler(logging.ERROR)
    handler.emit = lambda record: found.append(handler.format(record))  # type: ignore[method-assign]
    logger = logging.getLogger("gaga_studio.studio")
    logger.addHandler(handler)
    try:
        yield found
    finally:
        logger.removeHandler(handler)


KEY = imgui.Key
