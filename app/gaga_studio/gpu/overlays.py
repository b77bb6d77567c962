"""The last passes: depth colors and outlines, then frusta, grid and axes over the picture."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import moderngl
import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.color import DEPTH_POLYNOMIAL
from gaga_core.scene.scene import RGB
from gaga_studio.gpu.context import Target, bind_textures, load_program, set_uniforms

# --- The last pass: blended splats to the finished picture, with depth colors and outlines.

ACCENT = (0.36, 0.66, 1.0)  # outline of what is selected
HOVER = (1.0, 1.0, 1.0)  # outline of what is under the cursor
_SELECTED_WIDTH = 2.0  # pixels
_HOVER_WIDTH = 1.2
# Of an area with more outlines than that across it, each is fainter: splats that are selected among
# others that are not have one around each. 32 pixels at a scale of 1: as wide as 16 lines.
_AREA, _MOST_LINES = 32.0, 2.0
_TILE = 16  # pixels, of the squares that an outline reaches or not; any width draws the same
_DEPTH_POLYNOMIAL = np.array(DEPTH_POLYNOMIAL, np.float32).tobytes()


@dataclass(frozen=True)
class Finish:
    """Settings of the pass."""

    background: tuple[float, float, float]
    with_mask: bool = False
    depth_range: tuple[float, float] | None = None  # near, far; None: not depth
    pixel_scale: float = 1.0  # outline widths grow with it


class Compositor:
    """Programs of the pass."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._variants: dict[tuple[str, ...], tuple[moderngl.Program, moderngl.VertexArray]] = {}
        self._marks = Target(ctx, [(1, "f1")])
        self._crowding = Target(ctx, [(2, "f2")], smooth=True)

    def draw(self, splats: Target | None, picture: Target, finish: Finish) -> None:
        """Fill ``picture``; without splats it is plain background.

        An outline takes 48 samples a pixel, so only the tiles that one can reach get that pass.
        """
        if splats is None:
            picture.begin().clear(*finish.background, 1.0)
            return
        textures = [("u_splats", splats.textures[0])]
        picture.begin()
        self._pass("full.vert", picture, finish, textures)
        if not finish.with_mask:
            return
        mask = ("u_mask", splats.textures[1])
        self._mark(mask, picture, finish)
        self._count(mask, picture, finish)
        picture.begin()
        marks = ("u_marks", self._marks.textures[0])
        crowding = ("u_crowding", self._crowding.textures[0])
        self._pass("tiles.vert", picture, finish, [*textures, mask, marks, crowding])

    def _mark(self, mask: tuple[str, moderngl.Texture], picture: Target, finish: Finish) -> None:
        """Find the tiles that an outline reaches."""
        width, height = picture.size
        self._marks.resize(-(-width // _TILE), -(-height // _TILE))
        self._marks.begin()
        program, geometry = self._variant("full.vert", "marks.frag")
        bind_textures(program, [mask])
        reach = 2.0 * max(_SELECTED_WIDTH, _HOVER_WIDTH) * finish.pixel_scale
        set_uniforms(program, {"u_picture": (float(width), float(height)), "u_reach": reach})
        geometry.render(moderngl.TRIANGLES, vertices=3)

    def _count(self, mask: tuple[str, moderngl.Texture], picture: Target, finish: Finish) -> None:
        """Find how many outlines there are in each area."""
        width, height = picture.size
        area = _AREA * finish.pixel_scale
        self._crowding.resize(math.ceil(width / area), math.ceil(height / area))
        self._crowding.begin()
        program, geometry = self._variant("full.vert", "crowding.frag")
        bind_textures(program, [mask])
        set_uniforms(program, {"u_picture": (float(width), float(height)), "u_area": area})
        geometry.render(moderngl.TRIANGLES, vertices=3)

    def _pass(
        self,
        vertex: str,
        picture: Target,
        finish: Finish,
        textures: Sequence[tuple[str, moderngl.Texture]],
    ) -> None:
        """Finish the whole picture without outlines, or its marked tiles with them."""
        near, far = finish.depth_range or (1.0, 1.0)
        width, height = picture.size
        has_mask = vertex == "tiles.vert"
        kinds = {"DEPTH": finish.depth_range is not None, "MASK": has_mask}
        defines = [name for name, is_wanted in kinds.items() if is_wanted]
        program, geometry = self._variant(vertex, "composite.frag", *defines)
        bind_textures(program, textures)
        set_uniforms(
            program,
            {
                "u_picture": (float(width), float(height)),
                "u_background": finish.background,
                "u_near_far": (math.log(near), math.log(far)),
                "u_far": far,
                "u_depth_polynomial": _DEPTH_POLYNOMIAL,
                "u_accent": ACCENT,
                "u_hover": HOVER,
                "u_area": _AREA * finish.pixel_scale,
                "u_outline": (
                    _SELECTED_WIDTH * finish.pixel_scale,
                    _HOVER_WIDTH * finish.pixel_scale,
                ),
            },
        )
        if has_mask:
            n_tiles = self._marks.size[0] * self._marks.size[1]
            geometry.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=n_tiles)
        else:
            geometry.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        """Give everything back."""
        self._marks.release()
        self._crowding.release()
        for program, geometry in self._variants.values():
            geometry.release()
            program.release()
        self._variants.clear()

    def _variant(
        self, vertex: str, fragment: str, *defines: str
    ) -> tuple[moderngl.Program, moderngl.VertexArray]:
        key = (vertex, fragment, *defines)
        if key not in self._variants:
            program = load_program(
                self._ctx,
                vertex,
                fragment,
                {"TILE": _TILE, "MOST_LINES": _MOST_LINES, **dict.fromkeys(defines, 1)},
            )
            self._variants[key] = program, self._ctx.vertex_array(program, [])
        return self._variants[key]


_FRUSTUM = (0.86, 0.88, 0.92, 0.5)
_GRID = (0.75, 0.77, 0.8, 0.16)
_AXES = ((0.93, 0.36, 0.36, 0.9), (0.45, 0.8, 0.4, 0.9), (0.36, 0.56, 0.95, 0.9))


@dataclass(frozen=True, eq=False)
class Ground:
    """A grid with the world's axes. Compared by identity: keep it as long as it is the same."""

    origin: DoubleArray  # (3,) world
    up: DoubleArray  # (3,) unit, world
    spacing: float
    n_cells: int = 10  # to each side


@dataclass(frozen=True)
class Overlays:
    """What is shown in addition to the scene."""

    cameras: tuple[Camera, ...] = ()  # frusta to draw
    active_camera: int | None = None  # index of the highlighted one
    labels: IntArray | None = field(default=None, compare=False)  # (N,) instead of scene.labels
    # (N, 4) color over each splat's own, and its share 0..255. Compared by identity.
    tint: UInt8Array | None = field(default=None, compare=False)
    muted: Mapping[int, RGB] = field(default_factory=dict)  # colors of groups instead
    hovered_group: int = 0
    focused_group: int = 0  # the one that Mode.MASK shows
    ground: Ground | None = None
    pixel_scale: float = 1.0  # of line widths: 2 on a screen with two pixels a point


class LineRenderer:
    """Draws the lines of overlays as soft-edged quads, over everything."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._program = load_program(ctx, "lines.vert", "lines.frag")
        corners = np.array([[0, -1], [1, -1], [0, 1], [1, 1]], np.float32)
        self._corners = ctx.buffer(corners.tobytes())
        self._segments: moderngl.Buffer | None = None
        self._geometry: moderngl.VertexArray | None = None
        self._n_segments = 0
        self._shown: tuple[object, ...] = ()

    def draw(self, camera: Camera, overlays: Overlays) -> None:
        """Draw into the bound framebuffer of the camera's size."""
        self._sync(overlays)
        if self._geometry is None or self._n_segments == 0:
            return
        K = camera.K
        set_uniforms(
            self._program,
            {
                "u_cam_from_world": camera.cam_from_world.T.astype(np.float32).tobytes(),
                "u_lens": (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])),
                "u_size": (float(camera.width), float(camera.height)),
                "u_width_scale": overlays.pixel_scale,
            },
        )
        self._ctx.enable(moderngl.BLEND)
        self._ctx.blend_func = (moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA)
        self._geometry.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=self._n_segments)
        self._ctx.disable(moderngl.BLEND)

    def release(self) -> None:
        """Give everything back."""
        self._drop()
        self._program.release()
        self._corners.release()

    def _sync(self, overlays: Overlays) -> None:
        shown = (overlays.cameras, overlays.active_camera, overlays.ground)
        if shown == self._shown:
            return
        self._shown = shown
        self._drop()
        segments = overlay_segments(overlays)
        self._n_segments = len(segments)
        if len(segments) == 0:
            return
        self._segments = self._ctx.buffer(segments.tobytes())
        names = ("in_from", "in_to", "in_color", "in_width")
        content = [(self._corners, "2f", "in_corner"), (self._segments, "3f 3f 4f 1f/i", *names)]
        self._geometry = self._ctx.vertex_array(self._program, content)

    def _drop(self) -> None:
        if self._geometry is not None:
            self._geometry.release()
            self._geometry = None
        if self._segments is not None:
            self._segments.release()
            self._segments = None
        self._n_segments = 0


def overlay_segments(overlays: Overlays) -> FloatArray:
    """Segments (L, 11): from, to (world), rgba, width in pixels; later ones lie over earlier."""
    parts = []
    if overlays.ground is not None:
        parts.append(_ground_segments(overlays.ground))
    if overlays.cameras:
        size = frustum_size(overlays.cameras)
        active = overlays.active_camera
        for i, camera in enumerate(overlays.cameras):
            if i != active:
                parts.append(_styled(frustum_segments(camera, size), _FRUSTUM, 1.0))
        if active is not None and 0 <= active < len(overlays.cameras):
            lines = frustum_segments(overlays.cameras[active], size)
            parts.append(_styled(lines, (*ACCENT, 1.0), 2.0))
    return np.concatenate(parts) if parts else np.zeros((0, 11), np.float32)


def frustum_size(cameras: tuple[Camera, ...]) -> float:
    """Depth of a drawn frustum, scene units: well under the distance to the next camera."""
    positions = np.array([camera.position for camera in cameras])
    if len(cameras) < 2:
        return 0.2
    distances = np.asarray(cKDTree(positions).query(positions, k=2)[0])
    spread = float(np.linalg.norm(np.ptp(positions, axis=0)))
    return max(0.55 * float(np.median(distances[:, 1])), 0.01 * spread, 1e-6)


def frustum_segments(camera: Camera, depth: float) -> DoubleArray:
    """Edges (9, 2, 3) world: four rays, the border of the picture, a tick on its upper side."""
    w, h = camera.width, camera.height
    corners = [camera.unproject(u, v, depth) for u, v in ((0, 0), (w, 0), (w, h), (0, h))]
    middle, top = camera.unproject(w / 2, 0, depth), camera.unproject(w / 2, -0.18 * h, depth)
    pairs = [(camera.position, corner) for corner in corners]
    pairs += [(corners[k], corners[(k + 1) % 4]) for k in range(4)]
    pairs.append((middle, top))
    return np.array(pairs)


def _ground_segments(ground: Ground) -> FloatArray:
    up = np.asarray(ground.up, np.float64)
    side = np.eye(3)[int(np.argmin(np.abs(up)))]
    right = np.cross(up, side)
    right /= np.linalg.norm(right)
    ahead = np.cross(up, right)
    steps = np.arange(-ground.n_cells, ground.n_cells + 1) * ground.spacing
    end = ground.n_cells * ground.spacing
    lines = []
    for a, b in ((right, ahead), (ahead, right)):
        lines += [(a * s - b * end, a * s + b * end) for s in steps]
    grid = _styled(np.array(lines) + ground.origin, _GRID, 1.0)
    axes = [
        _styled(np.array([[ground.origin, ground.origin + ground.spacing * axis]]), color, 2.0)
        for axis, color in zip(np.eye(3), _AXES, strict=True)
    ]
    return np.concatenate([grid, *axes])


def _styled(
    segments: DoubleArray, color: tuple[float, float, float, float], width: float
) -> FloatArray:
    rows = np.empty((len(segments), 11), np.float32)
    rows[:, :6] = segments.reshape(len(segments), 6)
    rows[:, 6:10] = color
    rows[:, 10] = width
    return rows
