"""Photos without splats: what can be made of them, how, and the curves while it is made."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui

from gaga_core.errors import QUALITY_TITLES, GagaError, counted
from gaga_core.settings import setting_of
from gaga_studio.features import commands, reconstruction
from gaga_studio.features.find import association
from gaga_studio.features.reconstruction import ReconstructionPlan
from gaga_studio.session.notices import Level, Request
from gaga_studio.session.session import Session
from gaga_studio.session.view import TrainingPreview, smoothed
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.chrome.status import time_left
from gaga_studio.ui.kit import icons, textures, theme, widgets
from gaga_studio.ui.kit.modal import answer, begin_modal, body
from gaga_studio.ui.kit.path_field import path_field
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

if TYPE_CHECKING:
    from gaga_core.pipeline.place import PlacementReport
    from gaga_core.pipeline.reconstruct import PhotoFind

# --- The placement of photos: its settings, and a picture of what is placed and what links it.

_POSES = (
    ("refine", "", "Refine", "Adjust the poses next to the photos, if that is better"),
    ("keep", "", "Use as they are", "The scene has exactly the poses that were given"),
    (
        "scale",
        "",
        "Only scale",
        "Place the photos again; only scale and vertical are used",
    ),
    ("ignore", "", "Ignore", "As if there were no poses"),
)
NAMES = 10.5  # width of the names of fields, ems
_NAMED = 6  # photos without a place that are listed
_CUT_OUT = 5.0  # em: width of the example without its background, 4:3; upright ones are as high
_FAINT, _STRONG = 0.10, 0.75  # opacity of a weak and of a strong link
_MANY = 150.0  # matches of a strong link


def draw_fields(
    session: Session, plan: ReconstructionPlan, found: "PhotoFind"
) -> ReconstructionPlan:
    """Draw the settings of the placement; return the plan with what was changed."""
    config = plan.config
    if not found.is_video:
        widgets.dim("Poses next to the photos")
        chosen = widgets.segmented("Poses", _POSES, config.poses, why_not={}, wraps=True)
        if chosen != config.poses:
            plan = reconstruction.plan_with(plan, "poses", chosen)
        tip = "Poses of another program, a file or a folder; empty: what lies next to the photos"
        plan = draw_setting(plan, "poses_from", config.poses_from or "", tip)
    tip = "Of the photos as they are; 0: from EXIF, else estimated"
    plan = draw_setting(plan, "focal", config.focal or 0.0, tip)
    if found.is_video:
        tip, rate = "0: by the camera's motion, the sharpest ones", config.video_fps or 0.0
        plan = draw_setting(plan, "video_fps", rate, tip, form="%.1f")
    tip = "For all attempts to place the photos; 0: as the quality says"
    plan = draw_setting(plan, "place_minutes", config.place_minutes or 0.0, tip)
    if config.scene > 1:  # else nothing has said that the photos show several
        tip = "Which one, by its number of photos, when the photos show several"
        plan = draw_setting(plan, "scene", config.scene, tip)
    tip = "The object turned in front of a fixed camera, where that is not found without asking"
    plan = draw_setting(plan, "turntable", config.turntable, tip)
    tip = "A folder with NAME.png for each photo, black = background; empty: it is looked for"
    right = imgui.calc_text_size("Choose…").x + 3 * imgui.get_style().frame_padding.x
    plan = draw_setting(plan, "foreground", config.foreground or "", tip, right=right)
    imgui.same_line()
    if widgets.button("Choose masks", Face("Choose…"), hint="Choose the folder"):
        session.request = Request.OBJECT_MASKS
        imgui.close_current_popup()
    return plan


def draw_setting(
    plan: ReconstructionPlan,
    name: str,
    shown: float | str,  # value of the field; its type says which field it is: text is a path
    tip: str = "",
    *,
    steps: tuple[int, int] = (1, 100),
    form: str = "%.0f",
    right: float = 0.0,  # pixels that are left free next to it
) -> ReconstructionPlan:
    """Draw the field ``name`` of the settings by its description; return the plan."""
    about = setting_of(plan.config, name)
    changed, value = False, shown
    if isinstance(shown, bool):
        widgets.under_fields(em(NAMES))
        changed, value = widgets.checkbox(about.label, shown)
    else:
        widgets.field_name(about.label, em(NAMES), right)
    if isinstance(shown, str):
        changed, text = path_field(f"##{about.label}", shown, Path())
        value = text.strip()
    elif isinstance(shown, float):
        form = form if shown else "automatic"
        changed, number = imgui.input_float(f"##{about.label}", shown, 0, 0, form)
        value = about.clamped(number)
    elif not isinstance(shown, bool):
        changed, count = imgui.input_int(f"##{about.label}", shown, *steps)
        value = int(about.clamped(count))
    widgets.tooltip(tip)
    return reconstruction.plan_with(plan, name, value) if changed else plan


def draw_placement(session: Session, placement: "PlacementReport") -> None:
    """Draw how many photos have a place, the links between photos as a ring, who is out, and an
    example of what is left out of the photos."""
    widgets.dim("Placed")
    imgui.same_line()
    widgets.number(f"{placement.n_placed} of {counted(len(placement.names), 'photo')}")
    _ring(placement)
    if placement.cut_out is not None:
        texture = textures.cut_out(session, *placement.cut_out)
        aspect = 4 / 3 if texture is None else texture[1] / texture[2]
        textures.place(texture, em(_CUT_OUT) * min(aspect * 3 / 4, 1.0), aspect)
        imgui.same_line()
        widgets.dim("Darkened here: the background, which is left out", wrap=True)
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
    widgets.tooltip("Dots are photos in their order, lines are matches, red ones are not placed")
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


SHEET = "Make splats"
_QUALITIES = (
    ("draft", "Draft: enough to find objects in"),
    ("standard", "Standard: a good picture"),
    ("full", "Full: the published schedule, for a graphics card or a night"),
)


@dataclass
class PlanSheet:
    """What is to be made of the photos, as the sheet says."""

    plan: ReconstructionPlan | None = None
    photos: "PhotoFind | None" = None  # that it is for
    shows_more: bool = False  # all settings, also when the sheet comes back from a file dialog


def draw_photos(session: Session) -> None:
    """Instead of the picture: the photos that are open, and one button that makes splats."""
    found = session.photos
    if found is None:
        return
    room = imgui.get_content_region_avail()
    imgui.set_cursor_pos_y(imgui.get_cursor_pos_y() + max((room.y - em(9)) * 0.42, em(0.5)))
    buttons = 2 * imgui.get_frame_height_with_spacing() + em(1.4)
    most = ImVec2(room.x, max(room.y - imgui.get_cursor_pos_y() - buttons, em(3)))
    imgui.set_next_window_size_constraints(ImVec2(0, 0), most)
    imgui.begin_child("Photos", ImVec2(0, 0), imgui.ChildFlags_.auto_resize_y)
    with theme.face(strong=True, scale=1.35):
        widgets.wrapped(found.name, theme.TEXT)
    missing = reconstruction.too_few(found)
    widgets.wrapped(missing or reconstruction.found_text(found), theme.DIM)
    imgui.end_child()
    imgui.dummy(ImVec2(0, em(0.6)))
    labels = _labels(session, found)
    wide = [imgui.calc_text_size(label).x + em(4.5) for label in labels]
    at = next((i for i, width in enumerate(wide) if width <= room.x), -1)
    label, width = labels[at], min(wide[at], room.x)
    _centre(room, width)
    face = Face(label, icons.RUN, width=width, primary=True)
    command_buttons.command_button(session, "file.make_splats", "Make splats", face)
    imgui.dummy(ImVec2(0, em(0.1)))
    style, others = imgui.get_style(), ("Settings…", "Open another…")
    wide = [em(9), em(9)]
    if sum(wide) + style.item_spacing.x > room.x:
        wide = [imgui.calc_text_size(text).x + 2 * style.frame_padding.x for text in others]
    _centre(room, sum(wide) + style.item_spacing.x)
    if widgets.button(others[0], Face(width=wide[0]), why_not=reconstruction.why_not(session)):
        commands.run("file.make_splats_as", session)
    imgui.same_line()
    if widgets.button(others[1], Face(width=wide[1])):
        commands.run("file.open_folder", session)


def _centre(room: ImVec2, width: float) -> None:
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + max((room.x - width) / 2, 0))


def _labels(session: Session, found: "PhotoFind") -> tuple[str, ...]:
    """ "Make splats from 50 photos, about 4 min", and shorter ones; no time where too few cannot
    make any."""
    title, short = reconstruction.title(session), "Make splats"
    if reconstruction.too_few(found):
        return title, short
    seconds = reconstruction.seconds_of(session, found, reconstruction.plan_of(found))
    offers = [association.StageOffer("", text, seconds=seconds).label for text in (title, short)]
    return (*offers, short)


# --- while it runs


def draw_live(session: Session, corner: ImVec2, size: ImVec2) -> ImVec2:
    """A card over the picture: how far the training is, its loss and its held-out quality.

    Returns its lower right corner; 0, 0 where there is none.
    """
    training = session.training
    if training is None:
        return ImVec2(0, 0)
    width = min(em(17), size.x - em(2))
    if width < em(10):
        return ImVec2(0, 0)
    at = ImVec2(corner.x + em(0.8), corner.y + em(0.8))
    imgui.set_next_window_pos(at, imgui.Cond_.always)
    most = ImVec2(width, size.y - em(1.6))  # what is higher scrolls
    imgui.set_next_window_size_constraints(ImVec2(width, 0), most)
    widgets.card("Training", width, lambda: _card(session, training, small=size.y < em(22)))
    return imgui.get_item_rect_max()


def _card(session: Session, training: TrainingPreview, *, small: bool) -> None:
    update, job = training.update, session.jobs.running
    if update is None or training.is_stopped or not small:  # else the picture needs the room
        with theme.face(strong=True):
            widgets.line(f"{'Stopped' if training.is_stopped else 'Training'}: {training.name}")
    if update is None:
        widgets.dim(job.message if job is not None else "", wrap=True)
    if update is None:
        if training.placement is not None and not small:
            draw_placement(session, training.placement)
        if training.is_stopped:
            _what_now(session)
        return
    text = (
        f"{update.iteration:,} of {training.iterations:,}  ·  {counted(update.n_splats, 'splat')}"
    )
    if not small:
        widgets.dim(text, wrap=True)
    elif not training.is_stopped:  # else the buttons need the room
        widgets.line(text, theme.DIM)
    if job is not None and job.eta_s is not None and not small:  # the status line says it, too
        widgets.dim(time_left(job.eta_s))
    if training.is_stopped:
        _what_now(session)
    else:
        _while_it_runs(session, small=small)
    if small:
        return
    imgui.dummy(ImVec2(0, em(0.1)))
    losses = smoothed(update.losses)
    last = f"{losses[-1][1]:.4f}" if losses else ""
    chart("Loss", last, losses, training.iterations, theme.ACCENT)
    measured = [(float(m.iteration), m.psnr) for m in update.measured]
    last = f"{measured[-1][1]:.1f} dB" if measured else "not measured yet"
    chart("Held-out PSNR", last, measured, training.iterations, theme.GOOD)
    if training.placement is not None:  # the longest comes last: a low picture shows its beginning
        draw_placement(session, training.placement)


def _while_it_runs(session: Session, *, small: bool) -> None:
    """The button that ends it, and where there is room the switch of the turning picture."""
    hint = "What is there becomes the scene. File, Go on training takes the training up again."
    face = Face("Stop here", width=imgui.get_content_region_avail().x)
    if widgets.button("Stop here", face, hint=hint):
        reconstruction.stop_here(session)
    if small:  # the switch is in the menu View, too
        return
    changed, _ = widgets.checkbox("Turn the picture", reconstruction.turns(session))
    if changed:
        commands.run("view.turn_in_training", session)


def _what_now(session: Session) -> None:
    """What can be done with the splats of a training that was cancelled."""
    width = imgui.get_content_region_avail().x
    command_buttons.command_button(
        session,
        "file.make_splats",
        "Continue",
        Face("Continue training", width=width, primary=True),
    )
    hint = "Save the splats as they are into the scene folder, and open it"
    if widgets.button("Keep these splats", Face(width=width), hint=hint):
        reconstruction.keep_stopped(session)
    back = f"Back to {reconstruction.before_training(session)}"
    if widgets.button("Back to the photos", Face(back, width=width)):
        reconstruction.leave_stopped(session)


def chart(
    title: str, value: str, points: Sequence[tuple[float, float]], x_end: float, color: ImVec4
) -> None:
    """A line over 0..``x_end`` with its name, its newest value, and its range right of it."""
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
    labels = (_short(top), _short(bottom)) if top > bottom else ()
    with theme.face(scale=0.78):
        wide = max((imgui.calc_text_size(text).x + em(0.4) for text in labels), default=0.0)
    line: list[ImVec2 | tuple[float, float] | list[float]] = [
        ImVec2(
            low.x + pad + (width - wide - 2 * pad) * min(x / max(x_end, 1), 1.0),
            high.y - pad - (height - 2 * pad) * ((y - bottom) / span if top > bottom else 0.5),
        )
        for x, y in points
    ]
    drawing.add_polyline(line, theme.u32(color), theme.scaled(1.6), 0)
    drawing.add_circle_filled(line[-1], theme.scaled(2.6), theme.u32(color))
    with theme.face(scale=0.78):
        for y, text in zip((low.y + em(0.1), high.y - em(1.15)), labels, strict=False):
            left = high.x - imgui.calc_text_size(text).x - em(0.3)
            drawing.add_text(ImVec2(left, y), theme.u32(theme.FAINT), text)


def _short(value: float) -> str:
    return f"{value:.1f}" if abs(value) >= 1 else f"{value:.3f}"


# --- the sheet


def sheet(session: Session, held: PlanSheet) -> None:
    """Settings of what is to be made."""
    found = reconstruction.meant(session)
    if not begin_modal(SHEET, em(32), is_possible=found is not None) or found is None:
        return
    if held.plan is None or held.photos is not found:
        held.plan, held.photos = reconstruction.plan_of(found), found
    masks = reconstruction.take_chosen_masks(session)
    if masks:
        held.plan = reconstruction.plan_with(held.plan, "foreground", masks)
    with body("Plan"):
        with theme.face(strong=True, scale=1.2):
            imgui.text_unformatted(theme.plain(reconstruction.title_of(found)))
        is_again = found is not session.photos
        said = f"For a new scene, {found.scene.name}. The open one stays as it is saved."
        widgets.dim(said if is_again else reconstruction.found_text(found), wrap=True)
        _photo_row(session, found)
        imgui.dummy(ImVec2(0, em(0.2)))
        try:
            plan = _fields(session, held, held.plan, found)
        except GagaError as error:
            session.notify(Level.WARNING, str(error))
            plan = held.plan
        held.plan = plan
        imgui.dummy(ImVec2(0, em(0.3)))
        _estimate(session, found, plan)
    face = Face("Start", icons.RUN, width=em(8), primary=True)
    if answer("Start", face, why_not=reconstruction.why_not_meant(session)):
        reconstruction.make_meant(session, plan)
    imgui.end_popup()


def _photo_row(session: Session, found: "PhotoFind") -> None:
    """The first photos as pictures, as many as fit into a line."""
    aspect = found.size[0] / found.size[1]
    width, gap = em(3.2) * aspect, imgui.get_style().item_spacing.x
    n = max(int((imgui.get_content_region_avail().x + gap) / (width + gap)), 1)
    for at, path in enumerate(reconstruction.photo_files(session)[:n]):
        if at:
            imgui.same_line()
        textures.place(textures.photo_file(session, path), width, aspect)
        widgets.tooltip(path.name)


def _fields(
    session: Session, held: PlanSheet, plan: ReconstructionPlan, found: "PhotoFind"
) -> ReconstructionPlan:

    config, choices = plan.config, []
    for name, hint in _QUALITIES:
        title = QUALITY_TITLES[name]
        other = plan if name == config.quality else reconstruction.plan_with(plan, "quality", name)
        seconds = reconstruction.seconds_of(session, found, other)
        took = association.duration_text(seconds).removeprefix("about ")
        choices.append((name, "", f"{title}, {took}###{title}", hint))
    chosen = widgets.segmented("Quality", choices, config.quality, why_not={}, wraps=True)
    if chosen != config.quality:
        plan = reconstruction.plan_with(plan, "quality", chosen)
    widgets.dim(dict(_QUALITIES)[chosen], wrap=True)
    held.shows_more = widgets.section("More", held.shows_more)
    if not held.shows_more:
        return plan
    settings = plan.config.train()
    plan = draw_setting(plan, "max_side", settings.longest_side, steps=(80, 320))
    plan = draw_setting(plan, "iterations", settings.iterations, steps=(500, 5000))
    if not found.is_placed:
        plan = draw_fields(session, plan, found)
    tip = "Those of split.json where there is one. Without, all photos are trained on."
    plan = draw_setting(plan, "hold_out", plan.config.hold_out, tip)
    tip = "Splats that also look right from nearer and from farther away (mip mode)"
    plan = draw_setting(plan, "antialiased", plan.config.antialiased, tip)
    tip = "Train each photo's brightness and white balance, and keep them out of the splats"
    plan = draw_setting(plan, "exposure", plan.config.exposure, tip)
    if found.photos is not None:
        widgets.field_name("Scene folder", em(NAMES))
        changed, text = path_field("##Scene folder", str(plan.scene), Path(), only_folders=True)
        if changed and text.strip():
            plan = replace(plan, scene=Path(text.strip()).expanduser())
    return plan


def _estimate(session: Session, found: "PhotoFind", plan: ReconstructionPlan) -> None:
    """How long it takes."""
    if found.going_on is not None and plan.config != found.going_on:
        widgets.dim("With other settings the training starts again.", wrap=True)
    about = association.StageOffer(
        "", "", seconds=reconstruction.seconds_of(session, found, plan)
    ).duration
    widgets.dim(f"It takes {about} on the processor here.", wrap=True)
