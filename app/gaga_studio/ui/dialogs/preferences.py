"""Preferences, each saved as it is changed, and the keys of the commands."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from imgui_bundle import ImVec2, imgui

from gaga_core.segmentation.models.hub import HUB
from gaga_studio.features import commands
from gaga_studio.session.session import Session
from gaga_studio.session.settings import RANGES, Settings, hex_color, is_known
from gaga_studio.ui.kit import widgets
from gaga_studio.ui.kit.modal import QUESTION, begin_modal, begin_part, body_height, close_row
from gaga_studio.ui.kit.theme import em

_THEMES = {"dark": "Dark", "light": "Light"}
_PROFILES = {"supersplat": "SuperSplat", "blender": "Blender"}
_PRESETS = {
    "robust": "Robust: all views decide",
    "paper": "Paper: one view after the other",
    "released": "Released: as the paper's released code",
}
_LOG = imgui.SliderFlags_.logarithmic | imgui.SliderFlags_.always_clamp
SHEET = "Preferences"
_NAMES = 11.5  # width of the names of fields, ems


@dataclass
class DraggedPreferences:
    """Numbers that are being dragged, by the names of the settings."""

    values: dict[str, float] = field(default_factory=dict)
    mirror: str | None = None  # being typed


def draw(session: Session, dragged: DraggedPreferences) -> None:
    """The whole sheet."""
    # Not dimmed: what is chosen here is seen in the window.
    if not begin_modal(SHEET, em(31), dims=False):
        dragged.values.clear()
        dragged.mirror = None
        return
    before = session.settings
    # The rows scroll where the window is low; the button to close stays visible.
    begin_part("Rows", ImVec2(0, body_height(em(38))))
    settings = _look(before, dragged)
    settings = _handling(settings, dragged)
    settings = _work(settings, dragged)
    settings = _models(settings, dragged)
    imgui.end_child()
    if settings != before:
        session.change_settings(settings)
    close_row()
    imgui.end_popup()


def _look(settings: Settings, dragged: DraggedPreferences) -> Settings:
    widgets.heading("Look")
    settings = replace(settings, theme=_choice("Theme", _THEMES, settings.theme))
    settings = _slider(settings, dragged, "ui_scale", "Size of text and buttons", "%.2f×")
    widgets.tooltip("A small window shows them smaller, so that all of it stays in reach")
    widgets.field_name("Background", em(_NAMES))
    changed, color = imgui.color_edit3("##Background", list(settings.background_color))
    settings = replace(settings, background=hex_color(color)) if changed else settings
    settings = _slider(settings, dragged, "lod_millions", "Large scenes", "%.1f M splats", _LOG)
    widgets.tooltip("Most splats in a picture of a scene with level of detail")
    return settings


def _handling(settings: Settings, dragged: DraggedPreferences) -> Settings:
    widgets.heading("Keys and mouse")
    settings = replace(settings, keys=_choice("Keys as in", _PROFILES, settings.keys))
    settings = _slider(settings, dragged, "fly_speed", "Fly speed", "%.1f×")
    label = "The wheel is reversed"
    return replace(settings, invert_zoom=_tick(label, settings.invert_zoom))


def _work(settings: Settings, dragged: DraggedPreferences) -> Settings:
    widgets.heading("Objects and edits")
    settings = replace(settings, preset=_choice("Find objects", _PRESETS, settings.preset))
    hint = "Clean whole objects before they are isolated, deleted or exported"
    clean = _tick("Always clean first", settings.clean_first, hint)
    hint = "What is under an object is moved, copied, hidden, deleted and exported with it"
    along = _tick("Children go along", settings.children_go_along, hint)
    settings = replace(settings, clean_first=clean, children_go_along=along)
    settings = _slider(settings, dragged, "autosave_minutes", "Autosave every", "%.1f min", _LOG)
    widgets.tooltip("Most work that a crash can lose")
    settings = _slider(settings, dragged, "undo_megabytes", "Undo may hold", "%.0f MB", _LOG)
    widgets.tooltip("Beyond this limit the oldest edits can no longer be undone")
    return settings


def _models(settings: Settings, dragged: DraggedPreferences) -> Settings:
    widgets.heading("Models")
    text = settings.hub_mirror if dragged.mirror is None else dragged.mirror
    widgets.field_name("Mirror of the hub", em(_NAMES))
    changed, text = imgui.input_text_with_hint("##Mirror of the hub", HUB, text)
    edited = imgui.is_item_deactivated_after_edit()
    widgets.tooltip("Empty: the hub itself, or what HF_ENDPOINT names")
    widgets.under_fields(em(_NAMES))
    widgets.dim(
        "Copy of huggingface.co to download models from where that is not reached", wrap=True
    )
    if changed:
        dragged.mirror = text
    if edited and dragged.mirror is not None:
        typed, dragged.mirror = dragged.mirror.strip(), None
        typed = f"https://{typed}" if typed and "://" not in typed else typed
        if is_known("hub_mirror", typed):
            settings = replace(settings, hub_mirror=typed)
    hint = "Never contact a model hub; use only installed models"
    offline = _tick("Work offline", settings.works_offline, hint)
    return replace(settings, works_offline=offline)


def _tick(label: str, value: bool, hint: str = "") -> bool:
    return widgets.tick(label, value, hint, em(_NAMES))


def _choice(label: str, named: dict[str, str], current: str) -> str:
    return widgets.choice(label, named, current, em(_NAMES))


def _slider(
    settings: Settings,
    dragged: DraggedPreferences,
    name: str,
    label: str,
    shown: str,
    flags: int = imgui.SliderFlags_.always_clamp,
) -> Settings:
    """A number of the settings; it counts when the mouse lets go."""
    low, high = RANGES[name]
    value = dragged.values.get(name, float(getattr(settings, name)))
    widgets.field_name(label, em(_NAMES))
    changed, value = widgets.slider(f"##{label}", value, low, high, shown, flags)
    if changed:
        dragged.values[name] = value
    if imgui.is_item_deactivated_after_edit() and name in dragged.values:
        return replace(settings, **{name: dragged.values.pop(name)})  # type: ignore[arg-type]
    return settings


# --- Keys to commands, by the character that a key types on this keyboard.
# Dear ImGui's GLFW backend already names letter keys by what they type, so "Ctrl+Z" is where the
# user's Z is; the fly keys alone go by place (``window.physical_keys``).

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


# From their key on, as in Blender.
_FOLLOWING = {"tool.move", "tool.rotate", "tool.scale", "edit.duplicate_and_move"}
_OF_FIELDS = {"Ctrl+A", "Ctrl+C", "Ctrl+V", "Ctrl+X", "Ctrl+Z", "Ctrl+Y", "Ctrl+Shift+Z"}


@dataclass
class Shortcuts:
    """Runs the commands of the keys that are pressed."""

    follow: Callable[[], object]  # lets the selection follow the mouse
    _n_popups: int = 0  # open in the frame before
    _after_text: str = ""  # id of the command that was asked for while a text was typed

    def pressed(self, session: Session, on_escape: Callable[[], bool]) -> None:
        """Run the command of the keys that went down in this frame.

        ``on_escape`` may end something of the window's own instead (a gesture, a card).

        Nothing while a popup is open, and Escape alone while the mouse drags a handle or a number.
        While a text is being typed, Ctrl combinations of text fields (undo, copy) and keys without
        Ctrl, but for F1 to F12, stay with the field; others enter the text first.
        """
        io = imgui.get_io()
        before, self._n_popups = self._n_popups, len(imgui.get_current_context().open_popup_stack)
        if self._n_popups:
            # Where the keys walk through a list, the toolkit has closed it.
            if imgui.is_key_pressed(imgui.Key.escape, False) and self._n_popups >= before:
                _close_top()
            return
        if self._after_text and not io.want_text_input:
            command_id, self._after_text = self._after_text, ""
            commands.run(command_id, session)
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
            if io.want_text_input:
                self._leave_field(session, modifiers + name)
                continue
            if name == "Escape" and (before or on_escape()):
                continue
            if session.is_dragging and imgui.is_mouse_down(imgui.MouseButton_.left):
                continue  # what is dragged is let go first
            command = commands.for_shortcut(modifiers + name, session)
            is_new = imgui.is_key_pressed(key, False)
            if command is not None and (command.id in _REPEATING or is_new):
                done = commands.run(command.id, session)
                if done and session.settings.keys == "blender" and command.id in _FOLLOWING:
                    self.follow()

    def _leave_field(self, session: Session, keys: str) -> None:
        """Enter the text that is typed, and run the command of ``keys`` in the next frame."""
        command = commands.for_shortcut(keys, session)
        # Alt with Ctrl types letters on some keyboards. F1 and the like type nothing.
        types = "Ctrl+" not in keys and not keys.rpartition("+")[2][1:].isdecimal()
        is_its_own = keys in _OF_FIELDS or types or "Alt+" in keys
        if command is not None and not is_its_own:
            self._after_text = command.id
            imgui.internal.clear_active_id()


def _close_top() -> None:
    """Close what is open on top: a menu with its submenus, or a drop-down before its sheet."""
    is_submenu = imgui.WindowFlags_.child_menu
    opened = [popup.window for popup in imgui.get_current_context().open_popup_stack]
    top = len(opened) - 1
    while top > 0 and (window := opened[top]) is not None and window.flags & is_submenu:
        top -= 1
    if (window := opened[top]) is None or window.name != QUESTION:
        imgui.internal.close_popup_to_level(top, True)
