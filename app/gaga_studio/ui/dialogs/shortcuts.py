"""Keys to commands, by the character that a key types on this keyboard.

Dear ImGui's GLFW backend already names letter keys by what they type, so "Ctrl+Z" is where the
user's Z is; the fly keys alone go by place (``window.physical_keys``).
"""

from collections.abc import Callable

from imgui_bundle import imgui

from gaga_studio.features import commands
from gaga_studio.session.session import Session

_NAMED = {
    "/": imgui.Key.slash,
    ",": imgui.Key.comma,
    ".": imgui.Key.period,
    "[": imgui.Key.left_bracket,
    "]": imgui.Key.right_bracket,
    "Left": imgui.Key.left_arrow,
    "Right": imgui.Key.right_arrow,
    "Up": imgui.Key.up_arrow,
    "Down": imgui.Key.down_arrow,
}
_REPEATING = {
    "edit.undo",
    "edit.redo",
    "view.next_photo",
    "view.previous_photo",
    "tool.smaller_brush",
    "tool.larger_brush",
}


def key_of(name: str) -> imgui.Key:
    """The key of a shortcut's last part: "Z", "F1", "Delete", "/"."""
    if name in _NAMED:
        return _NAMED[name]
    if len(name) == 1 and name.isdigit():
        return imgui.Key[f"_{name}"]
    return imgui.Key[name.lower()]


def all_keys() -> dict[str, imgui.Key]:
    """Every key that some command's shortcut ends with, by its name."""
    names = {
        keys.rpartition("+")[2]
        for profile in commands.PROFILES.values()
        for listed in profile.values()
        for keys in listed
    }
    return {name: key_of(name) for name in names}


def pressed(session: Session, on_escape: Callable[[], bool]) -> None:
    """Run the command of the keys that went down in this frame.

    ``on_escape`` may end something of the window's own instead (a gesture, a card).

    Nothing while a text is being typed or a popup is open; Ctrl combinations of text fields
    (undo, copy) stay with the field.
    """
    io = imgui.get_io()
    any_popup = imgui.PopupFlags_.any_popup_id | imgui.PopupFlags_.any_popup_level
    if io.want_text_input or imgui.is_popup_open("", any_popup):
        return
    modifiers = "".join(
        f"{name}+"
        for name, down in (
            ("Ctrl", io.key_ctrl),
            ("Shift", io.key_shift),
            ("Alt", io.key_alt),
        )
        if down
    )
    for name, key in all_keys().items():
        if not imgui.is_key_pressed(key, True):
            continue
        if name == "Escape" and on_escape():
            continue
        command = commands.for_shortcut(modifiers + name, session)
        if command is not None and (command.id in _REPEATING or imgui.is_key_pressed(key, False)):
            commands.run(command.id, session)
