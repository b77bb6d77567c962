"""Photos placed by poses that another program gave: kept, refined, or for their scale only.

Features are matched between photos whose poses say that they may overlap, and triangulated with
the poses as they are; *refine* adjusts them from there. Matches of a tenth of the features take no
part in it: by their distance from the epipolar lines it is decided whether the refined poses are
better, and those that were given stay where they are not.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.errors import GagaError
from gaga_core.io.cameras.given import GivenPoses, Lens
from gaga_core.io.json_file import read_json
from gaga_core.placing.checks import check_model
from gaga_core.placing.diagnosis import MatchFacts, diagnose
from gaga_core.placing.ladder import Ladder, Placement
from gaga_core.placing.metrics import SfmFacts, summarize
from gaga_core.placing.photos import FEWEST, PhotoSet
from gaga_core.placing.poses import pairs_by_pose
from gaga_core.placing.sfm import (
    CameraGroup,
    SfmConfig,
    require_overlap,
    run_matching,
    run_step,
)
from gaga_core.progress import Stage

PosesMode = Literal["keep", "refine", "scale", "ignore"]
_NEIGHBOURS = 10  # photos that each is matched with: 8 and 16 gave as many points on fox


class GivenReport(msgspec.Struct, frozen=True):
    """What the worker says: pixels off the epipolar lines of held-out matches, and the choice."""

    given: float
    refined: float | None
    is_refined: bool
    moved: float = 0.0  # median way of a camera, units of the given world
    moved_most: float = 0.0
    turned: float = 0.0  # median, degrees
    turned_most: float = 0.0


@dataclass(frozen=True, eq=False)
class Posed:
    """Prepared photos that have a given pose."""

    photos: PhotoSet  # those with a pose only
    groups: tuple[CameraGroup, ...]
    names: tuple[str, ...]
    poses: DoubleArray  # (V, 3, 4) cam_from_world
    without: tuple[str, ...]  # prepared photos without a pose


def posed_photos(photos: PhotoSet, given: GivenPoses, root: Path, config: SfmConfig) -> Posed:
    """Match the prepared ``photos`` of ``root`` with their poses. ``GagaError``: too few have one.

    A photo whose lens is not known has that of its EXIF, to be estimated.
    """
    by_source = {(root / pose.name).resolve(): pose for pose in given.poses}
    found = [(p, by_source.get(Path(p.source).resolve())) for p in photos.photos]
    with_pose = [(photo, pose) for photo, pose in found if pose is not None]
    without = tuple(photo.name for photo, pose in found if pose is None)
    if len(with_pose) < FEWEST:
        raise GagaError(
            f"{given.file} has poses of {len(with_pose)} of the {len(found)} photos only. Give the "
            "poses of these photos, or --poses ignore."
        )
    groups: dict[tuple[object, ...], list[str]] = {}
    for photo, pose in with_pose:
        lens = pose.lens
        if lens is not None:
            lens = lens.resized(photo.width, photo.height)
        focal = None if lens is not None else photo.focal
        groups.setdefault((lens, photo.width, photo.height, focal), []).append(photo.name)
    return Posed(
        replace(photos, photos=tuple(photo for photo, _ in with_pose)),
        tuple(_group(key, names, config) for key, names in groups.items()),
        tuple(photo.name for photo, _ in with_pose),
        np.array([pose.cam_from_world[:3] for _, pose in with_pose], np.float64),
        without,
    )


def _group(key: tuple[object, ...], names: Sequence[str], config: SfmConfig) -> CameraGroup:
    lens, width, height, focal = key
    assert isinstance(width, int)
    assert isinstance(height, int)
    if isinstance(lens, Lens):
        params = tuple(float(p) for p in lens.params)
        return CameraGroup(tuple(names), width, height, None, lens.model, params)
    assert focal is None or isinstance(focal, float)
    model = "SIMPLE_RADIAL" if config.camera_model == "auto" else config.camera_model
    return CameraGroup(tuple(names), width, height, focal, model)


def place_given_stage(
    posed: Posed, workspace: Path, config: SfmConfig, *, refine: bool
) -> Stage[Ladder]:
    """Triangulate with the poses, refine them if wanted; the result is judged as any placement.

    Writes workspace/given/model. Raises ``GagaError`` when no two photos match.
    """
    pairs = pairs_by_pose(
        posed.poses, config.neighbours if config.pairs == "exhaustive" else _NEIGHBOURS
    )
    lines = [f"{posed.names[i]} {posed.names[j]}\n" for i, j in pairs]
    workspace.mkdir(parents=True, exist_ok=True)
    (workspace / "pairs.txt").write_text("".join(lines), encoding="utf-8")
    write_given(workspace, posed.names, posed.poses, refine=refine)
    config = replace(config, pairs="listed")
    photos, groups = posed.photos, posed.groups
    yield from run_matching(photos, workspace, config, groups=groups)
    require_overlap(workspace, len(photos.photos))
    yield from run_step("given", photos, workspace, config, groups=groups)
    facts = SfmFacts.load(workspace / "given" / "facts.npz")
    summary = summarize(facts)
    title = "the given poses" + (", refined" if report_of(workspace).is_refined else "")
    placement = Placement(
        title=title,
        reason="",
        model=workspace / "given" / "model",
        facts=facts,
        summary=summary,
        verdicts=check_model(facts, summary, {}),
        scenes=(facts.names,),
        n_photos=len(photos.photos),
    )
    diagnosis = diagnose(photos, MatchFacts.load(workspace / "matches.npz"))
    attempt: dict[str, object] = {
        "title": title,
        "reason": "",
        "placed": len(facts.names),
        "passes": placement.is_right,
        "chosen": True,
    }
    return Ladder(placement, diagnosis, (attempt,), out_of_time=False)


def write_given(workspace: Path, names: Sequence[str], poses: DoubleArray, *, refine: bool) -> None:
    """Write what the worker reads of the poses."""
    rows = poses.reshape(len(poses), 12).tolist()
    text = json.dumps({"names": list(names), "poses": rows, "refine": refine})
    (workspace / "poses.json").write_text(text, encoding="utf-8")


def report_of(workspace: Path) -> GivenReport:
    """What the worker found out about the poses."""
    return read_json(workspace / "given" / "report.json", GivenReport, "Remove it and run again.")


def entry_of(
    given: GivenPoses, mode: PosesMode, report: GivenReport | None, without: Sequence[str]
) -> Mapping[str, object]:
    """The entry "given" of a placement's report."""
    return {
        "program": given.program,
        "file": str(given.file),
        "photos": len(given.poses),
        "mode": mode,
        "metres": given.is_metric,
        "up": given.up,
        "without": list(without),
        **({} if report is None else msgspec.to_builtins(report)),
    }


def warned(given: GivenPoses) -> list[str]:
    """Sentences for a person about what of the file could not be taken over."""
    if not given.missing:
        return [*given.notes]
    listed = ", ".join(given.missing[:3])
    missing = f"{len(given.missing)} photos in {given.file.name} are not here: {listed}."
    return [*given.notes, missing]


def told(given: GivenPoses, mode: PosesMode, report: GivenReport | None) -> list[str]:
    """Sentences for a person, none a warning: whose poses these are, what moved how far."""
    notes = [f"{given.told}."]
    if given.has_masks:
        notes.append("Its masks leave the background out; --foreground replaces them.")
    if any(pose.depth is not None for pose in given.poses):
        notes.append("Splats begin at its depth.")
    if report is None:
        return notes
    unit = "m" if given.is_metric else "units"
    if mode == "refine" and not report.is_refined:
        notes.append(
            f"The given poses were kept: held-out matches lie {report.given:.2f} pixels off, and "
            "refined ones no nearer."
        )
    elif mode in ("refine", "scale"):
        change = ""
        if report.refined is not None:
            change = (
                f"Held-out matches lie {report.refined:.2f} pixels off instead of "
                f"{report.given:.2f}. "
            )
        notes.append(
            f"{change}Cameras moved by {report.moved:.3g} {unit} (at most {report.moved_most:.3g}) "
            f"and turned by {report.turned:.2g} degrees (at most {report.turned_most:.2g})."
        )
    return notes
