"""Each task that the window starts has one share of the whole, which never goes back, and ends with
a word: what it made and where, that it was cancelled, or why it failed."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.evaluate.photo_film import PhotoFilmConfig
from gaga_core.export.cameras import CameraForm
from gaga_core.export.dataset.settings import DatasetConfig
from gaga_core.export.simulation.export import SimulationExport
from gaga_core.export.simulation.settings import SimulationConfig
from gaga_core.export.solids import MeshConfig
from gaga_core.io.splats.splat_files import SplatFormat
from gaga_core.io.video import VideoConfig
from gaga_core.pipeline.film import FilmConfig
from gaga_studio.features import camera, cleanup, dataset, export, fill, level_of_detail
from gaga_studio.features.find import association, masks
from gaga_studio.session import jobs, rates
from gaga_studio.session.notices import Level
from gaga_studio.session.session import Session
from tests.app import told
from tests.shares import falls

_FILM = FilmConfig(video=VideoConfig(64, 48, fps=2))
_DATA = dataset.DatasetPlan(DatasetConfig(views=2, width=64, height=64, fill=False), ("coco",))
Start = Callable[[Session, Path], object]


_BODIES = SimulationExport(config=SimulationConfig(parts=1), mesh=MeshConfig(voxels=24))


def _export(what: export.What, form: SplatFormat | CameraForm | SimulationExport) -> Start:
    suffix = form.suffix if isinstance(form, SplatFormat) and what != "objects" else ""
    return lambda s, to: export.start(s, export.ExportPlan(to / f"a{suffix}", what, form))


def _fill(session: Session, _: Path) -> None:
    assert session.scene is not None
    rows = np.flatnonzero(session.scene.labels == session.scene.labels.max())
    session.need().select(rows.astype(np.int32))
    fill.start(session)


_WRITE: Mapping[str, Start] = {
    "film": lambda s, to: export.export_film(s, to / "a.mp4", _FILM),
    "film of photos": lambda s, to: export.export_photo_film(
        s, to / "a.mp4", PhotoFilmConfig(video=_FILM.video), "all"
    ),
    "picture": lambda s, to: export.save_picture(s, to / "a.png", (64, 48)),
    "labelled data": lambda s, to: dataset.start(s, _DATA, to / "data"),
    "masks": lambda s, to: masks.export(s, "png", to / "masks"),
    "scene": _export("scene", SplatFormat.PLY),
    "page": _export("scene", SplatFormat.HTML),
    "objects": _export("objects", SplatFormat.PLY),
    "cameras": _export("cameras", CameraForm.COLMAP),
    "bodies": _export("simulation", _BODIES),
    "level of detail": lambda s, _: level_of_detail.build(s),
}
_CHANGE: Mapping[str, Start] = {
    "make masks": lambda s, _: masks.make(s, masks.MaskRequest(use_depth=False)),
    "find objects": lambda s, _: association.associate(s),
    "reduce": lambda s, _: cleanup.start_reducing(s, cleanup.ReducePlan(percent=50)),
}
_ALL = {**_WRITE, **_CHANGE}
_ALSO = ("film", "film of photos", "picture", "labelled data")
_TIMED = {**{name: _ALL[name] for name in _ALSO}, "fill": _fill}


@pytest.fixture
def walked(associated: Session) -> Session:
    """Keyframes for a film of a second."""
    camera.add_keyframe(associated)
    associated.rig.orbit(60, 5)
    camera.add_keyframe(associated)
    return associated


def _started(session: Session, name: str, to: Path) -> str:
    """Start it; returns its title. No notice is there."""
    session.notices = ()
    {**_ALL, **_TIMED}[name](session, to)
    job = session.jobs.running
    assert job is not None, session.notices
    return job.title


@pytest.mark.parametrize("name", _ALL)
def test_one_that_is_done_says_what_it_made_and_where(
    walked: Session, name: str, tmp_path: Path
) -> None:
    with told.by_job() as heard:
        _started(walked, name, tmp_path)
        assert walked.jobs.wait()
    assert [falls(said) for said in heard.values()] == [[]], "one share of the whole"
    assert walked.notices
    assert {n.level for n in walked.notices} <= {Level.INFO, Level.WARNING}
    if name in _WRITE:
        shown = [n.shows for n in walked.notices if n.shows is not None]
        assert shown, "a button opens its folder"
        assert shown[0].exists()
        assert shown[0].is_relative_to(tmp_path)


@pytest.mark.parametrize("name", _TIMED)
def test_one_whose_amount_is_known_tells_its_time_from_its_first_share(
    walked: Session, name: str, tmp_path: Path
) -> None:
    """Films, pictures, data sets and *Delete and fill* told none in their first 15 s."""
    with told.by_job() as heard:
        _started(walked, name, tmp_path)
        assert walked.jobs.wait()
    (said,) = heard.values()
    assert [step for step in said if step.total and step.left_s is None] == []


def test_a_film_of_photos_says_nothing_of_the_time_of_another_film(
    walked: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was told to take seven times as long as it did, and others less afterwards."""
    monkeypatch.setattr(rates, "_TELLING_S", 0.0)
    kept = list[dict[str, float]]()
    for name in ("film", "film of photos"):
        _started(walked, name, tmp_path)
        assert walked.jobs.wait()
        kept.append(dict(walked.rates.rates))
    assert kept[0].items() < kept[1].items()


@pytest.mark.parametrize("name", _ALL)
def test_one_that_is_cancelled_says_so(walked: Session, name: str, tmp_path: Path) -> None:
    title, at = _started(walked, name, tmp_path), walked.need().history.cursor
    walked.jobs.cancel()
    assert walked.jobs.wait()
    # What is written in one step is there, and told, if Cancel came in it.
    told = [n for n in walked.notices if n.shows is not None]
    hints = [n.text for n in walked.notices if n.level is Level.HINT]
    assert hints == ([] if told else [f"Cancelled: {title}."])
    assert walked.need().history.cursor == at


@pytest.mark.parametrize("name", _ALL)
@pytest.mark.parametrize("error", [GagaError("The disk is full."), ZeroDivisionError()])
def test_one_that_fails_says_why(
    walked: Session, name: str, error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_: object) -> bool:
        raise error

    monkeypatch.setattr(jobs._Delivery, "step", fails)
    title = _started(walked, name, tmp_path)
    assert walked.jobs.wait()
    (said,) = [n for n in walked.notices if n.level is Level.ERROR]
    assert said.of_task == title
    assert str(error) in said.text or "log file" in said.text
