"""What the formats of each kind carry: one table a kind, for the laws of tests/io and tests/golden.

`golden/corpus/KIND/NAME` holds a small file of each format, as its program writes it.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

CORPUS = Path(__file__).parent / "golden" / "corpus"
NAMES, SIZE, FRAMES = ("nose", "left_ear", "tail"), (640, 480), tuple(range(5))


class Keypoints(NamedTuple):
    """What keypoint files of the corpus carry.

    format: where it is not the name of the entry. individuals: how many. named, scores, tracked,
    sized: whether files have names of keypoints, scores, identities and the image size. pixels:
    whether positions are pixels, not shares of the image. written: whether we write the format
    too, and ordered: only where several individuals are followed. camera: its name.
    """

    format: str = ""
    individuals: int = 2
    named: bool = True
    scores: bool = True
    tracked: bool = True
    sized: bool = False
    pixels: bool = True
    written: bool = False
    ordered: bool = False
    camera: str = "cam"

    @property
    def options(self) -> dict[str, Any]:
        """Return what the user has to say of the files."""
        layout = {} if self.named else {"layout": NAMES}
        return layout if self.pixels else {**layout, "image_size": SIZE}


KEYPOINTS = {
    "alphapose": Keypoints(named=False, tracked=False),
    "caliscope": Keypoints(named=False, scores=False),
    "coco": Keypoints(tracked=False, sized=True, written=True),
    "coco-results": Keypoints(named=False, tracked=False),
    "csv": Keypoints(written=True),
    "csv-of-r": Keypoints("csv"),
    "csv-wide": Keypoints(individuals=1),
    "deeplabcut-csv": Keypoints(written=True, ordered=True),
    "deeplabcut-h5": Keypoints(written=True, ordered=True),
    "deeplabcut-h5-fixed": Keypoints("deeplabcut-h5"),
    "dltdv": Keypoints(individuals=1, scores=False, camera="cam1"),
    "freemocap-2d": Keypoints(individuals=1, named=False, scores=False, camera="cam_0"),
    "jarvis-2d": Keypoints("csv-wide", individuals=1),
    "label3d": Keypoints(individuals=1, named=False, scores=False),
    "mmpose": Keypoints(tracked=False),
    "mmpose-images": Keypoints(named=False, tracked=False),
    "movement": Keypoints(written=True, ordered=True),
    "movement-old": Keypoints("movement"),
    "nwb": Keypoints(individuals=1, sized=True),
    "openpose": Keypoints(named=False, tracked=False, written=True),
    "simba": Keypoints("csv-wide", individuals=1),
    "sleap": Keypoints(written=True),
    "sleap-csv": Keypoints(),
    "sleap-csv-frames": Keypoints("sleap-csv"),
    "sleap-csv-points": Keypoints("sleap-csv"),
    "sleap-slp": Keypoints(),
    "superanimal": Keypoints(named=False, tracked=False),
    "ultralytics-csv": Keypoints("ultralytics-images", named=False, tracked=False),
    "ultralytics-images": Keypoints(named=False, tracked=False),
    "ultralytics-json": Keypoints(named=False),
    "ultralytics": Keypoints(named=False, tracked=False, sized=True, pixels=False),
}


class Cameras(NamedTuple):
    """What camera files carry.

    lengths: of distortions. fisheye, sizes, names, stated: whether it has fisheyes, image sizes,
    names and a unit. square: one focal length a camera. unit: of its lengths, "" = any. folder:
    several files. verdict: where the verdict on the rig stands: "comment", "field" or "".
    """

    lengths: tuple[int, ...] = (0, 4, 5)
    fisheye: bool = False
    sizes: bool = True
    square: bool = False
    unit: str = ""
    folder: bool = False
    verdict: str = "comment"
    names: bool = True
    stated: bool = True


ANY = (0, 4, 5, 8)
CAMERAS = {  # those that are written
    "mocap-calib": Cameras(ANY, fisheye=True),
    "anipose": Cameras(ANY, fisheye=True),
    "opencv": Cameras(ANY, fisheye=True, folder=True),
    "colmap": Cameras(ANY, fisheye=True, folder=True),
    "colmap-binary": Cameras(ANY, fisheye=True, folder=True, verdict="", stated=False),
    "caliscope": Cameras(fisheye=True, unit="m"),
    "nerfstudio": Cameras(fisheye=True, verdict="field"),
    "openmvg": Cameras(fisheye=True, square=True, verdict="field"),
    "pose2sim": Cameras(ANY, unit="m"),
    "multiview-calib": Cameras(ANY, folder=True, verdict=""),
    "freemocap": Cameras(unit="mm"),
    "easymocap": Cameras(unit="m", folder=True),
    "panoptic": Cameras(unit="cm", verdict="field"),
    "jarvis": Cameras(sizes=False, unit="mm", folder=True),
    "voxelpose": Cameras(sizes=False, unit="mm", verdict=""),
    "dannce": Cameras(sizes=False, unit="mm", verdict=""),
    "4d-association": Cameras((0,), unit="m", verdict="", names=False),
}


class Poses(NamedTuple):
    """What pose files carry: one individual a file, its unit ("" = any), the rate, what is known
    of points ("errors" or "all", with covariances), and the ending of its files.
    """

    ending: str
    single: bool = False
    unit: str = ""
    rate: bool = True
    known: str = ""


POSES = {  # those that are written and read
    "poses-h5": Poses(".h5", known="all"),
    "npz": Poses(".npz", known="all"),
    "anipose-csv": Poses(".csv", single=True, unit="arbitrary", rate=False, known="errors"),
    "trc": Poses(".trc", single=True),
    "c3d": Poses(".c3d", unit="mm"),
    "movement-3d": Poses(".nc", known="errors"),
    "sleap-anipose": Poses(".h5"),
}
READ_ONLY = {  # camera formats whose file in the corpus is the rig of `mocap-calib`: its unit
    **{"mc-calib": "", "metashape": "m", "multical": "", "opensfm": "", "qualisys": "mm"},
    **{"dlt": "", "vicon": "mm"},  # which have no distortion, or have none in the corpus
}
# formats that are written; the first can hold what all others can
TARGETS = {
    kind: (first, *sorted(set(written) - {first}))
    for kind, first, written in (
        ("keypoints", "csv", [name for name, each in KEYPOINTS.items() if each.written]),
        # dlt comes back only where the origin lies before a camera: a test of its own
        ("cameras", "mocap-calib", [*CAMERAS, "dlt"]),
        ("poses", "npz", [*POSES, "bvh", "blender"]),
    )
}


def recording(individuals: int = 2, scores: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and scores of the corpus' recording; all have a point in every frame.

    Positions are `[frame, individual, keypoint, 2]`, scores `[frame, individual, keypoint]`.
    """
    rng = np.random.default_rng(0)
    positions = rng.uniform(2, 470, (len(FRAMES), individuals, len(NAMES), 2)).round(3)
    confidence = np.ones(positions.shape[:3])
    if scores:
        confidence = rng.uniform(0.1, 0.99, confidence.shape).round(3)
    gone = rng.random(confidence.shape) < 0.3
    gone[..., 0] = False
    positions[gone], confidence[gone] = np.nan, 0.0
    return positions, confidence
