"""Find how the clocks of a recording's cameras differ, before it is calibrated."""

from dataclasses import replace
from pathlib import Path

from mocap_calib.clocks.frame_clocks import find_clocks
from mocap_calib.compute.parallel import single_threaded_libraries
from mocap_calib.config import Config
from mocap_calib.errors import MismatchError
from mocap_calib.lift.lift import RememberedLift
from mocap_calib.lift.lifter import Lifter
from mocap_calib.lift.weights import AUTO, choose_model
from mocap_calib.recording.retiming import clocks_of_rates, retime
from mocap_calib.recording.sampling import choose_stretches, take_sample
from mocap_calib.results import Clocks
from mocap_calib.training.device import on_device
from mocap_calib.types import Progress, Recording, silent


def compare_clocks(
    recording: Recording,
    model: str | Path | Lifter = AUTO,
    config: Config = Config(),
    *,
    seed: int = 0,
    device: str = "cpu",
    progress: Progress | None = None,
) -> Clocks:
    """Return how the clocks of the cameras differ, as `calibrate` finds it; nothing is changed.

    The arguments are those of `calibrate`. Raises FormatError where there is no such model, and
    MismatchError where there is no such device.
    """
    recording, lifter = choose_model(recording, model)
    lifter = on_device(lifter, device)
    checked = replace(config, sync=replace(config.sync, mode="check"))
    with single_threaded_libraries():
        lift_sample = RememberedLift(lifter, progress or silent)
        return synchronise(recording, lift_sample, checked, seed=seed)


def synchronise(
    recording: Recording, lift_sample: RememberedLift, config: Config, *, seed: int
) -> Clocks:
    """Return which frame each camera shows at each frame of a clock that is common to all.

    Rates that somebody said come first. Where clocks are only to be checked, the frames stay what
    they are.
    """
    said = clocks_of_rates(recording, dict(config.sync.rates))
    recording = retime(recording, said)
    if config.sync.mode == "off":
        return said
    stretches = choose_stretches(recording, config.sync)
    sample = take_sample(recording, stretches[stretches >= 0])
    try:
        lifted = lift_sample(sample)
    except MismatchError:  # the model knows too few of the joints: said where they are needed
        return said
    found = find_clocks(recording, lifted, stretches, config.sync, seed=seed)
    if config.sync.mode == "check":
        found = Clocks.of_one(recording, found.cameras)
    return found.after(said)
