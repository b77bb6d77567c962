"""The command that makes a scene of photos."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from gaga_core.cli import output as out


@dataclass(frozen=True)
class ReconstructCommand:
    """Make a scene folder of a folder of photos or of a video: place the photos, train splats."""

    photos: Positional[Path]
    """Folder of photos, or a video file."""
    scene: Positional[Path]
    """Scene folder to make or to complete; what is there already is not made again."""
    quality: Literal["auto", "draft", "standard", "full"] = "auto"
    """draft: minutes on a processor. full: the published schedule. auto: full on CUDA, else draft.
    """
    iterations: int | None = None
    """Training steps; default: as the quality says."""
    max_side: int | None = None
    """Longest side of the training pictures in pixels; default: as the quality says."""
    max_splats: int | None = None
    """No more splats than this; default: as the quality says."""
    strategy: Literal["gradient", "mcmc"] = "gradient"
    """How splats are added: where the gradient is large, or by sampling (MCMC, Kheradmand 2024)."""
    antialiased: bool = False
    """Splats that also look right from nearer and farther away, in viewers with a mip mode."""
    exposure: bool = False
    """Photos differ in brightness or white balance: train that along, and leave it out."""
    focal: float | None = None
    """Focal length in pixels of the photos as they are; default: from EXIF, else estimated."""
    video_fps: float | None = None
    """Frames to take of each second of a video; default: as it moves, the sharpest ones."""
    place_minutes: float | None = None
    """Time for all attempts to place the photos; default: 20, 60 or 300 as the quality says."""
    foreground: Path | None = None
    """Folder of masks of the object, NAME.png, black = background: the background is left out."""
    turntable: bool = False
    """The object turned in front of a camera that stood still: leave the background out."""
    scene_number: Annotated[int, arg(name="scene")] = 1
    """Which scene to make, by size, when the photos show several."""
    seed: int = 0
    """Equal seeds give equal scenes."""
    threads: int = 0
    """Processor threads; 0: all."""
    only: Literal["all", "sfm"] = "all"
    """sfm: place the photos and stop before the training."""
    accept_wrong: bool = False
    """Keep a placement of the photos that the checks refuse."""
    backend: Literal["auto", "cpu", "cuda"] = "auto"
    """Who trains: auto takes CUDA where a self-test has passed (see gaga doctor)."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Write images/, sparse/0/, cameras.json, point_cloud.ply and gaga/report.json."""
        from gaga_core.pipeline.reconstruct import ReconstructConfig, reconstruct_scene
        from gaga_core.raster import choose

        engine = choose(self.backend)
        automatic: Literal["draft", "full"] = "full" if engine.name == "cuda" else "draft"
        config = ReconstructConfig(
            quality=automatic if self.quality == "auto" else self.quality,
            iterations=self.iterations,
            max_side=self.max_side,
            max_splats=self.max_splats,
            strategy=self.strategy,
            antialiased=self.antialiased,
            exposure=self.exposure,
            focal=self.focal,
            video_fps=self.video_fps,
            place_minutes=self.place_minutes,
            foreground=None if self.foreground is None else str(self.foreground.absolute()),
            turntable=self.turntable,
            scene=self.scene_number,
            seed=self.seed,
            threads=self.threads,
            only=self.only,
            accept_wrong=self.accept_wrong,
        )
        stage = reconstruct_scene(self.photos, self.scene, config, rasterizer=engine)
        made = out.follow(stage)
        for note in made.notes:
            out.say(note)
        values = {"scene": str(self.scene), "stages_run": list(made.stages_run)}
        out.result(values | _figures(made.report, as_json=self.json), as_json=self.json)
        return 0


def _figures(report: dict[str, object], *, as_json: bool) -> dict[str, object]:
    """The report as it is for a machine; the figures that matter for a person."""
    if as_json:
        return report
    shown: dict[str, object] = {}
    sfm, train = report.get("sfm"), report.get("train")
    held_out = train.get("held_out") if isinstance(train, dict) else None
    for values, keys in (
        (sfm, ("photos", "registered", "points", "reprojection", "track")),
        (train, ("splats", "iterations")),
        (held_out, ("psnr", "ssim")),
    ):
        if isinstance(values, dict):
            shown |= {key: values[key] for key in keys if values.get(key) is not None}
    return shown
