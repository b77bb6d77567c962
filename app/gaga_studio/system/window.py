"""The window itself: size, OpenGL context, docking layout, idling, dropped files.

It knows nothing of the scene: ``studio.py`` hands it functions. Apart from ``gpu/`` this is the
only module that speaks to GLFW.
"""

import ctypes
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import glfw
from imgui_bundle import ImVec2, ImVec4, glfw_utils, hello_imgui, imgui, immapp

from gaga_core.errors import GagaError, plain_text
from gaga_studio.system.key_queue import KeyQueue, correct_modifiers

# --- Docking of the panels: a wide, a compact and a low layout, sized for the text that they hold.
# Docks keep their pixels when the window grows; text does not when its scale changes. So each scale
# has layouts of its own, a compact one is made again where little is left of the picture, and a
# remembered layout in which there is no picture is forgotten.

Draw = Callable[[], None]
Split = tuple[str, str, imgui.Dir, float]
_Made = tuple[int, int, float]  # width, height, scale
_WIDE, _COMPACT, _LOW = "Wide", "Compact", "Low"
_MAIN, _BESIDE = "MainDockSpace", "Right"  # dock spaces: of the picture, next to it
# Columns of the wide layout, pixels at 96 dpi, and the most of the window that they take.
_RIGHT, _RIGHT_MOST, _LEFT, _LEFT_MOST = 345.0, 0.3, 310.0, 0.36
_BOTTOM, _BOTTOM_MOST, _BARS = 205.0, 0.32, 95.0  # its row at the foot; menu, tool and status bar
_SETTLED = 4  # frames after which a layout is built: it is neither left nor looked at before
_PICTURE_SHARE = 0.55  # of the width of a compact window that the picture has at least
_STACKED = (
    330.0  # pixels at 96 dpi: in a lower window two panels, one below the other, show no list
)
# In the settings file; the toolkit keeps size and place, of a maximized window the large one.
_MAXIMIZED, _YES, _FREE_SIZE = "Maximized", "yes", "Size while not maximized"
# Pixels at 96 dpi, width and height, in which every bar and every sheet works: half of the 800x500
# in which text of double size is tested. The smallest window holds them.
_ROOM = (400.0, 250.0)
_STEP = 0.25  # of a scale that the window bounds: each has layouts of its own
_LEAST = 80  # pixels: a remembered picture that is smaller is lost
_PICTURE = re.compile(r"\[Window\]\[Viewport\]\n(?:(?!\[).*\n)*?Size=(\d+),(\d+)")


def fitting_scale(wanted: float, size: tuple[float, float], dpi: float = 1.0) -> float:
    """The scale of text for a window of ``size`` pixels: ``wanted``, or less where bars and sheets
    would have no room. ``dpi``: the scale that the screen asks for."""
    most = min(side / room for side, room in zip(size, _ROOM, strict=True)) / dpi
    if most <= 0 or wanted <= most:  # 0: minimized
        return wanted
    return max(math.floor(most / _STEP), 1) * _STEP


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
    """The layouts of one window, and which of them is used."""

    panels: Sequence[Panel]
    dockable: Callable[[Panel, str], hello_imgui.DockableWindow]
    compact_below: tuple[int, int]  # pixels at 96 dpi
    _name: str = ""
    _scale: float = 0.0
    _made_for: dict[str, _Made] = field(default_factory=dict)  # by layout, until it is shown
    remembered: frozenset[str] = frozenset()  # layouts that a person has arranged
    _frames: int = field(default=0)  # since the layout or its scale changed
    _size: tuple[int, int] = (0, 0)  # of the window, in the frame before
    _is_shown: bool = True  # the panels, next to the picture
    _shown: Sequence[str] = ()  # panels that were in front, the one used last at the end
    _left: dict[str, Sequence[str]] = field(default_factory=dict)  # such panels, by layout

    def prepare(
        self, params: hello_imgui.RunnerParams, size: tuple[int, int], scale: float
    ) -> None:
        """Give all layouts to the runner, the one for a window of ``size`` first."""
        self._name = _named(self._wanted(size, scale), scale)
        names = [_named(name, scale) for name in (_WIDE, _COMPACT, _LOW)]
        layouts = [self._docking(name, size, scale) for name in names]
        self._made_for = dict.fromkeys(names, (*size, scale))
        if self._name not in self.remembered:
            self._shown = next(([p.label] for p in self.panels if not p.is_bare), [])
        layouts.sort(key=lambda docking: docking.layout_name != self._name)
        params.docking_params, *params.alternative_docking_layouts = layouts
        params.remember_selected_alternative_layout = False

    def fit(self, size: imgui.ImVec2, scale: float) -> None:
        """Bring the layout to a window of ``size`` pixels and text of ``scale``; every frame.

        Fewer columns when the window becomes small for its text, all of them when it becomes large.
        """
        if size.x <= 0 or size.y <= 0:  # minimized
            return
        self._frames += 1
        if self._frames == _SETTLED:
            # Where more panels share a place, some of them were behind others; here they are as
            # they were left.
            for name in (*self._shown, *self._left.get(self._name, ())):
                _bring_to_front(name)
            _take_keys_from_what_appeared(self._left.get(self._name, ()))
        if self._frames <= _SETTLED:
            return
        params = hello_imgui.get_runner_params()
        whole = (int(size.x), int(size.y))
        wanted, before = _named(self._wanted(whole, scale), scale), self._size
        self._size = whole
        if wanted != self._name:
            known = (params.docking_params, *params.alternative_docking_layouts)
            if all(docking.layout_name != wanted for docking in known):  # the first time
                new = self._docking(wanted, whole, scale)
                params.alternative_docking_layouts = [*params.alternative_docking_layouts, new]
            self._note_what_is_in_front()
            self._name, self._scale, self._frames = wanted, scale, 0
            hello_imgui.switch_layout(wanted)
            return
        docking = params.docking_params
        # Shares of a window that has another size by now would make panels of another width.
        made, now = self._made_for.pop(self._name, None), (*whole, scale)
        is_stale = made not in (None, now) and self._name not in self.remembered
        is_narrow = not wanted.startswith(_WIDE) and before != whole and _is_narrow(whole[0])
        if is_stale or is_narrow:
            self._note_what_is_in_front()
            self._made_for[self._name] = now
            docking.docking_splits = _splits(self._name, *whole, scale)
            docking.layout_reset = True
            self._frames = 0
        self._scale = scale

    def show(self, shown: bool, take_asked: Callable[[], str]) -> None:
        """Show the panels that have a place, or the picture alone; every frame. What was in front
        is so again when they come back, and then the panel that was asked for, if any."""
        if shown != self._is_shown:
            self._note_what_is_in_front()
            self._is_shown, self._frames = shown, 0
        asked = take_asked() if shown and self._frames > _SETTLED else ""
        if asked:
            imgui.set_window_focus(asked)
            _bring_to_front(asked)
        docking = hello_imgui.get_runner_params().docking_params
        for panel in self.panels:
            if not panel.is_bare:
                window = docking.dockable_window_of_name(panel.label)
                window.is_visible = shown and self._shows(panel)

    def _note_what_is_in_front(self) -> None:
        """For the next layout; the first one shows its first panel, whatever it replaces."""
        if self._is_shown and self._frames > 2 * _SETTLED:
            self._shown = self._left[self._name] = _in_front(self.panels)

    def _shows(self, panel: Panel) -> bool:
        """Whether the layout that is used has a place for ``panel`` now."""
        return self._name.startswith(_WIDE) or panel.is_wanted is None or panel.is_wanted()

    def _wanted(self, size: tuple[int, int], scale: float) -> str:
        narrow, low = (side * scale for side in self.compact_below)
        if size[0] >= narrow and size[1] >= low:
            return _WIDE
        return _COMPACT if size[1] >= _STACKED * scale else _LOW

    def _docking(self, name: str, size: tuple[int, int], scale: float) -> hello_imgui.DockingParams:
        docking = hello_imgui.DockingParams()
        docking.layout_name = name
        docking.docking_splits = _splits(name, *size, scale)
        docking.dockable_windows = [
            self.dockable(panel, _space(panel, name)) for panel in self.panels
        ]
        docking.main_dock_space_node_flags = imgui.DockNodeFlags_.none
        return docking


def _space(panel: Panel, name: str) -> str:
    """The dock space of ``panel`` in the layout ``name``."""
    if name.startswith(_WIDE):
        return panel.space
    return _BESIDE if name.startswith(_LOW) and not panel.is_bare else panel.compact_space


def _named(layout: str, scale: float) -> str:
    """The layout for text of ``scale``: each scale keeps its own."""
    return layout if scale == 1.0 else f"{layout} {scale:.2f}"


def _in_front(panels: Sequence[Panel]) -> tuple[str, ...]:
    """Titles of the panels whose tabs are chosen, the one used last at the end."""
    shown = [
        imgui.internal.find_window_by_name(panel.label)
        for panel in panels
        if is_in_front(panel.label)
    ]
    return tuple(window.name for window in sorted(shown, key=lambda window: window.focus_order))


def is_in_front(panel: str) -> bool:
    """Whether the panel of this title is seen."""
    window = imgui.internal.find_window_by_name(panel)
    return window is not None and window.active and not window.hidden


def _bring_to_front(panel: str) -> None:
    """Choose the tab of a panel; the keys stay where they are."""
    window = imgui.internal.find_window_by_name(panel)
    if window is not None and window.dock_node is not None and window.dock_node.tab_bar is not None:
        window.dock_node.tab_bar.next_selected_tab_id = window.tab_id


def _take_keys_from_what_appeared(left: Sequence[str]) -> None:
    """The panel used last has the keys: one that appears takes them, and its tab with them."""
    if left and not len(imgui.get_current_context().open_popup_stack):
        imgui.set_window_focus(left[-1])


def _is_narrow(width: int) -> bool:
    """Whether the picture has less than its share of ``width`` pixels."""
    picture = imgui.internal.find_window_by_name("Viewport")
    return picture is not None and picture.size.x < _PICTURE_SHARE * width


def put_panels_back() -> None:
    """Put every panel back to its place."""
    hello_imgui.get_runner_params().docking_params.layout_reset = True


def remembered(settings_file: Path | None) -> frozenset[str]:
    """Names of the layouts that the settings file holds as they were left."""
    try:
        text = "" if settings_file is None else settings_file.read_text("utf-8", "replace")
    except OSError:
        text = ""  # there is none yet
    return frozenset(re.findall(rf"_((?:{_WIDE}|{_COMPACT}|{_LOW})(?: [\d.]+)?)>>>", text))


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
    splits: list[Split] = [(_MAIN, _BESIDE, imgui.Dir.right, 0.43)]
    if name.startswith(_COMPACT):
        splits.append((_BESIDE, "RightBottom", imgui.Dir.down, 0.53))
    elif name.startswith(_WIDE):
        right = min(_RIGHT / width, _RIGHT_MOST)
        left = min(_LEFT / (width * (1 - right)), _LEFT_MOST)
        bottom = min(_BOTTOM / max(height - _BARS, 1.0), _BOTTOM_MOST)
        splits = [
            (_MAIN, _BESIDE, imgui.Dir.right, right),
            (_BESIDE, "RightDown", imgui.Dir.down, 0.36),
            (_MAIN, "Bottom", imgui.Dir.down, bottom),
            (_MAIN, "Left", imgui.Dir.left, left),
        ]
    return [hello_imgui.DockingSplit(*split) for split in splits]


@dataclass(frozen=True)
class Hooks:
    """What the window calls, and when."""

    started: Draw  # once, when the OpenGL context is there
    ending: Draw  # once, while it is still there
    fonts: Draw
    style: Draw
    before_frame: Draw
    keys: Draw  # before the panels, which may close the popup that a key was for
    menu: Draw
    tool_bar: Draw
    status: Draw
    overlay: Draw  # dialogs and notices, after the panels
    dropped: Callable[[list[Path]], None]
    may_close: Callable[[], bool]  # False keeps the window open
    frame_rate: Callable[[], float]  # wanted frames a second at rest; 0 = as fast as the screen
    panels_shown: Callable[[], bool]  # False: the picture alone
    is_opening: Callable[[], bool]  # what a key asked for waits for its panel
    take_asked_panel: Callable[[], str]  # panel that is to come to the front, once; "" = none


@dataclass(frozen=True)
class WindowOptions:
    """How the window comes up."""

    title: str = "gaga-studio"
    size: tuple[int, int] = (1440, 900)  # at 96 dpi
    settings_file: Path | None = None  # None: no layout is remembered (tests)
    compact_below: tuple[int, int] = (1100, 640)  # smaller windows start with the compact layout
    ui_scale: float = 1.0  # of text, times what the screen asks for


@dataclass
class Window:
    """One window, from ``run`` to its end."""

    hooks: Hooks
    panels: Sequence[Panel]
    options: WindowOptions = field(default_factory=WindowOptions)
    _layout: Layout = field(init=False)
    _title: str = ""
    _key_queue: KeyQueue = field(default_factory=KeyQueue)
    _size: tuple[int, int] = (0, 0)  # in the frame before
    _free_size: tuple[int, int] | None = None  # the last one while it was not maximized
    _callbacks_of_glfw: tuple[object, ...] = ()  # GLFW keeps no reference to them: we must

    def __post_init__(self) -> None:
        self._layout = Layout(self.panels, _dockable, self.options.compact_below)

    def params(self) -> hello_imgui.RunnerParams:
        """Everything that the runner wants to know, ready for ``run`` or for the test engine."""
        p = hello_imgui.RunnerParams()
        p.platform_backend_type = hello_imgui.PlatformBackendType.glfw
        p.renderer_backend_type = hello_imgui.RendererBackendType.open_gl3
        p.renderer_backend_options.open_gl_options = _open_gl()
        p.app_window_params.window_title = self.options.title
        p.app_window_params.window_geometry.size = self.options.size
        _settings(p, self.options.settings_file)
        self._layout.remembered = remembered(self.options.settings_file)
        _frame(p)
        p.fps_idling.time_active_after_last_event = 1.0
        self._callbacks(p.callbacks)
        scale = fitting_scale(self.options.ui_scale, self.options.size)
        self._layout.prepare(p, self.options.size, scale)
        return p

    def run(self) -> None:
        """Open the window and stay until it is closed.

        Raises ``GagaError`` when this machine cannot open it.
        """
        params = self.params()
        try:
            immapp.run(params, immapp.AddOnsParams())
        except RuntimeError as error:
            sentence = _opening_problem(str(error))
            if not sentence:
                raise
            raise GagaError(sentence) from error

    @property
    def keys_wait(self) -> bool:
        """Whether keys that were typed wait for the next frames, which should come soon."""
        return self._key_queue.is_behind

    def set_title(self, title: str) -> None:
        """Show ``title`` in the title bar."""
        title = plain_text(title)
        if title != self._title:
            self._title = title
            glfw.set_window_title(glfw_utils.glfw_window_hello_imgui(), title)

    def close(self) -> None:
        """End the program after this frame."""
        hello_imgui.get_runner_params().app_shall_exit = True

    def _callbacks(self, callbacks: hello_imgui.RunnerCallbacks) -> None:
        hooks = self.hooks
        callbacks.load_additional_fonts = hooks.fonts
        callbacks.setup_imgui_style = hooks.style
        callbacks.setup_imgui_config = _imgui_config
        callbacks.post_init = self._started
        callbacks.before_exit = self._ending
        callbacks.pre_new_frame = self._before_frame
        callbacks.show_gui = self._keys
        callbacks.show_menus = hooks.menu
        callbacks.show_status = hooks.status
        callbacks.post_render_dockable_windows = self._after_panels
        callbacks.confirm_exit = hooks.may_close
        bar = hello_imgui.EdgeToolbarOptions()
        bar.size_em = 2.55
        bar.window_padding_em = ImVec2(0.55, 0.4)
        bar.window_bg = ImVec4(
            0.0, 0.0, 0.0, 0.0
        )  # `ui.chrome.toolbar` paints it in the theme's color
        callbacks.add_edge_toolbar(hello_imgui.EdgeToolbarType.top, hooks.tool_bar, bar)

    def _started(self) -> None:
        handle = glfw_utils.glfw_window_hello_imgui()

        def dropped(_: _Handle, names: list[str]) -> None:
            self.hooks.dropped([Path(name) for name in names])

        place: list[tuple[float, float]] = []  # of the mouse, as GLFW said it last

        def moved(window: _Handle, x: float, y: float) -> None:
            place[:] = [(x, y)]
            imgui.backends.glfw_cursor_pos_callback(_address(window), x, y)

        def entered(window: _Handle, is_inside: int) -> None:
            # GLFW does not report the same position twice. Dear ImGui reads another one while the
            # mouse is outside, so a click where the mouse comes back would be taken for elsewhere.
            imgui.backends.glfw_cursor_enter_callback(_address(window), is_inside)
            if is_inside and place:
                imgui.backends.glfw_cursor_pos_callback(_address(window), *place[0])

        self._callbacks_of_glfw = dropped, moved, entered, _on_key, _on_button
        glfw.set_drop_callback(handle, dropped)  # type: ignore[arg-type]  # names: a list
        glfw.set_key_callback(handle, _on_key)
        glfw.set_mouse_button_callback(handle, _on_button)
        glfw.set_cursor_pos_callback(handle, moved)
        glfw.set_cursor_enter_callback(handle, entered)
        glfw.set_window_size_limits(handle, 480, 320, glfw.DONT_CARE, glfw.DONT_CARE)
        if self._remembers and hello_imgui.load_user_pref(_MAXIMIZED) == _YES:
            free = re.fullmatch(r"(\d+) (\d+)", hello_imgui.load_user_pref(_FREE_SIZE))
            if free is not None:  # what it goes back to
                glfw.set_window_size(handle, int(free[1]), int(free[2]))
            glfw.maximize_window(handle)
        self.hooks.started()

    def _ending(self) -> None:
        if self._remembers:
            handle = glfw_utils.glfw_window_hello_imgui()
            is_maximized = glfw.get_window_attrib(handle, glfw.MAXIMIZED)
            hello_imgui.save_user_pref(_MAXIMIZED, _YES if is_maximized else "no")
            if self._free_size is not None:
                hello_imgui.save_user_pref(_FREE_SIZE, "{} {}".format(*self._free_size))
        self.hooks.ending()

    @property
    def _remembers(self) -> bool:
        return self.options.settings_file is not None

    def _keys(self) -> None:
        self._key_queue.after_new_frame()
        self.hooks.keys()

    def _before_frame(self) -> None:
        self._key_queue.before_frame(opens=self.hooks.is_opening())
        self._note_size()
        _walk_with_keys()
        rate = 0.0 if self.keys_wait else self.hooks.frame_rate()
        idling = hello_imgui.get_runner_params().fps_idling
        idling.enable_idling = rate > 0
        idling.fps_idle = max(rate, 1.0)
        style = imgui.get_style()
        scale = style.font_scale_dpi * style.font_scale_main  # large text needs a large window
        self._layout.fit(imgui.get_io().display_size, scale)
        self._layout.show(self.hooks.panels_shown(), self.hooks.take_asked_panel)
        self.hooks.before_frame()

    def _after_panels(self) -> None:
        self.hooks.overlay()
        _take_the_whole_number()

    def _note_size(self) -> None:
        """Note the size to go back to. One that has just changed may be of a window that is about
        to say that it is maximized."""
        handle = glfw_utils.glfw_window_hello_imgui()
        before, self._size = self._size, glfw.get_window_size(handle)
        if self._size == before and not glfw.get_window_attrib(handle, glfw.MAXIMIZED):
            self._free_size = self._size


def _take_the_whole_number() -> None:
    """A double click in the field of a number selects all of it, as a single one does: its second
    click, which meets the field open, would select the digits on one side of the point."""
    context = imgui.get_current_context()
    field = context.temp_input_id
    if field and field == context.active_id and imgui.is_mouse_double_clicked(0):
        context.input_text_state.select_all()
        context.input_text_state.selected_all_mouse_lock = True  # until the mouse is released


def _walk_with_keys() -> None:
    """Tab and the arrows walk through what is open over the window, Enter and Space press there.

    Where nothing is open they are shortcuts and turn the camera.
    """
    io, keyboard = imgui.get_io(), imgui.ConfigFlags_.nav_enable_keyboard
    if len(imgui.get_current_context().open_popup_stack):
        io.config_flags |= keyboard
    elif io.config_flags & keyboard:
        io.config_flags &= ~keyboard
        imgui.set_nav_cursor_visible(False)


# --- Modifiers as the event says that they are held. Dear ImGui asks GLFW instead, which holds Alt
# for ever when its release went to the window manager, as after Alt+F4.

_MODIFIERS = {
    imgui.Key.mod_ctrl: (glfw.MOD_CONTROL, glfw.KEY_LEFT_CONTROL, glfw.KEY_RIGHT_CONTROL),
    imgui.Key.mod_shift: (glfw.MOD_SHIFT, glfw.KEY_LEFT_SHIFT, glfw.KEY_RIGHT_SHIFT),
    imgui.Key.mod_alt: (glfw.MOD_ALT, glfw.KEY_LEFT_ALT, glfw.KEY_RIGHT_ALT),
    imgui.Key.mod_super: (glfw.MOD_SUPER, glfw.KEY_LEFT_SUPER, glfw.KEY_RIGHT_SUPER),
}
_Handle = Any  # of GLFW's window: a pointer of ctypes


def _on_key(window: _Handle, key: int, scancode: int, action: int, mods: int) -> None:
    n_before = imgui.get_current_context().input_events_queue.size()
    imgui.backends.glfw_key_callback(_address(window), key, scancode, action, mods)
    _correct(window, mods, n_before, key)


def _on_button(window: _Handle, button: int, action: int, mods: int) -> None:
    n_before = imgui.get_current_context().input_events_queue.size()
    imgui.backends.glfw_mouse_button_callback(_address(window), button, action, mods)
    _correct(window, mods, n_before)


def _correct(window: _Handle, mods: int, n_before: int, key: int = glfw.KEY_UNKNOWN) -> None:
    """Give the newest events the modifiers ``mods``; of ``key`` itself X11 tells the one before."""
    said, asked = {}, {}
    for mod, (bit, *sides) in _MODIFIERS.items():
        asked[mod] = any(glfw.get_key(window, side) == glfw.PRESS for side in sides)
        said[mod] = asked[mod] if key in sides else bool(mods & bit)
    if said != asked:
        correct_modifiers(n_before, said)


def _address(window: _Handle) -> int:
    return ctypes.cast(window, ctypes.c_void_p).value or 0


def physical_keys() -> dict[str, str]:
    """The character that each key of the fly keys W A S D Q E types on this keyboard layout.

    Flying goes by the position of the keys, so that it works on AZERTY too; the other shortcuts go
    by character.
    """
    names = {}
    for letter in "WASDQE":
        typed = glfw.get_key_name(getattr(glfw, f"KEY_{letter}"), 0)
        names[letter] = typed.upper() if typed and typed.isalpha() and len(typed) == 1 else letter
    return names


def _dockable(panel: Panel, space: str) -> hello_imgui.DockableWindow:
    window = hello_imgui.DockableWindow(panel.label, space, panel.draw)
    window.can_be_closed = False
    window.remember_is_visible = False  # a hidden panel must not stay lost after a restart
    if panel.is_bare:
        window.call_begin_end = False
        window.gui_function = lambda: _bare(panel)
    return window


def _bare(panel: Panel) -> None:
    """A panel that is nothing but its content: no tab, no padding, no scrolling."""
    node = imgui.WindowClass()
    node.dock_node_flags_override_set = imgui.internal.DockNodeFlagsPrivate_.no_tab_bar
    imgui.set_next_window_class(node)
    imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(0, 0))
    imgui.begin(
        panel.label,
        None,
        imgui.WindowFlags_.no_scrollbar | imgui.WindowFlags_.no_scroll_with_mouse,
    )
    imgui.pop_style_var()
    panel.draw()
    imgui.end()


def _open_gl() -> hello_imgui.OpenGlOptions:
    """OpenGL 3.3 core: what macOS, Mesa and every graphics card of the last decade offer."""
    options = hello_imgui.OpenGlOptions()
    options.major_version, options.minor_version, options.glsl_version = 3, 3, "150"
    options.use_core_profile = True
    options.use_forward_compat = True
    options.anti_aliasing_samples = 0  # the runner's default of 8 only slows the splats down
    return options


def _settings(p: hello_imgui.RunnerParams, settings_file: Path | None) -> None:
    p.ini_disable = settings_file is None
    if settings_file is not None:
        forget_if_lost(settings_file)
        p.ini_filename = str(settings_file)
        p.app_window_params.restore_previous_geometry = True


def _frame(p: hello_imgui.RunnerParams) -> None:
    inside = p.imgui_window_params
    inside.default_imgui_window_type = (
        hello_imgui.DefaultImGuiWindowType.provide_full_screen_dock_space
    )
    inside.enable_viewports = False
    inside.show_menu_bar = True
    inside.show_menu_app = False
    inside.show_menu_view = False
    inside.show_status_bar = True
    inside.show_status_fps = False
    inside.remember_theme = False
    inside.remember_status_bar_settings = False


def _imgui_config() -> None:
    io = imgui.get_io()
    io.config_flags |= imgui.ConfigFlags_.docking_enable
    io.config_windows_move_from_title_bar_only = True
    io.config_drag_click_to_input_text = True


def _opening_problem(error: str) -> str:
    if "glfwInitSuccess" in error:
        return (
            "gaga-studio could not reach the display. Check DISPLAY or WAYLAND_DISPLAY, or start "
            "it from a desktop session."
        )
    if "window" in error.lower() and "opengl" in error.lower():
        return (
            "gaga-studio could not open an OpenGL 3.3 window. Install the graphics driver, or for "
            "software drawing on Debian or Ubuntu: sudo apt-get install libgl1-mesa-dri"
        )
    return ""
