"""Dialogs of masks: who makes them and how, a try on one photo, the form of an export."""

from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.arrays import UInt8Array
from gaga_core.errors import GagaError
from gaga_core.segmentation.choose import ProviderEntry
from gaga_core.segmentation.models.catalogue import known_model
from gaga_core.segmentation.models.weights import models_folder
from gaga_studio.features.find import masks
from gaga_studio.features.find.association import duration_text
from gaga_studio.features.find.masks import MaskForm, MaskPreview, MaskRequest, Views
from gaga_studio.session.notices import Request, notifies
from gaga_studio.session.session import Session
from gaga_studio.ui.dialogs.file_dialog import FileDialog, FilePicker, PathKind
from gaga_studio.ui.dialogs.open_and_save import new_folder, start_folder, stem
from gaga_studio.ui.kit import icons, mask_images, photo_textures, theme, widgets
from gaga_studio.ui.kit.modal import begin_modal, body_height
from gaga_studio.ui.kit.requests import RequestTable
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

MAKE, EXPORT = "Make masks", "Export masks"
_VIEWS: tuple[tuple[Views, str, str, str], ...] = (
    ("train", "", "Training photos", "Objects are found in these; the others are for scores"),
    ("all", "", "All photos", "Those for testing too"),
)
_FORMS: tuple[tuple[MaskForm, str, str], ...] = (
    ("dataset", "Data set", "Photos, label maps, previews, COCO and panoptic files"),
    ("coco", "COCO", "One instances.json with run-length masks"),
    ("png", "Label maps", "One 16-bit PNG a view: the same number is the same object everywhere"),
)


@dataclass
class MaskDialog:
    """Who makes masks and how, as chosen so far."""

    entries: tuple[ProviderEntry, ...] = ()  # empty: look for models when it opens
    own: tuple[ProviderEntry, ...] = ()  # models elsewhere that the user named
    request: MaskRequest = field(default_factory=MaskRequest)
    view: str = ""  # photo to try on
    preview: MaskPreview | None = None
    n_previews: int = 0
    n_seen: int = 0  # of them, scrolled to
    reopens: bool = False  # after a file dialog
    form: MaskForm = "dataset"  # of the export


def register(table: RequestTable) -> None:
    """Answer the requests for both dialogs."""
    table.register_popup(Request.MAKE_MASKS, MAKE)
    table.register_popup(Request.EXPORT_MASKS, EXPORT)


def draw(session: Session, dialog: MaskDialog, files: FilePicker) -> None:
    """Whatever is open of them; ``files`` asks for paths."""
    if dialog.reopens and files.dialog is None:
        dialog.reopens = False
        imgui.open_popup(MAKE)
    if begin_modal(MAKE, em(46)):
        if _make(session, dialog):
            imgui.close_current_popup()
            _ask_model(session, dialog, files)
        imgui.end_popup()
    if begin_modal(EXPORT, em(28)):
        if _export(dialog):
            _ask_folder(session, dialog.form, files)
        imgui.end_popup()


def _ask_model(session: Session, dialog: MaskDialog, files: FilePicker) -> None:
    """Where another model is; then the dialog comes back."""
    dialog.reopens = True
    title = "Choose a model's folder, or a sam_vit_*.pth file in it"
    start = models_folder() if models_folder().is_dir() else start_folder(session)
    asked = FileDialog(title, PathKind.OPEN_FOLDER, start)
    files.ask(asked, lambda path: _take_model(session, dialog, path))


@notifies
def _take_model(session: Session, dialog: MaskDialog, path: Path) -> None:
    entry = masks.entry_of(path)
    dialog.own = (*(e for e in dialog.own if e.path != entry.path), entry)
    dialog.entries = ()
    _choose(dialog, entry)


def _ask_folder(session: Session, form: MaskForm, files: FilePicker) -> None:
    asked = new_folder("Export masks into a folder", session, f"{stem(session)} masks")
    files.ask(asked, lambda path: masks.export(session, form, path))


# --- making


def _make(session: Session, dialog: MaskDialog) -> bool:
    """The whole dialog; whether another model is to be chosen."""
    if imgui.is_window_appearing() or not dialog.entries:
        dialog.entries = masks.providers()
    entry = _entry(dialog)
    _introduction(session, dialog)
    height, wants_model = body_height(em(37)), False
    is_wide = imgui.get_content_region_avail().x > em(36)
    width = imgui.get_content_region_avail().x * 0.46 if is_wide else 0.0
    if imgui.begin_child("Who", ImVec2(width, height if is_wide else height * 0.5)):
        wants_model = _providers(dialog)
    imgui.end_child()
    if is_wide:
        imgui.same_line(0, em(1))
    if imgui.begin_child("How", ImVec2(0, height if is_wide else height * 0.5)):
        _details(session, dialog, entry)
    imgui.end_child()
    _actions(session, dialog, entry)
    return wants_model


def _entry(dialog: MaskDialog) -> ProviderEntry | None:
    request = dialog.request
    for entry in (*dialog.entries, *dialog.own):
        if entry.name == request.provider and (
            request.weights is None or entry.path == request.weights
        ):
            return entry
    return None


def _introduction(session: Session, dialog: MaskDialog) -> None:
    imgui.push_text_wrap_pos(0.0)
    if not masks.has_model(dialog.entries) and not dialog.own:
        widgets.dim(masks.first_steps(), wrap=True)
    else:
        widgets.dim("Each photo is cut into masks; Find objects then joins them in 3D.", wrap=True)
    imgui.pop_text_wrap_pos()
    folders = masks.mask_folders(session)
    if folders:
        imgui.align_text_to_frame_padding()
        widgets.dim("Masks in use")
        imgui.same_line()
        draw_choice(session, em(12))
    imgui.dummy(ImVec2(0, em(0.2)))


def draw_choice(session: Session, width: float) -> None:
    """A drop-down of the mask folders of the scene."""
    folders = masks.mask_folders(session)
    at = folders.index(session.provider) if session.provider in folders else 0
    imgui.set_next_item_width(width)
    changed, at = imgui.combo("##Masks in use", at, list(folders))
    widgets.tooltip("Which masks are shown, and which Find objects takes")
    if changed:
        masks.choose(session, folders[at])


def _providers(dialog: MaskDialog) -> bool:
    """The list; whether another model is to be chosen."""
    here = [e for e in (*dialog.entries, *dialog.own) if e.is_available]
    missing = [e for e in dialog.entries if not e.is_available]
    for entry in here:
        _provider(dialog, entry)
    face = Face("Another model…", icons.FOLDER)
    wants_model = widgets.button("Another model", face, hint="Choose a folder")
    if missing:
        widgets.heading("Not on this computer")
    for entry in missing:
        _provider(dialog, entry)
    return wants_model


def _provider(dialog: MaskDialog, entry: ProviderEntry) -> None:
    chosen = _entry(dialog)
    is_chosen = chosen is not None and (chosen.name, chosen.path) == (entry.name, entry.path)
    icon = icons.CHECK if entry.is_available else icons.BLANK
    with theme.text_color(theme.TEXT if entry.is_available else theme.DIM):
        label = f"{icon}  {entry.title}###{entry.name} {entry.path or ''}"
        flags = imgui.SelectableFlags_.no_auto_close_popups
        if imgui.selectable(label, is_chosen, flags)[0]:
            _choose(dialog, entry)
    if not is_chosen:
        widgets.tooltip(_facts(entry) or entry.reason)


def _choose(dialog: MaskDialog, entry: ProviderEntry) -> None:
    weights = entry.path if entry in dialog.own else None
    same = dialog.request.provider == entry.name and dialog.request.weights == weights
    if not same:
        fresh = masks.MaskRequest(views=dialog.request.views, redo=dialog.request.redo)
        dialog.request = replace(fresh, provider=entry.name, weights=weights)


def _facts(entry: ProviderEntry) -> str:
    """ "156 MB, Apache-2.0, the best choice without a graphics card"."""
    size = f"{entry.megabytes:,} MB" if entry.megabytes else ""
    return ", ".join(part for part in (size, entry.licence, entry.note) if part)


def _details(session: Session, dialog: MaskDialog, entry: ProviderEntry | None) -> None:
    if entry is None:
        widgets.dim("Choose who makes the masks.")
        return
    imgui.push_text_wrap_pos(0.0)
    with theme.face(strong=True):
        imgui.text_wrapped(entry.title)
    facts = _facts(entry)
    if facts:
        widgets.dim(f"{facts[0].upper()}{facts[1:]}.", wrap=True)
    if not entry.is_available:
        imgui.dummy(ImVec2(0, em(0.2)))
        imgui.text_wrapped(entry.reason)
        imgui.pop_text_wrap_pos()
        if entry.page and widgets.button("Get", Face("Get it…", primary=True)):
            imgui.close_current_popup()
            session.request = Request.MODELS
            masks.ask_model(session, known_model(entry.name))
        imgui.same_line()
        if entry.page and widgets.button("Copy the address", Face("Copy the address of its page")):
            imgui.set_clipboard_text(entry.page)
        return
    imgui.pop_text_wrap_pos()
    _settings(session, dialog, entry)
    _preview(session, dialog)


def _settings(session: Session, dialog: MaskDialog, entry: ProviderEntry) -> None:
    request = dialog.request
    settings = request.settings
    try:
        kind = masks.settings_family(entry)
    except GagaError as error:
        imgui.text_wrapped(str(error))
        return
    if masks.has_profile(entry):
        is_paper = settings.profile == "paper"
        changed, is_paper = widgets.checkbox("As in the paper", is_paper)
        widgets.tooltip("SAM: 64 points a side, predicted IoU 0.7; EntitySeg: no mask is dropped")
        if changed:
            settings = masks.with_profile(settings, paper=is_paper)
    for slider in masks.SLIDERS[kind]:
        value = masks.value_of(settings, slider, entry)
        changed, value = _slider(slider, value)
        widgets.tooltip(slider.hint)
        if changed:
            settings = masks.with_value(settings, slider, entry, value)
    views = widgets.segmented("Which photos", _VIEWS, request.views, why_not={})
    _, redo = widgets.checkbox("Make them again", request.redo)
    widgets.tooltip("Also where masks of the same settings are there already")
    use_depth = request.use_depth
    if kind == "regions":
        _, use_depth = widgets.checkbox("Use the depth of the splats", use_depth)
        widgets.tooltip("Tells an object from what it stands on; takes a little longer")
    dialog.request = replace(
        request, settings=settings, views=views, redo=redo, use_depth=use_depth
    )


def _slider(slider: masks.Slider, value: float) -> tuple[bool, float]:
    with theme.face(scale=0.93):
        widgets.dim(slider.label)
    imgui.set_next_item_width(-1)
    label = f"##{slider.label}"
    if slider.is_whole:
        changed, whole = imgui.slider_int(
            label, round(value), round(slider.low), round(slider.high)
        )
        return changed, float(whole)
    flags = imgui.SliderFlags_.always_clamp
    if slider.is_logarithmic:
        flags |= imgui.SliderFlags_.logarithmic
    return imgui.slider_float(label, value, slider.low, slider.high, "%.2f", flags)


# --- one photo, before all


def _preview(session: Session, dialog: MaskDialog) -> None:
    names = masks.photos_of(session, dialog.request.views)
    if not names:
        return
    if dialog.view not in names:
        active = session.active_view
        now = session.cameras[active].name if active is not None else ""
        dialog.view = now if now in names else names[0]
    imgui.dummy(ImVec2(0, em(0.2)))
    job = session.jobs.running
    why_not = masks.why_not(session, _entry(dialog))
    if widgets.button("Try on one photo", why_not=why_not, hint="See what the settings give"):

        def done(preview: MaskPreview) -> None:
            dialog.preview, dialog.n_previews = preview, dialog.n_previews + 1

        masks.try_one(session, dialog.request, dialog.view, done)
    imgui.same_line()
    imgui.set_next_item_width(-1)
    changed, at = imgui.combo("##Photo", names.index(dialog.view), list(names))
    if changed:
        dialog.view = names[at]
    if job is not None:
        imgui.progress_bar(max(job.fraction, 0.0), ImVec2(-em(5), 0), job.message or job.stage)
        imgui.same_line()
        if widgets.button("Stop", Face(width=-1), why_not="It stops." if job.is_cancelling else ""):
            session.jobs.cancel()
    _picture(session, dialog)


def _picture(session: Session, dialog: MaskDialog) -> None:
    preview, folder = dialog.preview, session.need().project.folder
    aspect = photo_textures.aspect(session, dialog.view)
    width = min(imgui.get_content_region_avail().x, em(24))
    if preview is None or preview.view != dialog.view or folder is None:
        photo_textures.place(photo_textures.photo(session, dialog.view), width, aspect)
        return
    path = folder.image_paths.get(preview.view)
    texture = None
    if path is not None and session.images is not None:
        load = partial(_mixed, path, preview)
        texture = session.images.texture(f"preview {dialog.n_previews}", load)
    seconds = f" in {preview.seconds:.1f} s" if preview.seconds else ""
    stale = ", with other settings" if preview.request != dialog.request else ""
    widgets.dim(f"{preview.n_masks} masks{seconds}{stale}")
    photo_textures.place(texture, width, aspect)
    if dialog.n_seen != dialog.n_previews:  # what was asked for is seen
        dialog.n_seen = dialog.n_previews
        imgui.set_scroll_here_y(1.0)


def _mixed(path: Path, preview: MaskPreview) -> UInt8Array:
    labels = np.asarray(preview.labels, np.int32)
    return mask_images.photo_with_masks(path, lambda: labels, None, mask_images.LARGE, {})


# --- the row of buttons


def _actions(session: Session, dialog: MaskDialog, entry: ProviderEntry | None) -> None:
    imgui.dummy(ImVec2(0, em(0.3)))
    why_not = masks.why_not(session, entry)
    n = len(masks.photos_of(session, dialog.request.views))
    photos = "1 photo" if n == 1 else f"{n:,} photos"
    text = f"Make masks of {photos}{_duration(session, dialog, n)}"
    if widgets.button("Make", Face(text, icons.RUN, primary=True), why_not=why_not):
        imgui.close_current_popup()
        masks.make(session, dialog.request)
    imgui.same_line()
    if widgets.button("Close"):
        imgui.close_current_popup()


def _duration(session: Session, dialog: MaskDialog, n: int) -> str:
    """As long as the try took for each, else as the model took before, or is likely to take."""
    preview, request = dialog.preview, dialog.request
    if preview is not None and preview.seconds and preview.request.provider == request.provider:
        text = duration_text(n * preview.seconds)
    else:
        text = masks.model_duration(session, request.provider, n)
    return f", {text}" if text else ""


# --- exporting


def _export(dialog: MaskDialog) -> bool:
    """The form of the export; whether to go on to the folder."""
    widgets.dim("The objects as every view shows them, edits included.", wrap=True)
    imgui.dummy(ImVec2(0, em(0.2)))
    for form, title, text in _FORMS:
        if widgets.radio_button(title, dialog.form == form):
            dialog.form = form
        imgui.indent(em(1.7))
        widgets.dim(text, wrap=True)
        imgui.unindent(em(1.7))
    imgui.dummy(ImVec2(0, em(0.3)))
    face = Face("Choose a folder…", icons.FOLDER, primary=True)
    goes = widgets.button("Choose a folder", face)
    imgui.same_line()
    if widgets.button("Close") or goes:
        imgui.close_current_popup()
    return goes
