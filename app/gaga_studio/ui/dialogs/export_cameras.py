"""The forms of cameras in the sheet that exports."""

from gaga_core.export.cameras import CameraForm
from gaga_studio.ui.kit import widgets

FORMS: tuple[tuple[CameraForm, str, str, str], ...] = (
    (
        CameraForm.CAMERAS_JSON,
        "",
        "cameras.json",
        "As trainings of 3D Gaussian Splatting write them; viewers of splats read them.",
    ),
    (
        CameraForm.TRANSFORMS_JSON,
        "",
        "transforms.json",
        "For nerfstudio and instant-ngp. The photos belong next to it, into the folder images.",
    ),
    (
        CameraForm.COLMAP,
        "",
        "COLMAP",
        "A folder with cameras, images and points as text: most trainings start from these.",
    ),
)


def draw(form: CameraForm, indent: float) -> CameraForm:
    """The row that chooses a form, and what it is for; ``indent`` pixels from the left."""
    widgets.field_name("Form", indent)
    chosen = widgets.segmented("Camera form", FORMS, form, why_not={})
    widgets.under_fields(indent)
    widgets.dim(next(hint for one, _, _, hint in FORMS if one is chosen), wrap=True)
    return chosen
