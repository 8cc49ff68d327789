"""Several animals: given their number, find identities and their distances.

python several_animals.py
"""

from dataclasses import replace

import numpy as np

import mocap_calib as mc

# two rats in an arena; `mc.read_recording("keypoints/", "intrinsics.toml")` with files of your own
config = mc.SimulateConfig(cameras=3, people=0, animals=(("rodent", 2),), frames=30)
scene = mc.simulate(config)
recording = mc.Recording.from_keypoints(scene.files, scene.rig.cameras)
print(recording)  # the names of the joints have told the model: rodent

# where you know how many there are, say it: never more get a name
defaults = mc.Config()
known = replace(defaults, matching=replace(defaults.matching, individuals=2))
group = mc.calibrate(recording, config=known).groups[0]
print(group)

# frame, individual, keypoint, coordinate
positions = group.poses.positions
for individual in range(positions.shape[1]):
    seen = np.isfinite(positions[:, individual]).all(-1).any(-1)
    print(f"individual {individual}: in {seen.sum()} of {len(seen)} frames")

# the middle of each body, and how far these are apart, in lengths of a back
middles = np.nanmean(positions, axis=2)
apart = np.linalg.norm(middles[:, 0] - middles[:, 1], axis=-1)
neck, tail = (group.poses.keypoints.index(name) for name in ("neck", "tail_base"))
back = np.nanmedian(np.linalg.norm(positions[:, :, neck] - positions[:, :, tail], axis=-1))
print(f"at their nearest {np.nanmin(apart) / back:.1f} backs apart, in frame {np.nanargmin(apart)}")
