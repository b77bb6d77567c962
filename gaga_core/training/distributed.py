"""Training by several processes at once: each draws its own view, all take the mean step.

    torchrun --nproc-per-node 4 -m gaga_core.cli.main reconstruct ...

Gradients are added up through torch.distributed, which is imported when there is a team.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray
from gaga_core.raster.base import Gradients
from gaga_core.training.optimizer import COLUMNS, as_rows

if TYPE_CHECKING:
    from torch import Tensor

_Values = TypeVar("_Values", FloatArray, DoubleArray)


@dataclass(frozen=True)
class Team:
    """This worker among those that train the same splats; all hold equal ones at every moment."""

    rank: int = 0  # this worker's number; 0 measures, writes and reports
    size: int = 1
    device: str = "cpu"  # that sums are sent from

    def sum_in_place(self, tensors: "Sequence[Tensor]") -> None:
        """Replace each tensor by its sum over the workers."""
        if self.size > 1:
            import torch.distributed as dist

            for tensor in tensors:
                dist.all_reduce(tensor)

    def mean_in_place(self, tensors: "Sequence[Tensor]") -> None:
        """Replace each tensor by its mean over the workers."""
        self.sum_in_place(tensors)
        for tensor in tensors:
            tensor.div_(self.size)

    def mean_values(self, values: DoubleArray) -> DoubleArray:
        """Element-wise mean over the workers."""
        return self._sum(values) / self.size

    def mean(self, gradients: Gradients, n_splats: int) -> Gradients:
        """Mean of all workers' gradients; rows that a worker did not draw count as zero there.

        Screen gradient and radius are means over those who drew the splat. All columns travel as
        one array: one message a step.
        """
        if self.size == 1:
            return gradients
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

    def _sum(self, values: _Values) -> _Values:
        if self.size == 1:
            return values
        import torch

        total = torch.tensor(values, device=self.device)
        self.sum_in_place([total])
        result: _Values = total.cpu().numpy()
        return result


SINGLE_WORKER = Team()


@contextmanager
def joined_team() -> Iterator[Team]:
    """The team of processes that torchrun started this one in, as its environment variables say;
    else `SINGLE_WORKER`. It is left at the end.

    NCCL where each process of this machine has a CUDA device of its own, else gloo.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) <= 1:
        yield SINGLE_WORKER
        return
    import torch
    import torch.distributed as dist

    local, n_local = (int(os.environ.get(f"LOCAL_{k}", "0")) for k in ("RANK", "WORLD_SIZE"))
    on_cuda = torch.cuda.is_available() and torch.cuda.device_count() >= n_local > 0
    if on_cuda:
        torch.cuda.set_device(local)
    dist.init_process_group("nccl" if on_cuda else "gloo")
    try:
        yield Team(dist.get_rank(), dist.get_world_size(), f"cuda:{local}" if on_cuda else "cpu")
    finally:
        dist.destroy_process_group()
