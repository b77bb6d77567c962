"""The command that runs a published benchmark over a data set."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional

from gaga_core.cli import output as out
from gaga_core.cli.output import AsJson, Backend, Groups, Identities, options
from gaga_core.errors import GagaError
from gaga_core.evaluate.settings import BenchmarkConfig, FindConfig
from gaga_core.pipeline.settings import ReconstructConfig

_OF_RUNS = ("preset", "lift", "masks", "seed", "pred", "redo")


@dataclass(frozen=True)
class BenchmarkCommand:
    """Run the method over every scene of a data set and print the paper's table with ours."""

    dataset: Positional[Literal["replica", "scannet", "lerf-mask", "3d-ovs", "mipnerf360"]]
    """Which data set (mipnerf360: any scenes with a COLMAP model; scored where gt/instance holds
    true maps, else shown by a film and a contact sheet)."""
    folder: Positional[Path]
    """Its folder, with one folder a scene."""
    config: Annotated[BenchmarkConfig, options(BenchmarkConfig, *_OF_RUNS)]
    groups: Groups
    identities: Identities
    train: Annotated[
        ReconstructConfig,
        options(ReconstructConfig, "quality", "iterations", quality="standard"),
    ]
    scenes: tuple[str, ...] = ()
    """Names of scenes; default: all."""
    models: Path | None = None
    """Folder of the trained models, as <scene>/point_cloud/...; default: in the scenes. Where there
    is none, splats are trained on the training views alone."""
    detector: str | None = None
    """For text prompts: folder or name of a Grounding DINO or OWLv2 model (see gaga query)."""
    box_masks: str | None = None
    """With --detector: folder or name of a Segment Anything model. Then prompts are answered by the
    published rule: masks in the boxes, groups with more than 0.7 inside, probability over 0.2."""
    index_with: str | None = None
    """For text prompts, without a detector: folder or name of a CLIP or SigLIP model; without
    either, words for colors, sizes and places alone are understood."""
    sparse: str = ""
    """Percentages of the train views to run as well, such as 30,20,10,5."""
    retrain_sparse: bool = False
    """Train splats on each of those choices of views; default: use those of all training views."""
    out: Path | None = None
    """Folder of the results, one JSON a scene; default: gaga-benchmark in the data set's folder."""
    backend: Backend = "auto"
    json: AsJson = False

    def run(self) -> int:
        """Print the tables; exit status 1 when a scene has no result."""
        from gaga_core.evaluate.benchmark.run import run_benchmark
        from gaga_core.io.datasets import open_dataset
        from gaga_core.query.embed import KNOWN_DETECTORS, KNOWN_EMBEDDERS, folder_of
        from gaga_core.raster import choose

        pred, detector, index = self.config.pred, self.detector, self.index_with
        if pred is not None and not pred.is_dir():
            raise GagaError(f"{pred} is not a folder. Choose a folder of predictions.")
        config = replace(
            self.config,
            shares=_shares(self.sparse),
            find=FindConfig(
                detector=None if detector is None else folder_of(detector, KNOWN_DETECTORS),
                embedder=None if index is None else folder_of(index, KNOWN_EMBEDDERS),
                segmenter=self.box_masks,
            ),
            train=self.train,
            retrain_sparse=self.retrain_sparse,
            groups=self.groups,
            identities=self.identities,
        )
        with out.possible():
            self.groups.config(config.preset)
            self.identities.config(config.preset, "paper")
        dataset = open_dataset(self.dataset, self.folder, self.scenes, models=self.models)
        target = self.out or self.folder / "gaga-benchmark"
        engine = None if pred is not None else choose(self.backend)
        stage = run_benchmark(dataset, target, config, rasterizer=engine)
        report = out.follow(stage, compiles=pred is None)
        for sentence in report.sentences():
            out.say(sentence)
        if self.json:
            out.result(report.to_json(), as_json=True)
        for table in () if self.json else report.tables():
            out.table(table.table())
            for note in table.notes:
                out.line(f"  {note}")
        return 1 if report.failed else 0


def _shares(text: str) -> tuple[float, ...]:
    """Shares of a list of percentages."""
    try:
        return tuple(float(word) / 100 for word in text.split(",") if word.strip())
    except ValueError as error:
        raise GagaError(
            f"--sparse takes percentages such as 30,20,10,5; it got {text!r}."
        ) from error
