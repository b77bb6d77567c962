"""View: how the scene is shown, and from where."""

from gaga_studio.commands import acts, reasons
from gaga_studio.commands.base import Command
from gaga_studio.commands.modes import MODE_COMMANDS


def _axis(axis: str) -> Command:
    return Command(
        f"view.{axis}",
        f"From the {axis}",
        "View",
        lambda session: session.rig.look_along(axis),
        enabled=reasons.no_scene,
    )


VIEW_COMMANDS: tuple[Command, ...] = (
    *MODE_COMMANDS,
    Command(
        "view.frame_selected",
        "Focus the selection",
        "View",
        acts.frame_selected,
        "F",
        enabled=reasons.no_scene,
    ),
    Command(
        "view.frame_all",
        "Show the whole scene",
        "View",
        acts.frame_all,
        "Shift+F",
        ("Home",),
        enabled=reasons.no_scene,
    ),
    *(_axis(axis) for axis in ("front", "back", "left", "right", "top", "bottom")),
    Command(
        "view.next_photo", "Next photo", "View", acts.next_view, "Right", enabled=reasons.no_photos
    ),
    Command(
        "view.previous_photo",
        "Previous photo",
        "View",
        acts.previous_view,
        "Left",
        enabled=reasons.no_photos,
    ),
    Command(
        "view.fly",
        "Fly",
        "View",
        acts.toggle_flying,
        "V",
        enabled=reasons.no_scene,
        is_on=lambda s: s.rig.is_flying,
    ),
    Command(
        "view.frusta",
        "Cameras of the photos",
        "View",
        acts.toggle_frusta,
        "C",
        enabled=reasons.no_photos,
        is_on=lambda s: s.view.show_frusta,
    ),
    Command(
        "view.outline",
        "Outline of the selection",
        "View",
        acts.toggle_outline,
        enabled=reasons.no_scene,
        is_on=lambda s: s.view.show_outline,
    ),
    Command(
        "view.panels",
        "Panels",
        "View",
        acts.toggle_panels,
        "Tab",
        is_on=lambda s: s.view.show_panels,
    ),
    Command(
        "view.info", "Figures", "View", acts.toggle_info, "I", is_on=lambda s: s.view.show_info
    ),
)
