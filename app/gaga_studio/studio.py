"""The one place that joins window, session, panels and picture; the frame loop."""

import logging
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import moderngl
import numpy as np
from imgui_bundle import imgui

from gaga_core.arrays import UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.export.export import MeshForm
from gaga_core.io.files import explain_os_error
from gaga_core.io.images import write_rgb
from gaga_core.io.splats.splat_files import SplatFormat
from gaga_studio.features import (
    add_scene,
    autosave,
    cleanup,
    fill,
    level_of_detail,
    reconstruction,
    split_view,
)
from gaga_studio.features import camera as camera_path_actions
from gaga_studio.features.cleanup import ReducePlan
from gaga_studio.features.commands import new_session
from gaga_studio.features.dataset import DatasetPlan
from gaga_studio.features.files import drop
from gaga_studio.features.find import memory_bank as bank
from gaga_studio.features.find.search import find_here, follow
from gaga_studio.features.view import background_of
from gaga_studio.gpu.context import attach
from gaga_studio.gpu.images import ImageStore
from gaga_studio.gpu.viewport import Overlays, Pacing, Viewport
from gaga_studio.session import stages
from gaga_studio.session.notices import Level, PreviewWaitsError, Request
from gaga_studio.session.session import Session
from gaga_studio.session.view import Mode, RenderRequests, ViewState
from gaga_studio.system import paths, window
from gaga_studio.system.paths import start_log
from gaga_studio.system.window import Hooks, Panel, Window, WindowOptions
from gaga_studio.ui.chrome import command_buttons, menu, status, toasts, toolbar
from gaga_studio.ui.chrome.menu import MenuState
from gaga_studio.ui.chrome.status import status_text
from gaga_studio.ui.chrome.toasts import ToastState
from gaga_studio.ui.dialogs import (
    changes,
    dataset,
    export,
    files,
    film_and_picture,
    first_steps,
    masks,
    models,
    preferences,
    reduce,
    sheets,
)
from gaga_studio.ui.dialogs.export import ExportSheet
from gaga_studio.ui.dialogs.files import FilePicker, has_native
from gaga_studio.ui.dialogs.film_and_picture import FilmChoices
from gaga_studio.ui.dialogs.masks import MaskDialog
from gaga_studio.ui.dialogs.preferences import DraggedPreferences
from gaga_studio.ui.dialogs.sheets import PaletteState
from gaga_studio.ui.kit import number_fields, textures, theme
from gaga_studio.ui.kit.picture_area import PictureArea
from gaga_studio.ui.panels import (
    camera_path,
    film_strip,
    history,
    inspector,
    memory_bank,
    objects,
    search,
    selecting,
)
from gaga_studio.ui.panels.camera_path import BookmarkState
from gaga_studio.ui.panels.film_strip import FilmStripState
from gaga_studio.ui.panels.history import HistoryState
from gaga_studio.ui.panels.inspector import InspectorState
from gaga_studio.ui.panels.objects import ObjectListState
from gaga_studio.ui.panels.selecting import SelectBy
from gaga_studio.ui.viewport import training
from gaga_studio.ui.viewport.training import PlanSheet
from gaga_studio.ui.viewport.viewport import PictureState, ViewportPanel

# --- State of the panels and dialogs between frames; each part is defined next to its owner.


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
    dataset: DatasetPlan = field(default_factory=DatasetPlan)
    film: FilmChoices = field(default_factory=FilmChoices)
    menu: MenuState = field(default_factory=MenuState)
    plan: PlanSheet = field(default_factory=PlanSheet)
    toasts: ToastState = field(default_factory=ToastState)
    in_front: Callable[[Session], object] | None = None  # waits until the asked panel is in front

    def forget_scene(self) -> None:
        """Another scene was opened; own models and the switch of the film strip stay."""
        before = self.scene
        self.scene = SceneUi(
            film_strip=FilmStripState(shows_masks=before.film_strip.shows_masks),
            masks=MaskDialog(own=before.masks.own),
        )


# --- The dockable panels: their titles, who draws them, and where each is docked.


def panels(session: Session, ui: UiState, picture: ViewportPanel) -> tuple[Panel, ...]:
    """Every panel of the window. State of a scene is looked up when a panel is drawn."""

    def draw_objects() -> None:
        objects.draw(session, ui.scene.objects, ui.scene.picture.evidence.menu, ui.area)

    def draw_bookmarks() -> None:
        camera_path.draw_bookmarks(session, ui.scene.bookmarks)

    def draw_picture() -> None:
        picture.draw(session, ui.scene.picture, ui.area)

    right, down = ("Right", "RightBottom"), ("RightDown", "RightBottom")
    bottom, main = ("Bottom", "Right"), ("MainDockSpace", "MainDockSpace")
    return (
        Panel("Viewport", draw_picture, *main, is_bare=True),
        Panel("Objects", draw_objects, "Left", "Right"),
        Panel("Inspector", lambda: inspector.draw(session, ui.scene.inspector), *right),
        Panel("Select by", lambda: selecting.draw(session, ui.scene.select_by), *right),
        Panel("Memory bank", lambda: memory_bank.draw(session, ui.scene.picture.evidence), *down),
        Panel("Views", lambda: film_strip.draw(session, ui.scene.film_strip), *bottom),
        Panel("Camera path", lambda: camera_path.draw(session), *bottom),
        Panel(
            "Bookmarks", lambda: camera_path.draw_bookmarks(session, ui.scene.bookmarks), *bottom
        ),
        Panel(
            memory_bank.TIMELINE,
            lambda: memory_bank.draw_timeline(session),
            *bottom,
            is_wanted=lambda: bank.timeline_of(session).is_open,
        ),
        Panel("History", lambda: history.draw(session, ui.scene.history), *down),
    )


# --- Handlers of the requests of the session.

_POPUPS = {
    Request.SHORTCUTS: sheets.KEYS,
    Request.ABOUT: sheets.ABOUT,
    Request.PREFERENCES: preferences.SHEET,
    Request.OBJECT_MENU: command_buttons.OBJECT_POPUP,
    Request.SCENE_MENU: command_buttons.SCENE_POPUP,
    Request.MAKE_SPLATS: training.SHEET,
    Request.SAVE_PICTURE: film_and_picture.PICTURE,
    Request.MAKE_MASKS: masks.MAKE,
    Request.EXPORT_MASKS: masks.EXPORT,
    Request.DATASET: dataset.SHEET,
    Request.FIND_OBJECTS: masks.FIND_OBJECTS,
    Request.ADD_VIEWS: masks.ADD_VIEWS,
}


def openers(ui: UiState) -> dict[Request, Callable[[Session], object]]:
    """What opens for each request. State of a scene is looked up when a request comes."""
    exports = partial(export.opens, sheet=ui.export)
    popups = {request: _popup(name) for request, name in _POPUPS.items()}
    return {
        **popups,
        **files.openers(ui.files),
        Request.SAVE_FILM: film_and_picture.opens_film,
        Request.COMMAND_LIST: lambda _: sheets.open_commands(ui.palette),
        Request.EXPORT_SCENE: partial(exports, what="scene"),
        Request.EXPORT_SELECTED: partial(exports, what="selected"),
        Request.EXPORT_OBJECTS: partial(exports, what="objects"),
        Request.EXPORT_MESHES: partial(exports, what="objects", solid=MeshForm.MESH),
        Request.EXPORT_SIMULATION: partial(exports, what="simulation"),
        Request.EXPORT_PAGE: partial(exports, what="scene", form=SplatFormat.HTML),
        Request.EXPORT_CAMERAS: partial(exports, what="cameras"),
        Request.MODELS: models.opens,
        Request.REDUCE: partial(reduce.opens, plan=ui.reduce),
        Request.CHANGES: changes.opens,
        Request.PANELS_BACK: lambda _: window.put_panels_back(),
        Request.RENAME: _in_panel(
            "Objects", lambda s: objects.rename_selected(s, ui.scene.objects), ui
        ),
        Request.TIMELINE: _panel(memory_bank.TIMELINE),
        Request.HISTORY: _panel("History"),
        Request.CAMERA_PATH: _panel("Camera path"),
        Request.RECOLOR: _in_panel("Inspector", lambda _: _open_picker(ui), ui),
        Request.FIND: _in_panel("Objects", lambda _: search.focus(ui.scene.objects.search), ui),
        Request.FIND_IN_VIEW: lambda s: find_here(s, ui.area.size),
    }


def _popup(name: str) -> Callable[[Session], object]:
    return lambda _: imgui.open_popup(name)


def _panel(name: str) -> Callable[[Session], None]:
    return lambda session: session.view.ask_for_panel(name)


def _in_panel(
    name: str, act: Callable[[Session], object], ui: UiState
) -> Callable[[Session], None]:
    """Do ``act`` once the panel is in front: in one that is covered, or just appears, a field would
    lose the keyboard."""

    def ask(session: Session) -> None:
        if session.view.show_panels and window.is_in_front(name):
            imgui.set_window_focus(name)
            act(session)
            return
        _panel(name)(session)
        ui.in_front = act

    return ask


def _open_picker(ui: UiState) -> None:
    ui.scene.inspector.opens_picker = True


# --- Errors while drawing: they become notices, and the frame continues.
# An error that leaves a child window, a popup or a table open would end the process at the end of
# the frame. So the toolkit's stacks are put back to where they were before.

Act = Callable[[], object]


class Guard:
    """Calls what the window wants drawn. ``tell`` gets the place and the error.

    A place that fails in every frame in the same way is reported once.
    """

    def __init__(self, tell: Callable[[str, Exception], None]) -> None:
        self._tell = tell
        self._failing: dict[str, str] = {}  # what each place failed with when it was called last

    def wrap(self, place: str, act: Act) -> Callable[[], None]:
        """``act``, called by this guard."""
        return lambda: self.call(place, act)

    def call(self, place: str, act: Act) -> None:
        """Call ``act``; report what it raises, never pass it on."""
        stacks = _stacks()
        try:
            act()
        except Exception as error:  # noqa: BLE001  the toolkit would abort: it becomes a notice and a log entry
            # A list clipper ends itself when it goes, and needs its window for that.
            traceback.clear_frames(error.__traceback__)
            if stacks is not None:
                _put_back(stacks)
            failure = repr(error)
            if self._failing.get(place) != failure:
                self._failing[place] = failure
                self._tell(place, error)
        else:
            self._failing.pop(place, None)


def _stacks() -> imgui.internal.ErrorRecoveryState | None:
    """How much is open now; None between two frames, when nothing can be."""
    if not imgui.get_current_context().within_frame_scope:
        return None
    stacks = imgui.internal.ErrorRecoveryState()
    imgui.internal.error_recovery_store_state(stacks)
    return stacks


def _put_back(stacks: imgui.internal.ErrorRecoveryState) -> None:
    """Close what was opened since, silently: the error itself is reported."""
    io = imgui.get_io()
    said = [f"config_error_recovery_enable_{what}" for what in ("assert", "tooltip", "debug_log")]
    kept = [getattr(io, name) for name in said]
    for name in said:
        setattr(io, name, False)
    # The toolkit would close the menu bar, too, in which the menus were drawn.
    bar = imgui.internal.find_window_by_name(_MENU_BAR)
    is_in_bar = bar is not None and bar.dc.menu_bar_appending
    if is_in_bar:
        bar.dc.menu_bar_appending = False
    imgui.internal.error_recovery_try_to_recover_state(stacks)
    if is_in_bar:
        bar.dc.menu_bar_appending = True
    for name, was in zip(said, kept, strict=True):
        setattr(io, name, was)


_LOG = logging.getLogger(__name__)
_MENU_BAR = "##MainMenuBar"
_REST_RATE = 2.0  # frames a second while nothing happens
_PART_S = 0.04  # of a picture that the processor draws, in one frame
_PICTURE_SIDE = 320  # pixels: about the longest side of a picture in the recent list
_JOB_RATE = 12.0  # while a job runs: its progress moves, and the job needs the processor
_JOB_RATE_SOFTWARE = 4.0  # the same where the processor draws: 1600 x 1000 take 40 ms of it


class Studio:
    """The program with a window."""

    def __init__(
        self,
        path: Path | None = None,
        *,
        demo: bool = False,
        session: Session | None = None,
        options: WindowOptions | None = None,
    ) -> None:
        self.session = session or new_session()
        self.ui = UiState(FilePicker(use_native=has_native()))
        self._openers = openers(self.ui)
        self.viewport: Viewport | None = None
        self.left: Viewport | None = None  # of a split view whose left side is drawn, too
        self._shows_left = False  # in this frame
        self._view = self.session.view  # that the picture was drawn with
        self.images: ImageStore | None = None
        self._ctx: moderngl.Context | None = None
        self._first: tuple[Path | None, bool] = (path, demo)
        self._pacing = Pacing()
        self._autosave = autosave.Autosave()
        self._steps = first_steps.FirstSteps()
        self._title = status.WindowTitle()
        self._guard = Guard(self._failed)
        self._shortcuts = preferences.Shortcuts(
            lambda: self.picture.follow(self.session, self.ui.area)
        )
        self._backend = ""
        self._has_focus = True
        self._document: object = None
        self._previewed = ""  # what waited to be applied in the frame before
        self._masks: object = None
        self._pictured = ""  # the path in the recent list that has a picture of the document
        self._named: tuple[int, ...] | None = None  # state whose names have their glyphs
        self._has_new_letters = False  # what was drawn before is drawn again, at once
        self.never_idle = False  # tests want every frame at once
        self.picture = ViewportPanel(
            self._render, self._render_left, self._mode_drawn, window.physical_keys
        )
        remembered = WindowOptions(settings_file=paths.home() / "window.ini")
        options = replace(options or remembered, ui_scale=self.session.settings.ui_scale)
        listed = panels(self.session, self.ui, self.picture)
        guarded = tuple(replace(p, draw=self._guard.wrap(p.label, p.draw)) for p in listed)
        self.window = Window(self._hooks(), guarded, options)

    def run(self) -> None:
        """Open the window and stay until it is closed. Raises ``GagaError`` if it cannot open."""
        start_log()
        home = paths.home()
        try:
            home.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            lost = "Settings and autosaves are not kept."
            self.session.notify(Level.WARNING, f"{explain_os_error(error, home)} {lost}")
        # While the window opens nobody clicks: half of what a first click needs is compiled then.
        self.session.jobs.prepare("Prepare kernels", stages.kernels_stage(self.session.rates))
        try:
            self.window.run()
        finally:
            self.session.jobs.shut_down()  # where no window opened, too

    # --- called by the window

    def _hooks(self) -> Hooks:
        session, guarded = self.session, self._guard.wrap
        return Hooks(
            started=self._started,
            ending=self._ending,
            fonts=theme.load_fonts,
            style=theme.apply_style,
            before_frame=self._before_frame,
            keys=guarded("Keys", self._keys),
            menu=guarded("Menu", lambda: menu.draw(session, self.ui.menu)),
            tool_bar=guarded("Tool bar", lambda: toolbar.draw(session, self.ui.area)),
            status=guarded("Status bar", self._status),
            overlay=self._overlay,
            dropped=self._dropped,
            may_close=self._may_close,
            frame_rate=self._frame_rate,
            panels_shown=lambda: session.view.show_panels,
            is_opening=lambda: self.ui.in_front is not None,
            take_asked_panel=session.view.take_asked_panel,
        )

    def _keys(self) -> None:
        if not self.picture.is_following:
            self._shortcuts.pressed(self.session, self._escape)

    def _started(self) -> None:
        self._ctx = attach()
        self._backend = _backend(self._ctx)
        self.viewport = Viewport(self._ctx)
        self._pacing.is_software = self.viewport.is_software
        self.images = ImageStore(self._ctx)
        self.session.images = self.images
        self.session.render_requests = RenderRequests(
            max_side=int(self._ctx.info["GL_MAX_TEXTURE_SIZE"]),
            is_fast=not self.viewport.is_software,
        )
        path, demo = self._first
        autosave.offer(self.session)
        if path is not None:
            self.session.open(path)
        elif demo:
            self.session.open_demo()

    def _ending(self) -> None:
        """Give back every OpenGL object while the context is still there."""
        self.session.shut_down()
        self._autosave.finish()
        self.session.images = None
        if self.images is not None:
            self.images.release()
        self._release_left()
        if self.viewport is not None:
            self.viewport.release()
        self.viewport = self.images = None

    def _failed(self, place: str, error: Exception) -> None:
        """An error while something was drawn or done: a sentence, the rest in the log."""
        if isinstance(error, GagaError):
            is_hint = isinstance(error, PreviewWaitsError)
            self.session.notify(Level.HINT if is_hint else Level.ERROR, str(error))
            return
        _LOG.error("%s failed", place, exc_info=error)
        self.session.notify(Level.ERROR, paths.failure(place))

    def _before_frame(self) -> None:
        self._guard.call("Session", self._prepare)
        self._guard.call("Autosave", lambda: self._autosave.tick(self.session))

    def _prepare(self) -> None:
        """Everything that a frame needs before it is drawn."""
        theme.use(self.session.settings.theme)
        self._letters()
        size, dpi = imgui.get_io().display_size, imgui.get_style().font_scale_dpi
        theme.resize(window.fitting_scale(self.session.settings.ui_scale, (size.x, size.y), dpi))
        if not_read := number_fields.take_not_read():
            self.session.notify(Level.HINT, not_read)
        self.session.tick(imgui.get_io().delta_time)
        self._guard.call("Names", lambda: follow(self.session))  # also where no list is shown
        camera_path_actions.tick(self.session, imgui.get_io().delta_time)
        bank.tick_timeline(self.session, imgui.get_io().delta_time)
        if (viewport := self.viewport) is not None:
            seconds = viewport.slices.elapsed_s
            reconstruction.tick(self.session, imgui.get_io().delta_time, viewport.settled, seconds)
        had_focus, self._has_focus = self._has_focus, not imgui.get_io().app_focus_lost
        if self._has_focus and not had_focus:
            self.session.look_at_files()
        if self.session.render_requests is not None:
            self.session.render_requests.serve(self._paint)
        self._keep_picture()
        if self.session.document is not self._document:
            self._document, self._pictured = self.session.document, ""
            self.ui.forget_scene()
            self._masks = None
        if self.session.masks is not self._masks:  # made again, they have the same names
            self._masks = self.session.masks
            if self.images is not None:
                self.images.clear()
        if self.images is not None:
            self.images.receive()
        self._shows_left = False  # it is away while the camera goes from photo to photo
        if split_view.left_drawn(self.session, self.session.view) is None:
            self._release_left()
        self.window.set_title(self._title.text(self.session, time.monotonic()))
        if self.session.should_quit:
            self.window.close()

    def _keep_picture(self) -> None:
        """Keep what is first seen of a scene, or of what it was saved as, as its picture in the
        recent list."""
        session, viewport = self.session, self.viewport
        document, recent = session.document, session.settings.recent
        if document is None or viewport is None or not recent or recent[0] == self._pictured:
            return
        if not self.is_settled or not viewport.texture or document is not self._document:
            return
        self._pictured, project = recent[0], document.project
        if str(project.opened_again_by(project.source).resolve()) != recent[0]:
            return  # the demo is not in the list
        file, pixels = paths.picture_of(recent[0]), viewport.read_pixels()
        step = max(max(pixels.shape[:2]) // _PICTURE_SIDE, 1)
        try:
            write_rgb(file, pixels[::step, ::step])
            paths.forget_pictures(recent)
        except GagaError as error:  # the list shows a sign instead
            _LOG.warning("recent: %s", error)
        if self.images is not None:
            self.images.drop(f"photo {file} {textures.THUMBNAIL}")

    def _letters(self) -> None:
        """Have glyphs for the names that are shown."""
        scene = self.session.scene
        now = () if scene is None else (scene.revision.names, id(scene))
        names: tuple[str, ...] = ()
        if now != self._named:
            self._named = now
            names = () if scene is None else tuple(scene.names.values())
            names = (*names, *(camera.name for camera in self.session.cameras))
        self._has_new_letters = theme.load_letters((*names, self.session.title))

    def _overlay(self) -> None:
        """After the panels: dialogs, sheets, notices."""
        session, ui, call = self.session, self.ui, self._guard.call
        ui.area.has_inspector = window.is_in_front("Inspector")  # all panels are drawn by now
        is_covered = ui.scene.picture.evidence.decision is not None or session.live is not None
        is_covered |= toasts.is_asking(session, ui.toasts, ui.area)
        steps = partial(first_steps.draw, session, ui.area, self._steps, is_covered=is_covered)
        # One place for each: a failure is reported once while the same place keeps failing.
        call("Commands", self._answer_request)
        call("Preview", self._show_preview)
        call("File dialog", ui.files.draw)
        call("Dialogs", lambda: sheets.draw(session, ui.palette))
        call("Preferences", lambda: preferences.draw(session, ui.preferences))
        call("Export", lambda: export.draw(session, ui.export, ui.files))
        call("Film and picture", lambda: film_and_picture.draw(session, ui.film, ui.files))
        call("Make splats", lambda: training.sheet(session, ui.plan))
        call("Menus", lambda: command_buttons.picture_menus(session))
        call("Make masks", lambda: masks.draw_make_masks(session, ui.scene.masks, ui.files))
        call("Find objects", lambda: masks.draw_find_objects(session))
        call("Add views", lambda: masks.draw_add_views(session))
        call("Models", lambda: models.draw(session))
        call("Reduce splats", lambda: reduce.draw(session, ui.reduce))
        call("Labelled data", lambda: dataset.draw(session, ui.dataset, ui.files))
        call("What changed", lambda: changes.draw(session))
        call("First steps", steps)
        call("Notices", lambda: toasts.draw(session, ui.toasts, ui.area))

    def _show_preview(self) -> None:
        """Bring what applies or cancels a preview to the front as it begins to wait."""
        document = self.session.document
        waits = document.waiting if document is not None else ""
        if waits and not self._previewed and self.session.view.show_panels:
            _panel("Inspector")(self.session)
        self._previewed = waits

    def _answer_request(self) -> None:
        request = self.session.take_request()
        if request is not None:
            self._openers[request](self.session)
        act = self.ui.in_front
        if act is not None and not self.session.view.asked_panel:
            self.ui.in_front = None
            act(self.session)

    def _status(self) -> None:
        tool = self.picture.controller.tool(self.session)
        hint = self.picture.follow_hint or status_text(
            self.session, tool, is_typing=imgui.get_io().want_text_input
        )
        document = self.session.document
        figures = None
        if document is not None:
            n_splats = document.read.n_splats()
            figures = status.FrameFigures(n_splats, self._pacing.frame_ms, self._backend)
        status.draw(self.session, hint, figures)

    def _escape(self) -> bool:
        """End a preview or a gesture, or close a notice or a card; whether there was one."""
        if any(one.cancel(self.session) for one in (cleanup, fill, add_scene)):
            return True
        if self.session.view.playback.is_playing:
            camera_path_actions.stop_playing(self.session)
            return True
        is_dragging = self.session.is_dragging
        if self.picture.cancel(self.session):
            if is_dragging:
                self.session.cancel_preview()
                imgui.internal.clear_active_id()  # a slider, say, is let go
            return True
        if toasts.close_newest(self.session, self.ui.toasts):
            return True
        if bank.timeline_of(self.session).is_open:
            bank.close_timeline(self.session)
            return True
        evidence = self.ui.scene.picture.evidence
        if evidence.decision is not None:
            evidence.decision = None
            return True
        return False

    def _dropped(self, dropped: list[Path]) -> None:
        if dropped:
            self._guard.call("Open", lambda: drop(self.session, dropped))

    def _may_close(self) -> bool:
        session = self.session
        if not session.should_quit and (session.unsaved or session.jobs.at_risk is not None):
            session.quit()  # asks; the answer closes the window
            return False
        return True

    # --- the picture

    def _render(self, camera: Camera) -> int:
        """The finished picture's texture; drawn again only when something in it changed."""
        if self.viewport is None:
            return 0
        if self.window.keys_wait and self.viewport.texture:
            return self.viewport.texture  # what was typed comes first
        session = self.session
        self.viewport.use_tree(level_of_detail.tree_of(session))
        n_splats = self.viewport.n_in_picture(session.shown, session.view)
        view = self._pacing.view_for(session.view, self._motion(camera), n_splats)
        if cleanup.shown(session) is not None or add_scene.shown(session) is not None:
            view = replace(view, mode=Mode.COLOR)  # the preview has colors of its own
        if session.document is not None and session.document.waiting:
            view = replace(view, show_outline=False)  # which would cover what the preview shows
        view = replace(view, background=background_of(session))
        self._view = view
        view = split_view.right_view(session, view)
        before, start = self.viewport.n_draws, time.perf_counter()
        frame_s = _PART_S if self.viewport.is_software else 0.0
        texture = self.viewport.draw(
            session.shown,
            camera,
            view,
            self._overlays(),
            frame_s=frame_s,
            is_draft=self._pacing.is_draft or session.live is not None,
        )
        if self.viewport.lod_error is not None:
            level_of_detail.failed(session, self.viewport.lod_error)
        if self.viewport.n_draws != before and self._ctx is not None:
            self._ctx.finish()  # so that the time is the picture's, not the queue's
            whole_s = self.viewport.slices.seconds if frame_s else time.perf_counter() - start
            self._pacing.drew(whole_s * 1000)
        return texture

    def _mode_drawn(self) -> Mode:
        return self.session.view.mode if self.viewport is None else self.viewport.mode

    def _render_left(self, camera: Camera) -> int:
        """The left side of a split view; 0 when it is no drawing of splats."""
        found = split_view.left_drawn(self.session, self._view)
        if found is None or self._ctx is None:
            return 0
        if self.left is None:
            self.left = Viewport(self._ctx)
        self._shows_left = True
        scene, view, labels = found
        camera = split_view.camera_in(scene, self.session.need().scene, camera)
        self.left.use_tree(level_of_detail.tree_of(self.session))
        scale = imgui.get_io().display_framebuffer_scale.x
        return self.left.draw(
            scene,
            camera,
            view,
            Overlays(
                labels=labels,
                muted=self.session.muted_colors(),
                focused_group=self.session.focus if view.mode is Mode.MASK else 0,
                pixel_scale=scale,
            ),
            frame_s=_PART_S if self.left.is_software else 0.0,
            is_draft=self._pacing.is_draft,
        )

    def _release_left(self) -> None:
        if self.left is not None:
            self.left.release()
            self.left = None

    def _paint(self, camera: Camera, view: ViewState) -> UInt8Array:
        """A picture for a film or a file, at full quality."""
        if self.viewport is None:
            return np.zeros((camera.height, camera.width, 3), np.uint8)
        focus = self.session.focus if view.mode is Mode.MASK else 0
        overlays = Overlays(focused_group=focus)
        self.viewport.draw(self.session.scene, camera, view, overlays, wait=True)
        return self.viewport.read_pixels()

    def _motion(self, camera: Camera) -> tuple[object, ...]:
        """What changes from frame to frame while the camera moves or an object is dragged."""
        session = self.session
        pose = (camera.cam_from_world.tobytes(), camera.K.tobytes())
        if not session.is_previewing or session.scene is None:
            return pose
        now = session.scene.revision
        return (*pose, now.splats, now.state, now.placement, now.placements)

    def _overlays(self) -> Overlays:
        session = self.session
        decision = self.ui.scene.picture.evidence.decision
        return Overlays(
            cameras=session.cameras if session.view.show_frusta else (),
            active_camera=split_view.photo_in_view(session),
            labels=session.live_labels if session.live else bank.timeline_labels(session),
            tint=bank.mask_tint(session, decision),
            muted=session.muted_colors(),
            hovered_group=session.hovered_group,
            focused_group=session.focus if session.view.mode is Mode.MASK else 0,
            pixel_scale=imgui.get_io().display_framebuffer_scale.x,
        )

    @property
    def is_settled(self) -> bool:
        """Whether the screen shows everything as it is: nothing runs, loads or moves."""
        return self.session.jobs.running is None and not self._is_moving()

    def _is_moving(self) -> bool:
        is_drawn = self.viewport is None or (self.viewport.settled and self._pacing.is_settled)
        is_drawn &= self.left is None or not self._shows_left or self.left.settled
        is_loading = self.images is not None and self.images.loading
        is_driven = self.session.rig.is_moving or self.picture.is_busy
        is_driven |= bank.timeline_of(self.session).is_playing
        is_driven |= self.session.view.playback.is_playing or self.session.view.holds_photo
        is_driven |= (
            self.session.render_requests is not None and self.session.render_requests.is_wanted
        )
        return is_driven or is_loading or not is_drawn

    def _frame_rate(self) -> float:
        """Wanted frames a second at rest; 0 while something on the screen moves."""
        is_opening = self.ui.in_front is not None
        if self.never_idle or is_opening or self._is_moving() or self._has_new_letters:
            return 0.0
        if self.session.jobs.running is not None:
            return _JOB_RATE_SOFTWARE if self._pacing.is_software else _JOB_RATE
        passes = self.ui.toasts.are_passing or self.session.hint
        return _JOB_RATE if passes else _REST_RATE


def _backend(ctx: moderngl.Context) -> str:
    """ "llvmpipe, OpenGL 4.5": who draws the picture, short enough for the status bar."""
    renderer = str(ctx.info["GL_RENDERER"]).split("(")[0].split("/")[0].strip()
    major, minor = divmod(ctx.version_code // 10, 10)
    return f"{renderer}, OpenGL {major}.{minor}"
