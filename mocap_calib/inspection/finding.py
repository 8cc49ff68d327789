"""A finding of `inspect`, and the limits from which on there is one."""

from dataclasses import dataclass

from mocap_calib.errors import spell_arguments, spell_as_option


@dataclass(frozen=True)
class Finding:
    """Something that stands in the way.

    critical: a run could not work; else its result may be worse than it could be.
    message: one line, with the remedy.
    """

    critical: bool
    message: str


def critical(message: str) -> Finding:
    """Return a finding without whose remedy a run could not work."""
    return Finding(critical=True, message=spell_arguments(message, spell_as_option))


def warning(message: str) -> Finding:
    """Return a finding that a run survives."""
    return Finding(critical=False, message=spell_arguments(message, spell_as_option))


@dataclass(frozen=True)
class InspectConfig:
    """What `inspect` warns of.

    cells: of the grid over the image, each way.
    outside: share of the points outside the image.
    enough_frames: that a camera sees together with another one. The worst of four simulated scenes
        (four cameras, one walker) is 3.0 deg off with 3 frames, 2.2 with 6, 2.1 with 10, and 0.5
        with 20. Fewest in a shared recording: 20.
    low_confidence: of half of the points.
    copied: detections that two files have in common; `run` refuses only what is certain.
    gaps: share of the frame numbers between the first and the last.
    motion_frames, motion_percentile: what `inspection.contents.measure_motion` compares.
    least_motion: median over the cameras of what that returns. Measured: 0.05 of a mouse that sits
        (a rig 19 deg off), 0.21 of a tethered fly, 0.36 and more in the other recordings, 0.45 of
        three people who sit; simulated, 0.02 to 0.07 where one frame is repeated with 1 to 3 px of
        noise, 0.16 to 0.22 where somebody walks on the spot, 0.3 and more where people go about
        for 10 frames, 0.8 and more for 60.
    single_share: of the frames in which two views see somebody, that show each of them one body.
    compared_frames, most_pairs: of two views, that `inspection.view_pairs` compares, and of views.
    least_matches, most_matches: joints of these.
    most_error: of two views whose images of one subject go together. Measured: 0.04 in shared
        recordings, 0.2 and more where keypoints are noise.
    least_depth: median over pairs of views of the error of a homography over that of a fundamental
        matrix. Measured: 9.4 and more in shared recordings, 5.0 and more in simulated ones, 2.1 to
        2.9 where all that is seen lies in a plane.
    """

    cells: int = 10
    outside: float = 0.01
    enough_frames: int = 20
    low_confidence: float = 0.1
    copied: int = 1
    gaps: float = 0.1
    motion_frames: int = 40
    motion_percentile: float = 90.0
    least_motion: float = 0.1
    single_share: float = 0.9
    compared_frames: int = 1000
    most_pairs: int = 30
    least_matches: int = 100
    most_matches: int = 2000
    most_error: float = 0.1
    least_depth: float = 3.0
