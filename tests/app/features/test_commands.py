"""The command table: no key twice, no disabled command without a reason, none that fails."""

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Event

import pytest
from PIL import ImageFont

from gaga_core.color import luminance
from gaga_core.io.files import assets
from gaga_core.progress import Progress, Stage
from gaga_studio.features import files, objects, selection
from gaga_studio.features.blender_keys import BLENDER
from gaga_studio.features.commands import (
    COMMANDS,
    MENUS,
    PROFILES,
    command,
    for_shortcut,
    keys_of,
    run,
    shortcut_of,
)
from gaga_studio.features.find import association, masks
from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings, hex_color, load_settings
from gaga_studio.session.view import REGION_TOOLS, Mode, SplatLook, ToolName, ViewState
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.dialogs.preferences import all_keys
from gaga_studio.ui.kit import icons
from tests.core.placing.photo_scenes import write_photos

# What can be done with nothing open.
_ALWAYS = {
    "object.models",
    "file.open_photos",
    "file.open_folder",
    "file.open_file",
    "file.demo",
    "file.quit",
    "edit.preferences",
    "view.panels",
    "view.panels_back",
    "view.info",
    "view.background",
    "view.cube",
    "camera.faster",
    "camera.slower",
    "object.clean_first",
    "object.fill_continue",
    "object.fill_model",
    "object.children_go_along",
    "tool.visible_only",
    "tool.smaller_brush",
    "tool.larger_brush",
    "tool.snap",
    "tool.local_axes",
    "tool.reset_pivot",
    "help.palette",
    "view.turn_in_training",
    "help.shortcuts",
    "help.first_steps",
    "help.about",
}


def test_ids_titles_and_keys_are_unique() -> None:
    for names in (
        [c.id for c in COMMANDS],
        [c.title for c in COMMANDS],
        [k for c in COMMANDS for k in (c.shortcut, *c.aliases) if k],
    ):
        assert [name for name, n in Counter(names).items() if n > 1] == []


def test_keys_are_written_in_one_way() -> None:
    named = r"F\d|Delete|Backspace|Enter|Escape|Tab|Home|Left|Right"
    pattern = rf"(Ctrl\+)?(Shift\+)?(Alt\+)?([A-Z0-9/,.[\]]|{named})"
    for c in COMMANDS:
        for keys in (c.shortcut, *c.aliases):
            assert not keys or re.fullmatch(pattern, keys), keys


def test_with_nothing_open_every_disabled_command_says_why(
    new_session: Callable[[], Session],
) -> None:
    session = new_session()
    assert {c.id for c in COMMANDS if not c.enabled(session)} == _ALWAYS
    for c in COMMANDS:
        reason = c.enabled(session)
        assert not reason or re.fullmatch(r"[A-Z].*\.", reason), (c.id, reason)


def test_while_a_task_runs_nothing_is_chosen_to_be_opened(session: Session) -> None:
    """Only after a file was chosen it was said that training still runs."""
    ends = Event()

    def waits() -> Stage[None]:
        while not ends.wait(0.01):
            yield Progress("Wait", 0, 1)

    opening = [c for c in COMMANDS if c.id.startswith("file.open_")] + [command("file.demo")]
    opening += files.recent(session)
    assert len(opening) == 5
    for can_be in (True, False):
        if not can_be:
            assert session.jobs.start("Wait", waits())
        reasons = {c.id: c.enabled(session) for c in opening}
        assert set(reasons.values()) == {"" if can_be else "Wait is still running."}, reasons
    ends.set()
    assert session.jobs.wait()


def test_a_disabled_command_does_nothing_but_tell(new_session: Callable[[], Session]) -> None:
    session = new_session()
    assert not run("edit.delete", session)
    assert session.hint == "No scene is open."
    assert not session.notices
    assert not run("file.export_scene", session)
    assert session.notices[-1].text == "No scene is open.", "no dialog opens"


def test_what_needs_splats_says_of_photos_that_there_are_none_yet(
    new_session: Callable[[], Session], tmp_path: Path
) -> None:
    """While splats were made of photos in sight it was said that no scene is open."""
    write_photos(tmp_path / "photos", 6)
    session = new_session()
    session.open(tmp_path / "photos")
    assert session.jobs.wait()
    assert session.photos is not None
    assert command("edit.delete").enabled(session).startswith("There are no splats yet.")
    ends = Event()

    def waits() -> Stage[None]:
        while not ends.wait(0.01):
            yield Progress("Wait", 0, 1)

    session.jobs.start("Wait", waits())
    assert command("edit.delete").enabled(session) == "Wait is still running."
    ends.set()
    assert session.jobs.wait()


def test_what_is_said_of_a_command_goes_when_the_selection_changes(associated: Session) -> None:
    assert not run("edit.duplicate", associated)
    assert "Nothing is selected" in associated.hint
    selection.select_groups(associated, (int(associated.objects().ids[1]),))
    assert associated.hint == ""


def test_reasons_follow_the_selection(session: Session) -> None:
    association.associate(session)
    assert session.jobs.wait()
    assert session.need().history.entries()[-1].title == command("object.associate").title
    first, second = session.objects().ids[1:3]
    assert "Nothing is selected" in command("edit.delete").enabled(session)
    assert command("object.merge").enabled(session)
    selection.select_groups(session, (int(first),))
    assert not command("edit.delete").enabled(session)
    assert not command("object.rename").enabled(session)
    assert "two objects" in command("object.merge").enabled(session)
    selection.select_groups(session, (int(second),), "add")
    assert "2 objects" in command("object.rename").enabled(session)
    assert not command("object.merge").enabled(session)
    assert command("edit.undo").title_now(session).startswith("Undo Select")
    assert "hidden" in command("object.show_all").enabled(session)
    objects.hide(session)
    assert not command("object.show_all").enabled(session)
    assert "deleted" in command("edit.restore").enabled(session)
    n = len(session.objects().ids)
    objects.delete(session)
    run("edit.restore", session)
    assert len(session.objects().ids) == n
    assert "deleted" in command("edit.restore").enabled(session)


def test_a_film_needs_a_path_or_photos_that_are_here(session: Session) -> None:
    film, project = command("camera.film"), session.project
    assert project is not None
    assert project.folder is not None
    assert film.enabled(session) == ""
    project.folder = replace(project.folder, image_paths={})
    assert "keyframes" in film.enabled(session)


def test_while_a_job_runs_what_needs_one_says_so(session: Session) -> None:
    run("object.associate", session)
    assert session.jobs.running is not None
    assert session.jobs.running.title == command("object.associate").title
    assert "running" in command("file.save_picture").enabled(session)
    assert not command("file.export_scene").enabled(session), "it waits"
    assert not command("file.save").enabled(session)
    assert not command("job.cancel").enabled(session)
    session.jobs.cancel()
    assert session.jobs.wait()
    assert not command("file.save").enabled(session)


_NEEDS_MORE = {
    "view.lod",  # more than two million splats
    "view.build_lod",
    "scene.add_apply",
    "scene.changes",
    "object.make",
    *(f"camera.bookmark_{key}" for key in range(1, 10)),
    "camera.play",
    "file.saved_project",  # of a lone file
    "file.make_splats",
    "file.make_splats_as",
    "file.go_on_training",
    "tool.leave_upright",
    "tool.turn_upright",  # no photos, which say which way is up
    "tool.visible_only",  # single splats are taken
    "camera.clear_path",
    "camera.save_path",
    "camera.film",
    "camera.split_truth",
    "camera.split_errors",
    "camera.split_before",
    "job.cancel",
    "object.show_all",
    "edit.restore",
    "object.clean_apply",
    "object.fill_apply",
    "object.fill_lighten",
    "object.find_in_view",
    "object.index",
    "object.labels_votes",
    "object.labels_identities",
    "view.identity",
    "view.identity_centres",
    "object.masks_model",
    "object.masks_rest",
    "object.name_all",
    "object.folder_out",
    "object.add_views",
    "object.leave_parent",
    "select.children",
    "object.folder_delete",
    "view.folder_colors",
    "edit.confirm",
    "tool.remove_corner",
    "tool.origin_here",
    "tool.pivot_here",
    "object.unlock_all",
    "object.split",
    "object.split_here",
    "object.join_here",
    "object.split_masks",
    "object.worst_view",
    "select.alike",
    "select.whole",
    "tool.click_model",
}


def _start_again(session: Session) -> None:
    """Two objects are selected, as the last entry; everything else is as it was opened."""
    session.cancel_preview()
    session.need().go_to(0)
    session.tool, session.view, session.live = ToolName.PICK, ViewState(), None
    session.rig.is_flying = False
    if session.provider != "made":
        masks.choose(session, "made")
    for group in session.objects().ids[1:3]:
        selection.select_groups(session, (int(group),), "add")
    objects.hide(session)
    session.undo()


# Making the demo and bodies takes long, and splats made again close the scene: test_demo.py,
# test_simulate.py and test_reconstruction.py do it.
@pytest.mark.parametrize("menu", MENUS)
def test_every_command_runs_on_an_open_scene(associated: Session, menu: str) -> None:
    session = associated
    ends = {"file.close": 1, "file.quit": 2}
    for wanted in sorted(MENUS[menu], key=lambda c: ends.get(c.id, 0)):
        if wanted.id in {"file.demo", "file.make_again", "object.simulate"}:
            continue
        _start_again(session)
        if wanted.id in {"object.rename", "object.clean"}:
            selection.select_groups(session, (int(session.objects().ids[1]),))
        if wanted.enabled(session):
            assert wanted.id in _NEEDS_MORE, wanted.enabled(session)
            continue
        n_notices = len(session.notices)
        assert run(wanted.id, session), wanted.id
        assert session.jobs.wait()
        assert all(n.level != "error" for n in session.notices[n_notices:]), wanted.id
        if session.document is None:
            break


@pytest.mark.parametrize("state", ["session", "associated"])
def test_every_disabled_command_has_a_reason_that_is_a_sentence(
    state: str, request: pytest.FixtureRequest
) -> None:
    open_now: Session = request.getfixturevalue(state)
    reasons = {c.id: c.enabled(open_now) for c in COMMANDS}
    for id_, reason in reasons.items():
        assert not reason or (reason[0].isupper() and reason.endswith(".")), (id_, reason)
    assert sum(map(bool, reasons.values())) > 20


def test_icons_are_drawn_by_the_font_and_stand_where_menus_are_short() -> None:
    font = ImageFont.truetype(str(assets() / "fonts" / "lucide.ttf"), 20)
    drawn = {name: sign for name, sign in vars(icons).items() if name.isupper() and sign.strip()}
    assert [n for n, sign in drawn.items() if font.getmask(sign).getbbox() is None] == []
    short = {*command_buttons.OBJECT_MENU, *command_buttons.SCENE_MENU, *command_buttons.SPLITS}
    assert short - {"", *command_buttons.ICONS} == set()
    assert set(command_buttons.ICONS) <= {c.id for c in COMMANDS}


def test_shortcuts_find_their_command(associated: Session) -> None:
    for c in COMMANDS:
        for keys in (c.shortcut, *c.aliases):
            assert not keys or for_shortcut(keys, associated) is c
    assert for_shortcut("Ctrl+Alt+X", associated) is None


def test_while_flying_the_fly_keys_are_not_shortcuts(associated: Session) -> None:
    assert for_shortcut("Shift+D", associated) is command("edit.duplicate")
    run("view.fly", associated)
    assert for_shortcut("Shift+D", associated) is None
    assert for_shortcut("Ctrl+D", associated) is command("edit.duplicate")
    assert for_shortcut("V", associated) is command("view.fly")


def test_escape_ends_the_innermost_thing_first(associated: Session) -> None:
    session = associated
    selection.select_groups(session, (int(session.objects().ids[1]),))
    run("tool.move", session)
    run("view.fly", session)
    run("edit.cancel", session)
    assert not session.rig.is_flying
    assert [c.id for c in MENUS["Tools"] if c.is_on and c.is_on(session)] == ["tool.move"]
    run("edit.cancel", session)
    assert session.tool == ToolName.PICK
    assert session.selected_groups()
    run("edit.cancel", session)
    assert not session.selected_groups()
    assert not run("edit.cancel", session)


def test_render_modes(associated: Session) -> None:
    run("view.groups", associated)
    assert associated.view.mode is Mode.GROUPS
    assert command("view.groups").is_on is not None
    run("object.lift", associated)  # without it there are no encodings to show
    assert associated.jobs.wait()
    seen = set()
    for _ in Mode:
        run("view.next_mode", associated)
        seen.add(associated.view.mode)
    assert seen == set(Mode)


@pytest.mark.parametrize(
    ("id_", "field"),
    [
        ("view.frusta", "show_frusta"),
        ("view.outline", "show_outline"),
        ("view.panels", "show_panels"),
        ("view.info", "show_info"),
        ("view.cube", "show_cube"),
        ("tool.splats", "takes_splats"),
        ("tool.visible_only", "visible_only"),
        ("tool.snap", "snaps"),
        ("tool.local_axes", "local_axes"),
    ],
)
def test_a_switch_flips_one_field_and_back(associated: Session, id_: str, field: str) -> None:
    session = associated
    session.view.takes_splats = field == "visible_only"  # objects are taken whole
    switch, before = command(id_), replace(session.view)
    assert switch.is_on is not None
    for _ in range(2):
        was_on = switch.is_on(session)
        assert run(id_, session)
        assert switch.is_on(session) is not was_on
        assert getattr(session.view, field) is not was_on
        assert replace(session.view, **{field: getattr(before, field)}) == before


@pytest.mark.parametrize("state", ["session", "associated"])
@pytest.mark.parametrize("takes_splats", [False, True])
@pytest.mark.parametrize("visible_only", [False, True])
def test_ticks_say_what_tools_take(
    state: str, takes_splats: bool, visible_only: bool, request: pytest.FixtureRequest
) -> None:
    """The tool bar had "Visible surface" lit for the brush, and the menu had no tick there."""
    now: Session = request.getfixturevalue(state)
    now.view.takes_splats, now.view.visible_only = takes_splats, visible_only
    splats, surface = command("tool.splats"), command("tool.visible_only")
    for tool in REGION_TOOLS:
        now.tool = tool
        for switch in (splats, surface):
            assert switch.is_on is not None
            before = switch.is_on(now)
            assert run(switch.id, now) is (switch.is_on(now) is not before), switch.id
            if switch.is_on(now) is not before:
                run(switch.id, now)
        of_splats = takes_splats or state == "session"
        assert splats.is_on is not None
        assert surface.is_on is not None
        assert splats.is_on(now) is of_splats
        assert surface.is_on(now) is (visible_only if of_splats else tool is ToolName.BRUSH)


@pytest.mark.parametrize("profile", PROFILES)
def test_no_key_means_two_things(profile: str) -> None:
    taken: dict[str, str] = {}
    for id_, listed in PROFILES[profile].items():
        for keys in listed:
            assert keys not in taken, (keys, id_, taken[keys])
            taken[keys] = id_


def test_profiles_name_commands_that_exist_and_keys_that_the_window_knows() -> None:
    ids = {c.id for c in COMMANDS}
    assert set(BLENDER) <= ids
    assert all(set(table) == ids for table in PROFILES.values())
    assert {"G", "X", ".", "[", "Home"} <= set(all_keys())


def test_the_same_key_follows_the_profile(new_session: Callable[[], Session]) -> None:
    session = new_session()
    chosen = for_shortcut("R", session)
    assert chosen is not None
    assert chosen.id == "tool.rect"
    session.settings = replace(session.settings, keys="blender")
    chosen = for_shortcut("R", session)
    assert chosen is not None
    assert chosen.id == "tool.rotate"
    assert shortcut_of(command("edit.delete"), session) == "X"
    assert keys_of(command("tool.polygon"), session) == ()
    session.rig.is_flying = True
    assert for_shortcut("S", session) is None  # flies back
    session.rig.is_flying = False
    session.settings = replace(session.settings, keys="unknown")
    assert shortcut_of(command("tool.rect"), session) == "R"


def test_modes_without_anything_to_show_are_left_out(session: Session) -> None:
    """Not associated: no groups, no mask, no confidence."""
    assert "Find objects" in command("view.confidence").enabled(session)
    seen = []
    for _ in range(8):
        run("view.next_mode", session)
        seen.append(session.view.mode)
    assert seen[:4] == [Mode.DEPTH, Mode.CENTRES, Mode.RINGS, Mode.COLOR]
    assert seen[4:] == seen[:4]


def test_from_a_mode_that_lost_its_subject_the_next_one_is_taken(session: Session) -> None:
    session.view.mode = Mode.MASK
    run("view.next_mode", session)
    assert session.view.mode is Mode.COLOR
    session.view.mode = Mode.GROUPS
    run("view.next_mode", session)
    assert session.view.mode is Mode.DEPTH


def test_the_look_follows_the_file_unless_it_is_chosen(associated: Session) -> None:
    scene = associated.scene
    assert scene is not None
    assert not associated.view.is_antialiased(scene)
    scene.gaussians = replace(scene.gaussians, comments=("SplatRenderMode: mip",))
    assert associated.view.is_antialiased(scene)
    run("view.look_classic", associated)
    assert associated.view.look is SplatLook.CLASSIC
    assert not associated.view.is_antialiased(scene)
    run("view.look_auto", associated)
    assert associated.view.is_antialiased(scene)


def test_a_background_is_used_and_remembered(associated: Session) -> None:
    seen = set()
    for _ in range(4):
        run("view.background", associated)
        assert associated.view.background == associated.settings.background_color
        seen.add(associated.view.background)
    assert len(seen) == 4
    assert {(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)} < seen
    run("view.background", associated)
    again, _ = load_settings()
    assert again.background_color == associated.view.background


def test_the_background_is_that_of_the_theme_unless_one_was_chosen(associated: Session) -> None:
    """A dark picture in a light window."""
    before = associated.view.background
    associated.change_settings(replace(associated.settings, theme="light"))
    assert luminance(before) < 0.1 < 0.7 < luminance(associated.view.background)
    run("view.background", associated)
    assert associated.view.background == (0.0, 0.0, 0.0)
    associated.change_settings(replace(associated.settings, theme="dark"))
    assert associated.view.background == (0.0, 0.0, 0.0)
    for _ in range(3):
        run("view.background", associated)
    assert associated.view.background == before


@pytest.mark.parametrize("color", ["#1c1c1f", "#000000", "#ffffff", "#0a80fe"])
def test_colors_as_html_writes_them(color: str) -> None:
    assert hex_color(Settings(background=color).background_color) == color


@pytest.mark.parametrize("color", ["", "red", "#12", "#1234567", "#gggggg"])
def test_a_color_that_is_none_is_black(color: str) -> None:
    assert Settings(background=color).background_color == (0.0, 0.0, 0.0)
