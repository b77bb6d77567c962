"""What the panels remember between frames and nobody else needs to know."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.segmentation.choose import ProviderEntry
from gaga_studio.actions.color_grade import GradeSliders
from gaga_studio.actions.masks import MaskForm, MaskPreview, MaskRequest
from gaga_studio.actions.reconstruction import ReconstructionPlan
from gaga_studio.actions.selection import Histograms
from gaga_studio.ui.dialogs.export_options import Wishes
from gaga_studio.ui.dialogs.file_dialog import FileDialog


@dataclass
class SelectBy:
    """What the "Select by" panel holds."""

    histograms: Histograms = field(default_factory=Histograms)
    column: str = ""
    low: float = 0.0
    high: float = 1.0
    color: tuple[float, float, float] = (0.5, 0.5, 0.5)
    tolerance: float = 0.1
    box: tuple[DoubleArray, DoubleArray] | None = None  # lo, hi (3,) world
    name: str = ""  # half typed


@dataclass
class Repairs:
    """What the object list and the memory bank hand each other."""

    dragged: Decision | None = None  # mask that is on its way to an object
    splats: IntArray | None = None  # selection from before a menu was opened on a row
    wanted: str = ""  # half-typed name in a menu of objects
    overlaps: tuple[str, dict[int, float]] = ("", {})  # of the mask whose menu is open
    is_coloring: bool = False  # a group's color is being dragged


@dataclass
class MaskDialog:
    """What the dialog that makes masks holds."""

    entries: tuple[ProviderEntry, ...] = ()  # empty: look for models when it opens
    own: tuple[ProviderEntry, ...] = ()  # models elsewhere that the user named
    request: MaskRequest = field(default_factory=MaskRequest)
    view: str = ""  # photo to try on
    preview: MaskPreview | None = None
    n_previews: int = 0
    reopen: bool = False  # after a file dialog
    form: MaskForm = "dataset"  # of the export


@dataclass
class UiState:
    """Open dialogs, half-typed texts, what is scrolled to."""

    dialog: FileDialog | None = None
    on_path: Callable[[Path], object] | None = None  # what the dialog's answer is for
    native_dialogs: bool = False
    renaming: int | None = None  # group whose name is a text field now
    rename_text: str = ""
    rename_started: bool = False  # the text field has taken the keyboard
    anchor: int | None = None  # group from which Shift selects a range
    hovered_row: int = 0  # group whose row is under the mouse
    was_row_hovered: bool = False
    scroll_to: int | None = None  # group to bring into the list's view
    last_selected: tuple[int, ...] = ()
    decision: Decision | None = None  # row of the memory bank whose photo is shown
    live_view: str = ""  # last view of a running association whose picture was there
    live_bank: MemoryBank | None = None
    show_masks: bool = False  # over the photos of the film strip
    strip_seen: int | None = None  # photo that the film strip was last scrolled to
    history_seen: int = 0  # entries done when the list was last scrolled
    find_now: bool = False  # the search box takes the keyboard
    find_at: int = 0  # line of the answer that was last scrolled to
    masks: MaskDialog = field(default_factory=MaskDialog)
    plan: ReconstructionPlan | None = None  # of the sheet that makes splats
    plan_of: int = 0  # id of the photos that it is for
    palette_text: str = ""
    palette_at: int = 0
    open_popup: str = ""  # popup to open in this frame
    picture: tuple[float, float, float, float] = (0.0, 0.0, 400.0, 300.0)  # x, y, w, h on screen
    closed_offer: int = 0  # document whose offer was put away
    half_set: dict[str, float] = field(default_factory=dict)  # preferences being dragged
    offer_top: float = float("inf")  # on screen: upper edge of the offer of the next stage
    steps_strip: float = 0.0  # height of the first steps at the foot of an empty picture
    closed: set[int] = field(default_factory=set)  # notices that were closed
    has_notices: bool = False  # some go by themselves: keep drawing
    move: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # of the drag in a field
    turn: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # degrees
    scale: float = 1.0
    color: tuple[float, float, float] | None = None  # being chosen, not applied yet
    grade: GradeSliders = field(default_factory=GradeSliders)
    select_by: SelectBy = field(default_factory=SelectBy)
    repairs: Repairs = field(default_factory=Repairs)

    wishes: Wishes = field(default_factory=Wishes)  # of films and pictures
    differences: dict[str, float] = field(default_factory=dict)  # mean errors of photos, 0..1
    renaming_mark: int | None = None  # bookmark whose name is a text field now
    mark_text: str = ""
    mark_started: bool = False

    def forget(self) -> None:
        """Another scene was opened: nothing of the former one is remembered."""
        self.renaming = self.anchor = self.scroll_to = self.decision = self.color = None
        self.live_view, self.live_bank = "", None
        self.strip_seen, self.history_seen, self.last_selected = None, 0, ()
        self.grade, self.select_by, self.repairs = GradeSliders(), SelectBy(), Repairs()
        self.masks = MaskDialog(own=self.masks.own)
        self.find_at = 0
        self.renaming_mark, self.mark_started = None, False
        self.differences.clear()
        self.clear_placement()

    def clear_placement(self) -> None:
        """Forget the numbers that were being dragged."""
        self.move, self.turn, self.scale = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 1.0
