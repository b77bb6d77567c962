"""View: what the color of splats means, how they are drawn, and the background."""

from dataclasses import replace

from gaga_studio.commands.availability import (
    no_confidence,
    no_folders,
    no_groups,
    no_identity_colors,
    no_scene,
)
from gaga_studio.commands.base import Command, Reason, switch
from gaga_studio.session.session import Session
from gaga_studio.session.view_state import CentreColors, Mode, SplatLook

_BACKGROUNDS = ("#1c1c1f", "#000000", "#808080", "#ffffff")  # dark, black, gray, white


def next_mode(session: Session) -> None:
    """Switch to the next mode that has something to show, cyclically."""
    current = [command.id for command in _MODES].index(f"view.{session.view.mode}")
    for command in (*_MODES[current + 1 :], *_MODES):
        if not command.enabled(session):
            command.run(session)
            return


def next_background(session: Session) -> None:
    """Switch to the next background: dark, black, gray, white."""
    now = session.settings.background
    at = _BACKGROUNDS.index(now) if now in _BACKGROUNDS else -1
    color = _BACKGROUNDS[(at + 1) % len(_BACKGROUNDS)]
    session.change_settings(replace(session.settings, background=color))


def _centres(colors: CentreColors, title: str, enabled: Reason) -> Command:
    def run(session: Session) -> None:
        view = session.view
        is_on = view.centre_colors is colors
        view.centre_colors = CentreColors.OWN if is_on else colors
        if not is_on:
            view.mode = Mode.CENTRES

    return Command(
        f"view.{colors}_centres",
        title,
        run,
        enabled=enabled,
        is_on=lambda session: session.view.centre_colors is colors,
    )


def _mode(mode: Mode, title: str) -> Command:
    def run(session: Session) -> None:
        session.view.mode = mode

    needs = {
        Mode.GROUPS: no_groups,
        Mode.MASK: no_groups,
        Mode.CONFIDENCE: no_confidence,
        Mode.IDENTITY: no_identity_colors,
    }
    return Command(
        f"view.{mode}",
        title,
        run,
        enabled=needs.get(mode, no_scene),
        is_on=lambda session: session.view.mode is mode,
    )


def _look(look: SplatLook, title: str) -> Command:
    def run(session: Session) -> None:
        session.view.look = look

    return Command(
        f"view.look_{look}",
        title,
        run,
        enabled=no_scene,
        is_on=lambda session: session.view.look is look,
    )


_MODES = (
    _mode(Mode.COLOR, "Color"),
    _mode(Mode.GROUPS, "Groups"),
    _mode(Mode.DEPTH, "Depth"),
    _mode(Mode.CONFIDENCE, "Confidence"),
    _mode(Mode.CENTRES, "Centres"),
    _mode(Mode.RINGS, "Rings"),
    _mode(Mode.MASK, "Mask of the object"),
    _mode(Mode.IDENTITY, "Identity encodings"),
)
MODE_COMMANDS: tuple[Command, ...] = (
    *_MODES,
    Command("view.next_mode", "Next render mode", next_mode, "M", enabled=no_scene),
    _centres(CentreColors.GROUPS, "Centres in the colors of their groups", no_groups),
    _centres(
        CentreColors.IDENTITY, "Centres in the colors of their identities", no_identity_colors
    ),
    switch(
        "view.folder_colors",
        "Groups in the colors of their folders",
        "folder_colors",
        enabled=no_folders,
    ),
    _look(SplatLook.AUTO, "Look that the file asks for"),
    _look(SplatLook.CLASSIC, "Classic look"),
    _look(SplatLook.ANTIALIASED, "Antialiased look (mip)"),
    Command("view.background", "Next background color", next_background),
)
