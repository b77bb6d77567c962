"""A field for a path: Tab completes what was typed, and goes on where nothing can be added."""

import os
from pathlib import Path

from imgui_bundle import imgui

from gaga_studio.ui.kit import theme, widgets


def path_field(
    label: str,
    text: str,
    folder: Path,
    suffixes: tuple[str, ...] = (),
    *,
    only_folders: bool = False,
    must_exist: bool = False,
    hint: str = "",
    flags: int = 0,
) -> tuple[bool, str]:
    """``imgui.input_text`` for a path, which is in ``folder`` where it is relative.

    ``must_exist``: Tab goes on only from a path that is there.
    """
    goes_on = False
    known, id_ = imgui.get_state_storage(), imgui.get_id(label)

    def complete(data: imgui.InputTextCallbackData) -> int:
        nonlocal goes_on
        typed = str(data.buf)
        # Who only walks through the fields changes nothing.
        is_typed = known.get_bool(id_)
        whole = completed(folder, typed, suffixes, only_folders) if is_typed else typed
        stays = must_exist and is_typed and not _is_there(folder, typed)
        goes_on = whole == typed and not stays
        if whole != typed:
            data.delete_chars(0, data.buf_text_len)
            data.insert_chars(0, whole)
        return 0

    if not imgui.get_io().key_shift:  # Shift+Tab goes back
        flags |= imgui.InputTextFlags_.callback_completion
    hint = widgets.hint_of_field(hint)
    answer = imgui.input_text_with_hint(label, hint, theme.noted(text), flags, complete)
    if imgui.is_item_edited():
        known.set_bool(id_, True)
    elif not imgui.is_item_active():
        known.set_bool(id_, False)
    if goes_on:
        imgui.set_keyboard_focus_here()
    return answer


def _is_there(folder: Path, text: str) -> bool:
    try:
        return (folder / Path(text).expanduser()).exists()
    except (OSError, RuntimeError):  # not allowed, or the home of nobody
        return False


def completed(folder: Path, text: str, suffixes: tuple[str, ...], only_folders: bool) -> str:
    """``text`` with what all paths that begin with it have in common; a whole folder ends in "/".

    Paths are folders and files of these ``suffixes``; without any, all files, or with
    ``only_folders`` none. Letters match in either case where none match as they are typed.
    """
    place, begin = (text[: text.rfind("/") + 1], text[text.rfind("/") + 1 :])
    try:
        names = [
            f"{p.name}/" if p.is_dir() else p.name
            for p in (folder / Path(place or ".").expanduser()).iterdir()
            if (p.is_dir() or (p.suffix.lower() in suffixes if suffixes else not only_folders))
            and p.name.startswith(".") == begin.startswith(".")
        ]
    except (OSError, RuntimeError):  # not there, not allowed, or the home of nobody
        return text
    fitting = [name for name in names if name.startswith(begin)]
    low = begin.casefold()
    fitting = fitting or [name for name in names if name.casefold().startswith(low)]
    return place + os.path.commonprefix(fitting) if fitting else text  # noqa: RUF071  letters
