"""Commands as buttons and menu items: one table decides what is possible and says why not."""

from collections.abc import Iterable, Sequence

from imgui_bundle import ImVec2, imgui

from gaga_studio.features import camera, commands
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import icons, widgets
from gaga_studio.ui.kit.theme import em, visual
from gaga_studio.ui.kit.widgets import Face

_AROUND_TITLE = 11.0  # em of a menu for icon, longest shortcut, check mark, scroll bar and edges
ICONS = {
    "file.open_folder": icons.FOLDER,
    "file.open_file": icons.FILE,
    "file.demo": icons.DEMO,
    "file.add_splats": icons.NEW,
    "file.add_scene": icons.NEW,
    "file.save": icons.SAVE,
    "file.save_as": icons.SAVE,
    "edit.cancel": icons.CLOSE,
    "edit.confirm": icons.CHECK,
    "edit.preferences": icons.SLIDERS,
    "select.all": icons.CHECK,
    "select.none": icons.CLOSE,
    "select.keep": icons.BOOKMARK_NEW,
    "object.reset_placement": icons.RESET,
    "object.find_in_view": icons.SEARCH,
    "object.models": icons.UPDATE,
    "object.name_all": icons.RENAME,
    "object.clean_apply": icons.CHECK,
    "object.worst_view": icons.IMAGES,
    "view.timeline": icons.HISTORY,
    "view.history": icons.HISTORY,
    "view.panels_back": icons.RESET,
    "view.next_photo": icons.LATER,
    "view.previous_photo": icons.EARLIER,
    "tool.origin_here": icons.HOME,
    "tool.reset_pivot": icons.RESET,
    "tool.remove_corner": icons.UNDO,
    "job.cancel": icons.CLOSE,
    "help.about": icons.INFO,
    "file.export_scene": icons.EXPORT,
    "file.export_page": icons.EXPORT,
    "file.export_selected": icons.EXPORT,
    "file.export_objects": icons.EXPORT,
    "file.export_meshes": icons.EXPORT,
    "file.export_simulation": icons.EXPORT,
    "edit.undo": icons.UNDO,
    "edit.redo": icons.REDO,
    "edit.recolor": icons.DROP,
    "edit.duplicate": icons.DUPLICATE,
    "edit.delete": icons.DELETE,
    "edit.reduce": icons.MERGE,
    "object.associate": icons.RUN,
    "object.find_settings": icons.SLIDERS,
    "object.lift": icons.MEMORY,
    "object.masks": icons.MASK,
    "object.masks_rest": icons.MASK,
    "object.masks_quick": icons.MASK,
    "object.masks_model": icons.MASK,
    "object.find": icons.SEARCH,
    "file.export_masks": icons.EXPORT,
    "object.hide": icons.EYE_OFF,
    "object.show_all": icons.EYE,
    "object.isolate": icons.ISOLATE,
    "object.rename": icons.RENAME,
    "object.folder": icons.FOLDER_NEW,
    "object.folder_out": icons.FOLDER_OUT,
    "object.leave_parent": icons.FOLDER_OUT,
    "object.folder_delete": icons.FOLDER_PLAIN,
    "view.folder_colors": icons.FOLDER_PLAIN,
    "object.merge": icons.MERGE,
    "object.clean": icons.CLEAN,
    "object.fill": icons.FILL,
    "object.lock": icons.LOCK,
    "object.unlock_all": icons.UNLOCK,
    "object.separate": icons.SEPARATE,
    "tool.pivot_here": icons.PIVOT,
    "help.first_steps": icons.STEPS,
    "object.split": icons.SPLIT,
    "object.split_here": icons.SPLIT,
    "object.join_here": icons.MERGE,
    "object.split_masks": icons.MEMORY,
    "object.quality": icons.QUALITY,
    "object.uncertain": icons.CONFIDENCE,
    "view.color": icons.COLOR,
    "view.groups": icons.GROUPS,
    "view.depth": icons.DEPTH,
    "view.confidence": icons.CONFIDENCE,
    "view.centres": icons.CENTRES,
    "view.rings": icons.RINGS,
    "view.mask": icons.MASK_MODE,
    "view.identity": icons.MEMORY,
    "view.frame_selected": icons.FOCUS,
    "view.frame_all": icons.HOME,
    "view.frusta": icons.FRUSTA,
    "view.fly": icons.FLY,
    "view.ortho": icons.ORTHO,
    "camera.add_bookmark": icons.BOOKMARK_NEW,
    "camera.swipe": icons.SWIPE,
    "camera.difference": icons.DIFFERENCE,
    "camera.add_keyframe": icons.PATH,
    "camera.turntable": icons.TURNTABLE,
    "camera.play": icons.PLAY,
    "camera.film": icons.FILM,
    "file.save_picture": icons.PICTURE,
    "tool.pick": icons.PICK,
    "tool.object": icons.OBJECT,
    "object.make": icons.NEW,
    "tool.rect": icons.RECT,
    "tool.lasso": icons.LASSO,
    "tool.polygon": icons.POLYGON,
    "tool.brush": icons.BRUSH,
    "tool.sphere": icons.SPHERE,
    "tool.erase": icons.ERASE,
    "tool.color": icons.DROP,
    "tool.clone": icons.DUPLICATE,
    "tool.ground": icons.GROUND,
    "tool.measure": icons.RULER,
    "tool.move": icons.MOVE,
    "tool.rotate": icons.ROTATE,
    "tool.scale": icons.SCALE,
    "help.palette": icons.SEARCH,
    "help.shortcuts": icons.KEYBOARD,
}
SELECTION_BUTTONS = (
    ("object.hide", "Hide"),
    ("object.isolate", "Isolate"),
    ("view.frame_selected", "Focus"),
    ("edit.duplicate", "Duplicate"),
    ("edit.delete", "Delete"),
    ("object.fill", "Fill"),
    ("file.export_selected", "Export…"),
    ("object.clean", "Clean up"),
)
OBJECT_MENU = (
    "view.frame_selected",
    "object.isolate",
    "object.hide",
    "object.lock",
    "object.rename",
    "",
    "edit.recolor",
    "edit.duplicate",
    "object.merge",
    "object.separate",
    "object.split",  # the submenu of all ways
    "object.clean",
    "edit.delete",
    "object.fill",
    "",
    "file.export_selected",
    "file.export_meshes",
    "file.export_simulation",
)
_OF_ONE = ("object.rename", "object.separate", "object.split", "object.clean", "object.fill")
FOLDER_MENU = tuple(id_ for id_ in OBJECT_MENU if id_ not in _OF_ONE)  # of all that is in it
_IN_THE_PICTURE = (
    "object.folder",
    "select.children",
    "",
    "tool.pivot_here",
    "tool.origin_here",
    "tool.ground",
)
SPLITS = ("object.split", "object.split_masks", "object.split_here", "object.join_here")
SCENE_MENU = (
    "select.all",
    "select.none",
    "object.show_all",
    "",
    "view.frame_all",
    "tool.ground",
    "tool.measure",
    "tool.origin_here",
)


def command_button(
    session: Session,
    command_id: str,
    label: str = "",
    face: Face | None = None,
) -> None:
    """A text button; ``label`` is its identity for tests. Without ``face``: with its icon."""
    command = commands.command(command_id)
    why_not = command.enabled(session)
    clicked = widgets.button(
        label or command.title.rstrip("…"),
        face or Face(icon=ICONS.get(command_id, "")),
        why_not=why_not,
        hint=command.title_now(session),
        shortcut=commands.shortcut_of(command, session),
    )
    if clicked:
        commands.run(command_id, session)


def command_icon(session: Session, command_id: str) -> None:
    """An icon button of the tool bar."""
    command = commands.command(command_id)
    clicked = widgets.icon_button(
        command.title.rstrip("…"),
        ICONS[command_id],
        hint=command.title_now(session),
        why_not=command.enabled(session),
        on=command.is_on is not None and command.is_on(session),
        shortcut=commands.shortcut_of(command, session),
    )
    if clicked:
        commands.run(command_id, session)


def fitting(title: str) -> str:
    """The title of an entry of a menu, no wider than the window."""
    return widgets.elided(title, imgui.get_main_viewport().size.x - em(_AROUND_TITLE))


def command_item(session: Session, command_id: str) -> None:
    """A menu item with its shortcut; greyed, it says why in its tooltip."""
    command = commands.command(command_id)
    why_not = command.enabled(session)
    icon = ICONS.get(command_id, icons.BLANK)
    title = command.title_now(session)
    shown = fitting(title)
    label = f"{icon}  {shown}###{command.title}"
    is_on = command.is_on is not None and command.is_on(session)
    keys = commands.shortcut_of(command, session)
    if imgui.menu_item(label, keys, is_on, not why_not)[0]:
        commands.run(command_id, session)
    widgets.tooltip(why_not or ("" if shown == visual(title) else title), of_row=True)


def object_menu(session: Session) -> None:
    """What can be done with the selected objects: the context menu of list and picture."""
    command_items(session, OBJECT_MENU)


OBJECT_POPUP, SCENE_POPUP = "Object in the picture", "Scene in the picture"


def picture_menus(session: Session) -> None:
    """The menus of a right click in the picture: on an object, and on nothing."""
    here = ("tool.pivot_here", "") if session.view.pointed is not None else ()
    widgets.popup(OBJECT_POPUP, lambda: command_items(session, (*OBJECT_MENU, *_IN_THE_PICTURE)))
    widgets.popup(SCENE_POPUP, lambda: command_items(session, (*here, *SCENE_MENU)))


def split_menu(session: Session) -> None:
    """The ways to take one object apart, as a submenu."""
    command_submenu(session, f"{icons.SPLIT}  Split###Split", SPLITS)


def command_submenu(session: Session, label: str, command_ids: Sequence[str]) -> None:
    """A submenu of commands; "" is a line."""
    listed = [commands.command(command_id) for command_id in command_ids if command_id]
    entries = [f"{one.title_now(session)}  {commands.shortcut_of(one, session)}" for one in listed]
    with widgets.submenu(label, entries) as is_open:
        for command_id in command_ids if is_open else ():
            if command_id:
                command_item(session, command_id)
            else:
                imgui.separator()


def command_items(session: Session, command_ids: Iterable[str]) -> None:
    """Commands as menu items; "" is a line."""
    for command_id in command_ids:
        if command_id == "object.split":
            split_menu(session)
        elif command_id:
            command_item(session, command_id)
        else:
            imgui.separator()


def fly_to(session: Session, view: str) -> None:
    """Go to where a photo was taken, by its name."""
    index = camera.view_index(session, view)
    if index is not None:
        camera.go_to_view(session, index)


def gap(size: float) -> None:
    """A pause in a row of buttons."""
    imgui.same_line()
    imgui.dummy(ImVec2(size, 1))
    imgui.same_line()
