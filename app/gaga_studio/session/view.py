"""The view of the scene: settings of panels that the viewport reads, and pictures for jobs."""

import queue
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Protocol

import numpy as np

from gaga_core.arrays import UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.scene.edits import How
from gaga_core.scene.object_picture import ObjectDrawing
from gaga_core.scene.scene import Scene
from gaga_studio.session.camera_rig import Pose

if TYPE_CHECKING:
    from gaga_core.pipeline.place import PlacementReport
    from gaga_core.training.train import TrainUpdate


class Mode(StrEnum):
    """Meaning of the color of the splats."""

    COLOR = "color"
    GROUPS = "groups"
    DEPTH = "depth"
    CONFIDENCE = "confidence"  # confidence of each splat in its group
    CENTRES = "centres"
    RINGS = "rings"  # the rim of each ellipse
    MASK = "mask"  # the object in the inspector, white on black
    IDENTITY = "identity"  # identity encodings as colors: their principal components


class SplatLook(StrEnum):
    """Drawing of splats that are smaller than a pixel."""

    AUTO = "auto"  # as the file's comments ask
    CLASSIC = "classic"  # every splat is widened by 0.3 pixels^2 (Kerbl 2023)
    ANTIALIASED = "antialiased"  # and thinned out as much (Yu 2024, Mip-Splatting)


class CentreColors(StrEnum):
    """Meaning of the colors of the centres, in `Mode.CENTRES`."""

    OWN = "own"  # the splats' own colors
    GROUPS = "groups"
    IDENTITY = "identity"  # principal components of the encodings


class ToolName(StrEnum):
    """The one active tool."""

    PICK = "pick"
    OBJECT = "object"
    RECT = "rect"
    LASSO = "lasso"
    POLYGON = "polygon"
    BRUSH = "brush"
    SPHERE = "sphere"
    ERASE = "erase"
    COLOR = "color"
    CLONE = "clone"
    GROUND = "ground"
    MEASURE = "measure"
    MOVE = "move"
    ROTATE = "rotate"
    SCALE = "scale"


Point = tuple[float, float, float]  # world
REGION_TOOLS = (ToolName.RECT, ToolName.LASSO, ToolName.POLYGON, ToolName.BRUSH)


@dataclass(frozen=True)
class Outline:
    """Corners that were clicked so far, pixels of the picture."""

    points: tuple[tuple[float, float], ...]
    width: int
    height: int
    how: How
    pose: bytes  # of the camera; an outline belongs to one picture

    def with_corner(self, corner: tuple[float, float]) -> "Outline":
        """Return the outline with one more corner."""
        return replace(self, points=(*self.points, corner))

    def without_last(self) -> "Outline | None":
        """Return the outline without its last corner; None when none is left."""
        return replace(self, points=self.points[:-1]) if len(self.points) > 1 else None


@dataclass(frozen=True)
class ViewportPoint:
    """A pixel of the picture, its size, and what the modifiers do to a selection."""

    u: float
    v: float
    width: int
    height: int
    how: How = "set"
    alt: bool = False


class Side(StrEnum):
    """Content of one side of a split view."""

    PHOTO = "photo"
    PICTURE = "picture"  # on the right as the view mode says
    GROUPS = "groups"
    TRUTH = "truth"  # the true maps of the scene folder
    ERRORS = "errors"  # where the groups differ from the truth
    BEFORE = "before"  # the picture before the last edit
    VERSION = "version"  # the picture as an entry of the history left it
    PRESET = "preset"  # the groups of the other preset


class PhotoCompareMode(StrEnum):
    """Comparison drawn over the picture at a photo's camera."""

    OFF = "off"
    SWIPE = "swipe"  # two sides with a line between them that can be dragged
    DIFFERENCE = "difference"  # how far the picture is from the photo


@dataclass
class Playback:
    """The preview of the camera's path."""

    at: float = 0.0  # seconds
    is_playing: bool = False
    chosen: int = 0  # keyframe
    came_from: tuple[Pose, int | None] | None = None  # the camera, and the photo, before it played


@dataclass
class ViewState:
    """The picture's settings; the camera is in ``CameraRig``."""

    mode: Mode = Mode.COLOR
    background: tuple[float, float, float] = (0.11, 0.11, 0.12)
    look: SplatLook = SplatLook.AUTO
    centre_colors: CentreColors = CentreColors.OWN
    folder_colors: bool = False  # groups have the colors of their folders
    show_frusta: bool = False
    show_outline: bool = True
    show_box: bool = False  # around the selection
    splat_budget: int = 0  # 0 = no limit
    coarse_budget: int = 0  # that a motion would begin with: its depth order is kept ready
    uses_lod: bool = True  # large scenes are drawn from a tree, where there is one
    lod_budget: int = 2_000_000  # splats in the picture of a scene with level of detail
    resolution_scale: float = 1.0  # of the viewport's own pixels
    show_panels: bool = True  # Tab hides everything but the picture
    asked_panel: str = ""  # title of the panel that is to come to the front
    show_info: bool = True  # splats, frame time and backend in the status bar
    takes_splats: bool = False  # of the tools that select regions; else whole objects
    visible_only: bool = False  # they take the visible surface; else everything behind it too
    brush_radius: float = 24.0  # pixels of the screen
    brush_color: tuple[float, float, float] = (0.8, 0.2, 0.2)  # of the color brush
    brush_strength: float = 1.0  # 0..1
    outline: "Outline | None" = None  # of the polygon tool
    snaps: bool = False  # handles move in steps
    local_axes: bool = False  # handles stand along the object's own axes, else the world's
    pivot: Point | None = None  # what turns and scales are about; None: middle
    compare: PhotoCompareMode = PhotoCompareMode.OFF
    version: int = -1  # state of the history that is compared; -1: none was chosen
    swipe: float = 0.5  # share of the width that is left of the line
    sides: tuple[Side, Side] = (Side.PHOTO, Side.PICTURE)  # of the line
    holds_photo: bool = False  # the photo lies over the picture while the keys are held
    show_cube: bool = True  # the view cube in a corner of the picture
    lights_masks: bool = True  # the splats of the mask that is chosen in the memory bank
    has_mask_gate: bool = True  # only those that the depth gate lets through
    playback: Playback = field(default_factory=Playback)
    pointed: tuple[float, ...] | None = None  # surface point (3,) that a menu was opened on

    def ask_for_panel(self, name: str) -> None:
        """Show the panel called ``name``, in front of the others, with the keyboard."""
        self.show_panels, self.asked_panel = True, name

    def take_asked_panel(self) -> str:
        """The panel that is to come to the front, told once; "" = none."""
        asked, self.asked_panel = self.asked_panel, ""
        return asked

    def is_antialiased(self, scene: Scene) -> bool:
        """Return whether the splats are drawn antialiased: as the file asks, unless overridden."""
        if self.look is SplatLook.AUTO:
            return scene.gaussians.is_antialiased
        return self.look is SplatLook.ANTIALIASED


Picture = UInt8Array | ObjectDrawing  # (H, W, 3) or (H, W, 4), or drawn with OpenGL


class ImageSource(Protocol):
    """Pictures as textures; the window gives one (``gpu.images.ImageStore``)."""

    def texture(self, key: str, load: Callable[[], Picture] | None) -> tuple[int, int, int] | None:
        """GL name, width and height; None while ``load`` runs in the background.

        Without ``load`` only a picture that is there.
        """
        ...

    def cannot_read(self, key: str) -> bool:
        """Whether a picture was asked for and could not be read."""
        ...


# --- pictures that a job needs and only the thread with the OpenGL context can draw

Draw = Callable[[Camera, ViewState], UInt8Array]  # (H, W, 3)
_PATIENCE_S = 120.0  # for one picture: software OpenGL at a large size


@dataclass
class _Request:
    camera: Camera
    view: ViewState
    done: threading.Event = field(default_factory=threading.Event)
    picture: UInt8Array | None = None


class RenderRequests:
    """A worker calls ``paint`` and waits; the window's thread calls ``serve`` every frame."""

    def __init__(self, *, max_side: int, is_fast: bool) -> None:
        self.max_side = max_side  # pixels of a side that OpenGL can draw
        self.is_fast = is_fast  # a graphics card: else the CPU's own rasterizer is quicker
        self._waiting: queue.SimpleQueue[_Request] = queue.SimpleQueue()
        self._closed = False

    def paint(self, camera: Camera, view: ViewState, *, transparent: bool = False) -> UInt8Array:
        """Return the picture (H, W, 3), or with ``transparent`` (H, W, 4) in straight alpha.

        Raises ``GagaError`` when the window closes or does not answer.
        """
        if not transparent:
            return self._ask(camera, view)
        dark, light = (
            self._ask(camera, replace(view, background=(level, level, level))).astype(np.int16)
            for level in (0.0, 1.0)
        )
        # The difference of the backgrounds is the light that the splats let through.
        alpha = 255 - np.clip(light - dark, 0, 255).max(axis=2, keepdims=True)
        straight = np.where(alpha > 0, dark * 255.0 / np.maximum(alpha, 1), 0)
        picture = np.concatenate([straight, alpha], axis=2)
        return (np.clip(picture, 0, 255) + 0.5).astype(np.uint8)

    @property
    def is_wanted(self) -> bool:
        """Whether a picture is requested: the window must not rest."""
        return not self._waiting.empty()

    def serve(self, draw: Draw) -> bool:
        """Draw one requested picture; return whether there was one."""
        try:
            request = self._waiting.get_nowait()
        except queue.Empty:
            return False
        request.picture = draw(request.camera, request.view)
        request.done.set()
        return True

    def close(self) -> None:
        """Release every waiting worker: the window closes."""
        self._closed = True
        while True:
            try:
                self._waiting.get_nowait().done.set()
            except queue.Empty:
                return

    def _ask(self, camera: Camera, view: ViewState) -> UInt8Array:
        request = _Request(camera, view)
        if not self._closed:
            self._waiting.put(request)
            request.done.wait(_PATIENCE_S)
        if request.picture is None:
            raise GagaError("The window did not draw the picture. Try again.")
        return request.picture


# --- splats while they are trained


_POINTS = 240  # of a curve: more than its picture has pixels to show


@dataclass(frozen=True, eq=False)
class TrainingUpdate:
    """Payload of a reconstruction's progress: everything so far, since payloads may be skipped."""

    cameras: tuple[Camera, ...]  # of the placed photos, by name
    notes: tuple[str, ...] = ()  # sentences of the checks
    update: "TrainUpdate | None" = None
    gaussians: Gaussians | None = None  # the newest copy of the splats
    placement: "PlacementReport | None" = None  # of photos that were placed here


@dataclass(eq=False)
class TrainingPreview:
    """A reconstruction that runs. Main thread only."""

    name: str
    iterations: int  # of the training
    cameras: tuple[Camera, ...] = ()
    scene: Scene | None = None  # nothing in it can be edited
    update: "TrainUpdate | None" = None
    placement: "PlacementReport | None" = None
    is_stopped: bool = False  # it was cancelled: what there is can be looked at and kept
    keeps: bool = False  # what is there when it has stopped becomes the scene
    _newest: Gaussians | None = field(default=None, repr=False)
    _shown: Gaussians | None = field(default=None, repr=False)

    def take(self, live: TrainingUpdate) -> bool:
        """Keep what is new for `show`; return whether the photos have just been placed."""
        is_first = not self.cameras and bool(live.cameras)
        self.cameras, self.update = live.cameras, live.update
        self.placement = live.placement
        if live.gaussians is not None:
            self._newest = live.gaussians
        if self.scene is None:
            self.show()
        return is_first

    def show(self) -> bool:
        """Put the newest splats into the same scene, so that the former depth order is kept; return
        whether there are any."""
        if self._newest is None or self._newest is self._shown:
            return False
        self._shown, new = self._newest, Scene.of(self._newest)
        if self.scene is None:
            self.scene = new
            return True
        scene = self.scene
        scene.gaussians, scene.labels, scene.state = new.gaussians, new.labels, new.state
        scene.placement, scene.source = new.placement, new.source
        scene.revision.splats_changed(kept=0)
        return True


def smoothed(losses: Sequence[float] | np.ndarray, n: int = _POINTS) -> list[tuple[float, float]]:
    """Return a curve of at most ``n`` points (iteration, mean loss) of the loss of every iteration.

    Each point is the mean over its share of the iterations: single views differ a lot.
    """
    values = np.asarray(losses, np.float64)
    if len(values) == 0:
        return []
    edges = np.unique(np.linspace(0, len(values), min(n, len(values)) + 1).astype(int))
    sums = np.add.reduceat(values, edges[:-1])
    means = sums / np.diff(edges)
    return [(float(x), float(y)) for x, y in zip(edges[1:], means, strict=True)]
