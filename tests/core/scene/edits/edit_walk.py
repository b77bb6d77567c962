"""A random walk over every kind of edit, for tests of undo and of the project file."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, IntArray
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import quats_to_matrices
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.scene import edits
from gaga_core.scene.edits import Edit
from gaga_core.scene.edits.splats import append_made
from gaga_core.scene.folders import Folders, is_inside, name_of, parent_of
from gaga_core.scene.frame import Frame
from gaga_core.scene.named_arrays import identity_arrays
from gaga_core.scene.scene import Scene, State, Weight
from tests.scenes import random_gaussians


@dataclass(frozen=True)
class Snapshot:
    """Bytes of everything in a scene but its revision."""

    columns: dict[str, tuple[str, bytes]]
    names: dict[int, str]
    colors: dict[int, tuple[float, float, float]]
    weights: dict[int, Weight]
    folders: Folders
    bank: MemoryBank | None
    sets: dict[str, bytes]


def snapshot(scene: Scene) -> Snapshot:
    """A deep copy, comparable with ``==``."""
    return Snapshot(
        {name: (str(a.dtype), a.tobytes()) for name, a in columns(scene).items()},
        dict(scene.names),
        dict(scene.colors),
        dict(scene.weights),
        scene.folders,
        scene.bank,
        {name: kept.mask().tobytes() for name, kept in scene.named_selections.items()},
    )


def columns(scene: Scene) -> dict[str, AnyArray]:
    g, table = scene.gaussians, scene.placements
    extra = {f"extra {name}": column for name, column in g.extra.items()}
    if scene.confidence is not None:
        extra["confidence"] = scene.confidence
    extra |= {f"identities {name}": a for name, a in identity_arrays(scene.identities).items()}
    extra |= {"world": scene.frame.world, "is_metric": np.array(scene.frame.is_metric)}
    return extra | {
        "means": g.means,
        "quats": g.quats,
        "log_scales": g.log_scales,
        "logit_opacities": g.logit_opacities,
        "sh": g.sh,
        "labels": scene.labels,
        "state": scene.state,
        "placement": scene.placement,
        "source": scene.source,
        "matrix": table.matrix,
        "color": table.color,
        "opacity": table.opacity,
    }


def walk_scene(n: int = 400, *, seed: int = 0, sh_degree: int = 1) -> Scene:
    """Random splats in 7 groups, with extra columns, a bank and a name."""
    rng = np.random.default_rng(seed)
    plain = random_gaussians(n, seed=seed, sh_degree=sh_degree)
    extra = {"nx": rng.normal(size=n).astype(np.float32), "tag": rng.integers(0, 255, n, np.uint8)}
    gaussians = Gaussians(
        plain.means, plain.quats, plain.log_scales, plain.logit_opacities, plain.sh, extra
    )
    scene = Scene.of(gaussians, np.sort(rng.integers(0, 7, n)).astype(np.int32))
    scene.bank = some_bank(rng, scene)
    scene.names = {2: "mug"}
    return scene


def some_bank(rng: np.random.Generator, scene: Scene) -> MemoryBank:
    log = tuple(
        Decision(f"{v}.png", m, int(rng.integers(1, 7)), v == 0, 0.5, 0, 0.0, 10)
        for v in range(3)
        for m in range(4)
    )
    return MemoryBank(scene.labels.copy(), 7, log, preset="robust")


def random_affine(rng: np.random.Generator) -> DoubleArray:
    return np.eye(3, 4) + rng.normal(0, 0.3, (3, 4))


def random_splats(rng: np.random.Generator, scene: Scene) -> AnyArray:
    """A group, a range, a scatter, all, none, or a mask: every form of an index set."""
    n = len(scene)
    kind = rng.integers(6)
    if kind == 0:
        return np.flatnonzero(scene.labels == rng.integers(0, 8))
    if kind == 1:
        start = int(rng.integers(n))
        return np.arange(start, min(n, start + int(rng.integers(1, n))))
    if kind == 2:
        return rng.choice(n, rng.integers(1, 12), replace=False)
    if kind == 3:
        return np.arange(n) if rng.random() < 0.3 else np.zeros(0, np.int32)
    if kind == 4:
        return scene.has(State.SELECTED)
    return rng.random(n) < rng.random()


def _under(rng: np.random.Generator, scene: Scene) -> Edit | None:
    groups, parent = rng.integers(1, 9, 2).tolist(), int(rng.integers(1, 9))
    if rng.random() < 0.3:
        return edits.leave_parent(scene, groups)
    below = scene.folders.under(*groups)
    return None if parent in (*groups, *below) else edits.set_parent(scene, groups, parent)


def _made(rng: np.random.Generator, scene: Scene) -> Edit | None:
    if len(scene) >= 3000:
        return None
    labels = rng.integers(0, 9, 5).astype(np.int32)
    splats = random_gaussians(5, seed=int(rng.integers(99)), sh_degree=2)
    merged_from = Frame() if rng.random() < 0.5 else None
    return append_made(scene, splats, labels, "Made", merged_from=merged_from)


def _moved(rng: np.random.Generator, scene: Scene) -> Edit | None:
    turn = quats_to_matrices(rng.normal(size=(1, 4)))[0] * rng.uniform(0.5, 2)
    return edits.move_scene(scene, np.column_stack([turn, rng.normal(size=3)]), "Move")


def builders() -> dict[str, Callable[[np.random.Generator, Scene], Edit | None]]:
    """Every builder of `gaga_core.scene.edits`, with random arguments."""
    s = random_splats
    hows: list[edits.How] = ["set", "add", "remove", "intersect"]

    def relabel(rng: np.random.Generator, scene: Scene) -> Edit | None:
        rows = np.flatnonzero(rng.random(len(scene)) < 0.3)
        return edits.set_labels(scene, rows, rng.integers(0, 400, len(rows)).astype(np.int32))

    def regroup(rng: np.random.Generator, scene: Scene) -> Edit | None:
        labels: IntArray = rng.integers(0, 9, len(scene)).astype(np.int32)
        sure = rng.random(400).astype(np.float32) if rng.random() < 0.7 else None
        return edits.set_grouping(scene, labels, some_bank(rng, scene), {3: "bowl"}, "x", sure)

    def lift(rng: np.random.Generator, scene: Scene) -> Edit | None:
        n = scene.n_opened
        labels = rng.integers(0, 9, n).astype(np.int32)
        sure, colors = rng.random(n).astype(np.float32), rng.integers(0, 255, (n, 3), np.uint8)
        return edits.set_identities(scene, labels, sure, colors, used=bool(rng.random() < 0.5))

    def use_labels(rng: np.random.Generator, scene: Scene) -> Edit | None:
        if scene.identities.other is None:
            return lift(rng, scene)
        return edits.use_labels(scene, "votes" if rng.random() < 0.5 else "identities")

    def put_in_folder(rng: np.random.Generator, scene: Scene) -> Edit | None:
        known = scene.folders.paths
        into = ("", "a", "a/b", "c", *known)[rng.integers(4 + len(known))]
        others = [p for p in known if not is_inside(into, p) and rng.random() < 0.3]
        return edits.put_in_folder(scene, rng.integers(1, 9, 3).tolist(), into, others)

    def on_folder(rng: np.random.Generator, scene: Scene) -> Edit | None:
        if not scene.folders.paths:
            return edits.new_folder(scene, "a/b")
        path = scene.folders.paths[rng.integers(len(scene.folders.paths))]
        if rng.random() < 0.5:
            return edits.delete_folder(scene, path)
        free = scene.folders.free(parent_of(path), "renamed")
        return edits.rename_folder(scene, path, name_of(free))

    return {
        "append_made": _made,
        "move_scene": _moved,
        "under": _under,
        "put_in_folder": put_in_folder,
        "on_folder": on_folder,
        "set_identities": lift,
        "use_labels": use_labels,
        "select": lambda r, c: edits.select(c, s(r, c), hows[r.integers(4)]),
        "hide": lambda r, c: edits.hide(c, s(r, c)),
        "show": lambda r, c: edits.show(c, s(r, c)),
        "show_all": lambda r, c: edits.show_all(c),
        "isolate": lambda r, c: edits.isolate(c, s(r, c)),
        "lock": lambda r, c: edits.lock(c, s(r, c)),
        "unlock": lambda r, c: edits.unlock(c, s(r, c)),
        "delete": lambda r, c: edits.delete(c, s(r, c)),
        "restore": lambda r, c: edits.restore(c),
        "transform": lambda r, c: edits.transform(c, s(r, c), random_affine(r)),
        "recolor": lambda r, c: edits.recolor(c, s(r, c), random_affine(r), r.uniform(0.5, 1)),
        "duplicate": lambda r, c: (
            edits.duplicate(c, s(r, c), random_affine(r) if r.random() < 0.5 else None)
            if len(c) < 3000
            else None
        ),
        "keep_set": lambda r, c: edits.keep_selection(c, f"set {r.integers(3)}", s(r, c)),
        "forget_set": lambda r, c: edits.forget_selection(
            c, next(iter(c.named_selections), "none")
        ),
        "set_labels": relabel,
        "separate": lambda r, c: edits.separate(c, s(r, c)),
        "set_grouping": regroup,
        "set_color": lambda r, c: edits.set_color(
            c, int(r.integers(1, 5)), r.random(3).tolist() if r.random() < 0.7 else None
        ),
        "set_weight": lambda r, c: edits.set_weight(
            c, int(r.integers(1, 5)), Weight("mass", r.random() + 0.1) if r.random() < 0.7 else None
        ),
        "rename": lambda r, c: edits.rename(c, int(r.integers(1, 9)), f"name {r.integers(3)}"),
        "merge_groups": lambda r, c: edits.merge_groups(c, r.integers(1, 9, 3).tolist()),
    }
