"""Splats as named arrays and back, bit for bit: those that an edit made and no file holds."""

from collections.abc import Mapping
from types import MappingProxyType

from gaga_core.arrays import AnyArray
from gaga_core.gaussians import Gaussians

_OWN = ("means", "quats", "log_scales", "logit_opacities", "sh")
_EXTRA = "extra:"  # before the names of all other columns


def columns_of(splats: Gaussians) -> dict[str, AnyArray]:
    """Every column by name."""
    own: dict[str, AnyArray] = {name: getattr(splats, name) for name in _OWN}
    return own | {_EXTRA + name: column for name, column in splats.extra.items()}


def splats_of(columns: Mapping[str, AnyArray]) -> Gaussians:
    """The splats of `columns_of`. Raises ``KeyError`` or ``ValueError`` when they are damaged."""
    extra = {k.removeprefix(_EXTRA): v for k, v in columns.items() if k.startswith(_EXTRA)}
    means, quats, log_scales, opacities, sh = (columns[name] for name in _OWN)
    return Gaussians(means, quats, log_scales, opacities, sh, MappingProxyType(extra))
