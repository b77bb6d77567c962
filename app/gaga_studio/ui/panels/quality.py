"""Sections of the inspector: how well an object agrees with its masks, how sure its splats are."""

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.arrays import DoubleArray
from gaga_studio.features import commands
from gaga_studio.features.find import memory_bank
from gaga_studio.features.selection import Uncertain
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

_WORST = 3  # views that are offered
_BINS = 20


def draw(session: Session, document: Document) -> None:
    """Both sections; each says what it knows in its header, so that it can stay closed."""
    groups = session.selected_groups()
    if len(groups) == 1 and not commands.command("object.quality").enabled(session):
        _agreement(session, groups[0])
    draw_confidence(session, document)


def _agreement(session: Session, group: int) -> None:
    found = memory_bank.quality_of(session, group)
    _, is_now = memory_bank.shown_quality(session)
    text = "not measured" if found is None else f"{100 * found.agreement:.0f} %"
    if found is not None and not is_now:
        text = f"was {text}"
    if not widgets.section(f"Quality: {text}###Quality"):
        return
    if found is None:
        widgets.dim("How well its picture agrees with the masks that made it.", wrap=True)
        command_buttons.command_button(
            session, "object.quality", "Measure", Face(icon=icons.QUALITY)
        )
        return
    n = found.n_views
    widgets.dim(
        f"Its picture and its masks agree to {100 * found.agreement:.0f} % (overlap over union, "
        f"mean of {n} view{'' if n == 1 else 's'}). Mean confidence of its splats: "
        f"{100 * found.confidence:.0f} %.",
        wrap=True,
    )
    if not is_now:
        with theme.text_color(theme.WARN):
            imgui.text_wrapped("Measured before the last change of the objects.")
        command_buttons.command_button(
            session, "object.quality", "Measure again", Face(icon=icons.QUALITY)
        )
    if found.views:
        widgets.dim("Views that agree least")
    for position, view in enumerate(found.views[:_WORST]):
        face = Face(icon=icons.CAMERA, text=f"{view.view}  {100 * view.agreement:.0f} %")
        if position:
            widgets.next_to(f"{face.icon}  {face.text}")
        hint = f"Fly there. Its masks have {view.n_mask:,} pixels, its picture {view.n_shown:,}."
        if widgets.button(f"Worst {view.view}", face, hint=hint):
            command_buttons.fly_to(session, view.view)


def draw_confidence(session: Session, document: Document) -> None:
    """How sure the selected splats are of their objects, and who is in doubt."""
    counts = document.read.confidence(_BINS)
    if counts is None:
        return
    share = float(counts @ (np.arange(_BINS) + 0.5) / max(int(counts.sum()), 1) / _BINS)
    if not widgets.section(f"Confidence: {100 * share:.0f} %###Confidence"):
        return
    _histogram(counts / max(int(counts.max()), 1), document.feature(Uncertain).threshold)
    imgui.set_next_item_width(-1)
    below = round(100 * document.feature(Uncertain).threshold)
    changed, below = imgui.slider_int("##Uncertain below", below, 1, 100, "below %d %%")
    if changed:
        document.feature(Uncertain).threshold = below / 100
    widgets.tooltip("The share of the masks' votes that a splat's object must have to be sure")
    command_buttons.command_button(session, "object.uncertain", "Select uncertain", Face())
    widgets.next_to("Clean up the edge")
    command_buttons.command_button(session, "object.clean", "Clean up the edge", Face())


def _histogram(heights: DoubleArray, below: float) -> None:
    """Bars from unsure to sure; those under the limit stand out."""
    size = ImVec2(imgui.get_content_region_avail().x, em(2.6))
    corner, drawing = imgui.get_cursor_screen_pos(), imgui.get_window_draw_list()
    drawing.add_rect_filled(
        corner, ImVec2(corner.x + size.x, corner.y + size.y), theme.u32(theme.RAISED), em(0.2)
    )
    width = size.x / len(heights)
    for i, value in enumerate(heights):
        color = theme.WARN if (i + 0.5) / len(heights) < below else theme.ACCENT_STRONG
        top = corner.y + size.y - max(float(value) * (size.y - 2), 1.0 if value > 0 else 0.0)
        low = ImVec2(corner.x + i * width + 1, top)
        drawing.add_rect_filled(
            low, ImVec2(corner.x + (i + 1) * width, corner.y + size.y), theme.u32(color, 0.85)
        )
    imgui.dummy(size)
    widgets.tooltip("Splats by confidence, from unsure (left) to sure (right)")
