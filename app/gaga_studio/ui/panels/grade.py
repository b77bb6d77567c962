"""Color grade of the selection: sliders that show at once and end as one entry of the history."""

from dataclasses import fields, replace

from imgui_bundle import imgui

from gaga_core.scene.tint import Grade
from gaga_studio.features.transform import GradeSliders
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import widgets
from gaga_studio.ui.kit.theme import em

_NAMES = 6.0  # width of the names of fields, ems
_SLIDERS = (
    ("temperature", "Temperature", -1.0, 1.0, "Cold to warm"),
    ("green", "Green", -1.0, 1.0, "Magenta to green"),
    ("saturation", "Saturation", 0.0, 2.0, "Grey to vivid"),
    ("brightness", "Brightness", -0.5, 0.5, "Added to every channel"),
    ("black", "Black", -0.5, 0.5, "The level that becomes black"),
    ("white", "White", 0.5, 1.5, "The level that becomes white"),
    ("opacity", "Opacity", 0.0, 1.0, "Of every splat of the selection"),
)


def draw(session: Session, sliders: GradeSliders) -> None:
    """A section of the inspector; closed until it is asked for."""
    if not widgets.section("Color grade"):
        return
    sliders.follow(session)
    grade, changed, ended = sliders.value, False, False
    widgets.field_name("Tint", em(_NAMES))
    moved, tint = imgui.color_edit3("##Tint", list(grade.tint), imgui.ColorEditFlags_.float)
    ended |= imgui.is_item_deactivated_after_edit()
    if moved:
        grade, changed = replace(grade, tint=(tint[0], tint[1], tint[2])), True
    for name, label, low, high, hint in _SLIDERS:
        widgets.field_name(label, em(_NAMES))
        moved, value = imgui.slider_float(
            f"##{label}", getattr(grade, name), low, high, "%.2f", imgui.SliderFlags_.always_clamp
        )
        ended |= imgui.is_item_deactivated_after_edit()
        widgets.tooltip(hint)
        if moved:
            grade, changed = _with(grade, name, value), True
    if changed:
        sliders.show(session, grade)
    if ended:
        sliders.keep(session)
    why_not = "" if not grade.changes_nothing else "Nothing is graded yet."
    if widgets.button("Reset", why_not=why_not, hint="Take the grade back"):
        sliders.reset(session)


def _with(grade: Grade, name: str, value: float) -> Grade:
    values = {f.name: getattr(grade, f.name) for f in fields(grade)}
    return Grade(**{**values, name: value})
