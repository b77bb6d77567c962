"""Keys and mouse in the order in which they were used, however slow the frames are.

Dear ImGui takes all events since the last frame at once, so what was typed during a slow frame
becomes one moment: a letter meets the Ctrl of the next shortcut, two shortcuts run in the order of
a table, and letters reach the picture although the shortcut before them opened a text field.
`KeyQueue` gives each frame at most one key with its modifiers, and a button of the mouse a frame
after the motion before it: a press needs what was hovered, and a drag that is shorter than a frame
is a drag. Later events wait in Dear ImGui's own queue, in order.
"""

import ctypes
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from imgui_bundle import imgui

SETTLE = 3  # frames that a key gets to open a popup or a text field before the next one counts
# ImGuiInputEvent: its two values (key and state, button and state, or u and v), 4 bytes each.
_EVENT_BYTES, _FIRST_AT, _SECOND_AT, _END = 28, 12, 16, 20
_DRAG_PIXELS = 4.0  # a shorter way of the mouse is no motion
_Type = imgui.internal.InputEventType
_SIDES = {  # of each modifier, the keys that hold it
    imgui.Key.mod_ctrl: (imgui.Key.left_ctrl, imgui.Key.right_ctrl),
    imgui.Key.mod_shift: (imgui.Key.left_shift, imgui.Key.right_shift),
    imgui.Key.mod_alt: (imgui.Key.left_alt, imgui.Key.right_alt),
    imgui.Key.mod_super: (imgui.Key.left_super, imgui.Key.right_super),
}
_SHIFTS = frozenset((imgui.Key.mod_shift, *_SIDES[imgui.Key.mod_shift]))
_MODIFIERS = frozenset(key for mod, sides in _SIDES.items() for key in (mod, *sides))
_COMMANDING = frozenset((imgui.Key.mod_ctrl, imgui.Key.mod_alt, imgui.Key.mod_super))
_WITHOUT_TEXT = frozenset(  # keys that a text field takes as commands
    (
        *(getattr(imgui.Key, f"f{i}") for i in range(1, 25)),
        imgui.Key.enter,
        imgui.Key.keypad_enter,
        imgui.Key.escape,
        imgui.Key.tab,
        imgui.Key.backspace,
        imgui.Key.delete,
        imgui.Key.insert,
        imgui.Key.home,
        imgui.Key.end,
        imgui.Key.page_up,
        imgui.Key.page_down,
        imgui.Key.left_arrow,
        imgui.Key.right_arrow,
        imgui.Key.up_arrow,
        imgui.Key.down_arrow,
        imgui.Key.menu,
    )
)


@dataclass(frozen=True)
class InputEvent:
    """One event of Dear ImGui's queue, as far as the order of keys needs it."""

    type: imgui.internal.InputEventType
    key: imgui.Key = imgui.Key.none  # of key events
    button: int = 0  # of mouse buttons
    is_down: bool = False
    at: tuple[float, float] = (0.0, 0.0)  # of mouse positions, pixels of the window


class Portion:
    """Decides event by event what still belongs to this frame."""

    def __init__(
        self,
        *,
        settles: bool,
        is_typing: bool,
        commands: set[imgui.Key],
        presses: Mapping[int, tuple[float, float]],
        mouse: tuple[float, float],
    ) -> None:
        self._settles = settles  # a key of the frames before is still at work
        self._is_typing = is_typing  # a text field has the keys
        self._commands = commands  # of _COMMANDING, held now; kept up to date
        self._presses = presses  # where the mouse buttons went down that are held, pixels
        self._mouse = mouse  # where the last frame had it, pixels
        self._has_dragged = False  # one of them, in this frame
        self._has_come = False  # the mouse, from elsewhere, in this frame
        self._taken: set[imgui.Key] = set()  # keys that went down in this frame
        self._has_text = self._has_mouse = False
        self.has_command = False  # a key went down that may change who gets the next one

    def takes(self, event: InputEvent) -> bool:
        """Whether the event belongs to this frame; after the first that does not, none does."""
        match event.type:
            case _Type.key:
                return self._takes_key(event)
            case _Type.text:
                is_theirs = bool(self._taken) or (self._is_typing and not self.has_command)
                self._has_text |= is_theirs or not self._settles
                return is_theirs or not self._settles
            case _Type.mouse_pos:
                presses = self._presses.values()
                self._has_dragged |= any(_is_far(event.at, place) for place in presses)
                self._has_come |= _is_far(event.at, self._mouse)
            case _Type.mouse_button | _Type.mouse_wheel:
                self._has_mouse = True
                waits = self._has_come if event.is_down else self._has_dragged
                is_button = event.type == _Type.mouse_button
                return not self.has_command and not (is_button and waits)
            case _Type.focus:
                return not self._taken
        return True

    def _takes_key(self, event: InputEvent) -> bool:
        key = event.key
        if key >= imgui.Key.gamepad_start and key not in _MODIFIERS:
            return True
        if key in _MODIFIERS:
            if not self._takes_modifier(event):
                return False
            (self._commands.add if event.is_down else self._commands.discard)(key)
            self._commands &= _COMMANDING
            return True
        if not event.is_down:
            return key not in self._taken
        if self._is_typing and not self._commands and key not in _WITHOUT_TEXT:
            self._taken.add(key)
            return not self.has_command
        if self._settles or self.has_command or self._has_text:
            return False
        self._taken.add(key)
        self.has_command = True
        return True

    def _takes_modifier(self, event: InputEvent) -> bool:
        if self.has_command or self._has_mouse:
            return False
        if self._is_typing and event.key in _SHIFTS:
            return True
        return not (event.is_down and self._settles) and not self._has_text


class KeyQueue:
    """Divides the event queue of the present Dear ImGui context into frames."""

    def __init__(self, is_typing: Callable[[], bool] | None = None) -> None:
        self._is_typing = is_typing or (lambda: imgui.get_io().want_text_input)
        self._held = imgui.ImVector_InputEvent()
        self._commands: set[imgui.Key] = set()
        self._settles = 0  # frames
        self.is_behind = False  # events of this frame wait for the next ones

    def before_frame(self, *, opens: bool = False) -> None:
        """Leave in the queue what belongs to the frame that begins now. ``opens``: what a key asked
        for is still on its way."""
        queue = imgui.get_current_context().input_events_queue
        self._return(queue)
        self._settles = SETTLE if opens else max(self._settles - 1, 0)
        portion = Portion(
            settles=self._settles > 0,
            is_typing=self._is_typing(),
            commands=self._commands,
            presses=_presses(),
            mouse=(imgui.get_io().mouse_pos.x, imgui.get_io().mouse_pos.y),
        )
        events = events_of(queue)
        n_taken = next((i for i, e in enumerate(events) if not portion.takes(e)), len(events))
        if portion.has_command:
            self._settles = SETTLE
        self.is_behind = n_taken < len(events)
        if n_taken == len(events):
            return
        ours = imgui.ImVector_InputEvent()
        for i, event in enumerate(queue):
            (ours if i < n_taken else self._held).push_back(event)
        _refill(queue, ours)

    def after_new_frame(self) -> None:
        """Put back what waits: Dear ImGui compares new events with the last ones in its queue."""
        self._return(imgui.get_current_context().input_events_queue)

    def _return(self, queue: imgui.ImVector_InputEvent) -> None:
        """All events that wait, ours and Dear ImGui's, into ``queue`` in their order."""
        if self._held.size() == 0:
            return
        if queue.size() == 0:
            _refill(queue, self._held)
        else:
            whole = imgui.ImVector_InputEvent()
            for event in sorted([*queue, *self._held], key=lambda event: event.event_id):
                whole.push_back(event)
            _refill(queue, whole)
        self._held.clear()


def events_of(queue: imgui.ImVector_InputEvent) -> list[InputEvent]:
    """The events of a queue. The binding shows their type only: values are read from memory."""
    start = queue.data_address()
    found = []
    for i, event in enumerate(queue):
        raw = ctypes.string_at(start + _EVENT_BYTES * i, _EVENT_BYTES)
        first, second = raw[_FIRST_AT:_SECOND_AT], raw[_SECOND_AT:_END]
        if event.type == _Type.key:
            key = imgui.Key(int.from_bytes(first, "little"))
            found.append(InputEvent(event.type, key, is_down=bool(second[0])))
        elif event.type == _Type.mouse_button:
            button = int.from_bytes(first, "little")
            found.append(InputEvent(event.type, button=button, is_down=bool(second[0])))
        elif event.type == _Type.mouse_pos:
            at = struct.unpack("ff", first + second)
            found.append(InputEvent(event.type, at=at))
        else:
            found.append(InputEvent(event.type))
    return found


def correct_modifiers(n_before: int, held: Mapping[imgui.Key, bool]) -> None:
    """Let the events after the first ``n_before`` of the queue have the modifiers ``held``.

    A modifier whose release went to the window manager (Alt of Alt+F4) is released before them.
    """
    queue, io = imgui.get_current_context().input_events_queue, imgui.get_io()
    events, kept = events_of(queue)[n_before:], imgui.ImVector_InputEvent()
    for i in range(n_before):
        kept.push_back(queue[i])
    _refill(queue, kept)
    for mod, is_held in held.items():
        io.add_key_event(mod, is_held)
        for side in () if is_held else _SIDES[mod]:
            io.add_key_event(side, False)
    for event in events:
        if event.type == _Type.key and event.key not in held:
            io.add_key_event(event.key, event.is_down)
        elif event.type == _Type.mouse_button:
            io.add_mouse_button_event(event.button, event.is_down)


def _is_far(place: tuple[float, float], other: tuple[float, float]) -> bool:
    return max(abs(place[0] - other[0]), abs(place[1] - other[1])) >= _DRAG_PIXELS


def _presses() -> dict[int, tuple[float, float]]:
    """Where each mouse button went down that is held, as far as Dear ImGui has been told."""
    now, found = imgui.get_io().mouse_pos, {}
    for button in range(imgui.MouseButton_.count):
        if imgui.is_mouse_down(button):
            way = imgui.get_mouse_drag_delta(button, 0.0)
            found[button] = (now.x - way.x, now.y - way.y)
    return found


def _refill(queue: imgui.ImVector_InputEvent, events: imgui.ImVector_InputEvent) -> None:
    queue.clear()
    for event in events:
        queue.push_back(event)
