"""The growth of the memory bank, view by view: play it, scrub it, follow it with the camera."""

from imgui_bundle import ImVec2, imgui

from gaga_core.grouping.figures import BankGrowth
from gaga_studio.features.find import memory_bank
from gaga_studio.features.find.memory_bank import Timeline
from gaga_studio.session.notices import Request
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, photo_textures, theme, widgets
from gaga_studio.ui.kit.requests import RequestTable
from gaga_studio.ui.kit.theme import em

TITLE = "Timeline"
_LEAST_PICTURE = 9.0  # em: the panel shows the photo only where it has this height and thrice this


def register(table: RequestTable) -> None:
    """Come to the front when the replay is opened."""
    table.register(Request.TIMELINE, lambda _: imgui.set_window_focus(TITLE))


def draw(session: Session) -> None:
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
    aspect = photo_textures.aspect(session, shown)
    width = min(room.y * aspect, 0.4 * room.x)
    bank = memory_bank.bank_at(session)
    texture = photo_textures.photo_with_masks(session, view, bank) if view else None
    photo_textures.place(texture, width, aspect)


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
    changed, step = imgui.slider_int("##Step", timeline.step, 0, growth.last_step, "view %d")
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
        n = len(growth.views)
        widgets.line(f"All {n} views: the groups as they are saved.", theme.DIM)
        return
    bank = timeline.bank
    first, last = int(growth.n_decisions[step - 1]), int(growth.n_decisions[step])
    decisions = bank.log[first:last] if bank is not None else ()
    n_new = int(growth.n_groups[step] - growth.n_groups[step - 1])
    n_joined = sum(decision.group > 0 for decision in decisions) - n_new
    with theme.face(strong=True):
        widgets.line(growth.views[step - 1])
    widgets.line(
        f"{int(growth.n_groups[step])} groups: {n_new} new, {n_joined} masks joined older ones",
        theme.DIM,
    )


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
