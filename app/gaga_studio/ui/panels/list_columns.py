"""The columns of the object list: which ones a width has room for, and by which it is sorted."""

from typing import get_args

from imgui_bundle import imgui

from gaga_studio.session.scene_cache import SortKey
from gaga_studio.ui.kit import icons, theme
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.panels.row_parts import RowColumns, indent

_NAME = 7.5  # least width of a name, ems: twelve letters, before any other column
# Widths of the other columns, ems: narrow and roomy.
_SHOWN, _SPLATS, _QUALITY, _VIEWS = (2.75, 4.1), (2.8, 3.5), (1.9, 3.3), 2.8
_ARROW = 1.0  # what opens folders and parts, ems
_KEYS: tuple[SortKey, ...] = get_args(SortKey)  # sort keys by column id


def columns_for(is_measured: bool, height: float, depth: int, has_arrows: bool) -> RowColumns:
    """What fits next to a name of `_NAME`: switches first, then quality, splats and views.

    Quality is there because somebody has asked for it. ``height`` of a row, pixels; ``depth`` of
    the deepest row.
    """
    arrow = em(_ARROW) if has_arrows else 0.0
    first = height + em(1.15) + arrow + indent(depth)
    room = (imgui.get_content_region_avail().x - first) / em(1) - _NAME
    is_roomy = room > _SHOWN[1] + _SPLATS[1] + is_measured * _QUALITY[1]
    shown, splats, quality = _SHOWN[is_roomy], _SPLATS[is_roomy], _QUALITY[is_roomy]
    has_quality = is_measured and room > shown + quality
    has_splats = room > shown + has_quality * quality + splats
    has_views = room > shown + splats + is_measured * quality + _VIEWS
    last = 2 + has_splats + has_views
    return RowColumns(
        splats=2 if has_splats else -1,
        views=3 if has_views else -1,
        quality=last if has_quality else -1,
        shown=last + has_quality,
        is_roomy=is_roomy,
        height=height,
        first=first,
        arrow=arrow,
    )


def set_up(columns: RowColumns) -> None:
    """Headers; the id of each column is the place of its sort key."""
    fixed = imgui.TableColumnFlags_.width_fixed
    plain = fixed | imgui.TableColumnFlags_.no_sort | imgui.TableColumnFlags_.no_header_label
    falling = fixed | imgui.TableColumnFlags_.prefer_sort_descending
    imgui.table_setup_scroll_freeze(0, 1)
    imgui.table_setup_column(
        "id", fixed | imgui.TableColumnFlags_.no_header_label, columns.first, 0
    )
    imgui.table_setup_column("Name", imgui.TableColumnFlags_.width_stretch, 1.0, 1)
    wide = columns.is_roomy
    if columns.splats >= 0:
        imgui.table_setup_column("Splats", falling, em(_SPLATS[wide] - 0.2), 2)
    if columns.views >= 0:
        imgui.table_setup_column("Views", falling, em(_VIEWS - 0.2), 3)
    if columns.quality >= 0:
        title = "Quality" if wide else f"{icons.QUALITY}###Quality"
        imgui.table_setup_column(title, fixed, em(_QUALITY[wide] - 0.2), 4)
    imgui.table_setup_column("Shown", plain, em(_SHOWN[wide]), 9)
    with theme.text_color(theme.DIM):
        imgui.table_headers_row()


def sorting() -> tuple[SortKey, bool]:
    """By what the open table is sorted, and whether descending."""
    specs = imgui.table_get_sort_specs()
    if specs is None or specs.specs_count == 0:
        return "id", False
    spec = specs.get_specs(0)
    key = _KEYS[spec.column_user_id] if spec.column_user_id < len(_KEYS) else "id"
    return key, spec.get_sort_direction() == imgui.SortDirection.descending


def switches_width(columns: RowColumns) -> float:
    """Of the column of the switches, pixels."""
    return em(_SHOWN[columns.is_roomy])
