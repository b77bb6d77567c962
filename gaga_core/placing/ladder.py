"""Placement that tries again: attempts from cheap to thorough, until the photos are placed.

Each attempt has a reason, learned from what the one before left out, and the time that all may
take is bounded. The best of them counts: first one that the checks accept, then the most photos.
"""

import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaga_core.arrays import LongArray
from gaga_core.errors import GagaError
from gaga_core.placing.checks import Verdict, check_model
from gaga_core.placing.diagnosis import Diagnosis, MatchFacts, diagnose
from gaga_core.placing.metrics import SfmFacts, SfmSummary, summarize
from gaga_core.placing.photos import PhotoSet
from gaga_core.placing.sfm import SfmConfig, require_overlap, run_matching, run_step
from gaga_core.progress import Progress, Stage, mapped

# --- Photos of two scenes in one folder: assign each photo to its model.
# A mapping that cannot join its models leaves several. Those that share matches are parts of one
# scene that did not hold together; those that share none are scenes of their own.


_LINK_MATCHES = 30  # verified matches of two photos that show the same place
_FEW_LINKS_SHARE = 0.25  # links between two scenes at most, as a share of the smaller one's photos
_FEWEST_PHOTOS = 5  # photos of a scene of its own


def scenes_of(models: Sequence[SfmFacts]) -> tuple[SfmFacts, ...]:
    """The models that are scenes of their own, largest first, each with its own photos only.

    ``models`` come from one mapping, largest first; all know all photos. A photo that no model
    holds belongs to the one that it has most matches with, or to the first.
    """
    first = models[0]
    chosen = [first]
    for model in models[1:]:
        if len(model.names) >= _FEWEST_PHOTOS and all(_is_apart(model, other) for other in chosen):
            chosen.append(model)
    if len(chosen) == 1:
        return (first,)
    owner = _owners(chosen)
    return tuple(_only(model, owner == i) for i, model in enumerate(chosen))


def _is_apart(a: SfmFacts, b: SfmFacts) -> bool:
    in_a, in_b = (np.isin(np.array(a.all_names), np.array(m.names)) for m in (a, b))
    if (in_a & in_b).any():
        return False
    i, j = a.pairs[a.pair_matches >= _LINK_MATCHES].T
    links = (in_a[i] & in_b[j]) | (in_b[i] & in_a[j])
    return bool(links.sum() <= _FEW_LINKS_SHARE * min(len(a.names), len(b.names)))


def _owners(scenes: Sequence[SfmFacts]) -> LongArray:
    """Index of the scene (A,) that each photo belongs to."""
    first = scenes[0]
    names = np.array(first.all_names)
    member = np.stack([np.isin(names, np.array(scene.names)) for scene in scenes], axis=1)
    votes = np.zeros(member.shape)
    for side, other in ((0, 1), (1, 0)):
        np.add.at(
            votes,
            first.pairs[:, side],
            member[first.pairs[:, other]] * first.pair_matches[:, None],
        )
    votes[member.any(axis=1)] = 0
    return (votes + member).argmax(axis=1)


def _only(facts: SfmFacts, mine: np.ndarray) -> SfmFacts:
    """``facts`` as if there were only the photos ``mine`` (A,)."""
    inside = mine[facts.pairs].all(axis=1)
    index = np.cumsum(mine) - 1
    return replace(
        facts,
        all_names=tuple(name for name, keep in zip(facts.all_names, mine, strict=True) if keep),
        pairs=index[facts.pairs[inside]].astype(np.int64),
        pair_matches=facts.pair_matches[inside],
        model_sizes=np.array([len(facts.names)], np.int64),
    )


STAGE = "Try again"
_MOST_SIDE, _MOST_FEATURES = 3200, 16_384  # pixels and features of the most thorough attempts
_EXHAUSTIVE_PHOTOS = 250  # photos whose pairs are all tried when the likely ones did not do
_HALF_PLACED = 0.5  # share of the photos: a placement of more promises that attempts gain
_UNPROMISING = 0.25  # x the time for all attempts: after that the refusal comes, 5 min at draft
_OF_THE_TIME = 0.5  # share of what is left that a learned model may take
_FAILED = "No attempt placed the photos."
_FAINT_CONTRAST = 0.002  # least contrast of the last attempt
_MAPPERS = {"": "map", "relaxed": "map_relaxed"}


@dataclass(frozen=True)
class LadderConfig:
    """When the attempts end."""

    enough: float = 0.9  # share of the photos that must be placed
    minutes: float = 20.0  # for all attempts together


@dataclass(frozen=True)
class Rung:
    """One attempt to come: what it does, and with what settings."""

    title: str
    config: SfmConfig
    reuses: bool = False  # the features of the attempt before, and its matches
    is_learned: bool = False  # by a model that the person has


@dataclass(frozen=True)
class Placement:
    """Result of an attempt."""

    title: str
    reason: str  # why it was made; "" for the first
    model: Path  # folder of COLMAP's model of the chosen scene
    facts: SfmFacts  # of the chosen scene
    summary: SfmSummary
    verdicts: tuple[Verdict, ...]
    scenes: tuple[tuple[str, ...], ...]  # placed photos of each scene, largest first
    n_photos: int

    @property
    def is_right(self) -> bool:
        """Whether no check refuses it."""
        return all(verdict.level != "error" for verdict in self.verdicts)

    @property
    def placed(self) -> frozenset[str]:
        """Every photo that is placed, in any scene."""
        return frozenset(name for names in self.scenes for name in names)

    @property
    def share(self) -> float:
        """Share of all photos that are placed, in any scene."""
        return sum(len(names) for names in self.scenes) / max(self.n_photos, 1)


@dataclass(frozen=True)
class Ladder:
    """The best placement, and how it was found."""

    best: Placement
    diagnosis: Diagnosis  # of the last attempt
    attempts: tuple[dict[str, object], ...]  # for the report
    out_of_time: bool

    def reasons(self) -> tuple[str, ...]:
        """Known reasons that keep photos out."""
        return self.diagnosis.reasons(self.best.placed) if self.best.share < 1 else ()


# Matches the pairs of photos in folder/pairs.txt for so many seconds at most: writes
# folder/learned.npz, which `worker._learned` adds to the database.
LearnedMatching = Callable[[Path, float], Stage[None]]


def rungs(photos: PhotoSet, config: SfmConfig, *, has_learned: bool = False) -> tuple[Rung, ...]:
    """The attempts for ``photos``, from cheap to thorough; the first is ``config`` itself."""
    n = len(photos.photos)
    few = n <= config.exhaustive_up_to and not photos.ordered
    is_all = config.pairs == "exhaustive" or (config.pairs == "auto" and few)
    more = replace(config, pairs="exhaustive", neighbours=3 * config.neighbours)
    if n > _EXHAUSTIVE_PHOTOS:
        more = replace(more, pairs="similar")
    fine = replace(
        more,
        doubled=True,
        affine=True,
        feature_side=min(2 * config.feature_side, _MOST_SIDE),
        n_features=min(2 * config.n_features, _MOST_FEATURES),
    )
    faint = replace(fine, least_contrast=_FAINT_CONTRAST, guided=True)
    wider = () if is_all else (Rung("more pairs of photos", more, reuses=True),)
    learned = (Rung("matches by a learned model", more, reuses=True, is_learned=True),)
    return (
        Rung("first attempt", config),
        *wider,
        *(learned if has_learned else ()),
        Rung("twice the pixels and features, seen from wider apart", fine),
        Rung("fainter details, matched along epipolar lines", faint),
    )


def place_stage(
    photos: PhotoSet,
    workspace: Path,
    config: SfmConfig,
    *,
    priors: Mapping[str, float] | None = None,  # focal lengths in pixels, where known
    ladder: LadderConfig | None = None,
    scene: int = 1,  # which of several scenes is wanted, by size
    learned: LearnedMatching | None = None,
) -> Stage[Ladder]:
    """Place ``photos``, which lie in workspace/photos, in as many attempts as it takes.

    An attempt that was finished before is not made again. Raises ``GagaError`` when no attempt
    finds a model; its text says what keeps the photos from being placed.
    """
    ladder = ladder or LadderConfig()
    steps = rungs(photos, config, has_learned=learned is not None)
    state = _State(photos, ladder, scene, priors or {})
    state.learned = learned
    for i, rung in enumerate(steps):
        folder = workspace if i == 0 else workspace / f"attempt-{i + 1}"
        if i > 0:
            reason = state.reason()
            yield Progress(STAGE, i, len(steps), f"{reason} Next: {rung.title}.")
            _begin(folder, workspace if i == 1 else workspace / f"attempt-{i}", rung)
        else:
            reason = ""
        label = "" if i == 0 else f" (attempt {i + 1} of {len(steps)}, {state.clock()})"
        turns = state.diagnosis.still  # the attempts before said so
        config = replace(rung.config, moving_only=rung.config.moving_only or turns)
        made = _attempt(state, folder, replace(rung, config=config), reason)
        attempt = mapped(made, _labelled(label))
        yield from attempt
        if state.is_enough or state.out_of_time or state.is_hopeless:
            break
    if state.best is None:
        raise GagaError(state.explain())
    return Ladder(state.best, state.diagnosis, tuple(state.attempts), state.out_of_time)


class _State:
    """Results of the attempts so far."""

    def __init__(
        self, photos: PhotoSet, ladder: LadderConfig, scene: int, priors: Mapping[str, float]
    ) -> None:
        self.photos, self.ladder, self.scene, self.priors = photos, ladder, scene, priors
        self.best: Placement | None = None
        self.diagnosis = Diagnosis((), (), few_features=False, featureless=False, still=False)
        self.attempts: list[dict[str, object]] = []
        self.failure = ""
        self.looked_closely = False  # whether photos seen from wide apart were matched too
        self.learned: LearnedMatching | None = None
        self._start = time.monotonic()

    @property
    def seconds(self) -> float:
        return time.monotonic() - self._start

    @property
    def out_of_time(self) -> bool:
        return self.seconds > 60 * self.minutes

    @property
    def minutes(self) -> float:
        """For all attempts: a part where they placed too little to promise more."""
        best = self.best
        promises = best is not None and best.is_right and best.share > _HALF_PLACED
        return self.ladder.minutes * (1.0 if promises else _UNPROMISING)

    @property
    def is_enough(self) -> bool:
        best = self.best
        if best is None or not best.is_right or best.share < self.ladder.enough:
            return False
        return len(best.scenes) == 1 or self.looked_closely

    @property
    def is_hopeless(self) -> bool:
        """Whether more attempts cannot help.

        They would match objects that look alike again, or be held to a wrong focal length again.
        """
        best = self.best
        if best is not None and best.share >= self.ladder.enough and self.diagnosis.repeated():
            return True
        if best is not None and best.share >= self.ladder.enough and self.priors:
            wrong = {verdict.check for verdict in best.verdicts if verdict.level == "error"}
            return bool(wrong) and wrong <= {"focal", "prior"}
        return False

    def take(self, placement: Placement) -> None:
        """Keep it when it is better than the best."""
        if self.best is None or _rank(placement) > _rank(self.best):
            self.best = placement

    def clock(self) -> str:
        """Share of the time limit that is used up."""
        return f"after {self.seconds / 60:.0f} of {self.minutes:.0f} min at most"

    def reason(self) -> str:
        """Reason for another attempt."""
        best, n = self.best, len(self.photos.photos)
        placed = 0 if best is None else sum(len(names) for names in best.scenes)
        text = f"{placed} of {n} photos are placed."
        if best is not None and not best.is_right and best.share >= self.ladder.enough:
            wrong = next(verdict for verdict in best.verdicts if verdict.level == "error")
            return f"{text} {wrong.text}"
        if best is not None and best.share >= self.ladder.enough:
            return f"{text} They fall into {len(best.scenes)} groups: is it one scene?"
        causes = self.diagnosis.reasons(() if best is None else best.placed)
        return f"{text} {causes[0]}" if causes else text

    def explain(self) -> str:
        """Reason why there is no model at all."""
        repeated = self.diagnosis.repeated()
        return " ".join(
            [self.failure or _FAILED, *([repeated] if repeated else []), *self.diagnosis.reasons()]
        )


def _rank(placement: Placement) -> tuple[bool, int, int, int]:
    return (
        placement.is_right,
        round(placement.share * placement.n_photos),
        -len(placement.scenes),
        len(placement.facts.points),
    )


def _attempt(state: _State, folder: Path, rung: Rung, reason: str) -> Stage[None]:
    """Match as the rung says, then map in one way after another until that is enough."""
    began, n = time.monotonic(), len(state.photos.photos)
    before = state.best
    yield from _until(state, _matching(state, folder, rung))
    if not (folder / "match.finished").is_file():
        return
    state.diagnosis = diagnose(state.photos, MatchFacts.load(folder / "matches.npz"))
    if state.diagnosis.still and not rung.config.moving_only:
        # On a turntable: what stands still tells nothing of how the camera saw the object.
        yield from _until(
            state,
            run_step("verify", state.photos, folder, replace(rung.config, moving_only=True)),
        )
        if not (folder / "verify.finished").is_file():
            return
        state.diagnosis = diagnose(state.photos, MatchFacts.load(folder / "matches.npz"))
    state.looked_closely = rung.config.affine or rung.is_learned
    placed: list[Placement] = []
    try:
        require_overlap(folder, n)
        for mapper, step in _MAPPERS.items():
            if (
                mapper == "relaxed"
                and not placed[0].is_right
                and placed[0].share >= state.ladder.enough
            ):
                continue  # weaker demands do not make a wrong model right
            yield from _until(state, run_step(step, state.photos, folder, rung.config))
            if not (folder / f"{step}.finished").is_file():
                break
            title = f"{rung.title}, {mapper} mapping" if mapper else rung.title
            placed.append(_placement(state, _models_in(folder / mapper), title, reason))
            state.take(max(placed, key=_rank))
            if state.is_enough:
                break
    except GagaError as error:
        state.failure = str(error)
    best = max(placed, key=_rank, default=None)
    state.attempts.append(
        {
            "title": rung.title if best is None else best.title,
            "reason": reason,
            "placed": 0 if best is None else round(best.share * n),
            "passes": best is not None and best.is_right,
            "chosen": state.best is not before and state.best in placed,
            "seconds": round(time.monotonic() - began, 1),
        }
    )


def _matching(state: _State, folder: Path, rung: Rung) -> Stage[None]:
    """Match the photos as the rung says; writes match.finished."""
    finished = folder / "match.finished"
    if not rung.is_learned or state.learned is None:
        yield from run_matching(state.photos, folder, rung.config)
    elif not finished.is_file():
        yield from run_step("likely_pairs", state.photos, folder, rung.config)
        left = 60 * state.minutes - state.seconds
        yield from state.learned(folder, _OF_THE_TIME * left)
        yield from run_step("learned", state.photos, folder, rung.config)
        finished.touch()


def _until(state: _State, stage: Stage[None]) -> Stage[None]:
    """Run ``stage`` until the time is used up; the first attempt in any case to a result."""
    try:
        for step in stage:
            yield step
            if state.out_of_time and (state.best is not None or state.attempts):
                return
    finally:
        stage.close()


def _models_in(folder: Path) -> list[tuple[SfmFacts, Path]]:
    """The models of a mapping and their folders, largest first."""
    numbers = ["", *(f"_{i}" for i in range(2, 9))]
    files = [(folder / f"facts{number}.npz", folder / f"model{number}") for number in numbers]
    return [(SfmFacts.load(file), model) for file, model in files if file.is_file()]


def _placement(
    state: _State, models: Sequence[tuple[SfmFacts, Path]], title: str, reason: str
) -> Placement:
    """Judge the models of one mapping: the scene that is wanted, as it was placed."""
    scenes = scenes_of([facts for facts, _ in models])
    folders = {facts.names: folder for facts, folder in models}
    chosen = scenes[min(state.scene, len(scenes)) - 1]
    summary = summarize(chosen)
    verdicts = check_model(chosen, summary, state.priors)
    repeated = state.diagnosis.repeated()
    if repeated:
        verdicts = (Verdict("repeats", "error", repeated), *verdicts)
    return Placement(
        title=title,
        reason=reason,
        model=folders[chosen.names],
        facts=chosen,
        summary=summary,
        verdicts=verdicts,
        scenes=tuple(facts.names for facts in scenes),
        n_photos=len(state.photos.photos),
    )


def _begin(folder: Path, former: Path, rung: Rung) -> None:
    """Make the folder of an attempt, with the features and matches that it goes on from."""
    folder.mkdir(exist_ok=True)
    if rung.reuses and not (folder / "features.finished").is_file():
        shutil.copyfile(former / "database.db", folder / "database.db")
        (folder / "features.finished").touch()


def _labelled(label: str) -> Callable[[Progress], Progress]:
    def labelled(step: Progress) -> Progress:
        return replace(step, message=f"{step.message}{label}" if step.message else label[2:-1])

    return labelled
