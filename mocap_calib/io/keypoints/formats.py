"""The table of keypoint formats: how each is recognised by content, read and written."""

from mocap_calib.io.formats import (
    coco,
    coco_results,
    dannce,
    deeplabcut,
    deeplabcut_h5,
    mmpose,
    movement,
    nwb,
    openpose,
    sleap,
    sleap_slp,
    tables,
    ultralytics,
)

# the first whose sniff says yes reads the file
KEYPOINT_FORMATS = (
    coco.ANNOTATIONS,
    openpose.FORMAT,
    mmpose.IMAGES,
    mmpose.VIDEO,
    deeplabcut.SUPERANIMAL,
    coco_results.RESULTS,
    coco_results.ALPHAPOSE,
    deeplabcut_h5.HDF5,
    sleap.ANALYSIS,
    sleap_slp.PROJECT,
    movement.KEYPOINTS,
    nwb.KEYPOINTS,
    dannce.KEYPOINTS,
    deeplabcut.CSV,
    sleap.TABLE,
    tables.CALISCOPE,
    tables.PLAIN,
    ultralytics.FORMAT,
)
