"""Where networks compute."""

import re
from collections.abc import Callable

from mocap_calib.errors import MismatchError
from mocap_calib.lift.lifter import Floats32, Lifter
from mocap_calib.types import Bools

CPU = "cpu"
# joints `[B, J, 3]` and logarithms of deviations `[B, J, 2]` of poses `[B, J, 2]`: see `Lifter`
Network = Callable[[Floats32, Bools], tuple[Floats32, Floats32]]


def check_device(device: str) -> None:
    """Raise MismatchError where there is no such device ("cpu", "cuda" or "cuda:1")."""
    if device == CPU:
        return
    if not (found := re.fullmatch(r"cuda(?::(\d+))?", device)):
        raise MismatchError(f"device: expected cpu or cuda, found {device!r}; use cpu")
    import torch  # noqa: PLC0415 - takes more than a second

    if int(found[1] or 0) >= torch.cuda.device_count():
        raise MismatchError(
            f"device {device}: expected a CUDA device and a torch built for it, found none; use cpu"
        )


def describe_devices() -> dict[str, object]:
    """Return which GPUs torch can use, the CUDA it was built for, and its threads."""
    import torch  # noqa: PLC0415 - torch takes a while

    names = [torch.cuda.get_device_name(each) for each in range(torch.cuda.device_count())]
    return {"gpus": names, "cuda": torch.version.cuda, "torch_threads": torch.get_num_threads()}


def network_on(device: str, lifter: Lifter) -> Network:
    """Return what lifts poses on a device, which `check_device` has found good."""
    if device == CPU:
        return lifter
    from mocap_calib.training.module_on_device import put_on  # noqa: PLC0415 - torch

    return put_on(device, lifter)
