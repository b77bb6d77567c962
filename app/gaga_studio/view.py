"""How the scene is shown: what panels set and the viewport reads."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from gaga_core.arrays import UInt8Array


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
    rect_takes_splats: bool = False  # else whole objects


class ImageSource(Protocol):
    """Pictures as textures; the window gives one (``gpu.images.ImageStore``)."""

    def texture(self, key: str, load: Callable[[], UInt8Array]) -> tuple[int, int, int] | None:
        """GL name, width and height; None while ``load`` runs in the background."""
        ...
