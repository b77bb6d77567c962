"""The stages behind the session's buttons. Each works on values taken at the call."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.demo_scene import ensure_demo
from gaga_core.io.folder.scene_folder import find_model
from gaga_core.io.masks.label_maps import mask_folder
from gaga_core.masks import MaskSet
from gaga_core.progress import Progress, Stage, mapped
from gaga_core.scene.project import Project, open_path_stage, save_project
from gaga_core.scene.scene import Scene

if TYPE_CHECKING:
    from gaga_core.kernels import Part
    from gaga_core.pipeline.reconstruct import PhotoFind

T = TypeVar("T")
_BAR = 1000  # steps of a bar


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


def kernels_stage() -> Stage[None]:
    """Compile what clicks, the object list and thumbnails run, so that none of them waits for it.

    Once on a machine: later it ends at once.
    """
    from gaga_core.kernels import is_compiled

    if not is_compiled():
        from gaga_core.pipeline.compile_kernels import warm_up_stage

        yield from warm_up_stage("window")


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
    title: str,
    make: Callable[[], Stage[T]],
    text: str = "Preparing",
    *,
    parts: "tuple[Part, ...]" = ("window", "grouping"),
    usual_s: float = 0.0,
) -> Stage[T]:
    """Compile the kernels of ``parts`` where needed, then run the stage that ``make`` builds.

    With ``usual_s``, the seconds that the stage takes on a machine like the one on which kernels
    were measured, both are one bar; without, kernels are a step with a share of its own. All in the
    job's thread: numba, torch and what ``make`` imports would slow the launch down.
    """
    from gaga_core.kernels import is_compiled

    yield Progress(title, 0, 0, text)
    missing = [part for part in parts if not is_compiled(part)]
    if not missing:
        return (yield from make())
    from gaga_core.pipeline.compile_kernels import usual_seconds, warm_up_stage

    kernels, work = warm_up_stage(*missing), make()
    if not usual_s:
        yield from kernels
        return (yield from work)
    kernels_s = usual_seconds(*missing)
    share = kernels_s / (kernels_s + usual_s)
    yield from mapped(kernels, partial(_within, title, 0.0, share))
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
    """The chosen (else the first) provider and its masks; empty when there are none."""
    folder = project.folder
    if folder is None or not folder.mask_folders:
        return "", MaskSet()
    if provider and provider not in folder.mask_folders:
        known = ", ".join(folder.mask_folders)
        raise GagaError(f"There are no masks of {provider!r} here. Choose one of {known}.")
    name = provider or next(iter(folder.mask_folders))
    return name, mask_folder(folder.mask_folders[name], [c.name for c in folder.cameras])
