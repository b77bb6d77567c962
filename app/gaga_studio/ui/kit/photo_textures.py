"""Textures of photos and masks, asked for by what they show."""

from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.arrays import IntArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import mask_images, theme

Texture = tuple[int, int, int] | None  # OpenGL name, width, height; None while it loads


def photo(session: Session, view: str, side: int = mask_images.THUMBNAIL) -> Texture:
    """The photo of a view; None while it loads and when there is none."""
    path = _photo_path(session, view)
    if path is None:
        return None
    return _texture(session, f"photo {path} {side}", partial(mask_images.photo, path, side))


def photo_with_masks(
    session: Session, view: str, bank: MemoryBank | None, side: int = mask_images.THUMBNAIL
) -> Texture:
    """The photo with its masks in the colors of their groups."""
    path, load = _photo_path(session, view), session.masks.loaders.get(view)
    if path is None or load is None:
        return photo(session, view, side)
    groups = groups_of_view(bank, view)
    own = _own_colors(session)
    key = f"masks {path} {session.provider} {side} {_mark(groups)} {sorted(own.items())}"
    paint = partial(mask_images.photo_with_masks, path, load, groups, side, own)
    return _texture(session, key, paint)


def photo_and_mask(
    session: Session, document: Document, decision: Decision
) -> tuple[Texture, Texture]:
    """The photo with one mask outlined, and the label map with that mask bright."""
    view, mask = decision.view, decision.mask
    path, load = _photo_path(session, view), session.masks.loaders.get(view)
    if load is None:
        return photo(session, view, mask_images.LARGE), None
    side = mask_images.LARGE
    bank = document.scene.bank if session.live is None else session.live.bank
    groups = groups_of_view(bank, view)
    own = _own_colors(session)
    key = f"{session.masks.source} {view} {mask} {_mark(groups)} {sorted(own.items())}"
    right = _texture(
        session,
        f"mask {key}",
        partial(mask_images.masks_with_highlight, load, groups, mask, side, own),
    )
    if path is None:
        return None, right
    left = partial(mask_images.photo_with_outline, path, load, mask, side)
    return _texture(session, f"outline {key}", left), right


def mask_at(session: Session, view: str, u: float, v: float) -> int:
    """Id of the mask at a place of a view, 0..1 from the upper left; 0 = none."""
    load = session.masks.loaders.get(view)
    if load is None:
        return 0
    try:
        labels = load()
    except GagaError as error:
        session.notify(Level.ERROR, str(error))
        return 0
    rows, columns = labels.shape
    row, column = min(max(int(v * rows), 0), rows - 1), min(max(int(u * columns), 0), columns - 1)
    return int(labels[row, column])


def place(texture: Texture, width: float, aspect: float) -> None:
    """Show a texture ``width`` wide, or its empty frame while it loads."""
    size = ImVec2(width, width / aspect)
    if texture is None:
        corner = imgui.get_cursor_screen_pos()
        imgui.dummy(size)
        high = ImVec2(corner.x + size.x, corner.y + size.y)
        imgui.get_window_draw_list().add_rect_filled(corner, high, theme.u32(theme.RAISED))
        return
    imgui.image(imgui.ImTextureRef(texture[0]), size)


def aspect(session: Session, view: str) -> float:
    """Width over height of a view's photo."""
    for camera in session.cameras:
        if camera.name == view:
            return camera.width / camera.height
    return 4 / 3


def groups_of_view(bank: MemoryBank | None, view: str) -> IntArray | None:
    """Group of each mask id of a view (M + 1,); None when nothing is known of it."""
    return _groups_by_view(bank).get(view) if bank is not None else None


@lru_cache(maxsize=2)
def _groups_by_view(bank: MemoryBank) -> dict[str, IntArray]:
    by_view: dict[str, dict[int, int]] = {}
    for decision in bank.log:
        by_view.setdefault(decision.view, {})[decision.mask] = decision.group
    result = {}
    for view, groups in by_view.items():
        table = np.zeros(max(groups) + 1, np.int32)
        table[list(groups)] = list(groups.values())
        result[view] = table
    return result


def _own_colors(session: Session) -> mask_images.Colors:
    """Colors of groups that a person chose."""
    return session.scene.colors if session.scene is not None else {}


def _photo_path(session: Session, view: str) -> Path | None:
    folder = session.project.folder if session.project is not None else None
    return folder.image_paths.get(view) if folder is not None else None


def _texture(session: Session, key: str, load: Callable[[], UInt8Array]) -> Texture:
    return session.images.texture(key, load) if session.images is not None else None


def _mark(groups: IntArray | None) -> str:
    """Short name of a table of groups, for texture keys."""
    return "none" if groups is None else f"{hash(groups.tobytes()):x}"
