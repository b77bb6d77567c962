"""The object list: swatch, name, splats, views, and whether it is shown and locked."""

from collections.abc import Sequence

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui

from gaga_core.arrays import IntArray
from gaga_core.scene.objects import ObjectTable
from gaga_studio.session import Session
from gaga_studio.ui import icons, theme, widgets
from gaga_studio.ui.state import UiState
from gaga_studio.ui.theme import em

_TABLE_FLAGS = (
    imgui.TableFlags_.sortable
    | imgui.TableFlags_.scroll_y
    | imgui.TableFlags_.row_bg
    | imgui.TableFlags_.no_saved_settings
    | imgui.TableFlags_.no_pad_outer_x
    | imgui.TableFlags_.sizing_fixed_fit
)
_NAME, _SPLATS, _VIEWS = 1, 2, 3


def draw(session: Session, ui: UiState) -> None:
    """The whole panel."""
    if session.scene is None:
        widgets.empty_state(icons.BOXES, "No scene is open", "Its objects will be listed here.")
        return
    table = session.objects()
    if not (table.ids > 0).any():
        _nothing_yet(session)
        return
    _filter(session)
    _list(session, ui, table)
    _count(session, table)


def _nothing_yet(session: Session) -> None:
    offer = session.stage_offer()
    if offer is None:
        text = "This scene has no groups and no masks to make them from."
    else:
        text = offer.reason
    widgets.empty_state(icons.BOXES, "No objects yet", text)


def _filter(session: Session) -> None:
    imgui.set_next_item_width(-1)
    hint = f"{icons.SEARCH}  Filter by name"
    _, session.filter = imgui.input_text_with_hint("##Filter", hint, session.filter)


def _list(session: Session, ui: UiState, table: ObjectTable) -> None:
    narrow = imgui.get_content_region_avail().x < em(15)
    height = -imgui.get_text_line_height_with_spacing() - theme.scaled(3)
    columns = 5 if narrow else 6
    if not imgui.begin_table("Table", columns, _TABLE_FLAGS, ImVec2(0, height)):
        return
    _columns(narrow)
    rows = _order(table, session.filter)
    groups = [int(table.ids[row]) for row in rows]
    _follow_selection(ui, table, groups)
    clipper = imgui.ListClipper()
    clipper.begin(len(rows))
    while clipper.step():
        for at in range(clipper.display_start, clipper.display_end):
            _row(session, ui, table, int(rows[at]), groups, narrow)
    clipper.end()
    imgui.end_table()
