"""How the scene is shown: what panels set and the viewport reads."""

from dataclasses import dataclass
from enum import StrEnum


class Mode(StrEnum):
    """What the splats' color says."""

    COLOR = "color"
    GROUPS = "groups"
    DEPTH = "depth"


@dataclass
class ViewState:
    """The picture's settings; the camera is in ``CameraRig``."""

    mode: Mode = Mode.COLOR
    background: tuple[float, float, float] = (0.11, 0.11, 0.12)
    show_frusta: bool = False
    show_outline: bool = True
    splat_budget: int = 0  # 0 = no limit
    resolution_scale: float = 1.0  # of the viewport's own pixels
