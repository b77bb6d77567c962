"""Search the open scene: by words, by an index of pictures, by a detector; name objects."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.pipeline.search import (
    INDEX_FILE,
    Pictures,
    find_in_view,
    pictures_of,
    refresh_index,
    suggested_names,
    train_views,
    work_of,
)
from gaga_core.progress import Progress, Stage
from gaga_core.query.embed import (
    KNOWN_DETECTORS,
    KNOWN_EMBEDDERS,
    Embedder,
    find_any,
    load_embedder,
    where_to_put_all,
)
from gaga_core.query.index import GroupIndex
from gaga_core.query.search import Answer
from gaga_core.scene.edits.objects import name_groups
from gaga_core.segmentation.models.weights import models_folder
from gaga_studio.actions import list_filter, navigation, quality, selection
from gaga_studio.session import stages
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level
from gaga_studio.session.search_state import look_up_stage, measure_stage
from gaga_studio.session.session import NO_GROUPS, Session
from gaga_studio.system import paths

_LONGEST = 800  # longest side, pixels, of the picture for a detector
EXAMPLES = "“red”, “the largest”, “yellow left of the bowl”"


# --- every frame that the box is drawn in


def tick(session: Session) -> None:
    """Measure what has changed, describe objects, look up nouns, and update the answer."""
    document = session.document
    if document is None or session.live is not None or session.is_previewing:
        return
    if not document.read.has_groups():
        return
    search = document.search
    is_asked = bool(search.text.strip())
    cameras = train_views(document.project)
    key = search.key(document.scene, cameras)
    is_new = search.measured is None or search.measured.key != key
    rests = search.rests(key)
    if not is_new:
        _describe(document)
    if session.jobs.quiet is None:
        nouns = search.nouns_to_look_up()
        if is_new:
            if is_asked or (rests and session.jobs.running is None):
                _measure(session, document, cameras, key)
        elif nouns and search.measured is not None and search.measured.pictures is not None:
            stage = look_up_stage(search.measured.pictures, nouns, search.know)
            session.jobs.start_quiet("Look up words", stage)
    if is_asked:
        table = session.objects()
        search.keep(list_filter.kept_groups(session, table, quality.column(session, table)))
        search.answer(document.scene, table, cameras)


def _describe(document: Document) -> None:
    """Call groups without a name by what was measured of them."""
    measured = document.search.measured
    if measured is None or document.search.described is measured:
        return
    document.search.described = measured
    scene = document.scene
    if scene.described != measured.description.words:
        scene.described = dict(measured.description.words)
        scene.revision.names += 1


def _measure(session: Session, document: Document, cameras: Sequence[Camera], key: object) -> None:
    snapshot = replace(document.scene)  # columns are never written in place
    project = document.project

    def load() -> Pictures | None:
        return pictures_of(project, _load_embedder)

    stage = measure_stage(snapshot, cameras, key, load, document.search.take)
    session.jobs.start_quiet("Measure the objects", stage)


def type_text(session: Session, text: str, size: tuple[int, int]) -> None:
    """Take the text of the box; left and right are those of the present picture of ``size``."""
    if session.document is not None:
        camera = session.rig.camera(max(size[0], 1), max(size[1], 1))
        session.document.search.type(text, camera)


# --- taking an answer


def take_hit(session: Session, at: int | None = None, *, flies: bool = True) -> bool:
    """Select the object of a line (default: the current one) and fly to it."""
    if session.document is None:
        return False
    search = session.document.search
    search.at = search.at if at is None else at
    if not 0 <= search.at < len(search.hits):
        return False
    group = search.hits[search.at].group
    selection.select_groups(session, (group,))
    if flies:
        navigation.frame_group(session, group)
    return True


def take_all(session: Session) -> bool:
    """Add all objects that answer the text to the selection."""
    meant = session.document.search.meant if session.document is not None else ()
    if not meant:
        return False
    return selection.select_groups(session, meant, "add")


# --- models


def embedder_folder() -> Path | None:
    """Return the folder of the first CLIP or SigLIP model that is here."""
    return find_any(KNOWN_EMBEDDERS)


def detector_folder() -> Path | None:
    """Return the folder of the first Grounding DINO or OWLv2 model that is here."""
    return find_any(KNOWN_DETECTORS)


def no_embedder() -> str:
    """Return why there is no CLIP or SigLIP model; "" when there is one."""
    if embedder_folder() is not None:
        return ""
    return f"That needs a model of words and pictures. {where_to_put_all(KNOWN_EMBEDDERS[0])}"


def no_detector() -> str:
    """Return why there is no Grounding DINO or OWLv2 model; "" when there is one."""
    if detector_folder() is not None:
        return ""
    return f"That needs a detector of phrases. {where_to_put_all(KNOWN_DETECTORS[0])}"


def no_index(session: Session) -> str:
    """Return why there is no index of the scene; "" when there is one."""
    document = session.document
    if document is None:
        return "No scene is open."
    if _index_file(document).is_file():
        return ""
    return no_embedder() or "There is no index of this scene yet. Use Index this scene first."


def index_state(session: Session) -> str:
    """Return one sentence on what the index knows, or what works without one."""
    document = session.document
    if document is None:
        return "No scene is open."
    found = document.search.measured
    if found is not None and found.problem:
        return found.problem
    if no_index(session):
        shown = paths.shown(models_folder())
        where = "" if embedder_folder() else f" Other nouns need a model in {shown}."
        return f"No index yet. Names, colors, sizes and places are understood without one.{where}"
    if found is None or found.pictures is None:
        return "There is an index of this scene."
    n, n_unknown = len(found.groups), found.n_unknown
    if n_unknown == 0:
        return f"The index knows all {n:,} objects as they are now."
    changed = "1 has" if n_unknown == 1 else f"{n_unknown:,} have"
    return f"{changed} changed since the index of {n:,} objects was made. Index again to know them."


def no_question(session: Session) -> str:
    """Return why the detector cannot be asked now; "" when it can."""
    document = session.document
    if document is None:
        return "No scene is open."
    if not document.read.has_groups():
        return NO_GROUPS
    if not document.search.text.strip():
        return "Type what to look for first."
    job = session.jobs.running
    return "" if job is None else f"{job.title} is still running."


# --- jobs


def index(session: Session) -> None:
    """Index every object that the index does not know yet; cancelling keeps the former index."""
    document = session.need()
    project = document.settled()
    frozen = replace(project, scene=replace(project.scene))

    stage = stages.prepared(
        "Index the objects", lambda: refresh_index(frozen, _load_embedder()), "Loading the model"
    )

    def done(made: GroupIndex) -> None:
        document.search.forget_index()
        session.notify(Level.INFO, f"Indexed {len(made):,} objects: ask for anything by its name.")

    session.jobs.start("Index this scene", stage, on_done=done)


def find_here(session: Session, size: tuple[int, int]) -> None:
    """Find what the text names in the present picture, with a detector."""
    document = session.need()
    search, text = document.search, document.search.text.strip()
    scene = replace(document.settled().scene)
    scale = _LONGEST / max(*size, 1)
    camera = session.rig.camera(max(round(size[0] * scale), 1), max(round(size[1] * scale), 1))

    def stage() -> Stage[Answer]:
        from gaga_core.query.detector import load_detector

        yield Progress("Find in this view", 0, 0, "Loading the detector")
        folder = detector_folder()
        if search.detector is None and folder is not None:
            search.detector = load_detector(folder)
        assert search.detector is not None
        return (yield from find_in_view(scene, [camera], text, search.detector))

    def done(answer: Answer) -> None:
        if session.document is document and search.text.strip() == text:
            search.show_in_view(text, answer, session.objects())

    session.jobs.start("Find in this view", stage(), on_done=done)


def name_all(session: Session) -> None:
    """Name the objects without a name that the index knows with confidence, as one edit."""
    document = session.need()
    project = document.settled()
    scene, before = replace(project.scene), document.history.state_id

    def stage() -> Stage[dict[int, str]]:
        yield Progress("Name the objects", 0, 0, "Loading the model")
        pictures = pictures_of(project, _load_embedder)
        assert pictures is not None  # asked by `no_index`
        yield Progress("Name the objects", 0, 0)
        return suggested_names(scene, pictures)

    def done(names: dict[int, str]) -> None:
        if session.document is not document or document.history.state_id != before:
            session.notify(Level.WARNING, "The scene changed meanwhile, so nothing was named.")
        elif document.do(name_groups(document.scene, names)):
            session.notify(Level.INFO, f"Named {len(names):,} objects. Undo takes it back.")
        else:
            session.notify(Level.HINT, "The index knows no further name with confidence.")

    session.jobs.start("Name the objects", stage(), on_done=done)


def _load_embedder() -> Embedder:
    folder = embedder_folder()
    if folder is None:
        raise GagaError(no_embedder())
    return load_embedder(folder)


def _index_file(document: Document) -> Path:
    return work_of(document.project) / INDEX_FILE
