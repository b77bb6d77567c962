"""Draws the splats: a projection pass, once per splat, then sorted quads, far to near."""

from collections import Counter
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass

import moderngl
import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_studio.gpu.buffers import WIDTH, SceneBuffers, sh_layers, texture_bytes, write_rows
from gaga_studio.gpu.context import Target, bind_textures, load_program, set_uniforms
from gaga_studio.session.view import CentreColors, Mode

_QUADS = 128  # quads an instance: one alone keeps graphics cards idle
_MODES = {mode: number for number, mode in enumerate(Mode)}  # as project.frag numbers them
_CENTRES = {colors: number for number, colors in enumerate(CentreColors)}  # and centres' colors
_POINT = 1.6  # pixels: radius of a centre


@dataclass(frozen=True)
class Look:
    """What the splats' color says, and which of them are marked."""

    mode: Mode = Mode.COLOR
    hovered_group: int = 0
    with_mask: bool = False
    far: float = 1.0  # depth that is stored as 1
    focus: int = 0  # group that is white in Mode.MASK
    antialiased: bool = False  # the mip look (Yu 2024): what the blur widens, it thins out
    pixel_scale: float = 1.0  # of lines and points
    threshold: float = -np.inf  # of importance: those above it stand for those that are left out
    centre_colors: CentreColors = CentreColors.OWN  # in Mode.CENTRES


class SplatRenderer:
    """Programs, quad geometry, the depth order and the projected splats."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        # Color is half float: rounding to 8 bits at each of some 30 layers shows (see tests).
        self.picture = Target(ctx, [(4, "f2")], smooth=True)
        self.marked = Target(ctx, [(4, "f2"), (4, "f1")], smooth=True)
        self._projected = Target(ctx, [(4, "u4"), (2, "u4")])
        self._order: moderngl.Texture | None = None
        self._n_order = 0
        self._projectors: dict[int, tuple[moderngl.Program, moderngl.VertexArray]] = {}
        self._drawers: dict[tuple[str, ...], tuple[moderngl.Program, moderngl.VertexArray]] = {}
        self._corners = ctx.buffer(_corners())
        self._indices = ctx.buffer(_indices())
        self.passes: Counter[str] = Counter()

    def set_order(self, order: IntArray, n_splats: int) -> None:
        """Draw these splats (M,) of ``n_splats``, far to near; parts of a picture end."""
        lines = max(1, -(-n_splats // WIDTH))
        if self._order is None or self._order.height != lines:
            if self._order is not None:
                self._order.release()
            self._order = self._ctx.texture((WIDTH, lines), 1, dtype="u4")
            self._order.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self._projected.resize(WIDTH, lines)
        write_rows(self._order, order, 0)
        self._n_order = len(order)

    @property
    def nbytes(self) -> int:
        """Bytes of the depth order and the projected splats on the graphics card."""
        textures = [*self._projected.textures, *([self._order] if self._order else [])]
        return sum(texture_bytes(texture) for texture in textures)

    def draw(self, buffers: SceneBuffers, camera: Camera, look: Look) -> Target:
        """`draw_parts` at once."""
        parts = self.draw_parts(buffers, camera, look, lambda _: 0)
        while True:
            try:
                next(parts)
            except StopIteration as end:
                return end.value

    def draw_parts(
        self,
        buffers: SceneBuffers,
        camera: Camera,
        look: Look,
        size_of: Callable[[str], int],
    ) -> Generator[str, None, Target]:
        """Blend the splats into a target of the camera's size; which one, is returned.

        Yields "project" or "blend" between parts; ``size_of`` says how many splats the next part
        of that name has, 0 = all the rest. Blending goes far to near whatever the parts, so the
        picture is the same to the bit. Where buffers change in between, some splats are drawn
        as they were and some as they are; with another depth order it has to begin again.

        Attachment 0 is premultiplied color and alpha; in depth mode red is the sum of weight times
        depth / far. Attachment 1 is there with a mask: shares of selected and of hovered splats.
        """
        target = self.marked if look.with_mask else self.picture
        target.resize(camera.width, camera.height)
        n_order = self._n_order
        if n_order > 0 and buffers.n_splats > 0:
            yield from self._project(buffers, camera, look, size_of)
            target.begin().clear(0.0, 0.0, 0.0, 0.0)
            yield from self._blend(target, n_order, camera, look, size_of)
        else:
            target.begin().clear(0.0, 0.0, 0.0, 0.0)
        return target

    def release(self) -> None:
        """Give everything back."""
        for _, geometry in (*self._projectors.values(), *self._drawers.values()):
            geometry.release()
        for program, _ in (*self._projectors.values(), *self._drawers.values()):
            program.release()
        self._projectors.clear()
        self._drawers.clear()
        for target in (self.picture, self.marked, self._projected):
            target.release()
        if self._order is not None:
            self._order.release()
            self._order = None
        self._corners.release()
        self._indices.release()

    def _project(
        self, buffers: SceneBuffers, camera: Camera, look: Look, size_of: Callable[[str], int]
    ) -> Generator[str, None, None]:
        program, geometry = self._projector(buffers.n_sh)
        n_lines = -(-self._n_order // WIDTH)
        for first, n in _parts(n_lines, lambda: -(-size_of("project") // WIDTH)):
            self._set_projection(program, buffers, camera, look)
            framebuffer = self._projected.begin()
            framebuffer.viewport = (0, 0, WIDTH, n_lines)
            framebuffer.scissor = (0, first, WIDTH, n)
            self._ctx.disable(moderngl.BLEND)
            geometry.render(moderngl.TRIANGLES, vertices=3)
            if first + n < n_lines:
                yield "project"
        self.passes["project"] += 1

    def _set_projection(
        self, program: moderngl.Program, buffers: SceneBuffers, camera: Camera, look: Look
    ) -> None:
        order = self._order
        assert order is not None
        bind_textures(program, [("u_order", order), *buffers.textures()])
        K = camera.K
        set_uniforms(
            program,
            {
                "u_count": self._n_order,
                "u_cam_from_world": camera.cam_from_world.T.astype(np.float32).tobytes(),
                "u_eye": tuple(camera.position.tolist()),
                "u_lens": (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])),
                "u_size": (float(camera.width), float(camera.height)),
                "u_log_scale": buffers.log_scale_range,
                "u_mode": _MODES[look.mode],
                "u_hovered": look.hovered_group,
                "u_focus": look.focus,
                "u_antialiased": int(look.antialiased),
                "u_tinted": int(buffers.is_tinted),
                "u_centre_colors": _CENTRES[look.centre_colors],
                "u_threshold": max(look.threshold, -1e9),
                "u_point": _POINT * look.pixel_scale,
            },
        )

    def _blend(
        self,
        target: Target,
        n_order: int,
        camera: Camera,
        look: Look,
        size_of: Callable[[str], int],
    ) -> Generator[str, None, None]:
        program, geometry = self._drawer(look)
        ellipses, looks = self._projected.textures
        n_instances = -(-n_order // _QUADS)
        for first, n in _parts(n_instances, lambda: -(-size_of("blend") // _QUADS)):
            target.begin()
            bind_textures(program, [("u_ellipses", ellipses), ("u_looks", looks)])
            set_uniforms(
                program,
                {
                    "u_count": n_order,
                    "u_first": first,
                    "u_size": (float(camera.width), float(camera.height)),
                    "u_far": look.far,
                },
            )
            self._ctx.enable(moderngl.BLEND)
            self._ctx.blend_func = (moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA)
            geometry.render(moderngl.TRIANGLES, instances=n)
            self._ctx.disable(moderngl.BLEND)
            if first + n < n_instances:
                yield "blend"
        self.passes["blend"] += 1

    def _projector(self, n_sh: int) -> tuple[moderngl.Program, moderngl.VertexArray]:
        if n_sh not in self._projectors:
            defines = {"N_SH": n_sh, "N_LAYERS": sh_layers(n_sh)}
            program = load_program(self._ctx, "full.vert", "project.frag", defines)
            self._projectors[n_sh] = program, self._ctx.vertex_array(program, [])
        return self._projectors[n_sh]

    def _drawer(self, look: Look) -> tuple[moderngl.Program, moderngl.VertexArray]:
        kinds = {Mode.DEPTH: "DEPTH", Mode.CENTRES: "CENTRES", Mode.RINGS: "RINGS"}
        key = tuple(filter(None, (kinds.get(look.mode), "MASK" if look.with_mask else None)))
        if key not in self._drawers:
            defines = dict.fromkeys(key, 1)
            program = load_program(self._ctx, "quads.vert", "quads.frag", defines)
            content = [(self._corners, "3f", "in_corner")]
            self._drawers[key] = program, self._ctx.vertex_array(program, content, self._indices)
        return self._drawers[key]


def _parts(n: int, size: Callable[[], int]) -> Iterator[tuple[int, int]]:
    """(first, length) of parts that cover 0..n; ``size`` is asked before each, 0 = the rest."""
    first = 0
    while first < n:
        length = min(size() or n, n - first)
        yield first, length
        first += length


def _corners() -> bytes:
    quad = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float32)
    corners = np.empty((_QUADS, 4, 3), np.float32)
    corners[:, :, :2] = quad
    corners[:, :, 2] = np.arange(_QUADS)[:, None]
    return corners.tobytes()


def _indices() -> bytes:
    quad = np.array([0, 1, 2, 0, 2, 3], np.uint32)
    return (quad + 4 * np.arange(_QUADS, dtype=np.uint32)[:, None]).astype(np.uint32).tobytes()
