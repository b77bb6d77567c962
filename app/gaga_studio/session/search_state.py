"""What the search box holds: a text, what it means, and what was measured of the scene for it.

Measuring runs in parallel (`JobRunner.start_quiet`) on a snapshot, once for each state of the
scene; typing then needs milliseconds. Nouns that only an index knows are looked up that way, too.
"""

import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.pipeline.search import Description, Pictures, describe, noun_scorer
from gaga_core.progress import Progress, Stage
from gaga_core.query.detector import Detector
from gaga_core.query.group_facts import GroupFacts, group_digests, group_facts
from gaga_core.query.index import n_stale
from gaga_core.query.search import Answer, NounScorer, search_words
from gaga_core.scene.objects import ObjectTable
from gaga_core.scene.scene import Scene, State

_WORD = (1 << 64) - 1
_PAUSE_S = 0.35  # without a key before a noun is looked up: the word may not be complete


@dataclass(frozen=True, eq=False)
class SceneMeasurements:
    """What a search needs to know of one state of a scene."""

    key: object  # of the state
    facts: GroupFacts
    groups: IntArray  # (G,)
    digests: LongArray  # (G,) of what they look like now
    pictures: Pictures | None  # the index next to the project file
    description: Description  # what groups without a name are called, and which are background
    problem: str = ""  # why the index cannot be used

    @property
    def n_unknown(self) -> int:
        """Groups that the index does not know as they are now."""
        return n_stale(self.pictures.index, self.digests) if self.pictures is not None else 0


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
        self.measured: SceneMeasurements | None = None
        self.described: SceneMeasurements | None = None  # by which objects are called now
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
        """How many that fit the filter of the list leaves out."""
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
        if self.measured is None:
            return None
        at = int(np.searchsorted(self.measured.groups, group))
        known = at < len(self.measured.groups) and self.measured.groups[at] == group
        return int(self.measured.digests[at]) & _WORD if known else None

    @property
    def is_measured(self) -> bool:
        """Whether what was measured is the scene as `rests` saw it last."""
        return self.measured is not None and self.measured.key == self._newest[0]

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

    def take(self, measured: SceneMeasurements) -> None:
        """Take what was measured; from any thread."""
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
            shown = {hit.group for hit in hits}
            called = [g for g in _called(table, self.text) if g not in shown]
            if called and not any(hit.fits for hit in hits):
                word = "is" if len(called) == 1 else "are"
                self.sentence = f"{len(called)} {word} called “{self.text.strip()}”."
                hits = []
            hits = [SearchHit(group, 1.0, True) for group in called] + hits
        self._take_hits(tuple(hits))


def measure_stage(
    scene: Scene,
    cameras: Sequence[Camera],
    key: object,
    load: Callable[[], Pictures | None],
    take: Callable[[SceneMeasurements], None],
) -> Stage[None]:
    """Measure a snapshot of a scene and read its index; ``take`` gets the result."""
    yield Progress("Measure the objects", 0, 1)
    facts = group_facts(scene, cameras)
    yield Progress("Measure the objects", 0, 1)
    groups, digests = group_digests(scene)
    try:
        pictures, problem = load(), ""
    except GagaError as error:
        pictures, problem = None, str(error)
    words = describe(scene, facts, cameras, kept=scene.described)
    take(SceneMeasurements(key, facts, groups, digests, pictures, words, problem))


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
