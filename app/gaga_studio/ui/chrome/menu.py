"""The menu bar, from the table of commands."""

from collections.abc import Sequence
from dataclasses import dataclass

from imgui_bundle import imgui

from gaga_studio.features import camera, files
from gaga_studio.features.base import Command, no_scene
from gaga_studio.features.camera import RECALL, SET
from gaga_studio.features.commands import MENUS, OPEN_RECENT, USE_MASKS, run_one
from gaga_studio.features.find import masks
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, theme, widgets

# A line above these, to set apart what belongs together.
_LINE_BEFORE = {
    "file.save",
    "file.export_scene",
    "file.close",
    "edit.recolor",
    "edit.cancel",
    "edit.preferences",
    "object.associate",
    "object.find",
    "object.quality",
    "object.folder",
    "object.rename",
    "object.fill",
    "object.clean",
    "view.next_mode",
    "view.background",
    "view.frame_selected",
    "view.lights_masks",
    "view.lod",
    "view.panels",
    "view.panels_back",
    "view.next_photo",
    "view.outline",
    "camera.faster",
    "camera.add_bookmark",
    "camera.swipe",
    "camera.difference",
    "camera.add_keyframe",
    "camera.open_path",
    "file.save_picture",
    "tool.move",
    "tool.splats",
    "tool.visible_only",
    "job.cancel",
    "help.about",
}

_BY_SUBMENU = {  # of the menu View: after the command that it follows
    "view.depth": (
        "More colors",
        (
            *("view.confidence", "view.centres", "view.rings", "view.mask", "view.identity", ""),
            *("view.groups_centres", "view.identity_centres", "view.folder_colors", ""),
            *("view.look_auto", "view.look_classic", "view.look_antialiased"),
        ),
    ),
    "view.home": (
        "Look from",
        tuple(f"view.{side}" for side in ("front", "back", "left", "right", "top", "bottom")),
    ),
}
_IN_VIEW = {command for _, listed in _BY_SUBMENU.values() for command in listed if command}
IN_SUBMENUS = {*RECALL, *SET, *command_buttons.SPLITS, *_IN_VIEW}


@dataclass
class MenuState:
    """Which menu was open in the frame before."""

    opened: str = ""
    by_hover: bool = False  # it opened as the mouse came from another one, without a click


def draw(session: Session, state: MenuState) -> None:
    """Menus, and at the right end the name of what is open."""
    before, state.opened = state.opened, ""
    # The toolkit sets titles twice this far apart; in a narrow window all of them have to fit.
    wide = sum(imgui.calc_text_size(title).x for title in MENUS)
    spacing = imgui.get_style().item_spacing
    between = (imgui.get_content_region_avail().x - wide) / (2 * len(MENUS))
    imgui.push_style_var(
        imgui.StyleVar_.item_spacing, imgui.ImVec2(min(spacing.x, max(between, 1.0)), spacing.y)
    )
    for title, menu in MENUS.items():
        is_open = imgui.begin_menu(title)
        is_clicked = imgui.is_item_hovered() and imgui.is_mouse_clicked(imgui.MouseButton_.left)
        if not is_open and title == before and state.by_hover and is_clicked:
            # The toolkit opened it under a mouse that came to click it, and the click closed it.
            imgui.open_popup(title)
            state.opened, state.by_hover = title, False
        if is_open:
            if title != before:  # between two menus there is a frame without one
                state.by_hover = not imgui.is_mouse_down(imgui.MouseButton_.left)
            state.opened = title
            for command in menu:
                if command.id in _LINE_BEFORE:
                    imgui.separator()
                if command.id not in IN_SUBMENUS:
                    command_buttons.command_item(session, command.id)
                _submenu_after(session, command.id)
            imgui.end_menu()
    imgui.pop_style_var()
    _arrows(state)
    _title(session)


def _arrows(state: MenuState) -> None:
    """Left and Right go to the menu next to the open one, where no submenu took them.

    The toolkit would close the open menu and only mark the title of the next; where the mouse
    opened the menu and rests on its title, it would do nothing.
    """
    context = imgui.get_current_context()
    step = {imgui.Dir.left: -1, imgui.Dir.right: 1}.get(context.nav_move_dir, 0)
    is_left_to_us = step and imgui.internal.nav_move_request_but_no_result_yet()
    within = context.nav_window
    if within is None or not within.flags & imgui.WindowFlags_.popup:  # no entry has the keys
        right, left = imgui.Key.right_arrow, imgui.Key.left_arrow
        step = imgui.is_key_pressed(right) - imgui.is_key_pressed(left)
        is_left_to_us = bool(step)
    if state.opened and is_left_to_us:
        imgui.internal.nav_move_request_cancel()
        context.nav_highlight_item_under_nav = True  # not what the mouse rests on, till it moves
        titles = tuple(MENUS)
        imgui.open_popup(titles[(titles.index(state.opened) + step) % len(titles)])


def _submenu_after(session: Session, command_id: str) -> None:
    if command_id in _BY_SUBMENU:
        name, listed = _BY_SUBMENU[command_id]
        command_buttons.command_submenu(session, f"{icons.BLANK}  {name}###{name}", listed)
    elif command_id == "object.separate":
        command_buttons.split_menu(session)
    elif command_id == "camera.add_bookmark":
        _bookmarks(session)
    elif command_id == "file.demo":
        _recent(session)
    elif command_id == "object.import_masks_file":
        _mask_folders(session)


def _bookmarks(session: Session) -> None:
    listed, name = camera.recall_commands(session), "Go to bookmark"
    entries = [f"{command.title}  {command.shortcut}" for command in listed]
    why_not = "" if listed else no_scene(session) or "There are no bookmarks yet."
    label = f"{icons.BOOKMARK}  {name}###{name}"
    with widgets.submenu(label, entries, why_not=why_not) as is_open:
        _items(session, listed if is_open else ())
    name = "Set bookmark"
    command_buttons.command_submenu(session, f"{icons.BLANK}  {name}###{name}", SET)


def _recent(session: Session) -> None:
    listed = files.recent(session)
    label = f"{icons.CLOCK}  {OPEN_RECENT}###{OPEN_RECENT}"
    entries = [command.title_now(session) for command in listed]
    why_not = "" if listed else "Nothing was opened before."
    with widgets.submenu(label, entries, why_not=why_not) as is_open:
        _items(session, listed if is_open else ())


def _mask_folders(session: Session) -> None:
    listed = masks.folder_commands(session)
    label = f"{icons.MASK}  {USE_MASKS}###{USE_MASKS}"
    entries = [command.title_now(session) for command in listed]
    why_not = "" if listed else "There is one mask folder at most, so there is nothing to choose."
    with widgets.submenu(label, entries, why_not=why_not) as is_open:
        _items(session, listed if is_open else ())


def _items(session: Session, listed: Sequence[Command]) -> None:
    """Commands called as files or bookmarks are, several perhaps by the same name."""
    names: set[str] = set()
    for command in listed:
        is_on = command.is_on is not None and command.is_on(session)
        title = command.title_now(session)
        shown = command_buttons.fitting(title)
        name = theme.visual(command.title)
        label = f"{shown}###{name}{command.id if name in names else ''}"
        names.add(name)
        why_not = command.enabled(session)
        if imgui.menu_item(label, command.shortcut, is_on, not why_not)[0]:
            run_one(command, session)
        widgets.tooltip(why_not or ("" if shown == theme.visual(title) else title), of_row=True)


def _title(session: Session) -> None:
    title = theme.visual(session.title)
    if not title:
        return
    width = imgui.calc_text_size(title).x
    left = (imgui.get_window_width() - width) / 2
    if left > imgui.get_cursor_pos_x() + theme.em(2):
        imgui.set_cursor_pos_x(left)
        widgets.text(title, theme.DIM)
