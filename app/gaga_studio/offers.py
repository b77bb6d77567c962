"""The one thing that a scene lacks next, with a button and a time."""

from dataclasses import dataclass

from gaga_core.project import Project

# Measured on two cores: a depth picture, a vote and the gate, per view and million splats.
_SECONDS_PER_VIEW = {"paper": 0.6, "robust": 1.2}
_LEAST_SECONDS = 2.0


@dataclass(frozen=True)
class Offer:
    """A missing stage. Without an ``action`` there is no button: the reason says what to do."""

    reason: str  # "48 photos have masks but no objects yet."
    action: str = ""  # text of the button
    command: str = ""  # id in the command table
    seconds: float = 0.0  # estimate

    @property
    def duration(self) -> str:
        """ "about 20 s", "about 3 min"; empty without an estimate."""
        if self.seconds <= 0:
            return ""
        if self.seconds < 90:
            return f"about {max(5 * round(self.seconds / 5), 5)} s"
        return f"about {round(self.seconds / 60)} min"


def stage_offer(project: Project, n_masks: int, preset: str) -> Offer:
    """What a scene without groups lacks. ``n_masks``: views with masks."""
    folder, scene = project.folder, project.scene
    if folder is None:
        return Offer(
            "A lone splat file has no photos, so there are no masks to make groups from. "
            "Open its scene folder for that."
        )
    if not folder.mask_folders:
        return Offer(
            f"{len(folder.cameras)} photos have no masks. Put label maps into "
            f"{folder.root.name}/masks/NAME/, one PNG per photo, and open the scene again."
        )
    if n_masks == 0:
        names = ", ".join(folder.mask_folders)
        return Offer(f"No file in masks/{names} has the name of a photo. Rename the masks.")
    millions = len(scene) / 1e6
    seconds = _LEAST_SECONDS + n_masks * _SECONDS_PER_VIEW.get(preset, 1.0) * (0.1 + millions)
    return Offer(
        f"{n_masks} photos have masks but no objects yet.",
        "Find objects",
        "object.associate",
        seconds,
    )
