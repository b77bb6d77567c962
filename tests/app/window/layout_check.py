"""What a person would call broken in a layout: cut words, buttons over buttons, thin panels."""

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from typing import Any

from imgui_bundle import imgui

from tests.app.window.driver import Driver

_LEAST = 100  # pixels of a panel, times the scale of the text
_CLOSE = 2.0  # pixels by which neighbours may touch, and letters reach into what follows
Box = tuple[float, float, float, float]  # left, top, right, bottom


class TextWatch:
    """Looks on while texts and buttons are drawn, and notes what does not fit its place."""

    def __init__(self) -> None:
        self.found: dict[str, None] = {}  # sentences, in their order
        self.n_seen = 0
        self.is_on = False

    def frame(self, d: Driver) -> None:
        """Look at one frame, after what was just opened or resized has found its size."""
        d.frames(3)
        self.is_on = True
        d.frames(1)
        self.is_on = False

    def text(self, draw: Callable[[str], None]) -> Callable[[str], None]:
        """``draw`` a text, then look at it."""

        def drawn(text: str) -> None:
            draw(text)
            if text.strip():
                self._look(text)

        return drawn

    def button(self, draw: Callable[..., bool]) -> Callable[..., bool]:
        """``draw`` a button, then look at it and at the text inside."""

        def drawn(label: str, *rest: Any) -> bool:
            clicked = draw(label, *rest)
            text = label.split("##")[0]
            low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
            if self.is_on and imgui.calc_text_size(text).x > high.x - low.x + _CLOSE:
                self._note(text, "is wider than its button")
            self._look(text)
            return clicked

        return drawn

    def labelled(self, draw: Callable[..., Any]) -> Callable[..., Any]:
        """``draw`` a box to tick or one of several, then look at it with its label."""

        def drawn(label: str, *rest: Any) -> Any:
            answer = draw(label, *rest)
            self._look(label.split("##")[0])
            return answer

        return drawn

    def hinted(self, draw: Callable[..., Any]) -> Callable[..., Any]:
        """``draw`` a text field, then look whether its hint fits."""

        def drawn(label: str, hint: str, *rest: Any, **named: Any) -> Any:
            answer = draw(label, hint, *rest, **named)
            pad = imgui.get_style().frame_padding.x
            wide = imgui.get_item_rect_size().x - 2 * pad
            if self.is_on and imgui.calc_text_size(hint).x > wide + _CLOSE:
                self._note(hint, "is wider than its field")
            return answer

        return drawn

    def _look(self, text: str) -> None:
        """Whether what was drawn last is cut; what can be scrolled to is not."""
        if not self.is_on:
            return
        self.n_seen += 1
        window = imgui.internal.get_current_window()
        low, high, clip = imgui.get_item_rect_min(), imgui.get_item_rect_max(), window.clip_rect
        is_out = high.y <= clip.min.y or low.y >= clip.max.y
        if is_out or imgui.get_scroll_max_x() > 0:
            return
        if high.x > clip.max.x + _CLOSE or low.x < clip.min.x - _CLOSE:
            self._note(text, "is cut at the side")
        if imgui.get_scroll_max_y() == 0 and high.y > clip.max.y + _CLOSE:
            self._note(text, "is cut at the foot")

    def _note(self, text: str, what: str) -> None:
        name = imgui.internal.get_current_window().name.split("/")[0].split("##")[0]
        size = imgui.get_window_size()
        self.found[f"{name} ({size.x:.0f} x {size.y:.0f}): {text!r} {what}"] = None


def findings(d: Driver, windows: Sequence[str]) -> list[str]:
    """Panels that are too small, and items that lie over each other, a sentence each."""
    found = []
    scale = imgui.get_style().font_scale_main
    for name in windows:
        window = d.engine.get_window_by_ref(f"//{name}")
        if window is None or not window.active or window.hidden:
            continue
        if min(window.size.x, window.size.y) < _LEAST * scale:
            found.append(f"{name} is only {window.size.x:.0f} x {window.size.y:.0f}")
        found += [f"{name}: {text}" for text in _overlapping(list(_items(d, name)))]
    return found


def _items(d: Driver, window: str) -> Iterator[Box]:
    """The visible box of everything that can be clicked in a window."""
    gathered = imgui.test_engine.TestItemList()
    d.engine.gather_items(gathered, f"//{window}", -1)
    for at in range(gathered.get_size()):
        seen = gathered.get_by_index(at).rect_clipped
        if seen.max.x > seen.min.x and seen.max.y > seen.min.y:
            yield seen.min.x, seen.min.y, seen.max.x, seen.max.y


def _overlapping(items: Sequence[Box]) -> Iterator[str]:
    for a, b in combinations(items, 2):
        wide, high = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
        nested = _holds(a, b) or _holds(b, a)
        if wide > _CLOSE and high > _CLOSE and not nested:
            yield f"an item at {a} lies over one at {b}"


def _holds(outer: Box, inner: Box) -> bool:
    """A row holds its switches, the picture what is drawn on it."""
    low = outer[0] <= inner[0] + _CLOSE and outer[1] <= inner[1] + _CLOSE
    return low and outer[2] >= inner[2] - _CLOSE and outer[3] >= inner[3] - _CLOSE
