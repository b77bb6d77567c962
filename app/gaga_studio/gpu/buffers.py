"""Data textures: the splats of a scene on the graphics card, kept up to date by pulling.

Columns lie row after row in textures 2048 texels wide and are read with ``texelFetch``; OpenGL 3.3
has nothing better that every driver likes. A column is sent again only when its counter in
``scene.revision`` moved, and then only the lines of texels that differ.
"""

from collections import Counter

import moderngl
import numpy as np

from gaga_core.arrays import AnyArray, IntArray, UInt16Array
from gaga_core.color import group_palette
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.scene.scene import Placements, Revision, Scene, State

WIDTH = 2048
_BLOCK = 16 * WIDTH  # rows packed at a time: temporaries stay in the cache

DataTexture = moderngl.Texture | moderngl.TextureArray


class SceneBuffers:
    """The textures of one scene. ``version`` grows with every change of what they hold."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._scene: Scene | None = None
        self._seen = Revision()
        self._textures: dict[str, DataTexture] = {}
        self._sent: dict[str, AnyArray] = {}  # columns as they were sent
        self.version = 0
        self.n_splats = 0
        self.n_sh = 1
        self.log_scale_range = (0.0, 1.0)  # low end and range of the fixed-point log scales
        self.has_selected = False
        self.uploads: Counter[str] = Counter()  # how often each column was sent, in whole or part

    def sync(self, scene: Scene, labels: IntArray | None = None) -> None:
        """Send what changed since the last call. ``labels`` (N,) stand in for those of the scene.

        Raises `GagaError` when the graphics card cannot hold the scene.
        """
        now = scene.revision
        everything = scene is not self._scene or now.splats != self._seen.splats
        if everything:
            self._scene = scene
            self._replace(scene.gaussians)
        shown = scene.labels if labels is None or len(labels) != len(scene) else labels
        labels_changed = now.labels != self._seen.labels
        if everything or labels_changed or shown is not self._sent.get("labels"):
            self._send_labels(shown, in_place=labels_changed)
        if everything or now.state != self._seen.state:
            self._send_column("state", scene.state)
            bits = np.uint8(State.SELECTED | State.HIDDEN | State.DELETED)
            self.has_selected = bool(np.any((scene.state & bits) == State.SELECTED))
        if everything or now.placement != self._seen.placement:
            self._send_column("placement", scene.placement)
        if everything or now.placements != self._seen.placements:
            self._send_placements(scene.placements)
        self._seen = Revision(**vars(now))

    def clear(self) -> None:
        """Forget the scene: nothing is open."""
        if self._scene is not None:
            self._scene = None
            self.n_splats = 0
            self.has_selected = False
            self.version += 1
            self.release()

    @property
    def scene(self) -> Scene | None:
        """The scene that the textures hold."""
        return self._scene

    def textures(self) -> list[tuple[str, DataTexture]]:
        """Sampler names and textures of the projection pass."""
        return [(f"u_{name}", texture) for name, texture in self._textures.items()]

    def release(self) -> None:
        """Give every texture back."""
        for texture in self._textures.values():
            texture.release()
        self._textures.clear()
        self._sent.clear()

    def _replace(self, gaussians: Gaussians) -> None:
        """New textures for new splats."""
        self.release()
        n = len(gaussians)
        limit = int(self._ctx.info["GL_MAX_TEXTURE_SIZE"])
        if n > limit * WIDTH:
            raise GagaError(
                f"The scene has {n:,} splats, but this graphics card can hold {limit * WIDTH:,}. "
                "Open a smaller part of it."
            )
        self.n_splats = n
        self.n_sh = gaussians.sh.shape[1]
        self._column("means", 3, "f4")
        self._column("shape", 4, "u4")
        self._column("state", 1, "u1")
        self._column("labels", 1, "i4")
        self._column("placement", 1, "i4")
        n_layers = sh_layers(self.n_sh)
        lines = max(1, -(-n // WIDTH))
        sh = self._ctx.texture_array((WIDTH, lines, n_layers), 4, dtype="f2")
        sh.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._textures["sh"] = sh
        self._send_gaussians(gaussians, sh)
        self._count("gaussians")

    def _column(self, name: str, components: int, dtype: str) -> None:
        lines = max(1, -(-self.n_splats // WIDTH))
        texture = self._ctx.texture((WIDTH, lines), components, dtype=dtype)
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._textures[name] = texture

    def _send_gaussians(self, gaussians: Gaussians, sh: moderngl.TextureArray) -> None:
        self.log_scale_range = _log_scale_range(gaussians)
        for start in range(0, self.n_splats, _BLOCK):
            stop = min(start + _BLOCK, self.n_splats)
            write_rows(self._texture("means"), gaussians.means[start:stop], start)
            words = pack_shape(gaussians, start, stop, self.log_scale_range)
            write_rows(self._texture("shape"), words, start)
            layers = pack_sh(gaussians, start, stop)
            for first, width, height, rows in _pieces(layers.T, start):
                place = (first % WIDTH, first // WIDTH, 0, width, height, len(layers))
                sh.write(np.ascontiguousarray(rows.T), viewport=place)

    def _send_labels(self, labels: IntArray, *, in_place: bool) -> None:
        if in_place and labels is self._sent.get("labels"):
            del self._sent["labels"]
        self._send_column("labels", labels)
        n_groups = int(labels.max(initial=0))
        palette = self._textures.get("palette")
        if palette is None or palette.width * palette.height <= n_groups:
            colors = np.zeros(((n_groups // WIDTH + 1) * WIDTH, 4), np.float32)
            known = group_palette(len(colors) - 1)
            colors[:, :3] = known
            self._table("palette", (WIDTH, n_groups // WIDTH + 1), colors)

    def _send_column(self, name: str, column: AnyArray) -> None:
        before = self._sent.get(name)
        start, stop = 0, len(column)
        if before is not None and before is not column and len(before) == len(column):
            start, stop = changed_range(before, column)
        write_rows(self._texture(name), column[start:stop], start)
        self._sent[name] = column
        self._count(name)

    def _send_placements(self, placements: Placements) -> None:
        lines = -(-len(placements) // 128)
        texels = np.zeros((lines * 128, 16, 4), np.float32)
        texels[: len(placements)] = placement_texels(placements)
        self._table("placements", (WIDTH, lines), texels)
        self._count("placements")

    def _table(self, name: str, size: tuple[int, int], texels: AnyArray) -> None:
        """A small RGBA32F table, made anew when its size changed."""
        texture = self._textures.get(name)
        if texture is None or (texture.width, texture.height) != size:
            if texture is not None:
                texture.release()
            texture = self._ctx.texture(size, 4, dtype="f4")
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self._textures[name] = texture
        texture.write(texels)

    def _texture(self, name: str) -> moderngl.Texture:
        texture = self._textures[name]
        assert isinstance(texture, moderngl.Texture)
        return texture

    def _count(self, name: str) -> None:
        self.uploads[name] += 1
        self.version += 1


def sh_layers(n_sh: int) -> int:
    """Layers of four halfs that hold ``n_sh`` coefficients of three colors."""
    return -(-3 * n_sh // 4)


def write_rows(texture: moderngl.Texture, rows: AnyArray, start: int) -> None:
    """Write ``rows`` (K,) or (K, C) of a column from splat ``start`` on, straight from memory."""
    for first, width, height, piece in _pieces(rows, start):
        place = (first % WIDTH, first // WIDTH, width, height)
        texture.write(np.ascontiguousarray(piece), viewport=place)


def _pieces(rows: AnyArray, start: int) -> list[tuple[int, int, int, AnyArray]]:
    """Rectangles of texels that ``rows`` from ``start`` on fill: (first, width, height, rows)."""
    stop = start + len(rows)
    pieces = []
    at = start
    while at < stop:
        column = at % WIDTH
        if column == 0 and stop - at >= WIDTH:
            width, height = WIDTH, (stop - at) // WIDTH
        else:
            width, height = min(WIDTH - column, stop - at), 1
        n = width * height
        pieces.append((at, width, height, rows[at - start : at - start + n]))
        at += n
    return pieces


def changed_range(before: AnyArray, after: AnyArray) -> tuple[int, int]:
    """The shortest range of rows outside of which two columns (N,) agree."""
    differs = before != after
    if not differs.any():
        return 0, 0
    return int(differs.argmax()), len(differs) - int(differs[::-1].argmax())


def _log_scale_range(gaussians: Gaussians) -> tuple[float, float]:
    """Low end and range of the finite log scales; at most 40 wide (a factor of 10^17)."""
    logs = gaussians.log_scales
    finite = logs if np.isfinite(logs.sum(dtype=np.float64)) else logs[np.isfinite(logs)]
    high = float(finite.max(initial=-40.0))
    low = max(float(finite.min(initial=high)), high - 40.0)
    return low, max(high - low, 1e-3)


def pack_shape(
    gaussians: Gaussians, start: int, stop: int, log_scale_range: tuple[float, float]
) -> AnyArray:
    """Unit quaternion, log scales and opacity of rows start..stop as 8 x 16 bits: (K, 4) uint32.

    Fixed point is finer than halfs here: 3e-5 in a quaternion, 1e-4 in a scale that spans e^7.
    Rows with anything that is not finite, or a quaternion of no length, get opacity 0.
    """
    rows = slice(start, stop)
    quats, logs = gaussians.quats[rows], gaussians.log_scales[rows]
    means, logits = gaussians.means[rows], gaussians.logit_opacities[rows]
    words: UInt16Array = np.empty((len(quats), 8), np.uint16)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        norm = np.sqrt(np.einsum("ij,ij->i", quats, quats))
        sound = np.isfinite(norm) & (norm > 0) & np.isfinite(logs.sum(axis=1) + means.sum(axis=1))
        sound &= ~np.isnan(logits)
        scale = np.where(sound, 32767.5 / np.where(sound, norm, 1), 0).astype(np.float32)
        unit = np.where(sound[:, None], quats, 0) * scale[:, None]
        words[:, :4] = np.clip(unit + np.float32(32768.0), 0, 65535)
        low, span = log_scale_range
        fixed = (np.where(sound[:, None], logs, low) - np.float32(low)) * np.float32(65535 / span)
        words[:, 4:7] = np.clip(fixed + np.float32(0.5), 0, 65535)
        opacity = np.float32(65535) / (np.float32(1) + np.exp(-np.where(sound, logits, -100)))
        words[:, 7] = opacity + np.float32(0.5)
    return words.view(np.uint32)


def pack_sh(gaussians: Gaussians, start: int, stop: int) -> AnyArray:
    """SH coefficients of rows start..stop as halfs, four a texel: (L, K) uint64, layer by layer."""
    flat = gaussians.sh[start:stop].reshape(stop - start, -1)
    halfs = np.zeros((stop - start, 4 * sh_layers(gaussians.sh.shape[1])), np.float16)
    with np.errstate(over="ignore", invalid="ignore"):
        halfs[:, : flat.shape[1]] = flat
    return np.ascontiguousarray(halfs.view(np.uint64).T)


def placement_texels(placements: Placements) -> AnyArray:
    """Texels (P, 16, 4) float32: matrix 3, color 3, rotation back of directions 3, opacity 1.

    Directions are turned by the rotation nearest to the linear part (polar decomposition).
    """
    texels = np.zeros((len(placements), 16, 4), np.float32)
    texels[:, 0:3] = placements.matrix
    texels[:, 3:6] = placements.color
    u, _, vt = np.linalg.svd(np.asarray(placements.matrix, np.float64)[:, :, :3])
    texels[:, 6:9, :3] = np.swapaxes(u @ vt, 1, 2)
    texels[:, 9, 0] = placements.opacity
    return texels
