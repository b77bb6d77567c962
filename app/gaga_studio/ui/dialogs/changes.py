"""The sheet What changed: objects that came, went or moved between two scenes, to be looked at."""

from imgui_bundle import ImVec2, imgui

from gaga_studio.features import add_scene
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import theme, widgets
from gaga_studio.ui.kit.modal import begin_modal, begin_part, close_row
from gaga_studio.ui.kit.theme import em

NAME = "What changed"
_ROWS = 12  # lines that are seen at once


def opens(session: Session) -> None:
    """Open the sheet."""
    if session.document is not None:
        imgui.open_popup(NAME)


def draw(session: Session) -> None:
    """The sheet, while it is open."""
    is_open = session.document is not None
    if not begin_modal(NAME, em(24), dims=False, is_possible=is_open, is_aside=True):
        return
    listed = add_scene.changes(session)
    widgets.dim(f"Between the open scene and {theme.plain(listed.name)}. Click to see.", wrap=True)
    height = em(1.8) * min(len(listed.found), _ROWS) + em(0.6)
    begin_part("Changes", ImVec2(0, height))
    for i, (change, groups) in enumerate(listed.found):
        told = theme.visual(change.sentence(is_metric=listed.is_metric))
        if imgui.selectable(f"{told}###Change {i}", False)[0]:
            add_scene.select(session, groups)
    imgui.end_child()
    close_row()
    imgui.end_popup()
