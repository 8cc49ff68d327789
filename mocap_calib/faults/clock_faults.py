"""Name the cameras whose clocks differ, for `CalibrationResult.faults`."""

from dataclasses import dataclass, replace
from typing import Any, cast

from mocap_calib.config import EPOCH_MARK
from mocap_calib.recording.corrections import find_view
from mocap_calib.recording.timeline import clocks_from, retime
from mocap_calib.results import CalibrationResult, Clocks, Fault, FaultWord, GroupResult
from mocap_calib.rig.averaging import best_scores
from mocap_calib.types import CameraClock, Recording
from mocap_calib.wording import count


@dataclass(frozen=True)
class Retimed:
    """The clock of a camera differs from that of the others."""

    clock: CameraClock

    @property
    def camera(self) -> str:
        """Name of the camera."""
        return self.clock.camera

    @property
    def word(self) -> FaultWord:
        """The fault that it mends."""
        return cast(FaultWord, self.clock.kind)

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with the camera on the clock of the others.

        Raises MismatchError where the recording does not have it.
        """
        view = find_view(recording, self.camera)
        cameras = [CameraClock(name, "in step") for name in recording.names]
        cameras[view] = self.clock
        return retime(recording, clocks_from(recording, tuple(cameras)))


def add_clocks(result: CalibrationResult, clocks: Clocks) -> CalibrationResult:
    """Return the result with the clocks of its cameras, and the faults that they are.

    clocks: by which the recording was put on one clock; where they change nothing, what differs was
        found and not applied.
    """
    groups = result.groups
    if clocks.changed:
        groups = tuple(_with_clocks(group, clocks) for group in groups)
    faults = clock_faults(clocks, applied=clocks.changed)
    refuted = {name for group in groups for name in _refuted(group, result)}
    faults = tuple(fault for fault in faults if not fault.mend or fault.camera not in refuted)
    return replace(result, groups=groups, clocks=clocks, faults=(*faults, *result.faults))


def _refuted(group: GroupResult, result: CalibrationResult) -> list[str]:
    """Return the cameras of which another clock explains nothing.

    The rig is not determined, and the bodies that they see then look like those of nobody.
    """
    if group.verdict != "not determined":
        return []
    best = best_scores(group.pairs, len(group.rig))
    unlike = best < result.config.averaging.weak_score
    return [
        name.partition(EPOCH_MARK)[0]
        for name, odd in zip(group.rig.names, unlike, strict=True)
        if odd
    ]


def _with_clocks(group: GroupResult, clocks: Clocks) -> GroupResult:
    """Return the group with a rig that says which of its cameras have other clocks."""
    different = [clock for clock in clocks.cameras if clock.differs]
    own = tuple(
        replace(clock, camera=name)
        for name in group.rig.names
        for clock in different
        if name.partition(EPOCH_MARK)[0] == clock.camera
    )
    rig = replace(group.rig, clocks=own)
    return replace(group, adjusted=replace(group.adjusted, rig=rig))


def clock_faults(clocks: Clocks, *, applied: bool) -> tuple[Fault, ...]:
    """Return the faults of the cameras whose clocks differ.

    applied: the recording was put on one clock.
    """
    return tuple(
        Fault(
            camera=each.camera,
            word=cast(FaultWord, each.kind),
            says=describe_clock_fault(each),
            evidence=dict(each.evidence),
            mend=Retimed(each) if applied else None,
        )
        for each in clocks.cameras
        if each.differs and each.evidence  # what somebody said is no finding
    )


def describe_clock_fault(clock: CameraClock) -> str:
    """Return how a clock differs, for a person, without the name of the camera."""
    if clock.kind == "clock":
        late = "late" if clock.offset > 0 else "early"
        return f"its clock is {count(abs(clock.offset), 'frame')} {late}"
    if clock.kind == "rate" and clock.rate != 1.0:
        return f"it has {clock.rate:g} frames for each of the other cameras"
    last = clock.table[-1][1] - clock.table[0][1]
    drift = f"its clock changes by {count(abs(last), 'frame')} over the recording"
    if clock.kind == "rate":
        return f"{drift}, evenly: its frame rate is another"
    return f"it lost frames and numbered the others without gaps: {drift}"


def describe_clock(clock: CameraClock, clocks: Clocks) -> dict[str, Any]:
    """Return how the clock of a camera differs from that of the others, as run.json has it."""
    return {
        "camera": clock.camera,
        "kind": clock.kind,
        "offset_frames": clock.offset,
        "rate": float(clock.rate),
        "table": [{"frame": frame, "offset": offset} for frame, offset in clock.table],
        "applied": clock.differs and clocks.changed,
        "evidence": dict(clock.evidence),
    }


def describe_unknown_clocks(result: CalibrationResult) -> list[str]:
    """Say that the clocks of the cameras could not be compared, where that is so."""
    looked = result.config.sync.mode != "off"
    if looked and all(clock.kind == "not known" for clock in result.clocks.cameras):
        return [
            "the clocks of the cameras are taken as they are: too little moves, or too few frames "
            "are shared, to compare them"
        ]
    return []
