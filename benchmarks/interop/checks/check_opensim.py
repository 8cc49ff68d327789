"""OpenSim: our TRC and C3D by its own readers."""

import numpy as np
import opensim
from expected import EXPECTED, FILES, FRAMES, POSITIONS, near

opensim.Logger.setLevelString("Off")


def values(table):
    """(frame, marker, 3) of a table."""
    rows = [table.getRowAtIndex(k) for k in range(table.getNumRows())]
    return np.array(
        [
            [[row.getElt(0, j)[i] for i in range(3)] for j in range(table.getNumColumns())]
            for row in rows
        ]
    )


for individual, name in enumerate(("poses-trc_0.trc", "poses-trc_1.trc")):
    table = opensim.TimeSeriesTableVec3(str(FILES / name))
    assert list(table.getColumnLabels()) == EXPECTED["keypoints"]
    assert table.getTableMetaDataString("Units") == "m"
    near(
        f"OpenSim {opensim.GetVersion()} TRC {individual} (m)",
        values(table),
        POSITIONS[:, individual],
        1e-12,
    )
    near("times (s)", np.array(table.getIndependentColumn()), FRAMES / EXPECTED["rate"], 1e-9)
