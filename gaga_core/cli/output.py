"""What the command prints, and the options that several commands share.

Messages and progress go to standard error, results to standard output. What is printed may quote
files: all of it is made `errors.plain_text`, so that no terminal obeys it.
"""

import ast
import inspect
import json
import os
import select
import signal
import sys
import textwrap
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import fields
from io import StringIO, TextIOWrapper
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol, TypeVar

from rich.console import Console
from rich.table import Table
from rich.text import Text
from tyro.conf import Positional, arg

from gaga_core.errors import LONGEST_LINE, GagaError, plain_text
from gaga_core.pipeline.settings import GroupSettings, IdentitySettings
from gaga_core.progress import Stage, show_stage

if TYPE_CHECKING:
    from gaga_core.scene.project import Project

T = TypeVar("T")


class _Console(Console):
    """One that leaves a closed pipe to `main.main`, as plain writing does."""

    def on_broken_pipe(self) -> None:
        """Raise the error, instead of ending with status 1."""
        raise BrokenPipeError


_messages = _Console(stderr=True, highlight=False, emoji=False)


def say(text: str) -> None:
    """A message for the person at the terminal."""
    _messages.print(plain_text(text, LONGEST_LINE), markup=False, soft_wrap=True)


def fail(text: str) -> None:
    """The one sentence of a failure."""
    shown = plain_text(f"gaga: {text}", LONGEST_LINE)
    _messages.print(shown, markup=False, style="red", soft_wrap=True)


def line(text: str) -> None:
    """One line of the result, for a person or a script."""
    sys.stdout.write(plain_text(text, LONGEST_LINE) + "\n")


def parsed(parse: Callable[[list[str]], T], given: list[str]) -> T:
    """The arguments as ``parse`` reads them; its messages quote those that are wrong."""
    plain = [plain_text(argument) for argument in given]
    if plain == given:
        return parse(given)
    try:
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            return parse(given)
    except SystemExit:
        parse(plain)  # says the same
        raise


def prepare_streams() -> None:
    """Send nowhere what goes to a stream that is closed from the start, as by ``>&-``.

    Characters that standard output has no code for are shown as escapes.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open("w"))  # noqa: SIM115  # to the end
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def is_unread() -> bool:
    """Whether the reader of standard output or standard error has closed its end of the pipe."""
    if sys.platform == "win32":  # reports a closed pipe as another error
        return False
    closed = select.poll()
    for stream in (sys.stdout, sys.stderr):
        closed.register(stream.fileno(), 0)
    return any(event & select.POLLERR for _, event in closed.poll(0))


def discard_the_rest() -> None:
    """Send what is still to be printed nowhere, so that the end of the process does not fail."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        os.dup2(nowhere, stream.fileno())


def follow(stage: Stage[T], *, compiles: bool = False) -> T:
    """Run ``stage`` with a progress bar and ETA; Ctrl-C closes it, so nothing half-made stays.

    ``compiles``: its kernels are compiled first where that was not done yet.
    """
    if compiles:
        from gaga_core.pipeline.compile_kernels import after_warm_up

        stage = after_warm_up(stage)
    with _interrupt_that_lasts() as raise_if_interrupted:
        return show_stage(stage, _messages, lambda _: raise_if_interrupted())


@contextmanager
def _interrupt_that_lasts() -> Iterator[Callable[[], None]]:
    """Yield a function that raises ``KeyboardInterrupt`` once Ctrl-C was pressed.

    Where Ctrl-C meets a callback of a C library, such as a compiler of kernels, Python prints the
    exception and goes on: it is raised again at the next step.
    """
    pressed = False

    def remember(number: int, frame: FrameType | None) -> None:
        nonlocal pressed
        pressed = True
        signal.default_int_handler(number, frame)

    def raise_if_interrupted() -> None:
        if pressed:
            raise KeyboardInterrupt

    is_ours = threading.current_thread() is threading.main_thread()
    is_ours = is_ours and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_ours:
        signal.signal(signal.SIGINT, remember)
    try:
        yield raise_if_interrupted
    finally:
        if is_ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def open_project(path: Path) -> "Project":
    """What a person calls a scene: a folder, a file of splats, or a saved project."""
    from gaga_core.scene.project import open_path_stage

    return follow(open_path_stage(path))


def result(values: Mapping[str, object], *, as_json: bool) -> int:
    """Print the result of a command: one JSON object, or aligned lines for a person.

    Returns 0, the exit status.
    """
    if as_json:
        sys.stdout.write(json.dumps(values, indent=2).replace("\x7f", "\\u007f") + "\n")
        return 0
    width = max((len(key) for key in values), default=0)
    for key, value in values.items():
        line(f"{key.replace('_', ' '):<{width}}  {_readable(value)}")
    return 0


def object_names(objects: object, most: int = 0) -> str:
    """The names in a list of objects (`pipeline.describe.list_objects`), background last.

    At most ``most`` of them and how many more there are; 0: all. One that lies under another says
    so: "lid (under teapot)".
    """
    assert isinstance(objects, list)
    names = {entry["group"]: str(entry["name"]) for entry in objects}
    ordered = sorted(objects, key=lambda entry: bool(entry["background"]))
    shown = [
        str(entry["name"]) + (f" (under {names[above]})" if (above := entry["parent"]) else "")
        for entry in ordered
    ]
    more = len(shown) - most if 0 < most < len(shown) else 0
    if more:
        shown = [*shown[:most], f"and {more:,} more (gaga info has all)"]
    return "; ".join(shown) or "none"


def folder_names(folders: object, objects: object) -> str:
    """The folders of the object list with the names of their objects."""
    assert isinstance(folders, dict)
    assert isinstance(objects, list)
    names = {entry["group"]: str(entry["name"]) for entry in objects}
    inside = {
        path: ", ".join(names[group] for group in groups if group in names) or "empty"
        for path, groups in folders.items()
    }
    return "; ".join(f"{path}: {shown}" for path, shown in inside.items()) or "none"


def say_what_a_project_keeps(scene: Path, *, adds: bool) -> None:
    """Say that a saved project has groups of its own; ``adds``: new views joined those there."""
    if (scene / "gaga" / "project.json").is_file():
        cure = "choose Find, Add new photos and masks" if adds else "associate"
        say(f"The saved project of this scene keeps its own groups until you {cure} there.")


def say_what_is_not_drawn(scene: Path) -> None:
    """Say that pictures show the scene without the edits that were saved of it."""
    if (scene / "gaga" / "project.json").is_file():
        say(
            "Edits and objects of the saved project are not drawn. A film (--video) and gaga "
            "export --what masks show them."
        )


class Scores(Protocol):
    """A report that can be a table or plain values."""

    def table(self) -> list[list[str]]:
        """Rows of text, headings first."""
        ...

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        ...


def scores(report: Scores, *, as_json: bool) -> int:
    """Print a report on standard output: as one JSON object, or as a table; returns 0."""
    if as_json:
        return result(report.to_json(), as_json=True)
    table(report.table())
    return 0


def table(rows: list[list[str]]) -> None:
    """Print rows of text as a table, headings first."""
    shown = Table()
    for heading in rows[0]:
        shown.add_column(_cell(heading))
    for row in rows[1:]:
        shown.add_row(*map(_cell, row))
    _Console(highlight=False).print(shown)


def _cell(text: str) -> Text:
    return Text(plain_text(text))


def _readable(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{value:,}"
    if isinstance(value, list | tuple):
        return ", ".join(str(v) for v in value) if value else "none"
    return str(value)


# --- Options that several commands share.


AsJson = Annotated[bool, arg(help="Print the result as JSON.")]
Backend = Annotated[
    Literal["auto", "cpu", "cuda"],
    arg(help="Who draws: auto takes CUDA where a self-test has passed (see gaga doctor)."),
]
AnyScene = Positional[
    Annotated[
        Path,
        arg(
            help="Scene folder, file of splats (.ply, .splat, .spz, .sog, .ksplat, .glb, .gltf, "
            ".usd) or saved project."
        ),
    ]
]
Model = Annotated[
    Path | None, arg(help="The 3D Gaussians; default: the newest model of the scene folder.")
]
Masks = Annotated[
    Path | None, arg(help="Folder of label maps; default: the only one in SCENE/masks.")
]


def options(config: Callable[..., T], *names: str, **defaults: object) -> Any:
    """Make options without a prefix of fields of a settings dataclass: ``names``, else all.

    ``defaults`` are those that differ from the class's. The help is the docstring below a field.
    """
    names = names or tuple(field.name for field in fields(config))  # type: ignore[arg-type]
    described = _docstrings(config)
    own = {field.name: field for field in fields(config)}  # type: ignore[arg-type]

    def make(**given: Any) -> T:
        with possible():
            return config(**given)

    make.__annotations__ = {
        name: Annotated[own[name].type, arg(help=described.get(name, ""))] for name in names
    }
    make.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                default=defaults.get(name, own[name].default),
                annotation=make.__annotations__[name],
            )
            for name in names
        ]
    )
    return arg(name="", constructor=make)


def _docstrings(config: Callable[..., object]) -> dict[str, str]:
    """The string below each field of a dataclass; empty where there is no source."""
    try:
        body = ast.parse(textwrap.dedent(inspect.getsource(config))).body[0]
    except OSError:
        return {}
    assert isinstance(body, ast.ClassDef)
    found: dict[str, str] = {}
    for line, below in zip(body.body, body.body[1:], strict=False):
        if isinstance(line, ast.AnnAssign) and isinstance(below, ast.Expr):
            assert isinstance(line.target, ast.Name)
            found[line.target.id] = " ".join(str(ast.literal_eval(below.value)).split())
    return found


class SwitchError(GagaError):
    """Switches that do not go together: the command ends with status 2 before it reads anything."""


@contextmanager
def possible() -> Iterator[None]:
    """Say of settings that are out of range, or exclude each other, that they cannot be."""
    try:
        yield
    except ValueError as error:
        raise GagaError(f"That cannot be: {error}.") from error


Groups = Annotated[GroupSettings, options(GroupSettings)]
Identities = Annotated[IdentitySettings, options(IdentitySettings)]
