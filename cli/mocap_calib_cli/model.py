"""The network, as commands use it: on one thread, on a device that exists."""

import torch

from mocap_calib.errors import MismatchError
from mocap_calib.steerpose.checkpoint import load_lifter
from mocap_calib.steerpose.model import Lifter
from mocap_calib.types import Skeleton

NONE = "none"


def load_model(device: str, name: str = "people") -> Lifter:
    """The lifter of that name or in that file; for geometry alone any will do. Raises MismatchError where there is no such device, and FormatError."""
    use_threads(1)  # such small networks are slower on more, and one is reproducible
    check_device(device)
    return load_lifter("people" if name == NONE else name)[0]


def vocabulary(name: str) -> Skeleton:
    """The joints that a model knows: a shipped one's, those inside a weights file, or none at all. Raises FormatError."""
    return Skeleton(NONE, (), (), (), {}) if name == NONE else load_lifter(name)[1]


def use_threads(count: int) -> None:
    """How many threads torch may use."""
    torch.set_num_threads(count)


def check_device(device: str) -> None:
    """Raises MismatchError where there is no such device."""
    if device == "cuda" and not torch.cuda.is_available():
        raise MismatchError(
            "--device cuda: expected a CUDA device and a torch built for it, found none; use --device cpu"
        )
