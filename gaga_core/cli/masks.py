"""The command that makes 2D masks."""

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, UseAppendAction, arg

from gaga_core.cli import output as out
from gaga_core.cli.output import AnyScene, AsJson, options
from gaga_core.errors import GagaError
from gaga_core.pipeline.settings import SegmentConfig

if TYPE_CHECKING:
    from gaga_core.segmentation.base import Provider


@dataclass(frozen=True)
class MasksCommand:
    """Make 2D masks of a scene's photos with a model, or without any (regions)."""

    pictures: Annotated[
        SegmentConfig, options(SegmentConfig, "longest_side", "order", "stop_after")
    ]
    scene: Positional[Path | None] = None
    """Scene folder; may be left out with --list."""
    provider: str = ""
    """Who makes them: see --list. With --weights any name, which is that of the masks' folder."""
    weights: Path | None = None
    """A model's folder (config.json, model.safetensors) or a sam_vit_*.pth file."""
    name: str = ""
    """Folder in SCENE/masks; default: the provider's name."""
    source: Annotated[Path | None, arg(name="from")] = None
    """Import masks that another program made instead: label maps (PNG), lists of masks of SAM or
    COCO (JSON, npz, npy), folders of binary masks, raw_*_mask of Gaga, object_mask of Gaussian
    Grouping. What it is is recognised."""
    views: tuple[str, ...] = ("train",)
    """train, test, all, or names of views."""
    profile: Literal["default", "paper"] = "default"
    """paper: the published settings. SAM models: 64 points a side and predicted IoU 0.7 (sixteen
    times the time on a processor); Mask2Former-like ones: nothing is left out for being covered."""
    points_per_side: int = 0
    """Points along each side of the grid (SAM models); default 16, on a graphics card 32."""
    crop_layers: int = 0
    """Look at 4, 16, ... crops as well, for small things (SAM models)."""
    min_score: float = 0.5
    """Least confidence of a mask (models)."""
    detail: float = 1.0
    """2: about twice the regions, 0.5: half of them (regions)."""
    kind: Literal["entity", "panoptic"] = "entity"
    """How queries become masks (Mask2Former-like models)."""
    device: Literal["auto", "cpu", "cuda", "mps"] = "auto"
    """Where models run: auto takes CUDA where torch has it."""
    redo: bool = False
    """Make masks again that are there already."""
    list: bool = False
    """Print the providers: which can be used here, sizes, licences, and what to put where."""
    json: AsJson = False

    def run(self) -> int:
        """Write SCENE/masks/<name>/<stem>.png, 16-bit label maps."""
        if self.list:
            return self._print_list()
        if self.scene is not None and self.source is not None:
            return self._import(self.scene, self.source)
        if self.scene is None or not (self.provider or self.weights):
            raise GagaError(
                "Name a scene folder and a provider of masks (--provider). --list shows them all."
            )
        from gaga_core.io.folder.scene_folder import find_mask_folders, open_scene_folder
        from gaga_core.pipeline.segment import segment_scene
        from gaga_core.segmentation.models.status import record

        folder = open_scene_folder(self.scene)
        provider = self._provider()
        stage = segment_scene(
            folder,
            provider,
            views=self.views,
            name=self.name,
            redo=self.redo,
            config=self.pictures,
        )
        draws_depth = "depth" in provider.cues and folder.model_path is not None
        report = out.follow(stage, compiles=draws_depth)
        if report.made and provider.name != "regions":
            record(report.provider, report.seconds / len(report.made))
        for note in report.notes:
            out.say(note)
        others = find_mask_folders(folder.root)
        if len(others) > 1:
            out.say(
                f"This scene has several mask folders ({', '.join(sorted(others))}): "
                f"name one, as in gaga associate {self.scene} --masks {report.folder.name}."
            )
        out.result(report.to_json(), as_json=self.json)
        return 0 if not report.failed else 1

    def _import(self, scene: Path, source: Path) -> int:
        from gaga_core.io.folder.scene_folder import open_scene_folder
        from gaga_core.pipeline.import_masks import import_masks
        from gaga_core.segmentation.base import FlattenConfig

        config = FlattenConfig(min_score=self.min_score)
        stage = import_masks(
            open_scene_folder(scene), source, self.name or None, config=config, replace=self.redo
        )
        report = out.follow(stage)
        for note in report.notes():
            out.say(note)
        shown = {"folder": report.folder, "views": len(report.views), "masks": report.n_masks}
        return out.result(report.to_json() if self.json else shown, as_json=self.json)

    def _provider(self) -> "Provider":
        from gaga_core.segmentation.base import FlattenConfig
        from gaga_core.segmentation.choose import ProviderSettings, provider_named
        from gaga_core.segmentation.regions import RegionsConfig
        from gaga_core.segmentation.settings import UniversalConfig

        try:
            settings = ProviderSettings(
                regions=RegionsConfig(detail=self.detail),
                profile=self.profile,
                points_per_side=self.points_per_side,
                crop_layers=self.crop_layers,
                universal=UniversalConfig(kind=self.kind, min_score=self.min_score),
                flatten=FlattenConfig(min_score=self.min_score),
                device=self.device,
            )
        except ValueError as error:
            raise GagaError(f"Settings out of range ({error}). See gaga masks --help.") from error
        name = self.provider or (self.weights.stem if self.weights else "")
        return provider_named(name, weights=self.weights, settings=settings)

    def _print_list(self) -> int:
        from gaga_core.segmentation.choose import available_providers

        entries = available_providers()
        if self.json:
            plain = [asdict(e) | {"path": str(e.path or "")} for e in entries]
            return out.result({"providers": plain}, as_json=True)
        rows = [["provider", "model", "here", "MB", "licence"]]
        for entry in entries:
            size = f"{entry.megabytes:,}" if entry.megabytes else ""
            here = "yes" if entry.is_available else "no"
            rows.append([entry.name, entry.title, here, size, entry.licence])
        out.table(rows)
        for entry in entries:
            if entry.reason or entry.note:
                note = f"{entry.note[:1].upper()}{entry.note[1:]}. " if entry.note else ""
                out.say(f"{entry.name}: {note}{entry.reason}")
        return 0


# --- ``gaga segment``: one object by clicks, without masks and without a model.


@dataclass(frozen=True)
class SegmentCommand:
    """Make an object of what clicks in views mean: VIEW,U,V with U and V in pixels of the photo."""

    scene: AnyScene
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
    json: AsJson = False

    def run(self) -> int:
        """Select, make the object in the saved project, and print its number and size."""
        from gaga_core.pipeline.click import ViewBox, ViewClick, click_stage
        from gaga_core.scene import edits
        from gaga_core.scene.edits.history import History
        from gaga_core.scene.project import save_project
        from gaga_core.segmentation.choose import prompter_named

        clicks = []
        for text, is_on in (*((t, True) for t in self.click), *((t, False) for t in self.not_)):
            view, (u, v) = _place(text, 2, "VIEW,U,V")
            clicks.append(ViewClick(view, u, v, is_on))
        box = None
        if self.box is not None:
            view, (u0, v0, u1, v1) = _place(self.box, 4, "VIEW,U0,V0,U1,V1")
            box = ViewBox(view, u0, v0, u1, v1)
        if box is None and not self.click:
            raise GagaError("Say where the object is: --click VIEW,U,V or --box VIEW,U0,V0,U1,V1.")
        project = out.open_project(self.scene)
        start, prompter = time.perf_counter(), None
        if self.model is not None:
            folder = Path(self.model)
            prompter = prompter_named(self.model, weights=folder if folder.exists() else None)
        found = out.follow(click_stage(project, clicks, box, prompter=prompter), compiles=True)
        values: dict[str, object] = {
            "splats": len(found.splats),
            "clicks": found.n_clicks,
            "seconds": round(time.perf_counter() - start, 2),
        }
        if not self.dry_run:
            history, scene = History(project.scene), project.scene
            if history.do(edits.separate(scene, found.splats, "Make object")) and self.name:
                history.do(edits.rename(scene, int(scene.labels[found.splats[0]]), self.name))
            values["group"] = int(scene.labels[found.splats[0]])
            values["project"] = str(save_project(project))
        return out.result(values, as_json=self.json)


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
