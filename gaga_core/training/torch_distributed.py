"""A team of processes that torchrun started: gradients are averaged through torch.distributed.

    torchrun --nproc-per-node 4 -m gaga_core.cli.main reconstruct ...

Each process draws other views. `distributed.joined_team` loads this module for such a team.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import torch
import torch.distributed as dist
from torch import Tensor

from gaga_core.arrays import DoubleArray, FloatArray
from gaga_core.raster.base import Gradients
from gaga_core.training.engine import Team
from gaga_core.training.optimizer import COLUMNS, as_rows


@contextmanager
def torch_team() -> Iterator[Team]:
    """The team of this process, as torchrun's environment variables say; left at the end.

    NCCL where each process of this machine has a CUDA device of its own, else gloo.
    """
    local, n_local = (int(os.environ.get(f"LOCAL_{k}", "0")) for k in ("RANK", "WORLD_SIZE"))
    on_cuda = torch.cuda.is_available() and torch.cuda.device_count() >= n_local > 0
    device = torch.device("cuda", local) if on_cuda else torch.device("cpu")
    if on_cuda:
        torch.cuda.set_device(device)
    dist.init_process_group("nccl" if on_cuda else "gloo")
    try:
        yield _TorchTeam(device)
    finally:
        dist.destroy_process_group()


def mean_in_place(tensors: Sequence[Tensor]) -> None:
    """Replace each tensor by its mean over the team."""
    for tensor in tensors:
        dist.all_reduce(tensor)
        tensor.div_(dist.get_world_size())


class _TorchTeam:
    """`team.Team` over the default process group."""

    def __init__(self, device: torch.device) -> None:
        self.rank, self.size = dist.get_rank(), dist.get_world_size()
        self._device = device

    def mean(self, gradients: Gradients, n_splats: int) -> Gradients:
        """Mean over the team; screen gradient and radius only over those who drew the splat.

        All columns travel as one array: one message a step.
        """
        columns = {name: getattr(gradients, name) for name in (*COLUMNS, "screen", "radii")}
        widths = {name: as_rows(column).shape[1] for name, column in columns.items()}
        dense = np.zeros((n_splats, 1 + sum(widths.values())), np.float32)
        dense[gradients.indices, 0] = 1
        dense[gradients.indices, 1:] = np.concatenate(
            [as_rows(column) for column in columns.values()], axis=1
        )
        dense = self._sum(dense)
        rows = np.flatnonzero(dense[:, 0]).astype(np.int32)
        found, at = dense[rows], 1
        result: dict[str, FloatArray] = {}
        for name, column in columns.items():
            share = found[:, :1] if name in ("screen", "radii") else np.float32(self.size)
            values = found[:, at : at + widths[name]] / share
            result[name] = np.ascontiguousarray(values.reshape(len(rows), *column.shape[1:]))
            at += widths[name]
        return Gradients(rows, **result)

    def mean_values(self, values: DoubleArray) -> DoubleArray:
        """Element-wise mean over the team."""
        total = torch.from_numpy(values.copy()).to(self._device)
        dist.all_reduce(total)
        return total.cpu().numpy() / self.size

    def _sum(self, values: FloatArray) -> FloatArray:
        total = torch.from_numpy(values).to(self._device)
        dist.all_reduce(total)
        return total.cpu().numpy()
