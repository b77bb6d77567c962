"""View: how the scene is shown, and from where."""

from gaga_studio.actions import bank_timeline, navigation
from gaga_studio.commands import handlers
from gaga_studio.commands.availability import no_photos, no_scene, no_shown_bank, not_replayable
from gaga_studio.commands.base import Command, switch
from gaga_studio.commands.modes import MODE_COMMANDS
from gaga_studio.session import level_of_detail


def _axis(axis: str) -> Command:
    return Command(
        f"view.{axis}",
        f"From the {axis}",
        lambda session: session.rig.look_along(axis),
        enabled=no_scene,
    )


VIEW_COMMANDS: tuple[Command, ...] = (
    *MODE_COMMANDS,
    Command(
        "view.frame_selected",
        "Focus the selection",
        navigation.frame_selected,
        "F",
        enabled=no_scene,
    ),
    Command(
        "view.frame_all",
        "Show the whole scene",
        navigation.frame_all,
        "Shift+F",
        ("Home",),
        enabled=no_scene,
    ),
    *(_axis(axis) for axis in ("front", "back", "left", "right", "top", "bottom")),
    Command(
        "view.next_photo",
        "Next photo",
        lambda s: navigation.next_view(s, 1),
        "Right",
        enabled=no_photos,
    ),
    Command(
        "view.previous_photo",
        "Previous photo",
        lambda s: navigation.next_view(s, -1),
        "Left",
        enabled=no_photos,
    ),
    Command(
        "view.fly",
        "Fly",
        handlers.toggle_flying,
        "V",
        enabled=no_scene,
        is_on=lambda s: s.rig.is_flying,
    ),
    switch("view.frusta", "Cameras of the photos", "show_frusta", "C", enabled=no_photos),
    switch("view.outline", "Outline of the selection", "show_outline", enabled=no_scene),
    switch("view.box", "Box of the selection", "show_box", enabled=no_scene),
    switch(
        "view.lights_masks",
        "Light up the splats of the chosen mask",
        "lights_masks",
        enabled=no_shown_bank,
    ),
    switch(
        "view.mask_gate", "Depth gate of the chosen mask", "has_mask_gate", enabled=no_shown_bank
    ),
    Command(
        "view.timeline",
        "Replay the memory bank",
        bank_timeline.toggle,
        enabled=not_replayable,
        is_on=lambda s: bank_timeline.timeline_of(s).is_open,
    ),
    switch("view.lod", "Level of detail", "uses_lod", enabled=level_of_detail.no_tree),
    Command(
        level_of_detail.COMMAND,
        "Build level of detail",
        level_of_detail.build,
        enabled=level_of_detail.not_buildable,
    ),
    switch("view.panels", "Panels", "show_panels", "Tab"),
    switch("view.info", "Figures", "show_info", "I"),
)
