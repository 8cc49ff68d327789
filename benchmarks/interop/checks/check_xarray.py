"""xarray: our movement netCDF, by the names that movement looks for."""

import xarray
from expected import EXPECTED, FILES, FRAMES, POSITIONS, near

with xarray.open_dataset(FILES / "poses-movement-3d.nc") as data:
    assert data.position.dims == ("time", "space", "keypoint", "individual")
    assert data.confidence.dims == ("time", "keypoint", "individual")
    assert data.keypoint.values.tolist() == EXPECTED["keypoints"]
    assert data.space.values.tolist() == ["x", "y", "z"]
    assert (data.attrs["ds_type"], float(data.attrs["fps"]), data.attrs["time_unit"]) == (
        "poses",
        60.0,
        "seconds",
    )
    near("times (s)", data.time.values, FRAMES / EXPECTED["rate"], 1e-12)
    near(
        f"xarray {xarray.__version__} (m)",
        data.position.values,
        POSITIONS.transpose(0, 3, 2, 1),
        0.0,
    )
