"""Settings of the stages, as the command and the window give them.

This module is light: the command reads it to explain its options.
"""

import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, get_args

from gaga_core.settings import check_limits, setting

if TYPE_CHECKING:
    from gaga_core.grouping.associate import AssociateConfig
    from gaga_core.identity.lift import LiftConfig, Mode
    from gaga_core.placing.ladder import LadderConfig
    from gaga_core.placing.sfm import SfmConfig
    from gaga_core.training.settings import TrainConfig

Quality = Literal["draft", "standard", "full"]
PLACE_MINUTES = {"draft": 20.0, "standard": 60.0, "full": 300.0}  # by quality


@dataclass(frozen=True)
class ReconstructConfig:
    """Settings of a reconstruction; None = what the quality says."""

    quality: Quality = setting("draft", "Quality")
    """Of splats that are still to be trained."""
    iterations: int | None = setting(None, "Iterations", least=1, most=1_000_000)
    """Training steps; default: as the quality says."""
    max_side: int | None = setting(None, "Longest side", "pixels", least=64, most=8192)
    """Longest side of the training pictures in pixels; default: as the quality says."""
    max_splats: int | None = setting(None, "Most splats", least=1000)
    """No more splats than this; default: as the quality says."""
    strategy: Literal["gradient", "mcmc"] = "gradient"
    """How splats are added: where the gradient is large, or by sampling (MCMC, Kheradmand 2024)."""
    antialiased: bool = setting(False, "Antialiased")
    """Splats that also look right from nearer and farther away, in viewers with a mip mode."""
    exposure: bool = setting(False, "Photos differ in brightness")
    """Photos differ in brightness or white balance: train both for each, outside of the splats."""
    focal: float | None = setting(None, "Focal length", "pixels", above=0)
    """Focal length in pixels of the photos as they are; default: from EXIF, else estimated."""
    video_fps: float | None = setting(None, "Frames of each second", above=0, most=60)
    """Frames to take of each second of a video; default: by its motion, the sharpest ones."""
    place_minutes: float | None = setting(None, "Minutes for placing", above=0, most=10_000)
    """Time for all attempts to place the photos; default: 20, 60 or 300 as the quality says."""
    foreground: str | None = setting(None, "Masks of the object")
    """Folder of masks of the object, NAME.png, black = background: the background is left out.
    Default: looked for, on turntables and in front of plain backdrops."""
    turntable: bool = setting(False, "Object on a turntable")
    """The object turned in front of a fixed camera, where that is not found without asking: leave
    the background out."""
    poses: Literal["keep", "refine", "scale", "ignore"] = setting(
        "refine", "Poses next to the photos"
    )
    """Poses of another program that lie next to the photos. keep: use them as they are. refine:
    adjust them, if that is better. scale: place the photos again, use only scale and vertical."""
    poses_from: str | None = setting(None, "File of the poses")
    """File or folder of poses; default: what lies next to the photos."""
    scene: int = setting(1, "Scene", least=1, most=9)
    """Which scene to make, by size, when the photos show several."""
    seed: int = 0
    """Equal seeds give equal scenes."""
    threads: int = 0
    """Processor threads; 0: all."""
    only: Literal["all", "sfm"] = "all"
    """sfm: place the photos and stop before the training."""
    accept_wrong: bool = False
    """Keep a placement of the photos that the checks refuse."""
    hold_out: bool = setting(True, "Hold test photos out")
    """Keep the test views out of the training, to measure on."""

    def __post_init__(self) -> None:
        if self.quality not in PLACE_MINUTES:
            raise ValueError(f"quality: {self.quality!r} is none of {(*PLACE_MINUTES,)}")
        check_limits(self)

    @property
    def object_only(self) -> bool:
        """Whether the background is left out."""
        return self.turntable or self.foreground is not None

    def sfm(self) -> "SfmConfig":
        """Settings of structure from motion."""
        from gaga_core.placing.sfm import SfmConfig

        config = SfmConfig.of(self.quality, threads=self.threads, seed=self.seed)
        return replace(config, moving_only=self.turntable)

    def ladder(self) -> "LadderConfig":
        """Settings of the attempts to place the photos, with their time limit."""
        from gaga_core.placing.ladder import LadderConfig

        return LadderConfig(minutes=self.place_minutes or PLACE_MINUTES[self.quality])

    def train(self) -> "TrainConfig":
        """Settings of the training."""
        from gaga_core.training.settings import TrainConfig

        config = replace(
            TrainConfig.of(self.quality),
            seed=self.seed,
            exposure=self.exposure,
            antialiased=self.antialiased,
        )
        if self.iterations is not None:
            config = replace(config, iterations=self.iterations)
        if self.max_side is not None:
            config = replace(config, longest_side=self.max_side)
        if self.max_splats is not None:
            config = config.with_cap(self.max_splats)
        return config.with_mcmc() if self.strategy == "mcmc" else config


@dataclass(frozen=True)
class AlignConfig:
    """How two captures are brought together."""

    by: Literal["auto", "photos", "surfaces"] = "auto"
    """photos: features that photos of both show. surfaces: the splats alone. auto: photos where
    both have some."""
    changes: bool = setting(True, "What changed")
    """Find what came, went or moved between the two."""
    threads: int = 0
    """Processor threads; 0: all."""
    seed: int = 0


@dataclass(frozen=True)
class SegmentConfig:
    """Settings of pictures for a provider of masks."""

    longest_side: int = setting(1600, "Longest side", "pixels", least=0)
    """Larger photos are shrunk to this many pixels, and so are their label maps; 0 = never."""
    use_depth: bool = True
    """Give providers that can use it the depth of the splats, where the scene has some."""
    order: Literal["auto", "coverage", "name"] = "auto"
    """Which photos come first. coverage: those that tell most of what none before them showed, so
    that a run may be stopped early (needs splats). auto: coverage for models, name for regions."""
    stop_after: float = setting(0.0, "Stop after", "seconds", least=0)
    """Begin no further photo after so many seconds, and use what is there; 0 = make all."""

    def __post_init__(self) -> None:
        check_limits(self)


@dataclass(frozen=True)
class GroupSettings:
    """Settings of the association; those that are not given are the preset's."""

    detail: float | None = None
    """Of groups made from regions: 0 things together .. 0.5 whole objects (default) .. 1 small
    pieces."""
    threshold: float | None = setting(None, "Overlap threshold", least=0.01, most=1.0)
    """Least overlap of a mask with a group to join it, in (0, 1]; default: 0.1, as published."""
    inlier_factor: float | None = setting(None, "Inlier factor f", least=0.0, most=4.0)
    """f of the depth gate: pixels within f IQRs of the mask's depths count; default: 1."""
    depth: Literal["expected", "median", "none", "front"] | None = setting(None, "Depth of a pixel")
    """Of a pixel; none: all Gaussians behind a mask; front: no depth but the front 20 % of a mask's
    Gaussians in each of 32 x 32 patches. Default: expected (paper), front (released), median
    (robust)."""
    order: Literal["name", "string", "coverage"] | None = setting(None, "Order of the views")
    """Of the views; name: by the numbers in it, string: by its characters, coverage: widest first.
    Default: name (paper), string (released), coverage (robust)."""

    def config(self, preset: str) -> "AssociateConfig":
        """The settings of ``preset`` with those that were given.

        ``ValueError`` when they exclude each other, ``GagaError`` when the preset has no detail.
        """
        from gaga_core.grouping.associate import AssociateConfig

        config = AssociateConfig.of(preset).at_detail(self.detail)
        names = ("threshold", "depth", "order")
        given = {name: value for name in names if (value := getattr(self, name)) is not None}
        if self.inlier_factor is not None:
            given["gate"] = replace(config.gate, iqr_factor=self.inlier_factor)
        return replace(config, **given)


@dataclass(frozen=True)
class IdentitySettings:
    """Settings of identity encodings (section 3.3)."""

    lift_iterations: int | None = setting(None, "Training steps", least=2, most=100_000)
    """Training steps of identities from zeros (paper); default: 10,000, as published."""
    pseudo: Literal["masks", "bank"] | None = setting(None, "Pseudo labels")
    """Labels that identities are trained on: masks with their groups' ids (figure 2 and released
    code), or the bank's groups splatted into the views (text of section 3.3). Default: bank where
    the preset paper trains, else masks."""
    void: Literal["ignore", "train"] | None = setting(None, "Pixels without a mask")
    """Pixels that no mask covers: ignore them, or train them as class 0. Default: train where the
    preset released trains, else ignore."""
    pixels: int | None = setting(None, "Pixels of a step", least=0)
    """Pixels of a view that a training step takes, drawn once; 0 = all. Default: all where the
    presets paper and released train, else (and in gaga compare) 16384, which takes a thirtieth of
    the time."""

    def config(self, preset: str, mode: "Mode") -> "LiftConfig":
        """Settings of a lift of ``preset`` with those that were given; ``ValueError`` when out of
        range."""
        from gaga_core.identity.lift import LiftConfig

        config = LiftConfig.of(preset, mode)
        paper, refine = config.paper, config.refine
        if self.lift_iterations is not None:
            paper = replace(paper, iterations=self.lift_iterations)
        if self.pixels is not None:
            # A sample is without the smallest weights, which halves its memory.
            w_min = 0.0 if self.pixels == 0 else type(paper.rows)().w_min
            paper = replace(paper, rows=replace(paper.rows, per_view=self.pixels, w_min=w_min))
        if self.void is not None:
            trains = self.void == "train"
            rows = replace(paper.rows, train_void=trains)
            paper = replace(paper, rows=rows, has_none=paper.has_none or trains)
            refine = replace(refine, rows=replace(refine.rows, train_void=trains))
        return replace(config, paper=paper, refine=refine, pseudo=self.pseudo or config.pseudo)


Engine = Literal["local", "dask"]


@dataclass(frozen=True)
class EngineConfig:
    """Workers that run many scenes."""

    engine: Engine = "local"
    workers: int = setting(2, "Workers", least=1)
    """Scenes at once, where the workers are started here."""
    threads: int = 0
    """Of each worker; 0 = an equal share."""
    address: str = ""
    """Of a dask scheduler that is running; default: start one here."""

    def __post_init__(self) -> None:
        if self.engine not in get_args(Engine):
            raise ValueError(f"engine: {self.engine!r} is none of {get_args(Engine)}")
        check_limits(self)

    @property
    def threads_each(self) -> int:
        """Threads of one worker."""
        return self.threads or max(1, (os.cpu_count() or 1) // self.workers)
