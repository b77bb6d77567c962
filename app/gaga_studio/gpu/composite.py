"""The last pass: blended splats to the finished picture, with depth colors and outlines."""

import math
from dataclasses import dataclass

import moderngl
import numpy as np

from gaga_core.color import DEPTH_POLYNOMIAL
from gaga_studio.gpu.context import bind_textures, load_program, set_uniforms
from gaga_studio.gpu.targets import Target

ACCENT = (0.36, 0.66, 1.0)  # outline of what is selected
HOVER = (1.0, 1.0, 1.0)  # outline of what is under the cursor
_SELECTED_WIDTH = 2.0  # pixels
_HOVER_WIDTH = 1.2
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
        self._variants: dict[tuple[bool, bool], tuple[moderngl.Program, moderngl.VertexArray]] = {}

    def draw(self, splats: Target | None, picture: Target, finish: Finish) -> None:
        """Fill ``picture``; without splats it is plain background."""
        framebuffer = picture.begin()
        if splats is None:
            framebuffer.clear(*finish.background, 1.0)
            return
        near, far = finish.depth_range or (1.0, 1.0)
        program, geometry = self._variant(finish.depth_range is not None, finish.with_mask)
        textures = [("u_splats", splats.textures[0])]
        if finish.with_mask:
            textures.append(("u_mask", splats.textures[1]))
        bind_textures(program, textures)
        set_uniforms(
            program,
            {
                "u_picture": (float(picture.size[0]), float(picture.size[1])),
                "u_background": finish.background,
                "u_near_far": (math.log(near), math.log(far)),
                "u_far": far,
                "u_depth_polynomial": _DEPTH_POLYNOMIAL,
                "u_accent": ACCENT,
                "u_hover": HOVER,
                "u_outline": (
                    _SELECTED_WIDTH * finish.pixel_scale,
                    _HOVER_WIDTH * finish.pixel_scale,
                ),
            },
        )
        geometry.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        """Give the programs back."""
        for program, geometry in self._variants.values():
            geometry.release()
            program.release()
        self._variants.clear()

    def _variant(
        self, has_depth: bool, has_mask: bool
    ) -> tuple[moderngl.Program, moderngl.VertexArray]:
        key = (has_depth, has_mask)
        if key not in self._variants:
            names = ("DEPTH", "MASK")
            defines = {name: 1 for name, wanted in zip(names, key, strict=True) if wanted}
            program = load_program(self._ctx, "full.vert", "composite.frag", defines)
            self._variants[key] = program, self._ctx.vertex_array(program, [])
        return self._variants[key]
