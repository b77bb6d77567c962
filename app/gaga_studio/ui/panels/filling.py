"""Delete and fill in the inspector: what is new, the choices, and the two ways to end it."""

from pathlib import Path

from imgui_bundle import ImVec2, imgui

from gaga_studio.features import commands, fill
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face


def draw(session: Session) -> bool:
    """The preview in the place of the panel; False when there is none."""
    found = fill.shown(session)
    if found is None:
        return False
    imgui.text_unformatted("Delete and fill")
    imgui.dummy(ImVec2(0, em(0.2)))
    for line in fill.summary(found):
        widgets.dim(line, wrap=True)
    command = commands.command("object.fill_lighten")
    if widgets.checkbox(f"{command.title}###Lighten", found.lighten)[0]:
        commands.run(command.id, session)
    widgets.tooltip("Lighten what is darker where the object stood, as its surroundings are")
    _colors(session)
    imgui.dummy(ImVec2(0, em(0.2)))
    gap = theme.scaled(5)
    width = (imgui.get_content_region_avail().x - gap) / 2
    face = Face(icon=icons.CHECK, width=width, primary=True)
    command_buttons.command_button(session, "object.fill_apply", "Apply", face)
    imgui.same_line(0, gap)
    if widgets.button("Cancel", Face(width=width), hint="Leave everything as it is  Esc"):
        fill.cancel(session)
    return True


def _colors(session: Session) -> None:
    """Where the colors of the hole come from; the file of a model is asked for."""
    widgets.dim("Colors of the hole")
    model = Path(session.settings.inpainting_model).name
    room = imgui.get_content_region_avail().x - imgui.get_frame_height() - em(1)
    by_model = widgets.elided(model, room) if model else "Inpainting model…"
    for id_, label, is_on in (
        ("object.fill_continue", "Continue the surroundings", not model),
        ("object.fill_model", by_model, bool(model)),
    ):
        command = commands.command(id_)
        why_not = command.enabled(session)
        imgui.begin_disabled(bool(why_not))
        if widgets.radio_button(f"{label}###{id_}", is_on):
            commands.run(id_, session)
        imgui.end_disabled()
        widgets.tooltip(why_not or command.title)
