"""Devices on which torch runs the lifting network."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from mocap_calib.errors import MismatchError
from mocap_calib.lift.lifter import Lifter
from mocap_calib.types import Bools, Floats32

if TYPE_CHECKING:
    from mocap_calib.training.model import LifterModule

CPU = "cpu"


@dataclass(frozen=True, eq=False)
class DeviceLifter(Lifter):
    """A lifter whose network runs in torch on a device such as "cuda:1"."""

    device: str

    def __call__(self, pose: Floats32, seen: Bools) -> tuple[Floats32, Floats32]:
        """Return joints `[B, J, 3]` and log standard deviations `[B, J, 2]`, see `Lifter`."""
        import torch  # noqa: PLC0415 - takes more than a second

        with torch.no_grad():
            joints, log_deviation = self._module(
                torch.from_numpy(pose).to(self.device), torch.from_numpy(seen).to(self.device)
            )
        return joints.cpu().numpy(), log_deviation.cpu().numpy()

    @cached_property
    def _module(self) -> "LifterModule":
        """The network in torch, on the device."""
        from mocap_calib.training.model import module_of  # noqa: PLC0415 - torch

        return module_of(self).to(self.device)


def on_device(lifter: Lifter, device: str) -> Lifter:
    """Return the lifter that runs on a device: numpy on "cpu", torch on "cuda" or "cuda:1".

    Raises MismatchError if the device does not exist.
    """
    check_device(device)
    return lifter if device == CPU else DeviceLifter(lifter.config, lifter.weights, device)


def check_device(device: str) -> None:
    """Raise MismatchError if a device does not exist ("cpu", "cuda" or "cuda:1")."""
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
    """Return the GPUs that torch can use, its CUDA version and its number of threads."""
    import torch  # noqa: PLC0415 - takes more than a second

    names = [torch.cuda.get_device_name(each) for each in range(torch.cuda.device_count())]
    return {"gpus": names, "cuda": torch.version.cuda, "torch_threads": torch.get_num_threads()}


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Limit torch to `count` threads: small networks are slower on more, and round differently."""
    import torch  # noqa: PLC0415 - takes more than a second

    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
