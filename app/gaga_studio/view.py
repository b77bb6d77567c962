"""How the scene is shown: what panels set and the viewport reads."""

from dataclasses import dataclass
from enum import StrEnum


class Mode(StrEnum):
    """What the splats' color says."""

    COLOR = "color"
    GROUPS = "groups"
    DEPTH = "depth"


class ToolName(StrEnum):
    """The one active tool."""

    PICK = "pick"
    RECT = "rect"
    MOVE = "move"
    ROTATE = "rotate"
    SCALE = "scale"


@dataclass
class ViewState:
    """The picture's settings; the camera is in ``CameraRig``."""

    mode: Mode = Mode.COLOR
    background: tuple[float, float, float] = (0.11, 0.11, 0.12)
    show_frusta: bool = False
    show_outline: bool = True
    splat_budget: int = 0  # 0 = no limit
    resolution_scale: float = 1.0  # of the viewport's own pixels
    show_panels: bool = True  # Tab hides everything but the picture
    show_info: bool = True  # splats, frame time and backend in the status bar
