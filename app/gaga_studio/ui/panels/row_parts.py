"""What all kinds of rows of the object list share: columns, selecting, a field for the name."""

from dataclasses import dataclass, field

from imgui_bundle import ImVec2, imgui

from gaga_core.arrays import IntArray
from gaga_core.scene.folders import name_of
from gaga_studio.ui.kit import icons, theme
from gaga_studio.ui.kit.object_menu import ObjectMenuState
from gaga_studio.ui.kit.theme import em

_FLAGS = (
    imgui.SelectableFlags_.span_all_columns
    | imgui.SelectableFlags_.allow_overlap
    | imgui.SelectableFlags_.allow_double_click
)
_HALF_LIT = 0.4  # of the color of a row whose object is selected whole
_STEP, _DEEPEST = 0.8, 4  # of a folder in a folder, ems; deeper ones stand under each other


def indent(depth: int) -> float:
    """Where a row of this depth begins, pixels from the left edge of the list."""
    return min(depth, _DEEPEST) * em(_STEP)


@dataclass(frozen=True)
class RowColumns:
    """Where the columns are that not every width has; -1 = not there."""

    splats: int
    views: int
    quality: int
    shown: int
    is_roomy: bool  # whole numbers, and a third switch
    height: float  # of a row, pixels of this screen
    first: float  # width of the first column, pixels
    arrow: float  # ... and in it of what opens and closes; 0 where nothing does


@dataclass
class RowState:
    """What the lines remember: the mouse, the name that is typed, an open menu."""

    hovered: int = 0  # group whose row is under the mouse
    anchor: int | None = None  # group from which Shift selects a range
    renaming: int | None = None  # group whose name is a text field now
    renaming_folder: str | None = None  # folder whose name is one
    text: str = ""  # of that field
    has_keyboard: bool = False  # the field has taken it
    is_coloring: bool = False  # a group's color is being dragged
    splats: IntArray | None = None  # (K,) selection from before a menu was opened on a row
    menu: ObjectMenuState = field(default_factory=ObjectMenuState)

    def rename(self, group: int, name: str) -> None:
        """Turn the name of an object into a text field."""
        self.renaming, self.renaming_folder = group, None
        self.text, self.has_keyboard = name, False

    def rename_folder(self, folder: str) -> None:
        """Turn the name of a folder into a text field."""
        self.renaming, self.renaming_folder = None, folder
        self.text, self.has_keyboard = name_of(folder), False


def select_area(is_selected: bool, is_partly: bool, height: float) -> bool:
    """Draw what is clicked to select a row, under all its cells; whether it was clicked."""
    lit = imgui.get_style_color_vec4(imgui.Col_.header)
    if is_partly:
        lit = imgui.ImVec4(lit.x, lit.y, lit.z, lit.w * _HALF_LIT)
    imgui.push_style_color(imgui.Col_.header, lit)
    clicked, _ = imgui.selectable("##row", is_selected, _FLAGS, ImVec2(0, height))
    imgui.pop_style_color()
    return clicked


def name_field(state: RowState, height: float) -> tuple[bool, str] | None:
    """The text field of a name: whether one was entered, and which; None while it is open."""
    if not state.has_keyboard:
        imgui.set_keyboard_focus_here()
    imgui.set_next_item_width(-1)
    imgui.push_style_var(imgui.StyleVar_.frame_padding, ImVec2(em(0.2), (height - em(1)) / 2))
    flags = imgui.InputTextFlags_.enter_returns_true | imgui.InputTextFlags_.auto_select_all
    entered, state.text = imgui.input_text("##Name", state.text, flags)
    imgui.pop_style_var()
    had_keyboard, state.has_keyboard = state.has_keyboard, True
    if entered or (had_keyboard and imgui.is_item_deactivated_after_edit()):
        return True, state.text.strip()
    return (False, "") if had_keyboard and imgui.is_item_deactivated() else None


def arrow(low: ImVec2, depth: int, columns: RowColumns, is_open: bool) -> bool:
    """What opens and closes a row of a depth with the corner ``low``; whether it was clicked."""
    left = indent(depth)
    imgui.set_cursor_screen_pos(ImVec2(low.x + left, low.y))
    clicked = imgui.invisible_button("Fold", ImVec2(columns.arrow, columns.height))
    icon = icons.UNFOLDED if is_open else icons.FOLDED
    at = ImVec2(low.x + left + em(0.1), low.y + (columns.height - em(1)) / 2)
    color = theme.TEXT if imgui.is_item_hovered() else theme.DIM
    imgui.get_window_draw_list().add_text(at, theme.u32(color), icon)
    return clicked


@dataclass(frozen=True)
class Across:
    """Text over several columns of a row whose corners are ``low`` and ``high``."""

    low: ImVec2
    high: ImVec2

    def text(self, left: float, top: float, color: int, text: str) -> None:
        """Draw ``text``, pixels from the upper left corner."""
        window = imgui.internal.get_current_window().inner_clip_rect
        edge = max(self.low.y, window.min.y), min(self.high.y, window.max.y)
        drawing = imgui.get_window_draw_list()
        drawing.push_clip_rect(ImVec2(self.low.x, edge[0]), ImVec2(self.high.x, edge[1]))
        drawing.add_text(ImVec2(self.low.x + left, self.low.y + top), color, text)
        drawing.pop_clip_rect()


def last_row() -> Across:
    """The row whose `select_area` was drawn last."""
    return Across(imgui.get_item_rect_min(), imgui.get_item_rect_max())


def lower(height: float, n_lines: int = 1) -> None:
    """Put text into the middle of the row."""
    room = height - n_lines * imgui.get_text_line_height()
    imgui.set_cursor_pos_y(imgui.get_cursor_pos_y() + room / 2)


def compact(n: int) -> str:
    """A number in at most four letters: "604", "4.5k", "12k", "3.1M"."""
    for unit, sign in ((1_000_000, "M"), (1_000, "k")):
        if n >= unit:
            return f"{n / unit:.1f}{sign}" if n < 10 * unit else f"{n // unit}{sign}"
    return f"{n}"
