"""Keys reach Dear ImGui in the order in which they were typed, with the modifiers that they had."""

import numpy as np
import pytest
from imgui_bundle import imgui

from gaga_studio.system.key_queue import KeyQueue, events_of

KEYS = (imgui.Key.a, imgui.Key.s, imgui.Key.z, imgui.Key._3, imgui.Key.f2, imgui.Key.escape)
MODIFIERS = (
    (imgui.Key.mod_ctrl, imgui.Key.left_ctrl),
    (imgui.Key.mod_shift, imgui.Key.left_shift),
    (imgui.Key.mod_alt, imgui.Key.left_alt),
)
Stroke = tuple[imgui.Key, bool]
Press = tuple[imgui.Key, bool, bool, bool]  # key, Ctrl, Shift, Alt


def _script(rng: np.random.Generator, n: int) -> tuple[list[Stroke], list[Press]]:
    """Random strokes, keys overlapping each other and modifiers, and the presses they mean."""
    strokes: list[Stroke] = []
    presses: list[Press] = []
    down: set[imgui.Key] = set()
    mods = [False, False, False]
    for _ in range(n):
        if rng.random() < 0.35:
            i = int(rng.integers(3))
            mods[i] = not mods[i]
            strokes += [(key, mods[i]) for key in MODIFIERS[i]]
            continue
        key = KEYS[int(rng.integers(len(KEYS)))]
        if key in down:
            down.discard(key)
        else:
            down.add(key)
            presses.append((key, mods[0], mods[1], mods[2]))
        strokes.append((key, key in down))
    return strokes, presses


def _frame(queue: KeyQueue, dt: float) -> list[Press]:
    io = imgui.get_io()
    io.delta_time = dt
    queue.before_frame()
    imgui.new_frame()
    queue.after_new_frame()
    found = [
        (key, io.key_ctrl, io.key_shift, io.key_alt)
        for key in KEYS
        if imgui.is_key_pressed(key, False)
    ]
    imgui.end_frame()
    return found


@pytest.mark.parametrize("seed", range(20))
def test_presses_keep_their_order_and_modifiers_however_many_a_frame(
    context: None, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    strokes, wanted = _script(rng, 60)
    queue, found, at = KeyQueue(), [], 0
    io = imgui.get_io()
    while at < len(strokes) or queue.is_behind:
        n = int(rng.integers(0, 30))
        for key, is_down in strokes[at : at + n]:
            io.add_key_event(key, is_down)
        at += n
        found += _frame(queue, dt=float(rng.uniform(0.005, 1.5)))
    for _ in range(3):
        found += _frame(queue, 0.1)
    assert found == wanted


def test_what_is_typed_after_a_command_waits_for_the_text_field_that_it_opens(
    context: None,
) -> None:
    is_typing = [False]
    queue, io = KeyQueue(lambda: is_typing[0]), imgui.get_io()
    for key in (imgui.Key.f2, imgui.Key.a):
        io.add_key_event(key, True)
        io.add_key_event(key, False)
    io.add_input_character(ord("a"))
    assert [key for key, *_ in _frame(queue, 1.0)] == [imgui.Key.f2]
    assert _frame(queue, 1.0) == _frame(queue, 1.0) == []
    assert queue.is_behind
    is_typing[0] = True
    _frame(queue, 1.0)
    _frame(queue, 1.0)
    assert not queue.is_behind


def test_keys_are_read_from_the_queue_as_they_were_put_in(context: None) -> None:
    io = imgui.get_io()
    io.add_key_event(imgui.Key.mod_ctrl, True)
    io.add_key_event(imgui.Key.z, True)
    io.add_mouse_pos_event(3, 4)
    io.add_key_event(imgui.Key.z, False)
    events = events_of(imgui.get_current_context().input_events_queue)
    read = [(e.key, e.is_down) for e in events]
    assert read == [
        (imgui.Key.mod_ctrl, True),
        (imgui.Key.z, True),
        (imgui.Key.none, False),
        (imgui.Key.z, False),
    ]
