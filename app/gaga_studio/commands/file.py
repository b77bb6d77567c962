"""File: opening, saving, exporting."""

from gaga_studio.actions import reconstruction
from gaga_studio.commands import availability
from gaga_studio.commands.base import Command, ask

FILE_COMMANDS: tuple[Command, ...] = (
    Command("file.open_folder", "Open scene folder…", "File", ask("open_folder"), "Ctrl+O"),
    Command("file.open_file", "Open splat file…", "File", ask("open_file"), "Ctrl+Shift+O"),
    Command(
        "file.make_splats",
        "Make splats from photos",
        "File",
        reconstruction.make,
        enabled=reconstruction.why_not,
        describe=reconstruction.title,
    ),
    Command(
        "file.make_splats_as",
        "Make splats as…",
        "File",
        ask("photos"),
        enabled=reconstruction.why_not,
    ),
    Command(
        "file.add_splats",
        "Add splats…",
        "File",
        ask("add_splats"),
        enabled=availability.not_saveable,
    ),
    Command(
        "file.demo", "Open the demo", "File", lambda s: s.open_demo(), enabled=availability.busy
    ),
    Command(
        "file.save",
        "Save project",
        "File",
        lambda s: s.save(),
        "Ctrl+S",
        enabled=availability.not_saveable,
    ),
    Command(
        "file.save_as",
        "Save project as…",
        "File",
        ask("save_as"),
        "Ctrl+Shift+S",
        enabled=availability.not_saveable,
    ),
    Command(
        "file.export_scene",
        "Export scene…",
        "File",
        ask("export_scene"),
        "Ctrl+Shift+E",
        enabled=availability.not_saveable,
    ),
    Command(
        "file.export_selected",
        "Export selection…",
        "File",
        ask("export_selected"),
        enabled=availability.not_exportable_selection,
    ),
    Command(
        "file.export_objects",
        "Export objects…",
        "File",
        ask("export_objects"),
        enabled=availability.not_exportable_objects,
    ),
    Command(
        "file.export_masks",
        "Export masks…",
        "File",
        ask("export_masks"),
        enabled=availability.not_exportable_masks,
    ),
    Command(
        "file.save_script",
        "Save the edits as a script…",
        "File",
        ask("save_script"),
        enabled=availability.no_edits,
    ),
    Command(
        "file.save_picture",
        "Save picture…",
        "File",
        ask("save_picture"),
        "Ctrl+Alt+S",
        enabled=availability.not_saveable,
    ),
    Command(
        "file.close",
        "Close",
        "File",
        lambda s: s.close(),
        "Ctrl+W",
        enabled=availability.not_saveable,
    ),
    Command("file.quit", "Quit", "File", lambda s: s.quit(), "Ctrl+Q"),
)
