"""Models: look which are here, get one after consent, remove one, make masks with the best."""

import webbrowser
from collections.abc import Callable

from gaga_core.progress import Progress, Stage
from gaga_core.segmentation.models.catalogue import KnownModel, known_model
from gaga_core.segmentation.models.download import Consent, Installed, download, remove
from gaga_core.segmentation.models.hub import HubConfig, Listing, list_files
from gaga_core.segmentation.models.status import all_models
from gaga_studio.actions import live_objects, masks
from gaga_studio.session.next_stage import duration_text
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.requests import Request
from gaga_studio.session.session import Session

FIRST = known_model("sam2.1-tiny")  # that is offered to whoever has no model


def hub_config(session: Session) -> HubConfig:
    """Return which hub the preferences name, and whether it may be asked."""
    return HubConfig(session.settings.hub_mirror, session.settings.works_offline)


def refresh(session: Session) -> None:
    """Look again which models are here."""
    session.models.entries = all_models()
    session.models.promptable = None


def why_not(session: Session) -> str:
    """Return why no model can be got or removed now; "" when one can."""
    job = session.jobs.running
    if job is not None:
        return f"{job.title} is still running."
    offline = hub_config(session).why_offline()
    return f"No model can be downloaded: {offline}." if offline else ""


def ask(session: Session, model: KnownModel, then: Callable[[], object] | None = None) -> None:
    """Ask the hub for licence and size of ``model``, and show them; nothing is downloaded.

    ``then`` is called when the model has been downloaded.
    """
    state, config = session.models, hub_config(session)

    def look() -> Stage[Listing]:
        yield Progress("Look at the model", 0, 0, config.host)
        return list_files(model, config)

    def seen(listing: Listing) -> None:
        state.offered, state.then = listing, then

    state.offered = state.removing = state.then = None
    session.jobs.start(f"Look at {model.title}", look(), on_done=seen)


def accept(session: Session) -> None:
    """Accept the licence that is shown, and download the model."""
    state = session.models
    listing, then = state.offered, state.then
    if listing is None:
        return
    consent = Consent(listing.model.name, listing.licence_name)

    def done(installed: Installed) -> None:
        session.notify(Level.INFO, f"{installed.model.title} is here: {installed.path}.")
        if then is not None:
            after.append(then)

    def end() -> None:
        refresh(session)
        for act in after:
            act()

    after: list[Callable[[], object]] = []
    stage = download(listing, consent, hub_config(session))
    if session.jobs.start(f"Download {listing.model.title}", stage, None, done, end):
        state.offered = state.then = None


def decline(session: Session) -> None:
    """Download nothing, remove nothing."""
    state = session.models
    state.offered = state.removing = state.then = None


def ask_remove(session: Session, model: KnownModel) -> None:
    """Ask whether to delete a model."""
    decline(session)
    session.models.removing = model


@notifies
def remove_asked(session: Session) -> bool:
    """Delete the model that was asked about."""
    model, session.models.removing = session.models.removing, None
    if model is None:
        return False
    folder = remove(model)
    session.models.prompters.pop(model.name, None)
    refresh(session)
    session.notify(Level.INFO, f"Removed {folder}." if folder else f"{model.title} is gone.")
    return True


def open_page(model: KnownModel) -> None:
    """Show the page of a model, with its licence, in the browser."""
    webbrowser.open(model.page)


# --- masks with a model, from the offer of the next stage


def here(session: Session) -> KnownModel | None:
    """Return the model for masks that is here and quickest; None when there is none."""
    if not session.models.entries:
        refresh(session)
    found = [e for e in session.models.entries if e.path and e.model.purpose == "masks"]
    quickest = min(found, key=lambda e: e.seconds or float("inf"), default=None)
    return quickest.model if quickest is not None else None


def duration(session: Session, name: str, n: int) -> str:
    """Return "about 3 min", as long as a model takes for ``n`` photos here; "" if not known."""
    if not session.models.entries:
        refresh(session)
    entry = session.models.entry(name)
    return duration_text(n * entry.seconds) if entry is not None and entry.seconds else ""


def title(session: Session) -> str:
    """Return "Make masks with SAM 2.1 Hiera tiny, 156 MB, about 3 min…", as it is now."""
    model = here(session) or FIRST
    entry = session.models.entry(model.name)
    is_here = entry is not None and entry.path is not None
    size = "" if is_here else f"{model.megabytes:,} MB"
    n = len(masks.photos_of(session, "train"))
    parts = (f"Make masks with {model.title}", size, duration(session, model.name, n))
    return ", ".join(filter(None, parts)) + ("" if is_here else "…")


def why_no_masks(session: Session) -> str:
    """Return why no masks can be made with a model; "" when they can, perhaps after a download."""
    reason = masks.no_photos(session)
    return reason or ("" if here(session) is not None else why_not(session))


def make_masks(session: Session) -> None:
    """Make masks with a model: at once when one is here, else after the user has got one."""
    document, model = session.need(), here(session)
    if model is not None:
        live_objects.make(session, masks.MaskRequest(provider=model.name))
        return

    def then() -> None:
        if session.document is document:
            live_objects.make(session, masks.MaskRequest(provider=FIRST.name))

    session.request = Request.MODELS
    ask(session, FIRST, then)
