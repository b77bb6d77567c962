"""A part of an object in the list: a click selects its splats, and it can become an object."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from imgui_bundle import imgui

from gaga_core.scene.scene import State
from gaga_studio.features import commands, object_list
from gaga_studio.features.object_list import Line, ObjectListView, Part
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.panels.row_parts import arrow, compact, indent, last_row, lower, select_area

if TYPE_CHECKING:
    from gaga_core.scene.edits import How
    from gaga_studio.ui.panels.object_row import Rows


@dataclass(frozen=True, eq=False)
class PartRow:
    """What is drawn of a part."""

    rows: "Rows"
    line: Line
    part: Part

    def draw(self) -> None:
        """Draw the cells of the row."""
        columns, part = self.rows.columns, self.part
        imgui.table_next_row(0, columns.height)
        imgui.push_id("part " + " ".join(map(str, part.key)))
        imgui.table_set_column_index(0)
        n_selected = self._n_selected()
        if select_area(n_selected > 0, 0 < n_selected < len(part.rows), columns.height):
            self._select("add" if imgui.get_io().key_ctrl or imgui.get_io().key_shift else "set")
        if imgui.begin_popup_context_item("Part menu"):
            self._menu()
            widgets.escape_closes()
            imgui.end_popup()
        self._begin()
        imgui.table_set_column_index(1)
        is_high = columns.splats < 0 and columns.height >= 2.2 * imgui.get_text_line_height()
        lower(columns.height, 1 + is_high)
        left = imgui.get_cursor_pos_x()
        widgets.dim(part.name)
        if is_high:
            top = imgui.get_item_rect_max().y
            imgui.set_cursor_pos_x(left)
            imgui.set_cursor_screen_pos(imgui.ImVec2(imgui.get_cursor_screen_pos().x, top))
            with theme.text_color(theme.FAINT):
                imgui.text_unformatted(f"{len(part.rows):,} splats")
        if columns.splats >= 0:
            imgui.table_set_column_index(columns.splats)
            lower(columns.height)
            n = len(part.rows)
            widgets.number(f"{n:,}" if columns.is_roomy else compact(n), theme.DIM)
        imgui.pop_id()

    def _begin(self) -> None:
        """What opens the parts of the part, and its sign in the color of the object."""
        row, columns, depth = last_row(), self.rows.columns, self.line.depth
        parts, listing = self.rows.parts, self.rows.document.feature(ObjectListView)
        if parts is not None and parts.parts(self.part):
            if arrow(row.low, depth, columns, self.part.key in listing.open_parts):
                listing.toggle_parts(self.part.key)
            widgets.tooltip("Its parts")
        color = imgui.get_color_u32(widgets.rgba(self.rows.table.colors[self.line.row]))
        left = indent(depth) + columns.arrow + em(0.15)
        row.text(left, (columns.height - em(1)) / 2, color, icons.PART)

    def _n_selected(self) -> int:
        scene = self.rows.document.scene
        key = (self.part, scene.revision.state)

        def count() -> int:
            return int(np.count_nonzero(scene.state[self.part.rows] & np.uint8(State.SELECTED)))

        return self.rows.document.read.once(f"selected of {self.part.key}", key, count)

    def _select(self, how: "How") -> None:
        name = self.rows.table.names[self.line.row]
        object_list.select_part(self.rows.session, self.part, name, how)

    def _menu(self) -> None:
        session = self.rows.session
        if imgui.is_window_appearing():
            self._select("set")
        if len(self.part.key) == 2:  # of an object, not of a part
            if imgui.menu_item_simple(f"{icons.SPLIT}  Split here###Split here"):
                commands.run("object.split_here", session)
            widgets.tooltip("Make objects of all parts of this object")
        if imgui.menu_item_simple(f"{icons.SEPARATE}  Make an object of it###Make an object"):
            commands.run("object.separate", session)
