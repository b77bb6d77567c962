"""``gaga``: everything that the window does, without a window.

Results go to standard output (``--json`` for machines), messages and progress to standard error.
Exit status 0 only on success; Ctrl-C leaves nothing half-written.
"""

import logging
import sys
from dataclasses import dataclass
from typing import Annotated

import tyro
from tyro.conf import arg, subcommand

import gaga_core
from gaga_core.cli import output as out
from gaga_core.cli.benchmark import Benchmark
from gaga_core.cli.files import Demo, Doctor, Edit, Export, Info
from gaga_core.cli.masks import Masks
from gaga_core.cli.query import Query
from gaga_core.cli.reconstruct import Reconstruct
from gaga_core.cli.run import Run
from gaga_core.cli.scene import Associate, Compare, Evaluate, Lift, Render
from gaga_core.errors import GagaError

Command = (
    Annotated[Reconstruct, subcommand("reconstruct")]
    | Annotated[Associate, subcommand("associate")]
    | Annotated[Lift, subcommand("lift")]
    | Annotated[Render, subcommand("render")]
    | Annotated[Evaluate, subcommand("evaluate")]
    | Annotated[Compare, subcommand("compare")]
    | Annotated[Benchmark, subcommand("benchmark")]
    | Annotated[Query, subcommand("query")]
    | Annotated[Masks, subcommand("masks")]
    | Annotated[Edit, subcommand("edit")]
    | Annotated[Export, subcommand("export")]
    | Annotated[Run, subcommand("run")]
    | Annotated[Info, subcommand("info")]
    | Annotated[Doctor, subcommand("doctor")]
    | Annotated[Demo, subcommand("demo")]
)


@dataclass(frozen=True)
class Main:
    """Group any Gaussians: associate, render, evaluate, edit and export 3D Gaussian scenes."""

    command: Annotated[Command, arg(name="")]


def main(arguments: list[str] | None = None) -> int:
    """Entry point of ``gaga``; returns the exit status."""
    logging.basicConfig(format="gaga: %(message)s", level=logging.WARNING, stream=sys.stderr)
    given = sys.argv[1:] if arguments is None else arguments
    if given in (["--version"], ["-V"]):
        sys.stdout.write(f"gaga {gaga_core.__version__}\n")
        return 0
    parsed = tyro.cli(
        Main,
        prog="gaga",
        args=given,
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.OmitSubcommandPrefixes),
    )
    try:
        return parsed.command.run()
    except GagaError as error:
        out.fail(str(error))
        return 1
    except KeyboardInterrupt:
        out.fail("Stopped. Nothing was left half-written.")
        return 130


if __name__ == "__main__":
    sys.exit(main())
