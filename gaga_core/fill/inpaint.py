"""Colors of a hole by an inpainting model that the user has: LaMa as TorchScript, or one like it.

LaMa (Suvorov et al. 2022, "Resolution-robust Large Mask Inpainting with Fourier Convolutions") is
published as ``big-lama.pt``: it takes an image (1, 3, H, W) and a mask (1, 1, H, W), 1 where it is
to paint, both float32 0..1 with sides that 8 divides, and returns the image (1, 3, H, W), 0..1.
Only torch reads it, in a separate process that ends with the work, whatever a model does.
Nothing is ever downloaded.
"""

import hashlib
import signal
from functools import cache
from importlib.util import find_spec
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.errors import GagaError
from gaga_core.progress import Progress, Stage

if TYPE_CHECKING:
    from torch.jit import ScriptModule

_STAGE = "Inpainting model"
_SIDE_MULTIPLE, _LEAST_SIDE = 8, 64  # of the sides that a model gets, cells
_SLACK = 0.5  # beyond 0..1: a result farther out has another range
_TRIAL = 64  # side of the picture that a model is tried on
_SECONDS = 0.1  # between two looks whether the model is done


@cache
def why_no_model() -> str:
    """Why no inpainting model can be used here; "" when one can.

    Looked up once: the window asks in every frame that shows the menu.
    """
    if find_spec("torch") is None:
        return "An inpainting model needs PyTorch, which is not installed here."
    return ""


class Inpainter:
    """A model in a separate process, which ends with the context.

    TorchScript holds no Python, but it can run any operator of torch: only files of a trusted
    source are to be loaded. ``sha256``: of the file that is expected, hexadecimal; "" = any.
    Raises ``GagaError``: no torch, no such file, another file.
    """

    def __init__(self, path: Path, sha256: str = "") -> None:
        if why := why_no_model():
            raise GagaError(why)
        if not path.is_file():
            raise GagaError(
                f"The inpainting model {path} is not there. Take another file, or none."
            )
        if sha256:
            with path.open("rb") as file:
                found = hashlib.file_digest(file, "sha256").hexdigest()
            if found != sha256.lower():
                raise GagaError(
                    f"The inpainting model {path} is another file: its SHA-256 is {found}, "
                    f"not {sha256.lower()}."
                )
        self.name = path.name
        context = SpawnContext()
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(path, theirs), daemon=True)
        self._process.start()
        theirs.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.kill()
        self._process.join()
        self._pipe.close()

    def loaded_stage(self) -> Stage[None]:
        """Wait until the model is loaded; ``GagaError`` when the file holds none."""
        yield from self._answer(f"load {self.name}")

    def painted_stage(
        self, color: DoubleArray, known: BoolArray, hole: BoolArray
    ) -> Stage[DoubleArray]:
        """``color`` (H, W, 3) with the cells of ``hole`` (H, W) as the model paints them.

        What is neither known nor hole is masked, too: the model paints it, and it is not used.
        Raises ``GagaError`` when the model fails, or returns anything but such a picture.
        """
        rows, columns = known.shape
        sides = [-(-side // _SIDE_MULTIPLE) * _SIDE_MULTIPLE for side in known.shape]
        pad = tuple((0, max(_LEAST_SIDE, s) - n) for s, n in zip(sides, known.shape, strict=True))
        image = np.clip(np.where(known[:, :, None], color, 0), 0, 1)
        image = np.pad(image, (*pad, (0, 0)), mode="symmetric")
        mask = np.pad(~known | hole, pad, mode="symmetric")
        self._pipe.send((image, mask))
        painted = yield from self._answer(f"{self.name} paints")
        result = painted[:rows, :columns]
        return np.where(hole[:, :, None], np.clip(result, 0, 1), color)

    def _answer(self, message: str) -> Stage[DoubleArray]:
        """The next message of the process; its errors are raised here."""
        try:
            while not self._pipe.poll(_SECONDS):
                yield Progress(_STAGE, 0, 0, message)
            answer: DoubleArray | str = self._pipe.recv()
        except (EOFError, OSError) as error:
            self._process.join()
            raise GagaError(
                f"The inpainting model {self.name} ended with status {self._process.exitcode}."
            ) from error
        if isinstance(answer, str):
            raise GagaError(answer)
        return answer


def trial_stage(path: Path) -> Stage[None]:
    """Load the model at ``path`` and try it on a small picture; ``GagaError`` when that fails."""
    hole = np.zeros((_TRIAL, _TRIAL), np.bool_)
    hole[_TRIAL // 4 : _TRIAL // 2, _TRIAL // 4 : _TRIAL // 2] = True
    with Inpainter(path) as model:
        yield from model.loaded_stage()
        yield from model.painted_stage(np.full((_TRIAL, _TRIAL, 3), 0.5), ~hole, hole)


def _serve(path: Path, pipe: Connection) -> None:
    """Run the model at ``path`` on what comes through the pipe: the process of an `Inpainter`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the whole group: the parent ends this one
    try:
        model = _load(path)
        pipe.send(np.zeros(0))
        while True:
            image, mask = pipe.recv()
            pipe.send(_run(path.name, model, image, mask))
    except GagaError as error:
        pipe.send(str(error))
    except EOFError:  # no more requests
        return


def _load(path: Path) -> "ScriptModule":
    import torch

    try:
        model = torch.jit.load(path, map_location="cpu")  # type: ignore[no-untyped-call]
    except (RuntimeError, ValueError, OSError) as error:
        raise GagaError(
            f"{path} is no inpainting model: it must be a TorchScript file, such as big-lama.pt."
        ) from error
    return model.eval()


def _run(name: str, model: "ScriptModule", image: DoubleArray, mask: BoolArray) -> DoubleArray:
    """What the model makes (H, W, 3) of ``image`` (H, W, 3) and ``mask`` (H, W)."""
    import torch

    planes = torch.from_numpy(image.transpose(2, 0, 1)[None].astype(np.float32))
    wanted = torch.from_numpy(mask[None, None].astype(np.float32))
    try:
        with torch.inference_mode():
            made = model(planes, wanted)
    except RuntimeError as error:  # of torch, whatever is wrong with the model
        # The sentence of an error of TorchScript, without the code that it quotes.
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        said = lines[-1] if lines else type(error).__name__
        raise GagaError(f"The inpainting model {name} failed: {said}") from error
    if not isinstance(made, torch.Tensor) or made.shape != planes.shape:
        got = tuple(made.shape) if isinstance(made, torch.Tensor) else type(made).__name__
        raise GagaError(
            f"The inpainting model {name} returned {got} for an image of "
            f"{tuple(planes.shape)}: a picture of the same size was expected."
        )
    result: DoubleArray = made[0].permute(1, 2, 0).double().numpy()
    if not np.isfinite(result).all():
        raise GagaError(f"The inpainting model {name} returned values that are not finite.")
    if result.min() < -_SLACK or result.max() > 1 + _SLACK:
        raise GagaError(
            f"The inpainting model {name} returned colors from {result.min():.3g} to "
            f"{result.max():.3g}: 0 to 1 was expected."
        )
    return result
