"""What the panels remember between frames and nobody else needs to know."""

from dataclasses import dataclass, field

from gaga_core.grouping.memory_bank import Decision
from gaga_studio.ui.files import FileDialog
from gaga_studio.ui.gizmo import Gizmo


@dataclass
class UiState:
    """Open dialogs, half-typed texts, what is scrolled to."""

    dialog: FileDialog | None = None
    renaming: int | None = None  # group whose name is a text field now
    rename_text: str = ""
    rename_started: bool = False  # the text field has taken the keyboard
    anchor: int | None = None  # group from which Shift selects a range
    scroll_to: int | None = None  # group to bring into the list's view
    last_selected: tuple[int, ...] = ()
    gizmo: Gizmo = field(default_factory=Gizmo)
    decision: Decision | None = None  # row of the memory bank whose photo is shown
    show_masks: bool = False  # over the photos of the film strip
    palette_text: str = ""
    palette_at: int = 0
    open_popup: str = ""  # popup to open in this frame
    move: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    turn: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # degrees
    scale: float = 1.0
    rect_from: tuple[float, float] | None = None  # picture pixels
