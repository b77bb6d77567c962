"""Bring a scene folder to the state that the window needs: run every stage that is missing.

`STAGES` is the whole plan. A stage is missing when its result is not there, is older than what it
was made from, or when a stage that it needs is about to run. To add one, add its entry in order.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import AssociateConfig
from gaga_core.grouping.bank_file import load_bank
from gaga_core.grouping.memory_bank import Preset
from gaga_core.identity.field import FILE
from gaga_core.identity.lift import LiftConfig, Mode, mode_of_preset
from gaga_core.io.arrays_file import TEXT, read_columns
from gaga_core.io.folder.scene_folder import (
    SceneFolder,
    is_scene_folder,
    mask_path_of,
    open_scene_folder,
    read_model,
)
from gaga_core.io.masks.label_maps import RECORD, view_key
from gaga_core.pipeline.associate import (
    are_associated,
    associate_scene,
    associated_masks,
    views_to_add,
)
from gaga_core.pipeline.lift import lift_scene
from gaga_core.pipeline.place import find_photos
from gaga_core.pipeline.reconstruct import reconstruct_scene, require_its_photos
from gaga_core.pipeline.render import render_views
from gaga_core.pipeline.segment import segment_scene
from gaga_core.pipeline.settings import IdentitySettings, ReconstructConfig
from gaga_core.progress import Stage
from gaga_core.segmentation.choose import provider_named
from gaga_core.segmentation.regions import NAME as REGIONS

JOIN = "join"  # new views joined groups, instead of "associate"


@dataclass(frozen=True)
class RunConfig:
    """Settings of the stages of a run."""

    reconstruct: ReconstructConfig = field(default_factory=ReconstructConfig)
    masks: str | Path | None = None  # a folder, or a name in SCENE/masks; None = the only one
    masks_from: str = ""  # who makes missing masks; "" = regions, if there are none
    associate: AssociateConfig = field(default_factory=lambda: AssociateConfig.of("robust"))
    keeps_groups: bool = True  # of another preset than that; False: they are made again
    mode: Mode | None = None  # of the lift; None = as the preset of the groups has it
    lift: LiftConfig | IdentitySettings = field(default_factory=IdentitySettings)

    def stage_of(self, folder: Path, photos: Path | None) -> Stage[tuple[str, ...]]:
        """`run_folder` with these settings: what an executor runs."""
        return run_folder(folder, self, photos=photos)


@dataclass(eq=False)
class Work:
    """The folder as the stages before have left it; the splats are read once."""

    folder: SceneFolder
    config: RunConfig
    model_path: Path | None = None  # given by the user instead of the folder's newest
    done: list[str] = field(default_factory=list)  # stages that have run
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
    is_done: Callable[[Work], bool]  # its result is there and not older than its sources
    run: Callable[[Work], Stage[object]]


def run_missing(
    folder: SceneFolder, config: RunConfig | None = None, *, model: Path | None = None
) -> Stage[tuple[str, ...]]:
    """Run every missing stage; returns the names of those run, `JOIN` for an association in which
    new views joined the groups that there were.

    ``model`` overrides the folder's splats, as in `open_scene_folder`. A stage that is cancelled
    or fails leaves nothing of its own; what the stages before it wrote stays.
    """
    work = Work(folder, config or RunConfig(), model)
    missing = missing_stages(folder, config)
    for stage in STAGES:
        if stage.name in missing:
            joins = stage.name == "associate" and _can_join(work)
            yield from stage.run(work)
            work.done.append(JOIN if joins else stage.name)
            work.refresh()
    return tuple(work.done)


def run_folder(
    root: Path,
    config: RunConfig | None = None,
    *,
    photos: Path | None = None,
    model: Path | None = None,
) -> Stage[tuple[str, ...]]:
    """`run_missing` for a folder that may hold nothing but input/ or a video yet.

    ``photos`` is a folder of photos or a video that lies elsewhere; ``root`` is made of it.
    """
    config, done = config or RunConfig(), tuple[str, ...]()
    if photos is not None:
        require_its_photos(photos, root)
    if not is_scene_folder(root) and (photos or find_photos(root)) is not None:
        yield from reconstruct_scene(photos, root, config.reconstruct)
        done = ("reconstruct",)
    rest = yield from run_missing(open_scene_folder(root, model=model), config, model=model)
    return (*done, *rest)


def missing_stages(folder: SceneFolder, config: RunConfig | None = None) -> tuple[str, ...]:
    """Names of the stages that still have to run, in their order."""
    work, missing = Work(folder, config or RunConfig()), list[str]()
    for stage in STAGES:
        if any(name in missing for name in stage.needs) or not stage.is_done(work):
            missing.append(stage.name)
    return tuple(missing)


def _labels(folder: SceneFolder) -> Path:
    return folder.work / "labels.npz"


def _reconstruct(work: Work) -> Stage[object]:
    return (yield from reconstruct_scene(None, work.folder.root, work.config.reconstruct))


def _has_masks(work: Work) -> bool:
    """Whether there are masks to associate: the wanted ones, or any; half of them are none.

    A scene that has groups needs no masks any more, unless others are wanted than it has.
    """
    config, found = work.config, work.folder.mask_folders
    if config.masks is not None:
        return True  # the user's own
    if config.masks_from:
        return config.masks_from in found and not _lacks_views(work, found[config.masks_from])
    if _labels(work.folder).is_file():
        return True
    return bool(found) and not (list(found) == [REGIONS] and _lacks_views(work, found[REGIONS]))


def _lacks_views(work: Work, masks: Path) -> bool:
    """Whether masks that were made here end before the last training view: a run was stopped."""
    if not (masks / RECORD).is_file():
        return False
    return any(not (masks / f"{view_key(name)}.png").is_file() for name in work.folder.train)


def _make_masks(work: Work) -> Stage[object]:
    if not work.folder.image_paths:
        raise GagaError(
            f"{work.folder.root} has no masks and no photos to make them of. Put the photos into "
            f"{work.folder.root / 'images'}, or label maps into {work.folder.root / 'masks'}."
        )
    provider = provider_named(work.config.masks_from or REGIONS)
    return (yield from segment_scene(work.folder, provider))


def _is_associated(work: Work) -> bool:
    """Whether there are the groups that are wanted, and no new views can join them."""
    return _has_wanted_groups(work) and not _can_join(work)


def _can_join(work: Work) -> bool:
    """Whether the groups are kept and there are masks of views that took no part in them."""
    folder, masks = work.folder, work.config.masks
    if "reconstruct" in work.done or not _has_wanted_groups(work):
        return False
    if masks is not None and not are_associated(folder, mask_path_of(folder, masks)):
        return False
    return len(views_to_add(folder)) > 0


def _has_wanted_groups(work: Work) -> bool:
    """Whether there are groups, and of the provider that is asked for by name."""
    if not _labels(work.folder).is_file():
        return False
    wanted = work.config.masks_from if work.config.masks is None else ""
    if wanted and not are_associated(work.folder, work.folder.mask_folders.get(wanted)):
        return False
    return work.config.keeps_groups or _preset_of(work) == work.config.associate.preset


def _preset_of(work: Work) -> Preset | None:
    """The preset that made the groups; None where they have no bank."""
    bank = work.folder.work / "bank.npz"
    return load_bank(bank).preset if bank.is_file() else None


def _associate(work: Work) -> Stage[object]:
    gaussians = yield from work.model()
    config = work.config
    masks, settings = config.masks or config.masks_from or None, config.associate
    joins = _can_join(work)
    if joins:
        masks, preset = associated_masks(work.folder), _preset_of(work) or settings.preset
        if preset != settings.preset:  # groups are kept as their own preset has them
            bytes_ = settings.histogram_bytes
            settings = replace(AssociateConfig.of(preset), histogram_bytes=bytes_)
    stage = associate_scene(work.folder, masks, settings, gaussians=gaussians, adds=joins)
    return (yield from stage)


def _is_newer(path: Path, source: Path) -> bool:
    """Whether ``path`` is there and was made from ``source`` as it is now."""
    return path.is_file() and path.stat().st_mtime_ns >= source.stat().st_mtime_ns


def _is_lifted(work: Work) -> bool:
    """Whether there are identities of the groups, and of the mode that is wanted by name."""
    labels, identity = _labels(work.folder), work.folder.work / FILE
    if not labels.is_file() or not _is_newer(identity, labels):
        return False
    if work.config.mode is None and work.config.keeps_groups:
        return True
    stored = read_columns(identity, "Remove it, and run again.", {"mode": TEXT})
    preset = _preset_of(work) or work.config.associate.preset
    return str(stored["mode"]) == (work.config.mode or mode_of_preset(preset))


def _lift(work: Work) -> Stage[object]:
    gaussians = yield from work.model()
    config = work.config
    return (yield from lift_scene(work.folder, config.mode, config.lift, gaussians=gaussians))


def _shown(folder: SceneFolder) -> tuple[str, ...]:
    """Views whose group pictures are wanted: the test views; all when none is set apart."""
    return folder.test or tuple(camera.name for camera in folder.cameras)


def _is_rendered(work: Work) -> bool:
    labels, pictures = _labels(work.folder), work.folder.work / "renders" / "groups"
    names = [f"{view_key(name)}.png" for name in _shown(work.folder)]
    if not labels.is_file():
        return False
    # Pictures older than the labels, or than identities that labels may come from, show groups
    # that are gone.
    sources = [path for path in (labels, work.folder.work / FILE) if path.is_file()]
    return all(_is_newer(pictures / name, source) for name in names for source in sources)


def _render(work: Work) -> Stage[object]:
    gaussians = yield from work.model()
    return (yield from render_views(work.folder, views=_shown(work.folder), gaussians=gaussians))


STAGES = (
    SceneStage("reconstruct", (), lambda work: work.folder.model_path is not None, _reconstruct),
    SceneStage("masks", (), _has_masks, _make_masks),
    SceneStage("associate", ("reconstruct", "masks"), _is_associated, _associate),
    SceneStage("lift", ("associate",), _is_lifted, _lift),
    SceneStage("render", ("associate",), _is_rendered, _render),
)
