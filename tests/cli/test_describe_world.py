"""What `run` says of the coordinates of its results."""

import numpy as np

from mocap_calib.io.world_fields import world_fields
from mocap_calib.types import MeasuredCue, MeasuredLandmark, World
from mocap_calib_cli.describe_world import describe_world

ALONE = MeasuredCue("height of 0", 1.75, 1.75, 0.03, np.nan)


def said_of(unit: str, **parts) -> list[str]:
    return describe_world(world_fields(World(**parts), unit))


def test_the_world_is_said_in_a_line_and_its_evidence_below():
    landmarks = (MeasuredLandmark("a", 0.002), MeasuredLandmark("b", np.nan))
    remark = "aligned to 1 landmark, RMS distance 2 mm"
    said = said_of("m", kind="landmarks", remarks=(remark,), landmarks=landmarks)
    assert said[0] == f"world: {remark}; lengths are in m"
    assert said[1] == "  landmark a: 2 mm from its place"
    assert "landmark b: not used" in said[2]
    (line,) = said_of("arbitrary", kind="floor")
    assert line.startswith("world: z is up, the origin is on the floor; lengths are arbitrary: ")
    (line,) = said_of("arbitrary", kind="file")
    assert "`mocap-calib convert FILE NEW --input-unit m`" in line


def test_a_known_length_is_compared_where_there_are_others():
    said = said_of("m", kind="floor", scale_sigma=0.03, cues=(ALONE,))
    assert said[0].endswith("lengths are in m, uncertain by 3.0 %, a standard deviation")
    assert said[1] == "  height of 0: 1.75 m"
    other = MeasuredCue("camera distance a-b", 3.1, 3.0, 0.01, -1.2)
    said = said_of("m", kind="floor", scale_sigma=0.01, cues=(other,))
    assert said[1] == "  camera distance a-b: 3.1 m, 3 m by all cues (-1.2 sigma)"
