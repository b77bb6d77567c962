"""The stages behind the session's buttons. Each works on values taken at the call."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from gaga_core.errors import GagaError, counted
from gaga_core.gaussians import Gaussians
from gaga_core.io.demo_scene import ensure_demo
from gaga_core.io.folder.scene_folder import find_model
from gaga_core.io.masks.label_maps import mask_folder
from gaga_core.masks import MaskSet
from gaga_core.progress import Progress, Stage, mapped
from gaga_core.scene.project import Project, open_path_stage, save_project
from gaga_core.scene.scene import Scene
from gaga_studio.session.rates import KnownRates

if TYPE_CHECKING:
    from gaga_core.kernels import Part
    from gaga_core.pipeline.reconstruct import PhotoFind

T = TypeVar("T")
_BAR = 1000  # steps of a bar
# Seconds for which the bar has room after the kernels where nobody knows how long a task takes; in
# the middle of those on the demo scene, which take 3 s (Split) to 30 s (Measure the objects).
_TASK_S = 10.0


def open_demo_stage(folder: Path) -> Stage[Project]:
    """Copy the demo scene to ``folder`` if it is not there yet, then open it."""
    return (yield from open_path_stage((yield from ensure_demo(folder))))


def open_stage(path: Path) -> "Stage[Project | PhotoFind]":
    """Open what is there; of photos without splats, or a video, what can be made of them."""
    from gaga_core.pipeline.reconstruct import look_at_photos

    yield Progress("Look at the folder", 0, 1, path.name)
    found = look_at_photos(path)
    if found is not None and find_model(found.scene) is None:
        return found
    return (yield from open_path_stage(found.scene if found is not None else path))


def said_of_photos(path: Path) -> str:
    """A sentence where ``path``, which was opened, are photos of which a scene was made before;
    else ""."""
    from gaga_core.pipeline.reconstruct import latest_of, photos_since, source_of
    from gaga_core.placing.undistort import ORIGINALS

    photos, scene = source_of(path)
    if scene.absolute() == path.absolute():
        return ""
    scene = scene if photos is None else latest_of(scene)
    n_new = photos_since(scene, photos or scene / ORIGINALS)
    new = f" {counted(n_new, 'photo')} of the folder came since." if n_new else ""
    return f"This is the scene that was made of {path.name}.{new}"


def kernels_stage(rates: KnownRates, *parts: "Part") -> Stage[None]:
    """Compile what is not compiled yet of ``parts`` (none: what clicks, the object list and
    thumbnails run, so that none of them waits for it); ``rates`` learns how fast that goes here.

    Once on a machine: later it ends at once.
    """
    from gaga_core.kernels import is_compiled

    missing = [part for part in parts or ("window",) if not is_compiled(part)]
    if missing:
        from gaga_core.pipeline.compile_kernels import usual_seconds, warm_up_stage

        yield from rates.timed_kernels(warm_up_stage(*missing), usual_seconds(*missing))


def kernels_seconds(*parts: "Part") -> float:
    """Seconds that what is not compiled yet of ``parts`` usually takes; 0 where all is."""
    from gaga_core.kernels import is_compiled

    if all(is_compiled(part) for part in parts):
        return 0.0
    from gaga_core.pipeline.compile_kernels import usual_seconds

    return usual_seconds(*parts)


def save_stage(
    project: Project, path: Path | None, copies_model: bool = False, overwrites: bool = False
) -> Stage[Path]:
    """Save the project as it is at the call, see `save_project`; returns where it is now."""
    frozen = replace(project, scene=replace(project.scene))

    def stage() -> Stage[Path]:
        yield Progress("Save", 0, 1)
        return save_project(frozen, path, copies_model=copies_model, overwrites=overwrites)

    return stage()


def prepared(
    rates: KnownRates,
    title: str,
    make: Callable[[], Stage[T]],
    text: str = "Preparing",
    *,
    parts: "tuple[Part, ...]" = ("window", "grouping"),
    usual_s: float | None = None,
    name: str = "",
) -> Stage[T]:
    """Compile the kernels of ``parts`` where needed, then run the stage that ``make`` builds.

    Both are one bar. ``usual_s``: seconds that this much work takes on a machine like the one on
    which kernels were measured; what it took here is kept in ``rates`` under ``name`` (default:
    ``title``) for the next time. None: nobody knows how much it is, so nothing is kept, and until
    it runs only the kernels' time is told. All in the job's thread: numba, torch and what ``make``
    imports would slow the launch down.
    """
    from gaga_core.kernels import STAGE

    name = name or title
    yield Progress(title, 0, 0, text)
    usual_kernels_s = kernels_seconds(*parts)
    kernels, work = kernels_stage(rates, *parts), make()
    if usual_s is not None:
        work = rates.timed(work, name, usual_s)
    if not usual_kernels_s:
        yield from kernels  # their last words, if any
        return (yield from work)
    kernels_s = usual_kernels_s * rates.of(STAGE)
    work_s = _TASK_S * rates.of(STAGE) if usual_s is None else usual_s * rates.of(name)
    share = kernels_s / (kernels_s + work_s)

    def change(step: Progress) -> Progress:
        left = 1 - step.done / step.total if step.total > 0 else 1.0
        left_s = left * usual_kernels_s * rates.of(STAGE)
        if usual_s is not None:
            left_s += usual_s * rates.of(name)
        return replace(_within(title, 0.0, share, step), left_s=left_s)

    yield from mapped(kernels, change)
    return (yield from mapped(work, partial(_within, title, share, 1.0)))


def _within(title: str, begin: float, end: float, step: Progress) -> Progress:
    """Progress of the whole from ``begin`` to ``end``, in 0..1."""
    message = step.message if step.stage == title else f"{step.stage}: {step.message}"
    if step.total <= 0:
        return replace(step, stage=title, message=message)
    done = round(_BAR * (begin + (end - begin) * step.done / step.total))
    return replace(step, stage=title, done=done, total=_BAR, message=message)


def file_gaussians(scene: Scene) -> Gaussians:
    """The Gaussians of the opened file, in its order: no duplicates, no splats of other files."""
    n = scene.n_opened  # all others are appended, so these are a prefix
    return scene.gaussians if n == len(scene) else scene.gaussians.take(np.arange(n))


def masks_of(project: Project, provider: str = "") -> tuple[str, MaskSet]:
    """The chosen provider, else the one that the objects are of, else the first, and its masks;
    empty when there are none."""
    folder = project.folder
    if folder is None or not folder.mask_folders:
        return "", MaskSet()
    if provider and provider not in folder.mask_folders:
        known = ", ".join(folder.mask_folders)
        raise GagaError(f"There are no masks of {provider!r} here. Choose one of {known}.")
    known = project.bank_masks if project.bank_masks in folder.mask_folders else ""
    name = provider or known or next(iter(folder.mask_folders))
    return name, mask_folder(folder.mask_folders[name], [c.name for c in folder.cameras])
