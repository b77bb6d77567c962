"""Textures to draw into, with the framebuffer that they belong to."""

from collections.abc import Sequence

import moderngl


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
