"""The sheet of exports: what and which form is chosen, then files appear where it says."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import imgui
from PIL import Image

from gaga_core.arrays import UInt8Array
from gaga_core.export.cameras import CameraForm
from gaga_core.export.simulation.export import SimulatorForm
from gaga_core.io.cameras.cameras_json import read_cameras_json
from gaga_core.io.cameras.colmap import read_colmap
from gaga_core.io.splats.ply import write_ply
from gaga_core.io.splats.splat_files import SplatFormat, read_splats, write_splats
from gaga_core.scene.bake import bake
from gaga_core.scene.export_manifest import listed_files
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import Weight
from gaga_studio.features import camera, export, objects, selection, simulate
from gaga_studio.features.commands import run
from tests.app.folders import write_scene
from tests.app.window.driver import KEY, Driver, drive
from tests.pages import page_data
from tests.scenes import box_on_table, objects_scene, random_gaussians

pytestmark = pytest.mark.window

_FORMS = {"Compressed PLY": ".compressed.ply", "SPZ": ".spz", "GLB": ".glb", "Web page": ".html"}


def test_every_form_is_in_reach_in_a_small_window(display: str, tmp_path: Path) -> None:
    write_scene(tmp_path / "balls")

    def walk(d: Driver) -> None:
        sheet = d.studio.ui.export
        d.menu("File/###Export scene…")
        for form, suffix in _FORMS.items():
            d.click(f"**/###{form}")
            assert sheet.form.suffix == suffix
        d.export_to(tmp_path / "page.html")
        d.settle()
        assert page_data(tmp_path / "page.html")[0]["objects"]
        _cameras(d, tmp_path)

    drive(walk, path=tmp_path / "balls", size=(800, 500))


def _cameras(d: Driver, folder: Path) -> None:
    """In every form, from the menu's own entry; the name and the form follow each other."""
    d.session.notices = ()
    sheet, n = d.studio.ui.export, len(d.session.cameras)
    d.menu("File/###Export cameras…")
    assert sheet.path.endswith(" cameras.json")
    d.click("**/###COLMAP")
    assert Path(sheet.path).suffix == ""
    d.export_to(folder / "model")
    d.settle()
    assert len(read_colmap(folder / "model").cameras) == n
    assert d.exists("**/###Show in folder")
    d.menu("File/###Export cameras…")
    d.click("**/###cameras.json")
    d.export_to(folder / "transforms.json")  # the form follows the name
    d.settle()
    assert len(json.loads((folder / "transforms.json").read_text())["frames"]) == n
    assert sheet.cameras is CameraForm.TRANSFORMS_JSON
    d.menu("File/###Export cameras…")
    d.click("**/###cameras.json")
    d.export_to(folder / "cameras.json")
    d.settle()
    assert len(read_cameras_json(folder / "cameras.json")) == n


def test_files_are_of_the_form_that_was_chosen(display: str, tmp_path: Path) -> None:
    write_scene(tmp_path / "balls")

    def walk(d: Driver) -> None:
        session = d.session
        sheet = d.studio.ui.export
        d.click("**/###Find objects")
        d.settle()
        n = int((session.objects().ids > 0).sum())
        d.menu("File/###Export objects…")
        d.keys(KEY.escape)
        assert not d.exists("Export/###Export now")
        for form, kind in (
            ("SPZ", SplatFormat.SPZ),
            ("Compressed PLY", SplatFormat.COMPRESSED_PLY),
        ):
            d.menu("File/###Export objects…")
            d.click(f"**/###{form}")
            assert sheet.form is kind
            assert not (tmp_path / kind).exists(), "nothing before it is wanted"
            d.export_to(tmp_path / kind)
            d.settle()
            listed = json.loads((tmp_path / kind / "groups.json").read_text())["groups"]
            assert len(listed) == n
            for entry in listed:
                assert entry["file"].endswith(kind.suffix)
                assert len(read_splats(tmp_path / kind / entry["file"])) == entry["count"]
        d.menu("File/###Export objects…")  # into the folder of another export
        d.export_to(tmp_path / SplatFormat.SPZ)
        d.settle()
        for name, of in (("groups.json", SplatFormat.SPZ), ("groups-2.json", sheet.form)):
            files = listed_files(tmp_path / SplatFormat.SPZ / name)
            assert [file.name.endswith(of.suffix) for file in files] == [True] * n
            assert all(file.is_file() for file in files)
        d.menu("File/###Export meshes…")
        d.click("**/###Box")
        d.click("**/###OBJ")
        d.export_to(tmp_path / "boxes")
        d.settle()
        assert len(list((tmp_path / "boxes").glob("*.box.obj"))) == n
        selection.select_groups(session, (int(session.objects().ids[1]),))
        d.menu("File/###Export objects…")
        d.click("**/###Selection")  # the same sheet: what is written is a choice of its own
        assert sheet.path.endswith(".compressed.ply")
        d.click("**/###PLY")
        assert sheet.path.endswith(".ply")
        assert not sheet.path.endswith(".compressed.ply"), "the name follows the form"
        d.click("**/Middle at the origin")
        d.export_to(tmp_path / "one.spz")  # and the form the name
        d.settle()
        assert sheet.form.suffix == ".spz"
        means = read_splats(tmp_path / "one.spz").means
        np.testing.assert_allclose(means.min(axis=0), -means.max(axis=0), atol=0.01)
        assert len(means) == len(session.selected_indices())
        assert d.exists("**/###Show in folder")
        d.menu("Edit/###Reduce splats…")
        d.click("**/###Reduce now")
        d.settle()
        assert (session.need().history.undo_title or "").startswith("Reduce splats of ")
        run("edit.undo", session)
        assert sheet.options.centre
        d.menu("File/###Export scene…")
        assert not sheet.options.centre, "where one object was to stand says nothing of the scene"
        d.click("**/###Choose a place")
        assert d.studio.ui.files.dialog is not None
        d.keys(KEY.escape)
        assert d.exists("Export/###Export now"), "the sheet is back when no place was chosen"
        d.keys(KEY.escape)
        for _ in range(2):  # a place that was named is proposed again, also after Cancel
            d.menu("File/###Export scene…")
            first = sheet.path
            d.type_place(tmp_path / "kept" / "a.ply")
            d.click("**/###Simulation")
            at = sheet.path
            d.type_place(tmp_path / "kept" / "mine")
            d.keys(KEY.escape)
        assert Path(first).parent == tmp_path / "kept"
        assert Path(at) == tmp_path / "kept" / "mine"
        d.menu("File/###Export a web page…")
        assert sheet.form.suffix == ".html"
        assert sheet.path.endswith(".html")
        d.click("**/###GLB")
        d.click("**/###Web page")  # the last one is in reach, too
        assert sheet.form.suffix == ".html"
        d.export_to(tmp_path / "page.html")
        d.settle()
        assert len(page_data(tmp_path / "page.html")[0]["objects"]) == n + 1
        d.menu("File/###Export scene…")
        assert sheet.form is SplatFormat.PLY, "a page is asked for by its own entry of the menu"
        d.keys(KEY.escape)

    drive(walk, path=tmp_path / "balls", size=(1280, 800))


# --- Add splats and an export that loses something, by the menu and the window's own dialogs.


def test_add_splats_and_export_them_small(display: str, tmp_path: Path) -> None:
    write_splats(tmp_path / "balls.ply", objects_scene().gaussians)
    write_splats(
        tmp_path / "chair.spz", random_gaussians(300, sh_degree=1, extent=0.4), SplatFormat.SPZ
    )

    def walk(d: Driver) -> None:
        session = d.session
        n = len(session.need().scene)
        before = d.pixels()
        d.menu("File/Add splats…")
        dialog = d.studio.ui.files.dialog
        assert dialog is not None
        assert ".spz" in dialog.suffixes

        def choose(path: Path) -> None:
            shown = d.studio.ui.files.dialog
            assert shown is not None
            d.engine.item_click("//###File dialog/##Path")
            d.engine.key_chars_replace(str(path))
            d.frames(2)

        choose(tmp_path / "chair.spz")
        d.click("###File dialog/Add")
        d.settle()
        assert len(session.need().scene) == n + 300
        assert (d.pixels() != before).any()

        d.menu("File/Export scene…")
        d.export_to(tmp_path / "small.splat")
        d.settle()
        assert (tmp_path / "small.splat").stat().st_size == 32 * (n + 300)

    drive(walk, path=tmp_path / "balls.ply")


def test_bodies_are_shown_by_their_parts_and_written(display: str, tmp_path: Path) -> None:
    for package in ("coacd", "manifold3d"):
        pytest.importorskip(package, reason=f"{package} is not installed")
    write_ply(tmp_path / "a.ply", box_on_table())

    def walk(d: Driver) -> None:
        session, document = d.session, d.session.need()
        session.rig.up = np.array([0.0, -1.0, 0.0])
        objects.set_weight(session, 1, Weight("mass", 0.35))
        d.select(1)
        sheet = d.studio.ui.export
        d.menu("File/###Export for simulation…")
        assert sheet.what == "simulation"
        d.click("**/###OpenUSD")  # off: usd-core may be absent
        d.engine.item_input_value("//Export/**/##Parts", 2.0)
        d.frames()
        assert sheet.simulation.forms == (SimulatorForm.MJCF,)
        assert sheet.simulation.config.parts == 2
        plan = export.ExportPlan(tmp_path / "bodies", "simulation", sheet.simulation)
        said = export.summary(session, plan).lost
        assert said[0] == f"{document.name_of(1)} becomes a body, all else stays."
        d.click("**/###Show convex parts")
        d.settle()
        shown = simulate.shown_parts(session)
        assert shown is not None
        assert shown.world is not None
        assert shown.edges is not None
        box = bake(document.scene, indices=group_indices(document.scene, 1)).means
        corners = shown.edges.reshape(-1, 3)
        assert np.abs(corners.min(axis=0) - box.min(axis=0)).max() < 0.01
        assert np.abs(corners.max(axis=0) - box.max(axis=0)).max() < 0.01
        camera.frame_selected(session)
        with_lines = _middle(d, tmp_path)
        simulate.hide_parts(session)
        assert (_middle(d, tmp_path) != with_lines).any()
        d.menu("File/###Export for simulation…")
        d.export_to(tmp_path / "bodies")
        d.settle()
        (told,) = json.loads((tmp_path / "bodies" / "simulation.json").read_text())["objects"]
        assert told["mass"] == pytest.approx(0.35)
        assert told["convex_parts"] == sum(len(body.parts) for body in shown.world.bodies) <= 2
        assert (tmp_path / "bodies" / "scene.xml").is_file()

    drive(walk, path=tmp_path / "a.ply")


def _middle(d: Driver, folder: Path) -> UInt8Array:
    """The middle of the window."""
    d.capture(folder / "window.png")
    with Image.open(folder / "window.png") as image:
        width, height = image.size
        third = width // 3, height // 3, 2 * width // 3, 2 * height // 3
        return np.asarray(image.convert("RGB").crop(third))


def test_labelled_data_tells_its_time_only_while_it_is_made(
    display: str, grouped_copy: Path, tmp_path: Path
) -> None:
    """The sheet said 35 s where it took 65 s, on a machine that was busy."""
    out = tmp_path / "data"

    def asked(d: Driver, views: int) -> None:
        shown: list[str] = []
        if not d.exists("Labelled data/###Choose a folder…"):
            d.menu("File/###Make labelled data…")
        for name, value in (
            ("Pictures of a scene", views),
            ("Width, pixels", 64),
            ("Height, pixels", 48),
        ):
            d.type_into(f"**/##{name}", f"{value}")
        draw = imgui.text_unformatted

        def noting(text: str) -> None:
            shown.append(text)
            draw(text)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(imgui, "text_unformatted", noting)
            d.frames(3)
        said = " ".join(shown)
        assert f"{views:,} pictures of" in said
        assert re.search(r"\d (s|seconds?|min|minutes?|hours?)\b", said) is None

    def made(d: Driver) -> None:
        d.click("**/###Choose a folder…")
        d.answer_path(out)
        shares: list[float] = []

        def is_done() -> bool:
            job = d.session.jobs.running
            if job is not None and job.stage == "Make pictures" and job.fraction >= 0:
                shares.append(job.fraction)
            return job is None

        d.until(is_done, "the data set is there")
        assert (out / "index.html").is_file(), [one.text for one in d.session.notices]
        assert shares == sorted(shares), "one share for photos, holes, pictures and models"

    def walk(d: Driver) -> None:
        d.studio.ui.dataset.put("coverage", 0.0)  # of 12 photos of balls
        asked(d, 2)
        made(d)
        n_made = len(list(out.glob("images/*/*.jpg")))
        assert n_made > 0
        asked(d, 400)
        d.click("**/###Choose a folder…")
        d.answer_path(out)
        d.until(lambda: len(list(out.glob("images/*/*.jpg"))) > 8, "some more are there")
        d.on_main(d.session.jobs.cancel)
        d.settle()
        n = len(list(out.glob("images/*/*.jpg")))
        assert n > n_made
        assert d.session.notices[-1].text.startswith(f"{n} pictures stay in ")

    drive(walk, path=grouped_copy, size=(1000, 800))
