"""The sheet Find objects: the preset, and the switches of the paper, folded away."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

from imgui_bundle import ImVec2, imgui

from gaga_core.grouping.associate import AssociateConfig
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_studio.features.find import association
from gaga_studio.features.find.association import FindOptions, FindState, lift_mode, training_text
from gaga_studio.session.notices import Request
from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings
from gaga_studio.ui.dialogs import make_masks
from gaga_studio.ui.kit import icons, widgets
from gaga_studio.ui.kit.modal import begin_modal, body_height
from gaga_studio.ui.kit.requests import RequestTable
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

NAME = "Find objects"
T = TypeVar("T")
Choices = Sequence[tuple[T, str]]
_PRESETS = (
    ("robust", "", "Robust", "Groups by the agreement of all views"),
    ("paper", "", "Paper", "The published method: memory bank view by view, trained identities"),
)
_IDENTITIES: Choices[str] = (
    ("preset", "As the preset has it"),
    ("none", "None"),
    ("vote", "By vote, in seconds"),
    ("refine", "By vote, then a few training steps"),
    ("paper", "Trained from zeros, as published"),
)
_DEPTHS: Choices[str] = (
    ("expected", "Expected"),
    ("median", "Median"),
    ("none", "None: all behind the mask"),
)
_ORDERS: Choices[str] = (("name", "By name"), ("coverage", "Widest views first"))
_PSEUDO: Choices[str] = (("masks", "Masks with their groups"), ("bank", "The splatted bank"))
_VOID: Choices[bool] = ((False, "Left out"), (True, "Trained as no group"))
_MOST_ITERATIONS = 100_000


def register(table: RequestTable) -> None:
    """Answer the request for the sheet."""
    table.register_popup(Request.FIND_OBJECTS, NAME)


def draw(session: Session) -> None:
    """The sheet, while it is open."""
    if not begin_modal(NAME, em(32)):
        return
    if session.document is None:
        imgui.close_current_popup()
        imgui.end_popup()
        return
    _head(session)
    most = ImVec2(1e6, body_height(em(24)))
    imgui.set_next_window_size_constraints(ImVec2(0, 0), most)  # grows as sections are unfolded
    imgui.begin_child("Switches", ImVec2(0, 0), imgui.ChildFlags_.auto_resize_y)
    _association(session)
    _identities(session)
    imgui.end_child()
    _actions(session)
    imgui.end_popup()


def _head(session: Session) -> None:
    widgets.dim("Masks of single photos are joined in 3D: a thing is one object.", wrap=True)
    settings = session.settings
    preset = widgets.segmented("Preset", _PRESETS, settings.preset, why_not={})
    if preset != settings.preset:
        session.change_settings(replace(settings, preset=preset))
    imgui.same_line(0, em(1))
    make_masks.draw_choice(session, -1)


def _association(session: Session) -> None:
    """Switches of section 3.2 of the paper; what they show at first is what the preset has."""
    if not widgets.section("Memory bank (section 3.2)"):
        return
    options, preset = (
        session.feature(FindState).options,
        AssociateConfig.of(session.settings.preset),
    )
    threshold = options.threshold or preset.threshold
    changed, threshold = _number("Overlap threshold", threshold, 0.01, 1.0)
    widgets.tooltip("Least share of a mask's splats in a group that it joins; published: 0.1")
    if changed:
        options = replace(options, threshold=threshold)
    f = preset.gate.iqr_factor if options.inlier_factor is None else options.inlier_factor
    changed, f = _number("Inlier factor f", f, 0.0, 4.0)
    widgets.tooltip("Depths up to Q3 + f times the IQR of a mask's depths count; published: 1")
    if changed:
        options = replace(options, inlier_factor=f)
    depth = _choice("Depth of a pixel", _DEPTHS, options.depth or preset.depth)
    if depth != (options.depth or preset.depth):
        options = replace(options, depth=depth)  # type: ignore[arg-type]
    order = _choice("Order of the views", _ORDERS, options.order or preset.order)
    if order != (options.order or preset.order):
        options = replace(options, order=order)  # type: ignore[arg-type]
    session.feature(FindState).options = options


def _identities(session: Session) -> None:
    """Switches of section 3.3."""
    if not widgets.section("Identity encodings (section 3.3)"):
        return
    settings, options = session.settings, session.feature(FindState).options
    chosen = _choice("Identities", _IDENTITIES, settings.identities)
    if chosen != settings.identities:
        session.change_settings(replace(settings, identities=chosen))
    lift, paper = options.lift, options.lift.paper
    _label("Training steps")
    changed, n = imgui.input_int("##Training steps", paper.iterations, 1000)
    widgets.tooltip("Of identities that are trained from zeros; published: 10,000")
    n = min(max(n, 2), _MOST_ITERATIONS)
    pseudo = _choice("Pseudo labels", _PSEUDO, lift.pseudo)
    widgets.tooltip("What identities are trained on: figure 2 and the published code, or the text")
    void = _choice("Pixels without a mask", _VOID, paper.rows.train_void)
    switched = lift.switched(n if changed else None, train_void=void)
    session.feature(FindState).options = replace(options, lift=replace(switched, pseudo=pseudo))  # type: ignore[arg-type]


def _actions(session: Session) -> None:
    imgui.dummy(ImVec2(0, em(0.2)))
    job = session.jobs.running
    busy = "" if job is None else f"{job.title} is still running."
    no_masks = "" if len(session.masks) else "This scene has no masks. Use Make masks."
    mode = lift_mode(session.settings)
    then = " and train" if mode == "paper" else ""
    hint = training_text(session.feature(FindState).options.lift) if then else ""
    face = Face(f"Find objects{then}", icons.RUN, primary=True)
    if widgets.button("Find", face, why_not=busy or no_masks, hint=hint):
        imgui.close_current_popup()
        association.associate(session)
    imgui.same_line()
    bank = session.need().scene.bank
    why_not = busy or no_masks or _no_groups(bank)
    hint = "Identities of the groups that are here; the groups stay"
    if widgets.button("Lift", Face("Lift only"), why_not=why_not, hint=hint):
        imgui.close_current_popup()
        association.lift(session)
    imgui.same_line()
    as_preset = session.feature(FindState).options == FindOptions()
    same = "All is as the preset has it." if as_preset and _is_default(session.settings) else ""
    if widgets.button("Reset", why_not=same, hint="Take every switch from the preset"):
        session.feature(FindState).options = FindOptions()
        session.change_settings(replace(session.settings, identities="preset"))
    imgui.same_line()
    if widgets.button("Close"):
        imgui.close_current_popup()


def _no_groups(bank: MemoryBank | None) -> str:
    return "" if bank is not None else "There are no groups of masks yet."


def _is_default(settings: Settings) -> bool:
    return settings.identities == Settings().identities


def _label(text: str) -> None:
    """The name of a control, on its left; the control takes the rest of the line."""
    imgui.align_text_to_frame_padding()
    widgets.dim(text)
    imgui.same_line(em(11))
    imgui.set_next_item_width(-1)


def _number(text: str, value: float, low: float, high: float) -> tuple[bool, float]:
    _label(text)
    flags = imgui.SliderFlags_.always_clamp
    return imgui.slider_float(f"##{text}", value, low, high, "%.2f", flags)


def _choice(text: str, choices: Choices[T], current: T) -> T:
    """A drop-down of (value, text)."""
    _label(text)
    values = [value for value, _ in choices]
    changed, at = imgui.combo(f"##{text}", values.index(current), [name for _, name in choices])
    return values[at] if changed else current
