"""What each picture of README and guide shows, and how the window comes to show it."""

import shutil

import numpy as np
from imgui_bundle import ImVec2
from PIL import Image

from gaga_core.export.simulation.export import SimulationExport
from gaga_studio.features import camera, commands, folders, objects, simulate, transform
from gaga_studio.features.find import association, memory_bank
from gaga_studio.features.find.search import SearchState
from gaga_studio.features.object_list import ObjectListView
from gaga_studio.session.session import Session
from gaga_studio.session.view import Mode, ToolName
from gaga_studio.system import paths
from tests.app.window.driver import KEY, Driver
from tests.shots import Film, Picture, Shot, rest

_TEAPOT = (0.44, 0.57)  # where the demo's first view shows it, parts of the picture's size


def _window(d: Driver, shot: Shot) -> None:
    _select_teapot(d)
    shot.window(d)


def _empty(d: Driver, shot: Shot) -> None:
    shot.window(d)


def _photos(d: Driver, shot: Shot) -> None:
    shot.window(d)


def _masks(d: Driver, shot: Shot) -> None:
    d.menu("Find/###Make masks…")
    dialog = d.studio.ui.scene.masks
    for n in (1, 2):  # the first compiles
        d.click("**/###Try on one photo")
        d.until(lambda n=n: dialog.n_previews == n, "one photo is done")  # type: ignore[misc]
        d.settle()
    shot.window(d)


def _models(d: Driver, shot: Shot) -> None:
    d.menu("Find/###Models…")
    shot.window(d)


def _find_objects(d: Driver, shot: Shot) -> None:
    """While the memory bank grows."""
    viewport = d.studio.viewport
    assert viewport is not None
    n = viewport.n_draws
    association.associate(d.session)
    d.until(lambda: _fraction(d.session) > 0.45, "half of the views are associated")
    rest(d)
    d.until(lambda: viewport.n_draws > n, "the groups are drawn")
    shot.now(d)
    d.settle()


def _fraction(session: Session) -> float:
    job = session.jobs.running
    return job.fraction if job is not None and session.live_labels is not None else 0.0


def _memory_bank(d: Driver, shot: Shot) -> None:
    group = _select_teapot(d)
    d.focus("Memory bank")
    decision = d.session.decisions(group)[2]
    d.click(f"**/{decision.view} {decision.mask}/##decision")
    shot.window(d)


def _timeline(d: Driver, shot: Shot) -> None:
    """The replay of the bank after its third view."""
    commands.run("view.timeline", d.session)
    timeline = memory_bank.timeline_of(d.session)
    d.until(lambda: timeline.is_open, "the growth is known")
    d.on_main(lambda: memory_bank.toggle_timeline_playing(d.session))
    d.on_main(lambda: memory_bank.go_to_step(d.session, 3))
    shot.window(d)


def _split_view(d: Driver, shot: Shot) -> None:
    """A photo left of the line, the groups right of it."""
    commands.run("camera.split_photo_groups", d.session)
    shot.window(d)


def _select(d: Driver, shot: Shot) -> None:
    """A lasso on its way, over what another one selected."""
    d.session.tool = ToolName.LASSO
    width, height = d.size
    d.focus("Select by")
    corner = d.corner
    turns = np.linspace(0.0, 1.75 * np.pi, 40)
    d.move_to(0.56 * width, 0.57 * height)
    d.engine.mouse_down(0)
    for turn in turns:
        u, v = (0.44 + 0.12 * np.cos(turn)) * width, (0.57 + 0.16 * np.sin(turn)) * height
        d.engine.mouse_move_to_pos(ImVec2(corner[0] + u, corner[1] + v))
    d.frames()
    shot.now(d)
    d.engine.mouse_up(0)


def _click(d: Driver, shot: Shot) -> None:
    """The teapot by one click, in a scene without groups."""
    commands.run("tool.object", d.session)
    d.until(lambda: d.session.jobs.running is None, "the scene was looked at")
    width, height = d.size
    d.click_picture(width * _TEAPOT[0], height * _TEAPOT[1])
    shot.window(d)


def _click_real(d: Driver, shot: Shot) -> None:
    """A real guitar by one click, without the stand that it leans on."""
    commands.run("tool.object", d.session)
    d.until(lambda: d.session.jobs.running is None, "the scene was looked at")
    means = d.session.need().scene.gaussians.means
    u, v = d.project(np.median(means, axis=0).astype(np.float64))
    d.click_picture(u - 0.01 * d.size[0], v + 0.07 * d.size[1])  # the body, next to its knobs
    shot.window(d)


def _edit(d: Driver, shot: Shot) -> None:
    _select_teapot(d)
    transform.recolor(d.session, (0.25, 0.45, 0.85))
    commands.run("tool.move", d.session)
    d.settle()
    shot.window(d)


def _search(d: Driver, shot: Shot) -> None:
    d.keys(KEY.mod_ctrl, KEY.f)
    d.engine.key_chars("largest red thing")
    document = d.session.need()
    d.until(lambda: bool(document.feature(SearchState).meant), "something is found")
    d.keys(KEY.down_arrow)
    shot.window(d)


def _camera_path(d: Driver, shot: Shot) -> None:
    pixels = d.size[1] / 580  # turns as in a picture of that height
    for turn in (0, -60, -60, -60):
        d.session.rig.orbit(turn * pixels, 6 * pixels)
        camera.add_keyframe(d.session)
    commands.run("camera.add_bookmark", d.session)
    d.focus("Camera path")
    shot.window(d)


def _export(d: Driver, shot: Shot) -> None:
    _select_teapot(d)
    d.menu("File/Export objects…")
    shot.window(d)


def _simulation(d: Driver, shot: Shot) -> None:
    """The convex parts of the teapot, and the sheet that writes them."""
    _select_teapot(d)
    camera.frame_selected(d.session)
    simulate.show_parts(d.session, SimulationExport())
    d.settle()
    with d.looking():
        shot.window(d)


def _dataset(d: Driver, shot: Shot) -> None:
    d.menu("File/Make labelled data…")
    shot.window(d)


def _modes(d: Driver, shot: Shot) -> None:
    """The same view in groups, depth and confidence, next to each other."""
    shown = []
    for mode in (Mode.GROUPS, Mode.DEPTH, Mode.CONFIDENCE):
        d.session.view.mode = mode
        shown.append(Image.fromarray(d.pixels()))
    gap, width = 8, 460
    height = round(shown[0].height * width / shown[0].width)
    whole = Image.new("RGB", (3 * width + 2 * gap, height), "white")
    for i, image in enumerate(shown):
        whole.paste(image.resize((width, height), Image.Resampling.LANCZOS), (i * (width + gap), 0))
    shot.save(whole)


def _quality(d: Driver, shot: Shot) -> None:
    """The list with its column of quality, and the views in which an object agrees least."""
    memory_bank.measure_quality(d.session)
    d.settle()
    _select_teapot(d)
    d.click("Inspector/###Quality")
    shot.window(d)


def _folders(d: Driver, shot: Shot) -> None:
    """Objects in folders and fruit under its bowl, a folder chosen, the groups in its colors."""
    session = d.session
    d.until(
        lambda: session.need().feature(SearchState).described is not None, "objects are described"
    )
    named = list(zip(session.objects().ids.tolist(), session.objects().names, strict=True))

    def named_like(*words: str) -> list[int]:
        return [g for g, name in named if g and any(word in name for word in words)]

    colored = named_like("red ", "orange", "yellow", "green", "blue", "turquoise")
    folders.put_in(session, "Toys", colored)
    folders.put_in(session, "Toys/Round", [g for g in named_like("round") if g in colored])
    folders.put_in(session, "Dishes", named_like("white", "gold"))
    bowl, fruit = _bowl_and_fruit(session)
    objects.rename(session, bowl, "bowl")
    folders.put_in(session, "Toys/Round", [bowl])
    folders.put_under(session, bowl, fruit)
    session.need().feature(ObjectListView).toggle("Dishes")
    folders.choose(session, "Toys/Round")
    session.view.mode = Mode.GROUPS
    commands.run("view.folder_colors", session)
    shot.window(d)


def _bowl_and_fruit(session: Session) -> tuple[int, list[int]]:
    """The object of fewest splats whose box has the middles of three others in it, and those."""
    scene = session.need().scene
    own = {g: scene.gaussians.means[scene.labels == g] for g in session.objects().ids.tolist() if g}
    held = {}
    for group, means in own.items():
        low, high = np.percentile(means, (2, 98), axis=0)  # of the bulk, not of stray splats
        middles = {g: np.median(m, axis=0) for g, m in own.items() if g != group}
        inside = [g for g, at in middles.items() if (low < at).all() and (at < high).all()]
        if len(inside) >= 3:
            held[group] = inside
    bowl = min(held, key=lambda group: len(own[group]))
    return bowl, held[bowl]


def _six_clicks(d: Driver, shot: Shot) -> None:
    """Open, find, click, isolate, export: what the guide's film shows."""
    film, session = Film(d, shot), d.session
    shutil.rmtree(paths.exports(), ignore_errors=True)
    width, height = d.size
    d.move_to(0.5 * width, 0.85 * height)
    d.frames()
    film.see()
    for ref in ("Viewport/Try the demo", "**/###Find objects"):
        d.engine.mouse_move(f"//{ref}")
        d.frames()
        film.see()
        d.engine.mouse_click(0)
        d.frames(3)
        for share in (0.25, 0.6) if "Find" in ref else ():
            d.until(lambda share=share: _fraction(session) > share, "objects")  # type: ignore[misc]
            d.frames()
            film.see(0.6)
        d.settle()
        session.notices = ()
        film.see()
    width, height = d.size
    d.move_to(width * _TEAPOT[0], height * _TEAPOT[1])
    d.settle()
    film.see()
    d.engine.mouse_click(0)
    d.settle()
    film.see()
    for ref in ("Inspector/###Isolate", "Inspector/###Export…", "Export/###Export now"):
        d.engine.mouse_move(f"//{ref}")
        d.frames()
        film.see()
        d.engine.mouse_click(0)
        d.frames(3)
        d.settle()
        film.see(2.5 if "now" in ref else 0.9)
    film.save(shot.path.with_suffix(".gif"))


def _select_teapot(d: Driver) -> int:
    """Click the object at the middle and name it; its group."""
    width, height = d.size
    d.click_picture(width * _TEAPOT[0], height * _TEAPOT[1])
    group = d.session.selected_groups()[0]
    objects.rename(d.session, group, "teapot")
    return group


PICTURES = (
    Picture("window", "the demo scene with groups, an object selected", _window),
    Picture("empty", "the window before anything is open", _empty, opens="nothing"),
    Picture("photos", "photos, offered for reconstruction", _photos, opens="photos"),
    Picture("masks", "the dialog that makes masks, tried on one photo", _masks, opens="masks"),
    Picture("models", "the sheet of models", _models, opens="nothing"),
    Picture("find_objects", "the memory bank while it grows", _find_objects, opens="masks"),
    Picture("memory_bank", "an object, its masks, and one of them on its photo", _memory_bank),
    Picture("timeline", "the replay of the memory bank", _timeline),
    Picture("split_view", "a photo and the groups with a line between them", _split_view),
    Picture("select", "a lasso on its way, and the panel Select by", _select),
    Picture("click", "a thing selected by one click, without groups", _click, opens="masks"),
    Picture("click_real", "a real guitar by one click, not its stand", _click_real, opens="guitar"),
    Picture("edit", "an object with another color and the handles that move it", _edit),
    Picture("search", "the search box and what it found", _search),
    Picture("camera_path", "a camera path of four places", _camera_path),
    Picture("export", "the sheet that exports the scene, the selection or objects", _export),
    Picture("simulation", "convex parts of an object in the picture", _simulation),
    Picture("dataset", "the sheet that makes labelled pictures of new views", _dataset),
    Picture("six_clicks", "the way from nothing to a file, moving", _six_clicks, opens="nothing"),
    Picture("modes", "groups, depth and confidence of one view", _modes),
    Picture("folders", "objects in folders and under others, in their colors", _folders),
    Picture("quality", "how well objects agree with their masks", _quality),
)
