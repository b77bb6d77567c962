"""Masks of a slow model, and the objects that they give so far: live after each photo.

Photos that tell most come first, so the user may stop whenever the objects are good enough: what is
there is used, and a later run goes on there.
"""

import time
from contextlib import closing
from dataclasses import replace

from gaga_core.errors import GagaError
from gaga_core.grouping.associate import AssociateConfig, Association, BankSnapshot
from gaga_core.io.masks.label_maps import mask_folder
from gaga_core.pipeline.segment import SegmentReport, ViewDone
from gaga_core.progress import Progress, Stage, mapped
from gaga_core.scene.project import Project
from gaga_studio.actions import associate, identities, masks
from gaga_studio.actions.masks import MaskRequest
from gaga_studio.session import stages
from gaga_studio.session.notices import Level
from gaga_studio.session.session import Session

TITLE = "Make masks, find objects"
_LEAST_VIEWS = 2  # an object is what two photos agree on
_SHARE = 0.5  # most time for live objects, as a part of the time for the masks between them


def make(session: Session, request: MaskRequest) -> None:
    """Make masks photo by photo and show the objects so far; at the end, or when the user stops,
    they become one edit. A scene that has objects already gets masks alone."""
    document = session.need()
    if document.read.has_groups():
        masks.make(session, request)
        return
    reason = masks.no_photos(session)
    if reason:
        session.notify(Level.WARNING, reason)
        return
    found: list[Association] = []  # newest last; the worker adds, nothing is changed
    ended: list[SegmentReport] = []
    progress, end_of_live = associate.watch_bank(session)
    stage = _stage(document.project, request, _config(session), found)

    def done(report: SegmentReport) -> None:
        ended.append(report)
        masks.take_report(session, document, report)

    def end() -> None:
        end_of_live()
        if session.document is not document:
            return
        if not ended:
            masks.keep_partial(session, request.provider)
        if found:
            n = associate.take_groups(document, found[-1])
            n_views = len(found[-1].mask_groups)
            session.notify(Level.INFO, f"Found {n} objects in {n_views} photos.")
            for note in found[-1].notes:
                session.notify(Level.WARNING, note)
            identities.lift_after_finding(session, found[-1].bank.preset)

    session.jobs.start(TITLE, stage, progress, done, end)


def _config(session: Session) -> AssociateConfig:
    return session.find_options.association(session.settings.preset)


def _stage(
    project: Project, request: MaskRequest, config: AssociateConfig, found: list[Association]
) -> Stage[SegmentReport]:
    """Make the masks; append to ``found`` the objects of the photos so far."""
    folder = project.folder
    if folder is None:
        raise GagaError("A single splat file has no photos. Open its scene folder for masks.")
    views: list[str] = []
    mark, n_seen, cost = time.perf_counter(), 0, 0.0
    with closing(masks.make_stage(folder, request)) as stage:
        while True:
            try:
                step = next(stage)
            except StopIteration as end:
                report: SegmentReport = end.value
                break
            yield replace(step, payload=None)
            if not isinstance(step.payload, ViewDone):
                continue
            views.append(step.payload.view)
            is_due = _SHARE * (time.perf_counter() - mark) >= cost
            if len(views) >= _LEAST_VIEWS and is_due:
                began = time.perf_counter()
                yield from _objects(project, step, views, config, found)
                mark, n_seen = time.perf_counter(), len(views)
                cost = mark - began
    if len(views) > n_seen:
        last = Progress(TITLE, 1, 1, "", ViewDone(report.folder, views[-1]))
        yield from _objects(project, last, views, config, found)
    return report


def _objects(
    project: Project,
    step: Progress,
    views: list[str],
    config: AssociateConfig,
    found: list[Association],
) -> Stage[None]:
    """Associate the masks of ``views``; progress stays that of the masks (``step``)."""
    done, folder = step.payload, project.folder
    assert isinstance(done, ViewDone)
    assert folder is not None  # `_stage` looked
    known = [camera.name for camera in folder.cameras]
    text = f"objects in {len(views)} photos"
    stage = stages.associate_project_stage(project, mask_folder(done.folder, views, known), config)
    association = yield from mapped(stage, lambda _: replace(step, payload=None, message=text))
    found.append(association)
    snapshot = BankSnapshot(done.view, association.bank, association.bank.n_groups)
    yield replace(step, payload=snapshot, message=text)
