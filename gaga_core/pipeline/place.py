"""From photos to a checked placement of them in a scene folder.

Photos are examined, placed by structure from motion in as many attempts as it takes, checked, and
undistorted. What is finished of a run that was stopped lies in SCENE/.gaga-reconstruct and is taken
up the next time.
"""

import hashlib
import json
import logging
import re
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from gaga_core.errors import CancelledError, GagaError, option, plain_text
from gaga_core.io.cameras.given import GivenPose, GivenPoses
from gaga_core.io.cameras.poses import find_poses, read_poses
from gaga_core.io.depth_maps import read_depth, write_scene_depth
from gaga_core.io.files import atomic_write, explain_os_error, is_link, refuse_links
from gaga_core.io.folder.lock import forget_owner, note_owner
from gaga_core.io.folder.scene_folder import (
    SceneFolder,
    World,
    read_report_entry,
    with_entry,
    write_world,
)
from gaga_core.io.folder.splits import carry_split
from gaga_core.io.images import read_rgb
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.placing.checks import Verdict
from gaga_core.placing.diagnosis import MatchFacts, chain_breaks
from gaga_core.placing.foreground import (
    Backdrop,
    backdrop_stage,
    masks_from_folder,
    write_masks,
)
from gaga_core.placing.given import (
    Posed,
    entry_of,
    place_given_stage,
    posed_photos,
    report_of,
    told,
    warned,
    write_given,
)
from gaga_core.placing.ladder import Ladder, place_stage
from gaga_core.placing.metrics import SfmFacts
from gaga_core.placing.photos import (
    DEPTH_MAPS,
    MASKS,
    PhotoSet,
    check_prepared,
    ignored_files,
    is_video,
    list_photos,
    prepare_photos,
    read_photo_set,
    unread_kinds,
)
from gaga_core.placing.recordings import is_recording, unpack_stage
from gaga_core.placing.sfm import MATCH_SIDE, pictures_of, run_matching, run_step
from gaga_core.placing.undistort import ORIGINALS, require_room, undistort_into, write_upright
from gaga_core.placing.video import (
    extract_frames,
    extract_more_frames,
    extract_moving_frames,
    shows_all_directions,
)
from gaga_core.progress import Progress, Stage
from gaga_core.scene.orientation import up_of_rotations, upright_basis
from gaga_core.segmentation.models.catalogue import MATCHER
from gaga_core.segmentation.models.weights import find_model

_LOG = logging.getLogger(__name__)

# --- The photos of a reconstruction, in its workspace: from a folder, or frames of a film.


_PREPARED_SIDE = 3200  # pixels: larger photos bring nothing to the matching
_ROUNDS = 2  # times that more frames are taken where the chain breaks


def photo_set_stage(
    source: Path, workspace: Path, config: ReconstructConfig, given: GivenPoses | None = None
) -> Stage[PhotoSet]:
    """The photos of ``source``, a folder or a film, ready in workspace/photos, with their masks.

    What was made ready before is read. Raises ``GagaError`` when there are too few.
    """
    file = workspace / "photos.json"
    if file.is_file():
        found = read_photo_set(file)
        check_prepared(found, workspace)
        return found
    if is_video(source):
        found = yield from _film(source, workspace, config)
    else:
        others = (*unread_kinds(source), *ignored_files(source))
        found = yield from _prepared(list_photos(source), workspace, source, config, others=others)
    shutil.rmtree(workspace / "frames", ignore_errors=True)
    if config.foreground is not None:
        yield from masks_from_folder(found, Path(config.foreground), workspace / MASKS)
    elif given is not None and given.has_masks:
        masks = {n: (p.mask, p.turns) for n, p in _by_photo(found, given, source) if p.mask}
        yield from write_masks(found, masks, workspace / MASKS)
    with atomic_write(file) as temporary:
        temporary.write_text(json.dumps(found.to_json()), encoding="utf-8")
    return found


def _by_photo(photos: PhotoSet, given: GivenPoses, source: Path) -> Iterator[tuple[str, GivenPose]]:
    """The prepared photos, but for views of panoramas, with what is given of them."""
    poses = {(source / pose.name).resolve(): pose for pose in given.poses}
    for photo in photos.photos:
        pose = poses.get(Path(photo.source).resolve())
        if pose is not None and photo.view is None:
            yield photo.name, pose


def _prepared(
    sources: Sequence[Path],
    workspace: Path,
    root: Path,
    config: ReconstructConfig,
    *,
    ordered: bool = False,
    panoramas: bool = False,
    others: Sequence[str] = (),
) -> Stage[PhotoSet]:
    shutil.rmtree(workspace / "photos", ignore_errors=True)
    return (
        yield from prepare_photos(
            sources,
            workspace / "photos",
            root=root,
            longest_side=_PREPARED_SIDE,
            focal=config.focal,
            ordered=ordered,
            panoramas=panoramas,
            others=others,
        )
    )


def _film(video: Path, workspace: Path, config: ReconstructConfig) -> Stage[PhotoSet]:
    """Frames by the clock where a person says so, else as the film moves.

    Where two neighbours share no matches, frames between them are added and matched again; not of
    360 degrees, where neighbours see the same.
    """
    root = workspace / "frames"
    shutil.rmtree(root, ignore_errors=True)
    is_round = yield from shows_all_directions(video)
    side = 4 * _PREPARED_SIDE if is_round else _PREPARED_SIDE
    prepare = partial(
        _prepared, workspace=workspace, root=root, config=config, ordered=True, panoramas=is_round
    )
    if config.video_fps is not None:
        paths = yield from extract_frames(video, root, fps=config.video_fps, longest_side=side)
        return (yield from prepare(paths))
    frames = yield from extract_moving_frames(video, root, longest_side=side)
    found = yield from prepare(frames.paths)
    for _ in range(0 if config.object_only or is_round else _ROUNDS):
        yield from run_matching(found, workspace, config.sfm())
        place = {path.stem: i for i, path in enumerate(frames.paths)}
        breaks = chain_breaks(MatchFacts.load(workspace / "matches.npz"))
        gaps = [(place[Path(a).stem], place[Path(b).stem]) for a, b in breaks]
        more = yield from extract_more_frames(video, root, frames, gaps, longest_side=side)
        if more is frames:
            break
        frames = more
        for mark in workspace.glob("*.finished"):
            mark.unlink()
        found = yield from prepare(frames.paths)
    return found


# --- The report of a placement: placed and left out photos with reasons, and their links.


_LINKED = 15  # verified matches that link two photos
_MOST_LINKS = 3000  # in the report, the strongest


_Index = Annotated[int, msgspec.Meta(ge=0)]


class _Given(msgspec.Struct, frozen=True):
    """What is said of given poses and is no warning."""

    told: list[str] = []


class _Placement(msgspec.Struct, frozen=True):
    """What is read again of the entry "sfm" of a report."""

    names: list[str]
    why_out: dict[str, str]
    links: list[tuple[_Index, _Index, _Index]]  # photo, photo, verified matches
    given: _Given = _Given()


class _Check(msgspec.Struct, frozen=True):
    """A verdict of the checks."""

    text: str


class _Remarks(msgspec.Struct, frozen=True):
    """What a person should know, in the same entry."""

    notes: list[str] = []
    checks: list[_Check] = []


@dataclass(frozen=True)
class PlacementReport:
    """A placement as the window shows it. A photos."""

    names: tuple[str, ...]  # (A,) every photo, by name
    left_out: Mapping[str, str]  # names of those without a place, and why
    links: tuple[tuple[int, int, int], ...]  # photo, photo, verified matches
    cut_out: tuple[Path, Path] | None = None  # a photo whose background is left out, and its mask
    told: tuple[str, ...] = ()  # those of the notes that are no warnings

    @property
    def n_placed(self) -> int:
        """Photos that have a place."""
        return len(self.names) - len(self.left_out)


def placement_of(
    entry: Mapping[str, object], folder: SceneFolder | None = None
) -> PlacementReport | None:
    """The placement in the entry "reconstruct" of a report; None where there is none in it.

    Its example of a photo without background is of ``folder``.
    """
    try:
        sfm = msgspec.convert(entry.get("sfm"), _Placement)
    except ValueError:  # none, of an older version, or damaged
        return None
    known = set(sfm.names)
    out = {name: why for name, why in sfm.why_out.items() if name in known}
    inside = [link for link in sfm.links if max(link[:2]) < len(sfm.names)]
    images, masks = ({}, {}) if folder is None else (folder.image_paths, folder.foreground)
    both = [(images[name], mask) for name, mask in masks.items() if name in images]
    example = both[len(both) // 2] if both else None
    return PlacementReport(tuple(sfm.names), out, tuple(inside), example, tuple(sfm.given.told))


def sfm_entry(
    source: Path, photos: PhotoSet, made: Ladder, backdrop: Backdrop | None = None
) -> dict[str, object]:
    """The entry "sfm" of the report: figures, checks, attempts, and the graph of the pairs."""
    best = made.best
    placed = set(best.facts.names)
    left_out = [photo.name for photo in photos.photos if photo.name not in placed]
    return best.summary.to_json() | {
        "source": str(source.absolute()),
        "left_out": left_out,
        "why_out": {name: made.diagnosis.why_out(name, made.best.placed) for name in left_out},
        "names": list(best.facts.all_names),
        "links": _links(best.facts),
        "notes": [
            *photos.notes,
            *((backdrop.note,) if backdrop else ()),
            *_scene_notes(made, placed),
            *made.reasons(),
        ],
        "backdrop": None if backdrop is None else asdict(backdrop),
        "checks": [asdict(verdict) for verdict in best.verdicts],
        "attempts": list(made.attempts),
        "scenes": [list(names) for names in best.scenes],
        "blurred": list(made.diagnosis.blurred),
    }


def _links(facts: SfmFacts) -> list[list[int]]:
    """The strongest links (photo, photo, matches), indices into ``facts.all_names``."""
    order = np.argsort(-facts.pair_matches, kind="stable")[:_MOST_LINKS]
    chosen = order[facts.pair_matches[order] >= _LINKED]
    rows = np.c_[facts.pairs[chosen], facts.pair_matches[chosen]]
    return rows.tolist()


def notes_of(entry: Mapping[str, object]) -> tuple[str, ...]:
    """What a person should know of the entry "sfm" of a report: left out photos, warnings."""
    try:
        remarks = msgspec.convert(entry, _Remarks)
    except ValueError:  # damaged: nothing is known
        return ()
    return (*remarks.notes, *(check.text for check in remarks.checks))


def _scene_notes(made: Ladder, placed: set[str]) -> list[str]:
    """Which photos show other scenes, and how to get those."""
    found = []
    for i, names in enumerate(made.best.scenes, start=1):
        if not placed & set(names):
            listed = ", ".join(names[:3]) + (" ..." if len(names) > 3 else "")
            found.append(
                f"{len(names)} photos show another scene, which is not in this one: {listed}. "
                f"{option('--scene', str(i))} with another scene folder makes it. If it is the "
                "same place, add photos in between."
            )
    return found


WORKSPACE = ".gaga-reconstruct"
GIVEN = "by_poses"  # folder in it
_PICTURE_SIDE = 1600  # pixels of the pictures in a scene folder (Kerbl 2023)


class WrongModelError(GagaError):
    """The checks refuse the placement of the photos; ``finding`` says why and what to try."""

    def __init__(self, finding: str) -> None:
        super().__init__(f"{finding} (--accept-wrong keeps it anyway.)")
        self.finding = finding


def find_photos(scene: Path) -> Path | None:
    """The photos of a scene folder: input/, images/, or the one video in it; None without any."""
    for folder in (scene / ORIGINALS, scene / "images"):
        if folder.is_dir() and list_photos(folder):
            return folder
    videos = [path for path in sorted(scene.iterdir()) if is_video(path)] if scene.is_dir() else []
    return videos[0] if len(videos) == 1 else None


def place_photos(
    photos: Path | None, scene: Path, config: ReconstructConfig
) -> Stage[tuple[str, ...]]:
    """Photos -> checked COLMAP model and undistorted pictures in ``scene``; returns notes."""
    source = photos or find_photos(scene)
    if source is None:
        raise GagaError(f"There are no photos in {scene}. Put them into {scene / 'images'}.")
    start, existed = time.perf_counter(), scene.exists()
    workspace = scene / WORKSPACE
    try:
        if is_recording(source):
            yield from unpack_stage(source, scene / ORIGINALS)
            source = scene / ORIGINALS
        given = _given_poses(source, config)
        _claim(workspace, _fingerprint(source, config, given))
        note_owner(workspace)
        photos_there = list_photos(source) if source.is_dir() else ()
        files = [path.relative_to(source).as_posix() for path in photos_there]
        require_room(scene, source, workspace)
        has_masks = config.foreground is not None or (given is not None and given.has_masks)
        if not has_masks:  # found by a run that was stopped: features need none
            shutil.rmtree(workspace / MASKS, ignore_errors=True)
        found = yield from photo_set_stage(source, workspace, config, given)
        posed = None if given is None else posed_photos(found, given, source, config.sfm())
        made = yield from _placed(found, posed, workspace, config)
        _require(made, config)
        if made.best.model != workspace / "model":  # where the next step looks for it
            shutil.rmtree(workspace / "model", ignore_errors=True)
            shutil.copytree(made.best.model, workspace / "model")
        if posed is not None and not _is_by_poses(made, workspace):
            write_given(workspace, posed.names, posed.poses, refine=False)
            yield from run_step("to_given", found, workspace, config.sfm())
        if posed is None:
            write_upright(
                workspace, upright_basis(up_of_rotations(made.best.facts.poses[:, :, :3]))
            )
        backdrop = None
        if not has_masks:
            is_static = config.turntable or made.diagnosis.still
            backdrop = yield from backdrop_stage(
                found,
                workspace / "photos",
                made.best.facts,
                workspace / MASKS,
                is_static=is_static,
            )
        if given is not None and given.is_metric:
            yield from _depth_stage(found, given, source, workspace / DEPTH_MAPS)
        side = max(_PICTURE_SIDE, config.max_side or 0)
        yield from undistort_into(
            scene, found, workspace, config.sfm(), longest_side=side, replaces=source
        )
        carry_split(source, scene)
    except OSError as error:
        raise GagaError(explain_os_error(error, scene)) from error
    finally:
        forget_owner(workspace)
        if not (workspace / "photos.json").is_file():
            shutil.rmtree(workspace, ignore_errors=True)
            if not existed and scene.is_dir() and not any(scene.iterdir()):
                scene.rmdir()
    entry = sfm_entry(source, found, made, backdrop) | {"files": files}
    if given is not None and posed is not None:
        entry |= _given_entry(given, posed, entry, made, workspace, config)
        write_world(scene, World(given.is_metric, given.up, given.program))
    write_entry(scene, {"sfm": entry | {"seconds": round(time.perf_counter() - start, 1)}})
    shutil.rmtree(workspace, ignore_errors=True)
    return notes_of(entry)


def _depth_stage(photos: PhotoSet, given: GivenPoses, source: Path, target: Path) -> Stage[None]:
    """Write the given depth of the photos, upright: NAME.jpg.png in the form of a scene's depth."""
    target.mkdir(exist_ok=True)
    found = [(name, pose) for name, pose in _by_photo(photos, given, source) if pose.depth]
    for i, (name, pose) in enumerate(found):
        yield Progress("Read depth", i, len(found), name)
        assert pose.depth is not None
        depth = np.rot90(read_depth(pose.depth), -pose.turns)
        write_scene_depth(target / f"{name}.png", depth)


def _given_poses(source: Path, config: ReconstructConfig) -> GivenPoses | None:
    """The poses that are to be used, if there are some."""
    if config.poses == "ignore" or not source.is_dir():
        return None
    named = config.poses_from
    given = find_poses(source) if named is None else read_poses(Path(named), source)
    if given is not None and config.poses == "keep" and any(p.lens is None for p in given.poses):
        raise GagaError(
            f"{given.file} says nothing of the lens, so its poses cannot be kept as they are. "
            f"{option('--poses', 'refine')} finds it."
        )
    if given is not None:
        # At once, in the terminal; a window says it of the notes, where it is no warning.
        said = f"{given.told} ({option('--poses', config.poses)})."
        _LOG.warning("%s", plain_text(said))
    return given


def _placed(
    found: PhotoSet, posed: Posed | None, workspace: Path, config: ReconstructConfig
) -> Stage[Ladder]:
    """Place by the given poses; where that fails and they may change, as without any."""
    sfm, model = config.sfm(), find_model(MATCHER)
    if posed is not None and config.poses in ("keep", "refine"):
        refine = config.poses == "refine"
        try:
            made = yield from place_given_stage(posed, workspace / GIVEN, sfm, refine=refine)
            if made.best.is_right or not refine:
                return made
        except GagaError as error:
            if not refine or isinstance(error, CancelledError):
                raise
    try:
        return (
            yield from place_stage(
                found,
                workspace,
                sfm,
                priors={p.name: p.focal for p in found.photos if p.focal is not None},
                ladder=config.ladder(),
                scene=config.scene,
                learned=None if model is None else partial(_match_learned, model),
            )
        )
    except GagaError as error:
        if isinstance(error, CancelledError) or not (advice := _advice()):
            raise
        raise GagaError(" ".join((str(error), *advice))) from error


_MATCHES = "Match photos"


def _advice(made: Ladder | None = None) -> tuple[str, ...]:
    """The model that would help, for those who do not have it, where photos are not placed."""
    is_placed = made is not None and made.best.is_right and made.best.share == 1
    if is_placed or find_model(MATCHER) is not None:
        return ()
    return (
        f"Matches by a learned model may help: gaga models get {MATCHER.name} (Models in the "
        f"window), {MATCHER.megabytes} MB, {MATCHER.licence}.",
    )


def _match_learned(model: Path, workspace: Path, seconds: float) -> Stage[None]:
    """Match the photos of workspace/pairs.txt by a learned model: writes learned.npz.

    names (Q, 2), counts (Q,) of matches, places (M, 2, 2) xy over width and height, scores (M,).
    """
    # Loaded when it is its turn: torch takes seconds.
    from gaga_core.segmentation.matches import load_matcher

    yield Progress(_MATCHES, 0, 0, "load the model")
    matcher, end = load_matcher(model, MATCH_SIDE), time.monotonic() + seconds
    pairs = [line.split() for line in (workspace / "pairs.txt").read_text().splitlines()]
    pictures = pictures_of(workspace)
    counts, places, scores = list[int](), [np.zeros((0, 2, 2))], [np.zeros(0, np.float32)]
    for i, (a, b) in enumerate(pairs):
        yield Progress(_MATCHES, i, len(pairs), f"{a}, {b}")
        if time.monotonic() > end:
            break
        first, second = (read_rgb(pictures / name) for name in (a, b))
        found = matcher.match(first, second)
        shares = [found.first / first.shape[1::-1], found.second / second.shape[1::-1]]
        counts.append(len(found.scores))
        places.append(np.stack(shares, axis=1))
        scores.append(found.scores)
    names = np.array(pairs[: len(counts)], np.str_).reshape(-1, 2)
    with atomic_write(workspace / "learned.npz") as temporary, temporary.open("wb") as file:
        np.savez(
            file,
            names=names,
            counts=np.array(counts, np.int64),
            places=np.concatenate(places),
            scores=np.concatenate(scores),
        )


def _is_by_poses(made: Ladder, workspace: Path) -> bool:
    return made.best.model.is_relative_to(workspace / GIVEN)


def _given_entry(
    given: GivenPoses,
    posed: Posed,
    entry: Mapping[str, object],
    made: Ladder,
    workspace: Path,
    config: ReconstructConfig,
) -> dict[str, object]:
    """What the report says of given poses: figures, and sentences before the other notes."""
    by_poses = _is_by_poses(made, workspace)
    report = report_of(workspace / GIVEN if by_poses else workspace)
    mode = config.poses if by_poses or config.poses == "scale" else "scale"
    said, notes = told(given, mode, report), warned(given)
    if mode != config.poses:
        notes.append("The photos contradict the given poses, so they were placed as without any.")
    left_out = dict.fromkeys(posed.without, "no pose is given") if by_poses else {}
    why, names = entry["why_out"], entry["names"]
    assert isinstance(why, dict)
    assert isinstance(names, list)
    before = entry["notes"]
    assert isinstance(before, list)
    return {
        "given": {**entry_of(given, mode, report, posed.without), "told": said},
        "notes": [*said, *notes, *before],
        "why_out": {**why, **left_out},
        "names": [*names, *(name for name in left_out if name not in names)],
    }


def read_entry(scene: Path) -> dict[str, object]:
    """The entry "reconstruct" of the scene's report.json; empty when there is none."""
    path = scene / "gaga" / "report.json"
    return read_report_entry(path, "reconstruct", dict[str, object]) or {}


def write_entry(scene: Path, values: dict[str, object]) -> None:
    """Add ``values`` to that entry."""
    path = scene / "gaga" / "report.json"
    text = with_entry(path, "reconstruct", read_entry(scene) | values)
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _claim(workspace: Path, fingerprint: str) -> None:
    """Make the workspace this task's: what another left in it is removed, and what has links."""
    refuse_links(workspace)
    mark = workspace / "task"
    is_own = mark.is_file() and mark.read_text(encoding="ascii", errors="replace") == fingerprint
    if not is_own or any(map(is_link, workspace.rglob("*"))):
        shutil.rmtree(workspace, ignore_errors=True)
        workspace.mkdir(parents=True)
        mark.write_text(fingerprint, encoding="ascii")


def _fingerprint(source: Path, config: ReconstructConfig, given: GivenPoses | None) -> str:
    """Digest of the photos' names, sizes and times and of what changes their places."""
    files: Sequence[Path] = (source,) if source.is_file() else list_photos(source)
    stats = [(path.name, path.stat().st_size, path.stat().st_mtime_ns) for path in files]
    settings = asdict(replace(config.sfm(), threads=0))
    masks = None if config.foreground is None else str(Path(config.foreground).absolute())
    poses = [config.poses, *([] if given is None else map(_words_of, given.poses))]
    task = [stats, settings, config.focal, config.video_fps, masks, poses, str(find_model(MATCHER))]
    return hashlib.sha256(json.dumps(task).encode()).hexdigest()


def _words_of(pose: GivenPose) -> str:
    return f"{pose.name} {pose.lens} {pose.cam_from_world.tolist()} {pose.mask} {pose.depth}"


def _require(made: Ladder, config: ReconstructConfig) -> None:
    """``GagaError`` unless the best placement may be used."""
    best = made.best
    if config.scene > len(best.scenes):
        n = len(best.scenes)
        raise GagaError(
            f"--scene {config.scene}: the placed photos show "
            f"{'one scene' if n == 1 else f'{n} scenes'} only. "
            "Leave --scene out, or give a smaller number."
        )
    late = f"The time for placing was used up; {option('--place-minutes')} gives more."
    why = (*made.reasons(), *((late,) if made.out_of_time else ()), *_advice(made))
    refuse(best.verdicts, "The model of these photos is not to be trusted.", config, why)


def refuse(
    verdicts: Sequence[Verdict],
    title: str,
    config: ReconstructConfig,
    reasons: Sequence[str] = (),
) -> None:
    """`WrongModelError` when a verdict is an error and the settings do not accept it."""
    errors = [verdict.text for verdict in verdicts if verdict.level == "error"]
    if errors and not config.accept_wrong:
        text = " ".join((title, *errors, *reasons))
        sentences = dict.fromkeys(re.split(r"(?<=\.) (?=[A-Z])", text))  # one advice of several
        raise WrongModelError(" ".join(sentences))
