"""The camera's path with its keyframes and its film, and the bookmarks that a person keeps."""

from dataclasses import dataclass

from imgui_bundle import ImVec2, imgui

from gaga_core.scene.camera_path import Bookmark, CameraPath
from gaga_studio.features import camera
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.number_fields import drag
from gaga_studio.ui.kit.theme import em


def draw(session: Session) -> None:
    """The whole panel."""
    if session.document is None:
        widgets.empty_state(icons.FILM, "No camera path", "")
        return
    path = camera.path_of(session)
    _buttons(session, path)
    if not path.keyframes:
        widgets.dim(
            "Go to the first view of the film and add a keyframe; move on and add the next. "
            "Turntable makes a circle around what is in the middle of the picture.",
            wrap=True,
        )
        return
    _scrub(session, path)
    if imgui.begin_child("Keyframes", ImVec2(0, 0)):
        _table(session, path)
    imgui.end_child()


def _buttons(session: Session, path: CameraPath) -> None:
    command_buttons.command_button(session, "camera.add_keyframe", "Add keyframe")
    widgets.next_to(f"{icons.TURNTABLE}  Turntable")
    command_buttons.command_button(session, "camera.turntable", "Turntable")
    if not path.keyframes:
        return
    widgets.next_to("Closed", em(1))
    hint = "After the last keyframe the camera continues to the first"
    if widgets.toggle("Closed", path.is_closed, hint=hint):
        camera.set_closed_path(session, not path.is_closed)
    widgets.next_to("Even speed")
    hint = "The same speed all the way: the times between the keyframes follow their distances"
    if widgets.toggle("Even speed", path.even_speed, hint=hint):
        camera.set_even_speed(session, not path.even_speed)
    widgets.next_to(f"{icons.FILM}  Save film…", em(1))
    command_buttons.command_button(session, "camera.film", "Save film…")


_LEAST_SLIDER = 9.0  # em: with less room next to it, the whole time stands below the slider


def _scrub(session: Session, path: CameraPath) -> None:
    playback = session.view.playback
    icon = icons.PAUSE if playback.is_playing else icons.PLAY
    why_not = "" if len(path.keyframes) > 1 else "Add another keyframe."
    if widgets.icon_button("Play", icon, hint="Play or stop", why_not=why_not, shortcut="Shift+K"):
        camera.toggle_playing(session)
    imgui.same_line()
    of_all = "%.1f s in all"
    width = imgui.calc_text_size(of_all % path.seconds).x + 2 * imgui.get_style().frame_padding.x
    room = imgui.get_content_region_avail().x
    is_narrow = room - width < em(_LEAST_SLIDER)
    imgui.set_next_item_width(room - (0 if is_narrow else width + em(0.6)))
    end = max(path.seconds, 1e-3)
    changed, at = widgets.slider("##Time", playback.at, 0.0, end, "%.2f s", ticks=path.times())
    if changed:
        playback.is_playing = False
        camera.scrub(session, at)
    if not is_narrow:
        imgui.same_line()
    imgui.set_next_item_width(width)
    changed, total = drag("##Total", path.seconds, 0.05, of_all, (0.1, 3600))
    widgets.tooltip("Duration of the whole path; all times scale with it")
    if changed:
        camera.set_total_seconds(session, total)


_ROW = 20.2  # width of a keyframe's row, ems


def _table(session: Session, path: CameraPath) -> None:
    """The keyframes, down one column after the other where the panel is wide and low."""
    room = imgui.get_content_region_avail()
    in_column = max(int(room.y / imgui.get_text_line_height_with_spacing()), 1)
    most = max(int(room.x / em(_ROW)), 1)
    n_columns = min(-(-len(path.keyframes) // in_column), most)
    if not imgui.begin_table("Columns", n_columns, imgui.TableFlags_.sizing_stretch_same):
        return
    in_column = -(-len(path.keyframes) // n_columns)
    imgui.table_next_row()
    for index in range(len(path.keyframes)):
        if index % in_column == 0:
            imgui.table_next_column()
        _camera_path_row(session, path, index)
    imgui.end_table()


def _camera_path_row(session: Session, path: CameraPath, index: int) -> None:
    chosen, times, key = session.view.playback.chosen, path.times(), path.keyframes[index]
    imgui.push_id(index)
    room = imgui.get_content_region_avail().x
    is_narrow = room < em(19.4)
    width, field = (em(5.6), em(4.4)) if is_narrow else (em(6.4), em(6.4))
    text = f"{index + 1}   at {times[index]:.1f} s"
    if imgui.selectable(f"{text}###Keyframe", index == chosen, 0, ImVec2(width, 0))[0]:
        camera.choose_keyframe(session, index)
    widgets.tooltip("Click to go there")
    imgui.same_line(width + em(0.4))
    if index or path.is_closed:
        imgui.set_next_item_width(field)
        form = "%.2f s" if is_narrow else "%.2f s before" if index else "%.2f s back"
        imgui.begin_disabled(path.even_speed)
        imgui.push_style_var(imgui.StyleVar_.frame_padding, ImVec2(em(0.3), 0))
        changed, seconds = drag("##S", key.seconds, 0.02, form, (0.05, 600))
        imgui.pop_style_var()
        imgui.end_disabled()
        if changed:
            camera.set_seconds(session, index, seconds)
    if width + field + em(0.8 + 4 * 1.35) <= room:  # else the four icons have a line of their own
        imgui.same_line(width + field + em(0.8))
    _row_buttons(session, index)
    imgui.pop_id()


def _row_buttons(session: Session, index: int) -> None:
    if widgets.small_icon("Update", icons.UPDATE, hint="Show the present view here instead"):
        camera.update_keyframe(session, index)
    imgui.same_line(0, 0)
    if widgets.small_icon("Earlier", icons.EARLIER, hint="Earlier"):
        camera.move_keyframe(session, index, -1)
    imgui.same_line(0, 0)
    if widgets.small_icon("Later", icons.LATER, hint="Later"):
        camera.move_keyframe(session, index, 1)
    imgui.same_line(0, 0)
    if widgets.small_icon("Remove", icons.CLOSE, hint="Remove this keyframe"):
        camera.remove_keyframe(session, index)


# --- The list of views that a person keeps.


@dataclass
class BookmarkState:
    """The name that is being typed."""

    renaming: int | None = None  # bookmark whose name is a text field now
    text: str = ""
    has_keyboard: bool = False  # the text field has taken it


def draw_bookmarks(session: Session, state: BookmarkState) -> None:
    """The whole panel."""
    marks = camera.bookmarks(session)
    if session.document is None:
        widgets.empty_state(icons.BOOKMARK, "No bookmarks", "")
        return
    command_buttons.command_button(session, "camera.add_bookmark", "Bookmark this view")
    if not marks:
        widgets.dim(
            "Views kept here are saved with the project. Ctrl+Shift+1 to 9 set one with a key, "
            "Ctrl+1 to 9 go there.",
            wrap=True,
        )
        return
    if imgui.begin_child("Marks", ImVec2(0, 0)):
        for index, mark in enumerate(marks):
            imgui.push_id(index)
            _bookmark(session, state, index, mark)
            imgui.pop_id()
    imgui.end_child()


def _bookmark(session: Session, state: BookmarkState, index: int, mark: Bookmark) -> None:
    room = imgui.get_content_region_avail().x
    tools = em(4.6)
    if state.renaming == index:
        _name_field(session, state, index, room - tools)
    else:
        keys = f"Ctrl+{mark.key}" if mark.key else ""
        width = room - tools - imgui.calc_text_size(keys).x - em(0.8)
        flags = imgui.SelectableFlags_.allow_double_click
        shown = widgets.elided(mark.name, width)
        if imgui.selectable(f"{shown}###{mark.name}", False, flags, ImVec2(width, 0))[0]:
            if imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
                state.renaming, state.text = index, mark.name
            else:
                camera.recall_bookmark(session, index)
        widgets.tooltip("Click to go there, double click to rename", of_row=True)
        if keys:
            imgui.same_line(0, em(0.4))
            widgets.dim(keys)
    imgui.same_line(room - tools + em(0.3))
    if widgets.small_icon("Update", icons.UPDATE, hint="Keep the present view instead"):
        camera.update_bookmark(session, index)
    imgui.same_line(0, 0)
    if widgets.small_icon("Up", icons.EARLIER, hint="Move up"):
        camera.move_bookmark(session, index, -1)
    imgui.same_line(0, 0)
    if widgets.small_icon("Remove", icons.CLOSE, hint="Remove the bookmark"):
        camera.remove_bookmark(session, index)


def _name_field(session: Session, state: BookmarkState, index: int, width: float) -> None:
    imgui.set_next_item_width(width)
    if not state.has_keyboard:
        imgui.set_keyboard_focus_here()
        state.has_keyboard = True
    flags = imgui.InputTextFlags_.enter_returns_true | imgui.InputTextFlags_.auto_select_all
    with theme.text_color(theme.TEXT):
        entered, state.text = imgui.input_text("##Name", theme.noted(state.text), flags)
    if entered or imgui.is_item_deactivated():
        if entered or not imgui.is_key_pressed(imgui.Key.escape):
            camera.rename_bookmark(session, index, state.text)
        state.renaming, state.has_keyboard = None, False
