"""Profiles of shortcuts: SuperSplat's are written with the commands, Blender's are here."""

from collections.abc import Mapping

Keys = tuple[str, ...]  # the first is shown, the others are aliases

# Fly keys are the camera's only while flying in this profile: S scales, A selects all.
BLENDER: Mapping[str, Keys] = {
    "select.all": ("A", "Ctrl+A"),
    "select.none": ("Alt+A", "Ctrl+Shift+A"),
    "select.invert": ("Ctrl+I",),
    "tool.rect": ("B",),
    "tool.brush": ("C",),
    "tool.lasso": ("L",),
    "tool.polygon": (),
    "tool.move": ("G",),
    "tool.rotate": ("R",),
    "tool.scale": ("S",),
    "edit.delete": ("X", "Delete", "Backspace"),
    "edit.duplicate": ("Ctrl+D",),
    "edit.duplicate_and_move": ("Shift+D",),
    "edit.redo": ("Ctrl+Shift+Z", "Ctrl+Y"),
    "object.separate": ("P",),
    "object.hide": ("H",),
    "object.show_all": ("Alt+H",),
    "object.isolate": ("/", "Shift+H"),
    "view.frame_selected": (".", "F"),
    "view.frame_all": ("Shift+F",),
    "view.fly": ("V",),
    "view.frusta": (),
}
