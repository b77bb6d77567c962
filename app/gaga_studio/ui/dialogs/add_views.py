"""The sheet Add new photos and masks: what joins, and what happens to what a person did."""

from imgui_bundle import ImVec2, imgui

from gaga_studio.features.find import memory_bank
from gaga_studio.session.notices import Request
from gaga_studio.session.session import Session
from gaga_studio.ui.dialogs import make_masks
from gaga_studio.ui.kit import icons, widgets
from gaga_studio.ui.kit.modal import begin_modal
from gaga_studio.ui.kit.requests import RequestTable
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

NAME = "Add new photos and masks"
_NAMED = 4  # photos


def register(table: RequestTable) -> None:
    """Answer the request for the sheet."""
    table.register_popup(Request.ADD_VIEWS, NAME)


def draw(session: Session) -> None:
    """The sheet, while it is open."""
    if not begin_modal(NAME, em(30)):
        return
    if session.document is None:
        imgui.close_current_popup()
        imgui.end_popup()
        return
    make_masks.draw_choice(session, -1)
    names, bare = memory_bank.new_views(session), memory_bank.text_on_bare_photos(session)
    n = len(names)
    shown = ", ".join(names[:_NAMED]) + (", …" if n > _NAMED else "")
    if names:
        took = "has masks that took" if n == 1 else "have masks that took"
        widgets.dim(f"{n:,} photo{'' if n == 1 else 's'} {took} no part yet: {shown}", wrap=True)
    if bare:
        widgets.dim(bare, wrap=True)
    widgets.dim(
        "Only these are looked at: their masks join the objects, or make new ones.", wrap=True
    )
    imgui.dummy(ImVec2(0, em(0.2)))
    for sentence in memory_bank.consequences_of_adding(session):
        widgets.dim(f"•  {sentence}", wrap=True)
    imgui.dummy(ImVec2(0, em(0.2)))
    job = session.jobs.running
    busy = "" if job is None else f"{job.title} is still running."
    face = Face("Add", icons.RUN, primary=True)
    if widgets.button("Add views", face, why_not=busy or memory_bank.why_no_new_views(session)):
        imgui.close_current_popup()
        memory_bank.add_views(session)
    imgui.same_line()
    if widgets.button("Close"):
        imgui.close_current_popup()
    imgui.end_popup()
