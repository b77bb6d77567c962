"""The picture of the scene as a texture, drawn again only when something in it changed."""

from collections.abc import Generator
from dataclasses import dataclass

import moderngl
import numpy as np

from gaga_core.arrays import UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.scene.lod.tree import LodTree
from gaga_core.scene.scene import Scene
from gaga_studio.gpu.buffers import SceneBuffers
from gaga_studio.gpu.composite import Compositor, Finish
from gaga_studio.gpu.context import drawing, is_software
from gaga_studio.gpu.lod_view import LodView, fits
from gaga_studio.gpu.overlays import LineRenderer, Overlays
from gaga_studio.gpu.slices import Slices
from gaga_studio.gpu.sorter import DepthOrder, Sorter, SortJob
from gaga_studio.gpu.splats import Look, SplatRenderer
from gaga_studio.gpu.targets import Target
from gaga_studio.session.view import CentreColors, Mode, ViewState

__all__ = ["Overlays", "Viewport"]

_NO_OVERLAYS = Overlays()
_SEE_THROUGH = (Mode.CENTRES, Mode.RINGS)  # what lies behind is seen
_WITHOUT_OUTLINE = (Mode.CENTRES, Mode.RINGS, Mode.MASK)  # selected splats have a color there


@dataclass(frozen=True)
class _Lens:
    """A camera by value: the rig makes a new one every frame."""

    K: bytes
    cam_from_world: bytes
    size: tuple[int, int]

    @staticmethod
    def of(camera: Camera) -> "_Lens":
        size = (camera.width, camera.height)
        return _Lens(camera.K.tobytes(), camera.cam_from_world.tobytes(), size)


class Viewport:
    """Owns everything that is drawn with; one per window."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self.is_software = is_software(ctx)
        self.buffers = SceneBuffers(ctx)
        self._splats = SplatRenderer(ctx)
        self._compositor = Compositor(ctx)
        self._lines = LineRenderer(ctx)
        self._picture = Target(ctx, [(4, "f1")], smooth=True)
        self._sorter = Sorter()
        self._order: DepthOrder | None = None
        self._ticket = 0
        self._valid_from = 0  # orders of earlier tickets belong to another scene
        self._sorted: tuple[object, ...] = ()  # what the last sort job was asked for
        self._drawn: tuple[object, ...] = ()  # what the picture shows
        self._parts: Generator[str, None, None] | None = None  # a picture that is begun
        self._begun: tuple[object, ...] = ()  # what it will show
        self._is_draft = False
        self._is_current = True  # the picture shows what was asked for last
        self._tree: LodTree | None = None  # of the scene
        self._lod: LodView | None = None
        self.slices = Slices(ctx.finish)
        self.n_draws = 0  # pictures of splats drawn so far

    @property
    def settled(self) -> bool:
        """Whether the last picture is whole, in the depth order of its own camera and scene."""
        return self.buffers.scene is None or (
            self._order is not None
            and self._order.ticket == self._ticket
            and self._is_current
            and (self._lod is None or self._lod.settled)
        )

    def use_tree(self, tree: LodTree | None) -> None:
        """Draw cuts of this tree of the scene from now on; None: the scene itself."""
        if tree is not self._tree:
            self._forget()
            self._tree = tree

    def draw(
        self,
        scene: Scene | None,
        camera: Camera,
        view: ViewState,
        overlays: Overlays = _NO_OVERLAYS,
        *,
        wait: bool = False,
        frame_s: float = 0.0,
        is_draft: bool = False,
    ) -> int:
        """OpenGL name of the picture's texture (camera.width x camera.height, row 0 = bottom).

        Never waits for the depth order: until the one of this camera is there, the last one is
        used and ``settled`` is False; call again. ``wait`` waits: for tests and saved pictures.
        A picture that takes longer than ``frame_s`` is drawn in parts, one a call; until it is
        whole, the last one is returned and ``settled`` is False. 0 = at once. A draft that is
        begun is finished before the next one, though the camera went on; others begin again.
        """
        if scene is None:
            self._forget()
        else:
            self._pull(scene, camera, view, overlays, wait=wait)
        size = (camera.width, camera.height)
        order = self._order
        wanted = (
            _Lens.of(camera),
            (view.mode, view.background, view.look, view.show_outline, view.centre_colors),
            overlays,
            self.buffers.version,
            (view.resolution_scale, order and (order.ticket, order.budget)),
        )
        # At rest after a motion the full picture waits for the order of all splats.
        only_finer = wanted[:-1] == self._drawn[:-1] and not self.settled
        is_on_its_way = only_finer and order is not None and order.budget != view.splat_budget
        if self._picture.size == (0, 0):
            with drawing(self._ctx):
                self._picture.resize(*size)
                self._picture.begin().clear(*view.background, 1.0)
        if self._parts is not None and self._is_draft and frame_s > 0:
            self._go_on(frame_s)
        elif wanted != self._drawn and not is_on_its_way:
            if self._parts is None or wanted != self._begun:
                self._is_draft = is_draft
                self._parts, self._begun = self._render(camera, view, overlays), wanted
                n_pixels = camera.width * camera.height * view.resolution_scale**2
                self.slices.begin(max(round(n_pixels), 1))
            self._go_on(frame_s)
        else:
            self._parts = None
        self._is_current = self._drawn == wanted
        return int(self._picture.textures[0].glo)

    def n_in_picture(self, scene: Scene | None, view: ViewState) -> int:
        """Splats that a picture of ``scene`` is drawn from at most."""
        if scene is None or self._tree is None or not fits(self._tree, scene, view.lod_budget):
            return 0 if scene is None else len(scene)  # it is drawn whole
        return min(len(scene), view.lod_budget)

    @property
    def n_in_cut(self) -> int:
        """Splats of the cut that is drawn; 0 without a tree."""
        return self._lod.n_drawn if self._lod is not None else 0

    @property
    def lod_error(self) -> GagaError | None:
        """Why the picture gets no finer: files of the tree that cannot be read."""
        return self._lod.error if self._lod is not None else None

    def finish_order(self) -> None:
        """Wait for the depth order that was asked for last; the next `draw` uses it."""
        self._sorter.wait(self._ticket)

    @property
    def texture(self) -> int:
        """OpenGL name of the last picture; 0 before the first."""
        return int(self._picture.textures[0].glo) if self.n_draws else 0

    @property
    def nbytes(self) -> int:
        """Bytes on the graphics card that grow with the number of splats."""
        return self.buffers.nbytes + self._splats.nbytes

    def read_pixels(self) -> UInt8Array:
        """The finished picture (H, W, 3), first row on top; `draw` comes first."""
        width, height = self._picture.size
        data = self._picture.framebuffer.read(components=3, alignment=1)
        return np.frombuffer(data, np.uint8).reshape(height, width, 3)[::-1].copy()

    def release(self) -> None:
        """Give every OpenGL object back and end the sorter; the context must be current."""
        self._sorter.release()
        if self._lod is not None:
            self._lod.release()
        for part in (self._lines, self._compositor, self._splats, self.buffers, self._picture):
            part.release()

    def _forget(self) -> None:
        if self._lod is not None:
            self._lod.release()
            self._lod = None
        self.buffers.clear()
        self._parts = None
        self._order = None
        self._sorted = ()
        self._valid_from = self._ticket + 1

    def _pull(
        self, scene: Scene, camera: Camera, view: ViewState, overlays: Overlays, *, wait: bool
    ) -> None:
        """Bring textures and depth order up to date, as far as they are known."""
        shown, labels, tint = scene, overlays.labels, overlays.tint
        if self._tree is not None and fits(self._tree, scene, view.lod_budget):
            lod = self._pull_lod(self._tree, scene, camera, view, wait=wait)
            shown = lod.scene
            labels, tint = lod.overlaid("labels", labels), lod.overlaid("tint", tint)
        elif scene is not self.buffers.scene:  # another one, or the pool of a tree
            self._forget()
        n_before = self.buffers.n_splats
        is_heat = view.mode is Mode.CONFIDENCE and scene.confidence is not None
        self.buffers.sync(
            shown,
            labels,
            with_confidence=is_heat,
            with_identity=_shows_identity(scene, view),
            tint=tint,
            muted=overlays.muted,
        )
        if self._order is not None and n_before != self.buffers.n_splats:
            self._use(self._order)
        revision = shown.revision
        wanted = (
            _Lens.of(camera),
            (revision.splats, revision.state, revision.placement, revision.placements),
            view.splat_budget,
            self._lod and self._lod.version,
        )
        if wanted != self._sorted:
            self._sorted = wanted
            self._ticket += 1
            self._sorter.submit(_job(self._ticket, shown, camera, view, self._lod))
        if wait:
            self._sorter.wait(self._ticket)
        order = self._sorter.take()
        if order is not None and order.ticket >= self._valid_from:
            self._use(order)
        now = self._order
        if now is not None and now.coarse is not None and now.coarse_budget == view.splat_budget:
            # A motion begins: not with all splats, even while their order is the only one.
            self._use(now.thinned())

    def _pull_lod(
        self, tree: LodTree, scene: Scene, camera: Camera, view: ViewState, *, wait: bool
    ) -> LodView:
        """The cut of ``tree`` for this camera, as far as it is there."""
        lod = self._lod
        if lod is None or lod.opened is not scene or lod.budget != view.lod_budget:
            self._forget()
            lod = self._lod = LodView(tree, scene, self.buffers, view.lod_budget)
        lens = _Lens.of(camera)
        while True:
            shown = self._order.ticket if self._order is not None else 0
            lod.pull(scene, camera, lens, shown, is_opaque=view.mode not in _SEE_THROUGH)
            if not wait or lod.settled:
                return lod
            lod.wait()

    def _use(self, order: DepthOrder) -> None:
        """Draw with ``order``; a scene that has shrunk since then loses the rows that it lost."""
        n = self.buffers.n_splats
        kept = order.order if order.n_splats <= n else order.order[order.order < n]
        with drawing(self._ctx):
            if self._splats.set_order(kept, n):
                self._parts = None  # what it was drawn from is gone
        self._order = order

    def _go_on(self, frame_s: float) -> None:
        """Draw as much of the picture that is begun as one frame may take."""
        parts, slices = self._parts, self.slices
        assert parts is not None
        start = slices.clock()
        slices.frame(frame_s)
        is_done = False
        with drawing(self._ctx):
            while not is_done:
                is_done = next(parts, None) is None
                if frame_s > 0 and slices.is_over():
                    break
        slices.leave(start, is_done=is_done)
        if is_done:
            self._parts, self._drawn = None, self._begun
            self.n_draws += self._order is not None  # before the first order it is empty

    def _render(
        self, camera: Camera, view: ViewState, overlays: Overlays
    ) -> Generator[str, None, None]:
        """Draw the picture; yields between its parts."""
        order, scene = self._order, self.buffers.scene
        mode, behind = view.mode, view.background
        if mode is Mode.CONFIDENCE and scene is not None and scene.confidence is None:
            mode = Mode.COLOR
        if mode is Mode.IDENTITY and scene is not None and scene.identities.colors is None:
            mode = Mode.COLOR
        if mode is Mode.MASK:
            behind = (0.0, 0.0, 0.0)
        finish = Finish(behind)
        blended: Target | None = None
        if order is not None and scene is not None:
            hovered = overlays.hovered_group
            with_mask = view.show_outline and (self.buffers.has_selected or hovered > 0)
            with_mask &= mode not in _WITHOUT_OUTLINE
            look = Look(
                mode,
                hovered,
                with_mask,
                order.far,
                overlays.focused_group,
                view.is_antialiased(scene),
                overlays.pixel_scale * view.resolution_scale,
                order.threshold,
                _centre_colors(scene, view),
            )
            small = scaled(camera, view.resolution_scale)
            blended = yield from self._splats.draw_parts(
                self.buffers, small, look, self.slices.size
            )
            depth_range = (order.near, order.far) if mode is Mode.DEPTH else None
            finish = Finish(behind, with_mask, depth_range, overlays.pixel_scale)
        self._picture.resize(camera.width, camera.height)
        self._compositor.draw(blended, self._picture, finish)
        self._lines.draw(camera, overlays)


def _shows_identity(scene: Scene, view: ViewState) -> bool:
    """Whether colors of identities are drawn, and known."""
    if scene.identities.colors is None:
        return False
    is_of_centres = view.mode is Mode.CENTRES and view.centre_colors is CentreColors.IDENTITY
    return view.mode is Mode.IDENTITY or is_of_centres


def _centre_colors(scene: Scene, view: ViewState) -> CentreColors:
    """What the colors of centres mean: their own where identities are not known."""
    wanted = view.centre_colors
    is_unknown = wanted is CentreColors.IDENTITY and scene.identities.colors is None
    return CentreColors.OWN if is_unknown else wanted


def scaled(camera: Camera, scale: float) -> Camera:
    """``camera`` with a picture of ``scale`` times its size, at least one pixel."""
    if scale == 1.0:
        return camera
    width = max(1, round(camera.width * scale))
    return camera.resized(width, max(1, round(camera.height * scale)))


def _job(
    ticket: int, scene: Scene, camera: Camera, view: ViewState, lod: LodView | None
) -> SortJob:
    return SortJob(
        ticket=ticket,
        gaussians=scene.gaussians,
        state=scene.state,
        placement=scene.placement,
        placements=scene.placements,
        camera=camera,
        budget=view.splat_budget,
        coarse_budget=view.coarse_budget,
        only=lod.sort_job(ticket) if lod is not None else None,
    )
