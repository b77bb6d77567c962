"""What the tool Object knows of the open scene: its graph, and the answers to clicks so far."""

from typing import TYPE_CHECKING

from gaga_core.scene.scene import Scene

if TYPE_CHECKING:
    from gaga_core.camera import Camera
    from gaga_core.scene.selection.click import Answer, Click, ClickGraph


class ClickState:
    """The answers are kept by `History.state_id`: undo of a click brings the one before back."""

    def __init__(self) -> None:
        self.graph: ClickGraph | None = None
        self.made_for: object = None  # `key_of` the scene that the graph was made of
        self.is_preparing = False
        self.answers: dict[int, Answer] = {}  # by state of the history
        self.views: dict[int, Camera] = {}  # of the last click on the thing, by state
        self.waiting: list[tuple[Click, Camera]] = []  # clicked before the graph was ready
        self.is_asking = False  # a model, in the background
        self.asks_again = False  # as soon as the model has stopped: there are more clicks

    def is_ready(self, scene: Scene) -> bool:
        """Whether the graph is that of the scene as it is now."""
        return self.graph is not None and self.made_for == key_of(scene)

    def take(self, graph: "ClickGraph", key: object) -> None:
        """Use a new graph; answers of the former one mean nothing any more."""
        self.graph, self.made_for = graph, key
        self.answers, self.views = {}, {}


def key_of(scene: Scene) -> object:
    """What changes when splats are added or moved, so that a graph is no longer theirs."""
    revision = scene.revision
    return revision.splats, revision.placement, revision.placements
