"""Where the selection stands, in numbers: position, rotation, scale and size; each can be typed."""

from dataclasses import dataclass, replace

import numpy as np
from imgui_bundle import imgui

from gaga_core.arrays import DoubleArray
from gaga_core.scene.orientation import Pose, degrees_of, motion_between, with_degrees
from gaga_studio.features import measure, transform
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import widgets
from gaga_studio.ui.kit.theme import em

_ZERO = 0.0005  # below half of the last digit that is shown
_LEAST, _MOST = 0.001, 1000.0  # scales


@dataclass
class PlacementState:
    """Numbers that are being dragged or typed, not applied yet."""

    target: Pose | None = None
    degrees: DoubleArray | None = None  # (3,) as typed: angles of a rotation are not unique
    verb: str = "Move"
    each_axis: bool = False  # scales of the axes change one by one

    def clear(self) -> None:
        """Forget the numbers that were being dragged."""
        self.target, self.degrees = None, None


def draw_rows(session: Session, document: Document, state: PlacementState) -> None:
    """Rows of a table of four columns."""
    start, box = document.selected_pose(), document.selected_box()
    if start is None or box is None:
        return
    extent = max(float(np.linalg.norm(box[1] - box[0])), 1e-6)
    _position(session, state, start, extent)
    _rotation(session, state, start)
    _scale(session, state, start)


def draw_below(session: Session, document: Document, state: PlacementState) -> None:
    """The size of the box, and along which axes the numbers are."""
    sizes = document.selected_sizes(local=session.view.local_axes)
    if sizes is None:
        return
    widgets.dim(f"Size  {measure.lengths(session, sizes)}", wrap=True)
    widgets.tooltip("Sides of its box along these axes, without the outermost 2 percent of splats")
    if session.view.show_box and (turned := document.selected_oriented_box()) is not None:
        widgets.dim(f"Turned box  {measure.lengths(session, turned.size)}", wrap=True)
        widgets.tooltip("The smallest box around it, turned as it lies")
    changed, local = widgets.checkbox("Own axes", session.view.local_axes)
    widgets.tooltip("Numbers and handles along the object's own axes, else the world's")
    if changed:
        session.view.local_axes = local
    widgets.next_to("Each axis", em(1.6))
    _, state.each_axis = widgets.checkbox("Each axis", state.each_axis)
    widgets.tooltip("Scale the axes one by one, else all together")
    widgets.next_to("Box", em(1.6))
    _, session.view.show_box = widgets.checkbox("Box", session.view.show_box)
    widgets.tooltip("Show the smallest box around the selection in the picture")
    command_buttons.command_button(session, "object.reset_placement", "Reset placement")


def _position(session: Session, state: PlacementState, start: Pose, extent: float) -> None:
    shown = state.target or start
    axes = start.axes if session.view.local_axes else np.eye(3)
    unit = "metres" if _is_metric(session) else "scene units"
    row("Position", f"Centre of the selection, in {unit}")
    values = axes.T @ shown.centre
    for axis, letter in enumerate("XYZ"):
        now = float(values[axis]) if abs(values[axis]) >= _ZERO else 0.0  # never "-0.000"
        changed, value = number(f"Position {letter}", now, extent * 0.005, "%.3f")
        if changed:
            centre = shown.centre + axes[:, axis] * (value - float(values[axis]))
            state.target, state.verb = replace(shown, centre=centre), "Move"
        _after(session, state, start, changed)


def _rotation(session: Session, state: PlacementState, start: Pose) -> None:
    shown, local = state.target or start, session.view.local_axes
    whose = "its own axes" if local else "the world's axes"
    row("Rotation" if start.is_one else "Turn by", f"Degrees about x, then y, then z: {whose}")
    degrees = degrees_of(shown, local=local) if state.degrees is None else state.degrees
    for axis, letter in enumerate("XYZ"):
        changed, value = number(f"Rotation {letter}", float(degrees[axis]), 0.5, "%.1f°")
        if changed:
            typed = degrees.copy()
            typed[axis] = value
            state.degrees, state.verb = typed, "Turn"
            state.target = with_degrees(shown, typed, local=local)
        _after(session, state, start, changed)


def _scale(session: Session, state: PlacementState, start: Pose) -> None:
    shown = state.target or start
    row("Scale" if start.is_one else "Scale by", "Along its own axes, about the centre")
    limits = (_LEAST, _MOST)
    for axis, letter in enumerate("XYZ"):
        now = float(abs(shown.scale[axis]))
        changed, value = number(f"Scale {letter}", now, 0.005, "%.3f×", limits)
        if changed and now > 0 and value > 0:
            factors = np.full(3, value / now)
            if state.each_axis:
                factors[np.arange(3) != axis] = 1.0
            state.target, state.verb = replace(shown, scale=shown.scale * factors), "Scale"
        _after(session, state, start, changed)


def _after(session: Session, state: PlacementState, start: Pose, changed: bool) -> None:
    """Show the placement that the numbers describe; keep it when a drag or a typed value ends."""
    if state.target is not None and imgui.is_key_pressed(imgui.Key.escape):  # given up
        session.cancel_preview()
        state.clear()
        imgui.internal.clear_active_id()
        return
    ended = imgui.is_item_deactivated_after_edit()
    if (changed or ended) and state.target is not None:
        transform.preview_move(session, motion_between(start, state.target), state.verb)
    if ended:
        session.commit_preview()
        state.clear()


def _is_metric(session: Session) -> bool:
    return session.scene is not None and session.scene.frame.is_metric


def row(name: str, hint: str) -> None:
    """Begin a row of the table with its name."""
    imgui.table_next_row()
    imgui.table_next_column()
    imgui.align_text_to_frame_padding()
    widgets.dim(name)
    widgets.tooltip(hint)


def number(
    name: str, value: float, speed: float, form: str, limits: tuple[float, float] = (0.0, 0.0)
) -> tuple[bool, float]:
    """A number in the next column: dragged or typed."""
    imgui.table_next_column()
    imgui.set_next_item_width(-1)
    flags = imgui.SliderFlags_.always_clamp if limits[1] > 0 else imgui.SliderFlags_.none
    result = imgui.drag_float(f"##{name}", value, speed, *limits, form, flags)
    widgets.tooltip(f"{name}: drag, or click to type")
    return result
