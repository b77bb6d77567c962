"""The table of commands behind menu, tool bar, shortcuts, shortcut sheet and palette.

Each feature has its own commands. Here: the order of the menus, and what Enter, Escape and
Backspace mean, which depends on the feature that is active.
"""

from collections.abc import Mapping

from gaga_studio.features import (
    add_scene,
    camera,
    cleanup,
    dataset,
    export,
    files,
    fill,
    folders,
    level_of_detail,
    measure,
    object_list,
    objects,
    reconstruction,
    selection,
    simulate,
    split_view,
    transform,
    upright,
    view,
)
from gaga_studio.features.base import Command, no_scene, no_selection
from gaga_studio.features.blender_keys import BLENDER, Keys
from gaga_studio.features.find import association, click_object, masks, memory_bank, search
from gaga_studio.session.camera_rig import FLY_KEYS
from gaga_studio.session.notices import Level
from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings
from gaga_studio.session.view import PhotoCompareMode, ToolName

# --- Enter, Escape and Backspace


def confirm(session: Session) -> None:
    """Confirm what waits: the outline, the clicked object, the filling or the cleaning."""
    if session.view.outline is not None:
        selection.close_outline(session)
    elif fill.apply(session) or add_scene.apply(session) or cleanup.apply(session):
        pass  # a preview waits, whatever the tool is
    elif click_object.is_clicking(session):
        click_object.make_object(session)


def nothing_to_confirm(session: Session) -> str:
    """Needs an outline, clicks, or the preview of a cleaning or filling."""
    waits = any(one.shown(session) is not None for one in (cleanup, fill, add_scene))
    if session.view.outline is not None or waits:
        return ""
    if click_object.is_clicking(session):
        return click_object.no_clicks(session)
    return no_scene(session) or "There is nothing to confirm."


def cancel(session: Session) -> None:
    """End what is active: a drag, flying, the tool, the selection, or a comparison."""
    if session.is_previewing:
        session.cancel_preview()
    elif session.rig.is_flying:
        session.rig.is_flying = False
    elif session.view.outline is not None:
        session.view.outline = None
    elif _clicks_points(session):
        measure.leave(session)
    elif click_object.is_clicking(session):
        click_object.clear(session)
    elif session.tool is not ToolName.PICK:
        session.tool = ToolName.PICK
    elif no_selection(session):
        session.view.compare = PhotoCompareMode.OFF
    else:
        selection.select_none(session)


def no_cancel(session: Session) -> str:
    """Needs something that Escape ends."""
    leaves = session.tool is not ToolName.PICK or session.rig.is_flying
    compares = session.view.compare is not PhotoCompareMode.OFF
    if session.is_previewing or leaves or compares or not no_selection(session):
        return ""
    job = session.jobs.running
    if job is not None:
        return f"{job.title} goes on: Cancel in the status bar ends it."
    return "There is nothing to cancel."


def remove_corner(session: Session) -> None:
    """Remove the last corner of the outline, or the last point that was clicked."""
    if _clicks_points(session):
        measure.take_back(session)
    elif session.view.outline is not None:
        session.view.outline = session.view.outline.without_last()


def no_corner(session: Session) -> str:
    """Needs an outline that is being drawn, or a point that was clicked."""
    if session.tool is ToolName.GROUND:
        return "" if measure.clicked(session).points else "No point of the ground is marked yet."
    if session.tool is ToolName.MEASURE:
        return "" if measure.clicked(session).points else "No point is marked yet."
    if session.view.outline is not None:
        return ""
    return no_scene(session) or "No outline is being drawn. Take the polygon tool first."


def _clicks_points(session: Session) -> bool:
    return session.tool in (ToolName.GROUND, ToolName.MEASURE)


_OWN = (
    Command("edit.confirm", "Confirm", confirm, "Enter", enabled=nothing_to_confirm),
    Command("edit.cancel", "Cancel", cancel, "Escape", enabled=no_cancel),
    Command(
        "tool.remove_corner",
        "Take back the last corner",
        remove_corner,
        enabled=no_corner,
        describe=lambda s: f"Take back the last {'point' if _clicks_points(s) else 'corner'}",
    ),
)

# --- menus

_ALL = (
    *(_OWN + files.COMMANDS + export.COMMANDS + reconstruction.COMMANDS + transform.COMMANDS),
    *(selection.COMMANDS + objects.COMMANDS + folders.COMMANDS + cleanup.COMMANDS + fill.COMMANDS),
    *(masks.COMMANDS + association.COMMANDS + memory_bank.COMMANDS + search.COMMANDS),
    *object_list.COMMANDS,
    *(click_object.COMMANDS + view.COMMANDS + split_view.COMMANDS + camera.COMMANDS),
    *(measure.COMMANDS + dataset.COMMANDS + add_scene.COMMANDS + simulate.COMMANDS),
)
_BY_ID = {command.id: command for command in _ALL}
_ORDER = {
    "File": """file.open_photos file.open_folder file.open_file file.saved_project file.make_splats
        file.make_splats_as file.make_again file.go_on_training file.add_splats file.add_scene
        file.demo file.save file.save_as file.export_scene file.export_page
        file.export_selected file.export_objects file.export_meshes file.export_simulation
        file.export_cameras file.export_masks file.dataset file.save_script file.save_picture
        file.close file.quit""",
    "Edit": """edit.undo edit.redo edit.recolor edit.duplicate edit.duplicate_and_move
        edit.delete edit.mirror_x edit.mirror_y edit.mirror_z edit.reduce edit.delete_floaters
        edit.restore edit.confirm edit.cancel edit.preferences""",
    "Select": """select.all select.none select.invert select.grow select.shrink select.whole
        select.alike select.children select.keep""",
    "Find": """object.masks object.masks_rest object.masks_quick object.masks_model object.models
        object.import_masks object.import_masks_file object.associate object.find_settings
        object.add_views object.lift object.labels_votes object.labels_identities object.find
        object.find_in_view object.index object.name_all object.quality object.worst_view
        object.uncertain object.list_unsure""",
    "Object": """object.hide object.isolate object.show_all object.lock object.unlock_all
        object.reset_placement object.rename object.folder object.folder_out object.folder_delete
        object.leave_parent object.children_go_along object.make object.merge object.separate
        object.split object.split_here object.join_here object.split_masks object.fill
        object.fill_apply object.fill_lighten object.fill_continue object.fill_model object.clean
        object.clean_apply object.clean_first object.simulate scene.add_apply scene.changes""",
    "View": """view.color view.groups view.depth view.confidence view.centres view.rings view.mask
        view.identity view.next_mode view.groups_centres view.identity_centres view.folder_colors
        view.look_auto view.look_classic view.look_antialiased view.background view.frame_selected
        view.frame_all view.home view.front view.back view.left view.right view.top view.bottom
        view.next_photo view.previous_photo view.fly view.frusta view.outline view.box
        view.lights_masks view.mask_gate view.timeline view.lod view.build_lod view.panels
        view.history view.turn_in_training view.info
        view.panels_back""",
    "Camera": f"""view.ortho view.cube camera.faster camera.slower camera.add_bookmark
        {" ".join(camera.RECALL)} {" ".join(camera.SET)} camera.swipe camera.split_groups
        camera.split_photo_groups camera.split_truth camera.split_errors camera.split_before
        camera.split_preset camera.difference camera.hold_photo camera.add_keyframe
        camera.turntable camera.play camera.clear_path camera.open_path camera.save_path
        camera.film""",
    "Tools": """tool.pick tool.object tool.rect tool.lasso tool.polygon tool.brush tool.sphere
        tool.erase tool.color tool.clone tool.move tool.rotate tool.scale tool.ground
        tool.turn_upright tool.leave_upright tool.measure tool.set_scale tool.origin_here tool.snap
        tool.local_axes tool.set_pivot tool.pivot_here tool.reset_pivot tool.splats
        tool.visible_only tool.click_model tool.smaller_brush tool.larger_brush
        tool.remove_corner job.cancel""",
    "Help": "help.palette help.shortcuts help.first_steps help.about",
}
MENUS: Mapping[str, tuple[Command, ...]] = {
    title: tuple(_BY_ID[id_] for id_ in ids.split()) for title, ids in _ORDER.items()
}
COMMANDS = tuple(command for menu in MENUS.values() for command in menu)
if len(COMMANDS) != len(_ALL):
    raise ValueError(f"in no menu: {sorted(_BY_ID.keys() - {c.id for c in COMMANDS})}")


OPEN_RECENT, USE_MASKS = "Open recent", "Use the masks of"


def all_menus(session: Session) -> Mapping[str, tuple[Command, ...]]:
    """The menus, the submenus whose commands hang on what is there, and the panels, by title."""
    more = {OPEN_RECENT: files.recent(session), USE_MASKS: masks.folder_commands(session)}
    return {**MENUS, **more, "Panel": view.PANELS}


def _own_keys(chosen: Command) -> Keys:
    return tuple(keys for keys in (chosen.shortcut, *chosen.aliases) if keys)


PROFILES: Mapping[str, Mapping[str, Keys]] = {
    "supersplat": {c.id: _own_keys(c) for c in COMMANDS},
    "blender": {c.id: BLENDER.get(c.id, _own_keys(c)) for c in COMMANDS},
}
_BY_KEYS = {
    profile: {keys: _BY_ID[id_] for id_, listed in table.items() for keys in listed}
    for profile, table in PROFILES.items()
}


def command(command_id: str) -> Command:
    """Return the command with this id; ``KeyError`` when there is none."""
    return _BY_ID[command_id]


def for_shortcut(keys: str, session: Session) -> Command | None:
    """Return the command of a shortcut. While flying, the fly keys move the camera."""
    letters = keys.removeprefix("Shift+").removeprefix("Alt+")
    if session.rig.is_flying and letters in FLY_KEYS:
        return None
    if keys == "Backspace" and (session.view.outline is not None or _clicks_points(session)):
        return _BY_ID["tool.remove_corner"]  # it never deletes then
    return _BY_KEYS[_profile(session)].get(keys)


def keys_of(chosen: Command, session: Session) -> Keys:
    """Return every shortcut of a command in the profile that the user chose."""
    return PROFILES[_profile(session)].get(chosen.id, ())


def shortcut_of(chosen: Command, session: Session) -> str:
    """Return the shortcut that is shown for a command; "" when it has none."""
    return next(iter(keys_of(chosen, session)), "")


def _profile(session: Session) -> str:
    wanted = session.settings.keys
    return wanted if wanted in PROFILES else "supersplat"


def run(command_id: str, session: Session) -> bool:
    """Run a command if it can be run; a disabled one leaves its reason as the hint."""
    return run_one(_BY_ID[command_id], session)


def run_one(chosen: Command, session: Session) -> bool:
    """Run a command of `all_menus`, as `run` does.

    Why a dialog does not open is a notice, too: a person who does not see it types on, and the
    letters are shortcuts.
    """
    session.hint = chosen.enabled(session)
    if session.hint:
        if chosen.title.endswith("…"):
            session.notify(Level.HINT, session.hint)
        return False
    if chosen.run(session) is not False:
        session.answered_by(chosen.id)
    return True


def new_session(settings: Settings | None = None) -> Session:
    """A session with what features do when the user has opened a scene."""
    return Session(settings, (upright.opened, level_of_detail.opened))
