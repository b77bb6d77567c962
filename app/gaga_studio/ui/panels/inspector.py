"""The selected objects: names and counts, color, placement by numbers, and what can be done."""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.arrays import DoubleArray
from gaga_core.errors import counted
from gaga_core.scene.cleanup import DROPPED, TAKEN_IN
from gaga_core.scene.orientation import Pose, degrees_of, motion_between, with_degrees
from gaga_core.scene.scene import Weight, WeightKind
from gaga_studio.features import (
    add_scene,
    cleanup,
    commands,
    fill,
    measure,
    objects,
    simulate,
    transform,
)
from gaga_studio.features.find import memory_bank
from gaga_studio.features.selection import Uncertain
from gaga_studio.features.transform import GradeSliders
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.number_fields import Limits, drag
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

# --- Placement of the selection in numbers: position, rotation, scale and size; each can be
# typed.

_LEAST, _MOST = 0.001, 1000.0  # scales
_FARTHEST = 1e4  # scene radii that a typed position may be away: farther is a slip of the keyboard


@dataclass
class PlacementState:
    """Numbers that are being dragged or typed, not applied yet."""

    target: Pose | None = None
    degrees: DoubleArray | None = None  # (3,) as typed: angles of a rotation are not unique
    verb: str = "Move"
    each_axis: bool = False  # scales of the axes change one by one

    def clear(self) -> None:
        """Forget the numbers that were being dragged."""
        self.target, self.degrees = None, None


def draw_rows(session: Session, document: Document, state: PlacementState) -> None:
    """Rows of a table of four columns."""
    start, box = document.selected_pose(), document.selected_box()
    if start is None or box is None:
        return
    extent = max(float(np.linalg.norm(box[1] - box[0])), 1e-6)
    _position(session, state, start, extent)
    _rotation(session, state, start)
    _scale(session, state, start)


def draw_below(session: Session, document: Document, state: PlacementState) -> None:
    """The size of the box, and along which axes the numbers are."""
    sizes = document.selected_sizes(local=session.view.local_axes)
    if sizes is None:
        return
    widgets.dim(f"Size  {measure.lengths(session, sizes)}", wrap=True)
    widgets.tooltip("Sides of its box along these axes, without the outermost 2 percent of splats")
    if session.view.show_box and (turned := document.selected_oriented_box()) is not None:
        widgets.dim(f"Oriented box  {measure.lengths(session, turned.size)}", wrap=True)
        widgets.tooltip("The smallest oriented box around it")
    view = session.view
    hint = "Numbers and handles along the object's own axes, else the world's"
    view.local_axes = widgets.tick("Own axes", view.local_axes, hint)
    widgets.next_to("Each axis", em(1.6))
    hint = "Scale the axes one by one, else all together"
    state.each_axis = widgets.tick("Each axis", state.each_axis, hint)
    widgets.next_to("Box", em(1.6))
    hint = "Show the smallest box around the selection in the picture"
    view.show_box = widgets.tick("Box", view.show_box, hint)
    command_buttons.command_button(session, "object.reset_placement", "Reset placement")


def _position(session: Session, state: PlacementState, start: Pose, extent: float) -> None:
    shown = state.target or start
    axes = start.axes if session.view.local_axes else np.eye(3)
    is_metric = session.need().scene.frame.is_metric
    unit = "metres" if is_metric else "scene units"
    row("Position", f"Centre of the selection, in {unit}")
    values, begun = axes.T @ shown.centre, axes.T @ start.centre
    far = _FARTHEST * session.rig.radius
    for axis, letter in enumerate("XYZ"):
        form, at = measure.number_format(session), float(begun[axis])
        limits = min(at, 0.0) - far, max(at, 0.0) + far
        now, step = float(values[axis]), extent * 0.005
        changed, value = number(f"Position {letter}", now, step, form, limits)
        if changed:
            centre = shown.centre + axes[:, axis] * (value - float(values[axis]))
            state.target, state.verb = replace(shown, centre=centre), "Move"
        _after(session, state, start, changed)


def _rotation(session: Session, state: PlacementState, start: Pose) -> None:
    shown, local = state.target or start, session.view.local_axes
    whose = "its own axes" if local else "the world's axes"
    row("Rotation" if start.is_one else "Turn by", f"Degrees about x, then y, then z: {whose}")
    degrees = degrees_of(shown, local=local) if state.degrees is None else state.degrees
    for axis, letter in enumerate("XYZ"):
        changed, value = number(f"Rotation {letter}", float(degrees[axis]), 0.5, "%.1f°")
        if changed:
            typed = degrees.copy()
            typed[axis] = value
            state.degrees, state.verb = typed, "Turn"
            state.target = with_degrees(shown, typed, local=local)
        _after(session, state, start, changed)


def _scale(session: Session, state: PlacementState, start: Pose) -> None:
    shown = state.target or start
    row("Scale" if start.is_one else "Scale by", "Along its own axes, about the centre")
    limits = (_LEAST, _MOST)
    for axis, letter in enumerate("XYZ"):
        now = float(abs(shown.scale[axis]))
        changed, value = number(f"Scale {letter}", now, 0.005, "%.3f×", limits)
        if changed and now > 0 and value > 0:
            factors = np.full(3, value / now)
            if state.each_axis:
                factors[np.arange(3) != axis] = 1.0
            state.target, state.verb = replace(shown, scale=shown.scale * factors), "Scale"
        _after(session, state, start, changed)


def _after(session: Session, state: PlacementState, start: Pose, changed: bool) -> None:
    """Show the placement that the numbers describe; keep it when a drag or a typed value ends."""
    if state.target is not None and imgui.is_key_pressed(imgui.Key.escape):  # given up
        session.cancel_preview()
        state.clear()
        imgui.internal.clear_active_id()
        return
    ended = imgui.is_item_deactivated_after_edit()
    if (changed or ended) and state.target is not None:
        transform.preview_move(session, motion_between(start, state.target), state.verb)
    if ended:
        session.commit_preview()
        state.clear()


def row(name: str, hint: str) -> None:
    """Begin a row of the table with its name."""
    imgui.table_next_row()
    imgui.table_next_column()
    imgui.align_text_to_frame_padding()
    widgets.dim(name)
    widgets.tooltip(hint)


def _next_field() -> None:
    """Go to the next column of fields, in a narrow table to the next line."""
    if imgui.table_get_column_index() == imgui.table_get_column_count() - 1:
        imgui.table_next_column()  # below the name
    imgui.table_next_column()


def as_shown(form: str, value: float) -> float:
    """``value``, but 0 where its digits are: never "-0.0°"."""
    return value if re.search("[1-9]", form % value) else 0.0


def number(
    name: str, value: float, speed: float, form: str, limits: Limits | None = None, empty: str = ""
) -> tuple[bool, float]:
    """A number in the next column: dragged or typed; ``empty`` is shown instead of 0."""
    _next_field()
    imgui.set_next_item_width(-1)
    result = drag(f"##{name}", as_shown(form, value), speed, form, limits, empty=empty)
    widgets.tooltip(f"{name}: drag, or click to type")
    return result


# --- Color grade of the selection: sliders that show at once and end as one entry of the history.

_NAMES = 6.0  # width of the names of fields, ems
_SLIDERS = (
    ("temperature", "Temperature", -1.0, 1.0, "Cold to warm"),
    ("green", "Green", -1.0, 1.0, "Magenta to green"),
    ("saturation", "Saturation", 0.0, 2.0, "Grey to vivid"),
    ("brightness", "Brightness", -0.5, 0.5, "Added to every channel"),
    ("black", "Black", -0.5, 0.5, "The level that becomes black"),
    ("white", "White", 0.5, 1.5, "The level that becomes white"),
    ("opacity", "Opacity", 0.0, 1.0, "Of every splat of the selection"),
)


def _grade(session: Session, sliders: GradeSliders) -> None:
    """A section of the inspector; closed until it is asked for."""
    if not widgets.section("Color grade"):
        return
    sliders.follow(session)
    grade, changed, ended = sliders.value, False, False
    widgets.field_name("Tint", em(_NAMES))
    moved, tint = imgui.color_edit3("##Tint", list(grade.tint), imgui.ColorEditFlags_.float)
    ended |= imgui.is_item_deactivated_after_edit()
    if moved:
        grade, changed = replace(grade, tint=(tint[0], tint[1], tint[2])), True
    for name, label, low, high, hint in _SLIDERS:
        widgets.field_name(label, em(_NAMES))
        moved, value = widgets.slider(f"##{label}", float(getattr(grade, name)), low, high)
        ended |= imgui.is_item_deactivated_after_edit()
        widgets.tooltip(hint)
        if moved:
            grade, changed = replace(grade, **{name: value}), True  # type: ignore[arg-type]
    if changed:
        sliders.show(session, grade)
    if ended:
        sliders.keep(session)
    why_not = "" if not grade.changes_nothing else "Nothing is graded yet."
    if widgets.button("Reset", why_not=why_not, hint="Take the grade back"):
        sliders.reset(session)


# --- Clean up in the inspector: what would come and go, and the two ways to end the preview.


def _cleaning(session: Session, document: Document) -> bool:
    """The preview in the place of the panel; False when there is none."""
    found = cleanup.shown(session)
    if found is None:
        return False
    counts = found.counts
    with _preview(session, "object.clean_apply", cleanup.cancel):
        _title(session, document)
        _line(
            DROPPED,
            f"{counted(len(found.remove), 'splat')} to drop",
            (
                (counts["stray"], "floater" if counts["stray"] == 1 else "floaters"),
                (counts["neighbours_out"], "of its neighbours"),
            ),
        )
        _line(
            TAKEN_IN,
            f"{counted(len(found.add), 'splat')} to add",
            ((counts["inside"], "hidden inside"), (counts["neighbours_in"], "at its edge")),
        )
        _confidence(session, document)
    return True


def draw_choice(session: Session, is_next_to: bool) -> None:
    """The choice to clean always; ``is_next_to`` the button that was drawn last."""
    command = commands.command("object.clean_first")
    if is_next_to:
        widgets.next_to(command.title, extra=imgui.get_frame_height() - em(0.6))
    if widgets.checkbox(f"{command.title}###Clean first", session.settings.clean_first)[0]:
        commands.run(command.id, session)
    widgets.tooltip("Clean whole objects before they are isolated, deleted or exported")


def _line(rgb: Sequence[float], text: str, parts: Sequence[tuple[int, str]]) -> None:
    """A dot in the color of the picture, how many, and of which kinds."""
    widgets.text("●", widgets.rgba(rgb))
    imgui.same_line(0, em(0.45))
    left = imgui.get_cursor_pos_x()
    imgui.text_unformatted(text)
    kinds = ", ".join(f"{n:,} {what}" for n, what in parts if n)
    if kinds:
        imgui.set_cursor_pos_x(left)
        widgets.dim(kinds, wrap=True)


# --- Delete and fill in the inspector: what is new, the choices, and the two ways to end it.


def _filling(session: Session) -> bool:
    """The preview in the place of the panel; False when there is none."""
    found = fill.shown(session)
    if found is None:
        return False
    edit = session.need().history.preview_edit
    title = "Delete and fill" if edit is None else edit.title
    with _preview(session, "object.fill_apply", fill.cancel):
        widgets.paragraph(title)
        for line in fill.summary(found):
            widgets.dim(line, wrap=True)
        command = commands.command("object.fill_lighten")
        label = widgets.elided(command.title, _label_room())
        if widgets.checkbox(f"{label}###Lighten", found.lighten)[0]:
            commands.run(command.id, session)
        widgets.tooltip("Lighten the object's shadow to match its surroundings")
        _colors(session)
    return True


def _adding(session: Session) -> bool:
    """The preview of an added scene in the place of the panel; False when there is none."""
    found = add_scene.shown(session)
    if found is None:
        return False
    with _preview(session, "scene.add_apply", add_scene.cancel):
        imgui.text_unformatted("Add a scene")
        for line in add_scene.summary(found):
            widgets.dim(line, wrap=True)
    return True


@contextmanager
def _preview(session: Session, apply: str, cancel: Callable[[Session], object]) -> Iterator[None]:
    """What a preview says, under the two ways to end it: those stay while the rest scrolls."""
    _apply_or_cancel(session, apply, cancel)
    imgui.begin_child("Preview")
    try:
        yield
    finally:
        imgui.end_child()


def _apply_or_cancel(session: Session, apply: str, cancel: Callable[[Session], object]) -> None:
    """The two ways to end a preview, above what it says: a low panel shows them as well."""
    imgui.dummy(ImVec2(0, em(0.2)))
    gap = theme.scaled(5)
    width = (imgui.get_content_region_avail().x - gap) / 2
    face = Face(icon=icons.CHECK, width=width, primary=True)
    command_buttons.command_button(session, apply, "Apply", face)
    imgui.same_line(0, gap)
    if widgets.button("Cancel", Face(width=width), hint="Discard the preview  Esc"):
        cancel(session)
    imgui.dummy(ImVec2(0, em(0.2)))


def _colors(session: Session) -> None:
    """Where the colors of the hole come from; the file of a model is asked for."""
    widgets.dim("Colors of the hole")
    model = Path(session.settings.inpainting_model).name
    for id_, label, is_on in (
        ("object.fill_continue", "Surroundings", not model),
        ("object.fill_model", model or "Inpainting model…", bool(model)),
    ):
        command = commands.command(id_)
        why_not = command.enabled(session)
        imgui.begin_disabled(bool(why_not))
        if widgets.radio_button(f"{widgets.elided(label, _label_room())}###{id_}", is_on):
            commands.run(id_, session)
        imgui.end_disabled()
        widgets.tooltip(why_not or command.title)


def _label_room() -> float:
    """Room for the label of a box to tick that is drawn next, pixels."""
    used = imgui.get_frame_height() + imgui.get_style().item_inner_spacing.x
    return imgui.get_content_region_avail().x - used


# --- Sections of the inspector: how well an object agrees with its masks, how sure its splats are.

_WORST = 3  # views that are offered
_BINS = 20


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
        widgets.text("Measured before the last change of the objects.", theme.WARN, wrap=True)
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


def _confidence(session: Session, document: Document) -> None:
    """How sure the selected splats are of their objects, and who is in doubt."""
    found = document.read.confidence(_BINS)
    if found is None:
        return
    share, counts = found
    if not widgets.section(f"Confidence: {100 * share:.0f} %###Confidence"):
        return
    _histogram(counts / max(int(counts.max()), 1), document.feature(Uncertain).threshold)
    imgui.set_next_item_width(-1)
    below = round(100 * document.feature(Uncertain).threshold)
    changed, below = widgets.slider("##Uncertain below", below, 1, 100, "below %d %%")
    if changed:
        document.feature(Uncertain).threshold = below / 100
    widgets.tooltip("The share of the masks' votes that a splat's object needs to be certain")
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


_COLOR_FLAGS = (
    imgui.ColorEditFlags_.no_inputs
    | imgui.ColorEditFlags_.no_label
    | imgui.ColorEditFlags_.no_alpha
    | imgui.ColorEditFlags_.no_drag_drop
    | imgui.ColorEditFlags_.no_tooltip
)


@dataclass
class InspectorState:
    """Numbers and colors that are being dragged, not applied yet."""

    placement: PlacementState = field(default_factory=PlacementState)
    color: tuple[float, float, float] | None = None
    opens_picker: bool = False
    weights: dict[WeightKind, float] = field(default_factory=dict)  # by kind
    grade: transform.GradeSliders = field(default_factory=transform.GradeSliders)


def draw(session: Session, state: InspectorState) -> None:
    """The whole panel."""
    document = session.document
    if _filling(session) or _adding(session):
        return
    if document is None or len(session.selected_indices()) == 0:
        hint = "Click an object in the view or in the list." if document is not None else ""
        widgets.empty_state(icons.BOX, "Nothing selected", hint)
        return
    if _cleaning(session, document):
        return
    _title(session, document)
    _buttons(session)
    _properties(session, document, state)
    groups = session.selected_groups()
    if len(groups) == 1 and not commands.command("object.quality").enabled(session):
        _agreement(session, groups[0])
    _confidence(session, document)
    _grade(session, state.grade)


def title(session: Session, document: Document) -> tuple[str, list[str]]:
    """What is selected, and facts of it: how many splats of objects, how many of none."""
    groups, n_loose = session.selected_groups(), document.read.n_loose()
    n_selected = len(session.selected_indices())
    if not groups:
        return "Loose splats", [counted(n_selected, "splat")]
    name = document.name_of(groups[0])
    if len(groups) > 1:
        name = f"{'Parts of ' * document.read.selects_parts()}{counted(len(groups), 'object')}"
    facts = [counted(n_selected - n_loose, "splat")]
    table = session.objects()
    row = table.row(groups[0]) if len(groups) == 1 else None
    if row is not None and n_selected - n_loose < table.counts[row]:
        facts.append(f"of {int(table.counts[row]):,}")
    if n_loose:
        facts.append(counted(n_loose, "loose splat"))
    if row is not None and table.n_views[row]:
        facts.append(f"seen in {counted(int(table.n_views[row]), 'photo')}")
    return f"{name} and loose splats" if n_loose else name, facts


def _title(session: Session, document: Document) -> None:
    name, facts = title(session, document)
    with theme.face(strong=True, scale=1.15):
        widgets.line(name)
    widgets.dim("  ·  ".join(facts), wrap=True)


def _buttons(session: Session) -> None:
    """What can be done with the selection, in equal columns."""
    room = imgui.get_content_region_avail().x
    columns = 3 if room > em(15.5) else 2
    gap = theme.scaled(5)
    width = (room - gap * (columns - 1)) / columns
    imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(gap, gap))
    for position, (command, label) in enumerate(command_buttons.SELECTION_BUTTONS):
        if position % columns:
            imgui.same_line()
        icon = command_buttons.ICONS[command] if width > em(7.2) else ""
        command_buttons.command_button(session, command, label, Face(icon=icon, width=width))
    draw_choice(session, len(command_buttons.SELECTION_BUTTONS) % columns > 0)
    imgui.pop_style_var()
    hint = "While you hold it, the selection falls and comes to rest under gravity"
    why_not = simulate.not_possible(session)
    face = Face(width=-1, text=simulate.label(session))
    widgets.button("Hold to simulate", face, why_not=why_not, hint=hint)
    if imgui.is_item_activated() and not why_not:
        simulate.start(session)
    elif imgui.is_item_deactivated():
        simulate.stop(session)


def _color(session: Session, document: Document, state: InspectorState) -> None:
    row("Color", "Recolor the selection; shading and reflections stay")
    imgui.table_next_column()
    color = list(state.color or (float(c) for c in transform.selected_color(session)))
    side = imgui.get_frame_height()
    is_clicked = imgui.color_button(
        "Color",
        widgets.rgba(color),
        _COLOR_FLAGS,
        ImVec2(imgui.get_content_region_avail().x, side),
    )
    if is_clicked or state.opens_picker:
        state.opens_picker = False
        imgui.set_scroll_here_y()
        imgui.open_popup("Color picker")
    widgets.tooltip("Recolor: shading and reflections stay")
    widgets.popup("Color picker", lambda: _picker(session, state, color), of_panel=True)
    _next_field()
    imgui.align_text_to_frame_padding()
    red, green, blue = (round(255 * min(max(c, 0.0), 1.0)) for c in color)
    widgets.dim(f"#{red:02X}{green:02X}{blue:02X}")
    if state.color is not None and not imgui.is_popup_open("Color picker"):
        session.commit_preview()  # the popup was closed with the mouse still down
        state.color = None


def _picker(session: Session, state: InspectorState, color: list[float]) -> None:
    """Live preview while the mouse is down; one entry of the history when it is released."""
    flags = imgui.ColorEditFlags_.no_alpha | imgui.ColorEditFlags_.no_side_preview
    flags |= imgui.ColorEditFlags_.display_rgb | imgui.ColorEditFlags_.display_hex
    imgui.set_next_item_width(em(14))
    changed, picked = imgui.color_picker3("##Picker", color, flags)
    if changed:
        state.color = (picked[0], picked[1], picked[2])
        transform.preview_recolor(session, state.color)
    if state.color is not None and not imgui.is_any_item_active():
        session.commit_preview()
        state.color = None


_WEIGHTS: tuple[tuple[WeightKind, str, str, float, float], ...] = (
    ("mass", "mass", "%.3f kg", 0.002, 1e5),
    ("density", "density", "%.0f kg/m³", 5.0, 25_000.0),  # osmium has 22,600
)


def _weight(session: Session, group: int, state: InspectorState) -> None:
    """Mass or density of the object: what was typed last counts."""
    row("Weight", "In simulations: mass, or density. Without either, the density of the export")
    own = session.need().scene.weights.get(group)
    for kind, empty, form, speed, most in _WEIGHTS:
        is_own = own is not None and own.kind == kind
        shown = state.weights.get(kind, own.value if own is not None and is_own else 0.0)
        word = "" if shown > 0 else empty
        changed, value = number(kind.title(), shown, speed, form, (0.0, most), word)
        if changed:
            state.weights[kind] = value
        if imgui.is_item_deactivated():
            typed = state.weights.pop(kind, shown)
            if imgui.is_item_deactivated_after_edit() and (typed > 0 or is_own):
                objects.set_weight(session, group, Weight(kind, typed) if typed > 0 else None)


_NAME = 4.0  # width of the names of properties, ems
_WIDEST = "-0.000"  # a number that has to be read in the narrowest field


def _properties(session: Session, document: Document, state: InspectorState) -> None:
    """Color, position, rotation, scale and size."""
    imgui.dummy(ImVec2(0, theme.scaled(2)))
    box = document.selected_box()
    style = imgui.get_style()
    field = imgui.calc_text_size(_WIDEST).x + 2 * (style.frame_padding.x + style.cell_padding.x)
    is_narrow = imgui.get_content_region_avail().x - em(_NAME) < 3 * field
    letters = "x" if is_narrow else "xyz"  # narrow: a line for each number
    flags = imgui.TableFlags_.no_saved_settings
    if box is None or not imgui.begin_table("Properties", 1 + len(letters), flags):
        return
    imgui.table_setup_column("what", imgui.TableColumnFlags_.width_fixed, em(_NAME))
    for letter in letters:
        imgui.table_setup_column(letter, imgui.TableColumnFlags_.width_stretch)
    _color(session, document, state)
    draw_rows(session, document, state.placement)
    if len(groups := session.selected_groups()) == 1:
        _weight(session, groups[0], state)
    imgui.end_table()
    draw_below(session, document, state.placement)
