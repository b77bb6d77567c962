"""Data textures: the splats of a scene on the graphics card, kept up to date by pulling.

Columns lie row after row in textures 2048 texels wide and are read with ``texelFetch``; OpenGL 3.3
has nothing better that every driver likes. A column is sent again only when its counter in
``scene.revision`` moved, and then only the lines of texels that differ. Splats that were appended
are sent alone.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import moderngl
import numpy as np

from gaga_core.arrays import AnyArray, FloatArray, IntArray, UInt8Array, UInt16Array, UInt32Array
from gaga_core.color import group_palette
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.scene.scene import RGB, Placements, Revision, Scene, State

# --- Packing of splats for the graphics card: 43 bytes each without view-dependent color.
# A splat of degree 3 takes 91 bytes in data textures; depth order and projected splats (`splats`)
# add 28. The files of most trainers hold 248.

WIDTH = 2048  # texels of a line of every data texture
_COMPARED = 1 << 16  # rows at a time, from both ends: what changed is mostly found in the first


def sh_layers(n_sh: int) -> int:
    """Layers of eight bytes that hold ``n_sh`` - 1 coefficients of three colors."""
    return -(-3 * (n_sh - 1) // 8)


def pieces(rows: AnyArray, start: int) -> list[tuple[int, int, int, AnyArray]]:
    """Rectangles of texels that ``rows`` from ``start`` on fill: (first, width, height, rows)."""
    stop = start + len(rows)
    found = []
    at = start
    while at < stop:
        column = at % WIDTH
        if column == 0 and stop - at >= WIDTH:
            width, height = WIDTH, (stop - at) // WIDTH
        else:
            width, height = min(WIDTH - column, stop - at), 1
        n = width * height
        found.append((at, width, height, rows[at - start : at - start + n]))
        at += n
    return found


def log_scale_range(log_scales: FloatArray) -> tuple[float, float]:
    """Low end and range of the finite log scales (N, 3); at most 40 wide (a factor of 10^17)."""
    finite = log_scales
    if not np.isfinite(log_scales.sum(dtype=np.float64)):
        finite = log_scales[np.isfinite(log_scales)]
    high = float(finite.max(initial=-40.0))
    low = max(float(finite.min(initial=high)), high - 40.0)
    return low, max(high - low, 1e-3)


def pack_shape(
    gaussians: Gaussians, start: int, stop: int, scale_range: tuple[float, float]
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
        low, span = scale_range
        fixed = (np.where(sound[:, None], logs, low) - np.float32(low)) * np.float32(65535 / span)
        words[:, 4:7] = np.clip(fixed + np.float32(0.5), 0, 65535)
        opacity = np.float32(65535) / (np.float32(1) + np.exp(-np.where(sound, logits, -100)))
        words[:, 7] = opacity + np.float32(0.5)
    return words.view(np.uint32)


def pack_sh(gaussians: Gaussians, start: int, stop: int) -> tuple[AnyArray, AnyArray]:
    """Color of rows start..stop: (K, 4) halfs, and (L, K) uint64 of eight bytes, layer by layer.

    The halfs are the DC coefficients and the scale of the rest: the largest of its numbers, of
    which every coefficient is a share in 127 steps. Where one is not finite, neither is the scale.
    """
    n, n_sh = stop - start, gaussians.sh.shape[1]
    flat = gaussians.sh[start:stop].reshape(n, -1)
    halfs = np.zeros((n, 4), np.float16)
    packed = np.zeros((n, 8 * sh_layers(n_sh)), np.int8)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        halfs[:, :3] = flat[:, :3]
        if n_sh > 1:
            rest = flat[:, 3:]
            halfs[:, 3] = np.maximum(rest.max(axis=1), -rest.min(axis=1))
            scale = halfs[:, 3].astype(np.float32)
            steps = np.where((scale > 0) & np.isfinite(scale), 127 / scale, 0)
            shares = rest * steps[:, None].astype(np.float32)
            np.rint(shares, out=shares)
            np.clip(shares, -127, 127, out=shares)
            packed[:, : shares.shape[1]] = shares
    return halfs, np.ascontiguousarray(packed.view(np.uint64).T)


@dataclass(frozen=True, eq=False)
class PackedSplats:
    """Rows as the textures hold them."""

    means: FloatArray  # (K, 3)
    shape: AnyArray  # (K, 4) uint32, of `pack_shape`
    color: AnyArray  # (K, 4) halfs
    sh: AnyArray  # (L, K) uint64, of `pack_sh`

    def __len__(self) -> int:
        return len(self.means)


def pack_splats(
    gaussians: Gaussians, start: int, stop: int, scale_range: tuple[float, float]
) -> PackedSplats:
    """Pack the rows start..stop."""
    shape = pack_shape(gaussians, start, stop, scale_range)
    return PackedSplats(gaussians.means[start:stop], shape, *pack_sh(gaussians, start, stop))


def words_of_colors(colors: UInt8Array) -> UInt32Array:
    """Colors (K, 3 or 4) of a byte a channel as a texel each (K,)."""
    words = np.zeros((len(colors), 4), np.uint8)
    words[:, : colors.shape[1]] = colors
    return words.view("<u4")[:, 0]


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


def changed_range(before: AnyArray, after: AnyArray) -> tuple[int, int]:
    """The shortest range of rows outside of which two columns agree; rows added are changed.

    Rows that were cut off are not: the range lies in ``after`` (0, 0 when nothing is to be sent).
    """
    n = min(len(before), len(after))
    start = n
    for at in range(0, n, _COMPARED):
        differs = before[at : min(at + _COMPARED, n)] != after[at : min(at + _COMPARED, n)]
        if differs.any():
            start = at + int(differs.argmax())
            break
    if len(after) > n:
        return start, len(after)
    for stop in range(n, start, -_COMPARED):
        first = max(stop - _COMPARED, start)
        differs = before[first:stop] != after[first:stop]
        if differs.any():
            return start, first + int(np.flatnonzero(differs)[-1]) + 1
    return 0, 0


_BLOCK = 4 * WIDTH  # rows packed at a time: temporaries stay in the cache
_SPARE = 8  # a scene that has grown gets an eighth more room, so that it can grow again
_MOST_SHORT = 65536  # placements that an index of 16 bits can tell apart

DataTexture = moderngl.Texture | moderngl.TextureArray


class SceneBuffers:
    """The textures of one scene. ``version`` grows with every change of what they hold."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._scene: Scene | None = None
        self._seen = Revision()
        self._textures: dict[str, DataTexture] = {}
        self._own_colors: dict[int, RGB] = {}  # of groups, in the palette
        self._muted: Mapping[int, RGB] = {}
        self._columns: set[str] = set()  # textures that have a line for every 2048 splats
        self._sent: dict[str, AnyArray] = {}  # columns as they were sent
        self._tint: UInt8Array | None = None  # as it was given
        self._lines = 0
        self.version = 0
        self.n_splats = 0
        self.n_sh = 1
        self.log_scale_range = (0.0, 1.0)  # low end and range of the fixed-point log scales
        self.has_selected = False
        self.uploads: Counter[str] = Counter()  # how often each column was sent, in whole or part

    def sync(
        self,
        scene: Scene,
        labels: IntArray | None = None,
        *,
        with_confidence: bool = False,
        with_identity: bool = False,
        tint: UInt8Array | None = None,
        muted: Mapping[int, RGB] | None = None,
    ) -> None:
        """Send what changed since the last call. ``labels`` (N,) stand in for those of the scene.

        ``tint`` (N, 4) lies over the colors of the splats; ``muted`` are colors of groups instead
        of the palette's and their own. Raises `GagaError` when the graphics card cannot hold the
        scene.
        """
        now = scene.revision
        is_same = scene is self._scene
        splats_changed = not is_same or now.splats != self._seen.splats
        if splats_changed:
            kept = now.rows_kept_since(self._seen.splats) if is_same else 0
            if not self._append(scene.gaussians, min(kept, self.n_splats)):
                self._allocate(scene.gaussians, len(scene.placements))
                self.log_scale_range = log_scale_range(scene.gaussians.log_scales)
                self._send_gaussians(scene.gaussians, 0)
                is_same = False
            self._scene = scene
        shown = scene.labels if labels is None or len(labels) != len(scene) else labels
        labels_changed = splats_changed or now.labels != self._seen.labels
        if labels_changed or shown is not self._sent.get("labels"):
            self._send_labels(shown, in_place=is_same and labels_changed)
        if {**scene.colors, **(muted or {})} != self._own_colors:
            self._muted = muted or {}
            self._send_palette(self._texture("palette").height * WIDTH - 1)
        if splats_changed or now.state != self._seen.state:
            self._send_column("state", scene.state)
            bits = np.uint8(State.SELECTED | State.HIDDEN | State.DELETED)
            self.has_selected = bool(np.any((scene.state & bits) == State.SELECTED))
        if not is_same or now.placements != self._seen.placements:
            self._send_placements(scene.placements)
        if splats_changed or now.placement != self._seen.placement:
            self._send_column("placement", scene.placement)
        if with_confidence != ("confidence" in self._textures) or labels_changed:
            rows = scene.confidence_of() if with_confidence else None
            if with_confidence and rows is None:
                rows = np.zeros(len(scene), np.uint8)
            self._send_optional("confidence", rows)
        if with_identity != ("identity" in self._textures) or labels_changed:
            colors = scene.identity_colors_of() if with_identity else None
            self._send_optional("identity", None if colors is None else words_of_colors(colors))
        tint = tint if tint is not None and len(tint) == len(scene) else None
        if tint is not self._tint or (tint is not None) != self.is_tinted:
            self._send_optional("tint", None if tint is None else words_of_colors(tint))
            self._tint = tint
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

    @property
    def is_tinted(self) -> bool:
        """Whether a color is blended over those of the splats."""
        return "tint" in self._textures

    @property
    def nbytes(self) -> int:
        """Bytes of all textures on the graphics card."""
        return sum(texture_bytes(texture) for texture in self._textures.values())

    def textures(self) -> list[tuple[str, DataTexture]]:
        """Sampler names and textures of the projection pass."""
        return [(f"u_{name}", texture) for name, texture in self._textures.items()]

    def release(self) -> None:
        """Give every texture back."""
        for texture in self._textures.values():
            texture.release()
        self._textures.clear()
        self._columns.clear()
        self._sent.clear()

    # --- the splats themselves

    def _allocate(self, gaussians: Gaussians, n_placements: int) -> None:
        """Textures with a texel for each of the splats."""
        self.release()
        self._check_fits(len(gaussians))
        self.n_splats = len(gaussians)
        self.n_sh = gaussians.sh.shape[1]
        self._lines = max(1, -(-self.n_splats // WIDTH))
        self._column("means", 3, "f4")
        self._column("shape", 4, "u4")
        self._column("color", 4, "f2")
        self._column("state", 1, "u1")
        self._column("labels", 1, "i4")
        self._column("placement", 1, "u2" if n_placements <= _MOST_SHORT else "u4")
        if self.n_sh > 1:
            self._column("sh", 2, "u4", sh_layers(self.n_sh))

    def _append(self, gaussians: Gaussians, n_kept: int) -> bool:
        """Send the rows from ``n_kept`` on, the others being there; False when that cannot be."""
        n = len(gaussians)
        if n_kept == 0 or gaussians.sh.shape[1] != self.n_sh:
            return False
        low, span = log_scale_range(gaussians.log_scales[n_kept:])
        here, range_ = self.log_scale_range
        if n_kept < n and not (here <= low and low + span <= here + range_ + 1e-3):
            return False
        self._check_fits(n)
        lines = -(-n // WIDTH)
        if lines > self._lines:
            limit = int(self._ctx.info["GL_MAX_TEXTURE_SIZE"])
            self._grow(min(lines + lines // _SPARE, limit))
        self.n_splats = n
        self._send_gaussians(gaussians, n_kept)
        return True

    def _check_fits(self, n: int) -> None:
        limit = int(self._ctx.info["GL_MAX_TEXTURE_SIZE"])
        if n > limit * WIDTH:
            raise GagaError(
                f"The scene has {n:,} splats, but this graphics card can hold {limit * WIDTH:,}. "
                "Open a smaller part of it."
            )

    def _send_gaussians(self, gaussians: Gaussians, first: int) -> None:
        """Send the rows from ``first`` on."""
        for start in range(first, len(gaussians), _BLOCK):
            stop = min(start + _BLOCK, len(gaussians))
            self._write(pack_splats(gaussians, start, stop, self.log_scale_range), start)
        self._count("gaussians")

    def _write(self, packed: PackedSplats, start: int) -> None:
        write_rows(self._texture("means"), packed.means, start)
        write_rows(self._texture("shape"), packed.shape, start)
        write_rows(self._texture("color"), packed.color, start)
        sh = self._textures.get("sh")
        if isinstance(sh, moderngl.TextureArray):
            for at, width, height, rows in pieces(packed.sh.T, start):
                place = (at % WIDTH, at // WIDTH, 0, width, height, len(packed.sh))
                sh.write(np.ascontiguousarray(rows.T), viewport=place)

    # --- a pool: rows that are written one by one

    def open_pool(self, pool: Scene, scale_range: tuple[float, float]) -> None:
        """Make room for the rows of ``pool``, a scene whose Gaussians `write` sends piece by piece.

        Its other columns are sent by `sync` as those of any scene.
        """
        self._allocate(pool.gaussians, len(pool.placements))
        self.log_scale_range = scale_range
        self._scene = pool
        self._seen = Revision(pool.revision.splats, -1, -1, -1, -1, -1)

    def write(self, packed: PackedSplats, start: int, columns: Mapping[str, AnyArray]) -> None:
        """Replace rows of a pool from ``start`` on, and of its other columns by name.

        Columns that are not there at the moment are passed over.
        """
        self._write(packed, start)
        for name, rows in columns.items():
            texture = self._textures.get(name)
            if isinstance(texture, moderngl.Texture):
                write_rows(texture, _as_texels(texture, rows), start)
                sent = self._sent.get(name)
                if sent is not None:
                    sent[start : start + len(rows)] = rows
        self._count("gaussians")

    # --- columns that edits change

    def _send_labels(self, labels: IntArray, *, in_place: bool) -> None:
        if in_place and labels is self._sent.get("labels"):
            del self._sent["labels"]
        self._send_column("labels", labels)
        n_groups = int(labels.max(initial=0))
        palette = self._textures.get("palette")
        if palette is None or palette.width * palette.height <= n_groups:
            self._send_palette(n_groups)

    def _send_palette(self, n_groups: int) -> None:
        colors = np.zeros(((n_groups // WIDTH + 1) * WIDTH, 4), np.float32)
        colors[:, :3] = group_palette(len(colors) - 1)
        own = self._scene.colors if self._scene is not None else {}
        self._own_colors = {**own, **self._muted}
        for group, rgb in self._own_colors.items():
            if group < len(colors):
                colors[group, :3] = rgb
        self._table("palette", (WIDTH, n_groups // WIDTH + 1), colors)
        self.version += 1

    def _send_column(self, name: str, column: AnyArray) -> None:
        before = self._sent.get(name)
        start, stop = 0, len(column)
        if before is not None and before is not column:
            start, stop = changed_range(before, column)
        texture = self._texture(name)
        rows = column[start:stop]
        write_rows(texture, _as_texels(texture, rows), start)
        self._sent[name] = column
        self._count(name)

    def _send_optional(self, name: str, rows: AnyArray | None) -> None:
        """A column that is there while it is shown: bytes a splat that are seldom needed."""
        if rows is not None:
            if name not in self._textures:
                self._column(name, 1, "u1" if rows.dtype == np.uint8 else "u4")
            self._send_column(name, rows)
        elif name in self._textures:
            self._textures.pop(name).release()
            self._columns.discard(name)
            self._sent.pop(name, None)
            self.version += 1

    def _send_placements(self, placements: Placements) -> None:
        if len(placements) > _MOST_SHORT and self._texture("placement").dtype == "u2":
            self._textures.pop("placement").release()
            self._sent.pop("placement", None)
            self._column("placement", 1, "u4")
            assert self._scene is not None
            self._send_column("placement", self._scene.placement)
        lines = -(-len(placements) // 128)
        texels = np.zeros((lines * 128, 16, 4), np.float32)
        texels[: len(placements)] = placement_texels(placements)
        self._table("placements", (WIDTH, lines), texels)
        self._count("placements")

    # --- textures

    def _column(self, name: str, components: int, dtype: str, n_layers: int = 0) -> None:
        """A texture with a texel for each splat, or with one in each layer."""
        self._textures[name] = self._empty(components, dtype, n_layers)
        self._columns.add(name)

    def _empty(self, components: int, dtype: str, n_layers: int) -> DataTexture:
        texture: DataTexture
        if n_layers:
            size = (WIDTH, self._lines, n_layers)
            texture = self._ctx.texture_array(size, components, dtype=dtype)
        else:
            texture = self._ctx.texture((WIDTH, self._lines), components, dtype=dtype)
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return texture

    def _grow(self, lines: int) -> None:
        """Make room for ``lines`` of texels; what is there is copied on the graphics card."""
        before, self._lines = self._lines, lines
        for name in self._columns:
            old = self._textures[name]
            layers = old.layers if isinstance(old, moderngl.TextureArray) else 0
            new = self._empty(old.components, old.dtype, layers)
            copy = self._ctx.buffer(reserve=texture_bytes(old))
            old.read_into(copy, alignment=1)
            if isinstance(new, moderngl.TextureArray):
                new.write(copy, viewport=(0, 0, 0, WIDTH, before, layers), alignment=1)
            else:
                new.write(copy, viewport=(0, 0, WIDTH, before), alignment=1)
            copy.release()
            old.release()
            self._textures[name] = new

    def _table(self, name: str, size: tuple[int, int], texels: AnyArray) -> None:
        """A small RGBA32F table, made again when its size changed."""
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


def _as_texels(texture: moderngl.Texture, rows: AnyArray) -> AnyArray:
    """Rows of a column in the type of its texture: indices of placements are short as a rule."""
    return rows.astype(np.uint16) if texture.dtype == "u2" else rows


def texture_bytes(texture: DataTexture) -> int:
    """Bytes that a texture takes."""
    layers = texture.layers if isinstance(texture, moderngl.TextureArray) else 1
    size = int(texture.dtype[1:])
    return int(texture.width * texture.height * layers * texture.components * size)


def write_rows(texture: moderngl.Texture, rows: AnyArray, start: int) -> None:
    """Write ``rows`` (K,) or (K, C) of a column from splat ``start`` on, straight from memory."""
    for first, width, height, piece in pieces(rows, start):
        place = (first % WIDTH, first // WIDTH, width, height)
        texture.write(np.ascontiguousarray(piece), viewport=place)
