"""Search the open scene: by words, by an index of pictures, by a detector; name objects."""

import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from gaga_core.arrays import IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError, counted
from gaga_core.pipeline.search import (
    INDEX_FILE,
    Description,
    Pictures,
    describe,
    find_in_view,
    noun_scorer,
    pictures_of,
    refresh_index,
    suggested_names,
    train_views,
    work_of,
)
from gaga_core.progress import Progress, Stage
from gaga_core.query.detector import Detector
from gaga_core.query.embed import (
    KNOWN_DETECTORS,
    KNOWN_EMBEDDERS,
    Embedder,
    find_any,
    load_embedder,
    where_to_put_all,
)
from gaga_core.query.group_facts import GroupFacts, group_digests, group_facts
from gaga_core.query.index import GroupIndex, n_stale
from gaga_core.query.search import Answer, NounScorer, search_words
from gaga_core.scene.edits.objects import name_groups
from gaga_core.scene.objects import ObjectTable
from gaga_core.scene.scene import Scene, State
from gaga_core.segmentation.models.weights import models_folder
from gaga_studio.features import camera as navigation
from gaga_studio.features import selection
from gaga_studio.features.base import Command, ask, busy, first_of, no_groups, no_scene, no_views
from gaga_studio.session import stages
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level, Request
from gaga_studio.session.session import Session
from gaga_studio.system import paths

Kept = Callable[[Session, ObjectTable], frozenset[int] | None]
_WORD = (1 << 64) - 1
_PAUSE_S = 0.35  # without a key before a noun is looked up: the word may not be complete


@dataclass(frozen=True, eq=False)
class Looks:
    """What the objects of one state of a scene look like."""

    key: object  # of the state
    groups: IntArray  # (G,) ascending
    digests: LongArray  # (G,)


@dataclass(frozen=True, eq=False)
class SceneMeasurements:
    """Facts of one state of a scene that a search reads."""

    key: object  # of the state
    facts: GroupFacts
    looks: Looks
    pictures: Pictures | None  # the index next to the project file
    description: Description  # what groups without a name are called, and which are background
    problem: str = ""  # why the index cannot be used

    @cached_property
    def without_words(self) -> tuple[int, ...]:
        """Groups that had a name then."""
        words = self.description.words
        return tuple(g for g in self.facts.ids.tolist() if g and g not in words)

    def describes(self, scene: Scene) -> bool:
        """Whether it has words for all that has no name: not after a name was taken back."""
        return all(group in scene.names for group in self.without_words)

    @property
    def n_unknown(self) -> int:
        """Groups that the index does not know as they are now."""
        return n_stale(self.pictures.index, self.looks.digests) if self.pictures is not None else 0


@dataclass(frozen=True)
class SearchHit:
    """One line of the answer."""

    group: int
    score: float  # 0..1
    fits: bool  # answers the text; else it is only similar


class SearchState:
    """The search of one document. Main thread only; jobs hand over whole values."""

    def __init__(self) -> None:
        self.text = ""
        self.at = 0  # line of the answer that Enter takes
        self._found: tuple[SearchHit, ...] = ()  # what answers the text
        self._kept: frozenset[int] | None = None  # groups that the list's filter keeps
        self.hits: tuple[SearchHit, ...] = ()  # of the former the latter
        self.sentence = ""  # what was understood
        self.unknown: tuple[str, ...] = ()  # words that were not
        self.problem = ""  # why a noun could not be looked up
        self.looks: Looks | None = None  # known before the rest is measured
        self.measured: SceneMeasurements | None = None
        self.described: SceneMeasurements | None = None  # the newest of the scene as it was then
        self.words: dict[int, Mapping[int, str]] = {}  # descriptions by `History.state_id`
        self.detector: Detector | None = None  # the one that was used last, loaded
        self.in_view = ""  # text whose answer came from a detector; "" = from words
        self._camera: Camera | None = None  # from where the text was typed
        self._answered: object = None
        self._asked: set[str] = set()  # nouns that only the index may know
        self._known: set[str] = set()
        self._typed_at = 0.0
        self._state: tuple[object, object] = (None, None)
        self._new_index = 0
        self._newest: tuple[object, float] = (None, 0.0)  # state of the scene, and since when

    def type(self, text: str, camera: Camera | None) -> None:
        """Take a new text; left, right and the like are those of ``camera``."""
        self.text, self._camera = text, camera
        self.at, self.in_view, self.problem = 0, "", ""
        self._asked = set()
        self._typed_at = time.monotonic()
        if not text.strip():
            self.sentence, self._answered = "", None
            self._take_hits(())

    def clear(self) -> None:
        """Empty the search."""
        self.type("", None)

    def move(self, step: int) -> None:
        """Go to another line."""
        self.at = min(max(self.at + step, 0), max(len(self.hits) - 1, 0))

    def keep(self, groups: frozenset[int] | None) -> None:
        """Leave out what is not among ``groups``: the filter of the list; None: it is off."""
        if groups != self._kept:
            self._kept = groups
            self._take_hits(self._found)

    def _take_hits(self, found: tuple[SearchHit, ...]) -> None:
        kept = self._kept
        self._found = found
        self.hits = tuple(hit for hit in found if kept is None or hit.group in kept)
        self.at = min(self.at, max(len(self.hits) - 1, 0))

    @property
    def n_left_out(self) -> int:
        """Number of fitting objects that the filter of the list leaves out."""
        return sum(hit.fits for hit in self._found) - len(self.meant)

    @property
    def meant(self) -> tuple[int, ...]:
        """Groups that fit, the best first."""
        return tuple(hit.group for hit in self.hits if hit.fits)

    # --- measuring

    def key(self, scene: Scene, cameras: Sequence[Camera]) -> object:
        """Return a key that changes with what facts and digests depend on, not the selection."""
        r = scene.revision
        state = (r.splats, r.state)
        if self._state[0] != state:
            gone = np.packbits(scene.has(State.DELETED))
            self._state = (state, zlib.crc32(gone.tobytes()))
        looks = (r.splats, r.labels, r.placement, r.placements)
        return (looks, self._state[1], len(cameras), self._new_index)

    def digest_of(self, group: int) -> int | None:
        """Digest of what a group looked like when it was measured; None if it was not."""
        if self.looks is None:
            return None
        groups, digests = self.looks.groups, self.looks.digests
        at = int(np.searchsorted(groups, group))
        known = at < len(groups) and groups[at] == group
        return int(digests[at]) & _WORD if known else None

    @property
    def has_looks(self) -> bool:
        """Whether digests are those of the scene as `rests` saw it last."""
        return self.looks is not None and self.looks.key == self._newest[0]

    def rests(self, key: object) -> bool:
        """Whether the scene has been in the state ``key`` for a moment: a drag may be over."""
        now = time.monotonic()
        if self._newest[0] != key:
            self._newest = key, now
        return now - self._newest[1] > _PAUSE_S

    def forget_index(self) -> None:
        """Read the file of the index again at the next measurement."""
        self._new_index += 1
        self._known = set()

    def take(self, measured: SceneMeasurements | Looks) -> None:
        """Take what was measured; from any thread."""
        if isinstance(measured, Looks):
            self.looks = measured
        else:
            self.measured = measured

    # --- looking up nouns

    def nouns_to_look_up(self) -> tuple[str, ...]:
        """Nouns of the text that the index may know, after a pause in typing."""
        waits = time.monotonic() - self._typed_at < _PAUSE_S
        if waits or self.problem:
            return ()
        return tuple(sorted(self._asked - self._known))

    @property
    def is_looking_up(self) -> bool:
        """Whether the answer may still change by itself."""
        return bool(self._asked - self._known) and not self.problem

    def know(self, nouns: Sequence[str], problem: str = "") -> None:
        """Note that these nouns have vectors now, or why not; from any thread."""
        self.problem = problem
        if not problem:
            self._known = self._known | set(nouns)

    def _look_up(self, facts: GroupFacts, pictures: Pictures | None) -> NounScorer | None:
        if pictures is None:
            return None
        score = noun_scorer(facts.ids, pictures)
        known = self._known

        def known_only(noun: str) -> "np.ndarray[tuple[int, ...], np.dtype[np.float64]] | None":
            self._asked.add(noun)
            return score(noun) if noun in known else None

        return known_only

    # --- answering

    def answer(self, scene: Scene, table: ObjectTable, cameras: Sequence[Camera]) -> None:
        """Bring the answer up to date; a no-op while nothing changed."""
        found = self.measured
        if not self.text.strip() or self.in_view:
            return
        if found is None:  # names need no measuring
            self._take_hits(
                tuple(SearchHit(group, 1.0, True) for group in _called(table, self.text))
            )
            return
        asked = (self.text, id(self._camera), id(found), scene.revision.names, self._known)
        if asked == self._answered:
            return
        self._answered = asked
        answer = search_words(
            self.text,
            found.facts,
            scene.names,
            described=scene.described,
            camera=self._camera,
            cameras=cameras,
            look_up=self._look_up(found.facts, found.pictures),
        )
        self._show(answer, table)

    def show_in_view(self, text: str, answer: Answer, table: ObjectTable) -> None:
        """Show the answer of a detector to ``text``, until something else is typed."""
        self.in_view = text
        self._show(answer, table)

    def _show(self, answer: Answer, table: ObjectTable) -> None:
        """Show the answer, then objects whose names only contain the text."""
        there = {int(group) for group in table.ids}
        pairs = zip(answer.groups.tolist(), answer.scores.tolist(), strict=True)
        hits = [
            SearchHit(group, score, k < answer.n_meant)
            for k, (group, score) in enumerate(pairs)
            if group in there
        ]
        self.sentence, self.unknown = answer.sentence, answer.unknown
        if not self.in_view:
            shown, named = {hit.group for hit in hits}, _called(table, self.text)
            called = [g for g in named if g not in shown]
            is_of_names = {hit.group for hit in hits if hit.fits} <= set(named)
            if called and is_of_names:  # a word that begins a name is part of others
                called, hits, self.sentence = named, [], ""
            if called:
                more, word = "" if is_of_names else " more", "is" if len(called) == 1 else "are"
                said = f"{len(called)}{more} {word} called “{self.text.strip()}”."
                self.sentence = f"{self.sentence} {said}".strip()
            hits = [SearchHit(group, 1.0, True) for group in called] + hits
        self._take_hits(tuple(hits))


def measure_stage(
    scene: Scene,
    cameras: Sequence[Camera],
    key: object,
    load: Callable[[], Pictures | None],
    take: Callable[[SceneMeasurements | Looks], None],
) -> Stage[None]:
    """Measure a snapshot of a scene and read its index; ``take`` gets the results, looks first:
    pictures of objects need no more, and the rest may wait for kernels."""
    yield Progress("Measure the objects", 0, 1)
    looks = Looks(key, *group_digests(scene))
    take(looks)
    yield Progress("Measure the objects", 0, 1)
    facts = group_facts(scene, cameras)
    try:
        pictures, problem = load(), ""
    except GagaError as error:
        pictures, problem = None, str(error)
    words = describe(scene, facts, cameras, kept=scene.described)
    take(SceneMeasurements(key, facts, looks, pictures, words, problem))


def look_up_stage(
    pictures: Pictures, nouns: Sequence[str], know: Callable[[Sequence[str], str], None]
) -> Stage[None]:
    """Compute the vectors of ``nouns`` that are new, with the index's model, and call ``know``."""
    yield Progress("Look up words", 0, 1, ", ".join(nouns))
    try:
        pictures.texts.anything()
        pictures.texts.nouns(nouns)
    except GagaError as error:
        know(nouns, str(error))
        return
    know(nouns, "")


def _called(table: ObjectTable, text: str) -> list[int]:
    """Groups whose name holds the text, or whose id it is."""
    wanted = text.strip().casefold()
    return [
        int(group)
        for group, name in zip(table.ids, table.names, strict=True)
        if wanted in name.casefold() or wanted == str(group)
    ]


_LONGEST = 800  # longest side, pixels, of the picture for a detector
EXAMPLES = "“red”, “the largest”, “yellow left of the green one”"


# --- every frame


def _subject(session: Session) -> Document | None:
    """The document, None while it has nothing to measure."""
    document = session.document
    if document is None or session.live is not None or session.is_dragging:
        return None
    return document if document.read.has_groups() else None


def answer(session: Session, kept: Kept | None = None) -> None:
    """Update the answer to what is typed: with the search box.

    ``kept`` returns the groups that the filter of the list keeps, None while it is off.
    """
    document = _subject(session)
    if document is None:
        return
    search = document.feature(SearchState)
    if search.text.strip():
        table = session.objects()
        search.keep(kept(session, table) if kept is not None else None)
        search.answer(document.scene, table, train_views(document.project))


def follow(session: Session) -> None:
    """Measure what has changed, describe objects and look up nouns, whatever panels are shown."""
    document = _subject(session)
    if document is None or session.is_previewing:  # what a preview shows is none of its history
        return
    search = document.feature(SearchState)
    is_asked = bool(search.text.strip())
    cameras = train_views(document.project)
    key = search.key(document.scene, cameras)
    measured = search.measured
    is_new = measured is None or measured.key != key or not measured.describes(document.scene)
    rests = search.rests(key)
    _describe(document, None if is_new else measured)
    if session.jobs.quiet is None:
        nouns = search.nouns_to_look_up()
        if is_new:
            # Next to a job only what was edited: a copy has a name and a picture before it ends.
            is_edited = measured is not None
            if is_asked or (rests and (is_edited or session.jobs.running is None)):
                _measure(session, document, cameras, key)
        elif nouns and measured is not None and measured.pictures is not None:
            stage = look_up_stage(measured.pictures, nouns, search.know)
            session.jobs.start_quiet("Look up words", stage)


def _describe(document: Document, measured: SceneMeasurements | None) -> None:
    """Call groups without a name by what was measured of them, once in a state of the history.

    Undo and redo bring back what they were called: descriptions stay where they are still true, so
    a measurement after undo may find other ones.
    """
    search, scene, history = document.feature(SearchState), document.scene, document.history
    if measured is not None:
        search.described = measured
        if history.state_id not in search.words:
            known = {s: search.words[s] for s in history.state_ids if s in search.words}
            search.words = known | {history.state_id: measured.description.words}
    words = search.words.get(history.state_id, scene.described)
    if scene.described != words:
        scene.described = dict(words)
        scene.revision.names += 1


def _measure(session: Session, document: Document, cameras: Sequence[Camera], key: object) -> None:
    snapshot = replace(document.scene)  # columns are never written in place
    project = document.project

    def load() -> Pictures | None:
        return pictures_of(project, _load_embedder)

    stage = measure_stage(snapshot, cameras, key, load, document.feature(SearchState).take)
    session.jobs.start_quiet("Measure the objects", stage)


def type_text(session: Session, text: str, size: tuple[int, int]) -> None:
    """Take the text of the box; left and right are those of the present picture of ``size``."""
    if session.document is not None:
        camera = session.rig.camera(max(size[0], 1), max(size[1], 1))
        session.document.feature(SearchState).type(text, camera)


# --- selecting an answer


def take_hit(session: Session, at: int | None = None, *, flies: bool = True) -> bool:
    """Select the object of a line (default: the current one) and fly to it."""
    if session.document is None:
        return False
    search = session.document.feature(SearchState)
    search.at = search.at if at is None else at
    if not 0 <= search.at < len(search.hits):
        return False
    group = search.hits[search.at].group
    selection.select_groups(session, (group,))
    if flies:
        navigation.frame_group(session, group)
    return True


def take_all(session: Session) -> bool:
    """Select all objects that answer the text."""
    meant = session.document.feature(SearchState).meant if session.document is not None else ()
    if not meant:
        return False
    return selection.select_groups(session, meant)


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
        return no_scene(session)
    if _index_file(document).is_file():
        return ""
    return no_embedder() or "There is no index of this scene yet. Use Index this scene first."


def index_state(session: Session) -> str:
    """Return one sentence on what the index knows, or what works without one."""
    document = session.document
    if document is None:
        return no_scene(session)
    found = document.feature(SearchState).measured
    if found is not None and found.problem:
        return found.problem
    if no_index(session):
        shown = paths.shown(models_folder())
        where = "" if embedder_folder() else f" Other nouns need a model in {shown}."
        return f"No index yet. Names, colors, sizes and places are understood without one.{where}"
    if found is None or found.pictures is None:
        return "There is an index of this scene."
    n, n_unknown = len(found.looks.groups), found.n_unknown
    if n_unknown == 0:
        return f"The index knows all {counted(n, 'object')} as they are now."
    changed = "1 has" if n_unknown == 1 else f"{n_unknown:,} have"
    known = counted(n, "object")
    return f"{changed} changed since the index of {known} was made. Index again to include them."


def no_search(session: Session) -> str:
    """Needs objects, or a task that may find some: what is typed meanwhile is looked for then."""
    return no_scene(session) if session.jobs.running is not None else no_groups(session)


def no_question(session: Session) -> str:
    """Return why the detector cannot be asked now; "" when it can."""
    document = session.document
    if document is None:
        return no_scene(session)
    if not document.read.has_groups():
        return session.no_groups_text
    return (
        busy(session)
        if document.feature(SearchState).text.strip()
        else "Type what to look for first."
    )


# --- jobs


def index(session: Session) -> None:
    """Index every object that the index does not know yet; cancelling keeps the former index."""
    document = session.need()
    project = document.settled()
    frozen = replace(project, scene=replace(project.scene))

    stage = stages.prepared(
        session.rates,
        "Index the objects",
        lambda: refresh_index(frozen, _load_embedder()),
        "Loading the model",
    )

    def done(made: GroupIndex) -> None:
        document.feature(SearchState).forget_index()
        session.notify(
            Level.INFO, f"Indexed {counted(len(made), 'object')}: ask for anything by its name."
        )

    session.jobs.start("Index this scene", stage, on_done=done)


def find_here(session: Session, size: tuple[int, int]) -> None:
    """Find what the text names in the present picture, with a detector."""
    document = session.need()
    search, text = document.feature(SearchState), document.feature(SearchState).text.strip()
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
            session.notify(
                Level.INFO, f"Named {counted(len(names), 'object')}. Undo takes it back."
            )
        else:
            session.notify(Level.HINT, "The index has no further name with enough confidence.")

    session.jobs.start("Name the objects", stage(), on_done=done)


def _load_embedder() -> Embedder:
    folder = embedder_folder()
    if folder is None:
        raise GagaError(no_embedder())
    return load_embedder(folder)


def _index_file(document: Document) -> Path:
    return work_of(document.project) / INDEX_FILE


COMMANDS: tuple[Command, ...] = (
    ask("object.find", "Search objects…", Request.FIND, "Ctrl+F", enabled=no_search),
    ask(
        "object.find_in_view",
        "Find it in this view",
        Request.FIND_IN_VIEW,
        enabled=first_of(no_groups, lambda _: no_detector(), no_question),
    ),
    Command(
        "object.index",
        "Index this scene",
        index,
        enabled=first_of(no_groups, no_views, lambda _: no_embedder()),
    ),
    Command(
        "object.name_all", "Name the objects", name_all, enabled=first_of(no_groups, busy, no_index)
    ),
)
