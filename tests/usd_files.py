"""What OpenUSD says of files."""

from pathlib import Path


def complaints(path: Path) -> list[str]:
    """What all validators of OpenUSD say of a file."""
    from pxr import Usd, UsdValidation

    registry = UsdValidation.ValidationRegistry()
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
    return [error.GetMessage() for error in context.Validate(Usd.Stage.Open(str(path)))]
