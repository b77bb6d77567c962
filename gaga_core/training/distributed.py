"""Which team trains here: the processes that torchrun started, or this process alone."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

from gaga_core.training.engine import SINGLE_WORKER, Team


@contextmanager
def joined_team() -> Iterator[Team]:
    """The team of processes that torchrun started this one in, else `SINGLE_WORKER`."""
    if int(os.environ.get("WORLD_SIZE", "1")) <= 1:
        yield SINGLE_WORKER
        return
    # Loaded when there is a team: it imports torch.
    from gaga_core.training.torch_distributed import torch_team

    with torch_team() as team:
        yield team
