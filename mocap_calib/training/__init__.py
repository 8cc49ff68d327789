"""Training of the networks: how they are trained and measured, and the devices of torch.

torch is imported where it is needed, as it takes more than a second.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mocap_calib.errors import MismatchError

if TYPE_CHECKING:
    from mocap_calib.lift.lifter import Lifter

CPU = "cpu"


@dataclass(frozen=True)
class TrainConfig:
    """How a lifter is trained; saved in its model card.

    Angles in degrees, lengths in body sizes (RMS joint distance from the centroid; about 0.55 m
    for an adult).
    """

    steps: int = 9000
    batch: int = 256
    width: int = 64
    layers: int = 4
    learning_rate: float = 2e-3
    # most rigs stand upright; the images of rolled cameras are turned upright before lifting
    roll_deg: float = 10.0
    elevation_deg: tuple[float, float] = (-15.0, 65.0)
    elevation_skew: float = 0.5  # 0: all elevations alike; more: the lower ones likelier
    distance: tuple[float, float] = (3.0, 40.0)
    # of the visible pose's RMS radius, log-uniform per pose
    noise: tuple[float, float] = (0.005, 0.06)
    outliers: float = 0.02  # share of joints that the detector puts somewhere else
    length_spread: float = 0.12  # log-normal, a limb; children and adults
    # knees of fitted skeletons are too bent: up to this share of the way to straight
    straighten: float = 0.7
    joint_spread: float = 0.03  # detectors disagree where a joint is
    joint_dropout: float = 0.6  # up to this share of joints belongs to other layouts
    occlusion: float = 0.25  # up to this share of the remaining joints is missing
    bodies: int = 40_000  # procedural bodies to draw from, where they are asked for
    procedural: float = 0.5  # share of the procedural bodies beside poses of files
    seed: int = 0


OUTLIER_NOISE = 0.5  # of the visible pose's RMS radius: noise of the joints put somewhere else
HIDDEN_LIMBS = 0.2  # share of the poses one of whose limbs is hidden
WARM_UP = 0.05  # share of the training steps in which the learning rate rises
LARGEST_GRADIENT = 1.0
UNCERTAINTY_WEIGHT = 0.1  # of the Laplace likelihood in the loss of a lifter
EVALUATION_SEED = 12345  # all networks are measured on the same examples
EVALUATION_EXAMPLES = 32 * TrainConfig.batch  # views, or pairs of them, to measure a network on

OWN_SPECIES_LEAST_POSES = 20  # 3D poses of a calibrated recording that can be learnt from
OWN_SPECIES_LARGEST_ERROR = 3.0  # median reprojection errors: joints beyond it are left out
# settings of TrainConfig: nobody has said from where the species is seen, or that it has knees
OWN_SPECIES_TRAINING = {"elevation_deg": (-60, 88), "roll_deg": 20, "straighten": 0}


@dataclass(frozen=True)
class PairsConfig:
    """The paper's training pairs (appendix C) for the rotation-token network."""

    cameras: int = 100  # on the hemisphere
    rolls: int = 20  # of each, about its axis
    pairs: int = 3000  # of views, split 7:2:1
    noise: float = 0.03  # of the visible pose's RMS radius
    masked: tuple[float, float] = (0.1, 0.3)  # share of joints
    # share of poses that lack further joints, as detectors' layouts do; not in the paper
    layouts: float = 0.5
    seed: int = 0


# --- devices


def on_device(lifter: "Lifter", device: str) -> "Lifter":
    """Return the lifter that runs on a device: numpy on "cpu", torch on "cuda" or "cuda:1".

    Raises MismatchError if the device does not exist.
    """
    check_device(device)
    if device == CPU:
        return lifter
    from mocap_calib.training.model import DeviceLifter  # noqa: PLC0415

    return DeviceLifter(lifter.config, lifter.weights, device)


def check_device(device: str) -> None:
    """Raise MismatchError if a device does not exist ("cpu", "cuda" or "cuda:1")."""
    if device == CPU:
        return
    if not (found := re.fullmatch(r"cuda(?::(\d+))?", device)):
        raise MismatchError("device", "cpu or cuda", f"{device!r}", "use cpu")
    import torch  # noqa: PLC0415

    if int(found[1] or 0) >= torch.cuda.device_count():
        raise MismatchError(
            f"device {device}", "a CUDA device and a torch built for it", "none", "use cpu"
        )


def describe_devices() -> dict[str, object]:
    """Return the GPUs that torch can use, its CUDA version and its number of threads."""
    import torch  # noqa: PLC0415

    names = [torch.cuda.get_device_name(each) for each in range(torch.cuda.device_count())]
    return {"gpus": names, "cuda": torch.version.cuda, "torch_threads": torch.get_num_threads()}


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Limit torch to `count` threads: small networks are slower on more, and round differently."""
    import torch  # noqa: PLC0415

    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
