"""The keys that fly: held since a press that meant to fly."""

from collections.abc import Callable

from imgui_bundle import imgui

_ANY_POPUP = imgui.PopupFlags_.any_popup_id | imgui.PopupFlags_.any_popup_level


class FlyKeys:
    """Follows W A S D Q E by their place, from frame to frame.

    A key flies from its press on, if that was no shortcut and no typed letter: who lets go of Ctrl
    before the S of Ctrl+S does not fly backwards.
    """

    def __init__(self, letters: Callable[[], dict[str, str]]) -> None:
        self._find_letters = letters  # place of each key -> the letter that it types here
        self._letters: dict[str, str] = {}
        self._held: set[str] = set()
        self.are_new = False  # the first of them went down in this frame

    def held(self, *, is_flying: bool) -> frozenset[str]:
        """The places of the keys that fly now; ``is_flying``: Shift+D is no shortcut then."""
        if not self._letters:
            self._letters = self._find_letters()
        keys = {place: getattr(imgui.Key, name.lower()) for place, name in self._letters.items()}
        before = set(self._held)
        self._held = {place for place in before if imgui.is_key_down(keys[place])}
        io = imgui.get_io()
        if io.want_text_input or imgui.is_popup_open("", _ANY_POPUP):
            self._held.clear()
        elif not io.key_ctrl:
            went_down = {p for p, key in keys.items() if imgui.is_key_pressed(key, False)}
            if io.key_shift and not is_flying and not self._held:
                went_down.discard("D")
            self._held |= went_down
        self.are_new = bool(self._held) and not before
        return frozenset(self._held)
