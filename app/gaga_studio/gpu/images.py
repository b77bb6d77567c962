"""Photos, masks and thumbnails as textures, decoded in a thread and uploaded when asked for.

Objects are drawn, a few a frame, in the thread of the window, next to the viewport's own picture.
"""

import logging
import queue
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable

import moderngl
import numpy as np

from gaga_core.arrays import UInt8Array
from gaga_core.errors import GagaError
from gaga_core.scene.object_picture import GROUND, ObjectDrawing
from gaga_core.scene.scene import Scene
from gaga_studio.gpu.buffers import SceneBuffers
from gaga_studio.gpu.context import Target, drawing
from gaga_studio.gpu.overlays import Compositor, Finish
from gaga_studio.gpu.splats import Look, SplatRenderer
from gaga_studio.session.view import Picture

_LOG = logging.getLogger(__name__)

Load = Callable[[], Picture]
_DRAWING_S = 0.02  # of a frame: small objects take 5 ms in software, large ones 90
_WAITING_MAX = 64  # requests that scrolled away are dropped, oldest first


class _ObjectPainter:
    """Draws objects: with programs and textures of its own, so the viewport may be half done."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._buffers = SceneBuffers(ctx)
        self._splats = SplatRenderer(ctx)
        self._compositor = Compositor(ctx)
        self._picture = Target(ctx, [(4, "f1")])

    def draw(self, picture: ObjectDrawing) -> UInt8Array:
        """The picture (H, W, 3), first row on top."""
        splats, camera = picture.splats, picture.camera
        with drawing(self._ctx):
            self._buffers.sync(Scene.of(splats))
            self._splats.set_order(np.arange(len(splats), dtype=np.int32), len(splats))
            look = Look(antialiased=splats.is_antialiased)
            blended = self._splats.draw(self._buffers, camera, look)
            self._picture.resize(camera.width, camera.height)
            self._compositor.draw(blended, self._picture, Finish((GROUND / 255,) * 3))
            data = self._picture.framebuffer.read(components=3, alignment=1)
        self._buffers.clear()
        return np.frombuffer(data, np.uint8).reshape(camera.height, camera.width, 3)[::-1].copy()

    def release(self) -> None:
        """Give every OpenGL object back."""
        for part in (self._compositor, self._splats, self._buffers, self._picture):
            part.release()


class ImageStore:
    """Textures by key. The least recently asked for go when ``budget_bytes`` is exceeded."""

    def __init__(self, ctx: moderngl.Context, *, budget_bytes: int = 256 << 20) -> None:
        self._ctx = ctx
        self._budget = budget_bytes
        self._textures: OrderedDict[str, moderngl.Texture] = OrderedDict()
        self._failed: set[str] = set()
        self._loads: OrderedDict[str, Load] = OrderedDict()  # the newest is decoded first
        self._decoding = ""
        self._decoded: queue.SimpleQueue[tuple[str, Picture | None]] = queue.SimpleQueue()
        self._undrawn: deque[tuple[str, ObjectDrawing]] = deque()
        self._painter: _ObjectPainter | None = None
        self._changed = threading.Condition()
        self._ended = False
        self._thread = threading.Thread(target=self._work, name="gaga-images", daemon=True)
        self._thread.start()

    def texture(self, key: str, load: Load | None) -> tuple[int, int, int] | None:
        """OpenGL name, width and height; None while it is loading, and if it cannot be read.

        ``load`` gives the picture, or the object to draw, and runs in a thread of the store, once;
        without it only what is there is given. Row 0 of the texture is the picture's first row.
        """
        self._take()
        texture = self._textures.get(key)
        if texture is not None:
            self._textures.move_to_end(key)
            return int(texture.glo), texture.width, texture.height
        if load is not None and key not in self._failed:
            self._request(key, load)
        return None

    def cannot_read(self, key: str) -> bool:
        """Whether a picture was asked for and could not be read."""
        self._take()
        return key in self._failed

    @property
    def loading(self) -> bool:
        """Whether something asked for is not there yet: keep the window awake."""
        with self._changed:
            is_decoding = bool(self._loads) or self._decoding != ""
        return is_decoding or bool(self._undrawn) or not self._decoded.empty()

    def receive(self) -> None:
        """Once a frame: send decoded pictures to the card, and draw an object or a few."""
        self._take()
        until = time.perf_counter() + _DRAWING_S
        while self._undrawn:
            key, picture = self._undrawn.popleft()
            self._painter = self._painter or _ObjectPainter(self._ctx)
            self._keep(key, self._painter.draw(picture))
            if time.perf_counter() > until:
                return

    def _take(self) -> None:
        while not self._decoded.empty():
            key, pixels = self._decoded.get_nowait()
            if pixels is None:
                self._failed.add(key)
            elif isinstance(pixels, ObjectDrawing):
                self._undrawn.append((key, pixels))
            elif key not in self._textures:
                self._keep(key, pixels)

    def _keep(self, key: str, pixels: UInt8Array) -> None:
        self._textures[key] = self._upload(pixels)
        used = sum(4 * texture.width * texture.height for texture in self._textures.values())
        while len(self._textures) > 1 and used > self._budget:
            _, oldest = self._textures.popitem(last=False)
            used -= 4 * oldest.width * oldest.height
            oldest.release()

    def drop(self, key: str) -> None:
        """Forget one picture: it changed, or is of no use any more."""
        self._take()
        self._undrawn = deque(waiting for waiting in self._undrawn if waiting[0] != key)
        self._failed.discard(key)
        with self._changed:
            self._loads.pop(key, None)
        texture = self._textures.pop(key, None)
        if texture is not None:
            texture.release()

    def clear(self) -> None:
        """Forget every picture: another scene was opened."""
        with self._changed:
            self._loads.clear()
            # One that is being decoded belongs to the old scene: a key may mean another file now.
            self._changed.wait_for(lambda: self._decoding == "" or self._ended, timeout=10)
        while not self._decoded.empty():
            self._decoded.get_nowait()
        self._undrawn.clear()
        self._failed.clear()
        for texture in self._textures.values():
            texture.release()
        self._textures.clear()

    def release(self) -> None:
        """Give every texture back and end the thread."""
        self.clear()
        if self._painter is not None:
            self._painter.release()
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._thread.join(timeout=10)

    def _request(self, key: str, load: Load) -> None:
        with self._changed:
            if key == self._decoding or any(key == waiting for waiting, _ in self._undrawn):
                return
            self._loads[key] = load
            self._loads.move_to_end(key)
            while len(self._loads) > _WAITING_MAX:
                self._loads.popitem(last=False)
            self._changed.notify_all()

    def _upload(self, pixels: UInt8Array) -> moderngl.Texture:
        height, width, channels = pixels.shape
        texture = self._ctx.texture((width, height), channels, pixels, alignment=1)
        texture.build_mipmaps()
        texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        texture.repeat_x = texture.repeat_y = False
        return texture

    def _work(self) -> None:
        while (request := self._next()) is not None:
            key, load = request
            pixels = _decoded(key, load)
            with self._changed:
                self._decoded.put((key, pixels))
                self._decoding = ""
                self._changed.notify_all()

    def _next(self) -> tuple[str, Load] | None:
        with self._changed:
            self._changed.wait_for(lambda: bool(self._loads) or self._ended)
            if self._ended:
                return None
            key, load = self._loads.popitem(last=True)
            self._decoding = key
            return key, load


def _decoded(key: str, load: Load) -> Picture | None:
    """The picture, or None when it cannot be read: a missing photo leaves an empty frame."""
    try:
        pixels = load()
    except (GagaError, OSError, ValueError) as error:
        _LOG.warning("%s cannot be shown: %s", key, error)
        return None
    if isinstance(pixels, ObjectDrawing):
        return pixels
    if pixels.ndim != 3 or pixels.shape[2] not in (3, 4) or pixels.size == 0:
        _LOG.warning("%s cannot be shown: it has the shape %s", key, pixels.shape)
        return None
    return np.ascontiguousarray(pixels, np.uint8)
