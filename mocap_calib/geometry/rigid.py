"""Rigid transforms: a rotation and a translation, batched over leading axes."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap_calib.records import Record

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Rigid(Record):
    """Transforms x -> R x + t, named target_from_source: `camera = cam_from_world.apply(world)`.

    rotation: `[..., 3, 3]`. translation: `[..., 3]`.
    """

    rotation: Floats
    translation: Floats

    def __len__(self) -> int:
        return len(self.translation)

    def __getitem__(self, index: Any) -> "Rigid":
        """Return some of the transforms, by an index of the batch axes."""
        return Rigid(self.rotation[index], self.translation[index])

    def __matmul__(self, first: "Rigid") -> "Rigid":
        """Return the composition, c_from_a = c_from_b @ b_from_a."""
        return Rigid(self.rotation @ first.rotation, self.apply(first.translation))

    @property
    def inverse(self) -> "Rigid":
        """The transforms source_from_target."""
        return Rigid(np.swapaxes(self.rotation, -1, -2), self.centre)

    @property
    def centre(self) -> Floats:
        """`[..., 3]` the origin of the target in source coordinates, C = -R' t.

        For cam_from_world: the camera centre.
        """
        return -(self.translation[..., None, :] @ self.rotation)[..., 0, :]

    def apply(self, points: Floats) -> Floats:
        """Return points `[..., 3]` of the source in target coordinates, one to a transform.

        For many points of each, give the transforms an axis for them: `cam_from_world[:, None]`.
        """
        return (self.rotation @ points[..., None])[..., 0] + self.translation
