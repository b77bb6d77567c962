"""The programs of the folder that ``make app`` makes: the window, the command, and their children.

One script for both, told apart by the name of the program. A frozen program is its own Python, so
children that are started with ``-m MODULE`` come here too.
"""

import multiprocessing
import os
import runpy
import sys
from pathlib import Path

from gaga_core.io.packed import import_packed

MODELS = "models"  # folder next to the programs: torch and what reads the weights of models


def main() -> int:
    """Run what the name of the program and the first argument ask for; the exit status."""
    multiprocessing.freeze_support()
    program = Path(sys.executable)
    import_packed(program.parent / "_internal" / "packed")
    models = program.parent / MODELS
    if models.is_dir():
        sys.path.insert(0, str(models))  # whole packages there, of which the program has parts
    if len(sys.argv) > 2 and sys.argv[1] == "-m":
        del sys.argv[:2]
        runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
        return 0
    if "gaga" in (program.stem, os.environ.pop("GAGA_PROGRAM", "")):
        from gaga_core.cli.main import main as command

        return command()
    from gaga_studio.__main__ import main as window

    return window()


if __name__ == "__main__":
    sys.exit(main())
