"""The OpenGL context of the window, programs from shader files, and textures to draw into."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import glfw
import moderngl

from gaga_core.camera import NEAR
from gaga_core.errors import GagaError
from gaga_core.io.files import assets

GLSL_VERSION = 330  # OpenGL 3.3 core: what macOS has too
_SOFTWARE = ("llvmpipe", "softpipe", "swiftshader", "software", "basic render")

Uniform = int | float | tuple[float, ...] | bytes


class GlfwLoader:
    """Finds OpenGL functions for moderngl with GLFW, whatever made the current context.

    moderngl's own way assumes GLX on Linux; a Wayland window has an EGL context.
    """

    standalone = False

    def load_opengl_function(self, name: str) -> int:
        """Address of an OpenGL function, 0 when there is none."""
        return int(glfw.get_proc_address(name) or 0)

    load = load_opengl_function

    def __enter__(self) -> None:
        """Nothing to switch: the window's context is current whenever the window draws."""

    def __exit__(self, *_: object) -> None:
        """Nothing to switch back."""

    def release(self) -> None:
        """Nothing to release: the context belongs to the window."""


def attach() -> moderngl.Context:
    """moderngl's view of the current context of the window (OpenGL 3.3 core or newer).

    Raises `GagaError` when there is no such context.
    """
    try:
        if glfw.get_current_context():
            # The stub knows the parameter by another name only.
            options: dict[str, Any] = {"context": GlfwLoader()}
            return moderngl.create_context(require=GLSL_VERSION, **options)
        return moderngl.create_context(require=GLSL_VERSION)
    except (moderngl.Error, ValueError) as error:
        raise GagaError(
            f"The graphics driver offers no OpenGL 3.3 ({error}). Install or update it."
        ) from error


def is_software(ctx: moderngl.Context) -> bool:
    """Whether this context draws on the processor: pictures take a good part of a second."""
    renderer = str(ctx.info["GL_RENDERER"]).lower()
    return any(name in renderer for name in _SOFTWARE)


def load_program(
    ctx: moderngl.Context,
    vertex: str,
    fragment: str,
    defines: Mapping[str, float] | None = None,
) -> moderngl.Program:
    """Program of two files of ``assets/shaders``, ``common.glsl`` put before each."""
    head = f"#version {GLSL_VERSION}\n"
    head += "".join(f"#define {name} {value}\n" for name, value in (defines or {}).items())
    head += f"#define NEAR {NEAR}\nprecision highp float;\nprecision highp int;\n"
    head += (assets() / "shaders" / "common.glsl").read_text(encoding="utf-8")
    sources = [
        (assets() / "shaders" / name).read_text(encoding="utf-8") for name in (vertex, fragment)
    ]
    return ctx.program(vertex_shader=head + sources[0], fragment_shader=head + sources[1])


def set_uniforms(program: moderngl.Program, values: Mapping[str, Uniform]) -> None:
    """Set the uniforms that this program uses; a variant that lacks one is no error."""
    for name, value in values.items():
        member = program.get(name, None)
        if not isinstance(member, moderngl.Uniform):
            continue
        if isinstance(value, bytes):
            member.write(value)
        else:
            member.value = value


def bind_textures(
    program: moderngl.Program,
    textures: Sequence[tuple[str, moderngl.Texture | moderngl.TextureArray]],
) -> None:
    """Bind each texture to a unit of its own and tell the samplers."""
    for unit, (name, texture) in enumerate(textures):
        texture.use(unit)
        set_uniforms(program, {name: unit})


@contextmanager
def drawing(ctx: moderngl.Context) -> Iterator[None]:
    """Draw into framebuffers of our own and leave the window's one bound as it was."""
    before = ctx.detect_framebuffer()
    ctx.disable(moderngl.DEPTH_TEST | moderngl.CULL_FACE | moderngl.BLEND)
    try:
        yield
    finally:
        before.use()


# --- Textures to draw into, with the framebuffer that they belong to.


class Target:
    """Color attachments of one size; made again when the size changes."""

    def __init__(
        self, ctx: moderngl.Context, formats: Sequence[tuple[int, str]], *, smooth: bool = False
    ) -> None:
        self._ctx = ctx
        self._formats = tuple(formats)  # (components, dtype) of each attachment
        self._filter = moderngl.LINEAR if smooth else moderngl.NEAREST
        self.textures: list[moderngl.Texture] = []
        self._framebuffer: moderngl.Framebuffer | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, (0, 0) before the first ``resize``."""
        return self.textures[0].size if self.textures else (0, 0)

    @property
    def framebuffer(self) -> moderngl.Framebuffer:
        """What to draw into; ``resize`` comes first."""
        assert self._framebuffer is not None
        return self._framebuffer

    def resize(self, width: int, height: int) -> None:
        """Have this size; what was drawn is lost if it changed."""
        if self.size == (width, height):
            return
        self.release()
        for components, dtype in self._formats:
            texture = self._ctx.texture((width, height), components, dtype=dtype)
            texture.filter = (self._filter, self._filter)
            texture.repeat_x = texture.repeat_y = False
            self.textures.append(texture)
        self._framebuffer = self._ctx.framebuffer(self.textures)

    def begin(self) -> moderngl.Framebuffer:
        """Bind it, whole and unclipped."""
        framebuffer = self.framebuffer
        framebuffer.use()
        framebuffer.viewport = (0, 0, *self.size)
        framebuffer.scissor = (0, 0, *self.size)
        return framebuffer

    def release(self) -> None:
        """Give the textures back."""
        if self._framebuffer is not None:
            self._framebuffer.release()
            self._framebuffer = None
        for texture in self.textures:
            texture.release()
        self.textures.clear()
