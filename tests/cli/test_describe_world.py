"""What `run` says of the coordinates of its results."""

from mocap_calib.io.world_fields import world_fields
from mocap_calib.types import World
from mocap_calib_cli.ending import _describe_world


def test_the_world_is_said_in_a_line_and_its_evidence_below():
    remarks = ("aligned to 3 landmarks, RMS distance 2 mm", "landmark a: 2 mm from its place")
    said = _describe_world(world_fields(World(kind="landmarks", remarks=remarks), "m"))
    assert said == [f"world: {remarks[0]}; lengths are in m", f"  {remarks[1]}"]
    (line,) = _describe_world(world_fields(World(kind="floor"), "arbitrary"))
    assert line == "world: z is up, the origin is on the floor; lengths are arbitrary"
