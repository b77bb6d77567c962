"""Photos without splats: what can be made of them, how, and the curves while it is made."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from imgui_bundle import ImVec2, ImVec4, imgui

from gaga_core.errors import GagaError
from gaga_studio.features import commands, reconstruction
from gaga_studio.features.find import association
from gaga_studio.features.reconstruction import ReconstructionPlan
from gaga_studio.session.notices import Level, Request
from gaga_studio.session.session import Session
from gaga_studio.session.view import TrainingPreview, smoothed
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.chrome.status_bar import duration
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.modal import begin_modal
from gaga_studio.ui.kit.requests import RequestTable
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face
from gaga_studio.ui.viewport import placement
from gaga_studio.ui.viewport.placement import NAMES

if TYPE_CHECKING:
    from gaga_core.pipeline.reconstruct import PhotoFind

SHEET = "Make splats"
_QUALITIES = (
    ("draft", "Draft", "Minutes on a processor; enough to find objects in"),
    ("standard", "Standard", "About an hour on a processor"),
    ("full", "Full", "The published schedule, for a graphics card or a night"),
)
_MOST_SIDE, _MOST_ITERATIONS = 8192, 1_000_000


@dataclass
class PlanSheet:
    """What is to be made of the photos, as the sheet says."""

    plan: ReconstructionPlan | None = None
    photos: "PhotoFind | None" = None  # that it is for


def register(table: RequestTable) -> None:
    """Answer the request for the settings."""
    table.register_popup(Request.MAKE_SPLATS, SHEET)


def draw_photos(session: Session) -> None:
    """Instead of the picture: the photos that are open, and one button that makes splats."""
    found = session.photos
    if found is None:
        return
    room = imgui.get_content_region_avail()
    imgui.set_cursor_pos_y(imgui.get_cursor_pos_y() + max((room.y - em(9)) * 0.42, em(0.5)))
    with theme.face(strong=True, scale=1.35):
        widgets.wrapped(found.name, theme.TEXT)
    missing = reconstruction.too_few(found)
    widgets.wrapped(missing or reconstruction.found_text(found), theme.DIM)
    imgui.dummy(ImVec2(0, em(0.6)))
    label = _label(session, found)
    width = imgui.calc_text_size(label).x + em(4.5)
    _centre(room, width)
    face = Face(label, icons.RUN, width=width, primary=True)
    command_buttons.command_button(session, "file.make_splats", "Make splats", face)
    imgui.dummy(ImVec2(0, em(0.1)))
    pair = em(9) * 2 + imgui.get_style().item_spacing.x
    _centre(room, pair)
    if widgets.button("Settings…", Face(width=em(9)), why_not=reconstruction.why_not(session)):
        commands.run("file.make_splats_as", session)
    imgui.same_line()
    if widgets.button("Open another…", Face(width=em(9))):
        commands.run("file.open_folder", session)


def _centre(room: ImVec2, width: float) -> None:
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + max((room.x - width) / 2, 0))


def _label(session: Session, found: "PhotoFind") -> str:
    """ "Make splats from 50 photos, about 4 min"; no time where too few cannot make any."""
    if reconstruction.too_few(found):
        return reconstruction.title(session)
    seconds = found.seconds(reconstruction.plan_of(found).config)
    return association.StageOffer(
        "", reconstruction.title(session), seconds=max(seconds, 1.0)
    ).label


# --- while it runs


def draw_live(session: Session, corner: ImVec2, size: ImVec2) -> None:
    """A card over the picture: how far the training is, its loss and its held-out quality."""
    training = session.training
    if training is None:
        return
    width = min(em(17), size.x - em(2))
    if width < em(10):
        return
    at = ImVec2(corner.x + em(0.8), corner.y + em(0.8))
    imgui.set_next_window_pos(at, imgui.Cond_.always)
    imgui.push_style_color(imgui.Col_.child_bg, theme.POPUP)
    imgui.push_style_color(imgui.Col_.border, theme.LINE_STRONG)
    flags = imgui.ChildFlags_.borders | imgui.ChildFlags_.auto_resize_y
    flags |= imgui.ChildFlags_.always_use_window_padding
    if imgui.begin_child("Training", ImVec2(width, 0), flags):
        _card(session, training, small=size.y < em(22))
    imgui.end_child()
    imgui.pop_style_color(2)


def _card(session: Session, training: TrainingPreview, *, small: bool) -> None:
    update, job = training.update, session.jobs.running
    with theme.face(strong=True):
        widgets.line(f"Training {training.name}")
    if update is None:
        widgets.dim(job.message if job is not None else "", wrap=True)
    if training.placement is not None and not small:
        placement.draw_placement(training.placement)
    if update is None:
        return
    text = f"{update.iteration:,} of {training.iterations:,}  ·  {update.n_splats:,} splats"
    widgets.dim(text, wrap=True)
    if job is not None and job.eta_s is not None:
        widgets.dim(f"{duration(job.eta_s)} left")
    if small:
        return
    imgui.dummy(ImVec2(0, em(0.1)))
    losses = smoothed(update.losses)
    last = f"{losses[-1][1]:.4f}" if losses else ""
    chart("Loss", last, losses, training.iterations, theme.ACCENT)
    measured = [(float(m.iteration), m.psnr) for m in update.measured]
    last = f"{measured[-1][1]:.1f} dB" if measured else "not measured yet"
    chart("Held-out PSNR", last, measured, training.iterations, theme.GOOD)


def chart(
    title: str, value: str, points: Sequence[tuple[float, float]], x_end: float, color: ImVec4
) -> None:
    """A line over 0..``x_end`` with its name, its newest value, and its range at the left edge."""
    width, height = imgui.get_content_region_avail().x, em(4.2)
    widgets.dim(title)
    imgui.same_line()
    widgets.number(value)
    low = imgui.get_cursor_screen_pos()
    high = ImVec2(low.x + width, low.y + height)
    drawing = imgui.get_window_draw_list()
    drawing.add_rect_filled(low, high, theme.u32(theme.BACK), em(0.25))
    imgui.dummy(ImVec2(width, height))
    if not points:
        return
    values = [y for _, y in points]
    bottom, top = min(values), max(values)
    span, pad = max(top - bottom, 1e-9), em(0.4)
    line: list[ImVec2 | tuple[float, float] | list[float]] = [
        ImVec2(
            low.x + pad + (width - 2 * pad) * min(x / max(x_end, 1), 1.0),
            high.y - pad - (height - 2 * pad) * ((y - bottom) / span if top > bottom else 0.5),
        )
        for x, y in points
    ]
    drawing.add_polyline(line, theme.u32(color), theme.scaled(1.6), 0)
    drawing.add_circle_filled(line[-1], theme.scaled(2.6), theme.u32(color))
    with theme.face(scale=0.78):
        for y, text in ((low.y + em(0.1), _short(top)), (high.y - em(1.15), _short(bottom))):
            if top > bottom:
                right = high.x - imgui.calc_text_size(text).x - em(0.3)
                drawing.add_text(ImVec2(right, y), theme.u32(theme.FAINT), text)


def _short(value: float) -> str:
    return f"{value:.1f}" if abs(value) >= 1 else f"{value:.3f}"


# --- the sheet


def sheet(session: Session, held: PlanSheet) -> None:
    """Settings of what is to be made."""
    if not begin_modal(SHEET, em(32)):
        return
    found = session.photos
    if found is None:
        imgui.close_current_popup()
        imgui.end_popup()
        return
    if held.plan is None or held.photos is not found:
        held.plan, held.photos = reconstruction.plan_of(found), found
    with theme.face(strong=True, scale=1.2):
        imgui.text_unformatted(reconstruction.title(session))
    widgets.dim(reconstruction.found_text(found), wrap=True)
    imgui.dummy(ImVec2(0, em(0.2)))
    try:
        plan = _fields(held.plan, found)
    except GagaError as error:
        session.notify(Level.WARNING, str(error))
        plan = held.plan
    held.plan = plan
    imgui.dummy(ImVec2(0, em(0.3)))
    _sheet_end(session, found, plan)
    imgui.end_popup()


def _fields(plan: ReconstructionPlan, found: "PhotoFind") -> ReconstructionPlan:
    config = plan.config
    names = [name for name, _, _ in _QUALITIES]
    at = names.index(config.quality)
    widgets.field_name("Quality", em(NAMES))
    changed, at = imgui.combo("##Quality", at, [title for _, title, _ in _QUALITIES])
    if changed:
        plan = reconstruction.plan_with(plan, quality=names[at])
    widgets.dim(_QUALITIES[at][2], wrap=True)
    settings = plan.config.train()
    widgets.field_name("Longest side, pixels", em(NAMES))
    changed, side = imgui.input_int("##Longest side, pixels", settings.longest_side, 80, 320)
    if changed:
        plan = reconstruction.plan_with(plan, max_side=min(max(side, 64), _MOST_SIDE))
    widgets.field_name("Iterations", em(NAMES))
    changed, count = imgui.input_int("##Iterations", settings.iterations, 500, 5000)
    if changed:
        plan = reconstruction.plan_with(plan, iterations=min(max(count, 1), _MOST_ITERATIONS))
    if not found.is_placed:
        plan = placement.draw_fields(plan, found)
    widgets.under_fields(em(NAMES))
    changed, hold = widgets.checkbox(
        "Hold the test photos out, to measure on", plan.config.hold_out
    )
    widgets.tooltip("Those of split.json where there is one. Without, all photos are trained on.")
    if changed:
        plan = replace(plan, config=replace(plan.config, hold_out=hold))
    widgets.under_fields(em(NAMES))
    changed, antialiased = widgets.checkbox("Antialiased", plan.config.antialiased)
    widgets.tooltip("Splats that also look right from nearer and from farther away (mip mode)")
    if changed:
        plan = replace(plan, config=replace(plan.config, antialiased=antialiased))
    widgets.under_fields(em(NAMES))
    changed, exposure = widgets.checkbox("Photos differ in brightness", plan.config.exposure)
    widgets.tooltip("Train brightness and white balance of each photo along, and leave them out")
    if changed:
        plan = replace(plan, config=replace(plan.config, exposure=exposure))
    if found.photos is not None:
        widgets.field_name("Scene folder", em(NAMES))
        changed, text = imgui.input_text("##Scene folder", str(plan.scene))
        if changed and text.strip():
            plan = replace(plan, scene=Path(text.strip()).expanduser())
    return plan


def _sheet_end(session: Session, found: "PhotoFind", plan: ReconstructionPlan) -> None:
    """The estimate and the buttons."""
    is_other = found.going_on is not None and plan.config != found.going_on
    if is_other:
        widgets.dim("With other settings the training starts again.", wrap=True)
        found = replace(found, iteration=0)
    about = association.StageOffer("", "", seconds=max(found.seconds(plan.config), 1.0)).duration
    widgets.dim(f"It takes {about} on the processor here.")
    width = em(8)
    room, gap = imgui.get_content_region_avail().x, imgui.get_style().item_spacing.x
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + room - 2 * width - gap)
    face = Face("Start", icons.RUN, width=width, primary=True)
    if widgets.button("Start", face, why_not=reconstruction.why_not(session)):
        imgui.close_current_popup()
        reconstruction.make(session, plan)
    imgui.same_line()
    if widgets.button("Cancel", Face(width=width)):
        imgui.close_current_popup()
