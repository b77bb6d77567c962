"""How large the demo scene is, and its seed."""

from dataclasses import dataclass


@dataclass(frozen=True)
class DemoConfig:
    """Size and seed of the demo scene."""

    n_splats: int = 120_000  # about
    n_views: int = 40
    width: int = 640
    height: int = 480
    seed: int = 0

    def __post_init__(self) -> None:
        if self.n_splats < 100 or self.n_views < 2 or min(self.width, self.height) < 16:
            raise ValueError(f"demo: too little to make a scene of: {self}")
