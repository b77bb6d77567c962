"""Labelled pictures of new views, of the open scene: what is asked for, and the job."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gaga_core.errors import GagaError, counted
from gaga_core.export.dataset.settings import FORMS, DatasetConfig, Form, planned
from gaga_core.progress import Progress, Stage
from gaga_core.settings import setting_of
from gaga_studio.features.base import Command, ask, busy, first_of, no_groups, no_photos
from gaga_studio.session import stages
from gaga_studio.session.notices import Level, Request, notifies
from gaga_studio.session.session import Session
from gaga_studio.system import paths

_MAKES = "Make pictures"


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

    def says(self) -> str:
        """What will be made, in a sentence."""
        config, (n, n_kept) = self.config, planned(self.config)
        placements = "one placement" if n == 1 else f"up to {n:,} placements"
        kept = f"up to {counted(n_kept, 'picture')}, {100 * n_kept / config.views:.0f} %"
        return (
            f"{counted(config.views, 'picture')} of {placements} of the objects; for validation "
            f"{kept if n_kept else 'none'}. Fewer where objects cannot stand elsewhere. In a "
            "folder that has a data set, only what is missing or stale is made."
        )


@notifies
def start(session: Session, plan: DatasetPlan, out: Path) -> bool:
    """Make or complete the data set in ``out``, as a job."""
    project = session.need().settled()
    frozen = replace(project, scene=replace(project.scene))
    config, forms = plan.config, plan.forms
    is_done = list[bool]()
    if not forms:
        raise GagaError(plan.why_not)

    def stage() -> Stage[str]:
        yield Progress(_MAKES, 0, 0, "Preparing")
        # They draw: numba is a good part of the launch time.
        from gaga_core.export.dataset.formats import DATASET_FILE
        from gaga_core.pipeline.dataset import dataset_stage, usual_seconds

        scene = frozen.scene
        n_objects = int(np.count_nonzero(np.unique(scene.labels[scene.visible])))
        usual_s = usual_seconds(config, forms, int(scene.visible.sum()), n_objects)
        made = yield from stages.prepared(
            session.rates,
            _MAKES,
            lambda: dataset_stage([frozen], out, config, forms),
            parts=("window", "export"),
            # Of one that is completed nobody knows yet what is missing.
            usual_s=None if (out / DATASET_FILE).is_file() else usual_s,
        )
        is_done.append(True)
        pictures = counted(made.pictures, "labelled picture")
        text = f"{pictures} in {out.name}, {made.made:,} of them new."
        return " ".join([text, *made.notes])

    def end() -> None:
        n = 0 if is_done else sum(1 for _ in out.glob("images/*/*.jpg"))
        if n:
            stay = f"{counted(n, 'picture')} {'stays' if n == 1 else 'stay'} in {paths.shown(out)}."
            text = f"{stay} Choose it again to go on."
            session.notify(Level.INFO, text, shows=out)

    return session.jobs.start(
        f"Make data in {out.name}",
        stage(),
        on_done=lambda text: session.notify(Level.INFO, text, shows=out),
        on_end=end,
        waits=True,
        resumes=True,
    )


COMMANDS: tuple[Command, ...] = (
    ask(
        "file.dataset",
        "Make labelled data…",
        Request.DATASET,
        enabled=first_of(no_groups, no_photos, busy),
    ),
)
