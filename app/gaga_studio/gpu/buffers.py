"""Data textures: the splats of a scene on the graphics card, kept up to date by pulling.

Columns lie row after row in textures 2048 texels wide and are read with ``texelFetch``; OpenGL 3.3
has nothing better that every driver likes. A column is sent again only when its counter in
``scene.revision`` moved, and then only the lines of texels that differ. Splats that were appended
are sent alone.
"""

from collections import Counter
from collections.abc import Mapping

import moderngl
import numpy as np

from gaga_core.arrays import AnyArray, IntArray, UInt8Array
from gaga_core.color import group_palette
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.scene.scene import RGB, Placements, Revision, Scene, State
from gaga_studio.gpu.packing import (
    WIDTH,
    PackedSplats,
    changed_range,
    log_scale_range,
    pack_splats,
    pieces,
    placement_texels,
    sh_layers,
    words_of_colors,
)

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
                self._replace(scene.gaussians, len(scene.placements))
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
            self._send_confidence(scene if with_confidence else None)
        if with_identity != ("identity" in self._textures) or labels_changed:
            self._send_identity(scene.identity_colors_of() if with_identity else None)
        fits = tint is not None and len(tint) == len(scene)
        self._send_tint(tint if fits else None)
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
        """Whether a color lies over those of the splats."""
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

    def _replace(self, gaussians: Gaussians, n_placements: int) -> None:
        """New textures for new splats."""
        self._allocate(gaussians, n_placements)
        self.log_scale_range = log_scale_range(gaussians.log_scales)
        self._send_gaussians(gaussians, 0)

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

    def _send_confidence(self, scene: Scene | None) -> None:
        """Put the column there while it is shown: a byte a splat that is seldom needed."""
        column = scene.confidence_of() if scene is not None else None
        texture = self._textures.get("confidence")
        if scene is None:
            if texture is not None:
                self._drop_column("confidence")
            return
        if texture is None:
            self._column("confidence", 1, "u1")
        self._send_column(
            "confidence", np.zeros(len(scene), np.uint8) if column is None else column
        )

    def _send_identity(self, colors: UInt8Array | None) -> None:
        """Put the colors (N, 3) of the encodings there while they are shown."""
        if colors is None:
            if "identity" in self._textures:
                self._drop_column("identity")
                self.version += 1
            return
        if "identity" not in self._textures:
            self._column("identity", 1, "u4")
        self._send_column("identity", words_of_colors(colors))

    def _send_tint(self, tint: UInt8Array | None) -> None:
        """Put the column there while it is shown: four bytes a splat that are seldom needed."""
        if tint is None:
            if self.is_tinted:
                self._drop_column("tint")
                self.version += 1
        elif tint is not self._tint or not self.is_tinted:
            if not self.is_tinted:
                self._column("tint", 1, "u4")
            self._tint = tint
            self._send_column("tint", words_of_colors(tint))

    def _drop_column(self, name: str) -> None:
        self._textures.pop(name).release()
        self._columns.discard(name)
        self._sent.pop(name, None)

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
