"""The placement of photos: its settings, and a picture of what is placed and what links it."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_studio.features import reconstruction
from gaga_studio.features.reconstruction import ReconstructionPlan
from gaga_studio.ui.kit import theme, widgets
from gaga_studio.ui.kit.theme import em

if TYPE_CHECKING:
    from gaga_core.pipeline.place import PlacementReport
    from gaga_core.pipeline.reconstruct import PhotoFind

_MOST_MINUTES, _MOST_FPS, _MOST_SCENES = 10_000.0, 60.0, 9
NAMES = 10.5  # width of the names of fields, ems
_NAMED = 6  # photos without a place that are listed
_FAINT, _STRONG = 0.10, 0.75  # opacity of a weak and of a strong link
_MANY = 150.0  # matches of a strong link


def draw_fields(plan: ReconstructionPlan, found: "PhotoFind") -> ReconstructionPlan:
    """Draw the settings of the placement; return the plan with what was changed."""
    config = plan.config
    widgets.field_name("Focal length, pixels", em(NAMES))
    changed, focal = imgui.input_float("##Focal length, pixels", config.focal or 0.0, 0, 0, "%.0f")
    widgets.tooltip("Of the photos as they are; 0: from EXIF, else estimated")
    if changed:
        plan = reconstruction.plan_with(plan, focal=max(focal, 0.0))
    if found.is_video:
        rate = config.video_fps or 0.0
        widgets.field_name("Frames of each second", em(NAMES))
        changed, rate = imgui.input_float("##Frames of each second", rate, 0, 0, "%.1f")
        widgets.tooltip("0: as the camera moves, the sharpest ones")
        if changed:
            plan = reconstruction.plan_with(plan, video_fps=min(max(rate, 0.0), _MOST_FPS))
    minutes = config.place_minutes or 0.0
    widgets.field_name("Minutes for placing", em(NAMES))
    changed, minutes = imgui.input_float("##Minutes for placing", minutes, 0, 0, "%.0f")
    widgets.tooltip("For all attempts to place the photos; 0: as the quality says")
    if changed:
        plan = reconstruction.plan_with(plan, place_minutes=min(max(minutes, 0.0), _MOST_MINUTES))
    widgets.field_name("Scene", em(NAMES))
    changed, number = imgui.input_int("##Scene", config.scene)
    widgets.tooltip("Which one, by its number of photos, when the photos show several")
    if changed:
        number = min(max(number, 1), _MOST_SCENES)
        plan = replace(plan, config=replace(plan.config, scene=number))
    widgets.under_fields(em(NAMES))
    changed, turntable = widgets.checkbox("Object on a turntable", config.turntable)
    widgets.tooltip("The object turned, the camera stood still: the background is left out")
    if changed:
        plan = replace(plan, config=replace(plan.config, turntable=turntable))
    widgets.field_name("Masks of the object", em(NAMES))
    changed, folder = imgui.input_text("##Masks of the object", config.foreground or "")
    widgets.tooltip("A folder with NAME.png for each photo, black where the background is")
    if changed:
        masks = folder.strip() or None
        plan = replace(plan, config=replace(plan.config, foreground=masks))
    return plan


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
