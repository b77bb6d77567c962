"""``gaga segment``: one object by clicks, without masks and without a model."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, UseAppendAction, arg

from gaga_core.cli import output as out
from gaga_core.errors import GagaError

if TYPE_CHECKING:
    from gaga_core.pipeline.click import ViewBox, ViewClick
    from gaga_core.segmentation.prompter import Prompter


@dataclass(frozen=True)
class SegmentCommand:
    """Make an object of what clicks in views mean: VIEW,U,V with U and V in pixels of the photo."""

    scene: Positional[Path]
    """Scene folder, file of splats (.ply, .splat, .spz, .sog, .ksplat, .glb, .gltf) or
    saved project."""
    click: UseAppendAction[tuple[str, ...]] = ()
    """On the object: VIEW,U,V. May be given again. Views of a lone file of splats are 0 to 18."""
    not_: Annotated[UseAppendAction[tuple[str, ...]], arg(name="not")] = ()
    """Off the object: VIEW,U,V. May be given again; answered after all --click."""
    box: str | None = None
    """Around the object: VIEW,U0,V0,U1,V1. Answered before the clicks."""
    model: str | None = None
    """A Segment Anything model that is here (sam2.1-tiny, ...; see gaga models list), or the folder
    of one: ask it in the view of the clicks and in views around. Default: no model."""
    name: str | None = None
    """Name of the new object."""
    dry_run: bool = False
    """Change nothing; print the figures only."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Select, make the object in the saved project, and print its number and size."""
        clicks = [_click(text, True) for text in self.click]
        clicks += [_click(text, False) for text in self.not_]
        box = None if self.box is None else _box(self.box)
        if box is None and not self.click:
            raise GagaError("Say where the object is: --click VIEW,U,V or --box VIEW,U0,V0,U1,V1.")
        from gaga_core.pipeline.click import click_stage
        from gaga_core.pipeline.compile_kernels import after_warm_up
        from gaga_core.scene.project import open_path_stage

        project = out.follow(open_path_stage(self.scene))
        start = time.perf_counter()
        prompter = None if self.model is None else _prompter(self.model)
        found = out.follow(after_warm_up(click_stage(project, clicks, box, prompter=prompter)))
        values: dict[str, object] = {
            "splats": len(found.splats),
            "clicks": found.n_clicks,
            "seconds": round(time.perf_counter() - start, 2),
        }
        if not self.dry_run:
            from gaga_core.scene import edits
            from gaga_core.scene.edits.history import History
            from gaga_core.scene.project import save_project

            history, scene = History(project.scene), project.scene
            if history.do(edits.separate(scene, found.splats, "Make object")) and self.name:
                history.do(edits.rename(scene, int(scene.labels[found.splats[0]]), self.name))
            values["group"] = int(scene.labels[found.splats[0]])
            values["project"] = str(save_project(project))
        out.result(values, as_json=self.json)
        return 0


def _prompter(model: str) -> "Prompter":
    from gaga_core.segmentation.choose import prompter_named

    folder = Path(model)
    return prompter_named(model, weights=folder if folder.exists() else None)


def _click(text: str, is_on: bool) -> "ViewClick":
    from gaga_core.pipeline.click import ViewClick

    view, (u, v) = _place(text, 2, "VIEW,U,V")
    return ViewClick(view, u, v, is_on)


def _box(text: str) -> "ViewBox":
    from gaga_core.pipeline.click import ViewBox

    view, (u0, v0, u1, v1) = _place(text, 4, "VIEW,U0,V0,U1,V1")
    return ViewBox(view, u0, v0, u1, v1)


def _place(text: str, n: int, form: str) -> tuple[str, list[float]]:
    """The view and the numbers of "VIEW,U,V"; a view's name may hold commas."""
    view, *numbers = text.rsplit(",", n)
    try:
        values = [float(number) for number in numbers]
    except ValueError:
        values = []
    if len(values) != n or not view:
        raise GagaError(f"{text!r} is not {form}.")
    return view, values
