"""The sheet of models: what is known, what is here; get one after its licence, remove one."""

from imgui_bundle import ImVec2, imgui

from gaga_core.segmentation.models.hub import Listing, terms
from gaga_core.segmentation.models.status import ModelStatus
from gaga_core.segmentation.models.weights import models_folder
from gaga_studio.features.find import masks
from gaga_studio.features.find.masks import ModelsState
from gaga_studio.session.jobs import Job
from gaga_studio.session.session import Session
from gaga_studio.system import paths
from gaga_studio.ui.chrome.status import time_left
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.modal import begin_modal, begin_part, body_height, close_row
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

SHEET = "Models"
_PURPOSES = {
    "masks": "Masks",
    "words": "Search by words",
    "boxes": "Find in a view",
    "matches": "Placing photos",
}
_NARROW = 34.0  # em: a narrower sheet leaves out three columns, or no name could be read
_TABLE = 26.0  # em, while something is asked below it
_COLUMNS = (  # title, width in em: below 0 a share of the room that is left; in a narrow sheet?
    ("Model", -0.47, True),
    ("Good for", -0.53, False),
    ("Size", 4.7, True),
    ("License", 5.8, False),
    ("Time a photo", 5.8, False),
    ("", 5.6, True),
)
_FOOT, _LOW_FOOT = 5.0, 1.6  # em: two lines and a row of buttons; one line


def opens(session: Session) -> None:
    """Look what is here, and open the sheet."""
    masks.refresh_models(session)
    session.feature(ModelsState).problem = ""
    imgui.open_popup(SHEET)


def draw(session: Session) -> None:
    """The whole sheet."""
    state = session.feature(ModelsState)
    state.is_shown = begin_modal(SHEET, em(70))
    if not state.is_shown:
        return
    if not session.feature(ModelsState).entries:
        masks.refresh_models(session)
    widgets.dim(
        "Nothing is downloaded without your consent. Sizes are approximate until you ask for one.",
        wrap=True,
    )
    widgets.line(f"Models are in {paths.shown(models_folder())}.", theme.DIM)
    is_asking = state.offered is not None or state.removing is not None or bool(state.problem)
    is_high = is_asking or _own_job(session) is not None
    footer = em(_FOOT if is_high else _LOW_FOOT)
    height = body_height(em(_TABLE + _FOOT))
    room = height - footer - imgui.get_style().item_spacing.y
    if is_high and room < 3 * imgui.get_frame_height():  # a low window has room for one of both
        footer = height
    else:
        if begin_part("Known", ImVec2(0, room)):
            _table(session)
        imgui.end_child()
    if begin_part("Answer", ImVec2(0, footer)):
        _foot(session)
    imgui.end_child()
    close_row()
    imgui.end_popup()


def _table(session: Session) -> None:
    flags = imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_stretch_prop
    is_narrow = imgui.get_content_region_avail().x < em(_NARROW)
    shown = [column for column in _COLUMNS if column[2] or not is_narrow]
    if not imgui.begin_table("Models", len(shown), flags):
        return
    for title, width, _ in shown:
        kind = imgui.TableColumnFlags_
        flag = kind.width_fixed if width > 0 else kind.width_stretch
        imgui.table_setup_column(title, flag, em(width) if width > 0 else -width)
    imgui.table_headers_row()
    for entry in session.feature(ModelsState).entries:
        imgui.table_next_row()
        imgui.push_id(entry.model.name)
        _row(session, entry, is_narrow=is_narrow)
        imgui.pop_id()
    imgui.end_table()


def _row(session: Session, entry: ModelStatus, *, is_narrow: bool) -> None:
    model = entry.model
    purpose = ", ".join(filter(None, (_PURPOSES[model.purpose], model.note)))
    imgui.table_next_column()
    imgui.align_text_to_frame_padding()
    icon = icons.CHECK if entry.path is not None else icons.BLANK
    widgets.line(f"{icon}  {model.title}", theme.TEXT if entry.path is not None else theme.DIM)
    where = str(entry.path) if entry.path is not None else model.hub
    widgets.tooltip(f"{purpose}: {entry.good_for}\n{where}" if is_narrow else where)
    if not is_narrow:
        imgui.table_next_column()
        widgets.line(purpose)
        widgets.tooltip(entry.good_for)
    imgui.table_next_column()
    widgets.line(f"{model.megabytes:,} MB")
    if not is_narrow:
        imgui.table_next_column()
        if imgui.text_link(f"{model.licence}##licence"):
            masks.open_model_page(model)
        widgets.tooltip(f"Open {model.page}")
        imgui.table_next_column()
        widgets.line(_seconds(entry))
    imgui.table_next_column()
    why_not = masks.why_no_download(session)
    if entry.path is None:
        hint = f"Continues after {entry.partial_bytes / 1e6:.0f} MB" if entry.partial_bytes else ""
        if widgets.button("Get", Face("Get…", width=-1), why_not=why_not, hint=hint):
            masks.ask_model(session, model)
    elif widgets.button("Remove", Face("Remove…", width=-1)):
        masks.ask_remove_model(session, model)


def _seconds(entry: ModelStatus) -> str:
    """ "12 s" where it was measured, "about 12 s" where it is estimated."""
    if entry.seconds is None:
        return "not known" if entry.model.purpose == "masks" else ""
    text = f"{entry.seconds:.0f} s" if entry.seconds >= 2 else f"{entry.seconds:.1f} s"
    return text if entry.is_measured else f"about {text}"


def _own_job(session: Session) -> Job | None:
    """The look at a model, or the download, that runs."""
    job = session.jobs.running
    return job if job is not None and job.title == session.feature(ModelsState).task else None


def _foot(session: Session) -> None:
    """What is asked, or the progress of what runs."""
    state, job = session.feature(ModelsState), _own_job(session)
    if job is not None:
        _progress(session, job)
    elif state.offered is not None:
        _terms(session, state.offered)
    elif state.removing is not None:
        widgets.paragraph(f"Delete {state.removing.title} from this computer?")
        if widgets.button("Delete", Face(primary=True)):
            masks.remove_asked_model(session)
        imgui.same_line()
        if widgets.button("Keep it"):
            masks.decline_model(session)
    elif state.problem:
        if widgets.button("All models"):
            masks.decline_model(session)
        with theme.text_color(theme.BAD):
            widgets.paragraph(state.problem)
    else:
        widgets.dim("Get… shows the license and the exact size, and asks.")


def _progress(session: Session, job: Job) -> None:
    imgui.text_unformatted(job.title)
    imgui.progress_bar(max(job.fraction, 0.0), ImVec2(-em(6), 0), job.message or job.stage)
    imgui.same_line()
    why_not = "It stops." if job.is_cancelling else ""
    if widgets.button("Cancel", Face(width=-1), why_not=why_not):
        session.jobs.cancel()
    if job.eta_s is not None:
        left = time_left(job.eta_s)
        goes_on = " After a cancel, Get continues from here." if job.resumes else ""
        widgets.dim(f"{left[0].upper()}{left[1:]}.{goes_on}")


def _terms(session: Session, listing: Listing) -> None:
    """Licence and size; nothing is downloaded before the answer."""
    widgets.paragraph(terms(listing.model, listing))
    if widgets.button("Accept", Face("Accept the license and download", primary=True)):
        masks.accept_model(session)
    imgui.same_line()
    if widgets.button("Not now"):
        masks.decline_model(session)
    imgui.same_line()
    if widgets.button("Read the license"):
        masks.open_model_page(listing.model)
