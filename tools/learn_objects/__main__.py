"""``python -m tools.learn_objects make|test --work DIR``: learn the ensembles, or judge them."""

import tyro

from tools.learn_objects.learn import judge, make

if __name__ == "__main__":
    tyro.extras.subcommand_cli_from_dict({"make": make, "test": judge})
