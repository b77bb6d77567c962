"""Export: what is written is what is visible, with edits applied."""

import re
import tempfile
import unicodedata
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import count
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from msgspec.structs import replace as changed

from gaga_core.arrays import BoolArray, DoubleArray, IntArray, LongArray
from gaga_core.errors import GagaError
from gaga_core.export.options import ExportOptions, PageContent
from gaga_core.export.page import DRAWS, write_scene_page_stage
from gaga_core.export.solids import MeshConfig, box_mesh, convex_collider, proxy_mesh_stage
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import safe_name
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.meshes import MeshFile, TriangleMesh, write_mesh
from gaga_core.io.splats.packing import PALETTE, SORTS, WRITES
from gaga_core.io.splats.splat_files import SplatFormat, form_of, losses, write_splats_stage
from gaga_core.io.splats.web_page import STAGE as WRITES_PAGE
from gaga_core.io.splats.web_page import check_room, viewer_bytes
from gaga_core.progress import Progress, Stage, joined, mapped, run_stage
from gaga_core.raster import choose
from gaga_core.scene.bake import STAGE as BAKES
from gaga_core.scene.bake import bake_stage, with_groups
from gaga_core.scene.export_manifest import (
    MANIFEST_VERSION,
    BoxEntry,
    Manifest,
    ManifestEntry,
    place_manifest,
    read_manifest,
    write_manifest,
)
from gaga_core.scene.objects import group_colors, group_name
from gaga_core.scene.orientation import saying_up
from gaga_core.scene.reduce import COMPARES, decimate_stage, picture_loss_stage
from gaga_core.scene.reduce import STEP as MERGES
from gaga_core.scene.scene import Scene, State, of_scene_now
from gaga_core.scene.selection.algebra import world_means
from gaga_core.scene.selection.bounds import object_parts, oriented_box
from gaga_core.scene.selection.click import loss_views

MESH_LOSS = (
    "A mesh is a solid of one color a vertex: transparency, fine detail and reflections are left "
    "out. An object without a surface gets no file."
)
_STANDING = (SplatFormat.GLB, SplatFormat.USD)  # with an axis that is up
_HEADER = 1500  # bytes before the splats of a file, about
# Measured, bytes: of the code books of a SOG and of a page, which do not grow with the splats; of a
# splat's place in the palette of SH; of an object of a page with its picture.
_BOOKS, _SOG_LABEL, _PAGE_LABEL, _PAGE_OBJECT = 11_000, 1.5, 2.7, 2_600
_SPLAT = 32  # bytes of a splat in a .splat


class MeshForm(StrEnum):
    """Solid that is written in place of an object's splats."""

    MESH = "mesh"  # closed surface with colors
    COLLIDER = "collider"  # convex, at most 255 triangles
    BOX = "box"  # oriented


@dataclass(frozen=True)
class MeshExport:
    """A form of meshes, and the kind of file."""

    form: MeshForm = MeshForm.MESH
    file: MeshFile = MeshFile.GLB
    config: MeshConfig = field(default_factory=MeshConfig)

    @property
    def suffix(self) -> str:
        """What the files end in: those of splats and of other forms keep their names."""
        return f".{self.form}{self.file.suffix}"


def object_mesh_stage(
    gaussians: Gaussians, how: MeshExport, up: tuple[float, float, float]
) -> Stage[TriangleMesh]:
    """The solid of an object alone, ``gaussians`` (world); ``up`` is unit.

    A collider holds all of the mesh; of an object without a surface, all centres. Raises
    ``GagaError`` when there is no such solid.
    """
    if how.form is MeshForm.BOX:
        box = oriented_box(gaussians.means)
        if box is None:
            raise GagaError("An object without splats has no box.")
        return box_mesh(box)
    try:
        mesh = yield from proxy_mesh_stage(
            gaussians, choose(), up=np.array(up, np.float64), config=how.config
        )
    except GagaError:
        if how.form is MeshForm.MESH:
            raise
        return convex_collider(gaussians.means.astype(np.float64))
    if how.form is MeshForm.MESH:
        return mesh
    return convex_collider(mesh.vertices.astype(np.float64))


T = TypeVar("T")
ExportWhat = Literal["visible", "selected"]
_AS_IS = ExportOptions()


@dataclass(frozen=True)
class Exported:
    """Summary of one written file."""

    n_splats: int
    psnr: float | None = None  # dB, see `picture_loss_stage`; None: nothing was decimated


STAGE = "Export"
# Seconds of the steps of a file of 120,000 splats of 50 objects. Only what they are in parts of
# each other counts.
_LESS_S = {MERGES: 9.5, COMPARES: 2.5}
_STEP_S = {BAKES: 0.3, **_LESS_S, DRAWS: 5.0, WRITES_PAGE: 5.0, SORTS: 0.3, WRITES: 1.0}


@of_scene_now
def export_scene_stage(
    scene: Scene,
    path: Path,
    *,
    what: ExportWhat = "visible",
    groups: bool = False,
    form: SplatFormat | None = None,
    options: ExportOptions = _AS_IS,
) -> Stage[Exported]:
    """Write the visible (or selected and visible) splats to one file; returns what was written.

    ``form`` is what the name of the file asks for by default. Hidden and deleted splats are never
    written. In a .ply splats without an edit keep their exact bytes, and unknown columns survive;
    `export_losses` says what other forms do not keep; ``options`` change what is written.
    ``groups`` adds a column ``group`` (int32, 0 = none). A cancel, a full disk or a folder without
    permission leaves nothing behind. Works on the scene as it is at the call, whatever is edited
    meanwhile. Raises ``GagaError`` when nothing is visible, or no such form is written.
    """
    form = form_of(path) if form is None else form
    splats = options.inside(scene, exported_indices(scene, what))
    if len(splats) == 0:
        state = "selected" if what == "selected" else "visible"
        state += " in the box of the crop" if options.crop is not None else ""
        raise GagaError(f"Nothing is {state}, so there is nothing to export to {path.name}.")
    if form is SplatFormat.HTML:  # before anything is computed
        check_room(len(np.setdiff1d(scene.labels[splats], 0)))
    stage = _written(scene, splats, path, form, options, groups=groups, alone=what == "selected")
    is_page, is_less = form is SplatFormat.HTML, options.decimate < 1
    steps = [
        BAKES,
        *(_LESS_S if is_less else ()),
        *((DRAWS, WRITES_PAGE) if is_page else (SORTS, WRITES)),
    ]
    return (yield from joined(stage, STAGE, {step: _STEP_S[step] for step in steps}))


def _written(
    scene: Scene,
    splats: IntArray,
    path: Path,
    form: SplatFormat,
    options: ExportOptions,
    *,
    groups: bool,
    alone: bool,
) -> Stage[Exported]:
    gaussians = yield from bake_stage(scene, indices=splats, is_step=True)
    gaussians = gaussians.with_metres(scene.frame.is_metric)
    origin = options.origin(gaussians.means)
    gaussians, rows, psnr = yield from _decimated(
        gaussians, scene.labels[splats], options, alone=alone
    )
    splats = splats[rows]
    if form is SplatFormat.HTML:
        yield from write_scene_page_stage(scene, splats, gaussians, path, options, origin)
        return Exported(len(splats), psnr)
    gaussians = _as_written(gaussians, origin, form, options)
    if groups:
        gaussians = with_groups(gaussians, scene.labels[splats])
    yield from write_splats_stage(path, gaussians, form)
    return Exported(len(gaussians), psnr)


def export_losses(
    scene: Scene,
    form: SplatFormat,
    *,
    what: ExportWhat = "visible",
    groups: bool = False,
    options: ExportOptions = _AS_IS,
) -> tuple[str, ...]:
    """What an export in ``form`` does not keep, a sentence each (see `splat_files.losses`)."""
    if form is SplatFormat.PLY:
        return ()
    splats = options.inside(scene, exported_indices(scene, what))
    gaussians = options.applied(_taken(scene, splats), np.zeros(3))
    return losses(with_groups(gaussians, scene.labels[splats]) if groups else gaussians, form)


def objects_losses(
    scene: Scene,
    form: SplatFormat | MeshExport,
    groups: Sequence[int] | None = None,
    options: ExportOptions = _AS_IS,
) -> tuple[str, ...]:
    """What `export_objects_stage` of these groups in ``form`` does not keep, a sentence each."""
    if isinstance(form, MeshExport):
        return (MESH_LOSS,)
    if form is SplatFormat.PLY:
        return ()
    splats = objects_indices(scene, groups, options)
    return losses(options.applied(_taken(scene, splats), np.zeros(3)), form)


def objects_indices(
    scene: Scene, groups: Sequence[int] | None = None, options: ExportOptions = _AS_IS
) -> IntArray:
    """Splats (K,) that an export of these groups (default: all) writes."""
    shown = options.inside(scene, exported_indices(scene))
    labels = scene.labels[shown]
    return shown[labels > 0 if groups is None else np.isin(labels, list(groups))]


def _as_written(
    gaussians: Gaussians, origin: DoubleArray, form: SplatFormat, options: ExportOptions
) -> Gaussians:
    """Splats as a file of ``form`` holds them: it stands, or says what is up where none guesses."""
    gaussians = options.applied(gaussians, origin)
    if form in _STANDING:
        return options.standing(gaussians)
    return saying_up(gaussians, options.up)


def _taken(scene: Scene, splats: IntArray) -> Gaussians:
    every = scene.gaussians.with_metres(scene.frame.is_metric)
    return every if len(splats) == len(scene) else every.take(splats)


def _decimated(
    gaussians: Gaussians, labels: IntArray, options: ExportOptions, *, alone: bool = False
) -> Stage[tuple[Gaussians, LongArray, float | None]]:
    """The share of the splats that is kept, a row that each stands for, and the loss in dB.

    It is told from where the photos were taken; of what is drawn ``alone``, from all around.
    """
    if options.decimate == 1.0:
        return gaussians, np.arange(len(gaussians)), None
    fewer, rows = yield from decimate_stage(gaussians, options.decimate, labels)
    views = loss_views(() if alone else options.page.cameras, gaussians.means)
    return fewer, rows, (yield from picture_loss_stage(gaussians, fewer, views, choose()))


def exported_indices(scene: Scene, what: ExportWhat = "visible") -> IntArray:
    """Splats (K,) that an export of ``what`` writes."""
    if what not in ("visible", "selected"):
        raise ValueError(f"what: expected visible or selected, got {what!r}")
    shown = scene.visible
    if what == "selected":
        shown &= scene.has(State.SELECTED)
    return np.flatnonzero(shown).astype(np.int32)


@of_scene_now
def export_objects_stage(
    scene: Scene,
    folder: Path,
    groups: Sequence[int] | None = None,
    *,
    source: str = "",
    form: SplatFormat | MeshExport = SplatFormat.PLY,
    options: ExportOptions = _AS_IS,
    kept: Collection[Path] = (),
) -> Stage[Path]:
    """Write one file per group into ``folder``, and ``groups.json``; returns the manifest's path.

    That is ``groups-2.json`` and so on where it would take the place of another export's.

    ``groups`` are all that are visible by default; a group without a visible splat gets no file.
    A `MeshExport` writes a solid in place of the splats; an object without one is left out.
    The manifest is a `gaga_core.scene.export_manifest.Manifest`.
    Files appear all together at the end; a cancel or a full disk leaves nothing. ``options`` change
    what is written, with one origin for all files. Raises ``GagaError`` when none of the groups is
    visible, or a file would replace one that is to be ``kept``.
    """
    objects = _objects(scene, groups, form.suffix, options)
    if not objects:
        raise GagaError("None of these objects is visible, so there is nothing to export.")
    stay = {path.resolve() for path in kept}
    if taken := next((e.file for e, _ in objects if (folder / e.file).resolve() in stay), ""):
        raise GagaError(f"This scene is read from {folder / taken}. Choose another folder.")
    written: list[ManifestEntry] = []
    left_out: list[str] = []
    origin = options.origin(world_means(scene, np.concatenate([rows for _, rows in objects])))
    with staging_folder(folder) as staging:
        for i, (entry, splats) in enumerate(objects):
            step = Progress("Export objects", i, len(objects), entry.name)
            gaussians = yield from as_step(step, bake_stage(scene, indices=splats))
            gaussians = gaussians.with_metres(scene.frame.is_metric)
            psnr, is_main = None, object_parts(scene, splats)
            if isinstance(form, MeshExport):
                try:
                    solid = object_mesh_stage(gaussians, form, options.up)
                    mesh = yield from as_step(step, solid, 1)
                except GagaError:  # it has no such solid: the others are written
                    left_out.append(entry.name)
                    continue
                mesh = mesh.moved(origin, options.scale)
                if form.file is MeshFile.GLB:
                    mesh = mesh.turned(options.turn())
                write_mesh(staging / entry.file, mesh, form.file, entry.name)
            else:
                fewer = _decimated(gaussians, scene.labels[splats], options, alone=True)
                merging = int(options.decimate < 1)  # takes the most of it, else writing does
                gaussians, rows, psnr = yield from as_step(step, fewer, merging)
                is_main = is_main[rows]
                step = replace(step, done=i + merging)
                if form is SplatFormat.HTML:  # the page of one object begins with all of it
                    alone = replace(options, page=PageContent(title=entry.name))
                    page = gaussians, staging / entry.file, alone, origin
                    stage = write_scene_page_stage(scene, splats[rows], *page)
                else:
                    placed = _as_written(gaussians, origin, form, options)
                    stage = write_splats_stage(staging / entry.file, placed, form)
                yield from as_step(step, stage, 1 - merging)
            written.append(_described(entry, options.applied(gaussians, origin), psnr, is_main))
        yield Progress("Export objects", len(objects), len(objects))
        if not written:
            raise GagaError("None of these objects has a surface, so there is nothing to export.")
        ids = {entry.id for entry in written}
        # The parent: the nearest object above it that is written, too.
        parents = [scene.folders.nearest(entry.id, ids) for entry in written]
        content = Manifest(
            version=MANIFEST_VERSION,
            source=source,
            form=str(form.form) if isinstance(form, MeshExport) else str(form),
            up=options.up,
            units=options.scale,
            left_out=left_out,
            groups=[changed(e, parent=p) for e, p in zip(written, parents, strict=True)],
        )
        files = [entry.file for entry in written]
        name, former, emptied = place_manifest(folder, files)
        for other, rest in {**former, name: content}.items():
            write_manifest(rest, staging, other)
        publish_all(staging, [*files, *former, name], folder)
        for other in emptied:
            (folder / other).unlink(missing_ok=True)
    return folder / name


def as_step(step: Progress, stage: Stage[T], width: float = 0) -> Stage[T]:
    """Run ``stage`` as a part of ``step``: it can be cancelled.

    The bar moves over ``width`` steps as the stage goes on, and never back.
    """
    share = 0.0

    def change(inner: Progress) -> Progress:
        nonlocal share
        share = max(share, min(inner.done / inner.total, 1.0) if inner.total > 0 else 0.0)
        return replace(step, done=step.done + width * share)

    yield step
    return (yield from mapped(stage, change))


def _objects(
    scene: Scene, groups: Sequence[int] | None, suffix: str, options: ExportOptions
) -> list[tuple[ManifestEntry, IntArray]]:
    """The groups to write, by id, each with a file name of its own, and their splats (K,)."""
    shown = options.inside(scene, exported_indices(scene))
    order = np.argsort(scene.labels[shown], kind="stable")
    ids, starts = np.unique(scene.labels[shown][order], return_index=True)
    wanted = set(ids[ids > 0].tolist()) if groups is None else {int(g) for g in groups}
    used: set[str] = set()
    objects = []
    for group, splats in zip(ids.tolist(), np.split(shown[order], starts[1:]), strict=len(ids) > 0):
        if group not in wanted:
            continue
        name = group_name(scene, group)
        red, green, blue = group_colors(np.array([group]), scene.colors)[0].tolist()
        color = round(red, 4), round(green, 4), round(blue, 4)
        stem = slug(name) or f"group-{group}"
        stem = next(n for i in count(1) if (n := f"{stem}-{i}" if i > 1 else stem) not in used)
        used.add(stem)
        folder = scene.folders.places.get(group, "")
        objects.append(
            (ManifestEntry(group, name, color, 0, [], stem + suffix, folder=folder), splats)
        )
    return objects


def least_psnr(manifest: Path) -> float | None:
    """PSNR in dB of the object that lost most in a decimation; None when nothing was decimated.

    Raises ``GagaError`` when the manifest is damaged.
    """
    known = [entry.psnr for entry in read_manifest(manifest).groups if entry.psnr is not None]
    return min(known, default=None)


def _described(
    entry: ManifestEntry, gaussians: Gaussians, psnr: float | None, is_main: BoolArray
) -> ManifestEntry:
    """``entry`` with what can be told of ``gaussians`` (N), which are written for it; those that
    are no floaters: ``is_main`` (N,)."""
    means = gaussians.means[np.isfinite(gaussians.means).all(axis=1)]
    corners = [means.min(axis=0).tolist(), means.max(axis=0).tolist()] if len(means) else []
    box = oriented_box(gaussians.means[is_main])
    oriented = box and BoxEntry(box.centre.tolist(), box.axes.T.tolist(), box.size.tolist())
    return changed(entry, count=len(gaussians), bbox=corners, oriented_box=oriented, psnr=psnr)


def slug(name: str) -> str:
    """A file name of ``name`` for every system: lower-case a-z, 0-9 and hyphens; may be empty."""
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    short = re.sub(r"[^a-z0-9]+", "-", plain)[:60].strip("-")
    return f"{short}-object" if short and safe_name(short) != short else short


_SAMPLE, _PIECE = 16_000, 500  # splats, 40 ms; of so many in a row, as neighbours are alike


PACKED = (SplatFormat.SPZ, SplatFormat.SPZ4, SplatFormat.SOG, SplatFormat.HTML)


def sampled_bytes(
    gaussians: Gaussians,
    splats: IntArray,
    n: int,
    options: ExportOptions,
    form: SplatFormat,
    n_objects: int = 0,
) -> int:
    """About how large a file of ``n`` splats like ``splats`` (K,) is, in a form of `PACKED`: some
    are written.

    How well its numbers are packed depends on the scene: three times as well where most splats
    look the same from every side. ``n_objects``: how many a web page lists, with a picture each.
    """
    if len(splats) == 0:
        return 0
    pieces = np.array_split(splats, max(1, len(splats) // _PIECE))
    some = np.concatenate(pieces[:: max(1, len(splats) // _SAMPLE)])
    placed = options.applied(gaussians.take(some), np.zeros(3))
    is_page = form is SplatFormat.HTML
    fixed = {SplatFormat.SOG: _BOOKS, SplatFormat.HTML: viewer_bytes() + _BOOKS}.get(form, 0)
    with tempfile.TemporaryDirectory() as folder:

        def size(what: Gaussians) -> int:
            path = Path(folder) / f"sample{form.suffix}"
            run_stage(write_splats_stage(path, what, form))
            return path.stat().st_size

        if fixed == 0 or placed.sh_degree == 0:
            shown, plain = 0.0, size(placed)
        else:  # the palette of SH has as many rows as there are splats, but no more than PALETTE
            label = _PAGE_LABEL if is_page else _SOG_LABEL
            plain = size(replace(placed, sh=placed.sh[:, :1]))
            rows = size(placed) - plain - label * len(some)
            shown = label * n + rows * min(n, PALETTE) / min(len(some), PALETTE)
        listed = _PAGE_OBJECT * n_objects if is_page else 0
        return round(fixed + max(plain - fixed, 0) * n / len(some) + shown + listed)


def estimated_bytes(gaussians: Gaussians, n: int, form: SplatFormat, sh_degree: int) -> int:
    """How large a file with ``n`` splats like ``gaussians`` is, at ``sh_degree``, in a form whose
    splats take the same bytes each."""
    n_rest = 3 * ((sh_degree + 1) ** 2 - 1)
    if form is SplatFormat.SPLAT:
        return n * _SPLAT
    if form is SplatFormat.COMPRESSED_PLY:
        return _HEADER + n * (16 + n_rest) + -(-n // 256) * 72
    if form is SplatFormat.PLY:
        extra = sum(c.nbytes // max(len(c), 1) for c in gaussians.extra.values())
        extra += 4 * len({"nx", "ny", "nz"} - {*gaussians.extra})  # normals that are 0
        return _HEADER + n * (4 * (14 + n_rest) + extra)
    shown = 4 if form is SplatFormat.GLB else 0  # COLOR_0, for viewers without the extension
    return _HEADER + 4 * n * (11 + 3 + n_rest + shown)
