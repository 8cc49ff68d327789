"""`inspect`: its numbers of files whose content is known, and what stands in the way of a run."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scenes import scene
from scipy.spatial.transform import Rotation

import mocap_calib as mc

NAMES = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
SIZE = (640, 480)


@dataclass(frozen=True)
class Inspected:
    """What the command said, as JSON, and its exit status."""

    report: dict
    status: int

    def messages(self, word: str = "", level: str = "") -> list[str]:
        """Return the messages with a word, of a level where one is named."""
        found = [each for each in self.report["findings"] if level in ("", each["level"])]
        return [each["message"] for each in found if word in each["message"]]

    def warnings(self, word: str) -> list[str]:
        return [text for text in self.messages(word) if text not in self.messages(word, "CRITICAL")]

    @property
    def critical(self) -> bool:
        return bool(self.messages(level="CRITICAL"))


@pytest.fixture
def inspect(tool, tmp_path) -> Callable[..., Inspected]:
    """Writes views as COCO, and what else is given, and inspects the folder."""

    def run(
        views: Sequence[mc.Keypoints2D],
        cameras: Sequence[mc.Camera] = (),
        aliases: dict[str, str] | None = None,
    ) -> Inspected:
        mc.write(views, tmp_path / "keypoints", format="coco")
        words = ["inspect", "keypoints", "--json"]
        if cameras:
            count = len(cameras)
            still, apart = np.stack([np.eye(3)] * count), np.arange(3.0 * count).reshape(-1, 3)
            mc.write(mc.CameraRig(list(cameras), still, apart, "m"), tmp_path / "rig.toml")
            words += ["--cameras", "rig.toml"]
        if aliases:
            pairs = ", ".join(f"{name}: {joint}" for name, joint in aliases.items())
            (tmp_path / "own.yaml").write_text(f"aliases: {{{pairs}}}")
            words += ["--skeleton", "own.yaml"]
        done = tool(*words, cwd=tmp_path)
        assert done.stderr == ""
        return Inspected(json.loads(done.stdout), done.returncode)

    return run


def view(camera="a", frames=range(40), instances=1, seed=0, names=NAMES, size=SIZE):
    """Detections at random places of the image."""
    positions = np.random.default_rng(seed).uniform(5, 470, (len(frames), instances, len(names), 2))
    scores, source = np.full(positions.shape[:3], 0.8), f"{camera}.json"
    return mc.Keypoints2D(camera, names, np.array(frames), positions, scores, False, size, source)


def camera(name, size=SIZE):
    return mc.Camera(name, size, [[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])


# --- numbers


def test_the_numbers_are_those_of_the_files(inspect):
    first = view(frames=[3, 4, 10, 11], instances=2)
    first.positions[1, 1], first.positions[3] = np.nan, np.nan
    first.positions[:, :, 4] = np.nan
    corner = view("c", frames=range(400), size=(1000, 1000))
    corner.positions[:] = corner.positions % 200  # a fifth each way
    corner.positions[0] = 1500.0
    report = inspect([first, view("b", frames=[4, 10, 12]), corner]).report
    found = report["cameras"][0]
    assert (found["frames"]["first"], found["frames"]["gaps"][0]) == (3, [5, 9])
    assert (found["detections"], found["most_at_once"], found["points"]) == (5, 2, 20)
    assert (found["never_seen"], found["followed"]) == (["right_ear"], False)
    assert found["confidence"] == pytest.approx({"least": 0.8, "median": 0.8, "most": 0.8})
    pair = report["pairs"][0]
    assert (pair["frames"], pair["covisible"], pair["joints"]) == (2, 2, 5)
    assert report["model"] == {"name": "people", "knows": 5, "unknown": []}
    image = report["cameras"][2]["image"]
    assert image["covered"] == pytest.approx(0.04)
    assert image["outside"] == pytest.approx(1 / 400)


def test_names_count_by_what_they_mean_as_in_a_run(inspect):
    """Other spellings and aliases are the joint for pairs, the model and the findings."""
    own = [f"{side}{k}" for side in "qw" for k in range(5)]
    views = [view("a", names=tuple(own[:5])), view("b", names=tuple(own[5:]), seed=1)]
    assert inspect(views).critical
    found = inspect(views, BOTH, dict(zip(own, NAMES * 2, strict=True)))
    assert (found.report["model"]["knows"], found.report["pairs"][0]["joints"]) == (5, 5)
    assert not found.critical
    others = dict(zip(own, ("chin", "head", "neck_base", "croup", "nose") * 2, strict=True))
    assert inspect(views, (), others).report["model"]["name"] == "quadruped"


# --- what a run would refuse


STRANGERS = {"instances": 2, "names": ("q", "r", "s", "t", "u")}

BOTH = (camera("a"), camera("b"))


@pytest.mark.parametrize(
    ("first", "second", "cameras"),
    [
        ({}, {}, (camera("a"), camera("c"))),  # none of its cameras
        ({"names": NAMES[:4]}, {"names": NAMES[1:]}, ()),  # three joints in common
        (STRANGERS, STRANGERS, BOTH),  # a crowd that no model knows
    ],
)
def test_what_a_run_would_refuse_is_critical(inspect, tool, tmp_path, first, second, cameras):
    """And the run refuses it."""
    found = inspect([view("a", **first), view("b", seed=1, **second)], cameras)
    assert found.critical
    assert found.status == 1
    words = ("--cameras", tmp_path / "rig.toml") if cameras else ("--image-size", "640x480")
    run = tool("run", tmp_path / "keypoints", *words, "-o", tmp_path / "out")
    assert run.returncode == 1
    assert not (tmp_path / "out" / "run.json").exists()


def test_a_file_that_cannot_be_read_is_critical_and_the_others_are_reported(
    inspect, tool, tmp_path
):
    """A good recording has nothing in its way, and headings are explained once."""
    found = inspect([view("a"), view("b", seed=1)], BOTH)
    assert (found.messages(), found.status) == ([], 0)
    said = tool("inspect", tmp_path / "keypoints").stdout
    for heading in ("range", "gaps", "followed", "missing", "score", "covered"):
        assert sum(line.startswith(f"{heading:<10}  ") for line in said.splitlines()) == 1
    (tmp_path / "keypoints" / "a.json").write_text('{"images": []')
    done = tool("inspect", tmp_path / "keypoints")
    assert done.returncode == 1
    lines = [line for line in done.stdout.splitlines() if line.startswith("CRITICAL: ")]
    assert len(lines) == 2  # the file, and that one camera is left
    assert str(tmp_path / "keypoints" / "a.json") in lines[0]


def test_a_camera_that_sees_nothing_or_nothing_with_others_is_named_once(inspect):
    apart = view("c", frames=range(100, 140), seed=2)
    blind = replace(apart, positions=np.full_like(apart.positions, np.nan))
    for third in (apart, blind):
        found = inspect([view("a"), view("b", seed=1), third])
        assert not found.critical
        assert len([text for text in found.messages() if text.startswith("c:")]) == 1


# --- subjects that stand still or are flat, cameras that see too little


def frozen(views: Sequence[mc.Keypoints2D], noise: float) -> list[mc.Keypoints2D]:
    """One frame of each view, repeated with noise in pixels."""
    rng = np.random.default_rng(0)
    still = [each.positions[np.full(60, 20)] for each in views]
    return [
        replace(each, positions=pose + rng.normal(0, noise, pose.shape), frames=np.arange(60))
        for each, pose in zip(views, still, strict=True)
    ]


def sees_only(each: mc.Keypoints2D, frames: range) -> mc.Keypoints2D:
    """The view with detections in these frames alone."""
    seen = np.isin(each.frames, list(frames))
    return replace(each, positions=np.where(seen[:, None, None, None], each.positions, np.nan))


@pytest.mark.parametrize(
    ("changes", "noise"),
    [
        ({"people": 1}, 0.5),
        ({"people": 3}, 3.0),
        ({}, None),
        ({"people": 1, "frames": 10}, None),
    ],
)
def test_a_still_subject_is_foretold_and_one_that_moves_is_not(inspect, changes, noise):
    """Simulated 0.01 to 0.07 of a body where it stands, 0.3 and more where it walks."""
    quiet = {} if noise is None else {"noise_px": 0.0, "false_detections": 0.0}
    views = scene(**changes, **quiet).files
    found = inspect(views if noise is None else frozen(views, noise))
    assert len(found.warnings("moves")) == (noise is not None)


def test_a_camera_that_shares_few_frames_is_named(inspect):
    *others, last = scene(cameras=4).files
    assert not inspect([*others, last]).messages("cam4:")
    (said,) = inspect([*others, sees_only(last, range(7))]).warnings("cam4:")
    assert "7 frames" in said


def test_groups_that_share_no_frame_are_foretold(inspect):
    views = scene(cameras=4).files
    first, second = range(30), range(30, 60)
    parts = zip(views, (first, second, first, second), strict=True)
    apart = [sees_only(each, frames) for each, frames in parts]
    (said,) = inspect(apart).warnings("groups")
    assert "cam1, cam3" in said
    assert "cam2, cam4" in said
    assert not inspect([*apart[:3], views[3]]).warnings("groups")


# --- two views of one subject

JOINTS = scene().files[0].keypoints
IMAGE = (1280, 720)
UP = np.array([0.0, 0, 1])


def walk(rng, bodies=1, thickness=1.0, frames=60):
    """Return `[frame, body, joint, 3]` metres of bodies that go about and turn, about the origin.

    thickness: of all that is seen along the first axis, 0 = in a plane.
    """
    body = rng.normal(size=(len(JOINTS), 3)) * [0.2, 0.2, 0.5]
    time = np.linspace(0, 6, frames)[:, None] + rng.uniform(0, 6, bodies)
    turn = Rotation.from_rotvec(2 * time.reshape(-1, 1) * UP).as_matrix()
    turned = np.einsum("nij,kj->nki", turn, body).reshape(frames, bodies, -1, 3)
    place = np.stack([np.sin(time), np.cos(1.7 * time), 0 * time], -1)
    return (turned + place[:, :, None]) * [thickness, 1, 1]


def film(name, azimuth, points, rng, noise_px):
    """Return the file of a level camera 4 m from the origin, of bodies as `walk` returns them."""
    turn = np.radians(azimuth)
    ahead = -np.array([np.cos(turn), np.sin(turn), 0.0])
    axes = np.stack([np.cross(ahead, UP), -UP, ahead])
    seen = (points + 4 * ahead) @ axes.T
    pixels = 600 * seen[..., :2] / seen[..., 2:] + np.array(IMAGE) / 2
    pixels += noise_px * rng.normal(size=pixels.shape)
    score, numbers = np.full(pixels.shape[:3], 0.9), np.arange(len(points))
    return mc.Keypoints2D(name, JOINTS, numbers, pixels, score, False, IMAGE, f"{name}.json")


def views_at(*azimuths, seed=0, noise_px=2.0, **changes):
    rng = np.random.default_rng(seed)
    points = walk(rng, **changes)
    return [
        film(f"cam{k}", azimuth, points, rng, noise_px) for k, azimuth in enumerate(azimuths, 1)
    ]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("azimuths", "facing"),
    [((0, 60), 0), ((0, 110), 0), ((0, 172), 1), ((0, 180), 1), ((0, 180, 90), 0)],
)
def test_two_cameras_that_look_at_each_other_are_named_without_a_third(
    inspect, azimuths, facing, seed
):
    found = inspect(views_at(*azimuths, seed=seed)).warnings("each other")
    assert len(found) == facing
    assert not facing or found[0].startswith("cam1 and cam2")


@pytest.mark.parametrize("change", ["behind", "several", "shuffled", "no common joint"])
def test_nothing_is_said_of_cameras_behind_each_other_or_where_views_do_not_compare(
    inspect, change
):
    first, second = views_at(*((0, 0) if change == "behind" else (0, 180)))
    if change == "behind":
        second.positions[...] = 1.3 * (second.positions - 500) + 500
    if change == "several":
        first, second = views_at(0, 180, bodies=2)
    if change == "shuffled":  # frames are of different moments
        second.positions[...] = np.random.default_rng(1).permutation(second.positions)
    if change == "no common joint":
        first.positions[:, :, ::2], second.positions[:, :, 1::2] = np.nan, np.nan
    assert not inspect([first, second]).warnings("each other")


@pytest.mark.parametrize(
    ("azimuths", "thickness", "noise_px", "flat"),
    [
        ((20, 60, 110), 0, 0.5, True),
        ((20, 60, 110), 0, 4, True),
        ((20, 60, 110), 0.02, 4, True),
        ((20, 60, 110), 0.5, 4, False),
        ((20, 60, 110), 1, 0.5, False),
        ((0, 0.5), 1, 4, True),  # 3.5 and 7 cm between cameras at 4 m: the same sight twice
        ((0, 1.0), 1, 4, True),
    ],
)
def test_what_lies_in_one_plane_or_is_seen_from_one_side_is_named(
    inspect, azimuths, thickness, noise_px, flat
):
    found = inspect(views_at(*azimuths, thickness=thickness, noise_px=noise_px))
    assert len(found.warnings("plane")) == flat
