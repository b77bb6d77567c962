"""The tree of merged splats of a large scene: opened with it, offered, built."""

from typing import TYPE_CHECKING

from gaga_core.errors import GagaError, counted
from gaga_core.pipeline.level_of_detail import (
    build_project_lod_stage,
    open_project_lod,
)
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.session import Session

if TYPE_CHECKING:
    from gaga_core.scene.lod.tree import LodTree

COMMAND = "view.build_lod"
LARGE = 2_000_000  # splats from which on a tree is used and offered: smaller scenes are drawn whole


def opened(session: Session) -> None:
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


def offer(session: Session) -> None:
    """Offer to build a tree of the files of a large scene that have none."""
    document = session.need()
    n, tree = len(document.scene), document.tree
    if n <= LARGE or (tree is not None and len(tree) == document.n_file_rows):
        return
    text = f"This scene has {counted(n, 'splat')}. With a level of detail it is drawn much faster."
    if tree is not None:
        left = n - len(tree)
        have = f"{counted(left, 'splat')} of added files {'has' if left == 1 else 'have'}"
        text = f"{have} no level of detail: build it again for all."
    session.notify(Level.HINT, text, COMMAND)


def tree_of(session: Session) -> "LodTree | None":
    """The tree that the picture is drawn from; None: every splat is drawn."""
    document = session.document
    if document is None or session.training is not None or not session.view.uses_lod:
        return None
    return document.tree if len(document.scene) > LARGE else None


def failed(session: Session, error: GagaError) -> None:
    """Files of the tree cannot be read: every splat is drawn again."""
    if session.document is not None and session.document.lods:
        session.document.lods = ()
        session.notify(Level.WARNING, str(error), COMMAND)


def no_tree(session: Session) -> str:
    """Needs a tree of the open scene: "" when there is one."""
    document = session.document
    if document is None:
        return "No scene is open."
    if len(document.scene) <= LARGE:
        return f"Scenes of up to {LARGE:,} splats are drawn whole."
    return "" if document.tree is not None else "Build the level of detail first."


def not_buildable(session: Session) -> str:
    """Needs a large scene without a tree, and the job runner."""
    document, job = session.document, session.jobs.running
    if document is None or len(document.scene) <= LARGE:
        return no_tree(session)
    tree = document.tree
    if tree is not None and len(tree) == document.n_file_rows:
        return "The level of detail is there already."
    return "" if job is None else f"{job.title} is still running."


@notifies
def build(session: Session) -> bool:
    """Build the tree of the open scene next to its model."""
    document = session.need()

    def done(tree: "LodTree") -> None:
        if session.document is document:
            # The tree of fewer files stays: undo takes files away.
            document.lods = (*(former for former in document.lods if len(former) < len(tree)), tree)
            session.view.uses_lod = True
        text = f"Built {len(tree.sizes) - 1} coarser levels of {counted(len(tree), 'splat')}."
        session.notify(Level.INFO, text, shows=tree.folder)

    stage = build_project_lod_stage(document.settled())
    return session.jobs.start("Build level of detail", stage, None, done)
