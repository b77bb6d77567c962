"""Gestures: which drag means what, and that nothing of it is lost."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pytest

from gaga_studio.tools.gestures import (
    CLICK_PIXELS,
    Act,
    Action,
    Gestures,
    KeyState,
    PointerState,
    fly_move,
    how_of,
)

_REST = PointerState(100, 100, 800, 600)
_PLAIN = KeyState()
Frame = Mapping[str, Any]


def _play(
    frames: Sequence[Frame],
    keys: KeyState = _PLAIN,
    *,
    tool_drags: bool = False,
    looks: bool = False,
) -> list[Action]:
    """Actions of some frames, hovering left out; each frame changes the one before."""
    gestures, pointer = Gestures(), _REST
    actions: list[Action] = []
    for frame in frames:
        pointer = replace(pointer, **{"wheel": 0.0, "is_double": False, **frame})
        actions += gestures.update(pointer, keys, tool_drags=tool_drags, looks=looks)
    return [a for a in actions if a.act not in (Act.HOVER, Act.AWAY)]


def _drag(button: str) -> list[Frame]:
    return [{button: True}, {"u": 130.0}, {"u": 150.0, "v": 90.0}, {button: False}]


@pytest.mark.parametrize(
    ("button", "keys", "options", "act"),
    [
        ("middle", _PLAIN, {}, Act.ORBIT),
        ("middle", _PLAIN, {"tool_drags": True}, Act.ORBIT),
        ("middle", KeyState(shift=True), {}, Act.PAN),
        ("middle", KeyState(ctrl=True), {}, Act.ZOOM),
        ("right", _PLAIN, {}, Act.PAN),
        ("right", _PLAIN, {"looks": True}, Act.LOOK),
        ("left", _PLAIN, {}, Act.ORBIT),
        ("left", _PLAIN, {"tool_drags": True}, Act.TOOL_DRAG),
        ("left", KeyState(alt=True), {"tool_drags": True}, Act.ORBIT),
        ("left", _PLAIN, {"looks": True}, Act.LOOK),
    ],
)
def test_meaning_of_a_drag(button: str, keys: KeyState, options: dict[str, bool], act: Act) -> None:
    actions = _play(_drag(button), keys, **options)
    moves = [a for a in actions if a.act is act]
    assert len(moves) == 2
    assert sum(a.dx for a in moves) == 50
    if act is not Act.ZOOM:
        assert sum(a.dy for a in moves) == -10
    others = [a.act for a in actions if a.act is not act]
    assert others == ([Act.TOOL_PRESS, Act.TOOL_RELEASE] if act is Act.TOOL_DRAG else [])


def test_a_press_that_hardly_moves_is_a_click_where_it_went_down() -> None:
    near = 100 + CLICK_PIXELS - 1
    actions = _play([{"left": True}, {"u": near}, {"left": False}], KeyState(shift=True))
    assert actions == [Action(Act.CLICK, 100, 100, how="add")]


def test_a_drag_is_no_click_even_when_it_returns() -> None:
    actions = _play([{"left": True}, {"u": 200.0}, {"u": 100.0}, {"left": False}])
    assert [a.act for a in actions] == [Act.ORBIT, Act.ORBIT]
    assert sum(a.dx for a in actions) == 0


def test_right_click_opens_the_menu_and_middle_click_does_nothing() -> None:
    assert _play([{"right": True}, {"right": False}]) == [Action(Act.MENU, 100, 100)]
    assert _play([{"right": True}, {"u": 103.0}, {"right": False}], looks=True) == [
        Action(Act.MENU, 100, 100)
    ]
    assert _play([{"middle": True}, {"middle": False}]) == []


def test_a_right_drag_opens_no_menu_even_when_it_returns() -> None:
    actions = _play([{"right": True}, {"u": 200.0}, {"u": 100.0}, {"right": False}])
    assert [a.act for a in actions] == [Act.PAN, Act.PAN]


def test_tool_drag_starts_where_the_button_went_down() -> None:
    actions = _play(_drag("left"), KeyState(ctrl=True), tool_drags=True)
    assert actions[0] == Action(Act.TOOL_PRESS, 100, 100, how="remove")
    assert actions[-1] == Action(Act.TOOL_RELEASE, 150, 90, how="remove")


def test_double_click_is_neither_click_nor_drag() -> None:
    frames: list[Frame] = [{"left": True, "is_double": True}, {"u": 300.0}, {"left": False}]
    assert _play(frames) == [Action(Act.DOUBLE_CLICK, 100, 100)]


def test_a_press_elsewhere_does_nothing_when_it_is_dragged_in() -> None:
    frames: list[Frame] = [
        {"left": True, "is_over": False},
        {"u": 300.0, "is_over": True},
        {"left": False},
    ]
    assert _play(frames) == []


def test_a_drag_goes_on_outside_the_picture() -> None:
    frames: list[Frame] = [{"left": True}, {"u": 900.0, "is_over": False}, {"left": False}]
    assert sum(a.dx for a in _play(frames)) == 800


def test_wheel_zooms_over_the_picture_only() -> None:
    assert _play([{"wheel": 2.0}]) == [Action(Act.ZOOM, 100, 100, dy=2.0)]
    assert _play([{"wheel": 2.0, "is_over": False}]) == []


def test_a_cancelled_gesture_stays_quiet_until_the_button_is_up() -> None:
    gestures = Gestures()
    down = replace(_REST, left=True)

    def update(pointer: PointerState) -> list[Act]:
        found = gestures.update(pointer, _PLAIN, tool_drags=True, looks=False)
        return [a.act for a in found if a.act not in (Act.HOVER, Act.AWAY)]

    update(down)
    assert update(replace(down, u=150)) == [Act.TOOL_PRESS, Act.TOOL_DRAG]
    gestures.cancel()
    assert not gestures.is_dragging
    assert update(replace(down, u=190)) == []
    assert update(replace(_REST, u=190)) == []
    assert update(replace(down, u=190)) == []
    assert update(replace(_REST, u=190)) == [Act.CLICK]


def test_hovering_stops_with_a_press_and_when_the_mouse_leaves() -> None:
    gestures = Gestures()

    def acts(pointer: PointerState) -> list[Act]:
        found = gestures.update(pointer, _PLAIN, tool_drags=False, looks=False)
        return [a.act for a in found]

    assert acts(_REST) == [Act.HOVER]
    assert acts(replace(_REST, left=True)) == [Act.AWAY]
    assert acts(_REST) == [Act.CLICK, Act.HOVER]
    assert acts(replace(_REST, is_over=False)) == [Act.AWAY]
    assert acts(replace(_REST, is_over=False)) == []


def test_modifiers_of_a_selection() -> None:
    assert how_of(KeyState()) == "set"
    assert how_of(KeyState(shift=True)) == "add"
    assert how_of(KeyState(ctrl=True)) == "remove"
    assert how_of(KeyState(shift=True, ctrl=True)) == "intersect"


def _fly(letters: str, *, is_flying: bool = False, **keys: bool) -> tuple[Any, float]:
    return fly_move(KeyState(held=frozenset(letters), **keys), is_flying)


def test_fly_keys() -> None:
    assert _fly("W") == ((0, 0, 1), 1)
    assert _fly("AE") == ((-1, 1, 0), 1)
    assert _fly("QS") == ((0, -1, -1), 1)
    assert _fly("AD")[0] == (0, 0, 0)
    assert _fly("W", shift=True)[1] > 1 > _fly("W", alt=True)[1]
    assert _fly("A", ctrl=True)[0] == (0, 0, 0)  # select all


def test_shift_d_duplicates_unless_flying() -> None:
    assert _fly("D", shift=True)[0] == (0, 0, 0)
    assert _fly("D", shift=True, is_flying=True)[0] == (1, 0, 0)
    assert _fly("WD", shift=True)[0] == (1, 0, 1)
