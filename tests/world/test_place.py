"""Coordinates of results: what moves, and what stays as it is when all else does."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scenes import recording, scene
from test_floor import exact, level_rig, poses_of

from mocap_calib.config import KnownCamera, Landmark, ScaleCue, WorldConfig
from mocap_calib.errors import FormatError, MismatchError
from mocap_calib.geometry.rotation import Similarity, matrix_from_vector
from mocap_calib.io.cameras.read import make_rig, parse_content
from mocap_calib.io.cameras.write import format_rig
from mocap_calib.io.landmarks_csv import read_landmarks
from mocap_calib.io.poses import npz
from mocap_calib.io.poses.common import PoseFile
from mocap_calib.io.results.poses_h5 import parse_poses_h5, poses_to_h5
from mocap_calib.results import POINT_SOURCES, RigCovariance
from mocap_calib.types import CameraRig, MeasuredCue, MeasuredLandmark, World
from mocap_calib.world.align import align_to_cameras, align_to_landmarks
from mocap_calib.world.floor import Floor, find_joints
from mocap_calib.world.lengths import Measurable
from mocap_calib.world.place import (
    check_world,
    find_placement,
    measurable,
    move_covariance,
    move_poses,
    move_rig,
)

SIDES = ("left", "right", "left")
BY = Similarity(1.7, matrix_from_vector(np.array([0.3, -0.2, 1.2])), np.array([1.0, -2.0, 0.5]))
WORLD = World(
    kind="floor",
    up=np.array([0.0, 0.0, 1.0]),
    up_sigma=0.02,
    floor=np.zeros(3),
    floor_sigma=0.01,
    scale_sigma=0.03,
    remarks=("from feet",),
    cues=(MeasuredCue("height", 1.75, 1.75, 0.03, 0.5),),
    landmarks=(MeasuredLandmark("a", 0.25),),
)


def test_cameras_see_the_same_points_wherever_both_are_moved():
    made = scene()
    moved = move_rig(made.rig, BY, "m", WORLD)
    points = made.poses[::20].reshape(-1, 3)
    np.testing.assert_allclose(moved.project(BY.apply(points)), made.rig.project(points), atol=1e-8)
    np.testing.assert_allclose(moved.centres, BY.apply(made.rig.centres), atol=1e-9)
    assert (moved.unit, moved.world.kind) == ("m", "floor")


def test_poses_and_their_covariances_move_alike():
    made = scene()
    poses = poses_of(made.poses, made.joints)
    spread = np.tile(np.float32([4, 1, 0, 3, 0, 2]), (*made.poses.shape[:3], 1))
    raw = poses.positions + 0.1
    moved = move_poses(replace(poses, covariance=spread, raw=raw), BY, "m", WORLD)
    np.testing.assert_allclose(moved.positions, BY.apply(poses.positions), atol=1e-9)
    np.testing.assert_allclose(moved.raw, BY.apply(raw), atol=1e-9)
    matrix = np.array([[4, 1, 0], [1, 3, 0], [0, 0, 2]])
    expected = BY.scale**2 * BY.rotation @ matrix @ BY.rotation.T
    upper = expected[np.triu_indices(3)]
    np.testing.assert_allclose(moved.covariance[0, 0, 0], upper, rtol=1e-5)
    assert move_poses(poses, BY, "m", WORLD).raw is not None


def test_the_covariance_of_a_rig_turns_with_the_axes():
    """Errors of cameras, drawn and turned, have the covariance that was turned."""
    rng = np.random.default_rng(0)
    draws = rng.normal(size=(50, 3, 6)) * np.arange(1, 7)
    covariance = RigCovariance(np.einsum("nvi,nwj->viwj", draws, draws) / 50, 2.0)
    turned = np.concatenate([draws[..., :3] @ BY.rotation.T, draws[..., 3:] @ BY.rotation.T], -1)
    moved = move_covariance(covariance, BY)
    np.testing.assert_allclose(
        moved.matrix, np.einsum("nvi,nwj->viwj", turned, turned) / 50, atol=1e-12
    )
    assert moved.size == pytest.approx(2.0 * BY.scale)
    np.testing.assert_allclose(moved.rotation_sigma, covariance.rotation_sigma)


def test_known_cameras_and_landmarks_bring_a_rig_back_to_its_world():
    made = scene()
    away = move_rig(made.rig, BY, "arbitrary", World())
    known = known_cameras(made.rig)
    by, sigma, world = align_to_cameras(
        away, WorldConfig(cameras=known[1:3], unit="m"), exact(away)
    )
    np.testing.assert_allclose(by.apply(away.centres), made.rig.centres, atol=1e-8)
    assert sigma < 1e-8
    assert world.remarks == (
        "aligned to 2 cameras of known pose, RMS distance 0 mm, RMS angle 0.0 deg",
    )
    by, sigma, world = align_to_landmarks(away, WorldConfig(landmarks=landmarks()), exact(away))
    np.testing.assert_allclose(by.apply(away.centres), made.rig.centres, atol=1e-5)
    assert sigma < 1e-5
    assert [each.name for each in world.landmarks] == list("abcd")
    assert max(each.distance for each in world.landmarks) < 1e-5


def people_seen() -> Measurable:
    """Walkers with truth, without a floor."""
    made = scene()
    poses, joints = poses_of(made.poses, made.joints), find_joints(made.joints)
    return Measurable(poses, joints, made.rig, "no floor is asked for", exact(made.rig))


def known_cameras(rig: CameraRig) -> tuple[KnownCamera, ...]:
    """The cameras of a rig, as a file places them."""
    return tuple(
        KnownCamera(each.name, tuple(each.rotation.ravel()), tuple(each.translation))
        for each in rig
    )


def landmarks(
    places=((0, 0, 0), (1, 0, 0), (0, 1, 0), (0.3, 0.2, 1)), stated=None, noise: float = 0.0
) -> tuple[Landmark, ...]:
    """What cameras see of points whose places are known; stated: where somebody says they are."""
    rig = scene().rig
    pixels = rig.project(np.array(places, float))
    pixels = pixels + noise * np.random.default_rng(0).normal(size=pixels.shape)
    stated = places if stated is None else stated
    return tuple(
        Landmark("abcde"[k], tuple(map(float, place)), name, tuple(pixels[view, k]))
        for k, place in enumerate(stated)
        for view, name in enumerate(rig.names)
    )


def test_landmarks_that_do_not_say_enough_are_refused_in_a_line():
    rig = scene().rig
    line = landmarks(((0, 0, 0), (1, 0, 0), (2, 0, 0)))
    with pytest.raises(MismatchError, match="not on a line"):
        align_to_landmarks(rig, WorldConfig(landmarks=line), exact(rig))
    alone = [each for each in landmarks() if each.camera == rig.names[0]]
    with pytest.raises(MismatchError, match="3 landmarks that two cameras see, found 0 of 4"):
        align_to_landmarks(rig, WorldConfig(landmarks=alone), exact(rig))
    with pytest.raises(MismatchError, match="at least two cameras of the recording"):
        align_to_cameras(rig, WorldConfig(), exact(rig))


MARKS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.5, 0.5, 1]])


def test_landmarks_measured_by_hand_are_good_enough():
    """Measured: 0.4 sigma with a pixel of noise, 1.4 with 2 cm (an axis) in 4 m, of 5."""
    rig = scene().rig
    align_to_landmarks(rig, WorldConfig(landmarks=landmarks(MARKS, noise=1.0)), exact(rig))
    wide = 4.0 * (MARKS - 0.5) * [1, 1, 0.4] + [0, 0, 1]
    by_hand = wide + 0.02 * np.random.default_rng(0).normal(size=wide.shape)
    align_to_landmarks(rig, WorldConfig(landmarks=landmarks(wide, by_hand, noise=1.0)), exact(rig))


@pytest.mark.parametrize(
    ("stated", "says"),
    [
        (MARKS * [1, 1, 2], "most of all e; correct or leave out that one"),
        (MARKS[:, [1, 0, 2]], "give the file right-handed axes"),
        (MARKS * [1, 3, 1], "most of all .; correct"),
    ],
)
def test_landmarks_that_contradict_what_cameras_see_are_refused(stated, says):
    rig = scene().rig
    with pytest.raises(MismatchError, match=says) as error:
        align_to_landmarks(
            rig, WorldConfig(landmarks=landmarks(MARKS, stated, noise=1.0)), exact(rig)
        )
    assert "\n" not in str(error.value)


def test_files_of_cameras_are_held_to_the_rig():
    """Measured: 0.7 sigma for a calibration of 1 deg, of 5 that are allowed."""
    rng = np.random.default_rng(0)
    rig = scene().rig
    away = move_rig(rig, BY, "arbitrary", World())
    turn = np.radians(1) / np.sqrt(3) * rng.normal(size=(len(rig), 3))
    rough = place(rig, matrix_from_vector(turn) @ rig.rotation, rig.centres)
    _, _, world = align_to_cameras(
        away, WorldConfig(cameras=known_cameras(rough), unit="m"), exact(away)
    )
    assert "RMS angle 0.7 deg" in world.remarks[0]
    one = rig.rotation.copy()
    one[1] = matrix_from_vector(np.array([0.0, 0.6, 0.0])) @ one[1]
    made_up = matrix_from_vector(rng.normal(size=(len(rig), 3)))
    mirrored = rig.centres * [-1, 1, 1]
    for other, says in (
        (place(rig, one, rig.centres), f"most of all {rig.names[1]}; correct"),
        (place(rig, made_up, rig.centres), "deg from there"),
        (place(rig, rig.rotation, mirrored), "found them .* deg from there"),
    ):
        with pytest.raises(MismatchError, match=says):
            align_to_cameras(away, WorldConfig(cameras=known_cameras(other)), exact(away))


@pytest.mark.parametrize(
    ("length", "says"),
    [
        (
            1000,
            "--align: expected lengths in its unit, found people .* m tall; were millimetres meant",
        ),
        (100, "were centimetres meant. multiply by 0.01"),
        (39.4, "were inches meant"),
        (1e6, "tall; correct it"),
    ],
)
def test_landmarks_in_another_unit_are_told_by_the_people(length, says):
    assert re.search(says, placed_by_landmarks(MARKS, length * MARKS).axes_unmet)


def test_landmarks_that_make_people_small_are_doubted():
    assert not placed_by_landmarks(MARKS, MARKS).axes_unmet
    small = placed_by_landmarks(MARKS, 0.1 * MARKS)
    assert (small.kind, small.axes_unmet) == ("landmarks", "")
    assert small.remarks[1].endswith("m tall: is the unit of --align right?")


def test_a_file_of_cameras_in_another_unit_is_told_by_the_people():
    made = scene()
    on = people_seen()
    known = known_cameras(made.rig)
    assert not find_placement(on, WorldConfig(cameras=known, unit="m")).world.axes_unmet
    far = known_cameras(made.rig.scale(1000, "m"))
    unmet = find_placement(on, WorldConfig(cameras=far, unit="m")).world.axes_unmet
    assert "--world: expected lengths in its unit, found people" in unmet


def place(rig: CameraRig, rotation: np.ndarray, centres: np.ndarray) -> CameraRig:
    """The rig with other rotations and centres."""
    shift = -np.einsum("vij,vj->vi", rotation, centres)
    return replace(rig, rotation=rotation, translation=shift)


def test_an_alignment_that_contradicts_is_left_out_and_said():
    world = placed_by_landmarks(MARKS, MARKS[:, [1, 0, 2]])
    assert world.kind == "camera"
    assert "right-handed axes" in world.axes_unmet


def placed_by_landmarks(places: np.ndarray, stated: np.ndarray) -> World:
    """The world of people among landmarks, or of what there is instead."""
    on = people_seen()
    marks = landmarks(places, stated)
    return find_placement(on, WorldConfig(landmarks=marks)).world


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"axes": "flor"}, "--world: expected one of auto, floor.*did you mean floor"),
        ({"forward": "nose-tail"}, "--forward nose-tail: expected two joints"),
        (
            {"forward": "left_hip-right_hip", "axes": "first-camera"},
            "--forward: expected a world on the floor, found another",
        ),
        (
            {"cues": (ScaleCue("height", 1.7, of="anna"),)},
            "expected an individual, one of 0, 1, ...",
        ),
        ({"cues": (ScaleCue("height", 1.7), ScaleCue("height", 1.8))}, "each length once"),
        (
            {"cues": (ScaleCue("height", 1.7, 0, "1"), ScaleCue("height", 1.8, 0, "individual_1"))},
            "found height of individual_1 twice",
        ),
        (
            {"cues": tuple(ScaleCue("length", 0.4, 0, f"{side}_hip-left_knee") for side in SIDES)},
            "length left_hip-left_knee twice",
        ),
        ({"landmarks": (Landmark("a", (0, 0, 0), "cam9", (1, 1)),)}, "--align: .*'cam9'"),
    ],
)
def test_unknown_names_are_refused_before_the_work(asked, says):
    with pytest.raises(MismatchError, match=says):
        check_world(WorldConfig(**asked), recording())


def test_individuals_may_be_called_as_results_call_them():
    check_world(WorldConfig(cues=(ScaleCue("height", 1.7, of="individual_1"),)), recording(), 2)
    with pytest.raises(MismatchError, match="one of 0, 1"):
        check_world(WorldConfig(cues=(ScaleCue("height", 1.7, of="individual_2"),)), recording(), 2)


def test_the_floor_is_below_triangulated_points_and_of_rigs_that_are_determined():
    made = scene()
    joints, rig = find_joints(made.joints), level_rig()
    seen = poses_of(made.poses, made.joints)
    source = seen.source.copy()
    source[::2] = POINT_SOURCES.index("interpolated")
    lower = seen.positions - np.where(source[..., None] == source[0, 0, 0], 5.0, 0.0)
    guessed = replace(seen, positions=lower, source=source)
    half = seen.select(frames=np.arange(1, len(seen.frames), 2))
    floors = [
        measurable(each, joints, rig, exact(rig), WorldConfig(), verdict="usable").floor
        for each in (guessed, half)
    ]
    assert isinstance(floors[0], Floor)
    np.testing.assert_allclose(floors[0].point, floors[1].point)
    on = measurable(seen, joints, rig, exact(rig), WorldConfig(), verdict="not determined")
    assert on.floor == "the rig is not determined"


def test_files_say_what_the_coordinates_are_and_it_is_read_back():
    rig = replace(scene().rig, world=WORLD, unit="m")
    for format in ("mocap-calib", "anipose"):
        (content,) = format_rig(rig, format, {}).files.values()
        same_world(make_rig(parse_content(content, "a"), "a").world)
    poses = replace(poses_of(scene().poses, scene().joints), world=WORLD)
    same_world(parse_poses_h5(poses_to_h5(poses, {}), "a").world)
    same_world(npz.parse(npz.write(PoseFile(poses), "").content, "a").poses.world)


def test_a_known_length_scales_a_world_of_cameras_whose_unit_nobody_knows():
    made = scene()
    target = move_rig(made.rig, BY, "arbitrary", World())
    known = known_cameras(target)
    cue = ScaleCue("camera distance", 3.0, 0.0, "-".join(target.names[:2]))
    on = people_seen()
    placement = find_placement(on, WorldConfig(cameras=known, cues=(cue,)))
    found = move_rig(made.rig, placement.by, placement.unit, placement.world)
    assert found.unit == "m"
    assert found.world.kind == "file"
    assert "axes and origin are those of the file; lengths follow" in found.world.remarks[1]
    assert np.linalg.norm(found.centres[1] - found.centres[0]) == pytest.approx(3.0)
    np.testing.assert_allclose(found.rotation, target.rotation, atol=1e-9)
    ratio = 3.0 / np.linalg.norm(target.centres[1] - target.centres[0])
    np.testing.assert_allclose(found.centres, ratio * target.centres, atol=1e-9)


@pytest.mark.parametrize(
    ("asked", "axes", "scale"),
    [
        ({"axes": "floor"}, "--world floor: expected subjects that show a floor, found that", ""),
        ({"axes": "cam9"}, "--world cam9: expected a camera of the rig", ""),
        ({"forward": "left_hip-right_hip"}, "--forward left_hip-right_hip: expected subjects", ""),
        ({"cues": (ScaleCue("height", 1.7),)}, "", "--height: expected someone who stands"),
        ({"cues": (ScaleCue("camera distance", 3, 0, "cam1-cam9"),)}, "", "found 'cam9'"),
    ],
)
def test_what_a_recording_does_not_show_is_left_out_and_said(asked, axes, scale):
    made = scene()
    placement = find_placement(people_seen(), WorldConfig(**asked))
    assert (placement.world.kind, placement.world.camera) == ("camera", made.rig.names[0])
    assert placement.unit == "arbitrary"
    for found, says in ((placement.world.axes_unmet, axes), (placement.world.scale_unmet, scale)):
        assert bool(found) == bool(says)
        assert says in found


def test_a_file_of_landmarks_without_any_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("name,x,y,z,camera,u,v\n", "utf-8")
    with pytest.raises(FormatError, match="expected landmarks, found a header alone"):
        read_landmarks(tmp_path / "a.csv")


def test_landmarks_with_a_torn_line_are_refused(tmp_path):
    (tmp_path / "a.csv").write_bytes(b"name,x,y,z,camera,u,v\ncor\rner,0,0,0,cam1,1,2\n")
    with pytest.raises(FormatError, match="expected a table of landmarks, found"):
        read_landmarks(tmp_path / "a.csv")


def test_a_file_of_cameras_that_nobody_recorded_is_refused_before_anything_is_computed():
    strangers = tuple(
        KnownCamera(f"other{k}", (1, 0, 0, 0, 1, 0, 0, 0, 1), (k, 0, 0)) for k in (0, 1)
    )
    with pytest.raises(MismatchError, match="at least two cameras of the recording"):
        check_world(WorldConfig(cameras=strangers), recording())


def same_world(found: World) -> None:
    assert (found.kind, found.remarks) == ("floor", WORLD.remarks)
    assert (found.cues, found.landmarks) == (WORLD.cues, WORLD.landmarks)
    np.testing.assert_array_equal(found.up, WORLD.up)
    np.testing.assert_array_equal(found.floor, WORLD.floor)
    sigmas = [found.up_sigma, found.floor_sigma]
    assert sigmas == pytest.approx([WORLD.up_sigma, WORLD.floor_sigma])
