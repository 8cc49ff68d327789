"""Real keypoint files, where they lie beside the checkout.

Each loads with these counts, or is refused for this reason.
"""

from pathlib import Path

import numpy as np
import pytest

from mocap_calib.errors import FormatError
from mocap_calib.io.keypoints.document import ReadOptions
from mocap_calib.io.keypoints.layouts import LAYOUTS
from mocap_calib.io.keypoints.read import read_keypoints

SAMPLES = Path(__file__).parents[3] / "shared" / "formats" / "samples"
pytestmark = pytest.mark.skipif(not SAMPLES.is_dir(), reason="no ../shared here")

MVOR = ReadOptions(layout=tuple("abcdefghij"), camera_pattern=r"1(?P<camera>00\d)(?P<frame>\d{7})")
BODY_25B = ReadOptions(layout=LAYOUTS["body_25b"])
LP = "lightning_pose_csv/"
# file: options, then of each camera:
# name, frames, first frame, last frame, most instances, keypoints, points
LOADS = {
    "caliscope/image_points_noisy.csv": (
        ReadOptions(),
        [
            ("0", 20, 0, 19, 1, 35, 700),
            ("1", 20, 0, 19, 1, 35, 700),
            ("2", 20, 0, 19, 1, 35, 700),
            ("3", 20, 0, 19, 1, 35, 700),
        ],
    ),
    "caliscope/xy.csv": (
        ReadOptions(),
        [
            ("1", 48, 416, 463, 1, 12, 529),
            ("2", 48, 416, 463, 1, 12, 484),
            ("0", 47, 416, 463, 1, 12, 433),
            ("3", 24, 440, 463, 1, 12, 279),
        ],
    ),
    "coco_keypoints/sleapio_visibility_ternary_annotations.json": (
        ReadOptions(),
        [("sleapio_visibility_ternary_annotations", 3, 1, 3, 1, 17, 33)],
    ),
    "coco_results/mvor_openpose_kps_head.json": (MVOR, [("001", 17, 1, 17, 5, 10, 350)]),
    "dannce_mat/label3d_dannce.mat": (
        ReadOptions(),
        [
            ("Camera1", 81, 27, 17858, 1, 22, 1715),
            ("Camera2", 81, 27, 17858, 1, 22, 1715),
            ("Camera3", 81, 27, 17858, 1, 22, 1715),
            ("Camera4", 81, 27, 17858, 1, 22, 1715),
            ("Camera5", 81, 27, 17858, 1, 22, 1715),
            ("Camera6", 81, 27, 17858, 1, 22, 1715),
        ],
    ),
    "dannce_mat/label3d_demo.mat": (
        ReadOptions(),
        [
            ("Camera1", 10, 27, 966, 1, 22, 214),
            ("Camera2", 10, 27, 966, 1, 22, 214),
            ("Camera3", 10, 27, 966, 1, 22, 214),
            ("Camera4", 10, 27, 966, 1, 22, 214),
            ("Camera5", 10, 27, 966, 1, 22, 214),
            ("Camera6", 10, 27, 966, 1, 22, 214),
        ],
    ),
    "dlc_csv/CollectedData_LM.csv": (ReadOptions(), [("CollectedData_LM", 4, 0, 3, 2, 3, 13)]),
    "dlc_csv/dlc_testdata.csv": (ReadOptions(), [("dlc_testdata", 4, 0, 3, 1, 3, 8)]),
    "dlc_csv/dlc_testdata_v2.csv": (ReadOptions(), [("dlc_testdata_v2", 4, 0, 3, 1, 3, 8)]),
    "dlc_csv/madlc_testdata.csv": (ReadOptions(), [("madlc_testdata", 4, 0, 3, 2, 3, 13)]),
    "dlc_csv/madlc_testdata_v2.csv": (ReadOptions(), [("madlc_testdata_v2", 4, 0, 3, 2, 3, 13)]),
    "dlc_csv/maudlc_testdata.csv": (ReadOptions(), [("maudlc_testdata", 4, 0, 3, 2, 3, 13)]),
    "dlc_csv/maudlc_testdata_v2.csv": (ReadOptions(), [("maudlc_testdata_v2", 4, 0, 3, 2, 3, 13)]),
    "dlc_h5_generated/collected_fixed_multiindex_pd135.h5": (
        ReadOptions(),
        [("collected_fixed_multiindex_pd135", 60, 0, 59, 1, 4, 208)],
    ),
    "dlc_h5_generated/collected_fixed_multiindex_pd3.h5": (
        ReadOptions(),
        [("collected_fixed_multiindex_pd3", 60, 0, 59, 1, 4, 208)],
    ),
    "dlc_h5_generated/collected_multiindex_pd135.csv": (
        ReadOptions(),
        [("collected_multiindex_pd135", 60, 0, 59, 1, 4, 208)],
    ),
    "dlc_h5_generated/collected_multiindex_pd3.csv": (
        ReadOptions(),
        [("collected_multiindex_pd3", 60, 0, 59, 1, 4, 208)],
    ),
    "dlc_h5_generated/images_fixed_pd135.h5": (
        ReadOptions(),
        [("images_fixed_pd135", 60, 0, 59, 2, 4, 412)],
    ),
    "dlc_h5_generated/images_fixed_pd3.h5": (
        ReadOptions(),
        [("images_fixed_pd3", 60, 0, 59, 2, 4, 412)],
    ),
    "dlc_h5_generated/multi_stitched_tracks_pd135.h5": (
        ReadOptions(),
        [("multi_stitched_tracks_pd135", 60, 0, 59, 2, 4, 378)],
    ),
    "dlc_h5_generated/multi_stitched_tracks_pd3.h5": (
        ReadOptions(),
        [("multi_stitched_tracks_pd3", 60, 0, 59, 2, 4, 378)],
    ),
    "dlc_h5_generated/multi_unique_pd135.csv": (
        ReadOptions(),
        [("multi_unique_pd135", 60, 0, 59, 2, 4, 412)],
    ),
    "dlc_h5_generated/multi_unique_pd3.csv": (
        ReadOptions(),
        [("multi_unique_pd3", 60, 0, 59, 2, 4, 412)],
    ),
    "dlc_h5_generated/multi_unique_table_pd135.h5": (
        ReadOptions(),
        [("multi_unique_table_pd135", 60, 0, 59, 2, 4, 412)],
    ),
    "dlc_h5_generated/multi_unique_table_pd3.h5": (
        ReadOptions(),
        [("multi_unique_table_pd3", 60, 0, 59, 2, 4, 412)],
    ),
    "dlc_h5_generated/single_pd135.csv": (ReadOptions(), [("single_pd135", 60, 0, 59, 1, 4, 195)]),
    "dlc_h5_generated/single_pd3.csv": (ReadOptions(), [("single_pd3", 60, 0, 59, 1, 4, 195)]),
    "dlc_h5_generated/single_table_pd135.h5": (
        ReadOptions(),
        [("single_table_pd135", 60, 0, 59, 1, 4, 195)],
    ),
    "dlc_h5_generated/single_table_pd3.h5": (
        ReadOptions(),
        [("single_table_pd3", 60, 0, 59, 1, 4, 195)],
    ),
    "dlc_h5_single/reachingDEMO_2D.h5": (
        ReadOptions(),
        [("reachingDEMO_2D", 800, 42150, 42949, 1, 33, 26400)],
    ),
    "dlc_labels/CollectedData_Mackenzie.csv": (
        ReadOptions(),
        [("CollectedData_Mackenzie", 55, 5, 245, 1, 5, 233)],
    ),
    "dlc_labels/CollectedData_Mackenzie.h5": (
        ReadOptions(),
        [("CollectedData_Mackenzie", 55, 5, 245, 1, 5, 233)],
    ),
    "dlc_labels/CollectedData_Pranav.csv": (
        ReadOptions(),
        [("CollectedData_Pranav", 116, 0, 115, 1, 4, 464)],
    ),
    "dlc_labels/CollectedData_Pranav.h5": (
        ReadOptions(),
        [("CollectedData_Pranav", 116, 0, 115, 1, 4, 464)],
    ),
    "dlc_superanimal_json/superanimal_frames.json": (
        ReadOptions(layout=LAYOUTS["superanimal_quadruped"]),
        [("superanimal_frames", 4, 0, 3, 3, 39, 468)],
    ),
    "lightning_pose_csv/05272019_fly4_0_R1C24_Cam-A_rot-ccw-0.06_sec.rng=0.csv": (
        ReadOptions(),
        [("05272019_fly4_0_R1C24_Cam-A_rot-ccw-0.06_sec.rng=0", 500, 0, 499, 1, 12, 6000)],
    ),
    "lightning_pose_csv/05272019_fly4_0_R1C24_Cam-B_rot-ccw-0.06_sec.rng=0.csv": (
        ReadOptions(),
        [("05272019_fly4_0_R1C24_Cam-B_rot-ccw-0.06_sec.rng=0", 500, 0, 499, 1, 12, 6000)],
    ),
    "lightning_pose_csv/05272019_fly4_0_R1C24_Cam-C_rot-ccw-0.06_sec.rng=0.csv": (
        ReadOptions(),
        [("05272019_fly4_0_R1C24_Cam-C_rot-ccw-0.06_sec.rng=0", 500, 0, 499, 1, 12, 6000)],
    ),
    "lightning_pose_csv/180607_004.train_frames=75.rng=0.bot.csv": (
        ReadOptions(),
        [("180607_004.train_frames=75.rng=0.bot", 501, 0, 500, 1, 4, 2004)],
    ),
    "lightning_pose_csv/180607_004.train_frames=75.rng=0.top.csv": (
        ReadOptions(),
        [("180607_004.train_frames=75.rng=0.top", 501, 0, 500, 1, 4, 2004)],
    ),
    "lightning_pose_csv/lp_CollectedData.csv": (
        ReadOptions(views=("top", "bot")),
        [("top", 90, 1, 90, 1, 8, 659), ("bot", 90, 1, 90, 1, 9, 737)],
    ),
    "mmpose_json/demo_save_predictions.json": (
        ReadOptions(),
        [("demo_save_predictions", 5, 1, 5, 1, 17, 85)],
    ),
    "mmpose_json/inferencer_video.json": (
        ReadOptions(layout=LAYOUTS["coco_17"]),
        [("inferencer_video", 8, 0, 7, 2, 17, 187)],
    ),
    "more/dlc_single_CollectedData.h5": (
        ReadOptions(),
        [("dlc_single_CollectedData", 116, 0, 115, 1, 4, 464)],
    ),
    "more/dlc_single_lily_cam1.csv": (
        ReadOptions(),
        [("dlc_single_lily_cam1", 219, 0, 218, 1, 25, 5475)],
    ),
    "more/dlc_single_lily_cam1.h5": (
        ReadOptions(),
        [("dlc_single_lily_cam1", 219, 0, 218, 1, 25, 5475)],
    ),
    "more/label3d_demo.mat": (
        ReadOptions(),
        [
            ("Camera1", 10, 27, 966, 1, 22, 214),
            ("Camera2", 10, 27, 966, 1, 22, 214),
            ("Camera3", 10, 27, 966, 1, 22, 214),
            ("Camera4", 10, 27, 966, 1, 22, 214),
            ("Camera5", 10, 27, 966, 1, 22, 214),
            ("Camera6", 10, 27, 966, 1, 22, 214),
        ],
    ),
    "more/lightningpose_fly_camA.csv": (
        ReadOptions(),
        [("lightningpose_fly_camA", 500, 0, 499, 1, 12, 6000)],
    ),
    "more/madlc_testdata_v2.csv": (ReadOptions(), [("madlc_testdata_v2", 4, 0, 3, 2, 3, 13)]),
    "more/maudlc_testdata_v2.csv": (ReadOptions(), [("maudlc_testdata_v2", 4, 0, 3, 2, 3, 13)]),
    "more/movement_DLC_sample_poses.h5": (
        ReadOptions(),
        [("movement_DLC_sample_poses", 1085, 0, 1084, 1, 2, 2152)],
    ),
    "more/movement_DLC_sample_tracks.h5": (
        ReadOptions(),
        [("movement_DLC_sample_tracks", 1085, 0, 1084, 1, 2, 2152)],
    ),
    "more/sleap_8cam_session_2mice.slp": (
        ReadOptions(),
        [
            ("min_session_topL", 3, 0, 2, 2, 15, 80),
            ("min_session_top", 3, 0, 2, 2, 15, 73),
            ("min_session_sideL", 3, 0, 2, 1, 15, 31),
            ("min_session_side", 3, 0, 2, 1, 15, 36),
            ("min_session_midL", 3, 0, 2, 2, 15, 78),
            ("min_session_mid", 3, 0, 2, 2, 15, 72),
            ("min_session_backL", 3, 0, 2, 2, 15, 66),
            ("min_session_back", 3, 0, 2, 2, 15, 71),
        ],
    ),
    "more/sleap_multi.analysis.h5": (ReadOptions(), [("sleap_multi", 3000, 0, 2999, 2, 13, 76474)]),
    "more/sleap_multi_tracks.slp": (
        ReadOptions(),
        [("sleap_multi_tracks", 1500, 0, 1499, 2, 2, 5754)],
    ),
    "more/sleap_single_back.analysis.h5": (
        ReadOptions(),
        [("sleap_single_back", 120, 0, 119, 1, 15, 1408)],
    ),
    "more/sleap_single_back.slp": (
        ReadOptions(),
        [("sleap_single_back", 120, 0, 119, 1, 15, 1408)],
    ),
    "movement_netcdf/sleap_back_2d.nc": (
        ReadOptions(),
        [("sleap_back_2d", 120, 0, 119, 1, 15, 1408)],
    ),
    "ndx_pose_nwb/0.3.0_poseestimation_one_camera.nwb": (
        ReadOptions(),
        [("0.3.0_poseestimation_one_camera", 10, 0, 9, 1, 2, 20)],
    ),
    "sleap_analysis_h5/minimal_instance.000_centered_pair_low_quality.analysis.csv": (
        ReadOptions(),
        [("minimal_instance.000_centered_pair_low_quality", 1, 0, 0, 1, 2, 2)],
    ),
    "sleap_analysis_h5/predictions.analysis.h5": (
        ReadOptions(),
        [("predictions", 3000, 0, 2999, 2, 13, 76474)],
    ),
    "sleap_analysis_h5/small_robot.000_small_robot_3_frame.analysis.h5": (
        ReadOptions(),
        [("small_robot.000_small_robot_3_frame", 3, 0, 2, 1, 3, 9)],
    ),
    "sleap_anipose_session/minimal_back_proofread.analysis.h5": (
        ReadOptions(),
        [("minimal_back_proofread", 120, 0, 119, 1, 15, 1408)],
    ),
    "sleap_anipose_session/minimal_back_proofread.slp": (
        ReadOptions(),
        [("minimal_back_proofread", 120, 0, 119, 1, 15, 1408)],
    ),
    "sleap_anipose_session/minimal_mid_proofread.analysis.h5": (
        ReadOptions(),
        [("minimal_mid_proofread", 120, 0, 119, 1, 15, 1800)],
    ),
    "sleap_anipose_session/minimal_side_proofread.analysis.h5": (
        ReadOptions(),
        [("minimal_side_proofread", 120, 0, 119, 1, 15, 1568)],
    ),
    "sleap_anipose_session/minimal_top_proofread.analysis.h5": (
        ReadOptions(),
        [("minimal_top_proofread", 120, 0, 119, 1, 15, 1800)],
    ),
    "sleap_slp/clip.2node.slp": (ReadOptions(), [("clip.2node", 1500, 0, 1499, 2, 2, 6000)]),
    "sleap_slp/minimal_instance.slp": (ReadOptions(), [("minimal_instance", 1, 0, 0, 2, 2, 4)]),
    "sleap_slp/small_robot_minimal.slp": (
        ReadOptions(),
        [("small_robot_minimal", 2, 0, 79, 1, 2, 4)],
    ),
    "openpose_json/single_balancing": (
        BODY_25B,
        [
            ("cam01", 100, 0, 99, 3, 25, 4626),
            ("cam02", 100, 0, 99, 2, 25, 4898),
            ("cam03", 100, 0, 99, 1, 25, 2376),
            ("cam04", 100, 0, 99, 1, 25, 2310),
        ],
    ),
    "openpose_json/multi_participants1-2": (
        BODY_25B,
        [
            ("cam01", 100, 0, 99, 4, 25, 6676),
            ("cam02", 100, 0, 99, 3, 25, 6998),
            ("cam03", 100, 0, 99, 2, 25, 4476),
            ("cam04", 100, 0, 99, 2, 25, 4410),
        ],
    ),
    "ultralytics/train/labels": (
        ReadOptions(layout=tuple("abcde"), image_size=(384, 384)),
        [("train", 1, 1, 1, 1, 5, 5)],
    ),
}
# file: options, why it is refused
REFUSED = {
    "alphapose_like/at_testdata.json": (
        ReadOptions(),
        "annotations, class, filename",
    ),  # AlphaTracker's, which is another format
    "caliscope/stereotriangulated_points.csv": (ReadOptions(), "expected one of"),  # 3D
    "coco_results/mvor_rtpose_kps_head.json": (
        MVOR,
        "numbers in one of its `keypoints`",
    ),  # all are empty
    "dannce_mat/com3d.mat": (ReadOptions(), "camnames and labelData"),  # 3D
    "dlc_3d_h5/reachingDEMO_3D.h5": (ReadOptions(), "3D ones"),
    "dlc_h5_generated/wide_table_pd135.h5": (ReadOptions(), "an aborted write"),
    "dlc_h5_generated/wide_table_pd3.h5": (ReadOptions(), "an aborted write"),
    "dlc_superanimal_json/superanimal_frames.json": (
        ReadOptions(),
        "--layout superanimal_quadruped",
    ),
    "mmpose_json/inferencer_image.json": (
        ReadOptions(layout=LAYOUTS["coco_17"]),
        "a frame number in each file name",
    ),
    "more/dlc_3d_reaching.h5": (ReadOptions(), "3D ones"),
    "more/ndx_pose_two_cameras.nwb": (ReadOptions(), "one series for camera1.mp4, camera2.mp4"),
    "movement_netcdf/h5netcdf_written_3d.nc": (ReadOptions(), "x, y, z"),
    "movement_netcdf/reaching3d_50frames.nc": (ReadOptions(), "x, y, z"),
    "ndx_pose_nwb/0.1.1_poseestimation_nodes_edges.nwb": (ReadOptions(), "3D ones"),
    "ndx_pose_nwb/0.3.0_poseestimation_two_cameras.nwb": (
        ReadOptions(),
        "one series for camera1.mp4, camera2.mp4",
    ),
    "ndx_pose_nwb/generated_3d_ndx0.4.nwb": (ReadOptions(), "3D ones"),
    "openpose_json/single_balancing": (ReadOptions(), "--layout body_25 or body_25b"),
    "sleap_anipose_session/calibration.metadata.h5": (
        ReadOptions(),
        "expected one of",
    ),  # a calibration
    "sleap_anipose_session/points3d.h5": (ReadOptions(), "expected one of"),  # 3D
    "ultralytics/train/labels": (ReadOptions(), "--image-size"),
}


@pytest.mark.parametrize("name", LOADS)
def test_a_real_file_loads_with_its_counts(name):
    options, wanted = LOADS[name]
    found = [
        (
            view.camera,
            len(view.frames),
            int(view.frames[0]),
            int(view.frames[-1]),
            *view.positions.shape[1:3],
            int(np.isfinite(view.positions[..., 0]).sum()),
        )
        for view in read_keypoints([SAMPLES / name], None, options)
    ]
    assert found == wanted


@pytest.mark.parametrize("name", REFUSED)
def test_a_real_file_is_refused_for_its_reason(name):
    options, reason = REFUSED[name]
    with pytest.raises(FormatError) as error:
        read_keypoints([SAMPLES / name], None, options)
    assert reason in str(error.value)
    assert str(SAMPLES / name) in str(error.value)


@pytest.mark.parametrize(
    ("first", "second", "tolerance"),
    [
        (
            "sleap_anipose_session/minimal_back_proofread.analysis.h5",
            "sleap_anipose_session/minimal_back_proofread.slp",
            0.0,
        ),
        (
            "sleap_anipose_session/minimal_back_proofread.analysis.h5",
            "movement_netcdf/sleap_back_2d.nc",
            1e-4,
        ),  # movement has 32 bits
        ("more/dlc_single_lily_cam1.csv", "more/dlc_single_lily_cam1.h5", 1e-9),
        (
            "dlc_h5_generated/multi_unique_pd3.csv",
            "dlc_h5_generated/multi_unique_table_pd3.h5",
            1e-9,
        ),
        ("dlc_h5_generated/single_pd135.csv", "dlc_h5_generated/single_table_pd135.h5", 1e-9),
        ("dlc_h5_generated/single_table_pd3.h5", "dlc_h5_generated/single_table_pd135.h5", 0.0),
        ("dlc_labels/CollectedData_Pranav.csv", "dlc_labels/CollectedData_Pranav.h5", 1e-9),
    ],
)
def test_two_formats_of_one_real_recording_are_equal(first, second, tolerance):
    one, two = (read_keypoints([SAMPLES / name])[0] for name in (first, second))
    assert (one.keypoints, one.tracked) == (two.keypoints, two.tracked)
    np.testing.assert_array_equal(one.frames, two.frames)
    np.testing.assert_allclose(one.positions, two.positions, rtol=0, atol=tolerance)
    np.testing.assert_allclose(
        one.confidence, two.confidence, rtol=0, atol=max(tolerance, 2e-7)
    )  # .slp has 32 bits


def test_a_session_of_folders_is_read_whole(tmp_path):
    """A folder per camera with a file each, as sleap-anipose keeps them."""
    for camera in ("back", "mid", "side", "top"):
        (tmp_path / camera).mkdir()
        source = SAMPLES / "sleap_anipose_session" / f"minimal_{camera}_proofread.analysis.h5"
        (tmp_path / camera / source.name).write_bytes(source.read_bytes())
    assert [view.camera for view in read_keypoints([tmp_path])] == ["back", "mid", "side", "top"]
