"""Lift a sample, and remember it: the stages before a rig often look at the same frames."""

from dataclasses import dataclass, field

from mocap_calib.lift.lift import lift
from mocap_calib.lift.lifter import Lifter
from mocap_calib.results import LiftedPoses
from mocap_calib.types import Progress, Sample


@dataclass
class RememberedLift:
    """Lifts samples as `lift` does; one that equals the last one is not lifted again."""

    lifter: Lifter
    progress: Progress
    _last: list[tuple[Sample, LiftedPoses]] = field(default_factory=list, init=False)

    def __call__(self, sample: Sample) -> LiftedPoses:
        """Return the lifted detections of a sample. Raises what `lift` raises."""
        if not self._last or self._last[0][0] != sample:
            lifted = lift(sample, self.lifter, progress=self.progress)
            self._last = [(sample, lifted)]
        return self._last[0][1]
