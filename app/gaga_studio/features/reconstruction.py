"""From photos to splats: the offer, the job, its preview, and its question."""

import logging
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from gaga_core.camera import Camera
from gaga_core.errors import GagaError, counted, in_window
from gaga_core.io.folder.scene_folder import find_model, known_world, place_aside
from gaga_core.progress import Progress, Stage, mapped
from gaga_core.scene.camera_path import CameraPath, turntable
from gaga_core.scene.orientation import upright_basis
from gaga_core.scene.project import meant_in
from gaga_studio.features.base import Command, ask, busy
from gaga_studio.session import stages
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level, Request, UserQuestion, choose_one, notifies
from gaga_studio.session.session import Session
from gaga_studio.session.view import TrainingPreview, TrainingUpdate
from gaga_studio.system import paths

if TYPE_CHECKING:
    from gaga_core.gaussians import Gaussians
    from gaga_core.kernels import Part
    from gaga_core.pipeline.reconstruct import Estimate, PhotoFind, Reconstruction
    from gaga_core.pipeline.settings import ReconstructConfig

T = TypeVar("T")
TITLE = "Make splats"
_PARTS: tuple["Part", ...] = ("window", "training")  # of the kernels: what it needs
_STEPS = 1000  # of the job's bar
_LOG = logging.getLogger(__name__)
_ANYWAY, _STOP = "Use it anyway", "Cancel"


@dataclass(frozen=True)
class ReconstructionPlan:
    """The plan of a reconstruction from the photos that were found."""

    config: "ReconstructConfig"
    scene: Path  # folder to write


@dataclass(frozen=True)
class _Refused:
    """The checks do not trust the placement of the photos."""

    finding: str


def why_not(session: Session) -> str:
    """Return why no splats can be made now; "" when they can."""
    if session.photos is None:
        return "No photos without splats are open. Use Start from photos or a film first."
    return busy(session) or too_few(session.photos)


def why_not_meant(session: Session) -> str:
    """Return why no splats can be made of the photos that the sheet is about."""
    found = meant(session)
    return why_not(session) if found is None else busy(session) or too_few(found)


def open_photos(session: Session, path: Path) -> None:
    """Open a video, a recording of a phone, or the folder of a photo."""
    from gaga_core.placing.photos import is_video
    from gaga_core.placing.recordings import is_recording

    is_whole = is_video(path) or is_recording(path) or path.is_dir()
    session.open(path if is_whole else path.parent)


def too_few(found: "PhotoFind") -> str:
    """Return what is missing for splats when there are only a few photos; "" when nothing is."""
    from gaga_core.placing.photos import FEWEST

    if found.is_video or found.is_placed or found.n_photos >= FEWEST:
        return ""
    there = f"There {'is' if found.n_photos == 1 else 'are'} {counted(found.n_photos, 'photo')}"
    return f"{there}; it takes at least {FEWEST} that overlap, and 30 or more for a whole scene."


def plan_of(found: "PhotoFind") -> ReconstructionPlan:
    """Return the default plan: the one that was begun, else a draft."""
    from gaga_core.pipeline.settings import ReconstructConfig

    return ReconstructionPlan(found.going_on or ReconstructConfig(), found.scene)


def title(session: Session) -> str:
    """ "Make splats from 50 photos" or "Continue training"."""
    return title_of(session.photos) if session.photos is not None else "Make splats"


def title_of(found: "PhotoFind") -> str:
    """The same of these photos."""
    if found.going_on is not None:
        return "Continue training"
    plural = "" if found.n_photos == 1 else "s"
    what = "the video" if found.is_video else f"{found.n_photos:,} photo{plural}"
    return f"Train splats on {what}" if found.is_placed else f"Make splats from {what}"


class PhotoFiles:
    """The files of the photos that are open without splats."""

    def __init__(self) -> None:
        self.of: PhotoFind | None = None
        self.files: tuple[Path, ...] = ()
        self.stems: tuple[str, ...] = ()  # that their cameras have; "" = shared by several
        self.of_cameras: tuple[Camera, ...] = ()
        self.cameras: tuple[Camera | None, ...] = ()  # of the files


def photo_files(session: Session) -> tuple[Path, ...]:
    """Return the files of the photos that are open; none of a video, and where there are splats."""
    from gaga_core.placing.photos import list_photos, plain_stem

    kept, found = session.feature(PhotoFiles), meant(session)
    if kept.of is not found:
        kept.of, kept.files, kept.stems = found, (), ()
        if found is not None and not found.is_video:
            folders = (found.photos, found.scene / "images", found.scene)
            for path in folders:
                files = list_photos(path) if path is not None and path.is_dir() else ()
                if path is not None and files:
                    stems = [plain_stem(file, path).lower() for file in files]
                    n_of = Counter(stems)
                    kept.stems = tuple(stem if n_of[stem] == 1 else "" for stem in stems)
                    kept.files = files
                    break
    return kept.files


def photo_cameras(session: Session) -> tuple[Camera | None, ...]:
    """Return the camera of each of `photo_files` while their splats are shown in training; None
    where it is not placed, or another photo has its name."""
    from gaga_core.placing.photos import plain_stem

    files, kept, training = photo_files(session), session.feature(PhotoFiles), session.training
    shown = training.cameras if training is not None and training.scene is not None else ()
    if kept.of_cameras is not shown or len(kept.cameras) != len(files):
        named = {plain_stem(Path(camera.name), Path()).lower(): camera for camera in shown}
        kept.of_cameras, kept.cameras = shown, tuple(named.get(stem) for stem in kept.stems)
    return kept.cameras


class ChosenMasks:
    """The folder of masks of the object that was chosen for the sheet."""

    def __init__(self) -> None:
        self.folder = ""


def choose_masks(session: Session, folder: Path) -> None:
    """Use the masks of this folder, and go back to the sheet."""
    session.feature(ChosenMasks).folder = str(folder)
    session.request = Request.MAKE_SPLATS


def take_chosen_masks(session: Session) -> str:
    """Return the folder that was chosen since the last call; "" for none."""
    chosen = session.feature(ChosenMasks)
    folder, chosen.folder = chosen.folder, ""
    return folder


def found_text(found: "PhotoFind") -> str:
    """Return what was found, in a sentence."""
    if found.going_on is not None:
        share = 100 * found.iteration / found.going_on.train().iterations
        return f"The training of {found.name} stopped at {share:.0f} %. You can continue it."
    if found.is_video:
        about = f"about {found.n_photos} useful frames, more where the camera moves fast"
        return f"{found.name} is a video of {about}."
    if found.is_placed:
        return f"{counted(found.n_photos, 'photo')} with known cameras, no splats yet."
    return (
        f"{counted(found.n_photos, 'photo')}, and no splats yet. {in_window(found.poses)}".strip()
    )


def make(
    session: Session, plan: ReconstructionPlan | None = None, former: TrainingUpdate | None = None
) -> None:
    """Make splats of the photos that are open, as a job that shows them while they are trained.

    A training that goes on shows its ``former`` splats until there are new ones.
    """
    found = session.photos
    if found is None or why_not(session):
        session.notify(Level.WARNING, why_not(session))
        return
    plan = plan or plan_of(found)
    from gaga_core.pipeline.reconstruct import Estimate

    stopped = session.training
    training = TrainingPreview(found.name, plan.config.train().iterations)
    if plan.config != found.going_on:
        former = None
    elif former is None and stopped is not None and stopped.scene is not None:
        kept = stopped.scene.gaussians, stopped.placement
        former = TrainingUpdate(stopped.cameras, (), stopped.update, *kept)
    if former is not None:
        training.take(former)
    known, aside = session.rates, place_aside(plan.scene)
    kernels_s = stages.kernels_seconds(*_PARTS)
    slowdown = known.load.slowdown
    estimate = Estimate(found, plan.config, known.rates, kernels_s=kernels_s, slowdown=slowdown)

    def progress(payload: object) -> None:
        if isinstance(payload, TrainingUpdate) and training.take(payload):
            _frame(session, training.cameras)
            placed = payload.placement
            for note in payload.notes:
                is_told = placed is not None and note in placed.told
                session.notify(Level.INFO if is_told else Level.WARNING, in_window(note))

    def done(result: "Reconstruction | _Refused") -> None:
        if isinstance(result, _Refused):
            _ask(session, plan, result.finding)
            return
        known.keep(estimate.rates())
        session.notify(Level.INFO, _figures(result.report))
        session.training = None
        session.open(plan.scene, then=lambda: _say_where(session, aside))

    def end() -> None:
        if session.training is training:
            known.keep(estimate.rates())
            training.show()
            training.is_stopped = training.update is not None or former is not None
            session.training = training if training.is_stopped else None
            _look_again(session, plan.scene)
            if training.is_stopped and training.keeps:
                keep_stopped(session)

    stage = _stage(found, plan, estimate, former)
    if session.jobs.start(title(session), stage, progress, done, end, resumes=True):
        session.training = training


def _frame(session: Session, cameras: tuple[Camera, ...]) -> None:
    """Show what the placed photos show."""
    eyes = np.array([camera.position for camera in cameras])
    session.rig.frame_scene(eyes.min(axis=0), eyes.max(axis=0), cameras)
    session.active_view = 0


def stop_here(session: Session) -> None:
    """End the training; what is there becomes the scene, and the training can go on later."""
    if session.training is not None:
        session.training.keeps = True
        session.jobs.drop()


class StoppedTraining:
    """The training of the open scene that was stopped, looked for once."""

    def __init__(self) -> None:
        self.of: object = None
        self.found: PhotoFind | None = None


def stopped_training_of(session: Session) -> "PhotoFind | None":
    """Return the training of the open scene that was stopped; None where there is none."""
    kept, document = session.feature(StoppedTraining), session.document
    if kept.of is not document:
        from gaga_core.pipeline.reconstruct import stopped_training

        folder = None if document is None else document.project.folder
        kept.of, kept.found = document, None if folder is None else stopped_training(folder.root)
    return kept.found


def why_not_go_on(session: Session) -> str:
    """Return why no training can go on; "" when one can."""
    if stopped_training_of(session) is None:
        return "The splats of this scene are no training that was stopped."
    return busy(session)


def go_on_title(session: Session) -> str:
    """ "Go on training from 40 %"."""
    found = stopped_training_of(session)
    if found is None or found.going_on is None:
        return "Go on training"
    return f"Go on training from {100 * found.iteration / found.going_on.train().iterations:.0f} %"


def go_on(session: Session) -> None:
    """Go on with the training that was stopped; its end takes the place of the open scene."""
    found, document = stopped_training_of(session), session.document
    if found is None or document is None or document.project.folder is None:
        return
    cameras, gaussians = document.project.folder.cameras, document.scene.gaussians
    former, is_moved = TrainingUpdate(cameras, gaussians=gaussians), bool(document.scene.frame.rows)

    def leave() -> None:
        make(session, former=former)
        if is_moved:  # the training knows nothing of that
            _frame(session, cameras)

    def start() -> None:
        session.leave_for(found, "before the training goes on", leave)

    if not document.read.has_groups():
        start()
        return
    text = (
        "The objects of this scene do not fit the splats that the training will make. Saved, they "
        f"stay in {place_aside(found.scene).name} with these splats; find them again after it."
    )
    session.pending_question = choose_one(text, {"Go on": start})


def why_not_again(session: Session) -> str:
    """Return why no other splats can be made of the photos of the open scene; "" when they can."""
    folder = session.project.folder if session.project is not None else None
    if folder is None or not folder.image_paths:
        return "No scene with photos is open."
    return busy(session)


class PhotosAgain:
    """The photos of the open scene, of which another one is to be made."""

    def __init__(self) -> None:
        self.of: Document | None = None
        self.found: PhotoFind | None = None


def meant(session: Session) -> "PhotoFind | None":
    """Return the photos that the sheet is about: those that are open, else those of the scene."""
    again = session.feature(PhotosAgain)
    is_again = session.document is not None and again.of is session.document
    return session.photos or (again.found if is_again else None)


@notifies
def make_again(session: Session) -> None:
    """Ask how splats are to be made of the photos of the scene once more, in another folder."""
    from gaga_core.pipeline.reconstruct import photos_again

    document = session.need()
    folder = document.project.folder
    found = photos_again(folder.root) if folder is not None else None
    if found is None:
        raise GagaError("The photos of this scene are gone.")
    again = session.feature(PhotosAgain)
    again.of, again.found = document, found
    session.request = Request.MAKE_SPLATS


def make_meant(session: Session, plan: ReconstructionPlan) -> None:
    """Make splats of the photos that the sheet is about; the open scene is closed for it."""
    found = meant(session)
    if found is None or session.photos is not None:
        make(session, plan)
    else:
        session.leave_for(found, "before splats are made again", lambda: make(session, plan))


def _say_where(session: Session, aside: Path) -> None:
    """Tell where the objects of former splats are, if any were set ``aside``."""
    is_saved = meant_in(aside) is not None  # with the splats that it opens with
    if is_saved or (aside / "labels.npz").is_file():
        hint = ": open it to see them" if is_saved else ""
        text = f"The objects of the former splats are in {paths.shown(aside)}{hint}."
        session.notify(Level.INFO, text, shows=aside)


def has_former(session: Session) -> bool:
    """Whether the folder of the training that was stopped has splats of an earlier one."""
    found = session.photos
    return found is not None and find_model(found.scene) is not None


def before_training(session: Session) -> str:
    """What there was before the training that was stopped, in words."""
    return "the scene as it was" if has_former(session) else "the photos"


def leave_stopped(session: Session) -> None:
    """Go back to the scene that the training went on from, else to the photos; the training can
    still be continued."""
    session.training = None
    if session.photos is not None and has_former(session):
        session.open(session.photos.scene)


@notifies
def keep_stopped(session: Session) -> None:
    """Write the splats of a cancelled training as those of the scene folder, and open it."""
    training, found = session.training, session.photos
    if training is None or training.scene is None or found is None:
        return
    from gaga_core.io.cameras.cameras_json import write_cameras_json
    from gaga_core.io.splats.ply import write_ply
    from gaga_core.pipeline.reconstruct import replacing_splats
    from gaga_core.scene.orientation import estimate_up, saying_up

    aside = place_aside(found.scene)
    with replacing_splats(found.scene):
        write_cameras_json(found.scene / "cameras.json", training.cameras)
        up = known_world(found.scene)[1] or estimate_up(training.cameras)
        write_ply(found.scene / "point_cloud.ply", saying_up(training.scene.gaussians, up))
    session.training = None
    session.open(found.scene, then=lambda: _say_where(session, aside))


def _ask(session: Session, plan: ReconstructionPlan, finding: str) -> None:
    def chosen(choice: str) -> None:
        if choice == _ANYWAY:
            make(session, replace(plan, config=replace(plan.config, accept_wrong=True)))

    session.pending_question = UserQuestion(in_window(finding), (_ANYWAY, _STOP), chosen)


@notifies
def _look_again(session: Session, scene: Path) -> None:
    """After a cancel or an error, offer to continue from what is finished."""
    from gaga_core.pipeline.reconstruct import look_at_photos, stopped_training

    if scene.is_dir():
        session.photos = stopped_training(scene) or look_at_photos(scene) or session.photos


def _stage(
    found: "PhotoFind",
    plan: ReconstructionPlan,
    estimate: "Estimate",
    former: TrainingUpdate | None,
) -> "Stage[Reconstruction | _Refused]":
    """`_splats_stage`, whose errors name the window's controls."""

    try:
        return (yield from _splats_stage(found, plan, estimate, former))
    except GagaError as error:
        error.args = (in_window(str(error)),)
        raise


def _splats_stage(
    found: "PhotoFind",
    plan: ReconstructionPlan,
    estimate: "Estimate",
    former: TrainingUpdate | None,
) -> "Stage[Reconstruction | _Refused]":
    # In the job's thread: numba and the reader of photos are a good part of the launch time.
    from gaga_core.io.folder.scene_folder import find_sparse, open_scene_folder
    from gaga_core.pipeline.compile_kernels import after_warm_up
    from gaga_core.pipeline.place import WrongModelError, placement_of, read_entry
    from gaga_core.pipeline.reconstruct import reconstruct_scene

    yield Progress(TITLE, 0, 0, "Preparing")
    yield from mapped(after_warm_up(_nothing(), *_PARTS), _in_steps(estimate))
    config = plan.config
    notes: tuple[str, ...] = ()
    if find_sparse(plan.scene) is None:
        place = reconstruct_scene(found.photos, plan.scene, replace(config, only="sfm"))
        try:
            placed = yield from mapped(place, _in_steps(estimate))
        except WrongModelError as error:
            return _Refused(error.finding)
        notes = placed.notes
    folder = open_scene_folder(plan.scene)
    placement = placement_of(read_entry(plan.scene), folder)
    if former is None:
        gaussians = _begun(plan.scene) if plan.config == found.going_on else None
        gaussians = gaussians or _points(plan.scene)
        former = TrainingUpdate(folder.cameras, gaussians=gaussians)
    seen = replace(former, notes=notes, placement=placement)
    train = reconstruct_scene(None, plan.scene, replace(config, only="all"), again=True)
    try:
        made = yield from mapped(mapped(train, _in_steps(estimate)), _gathered(seen))
    except WrongModelError as error:  # of poses that lay there: the photos contradict them
        return _Refused(error.finding)
    return made


def _begun(scene: Path) -> "Gaussians | None":
    """The splats of the training that goes on."""
    from gaga_core.pipeline.place import WORKSPACE
    from gaga_core.pipeline.reconstruct import CHECKPOINT
    from gaga_core.training.checkpoint import splats_of

    return splats_of(scene / WORKSPACE / CHECKPOINT)


def _points(scene: Path) -> "Gaussians | None":
    """The points of the placed photos as splats: shown until the first ones are trained."""
    from gaga_core.io.cameras.colmap import read_colmap
    from gaga_core.io.folder.scene_folder import find_sparse
    from gaga_core.training.start import initial_gaussians

    sparse = find_sparse(scene)
    if sparse is None:
        return None
    model = read_colmap(sparse)
    try:
        return initial_gaussians(model.points, model.point_colors, opacity=0.9, scale=0.5)
    except GagaError:  # poses without points
        return None


# --- The picture turns around what the photos look at while splats are trained.

_ROUND_S = 40.0  # seconds for once around
_LONGEST_STEP_S = 1.0  # on a slow machine it turns more slowly, and never jumps
_REST_S = 4.0  # before it begins
_SHARE = 0.2  # of the time, at most, for new pictures: the training needs the processor


class Turning:
    """Where the picture of a training was turned to last, and whether a hand has moved it since."""

    def __init__(self) -> None:
        self.begin(None, None)

    def begin(self, training: object, pose: object) -> None:
        """Turn the picture of ``training`` from ``pose`` on, after a rest."""
        self.training = training
        self.pose = pose
        self.is_by_hand = False
        self.rests_s = _REST_S
        self.since_s = 0.0  # since the last picture was begun
        self.path: CameraPath | None = None  # from where it began to turn
        self.at_s = 0.0  # in the path


def turns(session: Session) -> bool:
    """Whether the picture of a training turns: not where it was moved by hand."""
    is_by_hand = session.training is not None and session.feature(Turning).is_by_hand
    return session.settings.turns_in_training and not is_by_hand


def switch_turning(session: Session) -> None:
    """Let the picture of a training turn, from where it is, or stand."""
    wanted, state = not turns(session), session.feature(Turning)
    state.begin(state.training, session.rig.goal)
    state.rests_s = 0.0
    if wanted != session.settings.turns_in_training:
        session.change_settings(replace(session.settings, turns_in_training=wanted))


def tick(session: Session, dt: float, is_drawn: bool, picture_s: float) -> None:
    """Show the newest splats of a training, and turn its picture by what ``dt`` seconds make.

    Both wait until the last picture ``is_drawn``, and until so long after it was begun that it took
    `_SHARE` of the time: ``picture_s`` seconds, with the panels. On a slow machine pictures would
    be begun and never end, and where the processor draws they would slow the training. A move by
    hand ends the turn (`switch_turning` goes on): the picture stays where a person turned it. It
    keeps to where photos were taken from: around a thing at a wall it swings in front of it.
    """
    training, rig, state = session.training, session.rig, session.feature(Turning)
    if training is None or not training.cameras or training.scene is None or training.is_stopped:
        return
    if state.training is not training:
        state.begin(training, rig.goal)
    state.is_by_hand |= rig.goal is not state.pose
    state.since_s += dt
    may_draw = is_drawn and state.since_s * _SHARE >= picture_s
    is_new = may_draw and training.show()
    since_s = state.since_s
    if is_new:
        state.since_s = 0.0
    if not turns(session):
        return
    state.rests_s -= dt
    if state.rests_s > 0 or not may_draw:
        return
    if state.path is None:
        places, basis = np.array([c.position for c in training.cameras]), upright_basis(rig.up)
        path = turntable(rig.shot(), rig.up, _ROUND_S, seen_from=places, basis=basis)
        state.path, state.at_s = path, 0.0
    state.at_s += min(since_s, _LONGEST_STEP_S)
    rig.go_to_shot(state.path.shot(state.at_s % _ROUND_S), animated=False)
    state.pose, state.since_s = rig.pose, 0.0


def _nothing() -> Stage[None]:
    yield from ()


def _in_steps(estimate: "Estimate") -> Callable[[Progress], Progress]:
    """Map progress into a share of the whole job, with the time that is left of it."""

    def change(step: Progress) -> Progress:
        share, left = estimate.follow(step)
        message = f"{step.stage}: {step.message}" if step.message else step.stage
        done = min(int(share * _STEPS), _STEPS - 1)
        return replace(step, stage=TITLE, done=done, total=_STEPS, message=message, left_s=left)

    return change


def seconds_of(session: Session, found: "PhotoFind", plan: ReconstructionPlan) -> float:
    """Seconds that making splats takes on this machine."""
    known, kernels_s = session.rates, stages.kernels_seconds(*_PARTS)
    slowdown = known.load.slowdown
    return max(found.seconds(plan.config, known.rates, kernels_s, slowdown), 1.0)


def _gathered(seen: TrainingUpdate) -> Callable[[Progress], Progress]:
    """Make payloads hold everything so far."""

    def change(step: Progress) -> Progress:
        from gaga_core.training.train import TrainUpdate

        nonlocal seen
        if isinstance(step.payload, TrainUpdate):
            gaussians = step.payload.gaussians or seen.gaussians
            seen = replace(seen, update=step.payload, gaussians=gaussians)
        return replace(step, payload=seen)

    return change


def _figures(report: dict[str, object]) -> str:
    """ "Made 79,983 splats, 32.0 dB on photos that were held out"."""
    train = report.get("train")
    if not isinstance(train, dict):
        return "The splats are made."
    text = f"Made {train.get('splats', 0):,} splats"
    held_out = train.get("held_out")
    if isinstance(held_out, dict) and isinstance(held_out.get("psnr"), float):
        text += f", {held_out['psnr']:.1f} dB on photos that were held out"
    elif train.get("curve"):  # it chose, so it tells nothing
        text += ", chosen by the one photo that was held out"
    kept, n = train.get("kept_iteration"), train.get("iterations")
    if isinstance(kept, int) and isinstance(n, int) and kept < n:
        text += f". They are of iteration {kept:,} of {n:,}: later ones drew held-out photos worse"
    return f"{text}."


def plan_with(plan: ReconstructionPlan, name: str, value: object) -> ReconstructionPlan:
    """Return ``plan`` with another setting; ``GagaError`` for an invalid one.

    0 and "" of a setting that has no value by default are none: as the quality says.
    """
    is_optional = {field.name: field.default for field in fields(plan.config)}[name] is None
    changes: dict[str, object] = {name: (value or None) if is_optional else value}
    if name == "quality" and value != plan.config.quality:
        changes |= {"iterations": None, "max_side": None}
    try:
        return replace(plan, config=replace(plan.config, **changes))  # type: ignore[arg-type]
    except ValueError as error:
        raise GagaError(str(error)) from error


COMMANDS: tuple[Command, ...] = (
    ask("file.open_photos", "Start from photos or a film…", Request.OPEN_PHOTOS, enabled=busy),
    Command("file.make_splats", "Make splats", make, enabled=why_not, describe=title),
    Command(
        "file.go_on_training",
        "Go on training",
        go_on,
        enabled=why_not_go_on,
        describe=go_on_title,
    ),
    Command("file.make_again", "Make splats again…", make_again, enabled=why_not_again),
    Command(
        "view.turn_in_training", "Turn the picture while training", switch_turning, is_on=turns
    ),
    ask("file.make_splats_as", "Make splats as…", Request.MAKE_SPLATS, enabled=why_not),
)
