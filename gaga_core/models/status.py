"""What there is to say of each known model on this machine."""

from dataclasses import dataclass
from pathlib import Path

from gaga_core.models.catalogue import CATALOGUE, KnownModel
from gaga_core.models.download import partial_bytes
from gaga_core.models.lock_file import ModelLock, lock_of
from gaga_core.models.speed import seconds_a_photo
from gaga_core.models.weights import find_model

_PURPOSES = {
    "masks": "masks of photos (gaga masks)",
    "words": "objects by words (gaga query --index-with)",
    "boxes": "phrases in one view (gaga query --detector)",
}


@dataclass(frozen=True)
class ModelStatus:
    """A known model on this machine."""

    model: KnownModel
    path: Path | None  # None: not here
    lock: ModelLock | None  # of weights that were downloaded by this program
    partial_bytes: int  # of a download that was stopped
    seconds: float | None  # a photo; None = not known
    is_measured: bool  # else estimated

    @property
    def good_for(self) -> str:
        """What it is good for, in words."""
        purpose = _PURPOSES[self.model.purpose]
        return f"{purpose}; {self.model.note}" if self.model.note else purpose

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        model, lock = self.model, self.lock
        return {
            "name": model.name,
            "title": model.title,
            "purpose": model.purpose,
            "good_for": self.good_for,
            "repository": model.hub,
            "page": model.page,
            "licence": model.licence,
            "megabytes": model.megabytes,
            "is_gated": model.is_gated,
            "is_here": self.path is not None,
            "path": str(self.path or ""),
            "commit": lock.commit if lock is not None else "",
            "accepted_at": lock.accepted_at if lock is not None else "",
            "partial_bytes": self.partial_bytes,
            "seconds_a_photo": self.seconds,
            "is_measured": self.is_measured,
        }


def status_of(model: KnownModel) -> ModelStatus:
    """The state of one model; asks no network."""
    path = find_model(model)
    lock = lock_of(path) if path is not None and path.is_dir() else None
    seconds = seconds_a_photo(model) if model.purpose == "masks" else None
    return ModelStatus(
        model,
        path,
        lock,
        partial_bytes(model),
        seconds[0] if seconds else None,
        seconds[1] if seconds else False,
    )


def all_models() -> tuple[ModelStatus, ...]:
    """The state of every known model."""
    return tuple(status_of(model) for model in CATALOGUE)
