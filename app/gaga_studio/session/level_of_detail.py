"""The tree of merged splats of a large scene: opened with it, offered, built."""

from typing import TYPE_CHECKING

from gaga_core.errors import GagaError
from gaga_core.pipeline.level_of_detail import (
    build_project_lod_stage,
    is_of,
    open_project_lod,
    rows_of_files,
)
from gaga_core.scene.lod.edited import PickBoxes
from gaga_studio.session.notices import Level, notifies

if TYPE_CHECKING:
    from gaga_core.scene.lod.tree import LodTree
    from gaga_studio.session.document import Document
    from gaga_studio.session.session import Session

COMMAND = "view.build_lod"
LARGE = 2_000_000  # splats from which on a tree is used and offered: smaller scenes are drawn whole


def opened(session: "Session") -> None:
    """Take the tree of the scene that was opened; offer to build one of a large scene."""
    document = session.need()
    if len(document.scene) <= LARGE:
        return
    try:
        tree = open_project_lod(document.project)
    except GagaError as error:  # it can be built again
        session.notify(Level.WARNING, str(error), COMMAND)
        return
    document.lods = () if tree is None else (tree,)
    offer(session)


def offer(session: "Session") -> None:
    """Offer to build a tree of the files of a large scene that have none."""
    document = session.need()
    n, tree = len(document.scene), current(document)
    if n <= LARGE or (tree is not None and len(tree) == _rows_of_files(document)):
        return
    text = f"This scene has {n:,} splats. With a level of detail it is drawn much faster."
    if tree is not None:
        left = n - len(tree)
        text = f"{left:,} splats of added files have no level of detail: build it again for all."
    session.notify(Level.HINT, text, COMMAND)


def current(document: "Document") -> "LodTree | None":
    """Of the trees that are known the largest one of the files that are in the scene now."""

    def find() -> "LodTree | None":
        found = [tree for tree in document.lods if is_of(tree, document.project)]
        return max(found, key=len, default=None)

    key = (document.lods, document.scene.revision.splats)
    return document.read.once("level of detail", key, find)


def tree_of(session: "Session") -> "LodTree | None":
    """The tree that the picture is drawn from; None: every splat is drawn."""
    document = session.document
    if document is None or session.training is not None or not session.view.uses_lod:
        return None
    return current(document) if len(document.scene) > LARGE else None


def pick_boxes(session: "Session") -> PickBoxes | None:
    """Boxes that tell a click in a large scene which splats to look at; None: all of them.

    Also while the level of detail is switched off: what is found is the same.
    """
    document = session.document
    tree = None if document is None else current(document)
    if document is None or tree is None:
        return None
    now = document.scene.revision
    key = (id(tree), now.placement, now.placements)
    return document.read.once("pick boxes", key, lambda: PickBoxes(tree, document.scene))


def failed(session: "Session", error: GagaError) -> None:
    """Files of the tree cannot be read: every splat is drawn again."""
    if session.document is not None and session.document.lods:
        session.document.lods = ()
        session.notify(Level.WARNING, str(error), COMMAND)


def no_tree(session: "Session") -> str:
    """Needs a tree of the open scene: "" when there is one."""
    document = session.document
    if document is None:
        return "No scene is open."
    if len(document.scene) <= LARGE:
        return f"Scenes of up to {LARGE:,} splats are drawn whole."
    return "" if current(document) is not None else "Build the level of detail first."


def not_buildable(session: "Session") -> str:
    """Needs a large scene without a tree, and the job runner."""
    document, job = session.document, session.jobs.running
    if document is None or len(document.scene) <= LARGE:
        return no_tree(session)
    tree = current(document)
    if tree is not None and len(tree) == _rows_of_files(document):
        return "The level of detail is there already."
    return "" if job is None else f"{job.title} is still running."


def _rows_of_files(document: "Document") -> int:
    key = document.scene.revision.splats
    return document.read.once("rows of files", key, lambda: rows_of_files(document.scene))


@notifies
def build(session: "Session") -> bool:
    """Build the tree of the open scene next to its model."""
    document = session.need()

    def done(tree: "LodTree") -> None:
        if session.document is document:
            # The tree of fewer files stays: undo takes files away.
            document.lods = (*(former for former in document.lods if len(former) < len(tree)), tree)
            session.view.uses_lod = True
        text = f"Built {len(tree.sizes) - 1} coarser levels of {len(tree):,} splats."
        session.notify(Level.INFO, text, shows=tree.folder)

    stage = build_project_lod_stage(document.settled())
    return session.jobs.start("Build level of detail", stage, None, done)
