"""Labelled pictures of new views, of the open scene: what is asked for, and the job."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gaga_core.errors import GagaError
from gaga_core.export.dataset.settings import FORMS, MOST_PHOTOS, DatasetConfig, Form
from gaga_core.progress import Stage
from gaga_core.settings import setting_of
from gaga_studio.features.base import Command, ask, busy, first_of, no_groups, no_photos
from gaga_studio.features.reconstruction import KnownRates, timed
from gaga_studio.session import stages
from gaga_studio.session.notices import Level, Request, notifies
from gaga_studio.session.session import Session
from gaga_studio.system import paths

_RATE = "Labelled data"  # of the rate that is kept
# Seconds on two cores, half of the processor time of 50 pictures of the demo: a million pixels with
# their labels, the files of a picture, an object's hole, its model, the depth of a photo.
_PIXELS_S, _PICTURE_S, _HOLE_S, _MODEL_S, _PHOTO_S = 0.23, 0.12, 4.3, 0.4, 0.03
_MOVED = 2  # objects that stand elsewhere in a placement for the first time, about


@dataclass
class DatasetPlan:
    """The data set to make, as chosen so far."""

    config: DatasetConfig = field(default_factory=DatasetConfig)
    forms: tuple[Form, ...] = FORMS

    def put(self, name: str, value: float) -> None:
        """Set a field of the settings, within its limits."""
        wanted = setting_of(self.config, name).clamped(value)
        kind = type(getattr(self.config, name))
        self.config = replace(self.config, **{name: kind(wanted)})

    def switch(self, form: Form) -> None:
        """Add a format, or leave it out."""
        self.forms = tuple(one for one in FORMS if (one in self.forms) != (one == form))

    @property
    def why_not(self) -> str:
        """Reason why nothing can be made."""
        return "" if self.forms else "Choose a format."

    def usual_s(self, n_objects: int, n_photos: int) -> float:
        """About how long a new data set takes on two cores, seconds."""
        config = self.config
        n_touched = -(-config.views // config.views_each) * (_MOVED * config.moved + config.removed)
        each = _PIXELS_S * config.width * config.height / 1e6 + _PICTURE_S
        holes = _HOLE_S * min(n_touched, n_objects) if config.fill else 0.0
        models = _MODEL_S * n_objects if "bop" in self.forms else 0.0
        return each * config.views + holes + models + _PHOTO_S * min(n_photos, MOST_PHOTOS)

    def says(self) -> str:
        """What will be made, in a sentence."""
        config = self.config
        n = -(-config.views // config.views_each)
        placements = "one placement" if n == 1 else f"about {n:,} placements"
        return (
            f"{config.views:,} pictures of {placements} of the objects. In a folder that has a "
            "data set, only what is missing or stale is made."
        )


def seconds_of(session: Session, plan: DatasetPlan) -> float:
    """About how long a new data set takes, as the last one here did."""
    return session.feature(KnownRates).rates.get(_RATE, 1.0) * _usual_s(session, plan)


def _usual_s(session: Session, plan: DatasetPlan) -> float:
    n_objects = int(np.count_nonzero(session.objects().ids > 0))
    return plan.usual_s(n_objects, len(session.need().project.training_views))


@notifies
def start(session: Session, plan: DatasetPlan, out: Path) -> bool:
    """Make or complete the data set in ``out``, as a job."""
    project = session.need().settled()
    frozen = replace(project, scene=replace(project.scene))
    config, forms = plan.config, plan.forms
    usual, is_whole = _usual_s(session, plan), list[bool]()
    if not forms:
        raise GagaError(plan.why_not)

    def stage() -> Stage[str]:
        # It draws: numba is a good part of the launch time.
        from gaga_core.pipeline.dataset import dataset_stage

        made = yield from dataset_stage([frozen], out, config, forms)
        is_whole.append(made.kept == 0)
        text = f"{made.pictures:,} labelled pictures in {paths.shown(out)}: {made.made:,} new."
        return " ".join([text, *made.notes])

    def measured() -> Stage[str]:
        return timed(session, stage(), _RATE, lambda _: usual if all(is_whole) else None)

    def end() -> None:
        n = 0 if is_whole else sum(1 for _ in out.glob("images/*/*.jpg"))
        if n:
            text = f"{n:,} pictures stay in {paths.shown(out)}. Choose it again to go on with them."
            session.notify(Level.INFO, text, shows=out)

    return session.jobs.start(
        f"Make data in {out.name}",
        stages.prepared("Make pictures", measured, parts=("window", "export")),
        on_done=lambda text: session.notify(Level.INFO, text, shows=out),
        on_end=end,
        waits=True,
    )


COMMANDS: tuple[Command, ...] = (
    ask(
        "file.dataset",
        "Make labelled data…",
        Request.DATASET,
        enabled=first_of(no_groups, no_photos, busy),
    ),
)
