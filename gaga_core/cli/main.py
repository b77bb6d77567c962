"""``gaga``: everything that the window does, without a window.

Results go to standard output (``--json`` for machines), messages and progress to standard error.
Exit status 0 only on success; Ctrl-C leaves nothing half-written. A reader that closes the pipe, as
``head`` does, ends the command without a word, with the status 141 of a command that SIGPIPE ends.
Switches that do not go together end it with status 2, as switches that there are none of do.
"""

import errno
import logging
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import arg, subcommand

from gaga_core.cli import output as out
from gaga_core.cli.export import DatasetCommand, ExportCommand
from gaga_core.cli.files import DemoCommand, DoctorCommand, EditCommand, InfoCommand, LodCommand
from gaga_core.cli.masks import MasksCommand, SegmentCommand
from gaga_core.cli.models import ModelsCommand
from gaga_core.cli.output import SwitchError
from gaga_core.cli.query import QueryCommand
from gaga_core.cli.run import ReconstructCommand, RunCommand
from gaga_core.cli.scene import (
    AlignCommand,
    AssociateCommand,
    BenchmarkCommand,
    CompareCommand,
    EvaluateCommand,
    LiftCommand,
    RenderCommand,
)
from gaga_core.errors import GagaError, PlainFormatter
from gaga_core.io.files import explain_os_error
from gaga_core.version import __version__

AnyCommand = (
    Annotated[ReconstructCommand, subcommand("reconstruct")]
    | Annotated[AssociateCommand, subcommand("associate")]
    | Annotated[LiftCommand, subcommand("lift")]
    | Annotated[AlignCommand, subcommand("align")]
    | Annotated[RenderCommand, subcommand("render")]
    | Annotated[EvaluateCommand, subcommand("evaluate")]
    | Annotated[CompareCommand, subcommand("compare")]
    | Annotated[BenchmarkCommand, subcommand("benchmark")]
    | Annotated[QueryCommand, subcommand("query")]
    | Annotated[SegmentCommand, subcommand("segment")]
    | Annotated[MasksCommand, subcommand("masks")]
    | Annotated[ModelsCommand, subcommand("models")]
    | Annotated[EditCommand, subcommand("edit")]
    | Annotated[ExportCommand, subcommand("export")]
    | Annotated[DatasetCommand, subcommand("dataset")]
    | Annotated[LodCommand, subcommand("lod")]
    | Annotated[RunCommand, subcommand("run")]
    | Annotated[InfoCommand, subcommand("info")]
    | Annotated[DoctorCommand, subcommand("doctor")]
    | Annotated[DemoCommand, subcommand("demo")]
)


@dataclass(frozen=True)
class Main:
    """Group any Gaussians: associate, render, evaluate, edit and export 3D Gaussian scenes."""

    command: Annotated[AnyCommand, arg(name="")]


_MISUSED = 2  # exit status of switches that cannot be
_UNREAD = 128 + 13  # exit status of what SIGPIPE ends
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # of a disk, or what is left of it for a user


def main(arguments: list[str] | None = None) -> int:
    """Entry point of ``gaga``; returns the exit status."""
    out.prepare_streams()
    try:
        try:
            return _run(arguments)
        finally:
            sys.stdout.flush()  # a closed pipe shows here at the latest
    except BrokenPipeError:
        if not out.is_unread():  # another pipe: a fault of the program
            raise
        out.discard_the_rest()
        return _UNREAD
    except OSError as error:
        if error.filename is not None or error.errno not in _FULL:
            raise
        out.fail("The disk is full: not all results were written. Free some space.")
        out.discard_the_rest()
        return 1


def _run(arguments: list[str] | None) -> int:
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(PlainFormatter("gaga: %(message)s"))
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    logging.captureWarnings(True)
    given = sys.argv[1:] if arguments is None else arguments
    if given in (["--version"], ["-V"]):
        sys.stdout.write(f"gaga {__version__}\n")
        return 0
    flat = (tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes)
    try:
        parsed = out.parsed(lambda a: tyro.cli(Main, prog="gaga", args=a, config=flat), given)
        return parsed.command.run()
    except GagaError as error:
        out.fail(str(error))
        return _MISUSED if isinstance(error, SwitchError) else 1
    except OSError as error:
        if error.filename is None:  # not about a file: a fault of the program
            raise
        out.fail(explain_os_error(error, Path(os.fsdecode(error.filename))))
        return 1
    except KeyboardInterrupt:
        out.fail("Stopped. Nothing was left half-written.")
        return 130


if __name__ == "__main__":
    sys.exit(main())
