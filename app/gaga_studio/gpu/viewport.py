"""The picture of the scene as a texture, drawn in parts, and only when something in it changed."""

import math
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace

import moderngl
import numpy as np

from gaga_core.arrays import UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.scene.lod.tree import LodTree
from gaga_core.scene.scene import Scene
from gaga_studio.gpu.buffers import SceneBuffers
from gaga_studio.gpu.context import Target, drawing, is_software
from gaga_studio.gpu.lod_view import LodView, fits
from gaga_studio.gpu.overlays import Compositor, Finish, LineRenderer, Overlays
from gaga_studio.gpu.sorter import DepthOrder, Sorter, SortJob
from gaga_studio.gpu.splats import Look, SplatRenderer
from gaga_studio.session.view import CentreColors, Mode, ViewState

# --- The part of a picture that one frame draws, so that the window stays responsive.

_FIRST = 4096  # splats of the first part: what a splat costs is not known yet
_MOST_GROWTH = 2.0  # from one part to the next: near splats, drawn last, cost more
_LEAST = 128
_CAUTION = 0.5  # of the time that is left: the next part may be slower than the last
# Times the seconds of a frame that it gets where its panels take as long: on a busy machine they
# take a second, and a picture of three seconds in parts of 40 ms would be whole after a minute.
_MOST_TIMES = 8.0
_LAG_S = 0.5  # seconds after which a picture that is drawn while something moves is an old one


@dataclass
class Slices:
    """Sizes of the parts of a picture: each as long as the time that is left in its frame.

    ``finish`` waits for what was drawn. Speeds are kept from picture to picture.
    """

    finish: Callable[[], object]
    clock: Callable[[], float] = time.perf_counter
    seconds: float = 0.0  # of the last whole picture
    elapsed_s: float = 0.0  # from its start to its end, with all else that those frames did
    _speeds: dict[str, float] = field(default_factory=dict)  # splats a second, by kind of part
    _pixels: int = 0  # of this picture
    _spent: float = 0.0  # on this picture so far
    _until: float = 0.0
    _frame_s: float = 0.0  # 0 = all at once
    _begun_at: float = 0.0  # when this picture was begun
    _left_at: float = 0.0  # when the last frame of this picture ended
    _part: tuple[str, int, float] | None = None  # kind, splats, start of the part under way

    def begin(self, n_pixels: int) -> None:
        """Start another picture; splats cost more where it has more pixels than the last."""
        self._spent, self._part, self._left_at = 0.0, None, self.clock()
        self._begun_at = self._left_at
        if "blend" in self._speeds:
            self._speeds["blend"] *= min(1.0, self._pixels / n_pixels)
        self._pixels = n_pixels

    def frame(self, seconds: float, *, is_draft: bool = False) -> None:
        """Start a frame that may draw for ``seconds``, 0 = as long as it takes.

        As long as all else since the last one took, if that is longer; not for a draft, which is
        drawn while something moves, until it lags.
        """
        now = self.clock()
        keeps_pace = is_draft and now - self._begun_at < _LAG_S
        most = seconds if keeps_pace else _MOST_TIMES * seconds
        self._frame_s = max(seconds, min(now - self._left_at, most))
        self._until = now + self._frame_s

    def size(self, kind: str) -> int:
        """Splats of the next part; 0 = all that are left."""
        if self._frame_s <= 0:
            return 0
        n = _FIRST
        if kind in self._speeds:
            left = max(self._until - self.clock(), 0.1 * self._frame_s)
            n = max(int(_CAUTION * self._speeds[kind] * left), _LEAST)
        self._part = (kind, n, self.clock())
        return n

    def is_over(self) -> bool:
        """After a part: wait for it, learn its speed; whether the frame has had its time."""
        self.finish()
        if self._part is not None:
            kind, n, start = self._part
            speed = n / max(self.clock() - start, 1e-6)
            known = self._speeds.get(kind)
            self._speeds[kind] = speed if known is None else min(speed, _MOST_GROWTH * known)
            self._part = None
        return self._frame_s > 0 and self.clock() >= self._until - 0.2 * self._frame_s

    def leave(self, start: float, *, is_done: bool) -> None:
        """End the frame that began to draw at ``start``."""
        self._left_at = self.clock()
        self._spent += self._left_at - start
        if is_done:
            self.seconds, self.elapsed_s = self._spent, self._left_at - self._begun_at


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
        self._begun_mode = self.mode = Mode.COLOR  # whose colors it, and the picture, are in
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

        Until the depth order of this camera is there, the last one is used and ``settled`` is
        False; call again. Only where that one lacks a part of the picture it is waited for, as long
        as the last picture took. ``wait`` waits in any case: for tests and saved pictures.
        A picture that takes longer than ``frame_s`` is drawn in parts, one a call; until it is
        whole, the last one is returned and ``settled`` is False. 0 = at once. A draft that is
        begun is finished before the next one, though the camera went on; others begin again.
        """
        # A draft keeps its depth order: by the rest of another one, its near splats are missing.
        goes_on = self._parts is not None and self._is_draft and frame_s > 0
        if scene is None:
            self._forget()
        else:
            self._pull(scene, camera, view, overlays, wait=wait, keeps_order=goes_on)
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
        if goes_on and self._parts is not None:
            self._go_on(frame_s)
        elif wanted != self._drawn and not is_on_its_way:
            if self._parts is None or wanted != self._begun:
                self._is_draft = is_draft
                self._parts, self._begun = self._render(camera, view, overlays), wanted
                self._begun_mode = view.mode
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
        self,
        scene: Scene,
        camera: Camera,
        view: ViewState,
        overlays: Overlays,
        *,
        wait: bool,
        keeps_order: bool,
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
        elif not keeps_order and self._lacks(camera):
            self._sorter.wait(self._ticket, self.slices.seconds)
        if keeps_order and self._parts is not None:
            return
        order = self._sorter.take()
        if order is not None and order.ticket >= self._valid_from:
            self._use(order)
        now = self._order
        if now is not None and now.coarse is not None and now.coarse_budget == view.splat_budget:
            # A motion begins: not with all splats, even while their order is the only one.
            self._use(now.thinned())

    def _lacks(self, camera: Camera) -> bool:
        """Whether a picture of ``camera`` would lack a part of the scene, and is to begin now.

        After a jump, or in a flight on a slow machine. Its order is worth as long a wait as the
        last picture took: on a slow machine far more than sorting does.
        """
        order = self._order
        return order is not None and order.ticket != self._ticket and not order.covers(camera)

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
            self._splats.set_order(kept, n)
        self._parts, self._order = None, order  # what the picture was begun with is gone

    def _go_on(self, frame_s: float) -> None:
        """Draw as much of the picture that is begun as one frame may take."""
        parts, slices = self._parts, self.slices
        assert parts is not None
        start = slices.clock()
        slices.frame(frame_s, is_draft=self._is_draft)
        is_done = False
        with drawing(self._ctx):
            while not is_done:
                is_done = next(parts, None) is None
                if frame_s > 0 and slices.is_over():
                    break
        slices.leave(start, is_done=is_done)
        if is_done:
            self._parts, self._drawn, self.mode = None, self._begun, self._begun_mode
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


# --- Keeps moving smooth: fewer splats, then fewer pixels while something moves; all of it at
# rest.

REST_S = 0.15  # after the last motion the picture is drawn in full
TARGET_MS = 33.0  # of a picture while something moves
SOFTWARE_TARGET_MS = 120.0  # the same where the processor draws: the panels need it too
LEAST_SPLATS = 75_000  # the most important ones carry a picture alone
LEAST_SCALE = 0.35  # of the resolution
_SOFTWARE_SCALE = 0.5  # to begin with
_STEPS = 2  # budgets there are between a number of splats and half of it
# Halvings too many or too few that are left alone: more than a step apart, or the picture would
# flicker between two budgets.
_FAST_ENOUGH, _TOO_SLOW = -0.45, 0.25


@dataclass
class Pacing:
    """A controller of what a moving picture costs, by what the last pictures took.

    ``saved`` is how many times the work was halved: first the splats are halved down to
    `LEAST_SPLATS`, the most important ones staying, then the pixels.
    """

    is_software: bool = False
    clock: Callable[[], float] = time.monotonic
    frame_ms: float = 0.0  # of the last picture
    saved: float = -1.0  # halvings; -1 before the first motion
    _n_splats: int = 0
    _full_ms: float = 0.0  # of the last picture in full
    _step: float = 0.0  # `saved` in whole steps
    _motion: object = None
    _moved_at: float = -1e9
    _is_moving: bool = False
    _is_first: bool = True  # nothing of this scene was drawn yet
    # Whether this frame's picture is one of a motion, or a first one: coarse or not, it is finished
    # though the camera goes on, or none would be whole before the motion ends.
    is_draft: bool = False
    _is_coarse: bool = False

    @property
    def is_settled(self) -> bool:
        """Whether the picture on the screen is the full one."""
        return not self._is_coarse

    @property
    def budget(self) -> int:
        """Splats to draw while moving; 0 = all."""
        halvings = min(self._step, self._most_by_splats)
        n = max(round(self._n_splats / 2**halvings), LEAST_SPLATS)
        return n if n < self._n_splats else 0

    @property
    def scale(self) -> float:
        """Share of the resolution while moving; the work goes with its square."""
        halvings = max(0.0, self._step - self._most_by_splats)
        return max(LEAST_SCALE, 2 ** (-halvings / 2))

    def view_for(self, view: ViewState, motion: object, n_splats: int) -> ViewState:
        """The settings to draw this frame with: coarser while ``motion`` (any value) changes.

        ``n_splats`` of the scene. Twice or half as many are another scene: it begins again. Where
        the processor draws, its first picture is a coarse one: the full one takes seconds.
        """
        now = self.clock()
        if not self._n_splats < 2 * n_splats < 4 * self._n_splats:
            self._full_ms, self.saved, self._step, self._is_first = 0.0, -1.0, 0.0, True
        self._n_splats = n_splats
        if motion != self._motion:
            self._moved_at = now if self._motion is not None else -1e9
            self._motion = motion
        is_moving = now - self._moved_at < REST_S
        self.is_draft = is_moving or (self._is_first and self.is_software)
        if self.is_draft and not self._is_moving and self.saved < 0:
            self._begin()
        self._is_moving = is_moving
        self._is_coarse = self.is_draft and self._step > 0
        if not self._is_coarse:
            return replace(view, coarse_budget=_least(view.splat_budget, self.budget))
        return replace(
            view,
            splat_budget=_least(view.splat_budget, self.budget),
            resolution_scale=view.resolution_scale * self.scale,
        )

    def drew(self, milliseconds: float) -> None:
        """A picture took this long: one that was drawn while moving adjusts the next."""
        self.frame_ms = milliseconds
        if self._is_first:  # what the full one takes tells more
            self._is_first, self.saved, self._step = False, -1.0, 0.0
        if not self._is_coarse:
            self._full_ms = milliseconds
        if not self._is_moving:
            return
        halvings = math.log2(max(milliseconds, 0.5) / self._target)
        if not _FAST_ENOUGH < halvings < _TOO_SLOW:
            # Half the correction each time: a single slow picture says little.
            self._save(self.saved + 0.5 * halvings)

    @property
    def _target(self) -> float:
        return SOFTWARE_TARGET_MS if self.is_software else TARGET_MS

    @property
    def _most_by_splats(self) -> float:
        return max(0.0, math.log2(max(self._n_splats, 1) / LEAST_SPLATS))

    def _begin(self) -> None:
        """The first motion: what the picture in full took says how much is too much."""
        least = self._most_by_splats - 2 * math.log2(_SOFTWARE_SCALE) if self.is_software else 0.0
        by_time = math.log2(self._full_ms / self._target) if self._full_ms > 0 else 0.0
        self._save(max(least, by_time))

    def _save(self, halvings: float) -> None:
        most = self._most_by_splats - 2 * math.log2(LEAST_SCALE)
        self.saved = min(max(halvings, 0.0), most)
        self._step = round(self.saved * _STEPS) / _STEPS


def _least(a: int, b: int) -> int:
    """The smaller of two budgets, of which 0 is no limit."""
    return min(a, b) if a and b else a or b
