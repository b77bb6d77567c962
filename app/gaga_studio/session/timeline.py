"""The replay of the memory bank: what is shown, and the bank's growth once it is known."""

from dataclasses import dataclass

from gaga_core.grouping.figures import BankGrowth
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_studio.session.view import Mode


@dataclass
class Timeline:
    """Step by step through the views of a bank; see `actions.bank_timeline`."""

    growth: BankGrowth | None = None
    bank: MemoryBank | None = None  # that ``growth`` is of
    is_open: bool = False  # the picture shows the groups known at ``step``
    is_playing: bool = False
    follows: bool = True  # the camera flies to the view of the step
    step: int = 0
    waited_s: float = 0.0  # at this step
    former_mode: Mode = Mode.COLOR  # that comes back when the replay is closed
