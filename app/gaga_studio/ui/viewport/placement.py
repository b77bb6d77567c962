"""The placement of photos: its settings, and a picture of what is placed and what links it."""

from typing import TYPE_CHECKING

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.settings import setting_of
from gaga_studio.actions import reconstruction
from gaga_studio.actions.reconstruction import ReconstructionPlan
from gaga_studio.ui.kit import theme, widgets
from gaga_studio.ui.kit.theme import em

if TYPE_CHECKING:
    from gaga_core.pipeline.place import PlacementReport
    from gaga_core.pipeline.reconstruct import PhotoFind

NAMES = 10.5  # width of the names of fields, ems
_NAMED = 6  # photos without a place that are listed
_FAINT, _STRONG = 0.10, 0.75  # opacity of a weak and of a strong link
_MANY = 150.0  # matches of a strong link


def draw_fields(plan: ReconstructionPlan, found: "PhotoFind") -> ReconstructionPlan:
    """Draw the settings of the placement; return the plan with what was changed."""
    config = plan.config
    tip = "Of the photos as they are; 0: from EXIF, else estimated"
    plan = draw_setting(plan, "focal", config.focal or 0.0, tip)
    if found.is_video:
        tip, rate = "0: as the camera moves, the sharpest ones", config.video_fps or 0.0
        plan = draw_setting(plan, "video_fps", rate, tip, form="%.1f")
    tip = "For all attempts to place the photos; 0: as the quality says"
    plan = draw_setting(plan, "place_minutes", config.place_minutes or 0.0, tip)
    tip = "Which one, by its number of photos, when the photos show several"
    plan = draw_setting(plan, "scene", config.scene, tip)
    tip = "The object turned, the camera stood still: the background is left out"
    plan = draw_setting(plan, "turntable", config.turntable, tip)
    tip = "A folder with NAME.png for each photo, black where the background is"
    return draw_setting(plan, "foreground", config.foreground or "", tip)


def draw_setting(
    plan: ReconstructionPlan,
    name: str,
    shown: float | str,  # value of the field; its type says which field it is
    tip: str = "",
    *,
    steps: tuple[int, int] = (1, 100),
    form: str = "%.0f",
) -> ReconstructionPlan:
    """Draw the field ``name`` of the settings by its description; return the plan."""
    about = setting_of(plan.config, name)
    changed, value = False, shown
    if isinstance(shown, bool):
        widgets.under_fields(em(NAMES))
        changed, value = widgets.checkbox(about.label, shown)
    else:
        widgets.field_name(about.label, em(NAMES))
    if isinstance(shown, str):
        changed, text = imgui.input_text(f"##{about.label}", shown)
        value = text.strip()
    elif isinstance(shown, float):
        changed, number = imgui.input_float(f"##{about.label}", shown, 0, 0, form)
        value = about.clamped(number)
    elif not isinstance(shown, bool):
        changed, count = imgui.input_int(f"##{about.label}", shown, *steps)
        value = int(about.clamped(count))
    widgets.tooltip(tip)
    return reconstruction.plan_with(plan, name, value) if changed else plan


def draw_placement(placement: "PlacementReport") -> None:
    """Draw how many photos have a place, the links between photos as a ring, and who is out."""
    widgets.dim("Placed")
    imgui.same_line()
    widgets.number(f"{placement.n_placed} of {len(placement.names)} photos")
    _ring(placement)
    for name, why in list(placement.left_out.items())[:_NAMED]:
        widgets.dim(f"{name}: {why}", wrap=True)
    more = len(placement.left_out) - _NAMED
    if more > 0:
        widgets.dim(f"and {more} more")


def _ring(placement: "PlacementReport") -> None:
    """Draw a dot for each photo, in their order, and a line for each pair with matches.

    Photos without a place are red. A gap in the ring is where photos are missing.
    """
    width = imgui.get_content_region_avail().x
    radius = min(width, em(11)) / 2 - em(0.5)
    corner = imgui.get_cursor_screen_pos()
    middle = ImVec2(corner.x + width / 2, corner.y + radius + em(0.5))
    imgui.dummy(ImVec2(width, 2 * radius + em(1)))
    widgets.tooltip("Dots are photos in their order, lines are matches, red has no place")
    drawing = imgui.get_window_draw_list()
    n = len(placement.names)
    angles = np.linspace(0, 2 * np.pi, n, endpoint=False) - np.pi / 2
    xs = middle.x + radius * np.cos(angles)
    ys = middle.y + radius * np.sin(angles)
    dots = [ImVec2(float(x), float(y)) for x, y in zip(xs, ys, strict=True)]
    for i, j, matches in reversed(placement.links):  # the strongest on top
        share = min(matches / _MANY, 1.0)
        opacity = _FAINT + (_STRONG - _FAINT) * share
        drawing.add_line(dots[i], dots[j], theme.u32(theme.ACCENT, opacity), theme.scaled(1.0))
    for dot, name in zip(dots, placement.names, strict=True):
        color = theme.BAD if name in placement.left_out else theme.TEXT
        drawing.add_circle_filled(dot, theme.scaled(2.2), theme.u32(color))
