"""The picture of the scene: mouse and keys over it, handles, and what to do while it is empty."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from imgui_bundle import ImVec2, ImVec4, imgui

from gaga_core.camera import Camera
from gaga_core.errors import counted
from gaga_studio.features import add_scene, cleanup, commands, fill, objects
from gaga_studio.features import measure as align_ground
from gaga_studio.features.find import association
from gaga_studio.session.session import Session
from gaga_studio.session.view import CentreColors, Mode, ToolName
from gaga_studio.system import paths
from gaga_studio.system.key_queue import events_of
from gaga_studio.tools.base import RectShape
from gaga_studio.tools.controller import ToolController
from gaga_studio.tools.gestures import KeyState, PointerState
from gaga_studio.tools.move import FollowTransform
from gaga_studio.ui.chrome import command_buttons, toolbar
from gaga_studio.ui.kit import icons, textures, theme, widgets
from gaga_studio.ui.kit.modal import begin_part
from gaga_studio.ui.kit.picture_area import PictureArea
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face
from gaga_studio.ui.viewport import gizmo, mask_evidence, overlays, photo_compare, training
from gaga_studio.ui.viewport.gizmo import Gizmo, ViewCube
from gaga_studio.ui.viewport.mask_evidence import EvidenceState
from gaga_studio.ui.viewport.overlays import MeasureState

# --- The keys that fly: held since a press that meant to fly.

_ANY_POPUP = imgui.PopupFlags_.any_popup_id | imgui.PopupFlags_.any_popup_level


class FlyKeys:
    """Follows W A S D Q E by their place, from frame to frame.

    A key flies from its press on, if that was no shortcut and no typed letter: who lets go of Ctrl
    before the S of Ctrl+S does not fly backwards.
    """

    def __init__(self, letters: Callable[[], dict[str, str]]) -> None:
        self._find_letters = letters  # place of each key -> the letter that it types here
        self._letters: dict[str, str] = {}
        self._held: set[str] = set()
        self.are_new = False  # the first of them went down in this frame

    def held(self, *, is_flying: bool) -> frozenset[str]:
        """The places of the keys that fly now; ``is_flying``: Shift+D is no shortcut then."""
        if not self._letters:
            self._letters = self._find_letters()
        keys = {place: getattr(imgui.Key, name.lower()) for place, name in self._letters.items()}
        before = set(self._held)
        self._held = {place for place in before if imgui.is_key_down(keys[place])}
        io = imgui.get_io()
        if io.want_text_input or imgui.is_popup_open("", _ANY_POPUP):
            self._held.clear()
        elif not io.key_ctrl:
            went_down = {p for p, key in keys.items() if imgui.is_key_pressed(key, False)}
            if io.key_shift and not is_flying and not self._held:
                went_down.discard("D")
            self._held |= went_down
        self.are_new = bool(self._held) and not before
        return frozenset(self._held)


@dataclass
class PictureState:
    """Draw what is over the picture of a scene."""

    evidence: EvidenceState = field(default_factory=EvidenceState)
    is_offer_closed: bool = False  # of the next stage
    measure: MeasureState = field(default_factory=MeasureState)
    compared: dict[str, float] = field(default_factory=dict)  # errors of photos, 0..1, by key


# --- The one stage that the open scene lacks next, as one button on the picture.

_LOW_AREA = 14.0  # em: over a lower picture a card is a button, and one other way at most


def _draw_next_stage(session: Session, state: PictureState, area: PictureArea) -> None:
    """A card at the foot of the picture; nothing when nothing is missing or it was closed.

    What lacks a button to run is said until objects are made by hand.
    """
    offer = association.stage_offer(session)
    area.offer_top = float("inf")
    document = session.document
    if offer is None or document is None or state.is_offer_closed:
        return
    is_preview = any(one.shown(session) is not None for one in (cleanup, fill, add_scene))
    if is_preview or session.tool is ToolName.MEASURE:
        return  # it would cover what is to be looked at, or lengths
    is_low = area.height < em(_LOW_AREA)
    if not offer.command and (is_low or session.tool is ToolName.OBJECT):
        return  # it only advises: what is being done, or all over a low picture
    width = min(em(34), area.width - em(2))
    if width < em(12):
        return
    at = ImVec2(area.left + (area.width - width) / 2, area.bottom - em(1))
    imgui.set_next_window_pos(at, imgui.Cond_.always, ImVec2(0, 1))
    widgets.card("Offer", width, lambda: _content(session, state, offer, width, is_low=is_low))
    area.offer_top = imgui.get_item_rect_min().y


def _content(
    session: Session,
    state: PictureState,
    offer: association.StageOffer,
    width: float,
    *,
    is_low: bool,
) -> None:
    padding, pad = 2 * imgui.get_style().frame_padding.x, imgui.get_style().window_padding.x
    inside = width - 2 * pad - padding - (em(1.6) if is_low else 0)  # of the cross
    texts = (offer.label, offer.short_label, offer.action)
    fitting = (t for t in texts if imgui.calc_text_size(f"{icons.RUN}  {t}").x <= inside)
    first = Face(next(fitting, offer.action), icons.RUN, primary=True)
    buttons = [(offer.command, offer.action, first)] if offer.command else []
    for text, command in offer.more[-1:] if is_low else offer.more:
        shown = text or commands.command(command).title_now(session)
        buttons.append((command, shown.rstrip("…"), Face(widgets.elided(shown, inside))))
    widths = [
        imgui.calc_text_size(f"{face.icon}  {face.text}" if face.icon else face.text).x + padding
        for _, _, face in buttons
    ]
    used = sum(widths) + em(0.4) * len(widths)
    room = width - em(3.5)  # left of the cross
    is_wide = room - used > em(9) or not buttons
    if not is_low:
        reason = room - (used + em(0.4) if is_wide and buttons else 0)
        imgui.push_text_wrap_pos(imgui.get_cursor_pos_x() + reason)
        imgui.align_text_to_frame_padding()
        widgets.paragraph(offer.reason)
        imgui.pop_text_wrap_pos()
        imgui.same_line()
    begin = imgui.get_cursor_pos()
    imgui.set_cursor_pos_x(width - em(2.3))
    if widgets.icon_button("Not now", icons.CLOSE):
        state.is_offer_closed = True
    if is_low:
        imgui.set_cursor_pos(begin)
    elif is_wide and buttons:
        imgui.same_line(width - em(2.6) - used)
    for at, (command, name, face) in enumerate(buttons):
        if at and is_wide:
            imgui.same_line(0, em(0.4))
        elif at:
            widgets.next_to(face.text, em(0.4))
        command_buttons.command_button(session, command, name, face)


# --- The start page while nothing is open: four ways to begin, and recent scenes.

_CHOICES = (
    ("file.open_photos", icons.CAMERA, "Start from photos or a film", "They become a scene here"),
    ("file.open_folder", icons.FOLDER, "Open a scene folder", "Photos, cameras, splats, masks"),
    ("file.open_file", icons.FILE, "Open a splat file", "PLY, SPZ, SOG, .splat, project"),
    ("file.demo", icons.DEMO, "Try the demo", "A furnished room, ready to edit"),
)
_MOST_RECENT, _NAMES_IN_SIGHT = 5, 2  # without scrolling, where there is no room for pictures
_TILE = 7.2, 3.8  # width and height of the picture of a recent scene, em
_HEAD = 2.0  # of the words over cards in a low window, em
_LOW_CARD = 3.2  # without room for the second line, em
_LEAST_CARD = 1.5  # with room for its title, em
_CARD_EDGE = 12.0  # of a card that no text comes near, both sides together, pixels at 96 dpi


def _draw_welcome(session: Session, steps_height: float) -> None:
    """Four large choices in the middle; below them what was open lately."""
    room = imgui.get_content_region_avail()
    room.y -= steps_height
    corner = imgui.get_cursor_screen_pos()
    if session.jobs.running is not None:
        _opening(session, room)
        return
    n, recent = len(_CHOICES), session.settings.recent[:_MOST_RECENT]
    line = imgui.get_text_line_height_with_spacing()
    card = ImVec2(min(em(14.5), (room.x - em(5)) / n), em(8.6))
    widest = max(imgui.calc_text_size(text).x for choice in _CHOICES for text in choice[2:])
    is_wide = widest <= card.x - theme.scaled(_CARD_EDGE)
    if not is_wide:
        # Titles alone where the window is too low for all of them.
        high = room.y - em(_HEAD) - line * min(len(recent), _NAMES_IN_SIGHT)
        high = high / n - imgui.get_style().item_spacing.y
        card = ImVec2(min(room.x - em(1.6), em(24)), min(em(3.5), max(high, em(_LEAST_CARD))))
    height = card.y + em(3.6) if is_wide else n * card.y + em(4.2)
    rows = em(_TILE[1] + 1.5 + 2)
    are_names = bool(recent) and room.y <= height + rows
    height += len(recent) * line if are_names else rows if recent else em(2)
    if are_names:  # no room for pictures, perhaps not even for all names
        begin_part("Start page", room)
    imgui.set_cursor_pos_y(imgui.get_cursor_pos_y() + max((room.y - height) * 0.45, em(0.2)))
    if not are_names or card.y > em(_LEAST_CARD):  # else the status bar says it, too
        with theme.face(strong=True, scale=1.35 if is_wide or card.y > em(_LOW_CARD) else 1.1):
            widgets.wrapped("Open a scene to begin", theme.TEXT)
        imgui.dummy(ImVec2(0, em(0.5) if is_wide or card.y > em(_LOW_CARD) else 0.0))
    left = (room.x - (n * card.x + (n - 1) * em(0.8) if is_wide else card.x)) / 2
    for position, (command, icon, title, detail) in enumerate(_CHOICES):
        if position == 0 or not is_wide:
            imgui.set_cursor_pos_x(left)
        if _card(title, icon, detail, card, is_wide):
            commands.run(command, session)
        if is_wide and position < n - 1:
            imgui.same_line(0, em(0.8))
    if are_names:
        _recent_names(session, recent, left, room.x - 2 * left)
        imgui.end_child()
        return
    imgui.dummy(ImVec2(0, em(0.3)))
    widgets.wrapped("or drop a folder or a file into the window", theme.DIM)
    if recent:
        _recent(session, recent, corner.x + left, room.x - 2 * left)


def _card(title: str, icon: str, detail: str, size: ImVec2, is_wide: bool) -> bool:
    corner = imgui.get_cursor_screen_pos()
    clicked = imgui.invisible_button(title, size)
    is_hot = imgui.is_item_hovered()
    drawing = imgui.get_window_draw_list()
    high = ImVec2(corner.x + size.x, corner.y + size.y)
    drawing.add_rect_filled(corner, high, theme.u32(theme.HOT if is_hot else theme.RAISED), em(0.5))
    edge = theme.ACCENT if is_hot else theme.LINE_STRONG
    drawing.add_rect(corner, high, theme.u32(edge), em(0.5), theme.scaled(1))
    if is_wide:
        with theme.face(scale=2.1):
            extent = imgui.calc_text_size(icon)
            at = ImVec2(corner.x + (size.x - extent.x) / 2, corner.y + em(0.75))
            drawing.add_text(at, theme.u32(theme.ACCENT), icon)
        _text_centred(drawing, title, corner, size.x, em(5.1), strong=True)
        _text_centred(drawing, detail, corner, size.x, em(6.5), strong=False)
    else:
        is_low = size.y <= em(_LOW_CARD)
        left = corner.x + em(2.3 if is_low else 3.4)
        with theme.face(scale=1.0 if is_low else 1.4):
            top = corner.y + (size.y - imgui.get_font_size()) / 2
            drawing.add_text(ImVec2(corner.x + em(0.6), top), theme.u32(theme.ACCENT), icon)
        with theme.face(strong=True):
            shown = widgets.elided(title, high.x - left - em(0.2))
            top = corner.y + (size.y - imgui.get_font_size()) / 2 if is_low else corner.y + em(0.5)
            drawing.add_text(ImVec2(left, top), theme.u32(theme.TEXT), shown)
        if not is_low:
            shown = widgets.elided(detail, high.x - left - em(0.6))
            drawing.add_text(ImVec2(left, corner.y + em(1.85)), theme.u32(theme.DIM), shown)
    return clicked


def _text_centred(
    drawing: imgui.ImDrawList,
    text: str,
    corner: ImVec2,
    width: float,
    top: float,
    *,
    strong: bool,
) -> None:
    color: ImVec4 = theme.TEXT if strong else theme.DIM
    with theme.face(strong=strong):
        shown = widgets.elided(text, width - theme.scaled(_CARD_EDGE))
        extent = imgui.calc_text_size(shown)
        at = ImVec2(corner.x + (width - extent.x) / 2, corner.y + top)
        drawing.add_text(at, theme.u32(color), shown)


def _recent(session: Session, recent: tuple[str, ...], left: float, width: float) -> None:
    """What was open lately, as pictures in a row."""
    imgui.dummy(ImVec2(0, em(0.4)))
    imgui.set_cursor_screen_pos(ImVec2(left, imgui.get_cursor_screen_pos().y))
    with theme.face(strong=True), theme.text_color(theme.DIM):
        imgui.text_unformatted("Recent")
    gap, top = em(0.8), imgui.get_cursor_screen_pos().y
    n = max(int((width + gap) / (em(_TILE[0]) + gap)), 1)
    for position, name in enumerate(recent[:n]):
        at = ImVec2(left + position * (em(_TILE[0]) + gap), top)
        imgui.set_cursor_screen_pos(at)
        _tile(session, name, position, at)


def _recent_names(session: Session, recent: tuple[str, ...], left: float, width: float) -> None:
    """What was open lately, as a list of names that is scrolled to where the window is low."""
    for position, name in enumerate(recent):
        path = Path(name)
        icon = icons.FILE_PLAIN if path.suffix else icons.FOLDER_PLAIN
        shown = widgets.elided_name(path.name, width - em(1.8))
        imgui.set_cursor_pos_x(left)
        if imgui.selectable(f"{icon}  {shown}###Recent {position}", False, 0, ImVec2(width, 0))[0]:
            session.open(path)
        widgets.tooltip(name)


def _tile(session: Session, name: str, position: int, at: ImVec2) -> None:
    """The picture of a scene, or a sign where there is none, with its name below."""
    path, size = Path(name), ImVec2(em(_TILE[0]), em(_TILE[1]))
    if imgui.invisible_button(f"###Recent {position}", ImVec2(size.x, size.y + em(1.5))):
        session.open(path)
    is_hot = imgui.is_item_hovered()
    widgets.tooltip(name)
    file = paths.picture_of(name)
    texture = textures.photo_file(session, file) if file.is_file() else None
    drawing, high = imgui.get_window_draw_list(), ImVec2(at.x + size.x, at.y + size.y)
    drawing.add_rect_filled(at, high, theme.u32(theme.RAISED), em(0.3))
    if texture is not None:
        # The middle of the picture in the shape of the tile.
        share = texture[1] / texture[2] / (size.x / size.y)
        u, v = max(1 - 1 / share, 0) / 2, max(1 - share, 0) / 2
        picture = imgui.ImTextureRef(texture[0])
        drawing.add_image_rounded(
            picture, at, high, ImVec2(u, v), ImVec2(1 - u, 1 - v), 0xFFFFFFFF, em(0.3)
        )
    else:
        icon = icons.FILE_PLAIN if path.suffix else icons.FOLDER_PLAIN
        middle = ImVec2(at.x + (size.x - em(1)) / 2, at.y + (size.y - em(1)) / 2)
        drawing.add_text(middle, theme.u32(theme.DIM), icon)
    edge = theme.ACCENT if is_hot else theme.LINE_STRONG
    drawing.add_rect(at, high, theme.u32(edge), em(0.3), theme.scaled(1))
    shown = widgets.elided_name(path.name, size.x)
    drawing.add_text(ImVec2(at.x, high.y + em(0.2)), theme.u32(theme.TEXT), shown)


def _opening(session: Session, room: ImVec2) -> None:
    job = session.jobs.running
    if job is None:
        return
    imgui.set_cursor_pos_y(imgui.get_cursor_pos_y() + room.y * 0.4)
    with theme.face(strong=True, scale=1.2):
        widgets.wrapped(f"{job.title} …", theme.TEXT)
    if job.message:
        widgets.wrapped(job.message, theme.DIM)
    width = min(em(22), room.x * 0.7)
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + (room.x - width) / 2)
    fraction = job.fraction if job.fraction >= 0 else -imgui.get_time()
    imgui.progress_bar(fraction, ImVec2(width, em(0.35)), "")


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
    Mode.IDENTITY: "Identity encodings: similar colors were learned as one object",
    Mode.RINGS: "Rims of the splats",
}
_TAP_S = 0.05  # flight of a key that has just gone down: a slow frame before it was not its own
_FOLLOW_KEYS: dict[str, tuple[imgui.Key, ...]] = {
    **{name: (imgui.Key[name.lower()],) for name in "XYZ"},
    **{str(i): (imgui.Key[f"_{i}"], imgui.Key[f"keypad{i}"]) for i in range(10)},
    ".": (imgui.Key.period, imgui.Key.keypad_decimal),
    "-": (imgui.Key.minus, imgui.Key.keypad_subtract),
    "Backspace": (imgui.Key.backspace,),
}
Buttons = tuple[bool, bool, bool]  # left, right, middle: whether it is down
Render = Callable[[Camera], int]  # OpenGL name of the finished picture; 0 where there is none


@dataclass
class ViewportPanel:
    """Keeps the gesture that is under way between frames."""

    render: Render
    render_left: Render  # the left side of a split view, when it is drawn like the picture
    mode_drawn: Callable[[], Mode]  # whose colors the picture is in: a slow one follows later
    fly_keys: Callable[[], dict[str, str]]  # place of a fly key -> the letter that it types here

    def __post_init__(self) -> None:
        self.controller = ToolController()
        self.gizmo = Gizmo()
        self.cube = ViewCube()
        self._fly_keys = FlyKeys(self.fly_keys)
        self._is_flying = False
        self._held: Buttons = (False, False, False)
        self._follow: FollowTransform | None = None
        self._shown: object = None  # what it was shown for
        self._is_ignored = False  # the button that ended it is still down
        self._on_handle = False  # the mouse is over the move handles, or drags one

    def draw(self, session: Session, state: PictureState, area: PictureArea) -> None:
        """The whole panel."""
        corner, size = imgui.get_cursor_screen_pos(), imgui.get_content_region_avail()
        if size.x < 8 or size.y < 8:
            return
        area.left, area.top, area.width, area.height = corner.x, corner.y, size.x, size.y
        area.cube_height = gizmo.height(session, size)
        area.options = None
        if session.shown is None:
            if session.photos is not None and session.jobs.running is None:
                training.draw_photos(session)
            else:
                _draw_welcome(session, area.steps_height)
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
        shape = self.controller.overlay
        if isinstance(shape, RectShape):
            overlays.rectangle(shape, corner, density)
        elif shape is not None:
            overlays.path(shape, corner, density)
        overlays.source_mark(self.controller.clone_source(session), camera, corner)
        follows = is_over and not self._on_handle and not self.controller.is_dragging
        overlays.ground(session, camera, corner, follows=follows)
        overlays.waiting_clicks(session, camera, corner)
        overlays.box(session, camera, corner)
        overlays.parts(session, camera, corner)
        area.labels = overlays.draw_marks(session, camera, corner, follows=follows)
        _name_under_mouse(session, area, is_shown=follows and not self.gizmo.is_shown)
        _on_the_picture(session, state, area, self.mode_drawn())

    @property
    def is_busy(self) -> bool:
        """Whether a drag or a fly key keeps the picture moving."""
        return self.controller.is_dragging or self._is_flying or self.cube.is_dragging

    @property
    def is_following(self) -> bool:
        """Whether a transform follows the mouse: it has all keys until it ends."""
        return self._follow is not None

    @property
    def follow_hint(self) -> str:
        """What the transform that follows the mouse does, and what ends it; "" without one."""
        return "" if self._follow is None else self._follow.hint

    def follow(self, session: Session, area: PictureArea) -> None:
        """Let the selection follow the mouse, as the tool says; nothing without a selection."""
        session.cancel_preview()
        tool = self.controller.move_tools.get(session.tool)
        handles = tool.handles(session) if tool is not None else None
        if tool is None or handles is None or session.need().waiting:
            return
        io = imgui.get_io()
        scale = io.display_framebuffer_scale
        at = (io.mouse_pos.x - area.left) * scale.x, (io.mouse_pos.y - area.top) * scale.y
        self._follow = FollowTransform(tool.name, at, handles)

    def _go_on(self, session: Session, pointer: PointerState) -> bool:
        """One frame of what follows the mouse; whether it has the mouse."""
        pressed = pointer.left or pointer.right or pointer.middle
        self._is_ignored &= pressed
        if self._follow is None:
            return self._is_ignored
        if session.tool is not self._follow.name or session.document is None:
            session.cancel_preview()
            self._follow = None
            return False
        for name, keys in _FOLLOW_KEYS.items():
            if any(imgui.is_key_pressed(key, False) for key in keys):
                self._follow = self._follow.with_key(name)
        camera = session.rig.camera(pointer.width, pointer.height)
        shown = self._follow, pointer.u, pointer.v, session.rig.pose
        if shown != self._shown:  # else the picture would never be at rest
            self._shown, follow, self._follow = shown, self._follow, None
            follow.show(session, camera, (pointer.u, pointer.v))
            self._follow = follow  # unless that failed: nothing would end it
        is_cancelled = imgui.is_key_pressed(imgui.Key.escape, False) or pointer.right
        io = imgui.get_io()
        is_plain = io.key_ctrl and not (io.key_shift or io.key_alt)
        saves = is_plain and imgui.is_key_pressed(imgui.Key.s, False)
        if is_cancelled or pointer.left or saves or widgets.enter_pressed():
            session.cancel_preview() if is_cancelled else session.commit_preview()
            self._follow, self._is_ignored = None, pressed
        if saves:  # all else that keys mean waits for its end
            commands.run("file.save", session)
        return True

    def cancel(self, session: Session) -> bool:
        """Escape: end the gesture without an edit; whether there was one."""
        self.gizmo.cancel()
        return self.controller.cancel(session)

    def _handles(self, session: Session, camera: Camera, corner: ImVec2, size: ImVec2) -> bool:
        tool = self.controller.move_tools.get(session.tool)
        if tool is None or session.document is None or session.document.waiting or self._follow:
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
        if self._go_on(session, pointer):
            return
        held = self._fly_keys.held(is_flying=session.rig.is_flying)
        keys = KeyState(io.key_shift, io.key_ctrl, io.key_alt, held)
        if session.settings.keys == "blender" and not session.rig.is_flying:
            keys = replace(keys, held=frozenset())  # letters are shortcuts there
        self._is_flying = bool(keys.held)
        dt = min(io.delta_time, _TAP_S) if self._fly_keys.are_new else io.delta_time
        way = _way(self._held, pointer, corner, density)
        self._held = pointer.left, pointer.right, pointer.middle
        self.controller.update(session, pointer, keys, dt, way)


def _way(held: Buttons, now: PointerState, corner: ImVec2, density: ImVec2) -> list[PointerState]:
    """Where the mouse was between the last frame and ``now`` with the buttons ``held``, in order.

    A frame has at most one change of a button, at its end (`KeyQueue`).
    """
    if not any(held):
        return []
    events = events_of(imgui.get_current_context().input_events_trail)
    left, right, middle = held
    then = replace(now, left=left, right=right, middle=middle, wheel=0.0, is_double=False)
    places = [event.at for event in events if event.type == imgui.internal.InputEventType.mouse_pos]
    return [
        replace(then, u=(x - corner.x) * density.x, v=(y - corner.y) * density.y) for x, y in places
    ]


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


_HOVER_SHARE = 0.4  # of the picture's width, at most, of the card of the object under the mouse
_LEAST_NAME = 5.0  # em of its name, next to which there is room for how many splats it has


def _name_under_mouse(session: Session, area: PictureArea, *, is_shown: bool) -> None:
    """A card at the mouse, in the picture alone: next to it are panels and their buttons.

    Not where there are handles to be taken, nor over a notice or a label; the status bar has the
    name as well.
    """
    group, document = session.hovered_group, session.document
    if not is_shown or not group or document is None:
        return
    table = session.objects()
    row = table.row(group)
    if row is None or table.n_hidden[row] == table.counts[row]:
        return
    pad, gap = imgui.get_style().window_padding, imgui.get_style().item_spacing.x
    dot, count = "●", counted(int(table.counts[row]), "splat")
    around = imgui.calc_text_size(dot).x + em(0.4) + 2 * pad.x
    of_count, most = gap + imgui.calc_text_size(count).x, area.width * _HOVER_SHARE
    if most - around - of_count < em(_LEAST_NAME):
        count, of_count = "", 0.0
    around += of_count
    name = widgets.few_lines(table.names[row], most - around)
    wide = max((imgui.calc_text_size(line).x for line in name), default=0.0)
    high = len(name) * imgui.get_text_line_height_with_spacing() - imgui.get_style().item_spacing.y
    size = ImVec2(around + wide, high + 2 * pad.y)
    mouse, foot = imgui.get_io().mouse_pos, min(area.bottom, area.offer_top)
    below, above = mouse.y + em(1), max(mouse.y - em(0.5) - size.y, area.top)
    places = (
        (max(min(x, area.left + area.width - size.x), area.left), y)
        for x in (mouse.x + em(1), mouse.x - em(1) - size.x)
        for y in ((below, above) if below + size.y <= foot else (above,))
    )
    place = next(
        ((x, y) for x, y in places if not area.has_words_in((x, y, x + size.x, y + size.y))), None
    )
    if place is None:
        return
    imgui.set_next_window_pos(ImVec2(*place))
    if imgui.begin_tooltip():
        widgets.text(dot, widgets.rgba(table.colors[row]))
        imgui.same_line(0, em(0.4))
        imgui.begin_group()
        for line in name:
            imgui.text_unformatted(line)
        imgui.end_group()
        if count:
            imgui.same_line()
            widgets.dim(count)
        imgui.end_tooltip()


def _on_the_picture(session: Session, state: PictureState, area: PictureArea, mode: Mode) -> None:
    """Draw over the picture: the offer of the next stage, a compared photo, a mark."""
    bar = photo_compare.bar_height(session)
    corner, size = ImVec2(area.left, area.top + bar), ImVec2(area.width, area.height - bar)
    top, ends, badge = corner.y + em(0.7), corner.y, ""
    room = size.x - gizmo.height(session, size)  # the view cube, as wide, stands at the right
    if preview_badge(session):
        top = _badge(preview_badge(session), corner, room)
        if not area.has_inspector:
            top = ends = _ends_of_preview(session, corner.x, top)
    elif session.tool is ToolName.GROUND and session.document is not None:
        prompt = align_ground.ground_prompt(session)
        top = _badge(prompt, corner, room, align_ground.GROUND_HELP)
    elif mode is not Mode.COLOR and not bar and session.training is None:
        badge = mode_badge(session, mode)
    left_top = ImVec2(corner.x + em(0.7), top)
    area.options = overlays.draw_card(session, state.measure, left_top, size)
    if area.options is not None:
        top = area.options[3] + em(0.5)
    else:
        top = toolbar.draw_card(session, area, top)
    if badge:
        top = _badge(badge, ImVec2(corner.x, top - em(0.7)), room)
    area.head_bottom = top
    area.chip_bottom = max(_way_out_of_isolation(session, corner, size), ends)
    _draw_next_stage(session, state, area)
    end = training.draw_live(session, corner, size)
    area.live_right, area.live_bottom = end.x, end.y
    mask_evidence.draw(session, state.evidence, area)


def _way_out_of_isolation(session: Session, corner: ImVec2, size: ImVec2) -> float:
    """A button at the head of the picture while only a few objects are shown; its lower edge.

    In the middle of the picture while nothing is shown at all, unless that is low: notices stand
    below it.
    """
    names, is_empty = objects.isolated(session), objects.all_hidden(session)
    if not (names or is_empty) or session.is_previewing:
        return 0.0
    action = "Show all"
    said = ("Everything is hidden", "All is hidden") if is_empty else (f"Isolated: {names}", names)
    around = imgui.calc_text_size(f"  ·  {action}").x + em(1.4)
    room = size.x - around - 2 * (gizmo.height(session, size) or em(0.3))  # the cube is as wide
    text = widgets.elided(said[imgui.calc_text_size(said[0]).x > room], room)
    wide = imgui.calc_text_size(f"{text}  ·  {action}").x + em(1.4)
    top = size.y * 0.45 if is_empty and size.y > em(_LOW_AREA) else em(0.6)
    imgui.set_cursor_screen_pos(ImVec2(corner.x + (size.x - wide) / 2, corner.y + top))
    face = Face(f"{text}  ·  {action}", width=wide)
    if widgets.button(action, face, hint="Show what is hidden; hidden splats are not exported"):
        objects.show_all(session)
    return imgui.get_item_rect_max().y


def preview_badge(session: Session) -> str:
    """What is shown while it waits to be applied; "" while nothing does."""
    if fill.shown(session) is not None:
        return "Preview of Delete and fill"
    if add_scene.shown(session) is not None:
        return "Preview of Add a scene: the added one is orange"
    return "Preview of Clean up" if cleanup.shown(session) is not None else ""


def _ends_of_preview(session: Session, left: float, top: float) -> float:
    """Buttons that end a preview, from ``top``; what is free below.

    Those of the Inspector are not seen where another panel of a small window lies over it, or all
    are hidden.
    """
    imgui.set_cursor_screen_pos(ImVec2(left + em(0.7), top))
    if widgets.button("Apply", Face(primary=True), shortcut="Enter"):
        commands.run("edit.confirm", session)
    imgui.same_line()
    if widgets.button("Cancel", shortcut="Esc"):
        for one in (cleanup, fill, add_scene):
            one.cancel(session)
    return imgui.get_item_rect_max().y + em(0.5)


def mode_badge(session: Session, mode: Mode) -> str:
    """What the colors of the picture say, which is in ``mode``, when they are not its own."""
    if session.training is not None and mode in (Mode.GROUPS, Mode.MASK):
        return ""  # splats in training are in no group
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


def _badge(text: str, corner: ImVec2, room: float, more: str = "") -> float:
    """Says in a picture of width ``room`` that the colors are not its own, or what to click.

    Returns the y of what is free below.
    """
    pad, drawing = ImVec2(em(0.6), em(0.3)), imgui.get_window_draw_list()
    most = room - em(0.7) - 2 * pad.x
    size, font, font_size = ImVec2(0, 0), imgui.get_font(), imgui.get_font_size()
    lines = [(text, theme.TEXT), *([(more, theme.DIM)] if more else [])]
    for line, _ in lines:
        extent = imgui.calc_text_size(line, wrap_width=most)
        size = ImVec2(max(size.x, extent.x), size.y + extent.y)
    low = ImVec2(corner.x + em(0.7), corner.y + em(0.7))
    high = ImVec2(low.x + size.x + 2 * pad.x, low.y + size.y + 2 * pad.y)
    drawing.add_rect_filled(low, high, theme.u32(theme.BACK, 0.75), em(0.3))
    at = low.y + pad.y
    for line, color in lines:
        drawing.add_text(font, font_size, ImVec2(low.x + pad.x, at), theme.u32(color), line, most)
        at += imgui.calc_text_size(line, wrap_width=most).y
    return high.y + em(0.5)
