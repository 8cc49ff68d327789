"""aniposelib's CameraGroup: our calibration.toml, projected by it; pinhole and fisheye."""

from importlib.metadata import version

from aniposelib.cameras import CameraGroup
from expected import FILES, POINTS, near, pixels

for file, key in (("anipose", "pixels"), ("anipose-fisheye", "pixels_fisheye")):
    group = CameraGroup.load(str(FILES / f"{file}.toml"))
    expected = pixels(key)
    assert group.get_names() == list(expected), group.get_names()
    near(
        f"aniposelib {version('aniposelib')} {file} (px)",
        [c.project(POINTS).reshape(-1, 2) for c in group.cameras],
        list(expected.values()),
        1e-6,
    )
