"""File: opening, saving, exporting."""

from gaga_studio.actions import reconstruction
from gaga_studio.commands.availability import (
    busy,
    no_edits,
    no_scene,
    no_views,
    not_exportable_masks,
    not_exportable_objects,
    not_exportable_selection,
    not_saveable,
)
from gaga_studio.commands.base import Command, ask
from gaga_studio.session.requests import Request

FILE_COMMANDS: tuple[Command, ...] = (
    Command("file.open_folder", "Open scene folder…", ask(Request.OPEN_FOLDER), "Ctrl+O"),
    Command("file.open_file", "Open splat file…", ask(Request.OPEN_FILE), "Ctrl+Shift+O"),
    Command(
        "file.make_splats",
        "Make splats from photos",
        reconstruction.make,
        enabled=reconstruction.why_not,
        describe=reconstruction.title,
    ),
    Command(
        "file.make_splats_as",
        "Make splats as…",
        ask(Request.MAKE_SPLATS),
        enabled=reconstruction.why_not,
    ),
    Command("file.add_splats", "Add splats…", ask(Request.ADD_SPLATS), enabled=not_saveable),
    Command("file.demo", "Open the demo", lambda s: s.open_demo(), enabled=busy),
    Command("file.save", "Save project", lambda s: s.save(), "Ctrl+S", enabled=no_scene),
    Command(
        "file.save_as", "Save project as…", ask(Request.SAVE_AS), "Ctrl+Shift+S", enabled=no_scene
    ),
    Command(
        "file.export_scene",
        "Export scene…",
        ask(Request.EXPORT_SCENE),
        "Ctrl+Shift+E",
        enabled=not_saveable,
    ),
    Command(
        "file.export_page",
        "Export a web page…",
        ask(Request.EXPORT_PAGE),
        enabled=not_saveable,
    ),
    Command(
        "file.export_selected",
        "Export selection…",
        ask(Request.EXPORT_SELECTED),
        enabled=not_exportable_selection,
    ),
    Command(
        "file.export_objects",
        "Export objects…",
        ask(Request.EXPORT_OBJECTS),
        enabled=not_exportable_objects,
    ),
    Command(
        "file.export_meshes",
        "Export meshes…",
        ask(Request.EXPORT_MESHES),
        enabled=not_exportable_objects,
    ),
    Command(
        "file.export_cameras",
        "Export cameras…",
        ask(Request.EXPORT_CAMERAS),
        enabled=no_views,
    ),
    Command(
        "file.export_masks",
        "Export masks…",
        ask(Request.EXPORT_MASKS),
        enabled=not_exportable_masks,
    ),
    Command(
        "file.save_script",
        "Save the edits as a script…",
        ask(Request.SAVE_SCRIPT),
        enabled=no_edits,
    ),
    Command(
        "file.save_picture",
        "Save picture…",
        ask(Request.SAVE_PICTURE),
        "Ctrl+Alt+S",
        enabled=not_saveable,
    ),
    Command("file.close", "Close", lambda s: s.close(), "Ctrl+W", enabled=not_saveable),
    Command("file.quit", "Quit", lambda s: s.quit(), "Ctrl+Q"),
)
