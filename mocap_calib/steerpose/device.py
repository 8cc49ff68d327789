"""Where the network computes: on which device, and on how many threads."""

import torch

from mocap_calib.errors import MismatchError


def use_threads(count: int) -> None:
    """Let torch use so many threads.

    Networks as small as these are slower on more than one, and reproducible on one.
    """
    torch.set_num_threads(count)


def check_device(device: str) -> None:
    """Raise MismatchError where there is no such device ("cpu" or "cuda")."""
    if device == "cuda" and not torch.cuda.is_available():
        raise MismatchError(
            "--device cuda: expected a CUDA device and a torch built for it, found none; "
            "use --device cpu"
        )
