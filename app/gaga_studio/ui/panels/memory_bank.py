"""The memory bank of one object: which mask of which view joined it, and with what overlap.

While the association runs it shows the current view and the groups that its masks join.
"""

from collections.abc import Sequence
from pathlib import PurePath

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.errors import counted
from gaga_core.grouping.associate import BankSnapshot
from gaga_core.grouping.figures import BankGrowth
from gaga_core.grouping.memory_bank import Decision
from gaga_studio.features import commands
from gaga_studio.features.find import memory_bank
from gaga_studio.features.find.memory_bank import Timeline
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, textures, theme, widgets
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.viewport import mask_evidence
from gaga_studio.ui.viewport.mask_evidence import EvidenceState

_TABLE_FLAGS = (
    imgui.TableFlags_.scroll_y
    | imgui.TableFlags_.row_bg
    | imgui.TableFlags_.no_saved_settings
    | imgui.TableFlags_.no_pad_outer_x
    | imgui.TableFlags_.sizing_fixed_fit
)
_OVERLAPS = {  # what the shares are of
    False: "share of the splats behind the mask that the object held when the mask was decided",
    True: "share of the points on the surface that the mask shows, which belong to the object: "
    "a sample of what it shows",
}
_CHOSEN_SHARE = 0.45  # of the room below the head, at most: rows are what is looked through
_MOST_BARS = 6
_LEAST_ROWS = 3  # of the table, below its titles
_NARROW = 17.0  # em: a narrower panel has three columns, text and buttons one below the other
_ROW_FLAGS = imgui.SelectableFlags_.span_all_columns | imgui.SelectableFlags_.allow_double_click


def draw(session: Session, state: EvidenceState) -> None:
    """The whole panel."""
    document = session.document
    if document is None:
        what = session.nothing_open_text
        widgets.empty_state(icons.MEMORY, what, "")
        return
    if session.live is not None:
        _growing(session, document, state, session.live)
        return
    state.decision = document.read.decision_now(state.decision)
    if document.scene.bank is None:
        hint = "Association fills it: which mask of which photo belongs to which object."
        if not session.cameras:
            hint = "It says which mask of which photo belongs to which object. No photos are here."
        widgets.empty_state(icons.MEMORY, "The memory bank is empty", hint)
        return
    group = memory_bank.group_of_panel(session)
    if not group:
        hint = "Select an object to see the masks that made it."
        widgets.empty_state(icons.MEMORY, "No object chosen", hint)
        return
    whole = memory_bank.made_from(session, group)
    decisions = session.decisions(whole)
    if not decisions:
        hint = "Only objects that Find objects made have masks."
        widgets.empty_state(icons.MEMORY, f"{document.name_of(group)} has no masks", hint)
        return
    _head(session, group, whole, decisions)
    # Its room is there before a mask is chosen: a click moves no row.
    room, line = imgui.get_content_region_avail(), imgui.get_text_line_height_with_spacing()
    n_buttons, most = 3 if room.x < em(_NARROW) else 1, _CHOSEN_SHARE * room.y
    head = n_buttons * imgui.get_frame_height_with_spacing() + line
    n_bars = min(max(int((most - head) / line), 1), _MOST_BARS)
    below = head + n_bars * line
    least = (1 + _LEAST_ROWS) * line  # where that is too much for the panel, all of it scrolls
    height = max(room.y - below - imgui.get_style().item_spacing.y, least)
    _table(session, document, state, decisions, by_view=True, height=height)
    if imgui.begin_child("Chosen mask", ImVec2(0, below)):
        _chosen(session, document, state, n_bars)
    imgui.end_child()


def _head(session: Session, group: int, whole: int, decisions: Sequence[Decision]) -> None:
    document = session.need()
    with theme.face(strong=True):
        widgets.line(document.name_of(group))
    n_views = len({decision.view for decision in decisions})
    masks = counted(len(decisions), "mask")
    n_by_hand = sum(decision.by_hand for decision in decisions)
    by_hand = f", {n_by_hand} by hand" if n_by_hand else ""
    text = f"{masks} from {counted(n_views, 'photo')}{by_hand}"
    widgets.dim(widgets.elided(text, imgui.get_content_region_avail().x))
    widgets.tooltip(
        f"Overlap: {_OVERLAPS[document.read.overlap_is_of_points()]}. Right-click a mask that "
        "belongs elsewhere, or drag it onto its object in the list."
    )
    if whole != group:
        how = "Copied from" if memory_bank.is_copy(document, group) else "Split from"
        widgets.dim(f"{how} {document.name_of(whole)}, whose masks these are", wrap=True)
    elif n_parts := memory_bank.split_from(session, group):
        parts = counted(n_parts, "object")
        widgets.dim(f"Some of the masks show what was split from it ({parts})", wrap=True)


def _chosen(session: Session, document: Document, state: EvidenceState, n_bars: int) -> None:
    """The chosen mask: its splats in the picture, and the share of them that each group holds."""
    decision = state.decision
    why_not = commands.command("view.lights_masks").enabled(session)
    if decision is None or why_not:
        hint = "Click a mask: its splats light up, and bars show whose they are."
        widgets.dim(why_not if decision is not None else hint, wrap=True)
        return
    view = session.view
    hint = "Light up the splats of this mask in the picture"
    if widgets.toggle(f"{icons.MASK_MODE}  Light up###Light up", view.lights_masks, hint=hint):
        commands.run("view.lights_masks", session)
    widgets.next_to("Depth gate")
    hint = "Only splats at the depths of what the mask shows; without it also those behind it, pink"
    if widgets.toggle("Depth gate", view.has_mask_gate, hint=hint):
        commands.run("view.mask_gate", session)
    splats = memory_bank.mask_splats_of(session, decision)
    shares = memory_bank.mask_overlaps(session, decision, has_gate=view.has_mask_gate)
    if splats is None or shares is None:
        gone = memory_bank.where_masks_are(session, decision)
        widgets.dim("Looking at the view …" if shares is None else gone, wrap=True)
        return
    n_splats = counted(int(np.count_nonzero(splats.of(view.has_mask_gate))), "splat")
    widgets.next_to(n_splats)
    imgui.align_text_to_frame_padding()
    widgets.dim(n_splats)
    what = mask_evidence.what_is_shared(document, has_gate=view.has_mask_gate)
    widgets.line(what, theme.DIM)
    _shares(session, document, what, shares, n_bars)


def _shares(
    session: Session, document: Document, what: str, shares: dict[int, float], n: int
) -> None:
    """The largest shares as bars; all of them in the tooltip."""
    table = session.objects()
    left = imgui.get_cursor_pos_x()
    wide = imgui.get_content_region_avail().x
    imgui.begin_group()
    for group, share in list(shares.items())[:n]:
        row = table.row(group)
        color = theme.FAINT if row is None or not group else widgets.rgba(table.colors[row])
        widgets.text("●", color)
        imgui.same_line(0, em(0.4))
        name = document.name_of(group) if group else "no object"
        widgets.line(widgets.elided(name, 0.45 * wide - em(1.6)), theme.TEXT)
        imgui.same_line(left + 0.45 * wide)
        _bar(share, color)
    imgui.end_group()
    names = ((document.name_of(g) if g else "no object", s) for g, s in shares.items())
    listed = "\n".join(f"{100 * share:.1f} %  {name}" for name, share in names)
    widgets.tooltip(f"{what}\n{listed}", of_row=True)


def _growing(
    session: Session, document: Document, state: EvidenceState, live: BankSnapshot
) -> None:
    """The bank after the newest view."""
    decisions = [d for d in live.bank.log if d.view == live.view]
    n_new = sum(decision.is_new for decision in decisions)
    with theme.face(strong=True):
        widgets.line(counted(live.n_groups, "group"))
    joined = f"{counted(len(decisions) - n_new, 'mask')} joined, {n_new} opened a group"
    widgets.dim(widgets.elided(f"{live.view}: {joined}", imgui.get_content_region_avail().x))
    _table(session, document, state, decisions, by_view=False)


def _table(
    session: Session,
    document: Document,
    state: EvidenceState,
    decisions: Sequence[Decision],
    *,
    by_view: bool,
    height: float = 0.0,
) -> None:
    is_narrow = imgui.get_content_region_avail().x < em(_NARROW)
    if not imgui.begin_table("Decisions", 3 if is_narrow else 4, _TABLE_FLAGS, ImVec2(0, height)):
        return
    stretch, fixed = imgui.TableColumnFlags_.width_stretch, imgui.TableColumnFlags_.width_fixed
    imgui.table_setup_scroll_freeze(0, 1)
    imgui.table_setup_column("View" if by_view else "Group", stretch, 1.0 if is_narrow else 1.2)
    imgui.table_setup_column("Mask", fixed, em(2.6))
    imgui.table_setup_column("Overlap", stretch, 1.2 if is_narrow else 1.0)
    if not is_narrow:
        imgui.table_setup_column("Next best", stretch, 1.0)
    with theme.text_color(theme.DIM):
        imgui.table_headers_row()
    clipper = imgui.ListClipper()
    clipper.begin(len(decisions))
    if state.decision in decisions:  # drawn wherever it is, to be scrolled to
        clipper.include_item_by_index(decisions.index(state.decision))
    while clipper.step():
        for at in range(clipper.display_start, clipper.display_end):
            _row(session, document, state, decisions[at], by_view, is_narrow)
            if decisions[at] == state.decision:
                _keep_in_sight(state, decisions[at])
    clipper.end()
    imgui.end_table()


def _keep_in_sight(state: EvidenceState, decision: Decision) -> None:
    """Show the row drawn last whole when it is chosen, and when the table has another height."""
    now = (decision, imgui.get_window_height())
    if state.in_sight == now:
        return
    state.in_sight = now
    low, high = imgui.get_item_rect_min().y, imgui.get_item_rect_max().y
    top = imgui.get_window_pos().y + imgui.get_text_line_height_with_spacing()  # below the titles
    if low < top or high > imgui.get_window_pos().y + now[1]:
        imgui.set_scroll_here_y(0.5)


def _row(
    session: Session,
    document: Document,
    state: EvidenceState,
    decision: Decision,
    by_view: bool,
    is_narrow: bool,
) -> None:
    imgui.table_next_row()
    imgui.push_id(f"{decision.view} {decision.mask}")
    imgui.table_set_column_index(0)
    clicked, _ = imgui.selectable("##decision", state.decision == decision, _ROW_FLAGS)
    widgets.tooltip(mask_evidence.explanation(document, decision), of_row=True)
    if clicked:
        state.decision = None if state.decision == decision else decision
        if imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
            state.decision = decision
            command_buttons.fly_to(session, decision.view)
    if by_view:
        mask_evidence.drag_source(state.menu, document, decision)
        mask_evidence.popup(session, document, state.menu, decision)
    imgui.same_line(0, 0)
    if by_view:
        # Names of photos differ at their end.
        room, name = imgui.get_content_region_avail().x, PurePath(decision.view).stem
        fits = imgui.calc_text_size(decision.view).x <= room
        widgets.line(decision.view if fits else widgets.elided(name[::-1], room)[::-1])
    else:
        widgets.line(document.name_of(decision.group) if decision.group else "none")
    imgui.table_set_column_index(1)
    widgets.number(f"{decision.mask}", theme.DIM)
    imgui.table_set_column_index(2)
    if decision.by_hand:
        widgets.text(f"{icons.RENAME} by hand", theme.ACCENT)
    elif decision.is_new:
        widgets.text(f"{icons.NEW} new", theme.GOOD)
    else:
        _bar(decision.overlap, theme.ACCENT_STRONG)
    if not is_narrow:
        imgui.table_set_column_index(3)
        if decision.runner_up:
            _bar(decision.runner_up_overlap, theme.FAINT)
            widgets.tooltip(document.name_of(decision.runner_up))
        else:
            widgets.dim("–")
    imgui.pop_id()


def _bar(share: float, color: imgui.ImVec4) -> None:
    """A share 0..1 as a bar with its number."""
    width = imgui.get_content_region_avail().x - em(0.2)
    corner = imgui.get_cursor_screen_pos()
    height = imgui.get_text_line_height()
    drawing = imgui.get_window_draw_list()
    low, round_by = ImVec2(corner.x, corner.y + theme.scaled(1)), em(0.15)
    whole = ImVec2(corner.x + width, corner.y + height)
    drawing.add_rect_filled(low, whole, theme.u32(theme.RAISED), round_by)
    part = ImVec2(corner.x + width * min(max(share, 0.0), 1.0), whole.y)
    drawing.add_rect_filled(low, part, theme.u32(color, 0.75), round_by)
    with theme.face(scale=0.87):
        label = f"{100 * share:.0f} %"
        at = ImVec2(whole.x - imgui.calc_text_size(label).x - em(0.3), corner.y + theme.scaled(1))
        drawing.add_text(at, theme.u32(theme.TEXT), label)
    imgui.dummy(ImVec2(width, height))


# --- The growth of the memory bank, view by view: play it, scrub it, follow it with the camera.

TIMELINE = "Timeline"
_LEAST_PICTURE = 9.0  # em: the panel shows the photo only where it has this height and thrice this


def draw_timeline(session: Session) -> None:
    """The whole panel."""
    timeline = memory_bank.timeline_of(session)
    if session.document is None or session.document.scene.bank is None:
        widgets.empty_state(icons.MEMORY, "The memory bank is empty", "")
        return
    if not timeline.is_open or timeline.growth is None:
        widgets.dim(
            "How the masks of one view after the other found their groups, in the picture.",
            wrap=True,
        )
        command_buttons.command_button(session, "view.timeline", "Replay")
        return
    room = imgui.get_content_region_avail()
    if room.y > em(_LEAST_PICTURE) and room.x > 3 * em(_LEAST_PICTURE):
        _photo(session, room)
        imgui.same_line(0, em(0.7))
    if imgui.begin_child("Steps", ImVec2(0, 0)):
        _controls(session, timeline, timeline.growth)
        _sentence(session, timeline, timeline.growth)
        _curve(session, timeline, timeline.growth)
    imgui.end_child()


def _photo(session: Session, room: ImVec2) -> None:
    """The view of the step, its masks in the colors of the groups that they joined."""
    view = memory_bank.view_of_step(session)
    shown = view or (session.cameras[0].name if session.cameras else "")
    aspect = textures.aspect(session, shown)
    width = min(room.y * aspect, 0.4 * room.x)
    bank = memory_bank.bank_at(session)
    texture = textures.photo_with_masks(session, view, bank) if view else None
    textures.place(texture, width, aspect)


def _controls(session: Session, timeline: Timeline, growth: BankGrowth) -> None:
    icon = icons.PAUSE if timeline.is_playing else icons.PLAY
    if widgets.icon_button("Play the bank", icon, hint="Play or stop"):
        memory_bank.toggle_timeline_playing(session)
    imgui.same_line(0, em(0.2))
    if widgets.icon_button("Step back", icons.STEP_BACK, hint="One view back"):
        _stop_at(session, timeline, timeline.step - 1)
    imgui.same_line(0, em(0.2))
    if widgets.icon_button("Step on", icons.STEP_ON, hint="One view on"):
        _stop_at(session, timeline, timeline.step + 1)
    imgui.same_line()
    tail = 2 * imgui.get_frame_height() * 1.12 + 2 * imgui.get_style().item_spacing.x
    imgui.set_next_item_width(max(imgui.get_content_region_avail().x - tail, em(4)))
    ends = {0: "start", growth.last_step: "end"}  # no view: before the first, and all together
    steps = timeline.step, 0, growth.last_step
    changed, step = widgets.slider("##Step", *steps, "view %d", words=ends)
    if changed:
        _stop_at(session, timeline, step)
    imgui.same_line()
    hint = "The camera follows the views"
    if widgets.icon_button("Camera follows", icons.CAMERA, hint=hint, on=timeline.follows):
        memory_bank.set_follows(session, not timeline.follows)
    imgui.same_line()
    if widgets.icon_button("Close replay", icons.CLOSE, hint="Close the replay (Esc)"):
        memory_bank.close_timeline(session)


def _stop_at(session: Session, timeline: Timeline, step: int) -> None:
    timeline.is_playing = False
    memory_bank.go_to_step(session, step)


def _sentence(session: Session, timeline: Timeline, growth: BankGrowth) -> None:
    """What the step did."""
    step = timeline.step
    if step == 0:
        widgets.line("Before the first view every splat is free.", theme.DIM)
        return
    if step == growth.last_step:
        which = memory_bank.views_text(session, growth.views)
        widgets.line(f"{which}: the groups as they are saved.", theme.DIM)
        return
    bank = timeline.bank
    first, last = int(growth.n_decisions[step - 1]), int(growth.n_decisions[step])
    decisions = bank.log[first:last] if bank is not None else ()
    n_new = int(growth.n_groups[step] - growth.n_groups[step - 1])
    n_joined = sum(decision.group > 0 for decision in decisions) - n_new
    with theme.face(strong=True):
        widgets.line(growth.views[step - 1])
    groups, masks = counted(int(growth.n_groups[step]), "group"), counted(n_joined, "mask")
    widgets.line(f"{groups}: {n_new} new, {masks} joined older ones", theme.DIM)


def _curve(session: Session, timeline: Timeline, growth: BankGrowth) -> None:
    """Bars of the number of groups after each view; a click goes to a step."""
    room = imgui.get_content_region_avail()
    if room.y < em(1.5):
        return
    size = ImVec2(room.x, min(room.y, em(6)))
    corner, drawing = imgui.get_cursor_screen_pos(), imgui.get_window_draw_list()
    imgui.invisible_button("Growth", size)
    n = growth.last_step + 1
    if imgui.is_item_active():
        share = (imgui.get_mouse_pos().x - corner.x) / max(size.x, 1.0)
        _stop_at(session, timeline, int(share * n))
    widgets.tooltip("Groups after each view. Click or drag to go there.")
    heights = [*growth.n_groups.tolist(), int(growth.n_groups[-1])]
    top = max(*heights, 1)
    for step, groups in enumerate(heights):
        low = ImVec2(corner.x + size.x * step / n, corner.y + size.y * (1 - groups / top))
        high = ImVec2(corner.x + size.x * (step + 1) / n - 1, corner.y + size.y)
        is_known = step <= timeline.step
        color = theme.u32(theme.ACCENT_STRONG, 0.85) if is_known else theme.u32(theme.RAISED)
        drawing.add_rect_filled(low, ImVec2(max(high.x, low.x + 1), high.y), color)
