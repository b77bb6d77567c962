"""The sheet that exports: the scene, the selection, every object or the cameras; one for all."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from imgui_bundle import ImVec2, imgui

from gaga_core.errors import counted
from gaga_core.export.cameras import CameraForm, camera_form_of
from gaga_core.export.export import MeshExport, MeshForm
from gaga_core.export.options import ExportOptions, Point
from gaga_core.export.simulation.export import SimulationExport, SimulatorForm, why_not_into
from gaga_core.io.files import too_long
from gaga_core.io.meshes import MeshFile
from gaga_core.io.splats.splat_files import WRITE_SUFFIXES, SplatFormat
from gaga_core.scene.selection.bounds import splat_box
from gaga_studio.features import camera, commands, export, measure, simulate
from gaga_studio.features.export import ExportPlan, ExportSummary, What
from gaga_studio.session.session import Session
from gaga_studio.system import paths
from gaga_studio.ui.dialogs.files import FileDialog, FilePicker, PathKind
from gaga_studio.ui.kit import widgets
from gaga_studio.ui.kit.modal import answer, begin_modal, begin_part, body_height
from gaga_studio.ui.kit.number_fields import drag, drag_point
from gaga_studio.ui.kit.path_field import path_field
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face, T

_CAMERA_FORMS: tuple[tuple[CameraForm, str, str, str], ...] = (
    (
        CameraForm.CAMERAS_JSON,
        "",
        "cameras.json",
        "As trainings of 3D Gaussian Splatting write them; viewers of splats read them.",
    ),
    (
        CameraForm.TRANSFORMS_JSON,
        "",
        "transforms.json",
        "For nerfstudio and instant-ngp. The photos belong next to it, into the folder images.",
    ),
    (
        CameraForm.COLMAP,
        "",
        "COLMAP",
        "A folder with cameras, images and points as text: most trainings start from these.",
    ),
)


# --- Changes of an export, in its sheet: color, count, placement, crop.

NAMES = 7.0  # width of the names of fields, ems
_SHARES = {1.0: "All", 0.75: "Three quarters", 0.5: "Half", 0.25: "A quarter", 0.1: "A tenth"}


def _draw_options(session: Session, options: ExportOptions, *, has_splats: bool) -> ExportOptions:
    """The rows of options; ``has_splats``: what is written has colors, and may be fewer."""
    degree = session.need().scene.gaussians.sh_degree
    if has_splats:
        options = _color(options, degree) if degree > 0 else options
        options = _fewer(options)
    widgets.field_name("Placement", em(NAMES))
    hint = "The middle of the export becomes the origin; all files still fit together"
    centre = widgets.tick("Middle at the origin", options.centre, hint)
    widgets.next_to("Lowest point at height 0", extra=em(2))
    hint = "Places the exported splats on the ground"
    ground = widgets.tick("Lowest point at height 0", options.ground, hint)
    options = replace(options, centre=centre, ground=ground)
    widgets.field_name("Units", em(NAMES))
    is_metric = session.need().scene.frame.is_metric
    form = f"1 {'metre' if is_metric else 'scene unit'} = %.4g in the file"
    flags = imgui.SliderFlags_.logarithmic
    changed, scale = drag("##Units", options.scale, 0.01, form, (1e-4, 1e4), flags=flags)
    widgets.tooltip("Drag, or double-click to type. A length of 2 here is twice this number there")
    options = replace(options, scale=scale) if changed and scale > 0 else options
    widgets.field_name("Crop", em(NAMES))
    return _crop(session, options)


def _up(options: ExportOptions, of: str) -> ExportOptions:
    widgets.field_name("Up", em(NAMES))
    choices = [
        (False, "", f"Y, as {of} has it", "It stands upright in other programs"),
        (True, "", "As trained", "Axes of the scene, x and y reversed, as a .ply has them"),
    ]
    return replace(
        options,
        as_trained=widgets.segmented("Up", choices, options.as_trained, why_not={}, wraps=True),
    )


def _color(options: ExportOptions, degree: int) -> ExportOptions:
    now = degree if options.sh_degree is None else min(options.sh_degree, degree)
    named = {k: f"View-dependent, degree {k}" for k in range(degree, 0, -1)}
    named[0] = "The same from every side"
    named[degree] = f"As it is (degree {degree})"
    hint = "Lower degrees make smaller files and lose reflections"
    chosen = widgets.choice("Color", named, now, em(NAMES), hint=hint)
    return replace(options, sh_degree=None if chosen == degree else chosen)


def _fewer(options: ExportOptions) -> ExportOptions:
    now = min(_SHARES, key=lambda share: abs(share - options.decimate))
    hint = "Fewer make smaller files that are drawn faster: neighbours are merged"
    chosen = widgets.choice("Splats", _SHARES, now, em(NAMES), hint=hint)
    return options if chosen == now else replace(options, decimate=chosen)


def _crop(session: Session, options: ExportOptions) -> ExportOptions:
    hint = "The box is around the selection at first, else around everything"
    is_on = widgets.tick("Only what is in a box", options.crop is not None, hint)
    if not is_on or options.crop is None:
        return replace(options, crop=_box(session) if is_on else None)
    lo, hi = options.crop
    speed = max(*(b - a for a, b in zip(lo, hi, strict=True)), 1e-6) / 300
    form = measure.number_format(session)
    widgets.field_name("  from", em(NAMES))
    moved_lo, low = drag_point("##Crop from", lo, speed, form)
    widgets.field_name("  to", em(NAMES))
    moved_hi, high = drag_point("##Crop to", hi, speed, form)
    if not (moved_lo or moved_hi):
        return options
    first = [min(a, b) for a, b in zip(low, high, strict=True)]
    last = [max(a, b) for a, b in zip(low, high, strict=True)]
    return replace(options, crop=(_point(first), _point(last)))


def _box(session: Session) -> tuple[Point, Point]:
    chosen = session.selected_indices()
    lo, hi = splat_box(session.need().scene, chosen if len(chosen) else None, share=1.0)
    return _point(lo.tolist()), _point(hi.tolist())


def _point(values: "list[float]") -> Point:
    x, y, z = values
    return float(x), float(y), float(z)


SHEET = "Export"  # its title
_CAMERAS = "file.export_cameras"
_NO_FOLDER = "COLMAP needs a folder: leave .json out of the name."
_WHATS: tuple[tuple[What, str, str, str, str], ...] = (
    ("scene", "", "Scene", "One file of all that is visible", "file.export_scene"),
    ("selected", "", "Selection", "One file of what is selected", "file.export_selected"),
    (
        "objects",
        "",
        "Objects",
        "One file for each selected object, or for each object, and groups.json with their names",
        "file.export_objects",
    ),
    (
        "simulation",
        "",
        "Simulation",
        "A rigid body of each selected object, or of each object, and the rest as what stays",
        "file.export_simulation",
    ),
    ("cameras", "", "Cameras", "The photos' cameras around what is visible", _CAMERAS),
)
_FORMS: tuple[tuple[SplatFormat, str, str, str], ...] = (
    (SplatFormat.PLY, "", "PLY", "Keeps all of the splats. Every program for splats opens it."),
    (
        SplatFormat.COMPRESSED_PLY,
        "",
        "Compressed PLY",
        "A quarter of the size, rounded. SuperSplat opens it.",
    ),
    (
        SplatFormat.SPLAT,
        "",
        "SPLAT",
        "Small, rounded, for browsers. Colors look the same from every side.",
    ),
    (SplatFormat.SPZ, "", "SPZ", "Small, rounded, for phones. Colors still change with the view."),
    (SplatFormat.SOG, "", "SOG", "Small, rounded, for browsers: PlayCanvas and SuperSplat."),
    (SplatFormat.GLB, "", "GLB", "glTF with KHR_gaussian_splatting: exact, for 3D programs."),
    (SplatFormat.USD, "", "USD", "OpenUSD 26.03, exact: for simulators and film. Needs usd-core."),
    (
        SplatFormat.HTML,
        "",
        "Web page",
        "One file that opens in any browser, also on a phone and without a network: the scene, the "
        "list of its objects, bookmarks and the camera path. It begins with the present view.",
    ),
)

_SOLIDS: tuple[tuple[MeshForm | None, str, str, str], ...] = (
    (None, "", "Splats", "For programs that know splats"),
    (MeshForm.MESH, "", "Mesh", "The closed surface with its colors, for any 3D program"),
    (
        MeshForm.COLLIDER,
        "",
        "Collider",
        "A convex solid around the surface, of at most 255 triangles, for physics engines",
    ),
    (MeshForm.BOX, "", "Box", "The smallest oriented box around it"),
)
_FILES: tuple[tuple[MeshFile, str, str, str], ...] = (
    (MeshFile.GLB, "", "GLB", "glTF, for engines and viewers. Same axes as the splats' GLB."),
    (MeshFile.OBJ, "", "OBJ", "Text, for everything else. Same axes as the splats' PLY."),
)
_SIMULATORS: tuple[tuple[SimulatorForm, str, str], ...] = (
    (SimulatorForm.USD, "OpenUSD", "scene.usd with splats, meshes and UsdPhysics"),
    (SimulatorForm.MJCF, "MJCF", "scene.xml with meshes, for MuJoCo"),
    (SimulatorForm.URDF, "URDF", "A file an object; for robots' tools"),
)
_NUMBERS = (  # of bodies: field, label, format, speed, lowest, highest, hint
    ("density", "Density", "%.0f kg/m³", 5.0, 1.0, 25_000.0, "Of objects without a weight"),
    ("friction", "Friction", "%.2f", 0.01, 0.0, 2.0, "Coefficient of sliding friction"),
    ("parts", "Parts", "at most %.0f", 0.2, 1.0, 256.0, "Convex parts of an object; 1: its hull"),
    (
        "concavity",
        "Concavity",
        "%.2f of the size",
        0.002,
        0.01,
        1.0,
        "How far a part may be from its convex hull; smaller numbers give more parts",
    ),
)


@dataclass
class ExportSheet:
    """What was chosen last, kept while the program runs."""

    what: What = "scene"
    form: SplatFormat = SplatFormat.PLY
    cameras: CameraForm = CameraForm.CAMERAS_JSON
    solid: MeshForm | None = None  # of objects, in place of their splats
    mesh_file: MeshFile = MeshFile.GLB
    simulation: SimulationExport = field(default_factory=SimulationExport)
    options: ExportOptions = field(default_factory=ExportOptions)
    path: str = ""  # as it is typed
    begins: bool = False  # it opens at its upper end, wherever it was scrolled to before
    chosen: dict[What, Path] = field(default_factory=dict)  # places that a person named
    chosen_for: tuple[str, Path] | None = None  # the scene that they are for: its name and folder
    waits: FileDialog | None = None  # the sheet comes back when a place was chosen

    def turn_to(self, what: What) -> None:
        """Export ``what``, where it stands: *Middle at the origin* was said of the former part."""
        if what != self.what:
            self.options = replace(self.options, centre=False, ground=False)
        self.what = what


def opens(
    session: Session,
    sheet: ExportSheet,
    what: What,
    form: SplatFormat | None = None,
    solid: MeshForm | None = None,
) -> None:
    """Open the sheet for ``what``; a page and meshes are asked for by name."""
    if session.document is None:
        return
    sheet.turn_to(what)
    # Other requests go back to splats.
    other = SplatFormat.PLY if sheet.form is SplatFormat.HTML else sheet.form
    sheet.form = other if form is None else form
    sheet.solid = solid
    # A box is of one scene; the rest is wanted again.
    sheet.options = replace(sheet.options, crop=None, up=camera.up_of(session))
    _propose(session, sheet)
    sheet.begins = True
    imgui.open_popup(SHEET)


def draw(session: Session, sheet: ExportSheet, files: FilePicker) -> None:
    """The whole sheet; ``files`` asks for another place."""
    if sheet.waits is not None and files.dialog is None:
        sheet.waits = None
        imgui.open_popup(SHEET)
    if not begin_modal(SHEET, em(40.5), is_possible=session.document is not None):
        return
    if sheet.begins:
        imgui.set_next_window_scroll(ImVec2(0, 0))
        sheet.begins = False
    begin_part("Choices", ImVec2(0, body_height(em(25.5))))
    _what_and_form(session, sheet)
    is_solid = sheet.what == "objects" and sheet.solid is not None
    has_splats = sheet.what not in ("cameras", "simulation") and not is_solid
    if (
        sheet.mesh_file is MeshFile.GLB
        if is_solid
        else sheet.form in (SplatFormat.GLB, SplatFormat.USD) and has_splats
    ):
        is_usd = not is_solid and sheet.form is SplatFormat.USD
        sheet.options = _up(sheet.options, "OpenUSD" if is_usd else "glTF")
    if sheet.what == "simulation":
        _bodies(session, sheet)
    else:
        sheet.options = _draw_options(session, sheet.options, has_splats=has_splats)
    _place(sheet, files)
    summary = export.summary(session, _plan(sheet))
    _says(sheet, summary)
    imgui.end_child()
    _buttons(session, sheet, summary)
    imgui.end_popup()


def _bodies(session: Session, sheet: ExportSheet) -> None:
    """The rows of bodies for simulators."""
    config = sheet.simulation.config
    for name, label, form, speed, low, high, hint in _NUMBERS:
        widgets.field_name(label, em(NAMES))
        now = getattr(config, name)
        changed, value = drag(f"##{label}", float(now), speed, form, (low, high))
        widgets.tooltip(hint)
        if changed:
            config = replace(config, **{name: type(now)(value)})
    sheet.simulation = replace(sheet.simulation, config=config)
    widgets.under_fields(em(NAMES))
    hint = "Make the bodies now, and draw the parts in the picture before anything is written"
    why_not = session.jobs.why_busy
    if widgets.button("Show convex parts", why_not=why_not, hint=hint):
        simulate.show_parts(session, sheet.simulation)
        imgui.close_current_popup()
    if simulate.shown_parts(session) is not None:
        imgui.same_line()
        if widgets.button("Hide them", hint="Draw the parts no longer"):
            simulate.hide_parts(session)


def _simulators(sheet: ExportSheet) -> None:
    """Which files are written."""
    widgets.field_name("Form", em(NAMES))
    forms = sheet.simulation.forms
    for form, label, hint in _SIMULATORS:
        if widgets.toggle(label, form in forms, hint=hint):
            chosen = tuple(f for f in SimulatorForm if (f in forms) != (f is form))
            sheet.simulation = replace(sheet.simulation, forms=chosen)
        imgui.same_line()
    imgui.new_line()


def _plan(sheet: ExportSheet) -> ExportPlan:
    form: SplatFormat | MeshExport | CameraForm | SimulationExport = sheet.form
    if sheet.what == "simulation":
        form = sheet.simulation
    if sheet.what == "cameras":
        form = sheet.cameras
    elif sheet.what == "objects" and sheet.solid is not None:
        form = MeshExport(sheet.solid, sheet.mesh_file)
    return ExportPlan(Path(sheet.path.strip()).expanduser(), sheet.what, form, sheet.options)


def _propose(session: Session, sheet: ExportSheet) -> None:
    form = sheet.cameras if sheet.what == "cameras" else sheet.form
    proposed, scene = export.proposed(session, sheet.what, form), _scene(session)
    if scene != sheet.chosen_for:
        sheet.chosen, sheet.chosen_for = {}, scene
    if (chosen := sheet.chosen.get(sheet.what)) is not None:
        proposed = chosen if _is_folder(sheet) else chosen.parent / proposed.name
    sheet.path = paths.shown(proposed)


def _scene(session: Session) -> tuple[str, Path]:
    return session.need().name, export.folder(session)


def _keep_place(sheet: ExportSheet) -> None:
    """Propose what was named when the sheet opens again, also after Cancel."""
    if (path := _plan(sheet).path).is_absolute():
        sheet.chosen[sheet.what] = path


def _what_and_form(session: Session, sheet: ExportSheet) -> None:
    off = {what: commands.command(name).enabled(session) for what, *_, name in _WHATS}
    widgets.field_name("What", em(NAMES))
    choices = [(what, icon, label, hint) for what, icon, label, hint, _ in _WHATS]
    what = widgets.segmented("What", choices, sheet.what, why_not=off, wraps=True)
    if what != sheet.what:
        sheet.turn_to(what)
        _propose(session, sheet)
    if sheet.what == "cameras":
        cameras = _form("Camera form", _CAMERA_FORMS, sheet.cameras)
        if cameras is not sheet.cameras:
            sheet.cameras = cameras
            _propose(session, sheet)
        return
    if sheet.what == "simulation":
        _simulators(sheet)
        return
    if sheet.what == "objects":
        widgets.field_name("As", em(NAMES))
        sheet.solid = widgets.segmented("As", _SOLIDS, sheet.solid, why_not={}, wraps=True)
        if sheet.solid is not None:
            sheet.mesh_file = _form("File", _FILES, sheet.mesh_file)
            return
    former, sheet.form = sheet.form, _form("Form", _FORMS, sheet.form)
    if not _is_folder(sheet) and sheet.path.endswith(former.suffix):
        sheet.path = sheet.path.removesuffix(former.suffix) + sheet.form.suffix


def _form(name: str, forms: Sequence[tuple[T, str, str, str]], current: T) -> T:
    """The row that chooses a form, and what the form is for."""
    widgets.field_name("Form", em(NAMES))
    chosen = widgets.segmented(name, forms, current, why_not={}, wraps=True)
    widgets.under_fields(em(NAMES))
    widgets.dim(next(hint for form, _, _, hint in forms if form is chosen), wrap=True)
    return chosen


def _place(sheet: ExportSheet, files: FilePicker) -> None:
    is_folder = _is_folder(sheet)
    label = "Choose…"
    room = imgui.calc_text_size(label).x + em(2)
    widgets.field_name("Folder" if is_folder else "File", em(NAMES), right=room)
    changed, sheet.path = path_field("##Path", sheet.path, Path(), only_folders=is_folder)
    widgets.tooltip(sheet.path)
    if changed:
        _follow_name(sheet)
        _keep_place(sheet)
    imgui.same_line()
    if widgets.button("Choose a place", Face(label, width=-1), hint="Choose another place"):
        imgui.close_current_popup()
        _ask(sheet, files)


def _ask(sheet: ExportSheet, files: FilePicker) -> None:
    now = _plan(sheet).path
    start = next((p for p in now.parents if p.is_dir()), Path.home())
    if _is_folder(sheet):
        dialog = FileDialog("Export into a folder", PathKind.NEW_FOLDER, start, now.name)
    else:
        suffixes = (".json",) if sheet.what == "cameras" else WRITE_SUFFIXES
        title = f"Export as {' or '.join(filter(None, (', '.join(suffixes[:-1]), suffixes[-1])))}"
        dialog = FileDialog(title, PathKind.SAVE_FILE, start, now.name, suffixes)
    dialog.action, dialog.is_placed = "Choose", sheet.what in sheet.chosen

    def chosen(path: Path) -> None:
        sheet.path = paths.shown(path)
        _follow_name(sheet)
        _keep_place(sheet)

    files.ask(dialog, chosen)
    sheet.waits = dialog


def _is_folder(sheet: ExportSheet) -> bool:
    if sheet.what == "cameras":
        return sheet.cameras is CameraForm.COLMAP
    return sheet.what in ("objects", "simulation")


def _follow_name(sheet: ExportSheet) -> None:
    """Take the form that the name asks for; a folder has none."""
    if _is_folder(sheet):
        return
    if sheet.what == "cameras":
        form = camera_form_of(Path(sheet.path))
        sheet.cameras = sheet.cameras if form is CameraForm.COLMAP else form
    else:
        sheet.form = export.form_of_name(sheet.path) or sheet.form


def _says(sheet: ExportSheet, summary: ExportSummary) -> None:
    """How much it is, and what is lost."""
    imgui.dummy(ImVec2(0, em(0.2)))
    s = "" if summary.n_files == 1 else "s"
    n_files = f" in {summary.n_files:,} file{s}" if sheet.what == "objects" else ""
    n_things = counted(summary.n_splats, "splat")
    if sheet.what == "cameras":
        n_things = counted(summary.n_cameras, "camera")
    said = " ".join(summary.lost) or "Nothing is lost."
    if sheet.what == "simulation":
        said = " ".join(summary.lost)
    else:
        about = "at most" if summary.is_most else "about"
        imgui.text_unformatted(f"{n_things}{n_files}, {about} {size_text(summary.n_bytes)}")
    widgets.dim(said, wrap=True)
    if _replaces(sheet):
        widgets.paragraph("The file that is there is replaced.")


def _replaces(sheet: ExportSheet) -> bool:
    path = _plan(sheet).path
    return not _is_folder(sheet) and not too_long(path) and path.is_file()


def size_text(n_bytes: int) -> str:
    """ "940 kB", "2.1 MB", "1.3 GB"."""
    for unit, sign in ((1e9, "GB"), (1e6, "MB")):
        if n_bytes >= unit:
            return f"{n_bytes / unit:.1f} {sign}"
    return f"{max(round(n_bytes / 1e3), 1)} kB"


def _buttons(session: Session, sheet: ExportSheet, summary: ExportSummary) -> None:
    imgui.dummy(ImVec2(0, em(0.3)))
    # The button is in sight whatever is scrolled to.
    face = Face("Replace file" if _replaces(sheet) else "Export", width=em(8), primary=True)
    if answer("Export now", face, why_not=_why_not(session, sheet, summary)):
        export.start(session, _plan(sheet))


def _why_not(session: Session, sheet: ExportSheet, summary: ExportSummary) -> str:
    name = next(command for what, *_, command in _WHATS if what == sheet.what)
    reason = commands.command(name).enabled(session)
    if reason:
        return reason
    if sheet.what == "cameras":
        return _why_no_cameras(session, sheet)
    if summary.n_splats == 0:
        return "Nothing of it is visible, so nothing can be written."
    if not sheet.path.strip():
        return "Say where to write."
    if said := too_long(_plan(sheet).path):
        return said
    if sheet.what == "simulation":
        return _why_no_bodies(session, sheet)
    if _is_folder(sheet):
        return ""
    if export.form_of_name(sheet.path) is None:
        return f"The name must end in {sheet.form.suffix}."
    return export.why_not_there(session, _plan(sheet).path)


def _why_no_bodies(session: Session, sheet: ExportSheet) -> str:
    forms = sheet.simulation.forms
    return why_not_into(_plan(sheet).path, forms) if forms else "Choose a form."


def _why_no_cameras(session: Session, sheet: ExportSheet) -> str:
    if not sheet.path.strip():
        return "Say where to write."
    if camera_form_of(_plan(sheet).path) is sheet.cameras:
        return export.why_not_there(session, _plan(sheet).path)
    return f"The name must end in {sheet.cameras}." if not _is_folder(sheet) else _NO_FOLDER
