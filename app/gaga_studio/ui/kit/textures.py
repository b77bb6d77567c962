"""Pictures of photos, masks and objects, as textures that are asked for by what they show."""

from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from imgui_bundle import ImVec2, imgui
from PIL import Image

from gaga_core.arrays import BoolArray, FloatArray, IntArray, UInt8Array
from gaga_core.color import group_palette
from gaga_core.errors import GagaError
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.io.images import read_rgb
from gaga_core.masks import Loader, MaskSet, resize_labels
from gaga_core.scene.objects import ObjectTable
from gaga_studio.features import object_list
from gaga_studio.features.find.memory_bank import masks_of_bank
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import theme, widgets
from gaga_studio.ui.kit.theme import em

# --- Photos and masks as pictures: what the film strip and the memory bank show.
# The functions here only read files and mix colors; they run in the image store's thread.

THUMBNAIL = 256  # longest side in pixels
LARGE = 640

Colors = Mapping[int, tuple[float, float, float]]

_EDGE = np.array([255, 255, 255], np.uint8)
_DARK = 0.25  # brightness of a background that is left out
_REST = 0.35  # brightness of the masks that are not meant
_TINT = 0.55  # share of the group's color over the photo


def tint_masks(
    path: Path, load: Loader, groups: IntArray | None, side: int, own: Colors
) -> UInt8Array:
    """The photo with each mask tinted: in its group's color when ``groups`` knows it by mask id."""
    picture = read_rgb(path, side)
    labels = _fitting(load, picture)
    color = _colors(labels, groups, own)
    tinted = picture * (1 - _TINT) + color * (255 * _TINT)
    mixed = np.where((labels > 0)[..., None], tinted, picture)
    return np.clip(mixed, 0, 255).astype(np.uint8)


def outline_mask(path: Path, load: Loader, mask_id: int, side: int) -> UInt8Array:
    """The photo, darker around one mask, with that mask's outline."""
    picture = read_rgb(path, side)
    inside = _fitting(load, picture) == mask_id
    shaded = np.where(inside[..., None], picture, (picture * 0.55).astype(np.uint8))
    shaded[_edge(inside)] = _EDGE
    return shaded


def highlight_mask(
    load: Loader, groups: IntArray | None, mask_id: int, side: int, own: Colors
) -> UInt8Array:
    """The label map of a view in group colors, one mask bright and the others dim."""
    labels = load()
    height, width = labels.shape
    scale = min(1.0, side / max(height, width))
    labels = resize_labels(labels, max(round(width * scale), 1), max(round(height * scale), 1))
    inside = labels == mask_id
    color = _colors(labels, groups, own) * 255
    mixed = np.where(inside[..., None], color, color * _REST)
    mixed[labels <= 0] = 26
    picture = mixed.astype(np.uint8)
    picture[_edge(inside)] = _EDGE
    return picture


def without_background(path: Path, mask: Path, side: int) -> UInt8Array:
    """The photo, darker where its mask of the object is black."""
    picture = read_rgb(path, side)
    size = (picture.shape[1], picture.shape[0])
    alpha = np.asarray(Image.fromarray(read_rgb(mask)[..., 0]).resize(size), np.float32) / 255
    return (picture * (_DARK + (1 - _DARK) * alpha[..., None])).astype(np.uint8)


def _fitting(load: Loader, picture: UInt8Array) -> IntArray:
    return resize_labels(load(), picture.shape[1], picture.shape[0])


def _colors(labels: IntArray, groups: IntArray | None, own: Colors) -> FloatArray:
    """Colors (H, W, 3), 0..1: by group where it is known, else by the mask's own id.

    ``own`` are colors that a person gave groups.
    """
    ids = np.maximum(labels, 0)
    if groups is not None and len(groups):
        ids = np.where(ids < len(groups), groups[np.minimum(ids, len(groups) - 1)], 0)
    palette = group_palette(int(ids.max(initial=0)))
    for group, rgb in own.items() if groups is not None else ():
        if group < len(palette):
            palette[group] = rgb
    result: FloatArray = palette[ids]
    return result


def _edge(inside: BoolArray) -> BoolArray:
    """The pixels (H, W) of a region that touch its outside."""
    core = inside.copy()
    core[1:] &= inside[:-1]
    core[:-1] &= inside[1:]
    core[:, 1:] &= inside[:, :-1]
    core[:, :-1] &= inside[:, 1:]
    return inside & ~core


Texture = tuple[int, int, int] | None  # OpenGL name, width, height; None while it loads


def photo(session: Session, view: str, side: int = THUMBNAIL) -> Texture:
    """The photo of a view; None while it loads and when there is none."""
    path = photo_path(session, view)
    return None if path is None else photo_file(session, path, side)


def photo_file(session: Session, path: Path, side: int = THUMBNAIL) -> Texture:
    """The photo in a file; None while it loads."""
    return _texture(session, f"photo {path} {side}", partial(read_rgb, path, side))


def cut_out(session: Session, path: Path, mask: Path, side: int = THUMBNAIL) -> Texture:
    """The photo in a file, darker where its background is left out; None while it loads."""
    load = partial(without_background, path, mask, side)
    return _texture(session, f"cut out {path} {mask} {side}", load)


def photo_with_masks(
    session: Session, view: str, bank: MemoryBank | None, side: int = THUMBNAIL
) -> Texture:
    """The photo with its masks in the colors of their groups."""
    path, load = photo_path(session, view), _masks(session).loaders.get(view)
    if path is None or load is None:
        return photo(session, view, side)
    groups = groups_of_view(bank, view)
    own = _own_colors(session)
    key = f"masks {path} {_masks(session).source} {side} {_mark(groups)} {sorted(own.items())}"
    paint = partial(tint_masks, path, load, groups, side, own)
    return _texture(session, key, paint)


def _masks(session: Session) -> MaskSet:
    """Those of which the objects are, or are being made."""
    if session.live is not None or session.document is None:
        return session.masks
    return masks_of_bank(session)


def photo_and_mask(
    session: Session, document: Document, decision: Decision
) -> tuple[Texture, Texture]:
    """The photo with one mask outlined, and the label map with that mask bright."""
    view, mask = decision.view, decision.mask
    path, load = photo_path(session, view), _masks(session).loaders.get(view)
    if load is None:
        return photo(session, view, LARGE), None
    side = LARGE
    bank = document.scene.bank if session.live is None else session.live.bank
    groups = groups_of_view(bank, view)
    own = _own_colors(session)
    key = f"{_masks(session).source} {view} {mask} {_mark(groups)} {sorted(own.items())}"
    right = _texture(
        session,
        f"mask {key}",
        partial(highlight_mask, load, groups, mask, side, own),
    )
    if path is None:
        return None, right
    left = partial(outline_mask, path, load, mask, side)
    return _texture(session, f"outline {key}", left), right


def mask_at(session: Session, view: str, u: float, v: float) -> int:
    """Id of the mask at a place of a view, 0..1 from the upper left; 0 = none."""
    load = _masks(session).loaders.get(view)
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


def _own_colors(session: Session) -> Colors:
    """Colors of groups that a person chose."""
    return session.scene.colors if session.scene is not None else {}


def photo_path(session: Session, view: str) -> Path | None:
    """The file of a view's photo, by the name of the view; None where there is none."""
    folder = session.project.folder if session.project is not None else None
    return folder.image_paths.get(view) if folder is not None else None


def _texture(session: Session, key: str, load: Callable[[], UInt8Array]) -> Texture:
    return session.images.texture(key, load) if session.images is not None else None


def _mark(groups: IntArray | None) -> str:
    """Short name of a table of groups, for texture keys."""
    return "none" if groups is None else f"{hash(groups.tobytes()):x}"


# --- The picture of an object, small in a row and larger in its tooltip.

_ENDS = (ImVec2(0, 0), ImVec2(1, 1))
_HOVERED = 160  # pixels of the picture in the tooltip


def draw(
    session: Session, table: ObjectTable, row: int, corner: ImVec2, side: float, alpha: float = 1.0
) -> None:
    """Draw the object of a row into the square at ``corner``; grey until it is there."""
    drawing = imgui.get_window_draw_list()
    high = ImVec2(corner.x + side, corner.y + side)
    texture = _object_texture(session, table, row, object_list.SMALL)
    if texture is None:
        drawing.add_rect_filled(corner, high, theme.u32(theme.RAISED, alpha), em(0.2))
        return
    tint = imgui.get_color_u32(imgui.ImVec4(1, 1, 1, alpha))
    drawing.add_image_rounded(texture, corner, high, *_ENDS, tint, em(0.2))


def tooltip(session: Session, table: ObjectTable, row: int) -> None:
    """Show the picture larger while the mouse rests on the item that was drawn last."""
    if not imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip):
        return
    small = _object_texture(session, table, row, object_list.SMALL)
    if small is None or not imgui.begin_tooltip():
        return
    large = _object_texture(session, table, row, object_list.LARGE)
    side = theme.scaled(_HOVERED)
    imgui.image(large or small, ImVec2(side, side))
    imgui.push_text_wrap_pos(imgui.get_cursor_pos_x() + side)
    widgets.dim(table.names[row], wrap=True)
    imgui.pop_text_wrap_pos()
    imgui.end_tooltip()


def _object_texture(
    session: Session, table: ObjectTable, row: int, side: int
) -> imgui.ImTextureRef | None:
    wanted = object_list.picture_request(session, table, row, side)
    if wanted is None or session.images is None:
        return None
    texture = session.images.texture(*wanted)
    return None if texture is None else imgui.ImTextureRef(texture[0])
