"""The network, as commands use it: on one thread, on a device that exists."""

import torch

from mocap_calib.errors import MismatchError
from mocap_calib.skeleton import load_skeleton
from mocap_calib.steerpose.checkpoint import load_lifter
from mocap_calib.steerpose.model import Lifter


def load_model(device: str, name: str = "people") -> Lifter:
    """The shipped lifter of that name. Raises MismatchError where there is no such device."""
    use_threads(1)  # such small networks are slower on more, and one is reproducible
    check_device(device)
    lifter, vocabulary = load_lifter(name)
    if vocabulary.keypoints != load_skeleton(vocabulary.name).keypoints:
        raise MismatchError(f"expected weights for the shipped skeleton {vocabulary.name}, found others; install mocap-calib again")
    return lifter


def use_threads(count: int) -> None:
    """How many threads torch may use."""
    torch.set_num_threads(count)


def check_device(device: str) -> None:
    """Raises MismatchError where there is no such device."""
    if device == "cuda" and not torch.cuda.is_available():
        raise MismatchError("--device cuda: expected a CUDA device and a torch built for it, found none; use --device cpu")
