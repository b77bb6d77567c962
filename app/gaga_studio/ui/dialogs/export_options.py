"""What an export changes on the way, in the sheet that exports: color, count, placement, crop."""

from dataclasses import replace

from imgui_bundle import imgui

from gaga_core.export.options import ExportOptions, Point
from gaga_core.scene.selection.bounds import splat_box
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import widgets
from gaga_studio.ui.kit.theme import em

NAMES = 7.0  # width of the names of fields, ems
_SHARES = {1.0: "All", 0.75: "Three quarters", 0.5: "Half", 0.25: "A quarter", 0.1: "A tenth"}


def draw(session: Session, options: ExportOptions, *, has_splats: bool) -> ExportOptions:
    """The rows of options; ``has_splats``: what is written has colors, and may be fewer."""
    degree = session.need().scene.gaussians.sh_degree
    if has_splats:
        options = _color(options, degree) if degree > 0 else options
        options = _fewer(options)
    widgets.field_name("Placement", em(NAMES))
    changed, centre = widgets.checkbox("Middle at the origin", options.centre)
    widgets.tooltip("The middle of all that is written becomes the origin; files still fit")
    options = replace(options, centre=centre) if changed else options
    widgets.next_to("Lowest point at height 0", extra=em(2))
    changed, ground = widgets.checkbox("Lowest point at height 0", options.ground)
    widgets.tooltip("What is written stands on the ground")
    options = replace(options, ground=ground) if changed else options
    widgets.field_name("Units", em(NAMES))
    form = "1 scene unit = %.4g in the file"
    flags = imgui.SliderFlags_.always_clamp | imgui.SliderFlags_.logarithmic
    changed, scale = imgui.drag_float("##Units", options.scale, 0.01, 1e-4, 1e4, form, flags)
    widgets.tooltip("Drag, or double-click to type. What is 2 long here is twice this number long")
    options = replace(options, scale=scale) if changed and scale > 0 else options
    widgets.field_name("Crop", em(NAMES))
    return _crop(session, options)


def _color(options: ExportOptions, degree: int) -> ExportOptions:
    widgets.field_name("Color", em(NAMES))
    chosen = degree if options.sh_degree is None else min(options.sh_degree, degree)
    names = [f"View-dependent, degree {k}" if k else "The same from every side" for k in range(5)]
    names[degree] = f"As it is (degree {degree})"
    order = list(range(degree, -1, -1))
    changed, at = imgui.combo("##Color", order.index(chosen), [names[k] for k in order])
    widgets.tooltip("Lower degrees make smaller files and lose reflections")
    if not changed:
        return options
    return replace(options, sh_degree=None if order[at] == degree else order[at])


def _fewer(options: ExportOptions) -> ExportOptions:
    widgets.field_name("Splats", em(NAMES))
    shares = list(_SHARES)
    now = min(range(len(shares)), key=lambda k: abs(shares[k] - options.keep))
    changed, at = imgui.combo("##Splats", now, list(_SHARES.values()))
    widgets.tooltip("Fewer make smaller files that are drawn faster: neighbours are merged")
    return replace(options, keep=shares[at]) if changed else options


def _crop(session: Session, options: ExportOptions) -> ExportOptions:
    changed, is_on = widgets.checkbox("Only what is in a box", options.crop is not None)
    widgets.tooltip("The box is around the selection at first, else around everything")
    if changed:
        crop = _box(session) if is_on else None
        return replace(options, crop=crop)
    if options.crop is None:
        return options
    lo, hi = options.crop
    speed = max(*(b - a for a, b in zip(lo, hi, strict=True)), 1e-6) / 300
    widgets.field_name("  from", em(NAMES))
    moved_lo, low = imgui.drag_float3("##Crop from", list(lo), speed, 0, 0, "%.3f")
    widgets.field_name("  to", em(NAMES))
    moved_hi, high = imgui.drag_float3("##Crop to", list(hi), speed, 0, 0, "%.3f")
    if not (moved_lo or moved_hi):
        return options
    first = [min(a, b) for a, b in zip(low, high, strict=True)]
    last = [max(a, b) for a, b in zip(low, high, strict=True)]
    return replace(options, crop=(_point(first), _point(last)))


def _box(session: Session) -> tuple[Point, Point]:
    chosen = session.selected_indices()
    lo, hi = splat_box(session.need().scene, chosen if len(chosen) else None, share=1.0)
    return _point(lo.tolist()), _point(hi.tolist())


def _point(values: "list[float]") -> Point:
    x, y, z = values
    return float(x), float(y), float(z)
