"""The sheet that makes labelled pictures of new views of the open scene."""

from functools import partial

from imgui_bundle import ImVec2, imgui

from gaga_core.export.dataset.settings import DatasetConfig, Form
from gaga_core.settings import setting_of
from gaga_studio.features import dataset
from gaga_studio.features.dataset import DatasetPlan
from gaga_studio.session.session import Session
from gaga_studio.ui.dialogs.files import FilePicker, new_folder, stem
from gaga_studio.ui.kit import widgets
from gaga_studio.ui.kit.modal import answer, begin_modal, body
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

SHEET = "Labelled data"
_NAMES = 11.5  # width of the names of fields, ems
_NUMBERS = ("views", "views_each", "width", "height", "seed")
_SHARES = {
    "moved": "Share of the pictures in which objects stand elsewhere on what carries them",
    "removed": "Share of the pictures in which an object is gone",
    "lights": "Share of the pictures in another brightness, contrast and color temperature",
    "validation": "Share of the placements kept for validation; no view of one is in both",
    "closer": "Share of the pictures that look at one object from closer than photos",
    "coverage": "Share of a picture that photos must have shown from about the same side",
}
_FORMS: tuple[tuple[Form, str, str], ...] = (
    ("coco", "COCO", "Masks, boxes, poses, and outlines as if nothing stood before an object"),
    ("yolo", "YOLO", "Boxes of what is seen"),
    ("bop", "BOP", "6-D poses, masks and depth, in millimetres"),
)


def draw(session: Session, plan: DatasetPlan, files: FilePicker) -> None:
    """The sheet, while it is open; ``files`` asks where the data set goes."""
    if not begin_modal(SHEET, em(32), is_possible=session.document is not None):
        return
    with body("Settings"):
        widgets.dim(
            "Pictures from where photos were taken and between, with masks, boxes, poses and depth "
            "of every object. Names are classes.",
            wrap=True,
        )
        for name in _NUMBERS:
            _number(plan, name)
        for name, hint in _SHARES.items():
            widgets.field_name(setting_of(DatasetConfig, name).label, em(_NAMES))
            value = getattr(plan.config, name)
            low, high = setting_of(DatasetConfig, name).range
            share, most = round(100 * value), round(100 * high)
            label = f"##{setting_of(DatasetConfig, name).label}"
            changed, share = widgets.slider(label, share, round(100 * low), most, "%d %%")
            widgets.tooltip(hint)
            if changed:
                plan.put(name, share / 100)
        hint = "Seconds for each object that is moved or removed, once"
        title = setting_of(DatasetConfig, "fill").title
        plan.put("fill", widgets.tick(title, plan.config.fill, hint, em(_NAMES)))
        imgui.align_text_to_frame_padding()
        widgets.dim("Formats")
        imgui.same_line(em(_NAMES))
        for form, title, hint in _FORMS:
            if widgets.toggle(title, form in plan.forms, hint=hint):
                plan.switch(form)
            imgui.same_line()
        imgui.new_line()
        widgets.dim(plan.says(), wrap=True)
    imgui.dummy(ImVec2(0, em(0.3)))
    if answer("Choose a folder…", Face(width=em(10), primary=True), why_not=plan.why_not):
        title, name = "Make labelled data in a folder", f"{stem(session)} data"
        chosen = partial(dataset.start, session, plan)
        files.ask(new_folder(title, session, name, action="Make"), chosen, SHEET)
    imgui.end_popup()


def _number(plan: DatasetPlan, name: str) -> None:
    about = setting_of(DatasetConfig, name)
    widgets.field_name(about.label, em(_NAMES))
    changed, value = imgui.input_int(f"##{about.label}", getattr(plan.config, name), 0)
    if changed:
        plan.put(name, value)
