"""Where the network computes: on which device, and on how many threads."""

import torch

from mocap_calib.errors import MismatchError


def use_threads(count: int) -> None:
    """Let torch use so many threads.

    Networks as small as these are slower on more than one, and reproducible on one.
    """
    torch.set_num_threads(count)


def check_device(device: str) -> None:
    """Raise MismatchError where there is no such device ("cpu", "cuda" or "cuda:1")."""
    try:
        wanted = torch.device(device)
    except (RuntimeError, TypeError):
        wanted = None
    if wanted is None or wanted.type not in ("cpu", "cuda"):
        raise MismatchError(f"device: expected cpu or cuda, found {device!r}; use cpu")
    if wanted.type == "cuda" and (wanted.index or 0) >= torch.cuda.device_count():
        raise MismatchError(
            f"device {device}: expected a CUDA device and a torch built for it, found none; use cpu"
        )


def describe_devices() -> dict[str, object]:
    """Return which GPUs torch can use, the CUDA it was built for, and its threads."""
    names = [torch.cuda.get_device_name(each) for each in range(torch.cuda.device_count())]
    return {"gpus": names, "cuda": torch.version.cuda, "torch_threads": torch.get_num_threads()}
