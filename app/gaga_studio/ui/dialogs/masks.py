"""The sheets that make masks, find objects from them, and add new photos and masks."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.errors import GagaError, counted
from gaga_core.grouping.associate import AssociateConfig
from gaga_core.pipeline.settings import GroupSettings, IdentitySettings
from gaga_core.segmentation.choose import ProviderEntry
from gaga_core.segmentation.models.catalogue import known_model
from gaga_core.segmentation.models.weights import models_folder
from gaga_core.settings import setting_of
from gaga_studio.features.find import association, masks, memory_bank
from gaga_studio.features.find.association import (
    FindState,
    duration_text,
    lift_mode,
    training_text,
)
from gaga_studio.features.find.masks import MaskForm, MaskPreview, MaskRequest, Views
from gaga_studio.session.notices import Request, notifies
from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings
from gaga_studio.ui.dialogs.files import (
    FileDialog,
    FilePicker,
    PathKind,
    new_folder,
    start_folder,
    stem,
)
from gaga_studio.ui.kit import icons, textures, theme, widgets
from gaga_studio.ui.kit.modal import begin_modal, begin_part, body, body_height
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


def draw_make_masks(session: Session, dialog: MaskDialog, files: FilePicker) -> None:
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
            title, name = "Export masks into a folder", f"{stem(session)} masks"
            chosen = partial(masks.export, session, dialog.form)
            files.ask(new_folder(title, session, name), chosen, EXPORT)
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


# --- making


def _make(session: Session, dialog: MaskDialog) -> bool:
    """The whole dialog; whether another model is to be chosen."""
    if imgui.is_window_appearing() or not dialog.entries:
        dialog.entries = masks.providers()
    entry = _entry(dialog)
    wants_model = False
    if imgui.get_content_region_avail().x > em(36):
        _introduction(session, dialog)
        height = body_height(em(37))
        if begin_part("Who", ImVec2(imgui.get_content_region_avail().x * 0.46, height)):
            wants_model = _providers(dialog)
        imgui.end_child()
        imgui.same_line(0, em(1))
        if begin_part("How", ImVec2(0, height)):
            _details(session, dialog, entry)
        imgui.end_child()
    else:  # all of it scrolls as one
        if begin_part("Who", ImVec2(0, body_height(em(37)))):
            _introduction(session, dialog)
            wants_model = _providers(dialog)
            _details(session, dialog, entry)
        imgui.end_child()
    _make_row(session, dialog, entry)
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
    joins = "Each photo is cut into masks; Find objects then joins them in 3D."
    has_model = masks.has_model(dialog.entries) or dialog.own
    widgets.dim(joins if has_model else masks.first_steps(), wrap=True)
    folders = masks.mask_folders(session)
    if folders:
        imgui.align_text_to_frame_padding()
        widgets.dim("Masks in use")
        imgui.same_line()
        draw_choice(session, em(12))
    if not masks.why_no_rest(session):
        _rest_button(session)
    imgui.dummy(ImVec2(0, em(0.2)))


def draw_choice(session: Session, width: float) -> None:
    """A drop-down of the mask folders of the scene."""
    folders = masks.mask_folders(session)
    now = session.provider if session.provider in folders else next(iter(folders), "")
    imgui.set_next_item_width(width)
    hint = "Which masks are shown, and which Find objects takes"
    chosen = widgets.combo("Masks in use", {name: name for name in folders}, now, hint=hint)
    if chosen != now:
        masks.choose(session, chosen)


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
        widgets.dim("Choose a segmenter.")
        return
    with theme.face(strong=True):
        widgets.paragraph(entry.title)
    facts = _facts(entry)
    if facts:
        widgets.dim(f"{facts[0].upper()}{facts[1:]}.", wrap=True)
    if not entry.is_available:
        imgui.dummy(ImVec2(0, em(0.2)))
        widgets.paragraph(entry.reason)
        if entry.page and widgets.button("Get", Face("Get it…", primary=True)):
            imgui.close_current_popup()
            session.request = Request.MODELS
            masks.ask_model(session, known_model(entry.name))
        imgui.same_line()
        if entry.page and widgets.button("Copy the address", Face("Copy the address of its page")):
            imgui.set_clipboard_text(entry.page)
        return
    _settings(session, dialog, entry)
    _preview(session, dialog)


def _settings(session: Session, dialog: MaskDialog, entry: ProviderEntry) -> None:
    request = dialog.request
    settings = request.settings
    try:
        kind = masks.settings_family(entry)
    except GagaError as error:
        widgets.paragraph(str(error))
        return
    if masks.has_profile(entry):
        was = settings.profile == "paper"
        hint = "SAM: 64 points a side, predicted IoU 0.7; EntitySeg: no mask is dropped"
        is_paper = widgets.tick("As in the paper", was, hint)
        if is_paper != was:
            settings = masks.with_profile(settings, paper=is_paper)
    for slider in masks.SLIDERS[kind]:
        changed, value = _slider(slider, masks.part_of(settings, slider, entry))
        widgets.tooltip(slider.hint)
        if changed:
            settings = masks.with_value(settings, slider, entry, value)
    views = widgets.segmented("Which photos", _VIEWS, request.views, why_not={}, wraps=True)
    hint = "Also where masks of the same settings are there already"
    redo = widgets.tick("Make them again", request.redo, hint)
    use_depth = request.use_depth
    if kind == "regions":
        hint = "Separates an object from its support; takes a little longer"
        use_depth = widgets.tick("Use the depth of the splats", use_depth, hint)
    dialog.request = replace(
        request, settings=settings, views=views, redo=redo, use_depth=use_depth
    )


def _slider(slider: masks.Slider, part: object) -> tuple[bool, float]:
    about, value = setting_of(part, slider.field), getattr(part, slider.field)
    title, (low, high) = about.title, about.range
    with theme.face(scale=0.93):
        widgets.dim(title)
    imgui.set_next_item_width(-1)
    if isinstance(value, int):
        return widgets.slider(f"##{title}", value, round(low), round(high), "%d")
    flags = imgui.SliderFlags_.always_clamp
    if slider.is_logarithmic:
        flags |= imgui.SliderFlags_.logarithmic
    return widgets.slider(f"##{title}", float(value), low, high, "%.2f", flags)


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
    dialog.view = widgets.combo("Photo", {name: name for name in names}, dialog.view)
    if job is not None:
        imgui.progress_bar(max(job.fraction, 0.0), ImVec2(-em(5), 0), job.message or job.stage)
        imgui.same_line()
        if widgets.button("Stop", Face(width=-1), why_not="It stops." if job.is_cancelling else ""):
            session.jobs.cancel()
    _picture(session, dialog)


def _picture(session: Session, dialog: MaskDialog) -> None:
    preview, folder = dialog.preview, session.need().project.folder
    aspect = textures.aspect(session, dialog.view)
    width = min(imgui.get_content_region_avail().x, em(24))
    if preview is None or preview.view != dialog.view or folder is None:
        textures.place(textures.photo(session, dialog.view), width, aspect)
        return
    path = folder.image_paths.get(preview.view)
    texture = None
    if path is not None and session.images is not None:
        labels = np.asarray(preview.labels, np.int32)
        load = partial(textures.tint_masks, path, lambda: labels, None, textures.LARGE, {})
        texture = session.images.texture(f"preview {dialog.n_previews}", load)
    seconds = f" in {preview.seconds:.1f} s" if preview.seconds else ""
    stale = ", with other settings" if preview.request != dialog.request else ""
    widgets.dim(f"{counted(preview.n_masks, 'mask')}{seconds}{stale}")
    textures.place(texture, width, aspect)
    if dialog.n_seen != dialog.n_previews:  # what was asked for is seen
        dialog.n_seen = dialog.n_previews
        imgui.set_scroll_here_y(1.0)


# --- the row of buttons


def _make_row(session: Session, dialog: MaskDialog, entry: ProviderEntry | None) -> None:
    imgui.dummy(ImVec2(0, em(0.3)))
    why_not = masks.why_not(session, entry)
    n = len(masks.photos_of(session, dialog.request.views))
    photos = counted(n, "photo")
    text = f"Make masks of {photos}{_duration(session, dialog, n)}"
    if widgets.button("Make", Face(text, icons.RUN, primary=True), why_not=why_not):
        imgui.close_current_popup()
        masks.make(session, dialog.request)
    _close()


def _rest_button(session: Session) -> None:
    hint = f"Next to those of {session.provider}, made as these were"
    if widgets.button("The others", Face(masks.rest_title(session)), hint=hint):
        imgui.close_current_popup()
        masks.make_rest(session)


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
    with body("Forms"):
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


# --- The sheet Find objects: the preset, and the switches of the paper, folded away.

FIND_OBJECTS = "Find objects"
_NAMES = 11.0  # width of the names of fields, ems
_PRESETS = (
    ("robust", "", "Robust", "Groups by the agreement of all views"),
    ("paper", "", "Paper", "The paper's text: memory bank view by view, trained identities"),
    ("released", "", "Released", "The paper's released code, where it differs from the text"),
)
_IDENTITIES = {
    "preset": "As in the preset",
    "none": "None",
    "vote": "By vote, in seconds",
    "refine": "By vote, then a few training steps",
    "paper": "Trained from zeros, as published",
}
_DEPTHS = {
    "expected": "Expected",
    "median": "Median",
    "none": "None: all behind the mask",
    "front": "None: front 20 % of each patch",
}
_ORDERS = {
    "name": "By name",
    "string": "By name, 10 before 2",
    "coverage": "Widest views first",
}
_PSEUDO = {"masks": "Masks with their groups", "bank": "The splatted bank"}
_PIXELS = {0: "All, as published", 16384: "16,384: a thirtieth of the time"}
_VOID = {"ignore": "Left out", "train": "Trained as no group"}
C = TypeVar("C", GroupSettings, IdentitySettings)


def draw_find_objects(session: Session) -> None:
    """The sheet, while it is open."""
    if not begin_modal(FIND_OBJECTS, em(32), is_possible=session.document is not None):
        return
    _head(session)
    with body("Switches", em(24)):
        _association(session)
        _identities(session)
    _find_row(session)
    imgui.end_popup()


def _head(session: Session) -> None:
    widgets.dim("Joins the masks of all photos in 3D into objects.", wrap=True)
    settings = session.settings
    preset = widgets.segmented("Preset", _PRESETS, settings.preset, why_not={}, wraps=True)
    if preset != settings.preset:
        session.change_settings(replace(settings, preset=preset))
    imgui.same_line(0, em(1))
    draw_choice(session, -1)


def _association(session: Session) -> None:
    """Switches of section 3.2 of the paper; what they show at first is what the preset has."""
    if not widgets.section("Memory bank (section 3.2)"):
        return
    state, preset = session.feature(FindState), AssociateConfig.of(session.settings.preset)
    groups = state.groups
    threshold = groups.threshold or preset.threshold
    changed, threshold = _number(groups, "threshold", threshold)
    widgets.tooltip("Least share of a mask's splats in a group that it joins; published: 0.1")
    if changed:
        groups = replace(groups, threshold=threshold)
    f = preset.gate.iqr_factor if groups.inlier_factor is None else groups.inlier_factor
    changed, f = _number(groups, "inlier_factor", f)
    widgets.tooltip("Depths up to Q3 + f times the IQR of a mask's depths count; published: 1")
    if changed:
        groups = replace(groups, inlier_factor=f)
    groups = _choice(groups, "depth", _DEPTHS, groups.depth or preset.depth)
    state.groups = _choice(groups, "order", _ORDERS, groups.order or preset.order)


def _identities(session: Session) -> None:
    """Switches of section 3.3."""
    if not widgets.section("Identity encodings (section 3.3)"):
        return
    settings, state = session.settings, session.feature(FindState)
    chosen = widgets.choice("Identities", _IDENTITIES, settings.identities, em(_NAMES))
    if chosen != settings.identities:
        session.change_settings(replace(settings, identities=chosen))
    identities = state.identities
    lift = identities.config(settings.preset, lift_mode(settings) or "vote")
    steps = setting_of(identities, "lift_iterations")
    widgets.field_name(steps.title, em(_NAMES))
    changed, n = imgui.input_int(f"##{steps.title}", lift.paper.iterations, 1000)
    widgets.tooltip("Of identities that are trained from zeros; published: 10,000")
    if changed:
        identities = replace(identities, lift_iterations=int(steps.clamped(n)))
    hint, n = "Of a view, while identities are trained from zeros", lift.paper.rows.per_view
    title = setting_of(identities, "pixels").title
    pixels = widgets.choice(title, {n: f"{n:,}"} | _PIXELS, n, em(_NAMES), hint=hint)
    if pixels != n:
        identities = replace(identities, pixels=pixels)
    hint = "What identities are trained on: figure 2 and the released code, or the text"
    identities = _choice(identities, "pseudo", _PSEUDO, lift.pseudo, hint)
    void = "train" if lift.paper.rows.train_void else "ignore"
    state.identities = _choice(identities, "void", _VOID, void)


def _find_row(session: Session) -> None:
    imgui.dummy(ImVec2(0, em(0.2)))
    busy, state = _busy(session), session.feature(FindState)
    no_masks = "" if len(session.masks) else "This scene has no masks. Use Make masks."
    mode = lift_mode(session.settings)
    then = " and train" if mode == "paper" else ""
    options = state.identities.config(session.settings.preset, "paper")
    hint = training_text(options, session.cameras) if then else ""
    face = Face(f"Find objects{then}", icons.RUN, primary=True)
    if widgets.button("Find", face, why_not=busy or no_masks, hint=hint):
        imgui.close_current_popup()
        association.associate(session)
    imgui.same_line()
    bank = session.need().scene.bank
    why_not = busy or no_masks or ("" if bank else "There are no groups of masks yet.")
    hint = "Identities of the groups that are here; the groups stay"
    if widgets.button("Lift", Face("Lift only"), why_not=why_not, hint=hint):
        imgui.close_current_popup()
        association.lift(session)
    imgui.same_line()
    as_preset = state.groups == GroupSettings() and state.identities == IdentitySettings()
    as_preset &= session.settings.identities == Settings().identities
    same = "All settings are those of the preset." if as_preset else ""
    if widgets.button("Reset", why_not=same, hint="Take every switch from the preset"):
        state.groups, state.identities = GroupSettings(), IdentitySettings()
        session.change_settings(replace(session.settings, identities="preset"))
    _close()


def _busy(session: Session) -> str:
    """Why nothing can be started now."""
    job = session.jobs.running
    return "" if job is None else f"{job.title} is still running."


def _close() -> None:
    """The last button of a row."""
    imgui.same_line()
    if widgets.button("Close"):
        imgui.close_current_popup()


def _number(config: GroupSettings, name: str, value: float) -> tuple[bool, float]:
    about = setting_of(config, name)
    widgets.field_name(about.title, em(_NAMES))
    return widgets.slider(f"##{about.title}", value, *about.range)


def _choice(config: C, name: str, named: Mapping[str, str], now: str, hint: str = "") -> C:
    """Draw the field ``name`` of ``config``, which is ``now``; return it with what was chosen."""
    title = setting_of(config, name).title
    chosen = widgets.choice(title, named, now, em(_NAMES), hint=hint)
    return config if chosen == now else replace(config, **{name: chosen})  # type: ignore[arg-type]


# --- The sheet Add new photos and masks: what joins, and what happens to what a person did.

ADD_VIEWS = "Add new photos and masks"
_NAMED = 4  # photos


def draw_add_views(session: Session) -> None:
    """The sheet, while it is open."""
    if not begin_modal(ADD_VIEWS, em(30), is_possible=session.document is not None):
        return
    draw_choice(session, -1)
    names, bare = memory_bank.new_views(session), memory_bank.text_on_bare_photos(session)
    n = len(names)
    shown = ", ".join(names[:_NAMED]) + (", …" if n > _NAMED else "")
    if names:
        which = "has masks that are" if n == 1 else "have masks that are"
        widgets.dim(f"{n:,} photo{'' if n == 1 else 's'} {which} not used yet: {shown}", wrap=True)
    if bare:
        widgets.dim(bare, wrap=True)
        if not masks.why_no_rest(session):
            _rest_button(session)
    widgets.dim(
        "Only these are processed: their masks join the objects, or make new ones.", wrap=True
    )
    imgui.dummy(ImVec2(0, em(0.2)))
    for sentence in memory_bank.consequences_of_adding(session):
        widgets.dim(f"• {sentence}", wrap=True)
    imgui.dummy(ImVec2(0, em(0.2)))
    busy = _busy(session)
    face = Face("Add", icons.RUN, primary=True)
    if widgets.button("Add views", face, why_not=busy or memory_bank.why_no_new_views(session)):
        imgui.close_current_popup()
        memory_bank.add_views(session)
    _close()
    imgui.end_popup()
