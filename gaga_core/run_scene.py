"""Bring a scene folder to the state that the window needs: run every stage that is missing.

`STAGES` is the whole plan. A stage is missing when its result is not there, is older than what it
was made from, or when a stage that it needs is about to run. To add one, add its entry in order.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from gaga_core import lift
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import AssociateConfig
from gaga_core.io.scene_folder import SceneFolder, is_scene_folder, open_scene_folder
from gaga_core.pipeline import associate_scene, read_model, render_views
from gaga_core.progress import Stage
from gaga_core.reconstruct_scene import ReconstructConfig, find_photos, reconstruct_scene


@dataclass(frozen=True)
class RunConfig:
    """Settings of the stages of a run."""

    reconstruct: ReconstructConfig = field(default_factory=ReconstructConfig)
    masks: str | Path | None = None  # a provider's name or a folder; None = the only one
    associate: AssociateConfig = field(default_factory=AssociateConfig)
    mode: lift.Mode = "vote"  # of the lift


@dataclass(eq=False)
class Work:
    """The folder as the stages before have left it; the splats are read once."""

    folder: SceneFolder
    config: RunConfig
    model_path: Path | None = None  # given by the user instead of the folder's newest
    _model: tuple[Path | None, Gaussians] | None = None

    def refresh(self) -> None:
        """Look at the folder again: the stage that ran may have added a model or masks."""
        self.folder = open_scene_folder(self.folder.root, model=self.model_path)

    def model(self) -> Stage[Gaussians]:
        """The scene's splats."""
        if self._model is None or self._model[0] != self.folder.model_path:
            gaussians = yield from read_model(self.folder)
            self._model = (self.folder.model_path, gaussians)
        return self._model[1]


@dataclass(frozen=True)
class SceneStage:
    """One row of the plan."""

    name: str
    needs: tuple[str, ...]  # stages whose results it is made from
    is_done: Callable[[SceneFolder], bool]  # its result is there and not older than its sources
    run: Callable[[Work], Stage[object]]


def run_missing(
    folder: SceneFolder, config: RunConfig | None = None, *, model: Path | None = None
) -> Stage[tuple[str, ...]]:
    """Run every missing stage; returns the names of those run.

    ``model`` overrides the folder's splats, as in `open_scene_folder`. A stage that is cancelled
    or fails leaves nothing of its own; what the stages before it wrote stays.
    """
    missing = missing_stages(folder)
    work = Work(folder, config or RunConfig(), model)
    for stage in STAGES:
        if stage.name in missing:
            yield from stage.run(work)
            work.refresh()
    return missing


def run_folder(
    root: Path, config: RunConfig | None = None, *, model: Path | None = None
) -> Stage[tuple[str, ...]]:
    """`run_missing` for a folder that may hold nothing but input/ or a video yet."""
    config, done = config or RunConfig(), tuple[str, ...]()
    if not is_scene_folder(root) and find_photos(root) is not None:
        yield from reconstruct_scene(None, root, config.reconstruct)
        done = ("reconstruct",)
    rest = yield from run_missing(open_scene_folder(root, model=model), config, model=model)
    return (*done, *rest)


def missing_stages(folder: SceneFolder) -> tuple[str, ...]:
    """Names of the stages that still have to run, in their order."""
    missing: list[str] = []
    for stage in STAGES:
        if any(name in missing for name in stage.needs) or not stage.is_done(folder):
            missing.append(stage.name)
    return tuple(missing)


def _labels(folder: SceneFolder) -> Path:
    return folder.work / "labels.npz"


def _is_newer(path: Path, source: Path) -> bool:
    """Whether ``path`` is there and was made from ``source`` as it is now."""
    return path.is_file() and path.stat().st_mtime_ns >= source.stat().st_mtime_ns


def _is_reconstructed(folder: SceneFolder) -> bool:
    return folder.model_path is not None


def _reconstruct(work: Work) -> Stage[object]:
    return (yield from reconstruct_scene(None, work.folder.root, work.config.reconstruct))


def _is_associated(folder: SceneFolder) -> bool:
    return _labels(folder).is_file()


def _associate(work: Work) -> Stage[object]:
    gaussians = yield from work.model()
    config = work.config
    return (
        yield from associate_scene(work.folder, config.masks, config.associate, gaussians=gaussians)
    )


def _is_lifted(folder: SceneFolder) -> bool:
    return _is_associated(folder) and _is_newer(folder.work / lift.FILE, _labels(folder))


def _lift(work: Work) -> Stage[object]:
    gaussians = yield from work.model()
    return (yield from lift.lift_scene(work.folder, work.config.mode, gaussians=gaussians))


def _shown(folder: SceneFolder) -> tuple[str, ...]:
    """Views whose group pictures are wanted: the test views; all when none is set apart."""
    return folder.test or tuple(camera.name for camera in folder.cameras)


def _is_rendered(folder: SceneFolder) -> bool:
    pictures = folder.work / "renders" / "groups"
    names = [f"{Path(name).stem}.png" for name in _shown(folder)]
    # Pictures older than the labels show groups that are gone.
    return _is_associated(folder) and all(
        _is_newer(pictures / name, _labels(folder)) for name in names
    )


def _render(work: Work) -> Stage[object]:
    gaussians = yield from work.model()
    return (yield from render_views(work.folder, views=_shown(work.folder), gaussians=gaussians))


STAGES = (
    SceneStage("reconstruct", (), _is_reconstructed, _reconstruct),
    SceneStage("associate", ("reconstruct",), _is_associated, _associate),
    SceneStage("lift", ("associate",), _is_lifted, _lift),
    SceneStage("render", ("associate",), _is_rendered, _render),
)
