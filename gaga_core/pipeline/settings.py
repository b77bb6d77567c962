"""Settings of a reconstruction, as the command and the window give them."""

from dataclasses import dataclass, replace
from typing import Literal

from gaga_core.errors import GagaError
from gaga_core.placing.ladder import LadderConfig
from gaga_core.placing.sfm import SfmConfig
from gaga_core.training.settings import TrainConfig

QUALITIES = ("draft", "standard", "full")
_PLACE_MINUTES = {"draft": 20.0, "standard": 60.0, "full": 300.0}


@dataclass(frozen=True)
class ReconstructConfig:
    """Settings of a reconstruction; None = what the quality says."""

    quality: Literal["draft", "standard", "full"] = "draft"
    iterations: int | None = None  # of the training
    max_side: int | None = None  # pixels, longest side of the training pictures
    max_splats: int | None = None  # no more than this
    strategy: Literal["gradient", "mcmc"] = "gradient"  # Kerbl 2023 or Kheradmand 2024
    antialiased: bool = False  # right at other sizes of picture too (Yu 2024, Mip-Splatting)
    exposure: bool = False  # brightness and white balance of each photo are trained along
    focal: float | None = None  # pixels of the photos as they are; None = EXIF, else estimated
    video_fps: float | None = None  # frames taken of each second; None = as the film moves
    place_minutes: float | None = None  # for all attempts to place the photos; None = by quality
    foreground: str | None = None  # folder of masks of the object; the background is left out
    turntable: bool = False  # the object turned in front of a camera that stood still
    scene: int = 1  # which one, by size, when the photos show several
    seed: int = 0
    threads: int = 0  # 0 = all
    only: Literal["all", "sfm"] = "all"
    accept_wrong: bool = False  # keep a model that the checks refuse
    hold_out: bool = True  # keep the test views out of the training, to measure on

    def __post_init__(self) -> None:
        if self.quality not in QUALITIES:
            raise ValueError(f"quality: {self.quality!r} is none of {QUALITIES}")
        if self.focal is not None and self.focal <= 0:
            raise GagaError("--focal is a length in pixels: it must be greater than 0.")
        if self.video_fps is not None and self.video_fps <= 0:
            raise GagaError("--video-fps must be greater than 0.")
        if self.place_minutes is not None and self.place_minutes <= 0:
            raise GagaError("--place-minutes must be greater than 0.")
        if self.scene < 1:
            raise GagaError("--scene counts from 1, the scene with the most photos.")
        if self.iterations is not None and self.iterations < 1:
            raise GagaError("--iterations must be at least 1.")
        if self.max_side is not None and self.max_side < 64:
            raise GagaError("--max-side must be at least 64 pixels.")
        if self.max_splats is not None and self.max_splats < 1000:
            raise GagaError("--max-splats must be at least 1,000.")

    @property
    def object_only(self) -> bool:
        """Whether the background is left out."""
        return self.turntable or self.foreground is not None

    def sfm(self) -> SfmConfig:
        """Settings of structure from motion."""
        config = SfmConfig.of(self.quality, threads=self.threads, seed=self.seed)
        return replace(config, moving_only=self.turntable)

    def ladder(self) -> LadderConfig:
        """How long the photos may be tried to be placed."""
        minutes = self.place_minutes or _PLACE_MINUTES[self.quality]
        return LadderConfig(minutes=minutes)

    def train(self) -> TrainConfig:
        """Settings of the training."""
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
