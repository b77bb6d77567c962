"""File: opening, saving, exporting."""

from gaga_studio.commands import reasons
from gaga_studio.commands.base import Command, ask

FILE_COMMANDS: tuple[Command, ...] = (
    Command("file.open_folder", "Open scene folder…", "File", ask("open_folder"), "Ctrl+O"),
    Command("file.open_file", "Open splat file…", "File", ask("open_file"), "Ctrl+Shift+O"),
    Command("file.demo", "Open the demo", "File", lambda s: s.open_demo(), enabled=reasons.busy),
    Command(
        "file.save",
        "Save project",
        "File",
        lambda s: s.save(),
        "Ctrl+S",
        enabled=reasons.not_saveable,
    ),
    Command(
        "file.save_as",
        "Save project as…",
        "File",
        ask("save_as"),
        "Ctrl+Shift+S",
        enabled=reasons.not_saveable,
    ),
    Command(
        "file.export_scene",
        "Export scene…",
        "File",
        ask("export_scene"),
        "Ctrl+Shift+E",
        enabled=reasons.not_saveable,
    ),
    Command(
        "file.export_selected",
        "Export selection…",
        "File",
        ask("export_selected"),
        enabled=reasons.not_exportable_selection,
    ),
    Command(
        "file.export_objects",
        "Export objects…",
        "File",
        ask("export_objects"),
        enabled=reasons.not_exportable_objects,
    ),
    Command(
        "file.save_script",
        "Save the edits as a script…",
        "File",
        ask("save_script"),
        enabled=reasons.no_edits,
    ),
    Command(
        "file.close", "Close", "File", lambda s: s.close(), "Ctrl+W", enabled=reasons.not_saveable
    ),
    Command("file.quit", "Quit", "File", lambda s: s.quit(), "Ctrl+Q"),
)
