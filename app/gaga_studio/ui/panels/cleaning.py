"""Clean up in the inspector: what would come and go, and the two ways to end the preview."""

from collections.abc import Sequence

from imgui_bundle import ImVec2, imgui

from gaga_core.scene.cleanup import DROPPED, TAKEN_IN
from gaga_studio.features import cleanup, commands
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face


def draw(session: Session) -> bool:
    """The preview in the place of the buttons; False when there is none."""
    found = cleanup.shown(session)
    if found is None:
        return False
    counts = found.counts
    imgui.dummy(ImVec2(0, em(0.2)))
    _line(
        DROPPED,
        f"{_splats(len(found.remove))} to drop",
        (
            (counts["stray"], "floater" if counts["stray"] == 1 else "floaters"),
            (counts["neighbours_out"], "of what is next to it"),
        ),
    )
    _line(
        TAKEN_IN,
        f"{_splats(len(found.add))} to add",
        ((counts["inside"], "hidden inside"), (counts["neighbours_in"], "at its edge")),
    )
    imgui.dummy(ImVec2(0, em(0.2)))
    gap = theme.scaled(5)
    width = (imgui.get_content_region_avail().x - gap) / 2
    face = Face(icon=icons.CHECK, width=width, primary=True)
    command_buttons.command_button(session, "object.clean_apply", "Apply", face)
    imgui.same_line(0, gap)
    if widgets.button("Cancel", Face(width=width), hint="Leave everything as it is  Esc"):
        cleanup.cancel(session)
    return True


def draw_choice(session: Session, is_next_to: bool) -> None:
    """The choice to clean always; ``is_next_to`` the button that was drawn last."""
    command = commands.command("object.clean_first")
    if is_next_to:
        widgets.next_to(command.title, extra=imgui.get_frame_height() - em(0.6))
    if widgets.checkbox(f"{command.title}###Clean first", session.settings.clean_first)[0]:
        commands.run(command.id, session)
    widgets.tooltip("Clean whole objects before they are isolated, deleted or exported")


def _splats(n: int) -> str:
    return "1 splat" if n == 1 else f"{n:,} splats"


def _line(rgb: Sequence[float], text: str, parts: Sequence[tuple[int, str]]) -> None:
    """A dot in the color of the picture, how many, and of which kinds."""
    with theme.text_color(widgets.rgba(rgb)):
        imgui.text_unformatted("●")
    imgui.same_line(0, em(0.45))
    left = imgui.get_cursor_pos_x()
    imgui.text_unformatted(text)
    kinds = ", ".join(f"{n:,} {what}" for n, what in parts if n)
    if kinds:
        imgui.set_cursor_pos_x(left)
        widgets.dim(kinds, wrap=True)
