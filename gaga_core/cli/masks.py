"""The command that makes 2D masks."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from gaga_core.cli import output as out
from gaga_core.errors import GagaError

if TYPE_CHECKING:
    from gaga_core.segmentation.base import Provider
    from gaga_core.segmentation.choose import ProviderEntry


@dataclass(frozen=True)
class MasksCommand:
    """Make 2D masks of a scene's photos with a model, or without any (regions)."""

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
    longest_side: int = 1600
    """Larger photos are shrunk to this many pixels; 0 = never."""
    device: Literal["auto", "cpu", "cuda", "mps"] = "auto"
    """Where models run: auto takes CUDA where torch has it."""
    order: Literal["auto", "coverage", "name"] = "auto"
    """Which photos come first. coverage: those that tell most of what none before them showed, so
    that a run may be stopped early (needs splats). auto: coverage for models, name for regions."""
    stop_after: float = 0.0
    """Begin no further photo after so many seconds, and use what is there; 0 = make all."""
    redo: bool = False
    """Make masks again that are there already."""
    list: bool = False
    """Print the providers: which can be used here, sizes, licences, and what to put where."""
    json: bool = False
    """Print the result as JSON."""

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
        from gaga_core.io.scene_folder import find_mask_folders, open_scene_folder
        from gaga_core.models.speed import record
        from gaga_core.pipeline.compile_kernels import after_warm_up
        from gaga_core.pipeline.segment import SegmentConfig, segment_scene

        if self.longest_side < 0:
            raise GagaError("--longest-side counts pixels: choose 0 (never shrink) or more.")
        if not 0 <= self.stop_after < float("inf"):
            raise GagaError("--stop-after counts seconds: choose 0 (make all) or more.")
        folder = open_scene_folder(self.scene)
        provider = self._provider()
        stage = segment_scene(
            folder,
            provider,
            views=self.views,
            name=self.name,
            redo=self.redo,
            config=SegmentConfig(
                longest_side=self.longest_side,
                order=self.order,
                stop_after_s=self.stop_after,
            ),
        )
        draws_depth = "depth" in provider.cues and folder.model_path is not None
        report = out.follow(after_warm_up(stage) if draws_depth else stage)
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
        from gaga_core.io.scene_folder import open_scene_folder
        from gaga_core.pipeline.import_masks import import_masks
        from gaga_core.segmentation.flatten import FlattenConfig

        config = FlattenConfig(min_score=self.min_score)
        stage = import_masks(
            open_scene_folder(scene), source, self.name or None, config=config, replace=self.redo
        )
        report = out.follow(stage)
        for note in report.notes():
            out.say(note)
        shown = {"folder": report.folder, "views": len(report.views), "masks": report.n_masks}
        out.result(report.to_json() if self.json else shown, as_json=self.json)
        return 0

    def _provider(self) -> "Provider":
        from gaga_core.segmentation.choose import ProviderSettings, provider_named
        from gaga_core.segmentation.flatten import FlattenConfig
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
        out.scores(_Listing(entries), as_json=self.json)
        if not self.json:
            for entry in entries:
                if entry.reason or entry.note:
                    note = f"{entry.note[:1].upper()}{entry.note[1:]}. " if entry.note else ""
                    out.say(f"{entry.name}: {note}{entry.reason}")
        return 0


@dataclass(frozen=True)
class _Listing:
    """The providers, as a table or plain values."""

    entries: "tuple[ProviderEntry, ...]"

    def table(self) -> list[list[str]]:
        """A row a provider."""
        rows = [["provider", "model", "here", "MB", "licence"]]
        for entry in self.entries:
            size = f"{entry.megabytes:,}" if entry.megabytes else ""
            here = "yes" if entry.is_available else "no"
            rows.append([entry.name, entry.title, here, size, entry.licence])
        return rows

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        return {"providers": [asdict(e) | {"path": str(e.path or "")} for e in self.entries]}
