"""What the checks of a verdict look at, and what sound recordings show: for pages and documents."""

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class CheckMeaning:
    """What a check is, and the smallest and largest value of sound recordings.

    The values were measured on thirteen real recordings (docs/how-good.md).
    """

    text: str
    sound: tuple[float, float]


CHECK_MEANINGS = {
    "convergence": CheckMeaning("whether adjusting and matching came to an end", (0, 0)),
    "moments": CheckMeaning(
        "10 over the number of frames in which bodies are matched", (0.01, 0.5)
    ),
    "held-out frames": CheckMeaning(
        "median error of a fifth of the recording in a rig made without it, in errors of the same "
        "frames in the rig of all; of the worst fifth",
        (1.0, 1.07),
    ),
    "flat": CheckMeaning(
        "median error of points in those that they would have if all lay in one plane, as several "
        "rigs fit these",
        (0.01, 0.15),
    ),
    "bones": CheckMeaning(
        "share by which the steadiest quarter of all distances on a body vary over time",
        (0.01, 0.26),
    ),
    "loops": CheckMeaning("share of the pairs of cameras that contradict the rig", (0, 0.53)),
    "bridge": CheckMeaning(
        "of the best pairs that connect all cameras: by how many times the worst score is below "
        "the median of the others",
        (1.0, 1.2),
    ),
    "pair score": CheckMeaning(
        "what the best pair of a camera lacks of a score of 0.55: agreement of lifted bodies",
        (-0.4, -0.01),
    ),
    "clock": CheckMeaning(
        "frames by which a clock is certainly off that was not put right", (0, 0)
    ),
    "lens": CheckMeaning(
        "slope of errors along the cube of the radius, in standard deviations", (0.3, 2.1)
    ),
    "over time": CheckMeaning("largest error of a stretch of time, in median ones", (1.1, 2.3)),
    "unmatched": CheckMeaning("share of the detections of a camera that match nobody", (0, 0.13)),
    "errors": CheckMeaning(
        "median error of a keypoint in sizes of the body in the image", (0.02, 0.06)
    ),
}


def describe_checks() -> dict[str, dict[str, object]]:
    """Return the meanings by the names of the checks, as JSON has them."""
    return {name: asdict(meaning) for name, meaning in CHECK_MEANINGS.items()}
