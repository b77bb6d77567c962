"""Settings of the training of Gaussians: every number with its unit and where it comes from.

Moments of the schedule are shares of all iterations, so that a shorter run is the same run in
small. "Kerbl" is 3D Gaussian Splatting (Kerbl 2023), "MCMC" is Kheradmand 2024,
"Park" is DropGaussian (Park 2025).
"""

from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Literal

QUALITIES = ("draft", "standard", "full")
STRATEGIES = ("gradient", "mcmc")
DISSIMILARITY = 0.2  # share of 1 - SSIM in the loss (Kerbl, equation 7)
_FEW_PHOTOS = 25
_DEPTH_END = 0.05  # share of the weight of measured depth at the end
STEREO_VIEWS = 20  # whose surfaces are matched, evenly among all: more bring more of the same
STEREO_SIDE = 160  # pixels of the longest side of the pictures in which they are matched


@dataclass(frozen=True)
class RateConfig:
    """Learning rates of Adam for one step."""

    means: float = 1.6e-4  # x extent of the cameras, at the start (Kerbl)
    means_end: float = 0.01  # share of it at the end, falling exponentially (Kerbl)
    quats: float = 1e-3  # of a unit quaternion (Kerbl)
    log_scales: float = 5e-3  # (Kerbl)
    logit_opacities: float = 5e-2  # (Kerbl)
    sh: float = 2.5e-3  # degree 0 (Kerbl)
    sh_rest: float = 0.05  # share of `sh` for degrees 1 to 3 (Kerbl)
    end: float = 1.0  # share of all rates but that of `means` at the end; 1 = constant (Kerbl)
    end_from: float = 0.6  # moment when they begin to fall, exponentially

    def __post_init__(self) -> None:
        if min(asdict(self).values()) <= 0:
            raise ValueError("rates: all must be greater than 0")


@dataclass(frozen=True)
class DensityConfig:
    """How splats are added where the picture lacks detail, and removed where they do nothing."""

    strategy: Literal["gradient", "mcmc"] = "gradient"
    max_splats: int = 1_000_000  # no more than this
    every: int = 100  # iterations from one control to the next (Kerbl, MCMC)
    start: float = 0.0167  # moment of the first control: 500 of 30,000 (Kerbl, MCMC)
    stop: float = 0.5  # moment of the last: 15,000 of 30,000 (Kerbl)
    full_at: float = 0.0  # moment when `max_splats` is to be reached; 0 = as the threshold says
    threshold: float = 2e-4  # mean screen gradient, per half picture, to clone or split (Kerbl)
    split_size: float = 0.01  # x extent: larger splats are split, others cloned (Kerbl)
    least_opacity: float = 0.005  # splats under it are removed or moved (Kerbl, MCMC)
    largest_size: float = 0.1  # x extent: larger splats are removed (Kerbl); 0 = never
    reset_every: float = 0.1  # moments between opacity resets: 3,000 of 30,000 (Kerbl); 0 = never
    reset_opacity: float = 0.01  # opacities are cut to this (Kerbl)
    growth: float = 0.05  # share of new splats at each control (MCMC)
    noise: float = 5e5  # x rate of `means` x covariance: random walk of faint splats (MCMC)

    def __post_init__(self) -> None:
        if self.strategy not in STRATEGIES:
            raise ValueError(f"strategy: {self.strategy!r} is none of {STRATEGIES}")
        if self.max_splats < 1 or self.every < 1:
            raise ValueError("max_splats and every: at least 1")
        if not 0 <= self.start <= self.stop <= 1:
            raise ValueError("start and stop: moments in 0..1, in this order")


@dataclass(frozen=True)
class TrainConfig:
    """Settings of `train.train_stage`; the defaults are the schedule of Kerbl 2023."""

    quality: Literal["draft", "standard", "full"] = "full"  # where the others come from
    iterations: int = 30_000  # steps; in each, every worker draws a view (Kerbl)
    longest_side: int = 1600  # pixels of a training picture (Kerbl)
    # (moment, share): until then pictures have that share of the size, in this order
    smaller: tuple[tuple[float, float], ...] = ()
    sh_degree: int = 3  # of view-dependent color (Kerbl)
    sh_every: float = 1 / 30  # moments from one degree to the next: 1,000 of 30,000 (Kerbl)
    dissimilarity: float = DISSIMILARITY
    depth: float = 0.4  # weight of the relative error of measured depth; see `depth_at`
    initial_opacity: float = 0.1  # (Kerbl)
    initial_scale: float = 1.0  # x distance to the three nearest points (Kerbl)
    stereo: int = 0  # fewer points are brought up to so many by matching surfaces between photos
    cover: int = 10_000  # at most so many splats are put where views show no point
    shell: int = 0  # splats of a sphere behind everything, if it were whole; see `shell_of`
    opacity_decay: float = 0.0  # weight of mean opacity in the loss: 0.01 (MCMC)
    scale_decay: float = 0.0  # weight of mean standard deviation over extent: 0.01 (MCMC)
    dropout: float = 0.0  # share of splats left out of a step, see `dropout_at`: 0.2 (Park)
    keep_best: bool = True  # of few photos: once held-out views get worse, earlier splats are kept
    antialiased: bool = False  # drawn in the mip mode, for other sizes of picture too (Yu 2024)
    exposure: bool = False  # a gain and an offset per photo and channel are trained along
    exposure_rate: float = 1e-2  # learning rate of these at the start, falling to a hundredth
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)  # color behind all splats, 0..1
    seed: int = 0  # of view order, splitting and noise
    measure_every: float = 0.1  # moments between measurements on held-out views
    snapshot_seconds: float = 2.0  # from one copy of the splats for observers to the next
    checkpoint_seconds: float = 60.0  # from one checkpoint to the next, or more; 0 = each iteration
    rates: RateConfig = field(default_factory=RateConfig)
    density: DensityConfig = field(default_factory=DensityConfig)

    def __post_init__(self) -> None:
        if self.quality not in QUALITIES:
            raise ValueError(f"quality: {self.quality!r} is none of {QUALITIES}")
        if self.iterations < 1:
            raise ValueError("iterations: at least 1")
        if self.longest_side < 16:
            raise ValueError("longest_side: at least 16 pixels")
        if any(not 0 < share < 1 for _, share in self.smaller):
            raise ValueError("smaller: shares of the size between 0 and 1")
        if not 0 <= self.sh_degree <= 3:
            raise ValueError("sh_degree: 0 to 3")
        if not 0 <= self.dropout < 1:
            raise ValueError("dropout: at least 0, less than 1")
        if not 0 < self.initial_opacity < 1:
            raise ValueError("initial_opacity: must be between 0 and 1")

    @staticmethod
    def of(quality: str) -> "TrainConfig":
        """The settings called ``quality``.

        "draft" is done in minutes on two processors, "standard" in an hour, "full" is the schedule
        of the publication: for a graphics card, or a night. The first two learn faster and with no
        opacity reset, from which a short schedule has no time to recover; their numbers were found
        by trials on real scenes.
        """
        if quality == "full":
            return TrainConfig()
        if quality == "standard":
            return TrainConfig(
                quality="standard",
                iterations=10_000,
                longest_side=960,
                smaller=((0.25, 0.5),),
                sh_every=0.1,
                stereo=40_000,
                shell=2000,
                dropout=0.2,
                rates=_quick(RateConfig(means=4e-4, log_scales=8e-3, sh=5e-3)),
                density=_quick_density(250_000),
            )
        if quality == "draft":
            return TrainConfig(
                quality="draft",
                iterations=2000,
                longest_side=640,
                smaller=((0.15, 0.25), (0.45, 0.5), (0.7, 0.71)),  # 0.51 of all pixels
                sh_every=0.15,
                initial_opacity=0.5,
                stereo=20_000,
                shell=2000,
                dropout=0.2,
                rates=replace(
                    _quick(RateConfig(means=1.6e-3, log_scales=0.02, sh=0.02)),
                    end=0.05,
                    end_from=0.8,
                ),
                density=replace(_quick_density(80_000), every=50),
            )
        raise ValueError(f"quality: {quality!r} is none of {QUALITIES}")

    def at(self, moment: float) -> int:
        """Iteration at a share of the schedule."""
        return round(moment * self.iterations)

    def size_at(self, moment: float) -> float:
        """Share of `longest_side` that pictures have at a moment."""
        return next((share for until, share in self.smaller if moment <= until), 1.0)

    def pixels_until(self, moment: float) -> float:
        """Pixels drawn in all steps until a moment, as a share of those of all steps at full
        size."""
        drawn, before = 0.0, 0.0
        for until, share in (*self.smaller, (1.0, 1.0)):
            drawn += max(0.0, min(moment, until) - before) * share**2
            before = max(before, until)
        return drawn

    def degree_at(self, moment: float) -> int:
        """SH degree that is trained at a moment: one more every `sh_every`."""
        return min(self.sh_degree, int(moment / self.sh_every + 1e-9))

    def dropout_at(self, moment: float, n_views: int) -> float:
        """Share of the splats that is left out of the step at a moment: 0 at first, `dropout` at
        the end; less with more than 25 photos and nothing from 50 on, where it costs detail."""
        return self.dropout * moment * fewness(n_views)

    def depth_at(self, moment: float) -> float:
        """Weight of measured depth at a moment: it places surfaces early, and photos, which are
        sharper, decide at the end (Kerbl 2024 lets it fall likewise)."""
        return self.depth * _DEPTH_END**moment

    def shell_of(self, n_views: int) -> int:
        """Splats of the far shell, if it were whole: none from 50 photos on, which leave hardly a
        gap to look through, and for which plain walls would end on the shell."""
        return self.shell if fewness(n_views) > 0 else 0

    def keeps_best(self, n_views: int) -> bool:
        """Whether the result may be an earlier measurement, where later ones are worse by more than
        noise: with fewer than 50 photos, to which a training can overfit."""
        return self.keep_best and fewness(n_views) > 0

    def choosing(self, n_views: int) -> int:
        """One held-out view in so many chooses the splats that are kept, the first one at least,
        and the others tell how good they are; 0 = none chooses."""
        return 2 if self.keeps_best(n_views) else 0

    def cpu_seconds(self, n_pixels: int) -> float:
        """Rough time of all processors together for photos of ``n_pixels`` at training size.

        Measured on one core of a server of the 2020s: 0.21 microseconds a pixel and 0.67 a splat in
        an iteration. Of the processor time of 1,464 steps of sceaux, both are 0.75 with an error of
        7 % in steps of all sizes and numbers of splats, and there is no fixed cost of a step.
        """
        return self._cpu_seconds_until(n_pixels, 1.0)

    def spent(self, n_pixels: int, share: float) -> float:
        """Share 0..1 of the training's time that a ``share`` of its iterations takes; early ones
        are cheaper."""
        until = partial(self._cpu_seconds_until, n_pixels)
        return until(min(max(share, 0.0), 1.0)) / until(1.0)

    def _cpu_seconds_until(self, n_pixels: int, moment: float) -> float:
        """Splats grow evenly between the first control and the moment when they are all there, from
        the `stereo` points that they begin with."""
        density = self.density
        first = min(self.stereo / density.max_splats, 1.0)
        full = density.full_at or density.stop
        span = max(full - density.start, 1e-9)
        growing = min(max(moment - density.start, 0.0), span)
        grown = growing**2 / (2 * span) + max(moment - density.start - span, 0.0)
        splats = density.max_splats * (first * moment + (1 - first) * grown)
        pixels = n_pixels * self.pixels_until(moment)
        return self.iterations * (0.21e-6 * pixels + 0.67e-6 * splats)

    def with_mcmc(self) -> "TrainConfig":
        """These settings with the strategy of Kheradmand 2024 and its regularisers."""
        stop = max(self.density.stop, 25 / 30)
        density = replace(self.density, strategy="mcmc", stop=stop)
        return replace(self, opacity_decay=0.01, scale_decay=0.01, density=density)

    def with_cap(self, max_splats: int) -> "TrainConfig":
        """These settings with another greatest number of splats."""
        return replace(self, density=replace(self.density, max_splats=max_splats))


def fewness(n_views: int) -> float:
    """1 for up to 25 photos, falling to 0 at 50: how much a training needs that generalises."""
    return min(1.0, max(0.0, 2 - n_views / _FEW_PHOTOS))


def _quick(rates: RateConfig) -> RateConfig:
    return replace(rates, quats=2e-3, end=0.2, end_from=0.6)


def _quick_density(max_splats: int) -> DensityConfig:
    """Growth to the cap by 60 % of the schedule, so that the rest can settle."""
    return DensityConfig(
        max_splats=max_splats,
        start=0.1,
        stop=0.7,
        full_at=0.6,
        largest_size=0.0,
        reset_every=0.0,
    )
