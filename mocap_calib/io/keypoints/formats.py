"""The table of keypoint formats: how each is recognised by content, read and written."""

from mocap_calib.io.formats import (
    caliscope,
    coco,
    coco_results,
    dannce,
    deeplabcut_csv,
    deeplabcut_h5,
    generic_csv,
    mmpose,
    movement,
    nwb,
    openpose,
    sleap_csv,
    sleap_h5,
    sleap_slp,
    superanimal,
    ultralytics,
)

# the first whose sniff says yes reads the file
KEYPOINT_FORMATS = (
    coco.ANNOTATIONS,
    openpose.FORMAT,
    mmpose.IMAGES,
    mmpose.VIDEO,
    superanimal.FORMAT,
    coco_results.RESULTS,
    coco_results.ALPHAPOSE,
    deeplabcut_h5.HDF5,
    sleap_h5.ANALYSIS,
    sleap_slp.PROJECT,
    movement.KEYPOINTS,
    nwb.KEYPOINTS,
    dannce.KEYPOINTS,
    deeplabcut_csv.CSV,
    sleap_csv.TABLE,
    caliscope.FORMAT,
    generic_csv.FORMAT,
    ultralytics.FORMAT,
)
