"""Settings of bodies for simulators: the command reads them to explain its options."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class SimulationConfig:
    """Mass, friction and convex parts of the bodies."""

    density: float = 500.0
    """Of objects without one of their own, kg/m^3: half of water, as filled packages have it."""
    friction: float = 0.8
    """Coefficient of sliding friction."""
    parts: int = 16
    """Convex parts of an object at most."""
    concavity: float = 0.04
    """How far a part may be from its convex hull, as a share of the object's size, 0.01 to 1:
    a smaller one gives more parts."""

    def __post_init__(self) -> None:
        """Refuse what no simulator takes."""
        if not (math.isfinite(self.density) and self.density > 0):
            raise ValueError(f"density: expected a number above 0, got {self.density}")
        if not (math.isfinite(self.friction) and self.friction >= 0):
            raise ValueError(f"friction: expected 0 or more, got {self.friction}")
        if not 1 <= self.parts <= 256:
            raise ValueError(f"parts: expected 1 to 256, got {self.parts}")
        if not 0.01 <= self.concavity <= 1:
            raise ValueError(f"concavity: expected 0.01 to 1, got {self.concavity}")
