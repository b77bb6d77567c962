"""Where the panels are docked: a wide and a compact layout, sized for the text that they hold.

Docks keep their pixels when the window grows; text does not when its scale changes. So another
scale lays the panels out again, and a remembered layout in which there is no picture is forgotten.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from imgui_bundle import hello_imgui, imgui

Draw = Callable[[], None]
Split = tuple[str, str, imgui.Dir, float]
_Made = tuple[int, int, float]  # width, height, scale
_WIDE, _COMPACT = "Wide", "Compact"
_MAIN = "MainDockSpace"
# Columns of the wide layout, pixels at 96 dpi, and the most of the window that they take.
_RIGHT, _RIGHT_MOST, _LEFT, _LEFT_MOST = 345.0, 0.3, 310.0, 0.36
_BOTTOM, _BOTTOM_MOST, _BARS = 205.0, 0.32, 95.0  # its row at the foot; menu, tool and status bar
_SETTLED = 4  # frames after which a layout is built: it is neither left nor looked at before
_LEAST = 80  # pixels: a remembered picture that is smaller is lost
_PICTURE = re.compile(r"\[Window\]\[Viewport\]\n(?:(?!\[).*\n)*?Size=(\d+),(\d+)")


@dataclass(frozen=True)
class Panel:
    """A dockable panel: its title is also its name for tests and for the saved layout."""

    label: str
    draw: Draw
    space: str  # dock space of the wide layout
    compact_space: str  # dock space of the compact layout
    is_bare: bool = False  # no padding, no scrolling: the picture fills it
    # Whether the compact layout, which has little room for tabs, shows it now; None: always.
    is_wanted: Callable[[], bool] | None = None


@dataclass
class Layout:
    """The two layouts of one window, and which of them is used."""

    panels: Sequence[Panel]
    dockable: Callable[[Panel, str], hello_imgui.DockableWindow]
    compact_below: tuple[int, int]  # pixels at 96 dpi
    _name: str = ""
    _scale: float = 0.0
    _made_for: dict[str, _Made] = field(default_factory=dict)  # by layout, until it is shown
    remembered: frozenset[str] = frozenset()  # layouts that a person has arranged
    _frames: int = field(default=0)  # since the layout or its scale changed

    def prepare(
        self, params: hello_imgui.RunnerParams, size: tuple[int, int], scale: float
    ) -> None:
        """Give both layouts to the runner, the one for a window of ``size`` first."""
        self._name = self._wanted(size, scale)
        both = [self._docking(name, size, scale) for name in (_WIDE, _COMPACT)]
        self._made_for = dict.fromkeys((_WIDE, _COMPACT), (*size, scale))
        both.sort(key=lambda docking: docking.layout_name != self._name)
        params.docking_params, other = both
        params.alternative_docking_layouts = [other]
        params.remember_selected_alternative_layout = False

    def fit(self, size: imgui.ImVec2, scale: float) -> None:
        """Bring the layout to a window of ``size`` pixels and text of ``scale``; every frame.

        Fewer columns when the window becomes small for its text, all of them when it becomes large.
        """
        if size.x <= 0 or size.y <= 0:  # minimized
            return
        self._frames += 1
        if self._frames <= _SETTLED:
            return
        docking = hello_imgui.get_runner_params().docking_params
        whole = (int(size.x), int(size.y))
        wanted = self._wanted(whole, scale)
        if wanted != self._name:
            self._name, self._scale, self._frames = wanted, scale, 0
            hello_imgui.switch_layout(wanted)
            return
        # Shares of a window that has another size by now would make panels of another width.
        made, now = self._made_for.pop(self._name, None), (*whole, scale)
        is_stale = made not in (None, now) and self._name not in self.remembered
        if self._scale not in (0.0, scale) or is_stale:
            self._made_for[self._name] = now
            docking.docking_splits = _splits(self._name, *whole, scale)
            docking.layout_reset = True
            self._frames = 0
        self._scale = scale

    def shows(self, panel: Panel) -> bool:
        """Whether the layout that is used has a place for ``panel`` now."""
        return self._name == _WIDE or panel.is_wanted is None or panel.is_wanted()

    def _wanted(self, size: tuple[int, int], scale: float) -> str:
        narrow, low = (side * scale for side in self.compact_below)
        return _COMPACT if size[0] < narrow or size[1] < low else _WIDE

    def _docking(self, name: str, size: tuple[int, int], scale: float) -> hello_imgui.DockingParams:
        docking = hello_imgui.DockingParams()
        docking.layout_name = name
        docking.docking_splits = _splits(name, *size, scale)
        docking.dockable_windows = [
            self.dockable(panel, panel.space if name == _WIDE else panel.compact_space)
            for panel in self.panels
        ]
        docking.main_dock_space_node_flags = imgui.DockNodeFlags_.none
        return docking


def remembered(settings_file: Path | None) -> frozenset[str]:
    """Names of the layouts that the settings file holds as they were left."""
    try:
        text = "" if settings_file is None else settings_file.read_text("utf-8", "replace")
    except OSError:
        text = ""  # there is none yet
    return frozenset(name for name in (_WIDE, _COMPACT) if f"_{name}>>>" in text)


def forget_if_lost(settings_file: Path) -> None:
    """Remove a remembered layout that shows no picture: the panels are laid out as at first."""
    try:
        text = settings_file.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return  # there is none, or it cannot be read: the toolkit says so in its log
    sizes = [(int(width), int(height)) for width, height in _PICTURE.findall(text)]
    if any(min(size) < _LEAST for size in sizes):
        settings_file.unlink()


def _splits(name: str, width: float, height: float, scale: float) -> list[hello_imgui.DockingSplit]:
    """How a layout divides a window of so many pixels, whose text has ``scale``."""
    width, height = width / scale, height / scale
    if name == _COMPACT:
        splits: list[Split] = [
            (_MAIN, "Right", imgui.Dir.right, 0.43),
            ("Right", "RightBottom", imgui.Dir.down, 0.53),
        ]
    else:
        right = min(_RIGHT / width, _RIGHT_MOST)
        left = min(_LEFT / (width * (1 - right)), _LEFT_MOST)
        bottom = min(_BOTTOM / max(height - _BARS, 1.0), _BOTTOM_MOST)
        splits = [
            (_MAIN, "Right", imgui.Dir.right, right),
            ("Right", "RightDown", imgui.Dir.down, 0.36),
            (_MAIN, "Bottom", imgui.Dir.down, bottom),
            (_MAIN, "Left", imgui.Dir.left, left),
        ]
    return [hello_imgui.DockingSplit(*split) for split in splits]
