"""The stage that a scene needs next, with a button and a time estimate."""

from dataclasses import dataclass

from gaga_core.identity.lift import LiftConfig
from gaga_core.io.folder.scene_folder import SceneFolder
from gaga_core.scene.project import Project

# Measured on two cores: a depth picture, a vote and the gate, per view and million splats.
_SECONDS_PER_VIEW = {"paper": 0.6, "robust": 1.2}
_LEAST_SECONDS = 2.0
_SECONDS_PER_PHOTO = 0.7  # regions: depth, superpixels and merging
_SECONDS_PER_STEP = 0.02  # of identities from zeros, 16,384 pixels each


def training_seconds(config: LiftConfig) -> float:
    """How long identities take to train, roughly."""
    return config.paper.iterations * _SECONDS_PER_STEP


def training_text(config: LiftConfig) -> str:
    """What follows an association when identities are trained."""
    n, seconds = config.paper.iterations, duration_text(training_seconds(config))
    return f"Then {n:,} training steps, {seconds}. Cancel keeps the objects; a next run goes on."


@dataclass(frozen=True)
class StageOffer:
    """A missing stage. Without an ``action`` there is no button: the reason tells what to do."""

    reason: str  # "48 photos have masks but no objects yet."
    action: str = ""  # text of the button
    command: str = ""  # id in the command table
    seconds: float = 0.0  # estimate
    note: str = ""  # in brackets behind the action: "now, without a model"
    more: tuple[tuple[str, str], ...] = ()  # other ways: texts of buttons and their commands

    @property
    def label(self) -> str:
        """ "Make masks (now, without a model, about 20 s)", "Find objects, about 20 s"."""
        if self.note:
            return f"{self.action} ({', '.join(filter(None, (self.note, self.duration)))})"
        return self.short_label

    @property
    def short_label(self) -> str:
        """ "Make masks, about 20 s": where there is little room."""
        return ", ".join(filter(None, (self.action, self.duration)))

    @property
    def duration(self) -> str:
        """ "about 20 s", "about 3 min"; empty without an estimate."""
        return duration_text(self.seconds)


def duration_text(seconds: float) -> str:
    """ "about 20 s", "about 3 min"; empty when it is not known."""
    if seconds <= 0:
        return ""
    if seconds < 90:
        return f"about {max(5 * round(seconds / 5), 5)} s"
    return f"about {round(seconds / 60)} min"


def stage_offer(project: Project, n_masks: int, preset: str, training_s: float = 0.0) -> StageOffer:
    """Return the stage that a scene without groups needs.

    ``n_masks``: views with masks; ``training_s``: what identities take after the groups.
    """
    folder, scene = project.folder, project.scene
    if folder is None:
        return StageOffer(
            "A single splat file has no photos to find objects in. Make them by clicks with the "
            "tool Object (O), or open the scene folder of the file."
        )
    if not folder.mask_folders:
        return _no_masks(folder)
    if n_masks == 0:
        names = ", ".join(folder.mask_folders)
        return StageOffer(f"No file in masks/{names} has the name of a photo. Rename the masks.")
    millions = len(scene) / 1e6
    seconds = _LEAST_SECONDS + n_masks * _SECONDS_PER_VIEW.get(preset, 1.0) * (0.1 + millions)
    seconds += training_s
    return StageOffer(
        f"{_photos_have(n_masks)} masks but no objects yet.",
        "Find objects",
        "object.associate",
        seconds,
    )


def _no_masks(folder: SceneFolder) -> StageOffer:
    if not folder.cameras:
        return StageOffer(
            "This folder has splats but no photos with a place, so there is nothing to make groups "
            "from. Put images/ and sparse/ next to them."
        )
    n_photos = sum(camera.name in folder.image_paths for camera in folder.cameras)
    if n_photos == 0:
        n = len(folder.cameras)
        missing = "The photo is" if n == 1 else f"The {n} photos are"
        return StageOffer(
            f"{missing} not in {folder.root.name}/images, so there is nothing to make masks of. "
            f"Put {'it' if n == 1 else 'them'} back, or import masks."
        )
    seconds = _LEAST_SECONDS + len(folder.train) * _SECONDS_PER_PHOTO
    reason = f"{_photos_have(n_photos)} no masks yet."
    more = (("", "object.masks_model"), ("Other ways…", "object.masks"))
    note = "now, without a model"
    return StageOffer(reason, "Make masks", "object.masks_quick", seconds, note, more)


def _photos_have(n: int) -> str:
    return "1 photo has" if n == 1 else f"{n} photos have"
