"""The tool bar: tools, undo, how the picture is colored, and the search."""

from collections.abc import Sequence
from functools import partial

from imgui_bundle import imgui

from gaga_studio.features import add_scene, cleanup, commands, fill, selection
from gaga_studio.features.find import click_object
from gaga_studio.session.notices import Request
from gaga_studio.session.session import Session
from gaga_studio.session.view import REGION_TOOLS, Mode, SplatLook, ToolName
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.picture_area import PictureArea
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

# --- Options of the tool: in the tool bar, or over the picture where the bar has no room for them.

_TAKES = (
    (False, icons.BOX, "Objects", "Whole objects with at least half in the region"),
    (True, icons.CENTRES, "Splats", "Single splats"),
)
_DEPTHS = (
    (False, icons.DEPTH, "Through", "Everything in the region, including what is hidden behind it"),
    (True, icons.EYE, "Visible surface", "Only what is seen from here"),
)
_MODEL_HINT = (
    "A Segment Anything model segments the clicked object in several views, in the background; "
    "its answer replaces the first one"
)
_MAKE, _CLEAR = "Make object", "Clear"
# Tools that have a button at all times; others while they are used.
_IN_BAR = {
    *REGION_TOOLS,
    ToolName.PICK,
    ToolName.OBJECT,
    ToolName.SPHERE,
    ToolName.MOVE,
    ToolName.ROTATE,
    ToolName.SCALE,
}
_RULE, _GAP, _STRENGTH = 1.3, 0.4, 6.0  # of a line between groups, between buttons, of a slider; em


def fits(session: Session, room: float) -> bool:
    """Whether the options fit in ``room`` pixels of the bar, with the search behind them."""
    wide = _width(session)
    return wide == 0 or em(_RULE) + wide + em(3.5) <= room


def draw_options(session: Session) -> None:
    """A line and the options, behind all buttons: those stay where they are."""
    if _width(session):
        rule()
        _options(session)


def draw_card(session: Session, area: PictureArea, top: float) -> float:
    """The options over the upper left of the picture, from ``top``, pixels; what is free below.

    Nothing where the bar shows them, nor over a preview or a training, which are to be looked at.
    """
    previews = (cleanup, fill, add_scene)
    if session.training is not None or any(one.shown(session) is not None for one in previews):
        return top
    if not area.has_options or not _width(session):
        return top
    imgui.set_cursor_screen_pos(imgui.ImVec2(area.left + em(0.7), top))
    imgui.push_style_var(imgui.StyleVar_.window_padding, imgui.ImVec2(em(0.35), em(0.35)))
    is_narrow = _width(session) + em(2 * 0.7 + 2 * 0.35) > area.width
    widgets.card("Tool options", 0, lambda: _options(session, is_narrow=is_narrow))
    imgui.pop_style_var()
    area.options = widgets.item_rect()
    return area.options[3] + em(0.5)


def _width(session: Session) -> float:
    """Of the options, pixels; 0: the tool has none."""
    if session.tool in REGION_TOOLS:
        labels = [label for _, _, label, _ in (*_TAKES, *_DEPTHS)]
    elif session.tool is ToolName.OBJECT:
        labels = [f"{icons.BLANK}  {label}" for label in (_MAKE, _CLEAR)]  # each with an icon
    elif session.tool in _IN_BAR:
        return 0.0
    else:
        color = imgui.get_frame_height() + em(2 * _GAP + _STRENGTH)
        return em(2) + (color if session.tool is ToolName.COLOR else 0)
    padding = 2 * imgui.get_style().frame_padding.x
    return sum(imgui.calc_text_size(label).x + padding for label in labels) + em(_GAP)


def _options(session: Session, *, is_narrow: bool = False) -> None:
    if session.tool in REGION_TOOLS:
        _what_regions_take(session, is_narrow=is_narrow)
    elif session.tool is ToolName.OBJECT:
        _clicks(session)
    elif session.tool not in _IN_BAR:
        command_buttons.command_icon(session, f"tool.{session.tool}")
        if session.tool is ToolName.COLOR:
            imgui.same_line(0, em(_GAP))
            _paint_color(session)


def _what_regions_take(session: Session, *, is_narrow: bool) -> None:
    """In words, because "rings" and "centres" are what users of other editors stumble over.

    In signs where it ``is_narrow``: two lines of words cover a third of a small picture.
    """
    view = session.view
    no_objects = selection.why_splats(session)
    what, deep = (
        [(value, icon * is_narrow, label, hint) for value, icon, label, hint in named]
        for named in (_TAKES, _DEPTHS)
    )
    takes = widgets.segmented(
        "What is selected",
        what,
        selection.takes_splats(session),
        why_not={False: no_objects},
        with_text=not is_narrow,
    )
    imgui.same_line(0, em(_GAP))
    if not no_objects:
        view.takes_splats = takes
    shown, why_not = selection.takes_surface(session), selection.why_so_deep(session)
    depth = widgets.segmented(
        "How deep", deep, shown, why_not={not shown: why_not}, with_text=not is_narrow
    )
    if not why_not:
        view.visible_only = depth


def _paint_color(session: Session) -> None:
    """The color that the brush gives, and how much of it."""
    view = session.view
    flags = imgui.ColorEditFlags_.no_inputs | imgui.ColorEditFlags_.no_label
    changed, color = imgui.color_edit3("Brush color", list(view.brush_color), int(flags))
    if changed:
        view.brush_color = (float(color[0]), float(color[1]), float(color[2]))
    widgets.tooltip("The color of the brush; Ctrl+click in the picture takes one from there")
    imgui.same_line(0, em(_GAP))
    imgui.set_next_item_width(em(_STRENGTH))
    changed, strength = widgets.slider("###Strength", view.brush_strength, 0.05, 1.0)
    if changed:
        view.brush_strength = float(strength)
    widgets.tooltip("Strength of the color: 1 replaces the old one")


def _clicks(session: Session) -> None:
    """What is done with the clicks of the tool Object."""
    command_buttons.command_button(session, "object.make", _MAKE)
    imgui.same_line(0, em(_GAP))
    command_buttons.command_button(session, "select.none", _CLEAR)
    imgui.same_line(0, em(_GAP))
    _model_of_clicks(session)


def _model_of_clicks(session: Session) -> None:
    """Which model clicks ask, and the way to get one; the menu Tools has a switch where this has
    no room."""
    chosen = click_object.chosen_model(session)
    title = widgets.elided(chosen.title if chosen is not None else "none", em(11))
    room = imgui.get_content_region_avail().x - 2 * imgui.get_style().frame_padding.x
    texts = (f"{text}  {icons.UNFOLDED}" for text in (f"Model: {title}", "Model"))
    text = next((text for text in texts if imgui.calc_text_size(text).x <= room), "")
    if not text:
        imgui.new_line()
        return
    if widgets.button("Model of the clicks", Face(text), hint=_MODEL_HINT):
        imgui.open_popup("Models for clicks")
    low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    imgui.set_next_window_pos(imgui.ImVec2(low.x, high.y + theme.scaled(2)))
    if not imgui.begin_popup("Models for clicks"):
        return
    if imgui.menu_item("None", "", chosen is None)[0]:
        click_object.choose_model(session, click_object.NO_MODEL)
    for model in click_object.models_here(session):
        if imgui.menu_item(f"{model.title}###{model.title}", "", model is chosen)[0]:
            click_object.choose_model(session, model.name)
    imgui.separator()
    command_buttons.command_item(session, "object.models")
    imgui.end_popup()


def rule(room: float = 0.6) -> None:
    """A thin line between groups of buttons, with ``room`` on both sides, em."""
    imgui.same_line(0, em(room))
    corner = imgui.get_cursor_screen_pos()
    height = imgui.get_frame_height()
    top, bottom = corner.y + height * 0.15, corner.y + height * 0.85
    imgui.get_window_draw_list().add_line(
        imgui.ImVec2(corner.x, top), imgui.ImVec2(corner.x, bottom), theme.u32(theme.LINE_STRONG)
    )
    imgui.dummy(imgui.ImVec2(1, height))
    imgui.same_line(0, em(room))


_MODES = (
    (Mode.COLOR, icons.COLOR, "Color", "The scene in its own colors"),
    (Mode.GROUPS, icons.GROUPS, "Groups", "Every object in its list color"),
    (Mode.DEPTH, icons.DEPTH, "Depth", "Near is bright, far is dark"),
)
_NARROW = 31.0  # em: a narrower bar has one button for all modes
_SELECTING = [
    f"tool.{tool}" for tool in ("pick", "object", "rect", "lasso", "polygon", "brush", "sphere")
]
_MOVING = ("tool.move", "tool.rotate", "tool.scale")
_VIEWING = ("view.frusta", "view.fly", "view.frame_all")
_ICON = 1.12  # width of an icon button, of its height
_LEAST_SEARCH = 3.0  # width of the search, em


def draw(session: Session, area: PictureArea) -> None:
    """The whole bar, left to right; what does not fit a small window is listed with the modes.

    Options of the tool that do not fit are drawn over the picture.
    """
    _paint()
    width = imgui.get_content_region_avail().x
    left = imgui.get_cursor_screen_pos().x
    is_narrow = width < em(_NARROW)
    for listed in (_SELECTING, _MOVING, ("edit.undo", "edit.redo")):
        _icons(session, listed)
        rule(0.25 if is_narrow else 0.6)
    shown = () if is_narrow else tuple(mode for mode, *_ in _MODES)
    if shown:
        _modes(session, shown, with_text=width > em(58))
    button = _ICON * imgui.get_frame_height()
    room = width - (imgui.get_cursor_screen_pos().x - left) - button
    viewing = em(2 * 0.6 + 2 * 0.15) + 3 * button
    needed = viewing + imgui.get_style().item_spacing.x + em(_LEAST_SEARCH + 0.3)
    left_out = (*_VIEWING, "help.palette") if room < needed else ()
    _more_button(session, shown, has_all=not left_out)
    _more_list(session, shown, left_out)
    if left_out:
        area.has_options = True
        return
    rule()
    _icons(session, _VIEWING)
    used = imgui.get_item_rect_max().x - left
    area.has_options = not fits(session, width - used)
    if not area.has_options:
        draw_options(session)
    imgui.same_line()
    used = imgui.get_cursor_screen_pos().x - left
    _search(session, width, used)


def _paint() -> None:
    """The ground of the bar, and of what no panel covers: round corners, the last line of pixels.

    The window's own color does not follow the theme.
    """
    corner, size = imgui.get_window_pos(), imgui.get_window_size()
    end = imgui.ImVec2(corner.x + size.x, corner.y + size.y)
    imgui.get_window_draw_list().add_rect_filled(corner, end, theme.u32(theme.BACK))
    whole = imgui.get_main_viewport()
    far = imgui.ImVec2(whole.pos.x + whole.size.x, whole.pos.y + whole.size.y)
    imgui.get_background_draw_list().add_rect_filled(whole.pos, far, theme.u32(theme.BACK))


def _modes(session: Session, shown: Sequence[Mode], *, with_text: bool) -> None:
    why_not = {mode: commands.command(f"view.{mode}").enabled(session) for mode in shown}
    picked = widgets.segmented(
        "Render mode", _MODES, session.view.mode, why_not=why_not, with_text=with_text
    )
    if picked is not session.view.mode:
        commands.run(f"view.{picked}", session)
    imgui.same_line(0, theme.scaled(1))


def _more_button(session: Session, shown: Sequence[Mode], *, has_all: bool) -> None:
    """The way to the modes that are not ``shown`` next to it, and to what the bar has no room for
    unless it ``has_all``."""
    hint = "confidence, centres, rings, a mask, and the look of small splats"
    hint = hint if shown else f"color, groups, depth, {hint}"
    hint = hint if has_all else f"photos, flying, framing, the list of commands, {hint}"
    if widgets.icon_button(
        "More render modes",
        icons.MORE if shown or not has_all else icons.COLOR,
        hint=f"{hint[0].upper()}{hint[1:]}",
        on=session.view.mode not in (shown or (Mode.COLOR,)),
    ):
        imgui.open_popup("More modes")


def _more_list(session: Session, shown: Sequence[Mode], left_out: Sequence[str]) -> None:
    """What the button drawn last opens: other modes than those ``shown``, and what the bar has no
    room for."""
    more = [f"view.{mode}" for mode in Mode if mode not in shown]
    looks = [f"view.look_{look}" for look in SplatLook]
    listed = (*more, "view.folder_colors", "", *looks, "", "view.background")
    listed = (*left_out, "", *listed) if left_out else listed
    draw = partial(command_buttons.command_items, session, listed)
    widgets.popup("More modes", draw, of_button=True)


def _search(session: Session, width: float, used: float) -> None:
    """Looks like a text field; opens the list of all commands."""
    room = width - used - em(0.3)
    size = min(em(15), room)
    if size < em(_LEAST_SEARCH):
        imgui.new_line()
        return
    imgui.same_line(imgui.get_cursor_pos_x() + room - size)
    text = f"{icons.SEARCH}  Find a command" if size > em(11) else icons.SEARCH
    imgui.push_style_var(imgui.StyleVar_.button_text_align, imgui.ImVec2(0.0, 0.5))
    imgui.push_style_color(imgui.Col_.text, theme.DIM)
    imgui.push_style_color(imgui.Col_.button, theme.RAISED)
    if imgui.button(f"{text}###Find a command", imgui.ImVec2(size, 0)):
        session.request = Request.COMMAND_LIST
    imgui.pop_style_color(2)
    imgui.pop_style_var()
    widgets.tooltip("Every command by its name", "Ctrl+P")


def _icons(session: Session, command_ids: Sequence[str]) -> None:
    for position, command_id in enumerate(command_ids):
        if position:
            imgui.same_line(0, em(0.15))
        command_buttons.command_icon(session, command_id)
