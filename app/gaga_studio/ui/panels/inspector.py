"""The selected objects: names and counts, color, placement by numbers, and what can be done."""

from dataclasses import dataclass, field

from imgui_bundle import ImVec2, imgui

from gaga_core.scene.objects import ObjectTable
from gaga_studio.features import transform
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face
from gaga_studio.ui.panels import cleaning, filling, grade, inspector_placement, quality
from gaga_studio.ui.panels.inspector_placement import PlacementState

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
    grade: transform.GradeSliders = field(default_factory=transform.GradeSliders)


def draw(session: Session, state: InspectorState) -> None:
    """The whole panel."""
    document = session.document
    if filling.draw(session):
        return
    n_splats = len(session.selected_indices()) if document is not None else 0
    if document is None or n_splats == 0:
        hint = "Click an object in the view or in the list." if document is not None else ""
        widgets.empty_state(icons.BOX, "Nothing selected", hint)
        return
    _title(session, document, n_splats)
    if cleaning.draw(session):
        quality.draw_confidence(session, document)
        return
    _buttons(session)
    _properties(session, document, state)
    quality.draw(session, document)
    grade.draw(session, state.grade)


def _title(session: Session, document: Document, n_splats: int) -> None:
    groups = session.selected_groups()
    if len(groups) == 1:
        name = document.name_of(groups[0])
    elif groups:
        name = f"{len(groups)} objects"
    else:
        name = "Loose splats"
    with theme.face(strong=True, scale=1.15):
        widgets.line(name)
    facts = [f"{n_splats:,} splats"]
    if len(groups) == 1:
        facts += _facts(session.objects(), groups[0], n_splats)
    widgets.dim("  ·  ".join(facts), wrap=True)


def _facts(table: ObjectTable, group: int, n_splats: int) -> list[str]:
    row = table.row(group)
    if row is None:
        return []
    facts = []
    if n_splats < table.counts[row]:
        facts.append(f"of {int(table.counts[row]):,}")
    if table.n_views[row]:
        facts.append(f"seen in {int(table.n_views[row])} views")
    return facts


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
    cleaning.draw_choice(session, len(command_buttons.SELECTION_BUTTONS) % columns > 0)
    imgui.pop_style_var()


def _color(session: Session, document: Document, state: InspectorState) -> None:
    inspector_placement.row("Color", "Recolor the selection; shading and reflections stay")
    imgui.table_next_column()
    color = list(state.color or (float(c) for c in document.read.selected_color()))
    side = imgui.get_frame_height()
    if imgui.color_button(
        "Color",
        widgets.rgba(color),
        _COLOR_FLAGS,
        ImVec2(imgui.get_content_region_avail().x, side),
    ):
        imgui.open_popup("Color picker")
    widgets.tooltip("Recolor: shading and reflections stay")
    imgui.table_next_column()
    imgui.align_text_to_frame_padding()
    red, green, blue = (round(255 * min(max(c, 0.0), 1.0)) for c in color)
    widgets.dim(f"#{red:02X}{green:02X}{blue:02X}")
    if imgui.begin_popup("Color picker"):
        _picker(session, state, color)
        widgets.escape_closes()
        imgui.end_popup()
    elif state.color is not None:
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


def _properties(session: Session, document: Document, state: InspectorState) -> None:
    """Color, position, rotation, scale and size."""
    imgui.dummy(ImVec2(0, theme.scaled(2)))
    box = document.selected_box()
    if box is None or not imgui.begin_table("Properties", 4, imgui.TableFlags_.no_saved_settings):
        return
    imgui.table_setup_column("what", imgui.TableColumnFlags_.width_fixed, em(4.0))
    for letter in "xyz":
        imgui.table_setup_column(letter, imgui.TableColumnFlags_.width_stretch)
    _color(session, document, state)
    inspector_placement.draw_rows(session, document, state.placement)
    imgui.end_table()
    inspector_placement.draw_below(session, document, state.placement)
