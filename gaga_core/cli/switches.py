"""Switches of the method that several commands share; each is a group of options without prefix."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from gaga_core.errors import GagaError

if TYPE_CHECKING:
    from gaga_core.grouping.associate import AssociateConfig
    from gaga_core.identity.lift import LiftConfig


class SwitchError(GagaError):
    """Switches that do not go together: the command ends with status 2 before it reads anything."""


@dataclass(frozen=True)
class GroupSwitches:
    """Settings of the association; those that are not given are the preset's."""

    detail: float | None = None
    """Of groups made from regions: 0 things together .. 0.5 whole objects (default) .. 1 small
    pieces."""
    threshold: float | None = None
    """Least overlap of a mask with a group to join it, in (0, 1]; default: 0.1, as published."""
    inlier_factor: float | None = None
    """f of the depth gate: pixels within f IQRs of the mask's depths count; default: 1."""
    depth: Literal["expected", "median", "none"] | None = None
    """Of a pixel; none: all Gaussians behind a mask. Default: expected (paper), median (robust)."""
    order: Literal["name", "coverage"] | None = None
    """Of the views; coverage: widest first. Default: name (paper), coverage (robust)."""

    def config(self, preset: str) -> "AssociateConfig":
        """The settings of ``preset`` with those that were given; ``GagaError`` when impossible."""
        from gaga_core.grouping.associate import AssociateConfig

        config = AssociateConfig.of(preset).at_detail(self.detail)
        given = {
            name: value
            for name in ("threshold", "depth", "order")
            if (value := getattr(self, name)) is not None
        }
        try:
            gate = config.gate
            if self.inlier_factor is not None:
                gate = replace(gate, iqr_factor=self.inlier_factor)
            return replace(config, gate=gate, **given)
        except ValueError as error:
            raise GagaError(f"That cannot be: {error}.") from error


@dataclass(frozen=True)
class IdentitySwitches:
    """Settings of identity encodings (section 3.3)."""

    lift_iterations: int | None = None
    """Training steps of identities from zeros (paper); default: 10,000, as published."""
    pseudo: Literal["masks", "bank"] | None = None
    """Labels that identities are trained on: masks with their groups' ids (figure 2 and published
    code, the default), or the bank's groups splatted into the views (text of section 3.3)."""
    void: Literal["ignore", "train"] | None = None
    """Pixels that no mask covers: ignore them (the default), or train them as class 0, as the
    published code does."""

    def config(self) -> "LiftConfig":
        """Settings of a lift with those that were given; ``GagaError`` when impossible."""
        from gaga_core.identity.lift import LiftConfig

        void = None if self.void is None else self.void == "train"
        try:
            return LiftConfig().switched(self.lift_iterations, self.pseudo, void)
        except ValueError as error:
            raise GagaError(f"That cannot be: {error}.") from error
