"""movement: our netCDF passes its validator, and its kinematics work on it."""

from importlib.metadata import version

import xarray
from expected import FILES, POSITIONS, near
from movement.kinematics import compute_velocity
from movement.validators.datasets import ValidPosesInputs

data = xarray.open_dataset(FILES / "poses-movement-3d.nc").load()
ValidPosesInputs.validate(data)
assert compute_velocity(data.position).shape == data.position.shape
near(
    f"movement {version('movement')} (m)",
    data.position.values,
    POSITIONS.transpose(0, 3, 2, 1),
    0.0,
)
