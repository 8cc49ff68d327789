"""Laws of synthetic scenes: bodies are human, images are projections, identities are true.

Tolerances say what was measured.
"""

import dataclasses

import numpy as np
import pytest

from mocap_calib.errors import MismatchError
from mocap_calib.geometry.lens import pixels_from_points, rays_from_pixels
from mocap_calib.recording.joints import load_skeleton
from mocap_calib.synthetic import JOINTS, LAYOUTS, detect, people, ring_rig, simulate
from mocap_calib.synthetic.config import SimulateConfig
from mocap_calib.types import CameraRig

SKELETON = load_skeleton("people")
ROOM = (5.0, 4.0)
RING = {"cameras": 4, "radius": 4.5, "height": 2.2, "size": (1280, 720)}


def bodies(seed=0, individuals=4, frames=240, fps=30.0):
    return people(
        np.random.default_rng(seed), individuals=individuals, frames=frames, fps=fps, room=ROOM
    )


def ring(seed=0, distortion="brown", **changes):
    return ring_rig(np.random.default_rng(seed), **(RING | {"distortion": distortion} | changes))


def found(rig, poses, seed=1, **options):
    return detect(np.random.default_rng(seed), rig, poses, **options)


def unit(vector):
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def beside(vector, axis):
    """The part of a vector across an axis."""
    return vector - (vector * axis).sum(-1, keepdims=True) * axis


@pytest.fixture(scope="module", params=[0, 1, 10])
def poses(request):
    return bodies(request.param)


@pytest.fixture(scope="module")
def joint(poses):
    return lambda name: poses[:, :, JOINTS.index(name)]


@pytest.fixture(scope="module")
def ahead(joint):
    """`[frame, individual, 3]` where the pelvis faces: across its left, seen from above."""
    return unit(np.cross((joint("left_hip") - joint("right_hip")) * [1, 1, 0], [0.0, 0.0, 1.0]))


class TestBodies:
    def test_bones_keep_their_lengths_and_left_equals_right(self, poses):
        lengths = np.stack(
            [np.linalg.norm(poses[:, :, b] - poses[:, :, a], axis=-1) for a, b in SKELETON.edges],
            axis=-1,
        )
        np.testing.assert_allclose(lengths, np.broadcast_to(lengths[:1], lengths.shape), atol=1e-9)
        edges = [(SKELETON.keypoints[a], SKELETON.keypoints[b]) for a, b in SKELETON.edges]
        for k, (a, b) in enumerate(edges):
            if b.startswith("left_"):
                twin = edges.index((a.replace("left_", "right_"), b.replace("left_", "right_")))
                np.testing.assert_allclose(lengths[:, :, k], lengths[:, :, twin], atol=1e-9)

    def test_people_have_different_human_bodies(self, poses):
        leg = np.linalg.norm(
            poses[0, :, JOINTS.index("left_hip")] - poses[0, :, JOINTS.index("left_knee")], axis=-1
        )
        assert len(np.unique(leg.round(6))) == len(leg)
        assert (leg > 0.27).all()
        assert (leg < 0.55).all()

    def test_midpoints_are_in_the_middle(self, joint):
        np.testing.assert_allclose(
            joint("neck"), (joint("left_shoulder") + joint("right_shoulder")) / 2, atol=1e-9
        )
        np.testing.assert_allclose(
            joint("mid_hip"), (joint("left_hip") + joint("right_hip")) / 2, atol=1e-9
        )
        middle = (joint("mid_hip") + joint("neck")) / 2
        distance = np.linalg.norm(joint("spine") - middle, axis=-1)
        assert distance.max() < 0.05  # measured 0.03: trunks curve

    @pytest.mark.parametrize("side", ["left", "right"])
    def test_knees_bend_backward_only(self, joint, ahead, side):
        hip, knee, ankle = (joint(f"{side}_{name}") for name in ("hip", "knee", "ankle"))
        bend = beside(knee - hip, unit(ankle - hip))
        cosine = (bend * ahead).sum(-1) / np.linalg.norm(bend, axis=-1)
        assert cosine.min() > 0.4  # measured 0.66

    @pytest.mark.parametrize("side", ["left", "right"])
    def test_elbows_of_hanging_arms_bend_forward_only(self, joint, side):
        shoulder, elbow, wrist = (
            joint(f"{side}_{name}") for name in ("shoulder", "elbow", "wrist")
        )
        up = unit(joint("neck") - joint("spine"))
        chest = np.cross(unit(joint("left_shoulder") - joint("right_shoulder")), up)
        upper = unit(elbow - shoulder)
        hanging = (upper * up).sum(-1) < -0.8
        assert hanging.any()
        forward = (beside(wrist - elbow, upper) * chest).sum(-1)
        assert forward[hanging].min() > 0.01  # metres; measured 0.02

    def test_feet_are_on_the_floor(self, poses):
        joints = [
            JOINTS.index(f"{side}_{name}")
            for side in ("left", "right")
            for name in ("heel", "big_toe", "small_toe")
        ]
        feet = poses[:, :, joints, 2]
        assert feet.min() > 0.005  # measured 0.013
        assert feet.min(-1).max() < 0.035  # in every frame one foot stands; measured 0.021
        assert poses[..., 2].min() > 0

    def test_standing_feet_stay_where_they_are(self, joint):
        ankles = np.stack([joint("left_ankle"), joint("right_ankle")])[..., :2]
        speed = 30 * np.linalg.norm(np.diff(ankles, axis=1), axis=-1)
        slower = np.percentile(speed.min(0), 90)
        assert slower < 0.25  # m/s, an ankle rolls over its toes; measured 0.13

    def test_people_face_where_they_walk(self, joint, ahead):
        velocity = np.gradient(joint("mid_hip"), 1 / 30, axis=0) * [1, 1, 0]
        speed = np.linalg.norm(velocity, axis=-1)
        walking = speed > 0.7  # slower, hips may go back to crouch
        assert walking.any()
        assert ((velocity * ahead).sum(-1)[walking] / speed[walking]).min() > 0.5
        nose = joint("nose") - (joint("left_ear") + joint("right_ear")) / 2
        assert (unit(nose) * ahead).sum(-1).mean() > 0.7
        toes = joint("left_big_toe") - joint("left_heel")
        assert (unit(toes) * ahead).sum(-1).mean() > 0.7

    def test_left_is_left(self, joint, ahead):
        left = np.cross([0.0, 0.0, 1.0], ahead)
        for name in ("eye", "ear", "shoulder", "hip"):
            assert ((joint(f"left_{name}") - joint(f"right_{name}")) * left).sum(-1).mean() > 0

    def test_arms_swing_against_legs(self, joint, ahead):
        """Where somebody walks without a gesture; over all frames gestures average out."""
        leg = ((joint("left_ankle") - joint("right_ankle")) * ahead).sum(-1)
        arm = ((joint("left_wrist") - joint("right_wrist")) * ahead).sum(-1)
        assert np.corrcoef(leg.ravel(), arm.ravel())[0, 1] < 0

    def test_people_stay_in_the_room_and_apart(self, joint):
        place = joint("mid_hip")[..., :2]
        assert (np.abs(place) < np.array(ROOM) / 2 + 0.3).all()  # hips sway beyond the path
        distance = np.linalg.norm(place[:, :, None] - place[:, None], axis=-1)
        distance = distance + 10 * np.eye(place.shape[1])  # nobody is near themselves
        assert (distance.min((1, 2)) > 0.5).mean() > 0.95  # measured 1.0

    def test_motion_is_smooth(self, poses):
        speed = 30 * np.linalg.norm(np.diff(poses, axis=0), axis=-1)
        assert speed.max() < 10  # m/s; measured 7.7, a hand

    @pytest.mark.parametrize("fps", [7.5, 25.0, 120.0])
    def test_any_frame_rate(self, fps):
        assert bodies(individuals=1, frames=10, fps=fps).shape == (10, 1, 29, 3)
        assert bodies(individuals=2, frames=1, fps=fps).shape == (1, 2, 29, 3)

    def test_same_seed_same_bytes(self):
        assert bodies(3, frames=20).tobytes() == bodies(3, frames=20).tobytes()
        assert bodies(3, frames=20).tobytes() != bodies(4, frames=20).tobytes()

    def test_nobody_is_refused_in_one_line(self):
        with pytest.raises(MismatchError, match="0 individuals"):
            bodies(individuals=0)


class TestRig:
    @pytest.mark.parametrize("distortion", ["none", "brown", "fisheye"])
    def test_cameras_look_into_the_room(self, distortion):
        rig = ring(distortion=distortion)
        for camera, rotation, translation in zip(
            rig.cameras, rig.rotation, rig.translation, strict=True
        ):
            pixel = pixels_from_points(camera, rotation @ [0.0, 0.0, 1.0] + translation)
            offset = np.abs(pixel - np.array(camera.size) / 2)
            assert offset.max() < 200  # aims differ by decimetres
            assert camera.fisheye == (distortion == "fisheye")
        assert rig.names == ("cam1", "cam2", "cam3", "cam4")
        np.testing.assert_allclose(np.linalg.det(rig.rotation), 1)
        # the image's down is the world's down, but for a roll of a few degrees
        assert (rig.rotation[:, 1, 2] < -0.7).all()

    @pytest.mark.parametrize("distortion", ["none", "brown", "fisheye"])
    def test_distortion_does_not_fold(self, distortion):
        camera = ring(distortion=distortion).cameras[0]
        x, y = np.meshgrid(np.linspace(0, 1279, 9), np.linspace(0, 719, 9))
        pixels = np.stack([x, y], axis=-1)
        np.testing.assert_allclose(
            pixels_from_points(camera, rays_from_pixels(camera, pixels)), pixels, atol=1e-6
        )

    def test_arc(self):
        assert self._widest(ring(arc_deg=20.0)) < 30
        assert 70 < self._widest(ring(cameras=2, arc_deg=90.0)) < 115
        assert self._widest(ring(cameras=8)) > 140

    @staticmethod
    def _widest(rig):
        way = unit(rig.centres[:, :2])
        return np.degrees(np.arccos(np.clip(way @ way.T, -1, 1))).max()

    def test_no_camera_is_refused(self):
        with pytest.raises(MismatchError, match="cameras"):
            ring(cameras=0)


def backward(rig):
    """The same cameras, each turned about its own vertical by 180 degrees."""
    turn = np.diag([-1.0, 1.0, -1.0])
    return CameraRig(rig.cameras, turn @ rig.rotation, rig.translation @ turn, rig.unit)


class TestDetections:
    @pytest.mark.parametrize("distortion", ["none", "brown", "fisheye"])
    @pytest.mark.parametrize("layout", ["coco17", "all"])
    def test_without_flaws_they_are_the_projection(self, distortion, layout):
        poses, rig = bodies(frames=30), ring(distortion=distortion)
        seen = found(rig, poses, layout=layout, shuffle=False)
        assert seen.keypoints == LAYOUTS[layout]
        for v, camera in enumerate(rig.cameras):
            pixels = pixels_from_points(
                camera, poses[:, :, : len(seen.keypoints)] @ rig.rotation[v].T + rig.translation[v]
            )
            inside = ((pixels >= -0.5) & (pixels <= np.array(camera.size) - 0.5)).all(-1)
            for f in range(30):
                for i, who in enumerate(seen.identity[v, f]):
                    if who >= 0:
                        np.testing.assert_array_equal(
                            np.isfinite(seen.positions[v, f, i, :, 0]), inside[f, who]
                        )
                        np.testing.assert_array_equal(
                            seen.positions[v, f, i][inside[f, who]], pixels[f, who][inside[f, who]]
                        )
                assert set(seen.identity[v, f]) - {-1} == set(
                    np.flatnonzero(inside[f].sum(-1) >= 4)
                )

    def test_true_identities_triangulate_to_the_truth(self):
        poses, rig = bodies(frames=20), ring(distortion="brown")
        seen = found(rig, poses, shuffle=True)
        assert len({tuple(row) for row in seen.identity[0]}) > 1  # shuffled indeed
        projectors, sums = np.zeros((20, 4, 17, 3, 3)), np.zeros((20, 4, 17, 3))
        for v, camera in enumerate(rig.cameras):
            rays = rays_from_pixels(camera, seen.positions[v]) @ rig.rotation[v]
            for f, i in np.argwhere(seen.identity[v] >= 0):
                ok = np.isfinite(rays[f, i, :, 0])
                across = np.eye(3) - rays[f, i, ok, :, None] * rays[f, i, ok, None, :]
                projectors[f, seen.identity[v, f, i], ok] += across
                sums[f, seen.identity[v, f, i], ok] += across @ rig.centres[v]
        known = np.linalg.matrix_rank(projectors, tol=1e-3) == 3
        assert known.mean() > 0.9
        points = np.linalg.solve(projectors[known], sums[known][..., None])[..., 0]
        np.testing.assert_allclose(points, poses[:, :, :17][known], atol=1e-6)

    def test_noise_is_as_large_as_said_and_confidence_knows_of_it(self):
        poses, rig = bodies(frames=100), ring()
        true, seen = (
            found(rig, poses, shuffle=False),
            found(rig, poses, noise_px=2.0, shuffle=False),
        )
        error = (seen.positions - true.positions)[np.isfinite(true.positions[..., 0])]
        assert np.sqrt((error**2).mean()) == pytest.approx(2.0, rel=0.03)  # 1 % at this many joints
        confidence = seen.confidence[np.isfinite(true.positions[..., 0])]
        assert np.corrcoef(confidence, np.linalg.norm(error, axis=-1))[0, 1] < -0.2

    def test_missing_share(self):
        poses, rig = bodies(frames=100), ring()
        whole, gaps = (
            np.isfinite(found(rig, poses, missing=m).positions[..., 0]).sum() for m in (0.0, 0.2)
        )
        assert gaps / whole == pytest.approx(0.8, abs=0.02)

    def test_outlier_share_and_their_confidence(self):
        poses, rig = bodies(frames=100), ring()
        true, seen = (
            found(rig, poses, shuffle=False),
            found(rig, poses, outliers=0.05, shuffle=False),
        )
        ok = np.isfinite(true.positions[..., 0])
        far = np.linalg.norm(seen.positions - true.positions, axis=-1)[ok] > 10
        assert far.mean() == pytest.approx(0.05, abs=0.01)
        assert seen.confidence[ok][far].mean() < seen.confidence[ok][~far].mean() - 0.1

    def test_false_detections(self):
        poses = bodies(frames=200, individuals=2)
        rig = ring(size=(4000, 3000))  # so wide that all is seen
        seen = found(rig, poses, false_detections=0.3)
        there = np.isfinite(seen.positions[..., 0]).any(-1)
        false = there & (seen.identity < 0)
        assert false.sum(2).max() == 1
        assert 0.2 < false.any(2).mean() < 0.35  # some fall out of the image
        assert not (found(rig, poses).identity[..., :2] < 0).any()

    def test_swaps_exchange_left_and_right(self):
        poses, rig = bodies(frames=20), ring()
        true, seen = found(rig, poses, shuffle=False), found(rig, poses, swaps=1.0, shuffle=False)
        twin = [
            JOINTS.index(n)
            for n in (
                j.replace("left", "?").replace("right", "left").replace("?", "right")
                for j in LAYOUTS["coco17"]
            )
        ]
        np.testing.assert_array_equal(seen.positions, true.positions[..., twin, :])

    def test_detections_come_first_and_have_four_joints(self):
        seen = found(
            ring(distortion="none", radius=2.5),
            bodies(frames=100),
            missing=0.5,
            false_detections=0.5,
        )
        joints = np.isfinite(seen.positions[..., 0]).sum(-1)
        assert ((joints == 0) | (joints >= 4)).all()
        assert (np.diff((joints > 0).astype(int), axis=2) <= 0).all()
        assert (joints[..., -1] > 0).any()  # no instance too many
        np.testing.assert_array_equal(seen.confidence > 0, np.isfinite(seen.positions[..., 0]))
        assert (seen.identity[joints == 0] == -1).all()

    def test_nothing_is_seen_behind_the_camera(self):
        assert not np.isfinite(
            found(backward(ring(distortion="none")), bodies(frames=10)).positions
        ).any()

    def test_shares_are_checked(self):
        with pytest.raises(MismatchError, match=r"missing 1\.5"):
            found(ring(), bodies(frames=2), missing=1.5)


class TestScene:
    CONFIG = SimulateConfig(frames=30, people=2)

    def test_same_seed_same_bytes(self):
        first, second = simulate(self.CONFIG), simulate(self.CONFIG)
        assert first.detections.positions.tobytes() == second.detections.positions.tobytes()
        assert first.detections.identity.tobytes() == second.detections.identity.tobytes()
        assert first.rig.rotation.tobytes() == second.rig.rotation.tobytes()

    def test_another_seed_is_another_scene(self):
        first, second = simulate(self.CONFIG), simulate(dataclasses.replace(self.CONFIG, seed=1))
        assert not np.allclose(first.poses, second.poses)
        assert not np.allclose(first.rig.rotation, second.rig.rotation)

    def test_another_detector_sees_the_same_scene(self):
        first, second = (
            simulate(self.CONFIG),
            simulate(dataclasses.replace(self.CONFIG, noise_px=9.0, layout="all")),
        )
        np.testing.assert_array_equal(first.poses, second.poses)
        np.testing.assert_array_equal(first.rig.translation, second.rig.translation)

    def test_files_hold_the_detections(self):
        scene = simulate(self.CONFIG)
        assert [file.camera for file in scene.files] == list(scene.rig.names)
        np.testing.assert_array_equal(scene.files[2].positions, scene.detections.positions[2])
