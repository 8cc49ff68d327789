"""ezc3d: our C3D."""

from importlib.metadata import version

import ezc3d
from expected import EXPECTED, FILES, FRAMES, POSITIONS, near

file = ezc3d.c3d(str(FILES / "poses-c3d.c3d"))
assert file["parameters"]["POINT"]["LABELS"]["value"] == [
    f"{who}:{what}" for who in EXPECTED["individuals"] for what in EXPECTED["keypoints"]
]
assert file["parameters"]["POINT"]["UNITS"]["value"] == ["mm"]
assert file["header"]["points"]["first_frame"] in (FRAMES[0], FRAMES[0] + 1)
points = file["data"]["points"][:3].transpose(2, 1, 0)
near(f"ezc3d {version('ezc3d')} (mm)", points, POSITIONS.reshape(len(FRAMES), -1, 3) * 1000, 2e-3)
