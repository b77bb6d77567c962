"""The data sets that are known, and opening one whatever layout it lies in."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from gaga_core.errors import GagaError
from gaga_core.io.datasets import lerf_mask, mipnerf360, ovs3d, replica, scannet
from gaga_core.io.datasets.base import Dataset, DatasetScene, Layout, Protocol
from gaga_core.io.folder.scene_folder import find_model


@dataclass(frozen=True)
class KnownDataset:
    """A data set that can be read, and the layouts in which people have it."""

    title: str
    protocol: Protocol
    layouts: tuple[Layout, ...]
    scenes: tuple[str, ...] = ()  # in the order of the published tables, where known


# Semantic-NeRF's scenes, and those that DM-NeRF selects of ScanNet.
REPLICA_SCENES = (*(f"office_{k}" for k in range(5)), *(f"room_{k}" for k in range(3)))
SCANNET_SCENES = tuple(
    f"scene{n}_00" for n in ("0010", "0012", "0024", "0033", "0038", "0088", "0113", "0192")
)
DATASETS: Mapping[str, KnownDataset] = {
    "replica": KnownDataset("Replica", "instance", replica.LAYOUTS, REPLICA_SCENES),
    "scannet": KnownDataset("ScanNet", "instance", scannet.LAYOUTS, SCANNET_SCENES),
    "lerf-mask": KnownDataset(
        "LERF-Mask", "lerf-mask", lerf_mask.LAYOUTS, ("figurines", "ramen", "teatime")
    ),
    "3d-ovs": KnownDataset(
        "3D-OVS", "3d-ovs", ovs3d.LAYOUTS, ("bed", "bench", "room", "sofa", "lawn")
    ),
    "mipnerf360": KnownDataset("Mip-NeRF 360", "qualitative", mipnerf360.LAYOUTS),
}


def open_dataset(
    name: str,
    root: Path,
    scenes: Sequence[str] = (),
    *,
    models: Path | None = None,
) -> Dataset:
    """Look at the data set ``name`` in ``root``: its scenes, or ``root`` itself if it is a scene.

    ``scenes`` are folder names, default all; ``models`` holds trained splats as
    ``<scene>/point_cloud.ply`` or ``<scene>/point_cloud/iteration_*/``. A scene that cannot be
    opened, or is asked for and not there, is listed in ``failed`` with one sentence. Raises
    ``GagaError`` when ``root`` holds no scene of that data set.
    """
    kind = kind_of(name)
    if not root.is_dir():
        raise GagaError(f"{root} is not a folder. Choose the folder of the data set {kind.title}.")
    if models is not None and not models.is_dir():
        raise GagaError(f"{models} is not a folder. Choose the folder of the trained models.")
    found = _find_scenes(root, kind)
    if not found:
        wanted = ", or ".join(layout.wants for layout in kind.layouts)
        raise GagaError(f"{root} holds no scene of {kind.title}: it must have {wanted}.")
    opened: list[DatasetScene] = []
    failed = {
        scene: f"There is no scene {scene} of {kind.title} in {root}."
        for scene in scenes
        if scene not in found
    }
    for scene, (folder, layout) in found.items():
        if scenes and scene not in scenes:
            continue
        try:
            opened.append(layout.read(folder, _model_of(scene, models)))
        except GagaError as error:
            failed[scene] = str(error)
    return Dataset(name, kind.title, kind.protocol, root, tuple(opened), failed)


def kind_of(name: str) -> KnownDataset:
    """A known data set; ``GagaError`` that lists them otherwise."""
    if name not in DATASETS:
        raise GagaError(f"There is no data set {name!r}. Choose one of {', '.join(DATASETS)}.")
    return DATASETS[name]


def _find_scenes(root: Path, kind: KnownDataset) -> dict[str, tuple[Path, Layout]]:
    """Scenes by name, in the published order, then by name: ``root`` itself, or its folders, or
    theirs (archives often unpack into a folder of their own)."""
    own = _layout_of(root, kind)
    if own is not None:
        return {root.name: (root, own)}
    folders = _folders(root)
    for level in (folders, [inner for folder in folders for inner in _folders(folder)]):
        found = {}
        for folder in level:
            layout = _layout_of(folder, kind)
            if layout is not None and folder.name not in found:
                found[folder.name] = (folder, layout)
        if found:
            first = [scene for scene in kind.scenes if scene in found]
            order = first + [scene for scene in sorted(found) if scene not in first]
            return {scene: found[scene] for scene in order}
    return {}


def _folders(root: Path) -> list[Path]:
    return [p for p in sorted(root.iterdir()) if p.is_dir() and p.name[0] != "."]


def _layout_of(folder: Path, kind: KnownDataset) -> Layout | None:
    return next((layout for layout in kind.layouts if layout.fits(folder)), None)


def _model_of(scene: str, models: Path | None) -> Path | None:
    return None if models is None else find_model(models / scene)
