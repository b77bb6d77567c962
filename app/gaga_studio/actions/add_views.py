"""Let photos and masks that came later join the objects that there are, as one edit."""

from gaga_core.grouping.associate import AssociateConfig, Association
from gaga_core.io.folder.scene_folder import select_views
from gaga_core.masks import MaskSet
from gaga_core.raster import choose
from gaga_core.scene import edits
from gaga_studio.actions import associate, association_repair, identities
from gaga_studio.session import stages
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.session import Session

_NO_OBJECTS = "There are no objects that more photos could improve. Use Find objects first."
_LEVELS = (
    "These objects have levels of detail, which are made of all photos at once. Use Find objects."
)
_IDENTITIES = "The objects come from identities now. Choose Labels by votes first."


def new_views(session: Session) -> tuple[str, ...]:
    """Return the names of views with masks that took no part in the objects."""
    document = session.document
    if document is None or document.project.folder is None or document.scene.bank is None:
        return ()
    folder, bank, masks = document.project.folder, document.scene.bank, _masks(session)

    def find() -> tuple[str, ...]:
        known = {decision.view for decision in bank.log}
        return tuple(name for name in folder.train if name in masks and name not in known)

    return document.read.once("new views", (bank, masks, folder.train), find)


def without_masks(session: Session) -> int:
    """Return how many photos have no masks yet."""
    folder = session.project.folder if session.project is not None else None
    if folder is None:
        return 0
    masks = _masks(session)
    return sum(name in folder.image_paths and name not in masks for name in folder.train)


def why_not(session: Session) -> str:
    """Return why nothing can be added, "" when something can."""
    scene = session.scene
    if scene is None or scene.bank is None:
        return _NO_OBJECTS
    if scene.bank.levels is not None or session.masks.are_regions:
        return _LEVELS
    if scene.identities.source == "identities":
        return _IDENTITIES
    if new_views(session):
        return ""
    return f"All photos that have masks took part already. {bare_text(session)}".rstrip()


def bare_text(session: Session) -> str:
    """Return a sentence on photos without masks, "" when there are none."""
    n = without_masks(session)
    have = "1 photo has" if n == 1 else f"{n:,} photos have"
    return f"{have} no masks yet: use Make masks." if n else ""


def consequences(session: Session) -> tuple[str, ...]:
    """Return sentences on what happens to what a person did, before it is done."""
    scene = session.need().scene
    said = [
        "Names, colors, folders and what lies under what stay; so do merged and split objects, "
        "and masks that you moved."
    ]
    if scene.bank is not None and scene.bank.preset == "paper":
        said.append(
            "Splats that you put elsewhere by hand can follow the new masks: the preset Paper does "
            "not tell them apart from others."
        )
    else:
        said.append("Splats that you put elsewhere by hand stay there.")
    if scene.identities.colors is not None:
        said.append("Identities know only the former photos, so they are removed: lift them again.")
    return tuple(said)


@notifies
def start(session: Session) -> bool:
    """Associate the new views, as a job; False when another job runs."""
    # Numba and SciPy: imported when first needed, they take a part of the launch time.
    from gaga_core.grouping.add_views import EditedGroups, add_to_edited_stage

    document = session.need()
    folder, scene = document.project.folder, document.settled().scene
    if folder is None or scene.bank is None:
        return False
    session.masks = masks = _masks(session)
    labels, confidence = association_repair.file_columns(scene)
    edited = EditedGroups(scene.bank, labels, confidence, edits.free_group(scene))
    cameras, gaussians = select_views(folder, "train"), stages.file_gaussians(scene)
    config, n_new = AssociateConfig.of(scene.bank.preset), len(new_views(session))
    is_same = association_repair.watch(session, document)
    progress, end = associate.watch_bank(session)
    n_before = len(set(scene.labels.tolist()) - {0})

    def done(found: Association) -> None:
        if not is_same():
            return
        now = document.settled().scene
        after = association_repair.repaired_labels(now, labels, found.labels)
        title = f"Add the masks of {n_new} photos"
        document.do(
            edits.set_grouping(
                now, after, found.bank, now.names, title, found.confidence, now.folders
            )
        )
        n = len(set(document.scene.labels.tolist()) - {0}) - n_before
        opened = f"{n} new objects" if n > 1 else "one new object" if n == 1 else "no new object"
        session.notify(Level.INFO, f"The masks of {n_new} photos joined the objects: {opened}.")
        identities.lift_after_finding(session, config.preset)

    stage = stages.prepared(
        "Add views",
        lambda: add_to_edited_stage(gaussians, cameras, masks, edited, choose(), config),
        "Preparing (the first run takes a little longer)",
    )
    return session.jobs.start("Add photos and masks", stage, progress, done, end)


def _masks(session: Session) -> MaskSet:
    """The masks in use as they are on the disk now: files may have come since they were listed."""
    document = session.need()
    folder = document.project.folder
    path = folder.mask_folders.get(session.provider) if folder is not None else None
    if path is None or not path.is_dir():
        return session.masks
    key = (session.provider, path.stat().st_mtime_ns, session.masks)
    return document.read.once(
        "masks on disk", key, lambda: stages.masks_of(document.project, session.provider)[1]
    )
