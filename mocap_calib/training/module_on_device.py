"""Lift on a GPU, by torch."""

import torch

from mocap_calib.lift.device import Network
from mocap_calib.lift.lifter import Floats32, Lifter
from mocap_calib.training.model import module_of
from mocap_calib.types import Bools


def put_on(device: str, lifter: Lifter) -> Network:
    """Return what lifts poses on a device of torch."""
    module = module_of(lifter).to(device)

    @torch.no_grad()
    def lift_there(pose: Floats32, seen: Bools) -> tuple[Floats32, Floats32]:
        """Return joints `[B, J, 3]` and logarithms of deviations `[B, J, 2]`, see `Lifter`."""
        joints, log_deviation = module(
            torch.from_numpy(pose).to(device), torch.from_numpy(seen).to(device)
        )
        return joints.cpu().numpy(), log_deviation.cpu().numpy()

    return lift_there
