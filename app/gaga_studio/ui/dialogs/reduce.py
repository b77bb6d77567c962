"""The sheet Reduce splats: of what, how many are kept, and about how much that loses."""

from imgui_bundle import ImVec2, imgui

from gaga_studio.features import cleanup
from gaga_studio.features.cleanup import ReducePlan, ReduceWhat
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import widgets
from gaga_studio.ui.kit.modal import answer, begin_modal, body
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

NAME = "Reduce splats"
_NAMES = 5.0  # width of the names of fields, ems
_FEWEST, _MOST = 5, 95  # percent
_WHATS: tuple[tuple[ReduceWhat, str, str, str], ...] = (
    ("selection", "", "Selection", "What is selected"),
    ("objects", "", "Objects", "Each object with selected splats, as a whole"),
    ("scene", "", "Scene", "All that is visible and not locked"),
)


def opens(session: Session, plan: ReducePlan) -> None:
    """Open the sheet."""
    if session.document is not None:
        cleanup.open_reduce_plan(session, plan)
        imgui.open_popup(NAME)


def draw(session: Session, plan: ReducePlan) -> None:
    """The sheet, while it is open."""
    if not begin_modal(NAME, em(30), is_possible=session.document is not None):
        cleanup.close_reduce_plan(session, plan)
        return
    cleanup.estimate_loss(session, plan)
    with body("Choices"):
        widgets.dim(
            "Similar neighbours become one splat. Hidden and locked splats, and those of "
            "different objects, are never merged.",
            wrap=True,
        )
        widgets.field_name("Of", em(_NAMES))
        off = {what: cleanup.why_not_reducible(session, what) for what, *_ in _WHATS}
        plan.what = widgets.segmented("Of", _WHATS, plan.what, why_not=off, wraps=True)
        widgets.field_name("Keep", em(_NAMES))
        _, plan.percent = widgets.slider("##Keep", plan.percent, _FEWEST, _MOST, "%d %%")
        widgets.tooltip("Share of the splats that is left")
        _says(session, plan)
    imgui.dummy(ImVec2(0, em(0.3)))
    face = Face("Reduce", width=em(8), primary=True)
    if answer("Reduce now", face, why_not=cleanup.why_not_reducing(session, plan)):
        cleanup.start_reducing(session, plan)
    imgui.end_popup()


def _says(session: Session, plan: ReducePlan) -> None:
    """How many are left, and about how much is lost."""
    n = len(cleanup.reducible_splats(session, plan.what))
    imgui.dummy(ImVec2(0, em(0.2)))
    imgui.text_unformatted(f"{n:,} splats become {max(min(n, 1), round(plan.percent / 100 * n)):,}")
    widgets.dim(cleanup.what_is_known_of_loss(session, plan), wrap=True)
    widgets.dim("From 40 dB the loss is barely visible; at 25 dB fine texture is gone.", wrap=True)
