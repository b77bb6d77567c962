"""The picture of the scene: mouse and keys over it, handles, and what to do while it is empty."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from imgui_bundle import ImVec2, imgui

from gaga_core.camera import Camera
from gaga_studio.features import cleanup, fill, objects
from gaga_studio.features import measure as align_ground
from gaga_studio.session.session import Session
from gaga_studio.session.view import CentreColors, Mode, ToolName
from gaga_studio.tools.base import RectShape
from gaga_studio.tools.controller import ToolController
from gaga_studio.tools.gestures import KeyState, PointerState
from gaga_studio.ui.chrome import tool_options
from gaga_studio.ui.kit import theme, widgets
from gaga_studio.ui.kit.picture_area import PictureArea
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face
from gaga_studio.ui.viewport import (
    box_overlay,
    ground_overlay,
    mask_evidence,
    measure_overlay,
    next_stage,
    photo_compare,
    tool_overlay,
    training,
    view_cube,
    welcome,
)
from gaga_studio.ui.viewport.fly_keys import FlyKeys
from gaga_studio.ui.viewport.gizmo import Gizmo
from gaga_studio.ui.viewport.mask_evidence import EvidenceState
from gaga_studio.ui.viewport.measure_overlay import MeasureState
from gaga_studio.ui.viewport.next_stage import OfferState
from gaga_studio.ui.viewport.view_cube import ViewCube

_BUTTONS = (
    imgui.ButtonFlags_.mouse_button_left
    | imgui.ButtonFlags_.mouse_button_right
    | imgui.ButtonFlags_.mouse_button_middle
)
_BADGES = {
    Mode.GROUPS: "Group colors",
    Mode.DEPTH: "Depth: near is bright",
    Mode.CONFIDENCE: "Confidence: blue is sure, red is not; gray is in no group",
    Mode.CENTRES: "Centres of the splats",
    Mode.IDENTITY: "Identity encodings: what looks alike was learned to be one thing",
    Mode.RINGS: "Rims of the splats",
}
_TAP_S = 0.05  # flight of a key that has just gone down: a slow frame before it was not its own
Render = Callable[[Camera], int]  # OpenGL name of the finished picture; 0 where there is none


@dataclass
class PictureState:
    """What lies over the picture of a scene."""

    evidence: EvidenceState = field(default_factory=EvidenceState)
    offer: OfferState = field(default_factory=OfferState)
    measure: MeasureState = field(default_factory=MeasureState)
    compared: dict[str, float] = field(default_factory=dict)  # errors of photos, 0..1, by key


@dataclass
class ViewportPanel:
    """Keeps the gesture that is under way between frames."""

    render: Render
    render_left: Render  # the left side of a split view, when it is drawn like the picture
    fly_keys: Callable[[], dict[str, str]]  # place of a fly key -> the letter that it types here

    def __post_init__(self) -> None:
        self.controller = ToolController()
        self.gizmo = Gizmo()
        self.cube = ViewCube()
        self._fly_keys = FlyKeys(self.fly_keys)
        self._is_flying = False
        self._on_handle = False  # the mouse is over the move handles, or drags one

    def draw(self, session: Session, state: PictureState, area: PictureArea) -> None:
        """The whole panel."""
        corner, size = imgui.get_cursor_screen_pos(), imgui.get_content_region_avail()
        if size.x < 8 or size.y < 8:
            return
        area.left, area.top, area.width, area.height = corner.x, corner.y, size.x, size.y
        area.cube_height = view_cube.height(session, size)
        if session.shown is None:
            if session.photos is not None and session.jobs.running is None:
                training.draw_photos(session)
            else:
                welcome.draw(session, area.steps_height)
            return
        density = imgui.get_io().display_framebuffer_scale
        width = max(round(size.x * density.x), 1)
        height = max(round(size.y * density.y), 1)
        camera = session.rig.camera(width, height)
        picture = imgui.ImTextureRef(self.render(camera))
        imgui.image(picture, size, ImVec2(0, 1), ImVec2(1, 0))
        imgui.set_cursor_screen_pos(corner)
        is_over = _mouse_area(size, session.tool in self.controller.move_tools)
        self._on_handle = self._handles(session, camera, corner, size)
        self._on_handle |= photo_compare.draw(
            session, state.compared, corner, size, camera, self.render_left
        )
        self._on_handle |= self.cube.draw(session, corner, size)
        self._gestures(session, corner, (width, height), is_over)
        self._shapes(corner, density)
        tool_overlay.source_mark(self.controller.clone_source(session), camera, corner)
        follows = is_over and not self._on_handle and not self.controller.is_dragging
        ground_overlay.draw(session, camera, corner, follows=follows)
        box_overlay.draw(session, camera, corner)
        measure_overlay.draw_marks(session, camera, corner, follows=follows)
        _name_under_mouse(session, is_over and not self.controller.is_dragging)
        _on_the_picture(session, state, area)

    @property
    def is_busy(self) -> bool:
        """Whether a drag or a fly key keeps the picture moving."""
        return self.controller.is_dragging or self._is_flying or self.cube.is_dragging

    def cancel(self, session: Session) -> bool:
        """Escape: end the gesture without an edit; whether there was one."""
        self.gizmo.cancel()
        return self.controller.cancel(session)

    def _handles(self, session: Session, camera: Camera, corner: ImVec2, size: ImVec2) -> bool:
        tool = self.controller.move_tools.get(session.tool)
        if tool is None or session.document is None:
            self.gizmo.cancel()
            return False
        return self.gizmo.draw(session, tool, camera, corner, size)

    def _gestures(
        self,
        session: Session,
        corner: ImVec2,
        size: tuple[int, int],
        is_over: bool,
    ) -> None:
        io = imgui.get_io()
        density = io.display_framebuffer_scale
        pointer = PointerState(
            u=(io.mouse_pos.x - corner.x) * density.x,
            v=(io.mouse_pos.y - corner.y) * density.y,
            width=size[0],
            height=size[1],
            left=imgui.is_mouse_down(imgui.MouseButton_.left),
            right=imgui.is_mouse_down(imgui.MouseButton_.right),
            middle=imgui.is_mouse_down(imgui.MouseButton_.middle),
            wheel=io.mouse_wheel if is_over else 0.0,
            is_double=imgui.is_mouse_double_clicked(imgui.MouseButton_.left),
            is_over=is_over and not self._on_handle,
        )
        keys = self._key_state(session)
        if session.settings.keys == "blender" and not session.rig.is_flying:
            keys = replace(keys, held=frozenset())  # letters are shortcuts there
        self._is_flying = bool(keys.held)
        dt = min(io.delta_time, _TAP_S) if self._fly_keys.are_new else io.delta_time
        self.controller.update(session, pointer, keys, dt)

    def _key_state(self, session: Session) -> KeyState:
        io = imgui.get_io()
        held = self._fly_keys.held(is_flying=session.rig.is_flying)
        return KeyState(io.key_shift, io.key_ctrl, io.key_alt, held)

    def _shapes(self, corner: ImVec2, density: ImVec2) -> None:
        shape = self.controller.overlay
        if isinstance(shape, RectShape):
            tool_overlay.rectangle(shape, corner, density)
        elif shape is not None:
            tool_overlay.path(shape, corner, density)


def _mouse_area(size: ImVec2, has_handles: bool) -> bool:
    """Own the mouse over the picture; whether it is there.

    The library of the handles takes a click only where no item was hovered in the frame before:
    while there are handles the picture is no item.
    """
    if has_handles:
        imgui.dummy(size)
        return imgui.is_item_hovered()
    imgui.set_next_item_allow_overlap()
    imgui.invisible_button("##picture", size, _BUTTONS)
    if imgui.is_item_hovered():
        imgui.set_item_key_owner(imgui.Key.mouse_wheel_y)
    return imgui.is_item_hovered() or imgui.is_item_active()


def _name_under_mouse(session: Session, is_over: bool) -> None:
    group, document = session.hovered_group, session.document
    if not is_over or not group or document is None:
        return
    table = session.objects()
    row = table.row(group)
    if row is None or table.n_hidden[row] == table.counts[row]:
        return
    if imgui.begin_tooltip():
        color = widgets.rgba(table.colors[row])
        with theme.text_color(color):
            imgui.text_unformatted("●")
        imgui.same_line(0, em(0.4))
        imgui.text_unformatted(table.names[row])
        imgui.same_line()
        widgets.dim(f"{int(table.counts[row]):,} splats")
        imgui.end_tooltip()


def _on_the_picture(session: Session, state: PictureState, area: PictureArea) -> None:
    """What lies over the picture: the offer of the next stage, a compared photo, a mark."""
    bar = photo_compare.bar_height(session)
    corner, size = ImVec2(area.left, area.top + bar), ImVec2(area.width, area.height - bar)
    top = corner.y + em(0.7)
    if preview_badge(session):
        top = _badge(preview_badge(session), corner)
    elif session.tool is ToolName.GROUND and session.document is not None:
        top = _badge(
            align_ground.ground_prompt(session), corner, align_ground.GROUND_HELP, size.x - em(8)
        )
    elif session.view.mode is not Mode.COLOR and not bar:  # which names both sides
        top = _badge(mode_badge(session), corner)
    area.head_bottom = tool_options.draw_card(session, area, top)
    measure_overlay.draw_card(session, state.measure, corner, size)
    area.chip_bottom = _way_out_of_isolation(session, corner, size)
    next_stage.draw(session, state.offer, area)
    training.draw_live(session, corner, size)
    mask_evidence.draw(session, state.evidence, area)


def _way_out_of_isolation(session: Session, corner: ImVec2, size: ImVec2) -> float:
    """A button at the head of the picture while only a few objects are shown; its lower edge."""
    names = objects.isolated(session)
    if not names or session.is_previewing:
        return 0.0
    action = "Show all"
    text = widgets.elided(f"Isolated: {names}", size.x - em(18))
    wide = imgui.calc_text_size(f"{text}  ·  {action}").x + em(1.4)
    imgui.set_cursor_screen_pos(ImVec2(corner.x + (size.x - wide) / 2, corner.y + em(0.6)))
    face = Face(f"{text}  ·  {action}", width=wide)
    if widgets.button(action, face, hint="Show what is hidden; hidden splats are not exported"):
        objects.show_all(session)
    return imgui.get_item_rect_max().y


def preview_badge(session: Session) -> str:
    """What is shown while it waits to be applied; "" while nothing does."""
    if fill.shown(session) is not None:
        return "Preview of Delete and fill"
    return "Preview of Clean up" if cleanup.shown(session) is not None else ""


def mode_badge(session: Session) -> str:
    """What the colors of the picture say, when they are not the scene's own."""
    mode = session.view.mode
    if mode is Mode.CENTRES and session.view.centre_colors is not CentreColors.OWN:
        is_of_groups = session.view.centre_colors is CentreColors.GROUPS
        return f"Centres, in the colors of their {'groups' if is_of_groups else 'identities'}"
    if mode is Mode.GROUPS and session.colors_by_folder:
        return "Colors of the folders"
    if mode is Mode.MASK:
        name = session.document.name_of(session.focus) if session.document is not None else ""
        return f"Mask of {name}" if session.focus else "Mask: click an object"
    if mode is Mode.CONFIDENCE and (session.scene is None or session.scene.confidence is None):
        return "Confidence: not known"
    if mode is Mode.IDENTITY and (session.scene is None or session.scene.identities.colors is None):
        return "Identity encodings: none yet"
    return _BADGES[mode]


def _badge(text: str, corner: ImVec2, more: str = "", room: float = 0.0) -> float:
    """Says that the colors are not the scene's own, or what to click; ``more`` in ``room``.

    Returns the y of what is free below.
    """
    pad = ImVec2(em(0.6), em(0.3))
    extent = imgui.calc_text_size(text)
    wide = max(extent.x, room - 2 * pad.x)
    below = imgui.calc_text_size(more, wrap_width=wide) if more else ImVec2(0, 0)
    low = ImVec2(corner.x + em(0.7), corner.y + em(0.7))
    width, height = max(extent.x, below.x), extent.y + below.y
    high = ImVec2(low.x + width + 2 * pad.x, low.y + height + 2 * pad.y)
    drawing = imgui.get_window_draw_list()
    drawing.add_rect_filled(low, high, theme.u32(theme.BACK, 0.75), em(0.3))
    drawing.add_text(ImVec2(low.x + pad.x, low.y + pad.y), theme.u32(theme.TEXT), text)
    if more:
        at = ImVec2(low.x + pad.x, low.y + pad.y + extent.y)
        font, size = imgui.get_font(), imgui.get_font_size()
        drawing.add_text(font, size, at, theme.u32(theme.DIM), more, wide)
    return high.y + em(0.5)
