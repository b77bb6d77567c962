"""Help: finding commands and keys."""

from gaga_studio.commands import handlers
from gaga_studio.commands.base import Command, ask
from gaga_studio.session.requests import Request

HELP_COMMANDS: tuple[Command, ...] = (
    Command("help.palette", "Find a command…", ask(Request.COMMAND_LIST), "F3", ("Ctrl+P",)),
    Command("help.shortcuts", "Keys and mouse", ask(Request.SHORTCUTS), "F1"),
    Command(
        "help.first_steps",
        "First steps",
        handlers.toggle_first_steps,
        is_on=lambda s: not s.settings.first_steps_done,
    ),
    Command("help.about", "About gaga-studio", ask(Request.ABOUT)),
)
