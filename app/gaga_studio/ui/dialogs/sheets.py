"""Sheets over the window: a question, all commands by name, the keys, preferences, about."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from imgui_bundle import ImVec2, imgui

from gaga_core.version import __version__
from gaga_studio.features import commands
from gaga_studio.features.base import Command
from gaga_studio.features.commands import MENUS
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.modal import (
    EDGE,
    QUESTION,
    begin_modal,
    body,
    body_height,
    close_row,
    enter_is_free,
)
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

MOUSE = (
    ("Click", "Select the object; Shift adds, Ctrl removes"),
    ("Double click", "Turn around that point"),
    ("Drag", "Orbit (with the pick tool), else the tool"),
    ("Middle drag", "Orbit; with Shift pan, with Ctrl zoom"),
    ("Right drag", "Pan"),
    ("Right click", "The menu of the object"),
    ("Wheel", "Zoom"),
)
_LICENCES = (
    "Apache-2.0. With Dear ImGui Bundle (MIT), moderngl (MIT), numba (BSD), NumPy (BSD), "
    "SciPy (BSD), pycolmap (BSD), the font Inter (OFL) and the icons of Lucide (ISC)."
)


# Other words for what commands do, as people type them into the list of commands.
_WORDS = {
    "file.open_photos": "reconstruct train video movie images pictures import capture",
    "file.make_splats": "reconstruct train start",
    "file.open_folder": "load import",
    "file.open_file": "load import",
    "file.add_splats": "import insert append merge",
    "file.add_scene": "align register second capture",
    "file.save_as": "copy",
    "file.export_scene": "write save download blender unity unreal",
    "file.export_page": "html viewer share url link",
    "file.export_selected": "write save download",
    "file.export_meshes": "obj glb stl triangles collider blender unity unreal",
    "file.export_simulation": "physics usd mjcf urdf robot",
    "file.save_picture": "screenshot snapshot image render photo",
    "file.save_script": "macro python record",
    "file.close": "leave",
    "file.quit": "exit end leave",
    "edit.undo": "history revert back step",
    "edit.redo": "history repeat forward",
    "edit.recolor": "colour paint tint hue",
    "edit.duplicate": "copy clone paste",
    "edit.duplicate_and_move": "copy clone paste in place",
    "edit.delete": "remove erase cut clear",
    "edit.mirror_x": "flip reflect",
    "edit.mirror_y": "flip reflect",
    "edit.mirror_z": "flip reflect",
    "edit.reduce": "simplify decimate fewer smaller compress",
    "edit.delete_floaters": "remove noise clean outliers",
    "edit.restore": "undelete bring back recover original",
    "edit.preferences": """settings options theme dark light language keys blender font text size
        autosave""",
    "select.none": "deselect unselect clear",
    "select.invert": "inverse",
    "select.grow": "expand more larger",
    "select.whole": "alt click up level coarser whole",
    "select.shrink": "contract less smaller",
    "select.alike": "similar same color colour",
    "object.masks": "segment",
    "object.masks_model": "segment anything sam",
    "object.models": "download sam clip weights",
    "object.associate": "associate masks segment group detect separate",
    "object.find": "find query words",
    "object.hide": "invisible visibility",
    "object.isolate": "solo only crop hide others",
    "object.show_all": "unhide reveal visible visibility",
    "object.lock": "freeze protect",
    "object.unlock_all": "unfreeze",
    "object.reset_placement": "undo move transform original",
    "object.rename": "label title",
    "object.folder": "group collection layer",
    "object.merge": "join combine unite group",
    "object.separate": "extract split cut new",
    "object.split": "separate cut divide",
    "object.fill": "remove erase inpaint hole",
    "object.clean": "floaters edge noise remove",
    "object.simulate": "drop fall gravity physics settle simulate",
    "view.color": "colors colours rgb",
    "view.home": "reset camera",
    "view.frame_all": "reset fit zoom extents",
    "view.frame_selected": "fit zoom center centre look at",
    "view.frusta": "poses",
    "view.fly": "walk wasd first person game",
    "view.centres": "centers points dots wireframe",
    "view.groups": "objects segmentation colours",
    "view.background": "colour black white",
    "view.history": "panel versions undo changes log compare",
    "view.panels_back": "reset layout default docks",
    "view.panels": "show hide sidebar inspector full screen",
    "view.lod": "performance speed slow",
    "camera.ortho": "perspective parallel",
    "camera.swipe": "compare photo wipe split view side by side",
    "camera.split_groups": "compare view side by side",
    "camera.split_before": "compare view side by side undo",
    "camera.add_bookmark": "save view camera",
    "camera.add_keyframe": "animate animation path",
    "camera.turntable": "orbit animate animation spin rotate",
    "camera.film": "video movie record render animation mp4 gif",
    "tool.rect": "box marquee",
    "tool.lasso": "freehand",
    "tool.brush": "paint",
    "tool.erase": "remove delete",
    "tool.color": "paint colour recolor",
    "tool.clone": "copy stamp",
    "tool.move": "translate position gizmo",
    "tool.rotate": "turn gizmo",
    "tool.scale": "resize size gizmo",
    "tool.ground": "level floor horizon upright",
    "tool.turn_upright": "flip upside down rotate scene",
    "tool.measure": "distance ruler",
    "tool.set_scale": "measure units metres meters size known length",
    "panel.objects": "outliner list tree hierarchy groups",
    "panel.inspector": "properties attributes details color grade tint temperature saturation",
    "panel.select_by": "filter range",
    "panel.memory_bank": "masks groups",
    "panel.views": "photos film strip cameras images",
    "panel.camera_path": "keyframes animation timeline",
    "panel.bookmarks": "saved cameras",
    "help.shortcuts": "hotkeys keyboard bindings",
}

_SECOND_COLUMN = "Object"  # the menu that begins it in the sheet of keys
COMMANDS_SHEET, KEYS, ABOUT = "Commands", "Keys and mouse", "About gaga-studio"


@dataclass
class PaletteState:
    """What is typed into the list of commands, and which line is chosen."""

    text: str = ""
    found: list[tuple[Command, str]] = field(default_factory=list)  # with its menu, as last typed
    at: int = 0
    lost_keys: bool = False  # Enter, or a click on a line, took the keyboard from the field
    text_of_keys: str = ""  # what is typed into the sheet of keys


def open_commands(palette: PaletteState) -> None:
    """Open the list of all commands."""
    palette.text, palette.at = "", 0
    imgui.open_popup(COMMANDS_SHEET)


def draw(session: Session, palette: PaletteState) -> None:
    """Whatever is open of them."""
    _palette(session, palette)
    _shortcuts(session, palette)
    _about()
    _question(session)


def _question(session: Session) -> None:
    question = session.pending_question
    name = QUESTION
    if question is not None and not imgui.is_popup_open(name):
        imgui.open_popup(name)
    choices = question.choices if question is not None else ()
    style = imgui.get_style()
    widths = [max(em(6), imgui.calc_text_size(c).x + 2 * style.frame_padding.x) for c in choices]
    in_one_row = sum(widths) + len(widths) * style.item_spacing.x + 2 * em(EDGE)
    width = max(em(28), in_one_row)
    if not begin_modal(name, width, is_possible=question is not None) or question is None:
        return
    if imgui.is_window_appearing():  # on the blue button: the first Tab goes to the next
        imgui.set_nav_cursor_visible(True)
    room = imgui.get_content_region_avail().x
    rows = _rows(widths, room)
    with body("Text", rows=len(rows)):
        widgets.paragraph(question.text)
    imgui.dummy(ImVec2(0, em(0.4)))
    answer, left = "", imgui.get_cursor_pos_x()
    for row in rows:
        used = sum(widths[at] for at in row) + (len(row) - 1) * style.item_spacing.x
        imgui.set_cursor_pos_x(left + max(room - used, 0.0))
        for at in row:
            if at != row[0]:
                imgui.same_line()
            choice = choices[at]
            is_by_enter = choice == question.by_enter
            if widgets.button(choice, Face(width=widths[at], primary=is_by_enter)):
                answer = choice
            if is_by_enter:
                imgui.set_item_default_focus()
    if imgui.is_window_appearing():
        pass  # the key of this frame opened it
    elif enter_is_free():
        answer = question.by_enter
    elif imgui.is_key_pressed(imgui.Key.escape):
        answer = question.choices[-1]
    if answer:
        imgui.close_current_popup()
        session.answer(answer)
    imgui.end_popup()


def _rows(widths: Sequence[float], room: float) -> list[list[int]]:
    """Which buttons of these ``widths`` stand in which row of ``room`` pixels."""
    rows: list[list[int]] = [[]]
    used = 0.0
    for at, width in enumerate(widths):
        if rows[-1] and used + width > room:
            rows.append([])
            used = 0.0
        rows[-1].append(at)
        used += width + imgui.get_style().item_spacing.x
    return rows


def _palette(session: Session, state: PaletteState) -> None:
    viewport = imgui.get_main_viewport()
    width = min(em(34), viewport.size.x * 0.94)
    top = ImVec2(viewport.get_center().x, viewport.pos.y + em(4))
    imgui.set_next_window_pos(top, imgui.Cond_.always, ImVec2(0.5, 0))
    height = min(em(26), viewport.size.y - em(4.5))
    imgui.set_next_window_size(ImVec2(width, height))
    if not imgui.begin_popup(COMMANDS_SHEET, imgui.WindowFlags_.no_nav_inputs):  # own arrows
        return
    if imgui.is_window_appearing() or state.lost_keys:
        imgui.set_keyboard_focus_here()
    imgui.set_next_item_width(-1)
    changed, state.text = imgui.input_text_with_hint(
        "##Command",
        widgets.hint_of_field(f"{icons.SEARCH}  Type what you want to do"),
        state.text,
        flags=imgui.InputTextFlags_.auto_select_all,
    )
    if changed or imgui.is_window_appearing():  # lines do not move while one is chosen
        menus = commands.all_menus(session)
        menu_of = _menu_of(menus)
        matches = matching(state.text, menus, lambda command: not command.enabled(session))
        state.found, state.at = [(command, menu_of[command.id]) for command in matches], 0
    found, reasons = state.found, [command.enabled(session) for command, _ in state.found]
    step = imgui.is_key_pressed(imgui.Key.down_arrow) - imgui.is_key_pressed(imgui.Key.up_arrow)
    state.at = min(max(state.at + step, 0), max(len(found) - 1, 0))
    chosen: Command | None = None
    state.lost_keys = imgui.is_key_pressed(imgui.Key.enter)
    if state.lost_keys and found:
        chosen = found[state.at][0]
    why_not = reasons[state.at] if found else ""
    room = imgui.get_text_line_height_with_spacing() if why_not else 0.0
    imgui.begin_child("Found", ImVec2(0, -room))
    for position, ((command, menu), reason) in enumerate(zip(found, reasons, strict=True)):
        right = commands.shortcut_of(command, session) or menu
        title = theme.visual(command.title_now(session))
        is_current = position == state.at
        if _palette_line(command.id, title, right, reason, is_current):
            chosen, state.lost_keys = command, True
        if is_current and step:
            imgui.set_scroll_here_y()
    if not found:
        widgets.dim("No command is called that.")
    imgui.end_child()
    if why_not:
        widgets.line(why_not, theme.WARN)
    if chosen is not None and not chosen.enabled(session):
        imgui.close_current_popup()
        commands.run_one(chosen, session)
    imgui.end_popup()


def _palette_line(id_: str, title: str, right: str, why_not: str, is_current: bool) -> bool:
    icon = command_buttons.ICONS.get(id_, icons.BLANK)
    room = imgui.get_content_region_avail().x
    shown = widgets.elided(title, room - imgui.calc_text_size(right).x - em(2.5))
    with theme.text_color(theme.FAINT if why_not else theme.TEXT):
        label = f"{icon}  {shown}###{id_}"
        flags = imgui.SelectableFlags_.no_auto_close_popups
        clicked, _ = imgui.selectable(label, is_current, flags)
    widgets.tooltip(why_not or ("" if shown == title else title), of_row=True)
    imgui.same_line(room - imgui.calc_text_size(right).x)
    widgets.text(right, theme.FAINT)
    return clicked


def _menu_of(menus: Mapping[str, Sequence[Command]]) -> dict[str, str]:
    return {command.id: title for title, listed in menus.items() for command in listed}


def matching(
    text: str,
    menus: Mapping[str, Sequence[Command]] = MENUS,
    is_available: Callable[[Command], bool] = lambda _: True,
) -> list[Command]:
    """Commands whose title, menu or `_WORDS` have every word of ``text``: first the one of that id,
    then titles that begin with its first one, of these those in which each begins a word, then has
    a place; of equal ones those that are available."""
    words = [word for word in text.casefold().replace("…", " ").split() if word.strip(".")]
    words = [word.rstrip(".") for word in words]  # as titles end that open a sheet
    found = [c for title, menu in menus.items() for c in menu if _has(words, title, c)]
    first = words[0] if words else ""

    def rank(c: Command) -> tuple[bool, ...]:
        title = c.title.casefold()
        begins = all(any(own.startswith(word) for own in title.split()) for word in words)
        is_named = c.id.split(".")[-1] == "_".join(words)
        has = all(word in title for word in words)
        starts = title.startswith(first)
        return not is_named, not starts, not begins, not has, not is_available(c)

    return sorted(found, key=rank)


def _has(words: Sequence[str], menu: str, command: Command, keys: str = "") -> bool:
    """Whether a command is called by every one of ``words``, which are in lower case."""
    own = f"{menu} {command.title} {command.id} {_WORDS.get(command.id, '')} {keys}".casefold()
    return all(word in own for word in words)


def _shortcuts(session: Session, state: PaletteState) -> None:
    if not begin_modal(KEYS, em(50)):
        return
    if imgui.is_window_appearing():
        state.text_of_keys = ""
        imgui.set_keyboard_focus_here()
    imgui.set_next_item_width(-1)
    hint = widgets.hint_of_field(f"{icons.SEARCH}  Type a key, or what it does")
    _, state.text_of_keys = imgui.input_text_with_hint("##Filter", hint, state.text_of_keys)
    is_wide = imgui.get_content_region_avail().x > em(38)
    columns = 2 if is_wide and not state.text_of_keys else 1
    imgui.begin_child("Sheet", ImVec2(0, body_height(em(30))))
    sections = keys_with(state.text_of_keys, session)
    if imgui.begin_table("Columns", columns):
        imgui.table_next_column()
        for menu, rows in sections.items():
            if menu == _SECOND_COLUMN and columns == 2:
                imgui.table_next_column()
            _sheet(menu, rows)
        imgui.end_table()
    if not sections:
        widgets.dim("No key is called that, or does that.")
    imgui.end_child()
    close_row()
    imgui.end_popup()


def keys_with(text: str, session: Session) -> dict[str, list[tuple[str, str]]]:
    """Keys and what they do, by menu: those that have every word of ``text``."""
    words = text.casefold().split()
    is_letters = session.settings.keys == "blender"  # which are commands until V
    flies = "V, then W A S D, Q, E" if is_letters else "W A S D, Q, E"
    mouse = (*MOUSE, (flies, "Fly; Shift fast, Alt slow"))
    texts = {row: f"mouse {' '.join(row)}".casefold() for row in mouse}
    found = {"Mouse": [row for row in mouse if all(word in texts[row] for word in words)]}
    for menu, listed in MENUS.items():
        rows = [(c, ", ".join(commands.keys_of(c, session))) for c in listed]
        found[menu] = [
            (keys, c.title.rstrip("…")) for c, keys in rows if keys and _has(words, menu, c, keys)
        ]
    return {title: rows for title, rows in found.items() if rows}


def _sheet(title: str, rows: Sequence[tuple[str, str]]) -> None:
    widgets.heading(title)
    left = em(9)
    for keys, text in rows:
        start = imgui.get_cursor_screen_pos()
        imgui.text_unformatted(keys)
        imgui.same_line()
        imgui.set_cursor_screen_pos(ImVec2(start.x + left, start.y))
        widgets.dim(text, wrap=True)


def _about() -> None:
    if not begin_modal(ABOUT, em(30)):
        return
    with body("Facts"):
        with theme.face(strong=True, scale=1.4):
            imgui.text_unformatted("gaga-studio")
        widgets.dim(f"Version {__version__}")
        imgui.dummy(ImVec2(0, em(0.3)))
        widgets.paragraph(
            "Views and edits 3D Gaussian Splatting scenes object by object. Objects are found by "
            "Gaga: masks of single photos, associated through a 3D-aware memory bank (TMLR 2026)."
        )
        widgets.dim(_LICENCES, wrap=True)
    close_row()
    imgui.end_popup()
