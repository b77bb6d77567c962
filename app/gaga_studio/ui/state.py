"""What the panels and dialogs remember between frames; each part is defined next to its owner."""

from dataclasses import dataclass, field

from gaga_studio.features.cleanup import ReducePlan
from gaga_studio.ui.chrome.toasts import ToastState
from gaga_studio.ui.dialogs.export import ExportSheet
from gaga_studio.ui.dialogs.file_dialog import FilePicker
from gaga_studio.ui.dialogs.film_and_picture import FilmChoices
from gaga_studio.ui.dialogs.make_masks import MaskDialog
from gaga_studio.ui.dialogs.preferences import DraggedPreferences
from gaga_studio.ui.dialogs.sheets import PaletteState
from gaga_studio.ui.kit.picture_area import PictureArea
from gaga_studio.ui.panels.bookmarks import BookmarkState
from gaga_studio.ui.panels.film_strip import FilmStripState
from gaga_studio.ui.panels.history import HistoryState
from gaga_studio.ui.panels.inspector import InspectorState
from gaga_studio.ui.panels.objects import ObjectListState
from gaga_studio.ui.panels.selecting import SelectBy
from gaga_studio.ui.viewport.training import PlanSheet
from gaga_studio.ui.viewport.viewport import PictureState


@dataclass
class SceneUi:
    """What belongs to the open scene, and is forgotten with it."""

    picture: PictureState = field(default_factory=PictureState)
    objects: ObjectListState = field(default_factory=ObjectListState)
    inspector: InspectorState = field(default_factory=InspectorState)
    select_by: SelectBy = field(default_factory=SelectBy)
    film_strip: FilmStripState = field(default_factory=FilmStripState)
    bookmarks: BookmarkState = field(default_factory=BookmarkState)
    history: HistoryState = field(default_factory=HistoryState)
    masks: MaskDialog = field(default_factory=MaskDialog)


@dataclass
class UiState:
    """The parts, in the hands of the panels and dialogs that own them."""

    files: FilePicker = field(default_factory=FilePicker)
    scene: SceneUi = field(default_factory=SceneUi)
    area: PictureArea = field(default_factory=PictureArea)
    palette: PaletteState = field(default_factory=PaletteState)
    preferences: DraggedPreferences = field(default_factory=DraggedPreferences)
    export: ExportSheet = field(default_factory=ExportSheet)
    reduce: ReducePlan = field(default_factory=ReducePlan)
    film: FilmChoices = field(default_factory=FilmChoices)
    plan: PlanSheet = field(default_factory=PlanSheet)
    toasts: ToastState = field(default_factory=ToastState)

    def forget_scene(self) -> None:
        """Another scene was opened; own models and the switch of the film strip stay."""
        before = self.scene
        self.scene = SceneUi(
            film_strip=FilmStripState(shows_masks=before.film_strip.shows_masks),
            masks=MaskDialog(own=before.masks.own),
        )
