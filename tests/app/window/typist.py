"""Keys, mouse and files for a real window, as a hand: from another connection to the X server."""

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import glfw
from imgui_bundle import glfw_utils, hello_imgui, imgui, immapp
from Xlib import XK, X, display
from Xlib.protocol import event

from gaga_studio.studio import Studio
from gaga_studio.ui.kit.picture_area import PictureArea
from tests.app.window.driver import fill_little

# X11's name of a key, or "Button1"; whether it goes down. "Mouse": where it is, shares of the
# picture from its top left corner. "Inside": whether it is in the window. "Close": what a window
# manager asks for at Alt+F4. "Rest": nothing until all is drawn and seen.
Stroke = tuple[str, bool | tuple[float, float]]
_MASKS = {
    event.KeyPress: X.KeyPressMask,
    event.KeyRelease: X.KeyReleaseMask,
    event.ButtonPress: X.ButtonPressMask,
    event.ButtonRelease: X.ButtonReleaseMask,
    event.MotionNotify: X.PointerMotionMask,
}
_STATES = {
    "Shift_L": X.ShiftMask,
    "Control_L": X.ControlMask,
    "Alt_L": X.Mod1Mask,
    "Button1": X.Button1Mask,
    "Button3": X.Button3Mask,
}


class Hand:
    """Sends keys and mouse to the window, whatever that window is doing."""

    def __init__(self, area: PictureArea | None = None) -> None:
        self._area = area
        self._display = display.Display()
        number = glfw.get_x11_window(glfw_utils.glfw_window_hello_imgui())
        self._window = self._display.create_resource_object("window", number)
        self._state, self._time = 0, 0
        self._at = (0, 0)

    def stroke(self, name: str, is_down: bool | tuple[float, float]) -> None:
        if name == "Close":
            glfw.set_window_should_close(glfw_utils.glfw_window_hello_imgui(), True)
            self._state = 0  # the window manager was told that Alt is up, this window never
            return
        if name == "Inside":
            (self.enter if is_down else self.leave)()
            return
        if isinstance(is_down, tuple):
            area = self._area
            assert area is not None
            self.move(
                round(area.left + is_down[0] * area.width),
                round(area.top + is_down[1] * area.height),
            )
            return
        if name.startswith("Button"):
            self._send(event.ButtonPress if is_down else event.ButtonRelease, int(name[-1]))
        else:
            code = self._display.keysym_to_keycode(XK.string_to_keysym(name))
            self._send(event.KeyPress if is_down else event.KeyRelease, code)
        bit = _STATES.get(name, 0)
        self._state = self._state | bit if is_down else self._state & ~bit

    def move(self, x: int, y: int) -> None:
        """Move the mouse to a pixel of the window."""
        self._at = x, y
        self._send(event.MotionNotify, 0)

    def enter(self) -> None:
        """The mouse comes into the window."""
        self._window.send_event(event.EnterNotify(**self._where(), mode=0, flags=2))

    def leave(self) -> None:
        """The mouse goes out of the window."""
        self._window.send_event(event.LeaveNotify(**self._where(), mode=0, flags=2))

    def _where(self) -> dict[str, Any]:
        # As a hand types: GLFW takes a press right after a release for a repeating key.
        self._time += 30
        (x, y), time_ms = self._at, self._time
        return {
            "time": time_ms, "root": X.NONE, "window": self._window, "child": X.NONE,
            "root_x": x, "root_y": y, "event_x": x, "event_y": y,
            "state": self._state, "detail": 0,
        }  # fmt: skip

    def _send(self, kind: Any, code: int) -> None:
        fields = {**self._where(), "same_screen": 1, "detail": code}
        self._window.send_event(kind(**fields), event_mask=_MASKS[kind])

    def drop(self, paths: Sequence[Path]) -> Iterator[None]:
        """Drop files as another program does (XDND 5); the window has a frame at each step."""
        atom = self._display.intern_atom
        source = self._display.screen().root.create_window(0, 0, 1, 1, 0, X.CopyFromParent)
        source.set_selection_owner(atom("XdndSelection"), X.CurrentTime)
        text = "".join(f"{path.as_uri()}\r\n" for path in paths).encode()

        def tell(kind: str, *words: int) -> None:
            told = [source.id, *words, *[0] * (4 - len(words))]
            self._window.send_event(
                event.ClientMessage(window=self._window, client_type=atom(kind), data=(32, told))
            )

        assert self._window.get_full_property(atom("XdndAware"), X.AnyPropertyType)
        tell("XdndEnter", 5 << 24, atom("text/uri-list"))
        tell("XdndPosition", 0, 0, X.CurrentTime, atom("XdndActionCopy"))
        said = 0
        while said != atom("XdndFinished"):
            self.sync()
            yield
            while self._display.pending_events():
                heard = self._display.next_event()
                if heard.type == X.SelectionRequest:
                    heard.requestor.change_property(heard.property, heard.target, 8, text)
                    names = ("time", "requestor", "selection", "target", "property")
                    given = {name: getattr(heard, name) for name in names}
                    heard.requestor.send_event(event.SelectionNotify(**given))
                elif heard.type == X.ClientMessage:
                    said = heard.client_type
                    if said == atom("XdndStatus"):
                        assert heard.data[1][1] & 1, "it takes them"
                        tell("XdndDrop", 0, X.CurrentTime)

    def sync(self) -> None:
        """Until the server has passed on all strokes."""
        self._display.sync()

    def close(self) -> None:
        self._display.close()


def type_into(
    studio: Studio,
    script: Sequence[Stroke],
    *,
    in_a_frame: int,
    frame_s: float,
    see: Callable[[Studio], Any],
    patience_s: float = 60.0,
) -> list[Any]:
    """Open the window and type ``script`` when all is drawn; what was to ``see`` at each rest.

    The first is before the script, the last after it.

    From then on a frame says that it took ``frame_s``, and has ``in_a_frame`` strokes: all that a
    hand types while so slow a frame is drawn. Nobody sleeps for that. The window may end before.
    ``patience_s`` is what this thread may compute, for on a busy machine the clock says nothing.
    """
    params = studio.window.params()
    studio.never_idle = True
    fill_little(studio, params)
    params.fps_idling.enable_idling = False
    left, seen, end = list(script), [], time.thread_time() + patience_s
    hands: list[Hand] = []
    still, real = [0], params.callbacks.pre_new_frame

    def before_frame() -> None:
        if hands:
            imgui.get_io().delta_time = frame_s
        real()

    def after_frame() -> None:
        assert time.thread_time() < end, "the window is never done"
        is_at_rest = studio.is_settled and not studio.window.keys_wait
        still[0] = still[0] + 1 if is_at_rest else 0
        if hands and left and left[0][0] == "Rest":
            if still[0] > 4:
                seen.append(see(studio))
                del left[0]
        elif hands and left:
            for _ in range(in_a_frame):
                if left and left[0][0] != "Rest":
                    hands[0].stroke(*left.pop(0))
            hands[0].sync()
            still[0] = 0
        elif still[0] > 4:
            still[0] = 0
            seen.append(see(studio))
            if hands:
                hands.pop().close()
                hello_imgui.get_runner_params().app_shall_exit = True
            else:
                hands.append(Hand(studio.ui.area))
                hands[0].enter()

    params.callbacks.pre_new_frame = before_frame
    params.callbacks.after_swap = after_frame
    immapp.run(params, immapp.AddOnsParams())
    return seen if not hands else [*seen, see(studio)]


def strokes(text: str) -> list[Stroke]:
    """Down and up of each word: "Control_L+a" is a chord, "a" a key."""
    script: list[Stroke] = []
    for chord in text.split():
        names = chord.split("+")
        script += [(name, True) for name in names]
        script += [(name, False) for name in reversed(names)]
    return script
