"""How objects are found: the preset, and the paper's switches that differ from it."""

from dataclasses import dataclass, field, replace
from typing import Literal

from gaga_core.errors import GagaError
from gaga_core.grouping.associate import AssociateConfig
from gaga_core.identity.lift import LiftConfig, Mode
from gaga_studio.session.settings import Settings


@dataclass(frozen=True)
class FindOptions:
    """Switches of this run of the program; None is what the preset has."""

    threshold: float | None = None  # least overlap of a mask with a group that it joins, (0, 1]
    inlier_factor: float | None = None  # f of the depth gate
    depth: Literal["expected", "median", "none"] | None = None  # none: all Gaussians behind a mask
    order: Literal["name", "coverage"] | None = None  # of the views
    lift: LiftConfig = field(default_factory=LiftConfig)

    def association(self, preset: str) -> AssociateConfig:
        """Settings of an association by ``preset``; ``GagaError`` when they exclude each other."""
        config = AssociateConfig.of(preset)
        try:
            gate = config.gate
            if self.inlier_factor is not None:
                gate = replace(gate, iqr_factor=self.inlier_factor)
            return replace(
                config,
                gate=gate,
                threshold=self.threshold or config.threshold,
                depth=self.depth or config.depth,
                order=self.order or config.order,
            )
        except ValueError as error:
            raise GagaError(f"These settings do not go together ({error}).") from error


def lift_mode(settings: Settings, preset: str = "") -> Mode | None:
    """How identities are made once objects are found by ``preset`` (default: that of the settings).

    None: not at all.
    Preset paper trains them, as published. Robust leaves them: its labels are votes either way.
    """
    modes: dict[str, Mode] = {"vote": "vote", "refine": "refine", "paper": "paper"}
    if settings.identities == "preset":
        return "paper" if (preset or settings.preset) == "paper" else None
    return modes.get(settings.identities)
