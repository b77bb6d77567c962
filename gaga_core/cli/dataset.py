"""The command that makes labelled data of scenes."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional

from gaga_core.cli import output as out
from gaga_core.cli.output import AsJson, Backend, options
from gaga_core.errors import GagaError
from gaga_core.export.dataset.settings import DatasetConfig, forms_of
from gaga_core.pipeline.settings import EngineConfig


@dataclass(frozen=True)
class DatasetCommand:
    """Make labelled pictures of new views: masks, boxes, poses and depth of every object."""

    scenes: Positional[tuple[Path, ...]]
    """Scene folders or saved projects; what they show now is labelled."""
    config: Annotated[DatasetConfig, options(DatasetConfig)]
    engine: Annotated[EngineConfig, options(EngineConfig, "workers", "address")]
    out: Path | None = None
    """Folder of the data set; one that is there is completed: only stale pictures are made again.
    Default: next to the first scene, as NAME-dataset."""
    to: str = "coco,yolo,bop"
    """Formats of the labels, with commas between: coco, yolo, bop."""
    executor: Literal["none", "local", "dask"] = "none"
    """Who makes the pictures of many scenes: processes here, or workers of dask."""
    backend: Backend = "auto"
    json: AsJson = False

    def run(self) -> int:
        """Write pictures, labels, and index.html with samples and statistics."""
        from gaga_core.pipeline.dataset import dataset_stage
        from gaga_core.raster import choose

        forms = forms_of(self.to)
        if not self.scenes:
            raise GagaError("Name a scene folder, or several.")
        first = self.scenes[0].absolute()
        target = self.out or first.with_name(f"{first.stem}-dataset")
        workers = None if self.executor == "none" else replace(self.engine, engine=self.executor)
        engine = choose(self.backend)
        stage = dataset_stage(self.scenes, target, self.config, forms, workers, rasterizer=engine)
        made = out.follow(stage, compiles=True)
        for note in (*made.notes, *made.failed):
            out.say(note)
        values = made.to_json()
        if not self.json:
            values |= {f"pictures for {split}": n for split, n in made.by_split.items()}
            values = {key: value for key, value in values.items() if value and key != "by_split"}
            values = {key: values[key] for key in values if key not in ("notes", "failed")}
        out.result(values, as_json=self.json)
        return 1 if made.failed else 0
