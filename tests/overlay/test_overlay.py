"""Results on videos: what is drawn lies where the camera saw it, in the frame in which it did."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from mocap_calib.errors import MismatchError
from mocap_calib.geometry.lens import pixels_from_points
from mocap_calib.notebook.colours import COLOURS, UNASSIGNED, colour_of, rgb
from mocap_calib.notebook.shapes import camera_lines, floor_lines
from mocap_calib.overlay.drawing import View
from mocap_calib.overlay.make import make_overlays
from mocap_calib.overlay.results import CameraResults, Results, read_results
from mocap_calib.overlay.video import Video, read_frames
from mocap_calib.types import CameraClock, Floats, World

FRAMES = 12  # of the videos
BARREL = (-0.25, 0.06, 0.002, -0.001, 0.0)


@pytest.fixture(scope="module")
def found(done) -> Results:
    """The results of a run, in which the lenses are bent, cam2 is 5 frames late, and nobody is
    joined by bones: then discs are alone."""
    results = read_results(done[0])
    ((first, last, rig),) = results.epochs
    cameras = tuple(replace(camera, distortion=np.array(BARREL)) for camera in rig.cameras)
    rig = replace(rig, cameras=cameras, clocks=(CameraClock("cam2", "clock", 5),))
    poses = replace(results.poses, edges=())
    return replace(results, epochs=((first, last, rig),), poses=poses)


def seen_by(results: Results, name: str, frame: int) -> Floats:
    """Where OpenCV has the joints of the first individual in the images of a camera."""
    camera = results.epochs[0][2][name]
    points = results.poses.poses.positions[frame, 0]
    rotation, _ = cv2.Rodrigues(camera.rotation)
    pixels, _ = cv2.projectPoints(
        points[:, None], rotation, camera.translation, camera.matrix, camera.distortion
    )
    return pixels[:, 0]


def write_video(path: Path, results: Results, name: str, *, late: int = 0, scale: float = 1.0):
    """Dots on blank frames where OpenCV has the joints; of the joints that stand alone."""
    width, height = (round(scale * side) for side in results.epochs[0][2][name].size)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 30, (width, height))
    for number in range(FRAMES):
        image = np.full((height, width, 3), 40, np.uint8)
        if number >= late:
            for x, y in (seen_by(results, name, number - late) + 0.5) * scale - 0.5:
                place = (round(16 * x), round(16 * y))
                cv2.circle(image, place, 16 * 5, (255, 255, 255), -1, cv2.LINE_AA, 4)
        writer.write(image)
    writer.release()
    return path


def middle_of(image: np.ndarray, colour: str, near: Floats, radius: int = 6) -> Floats:
    """The middle of what has nearly a colour around a pixel."""
    x, y = np.round(near).astype(int)
    window = image[y - radius : y + radius + 1, x - radius : x + radius + 1].astype(float)
    far = np.abs(window - rgb(colour)[::-1]).max(-1)
    rows, columns = np.nonzero(far < 90)
    return np.array([columns.mean() + x - radius, rows.mean() + y - radius])


@pytest.mark.parametrize(("name", "late", "scale"), [("cam1", 0, 1.0), ("cam2", 5, 0.5)])
def test_the_overlay_lies_on_what_the_video_shows(found, tmp_path, name, late, scale):
    """Frame, lens, clock and size together."""
    video = write_video(tmp_path / "a.mp4", found, name, late=late, scale=scale)
    notes = make_overlays(found, (), {name: video}, tmp_path / "out", frames=[3, 6])
    assert len(notes) == (scale != 1)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        f"{name}_000003.png",
        f"{name}_000006.png",
    }
    image = cv2.imread(str(tmp_path / "out" / f"{name}_000006.png"))
    expected = (seen_by(found, name, 6) + 0.5) * scale - 0.5
    others = np.linalg.norm(expected[:, None] - expected, axis=-1) + 99 * np.eye(len(expected))
    alone = expected[others.min(1) > 20]
    assert len(alone) >= 3
    for joint in alone:
        assert np.linalg.norm(middle_of(image, COLOURS[0], joint) - joint) < 1
        assert np.linalg.norm(middle_of(image, "#ffffff", joint) - joint) < 1  # the ring around it


def test_the_command_writes_a_video_with_the_detections_of_the_run(done, found, tool, tmp_path):
    video = write_video(tmp_path / "a.mp4", found, "cam1")
    made = tool("overlay", done[0], "--video", f"cam1={video}", "-o", tmp_path / "out")
    assert made.returncode == 0, made.stderr
    assert made.stderr.splitlines()[-1] == f"overlays in {tmp_path / 'out'}"
    drawn = cv2.VideoCapture(str(tmp_path / "out" / "cam1.mp4"))
    assert drawn.get(cv2.CAP_PROP_FRAME_COUNT) == FRAMES
    _, image = drawn.read()
    ring = np.array(rgb(COLOURS[1]))[::-1]
    assert (np.abs(image.astype(int) - ring).max(-1) < 60).sum() > 50


def blank_video(path: Path, size: tuple[int, int]) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 30, size)
    writer.write(np.zeros((size[1], size[0], 3), np.uint8))
    writer.release()
    return path


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("--video cam9=a.mp4", "expected one of the cameras cam1, cam2, cam3, found cam9"),
        ("--video cam1=none.mp4", "none.mp4: expected a video, found no such file"),
        ("--video cam1=run.json", "expected a video that OpenCV can read"),
        ("--video cam1=wide.mp4", "expected images of 1280 x 720 as the keypoints of cam1 have"),
        ("--video cam1=a.mp4 --frames 500", "--frames: expected frames that "),
    ],
)
def test_mistakes_get_a_line_and_leave_nothing(done, tool, tmp_path, words, says):
    """Those of the command line are in tests/cli/test_usage.py."""
    blank_video(tmp_path / "a.mp4", (1280, 720))
    blank_video(tmp_path / "wide.mp4", (640, 200))
    (tmp_path / "run.json").write_text("{}")
    made = tool("overlay", done[0], *words.split(), "-o", "out", cwd=tmp_path)
    assert (made.returncode, made.stderr.count("\n")) == (1, 1)
    assert says in made.stderr
    assert not (tmp_path / "out").exists()


class Capture:
    """A video of blank frames at times in milliseconds, as OpenCV shows it."""

    def __init__(self, times: list[float]) -> None:
        self.times, self.index = times, -1
        self.isOpened, self.release = (lambda: True), (lambda: None)

    def grab(self) -> bool:
        self.index += 1
        return self.index < len(self.times)

    def get(self, _: int) -> float:
        return self.times[self.index]

    def retrieve(self) -> tuple[bool, np.ndarray]:
        return True, np.zeros((2, 2, 3), np.uint8)


def test_a_variable_frame_rate_is_refused_with_the_way_to_mend_it(monkeypatch):
    """Frames 33 ms apart, of which one in ten was dropped: 27 a second in the mean."""
    dropped = Capture([1000 / 30 * k for k in range(30) if k % 10 != 9])
    monkeypatch.setattr(cv2, "VideoCapture", lambda _: dropped)
    with pytest.raises(MismatchError, match=r"66.7 ms before frame 9: .* -fps_mode cfr -r 27 "):
        list(read_frames(Video(Path("a.mp4"), (640, 480), 27.0, 100), None))
    steady = Capture([float(round(1001 / 30 * k)) for k in range(100)])  # as Matroska rounds
    monkeypatch.setattr(cv2, "VideoCapture", lambda _: steady)
    assert len(list(read_frames(Video(Path("a.mp4"), (640, 480), 29.97, 100), None))) == 100


def test_frames_belong_to_moments_by_the_clock_of_the_camera(found):
    ((_, last, rig),) = found.epochs
    poses = found.poses.poses
    late = CameraResults("cam2", replace(found, late={"cam2": 0.25}), None)
    assert late.moments(np.array([4, 5, 9])) == pytest.approx([np.nan, 0.25, 4.25], nan_ok=True)
    between = 0.75 * poses.positions[4] + 0.25 * poses.positions[5]
    np.testing.assert_allclose(late.bodies_at(4.25), between)
    assert np.isnan(late.bodies_at(np.nan)).all()
    other = replace(rig, translation=rig.translation + 1)
    moved = CameraResults("cam1", replace(found, epochs=((0, 9, rig), (10, last, other))), None)
    assert [moved.rig_at(time) is other for time in (9.0, 10.0, np.nan)] == [False, True, False]


# --- what is drawn


def test_lines_end_at_the_near_plane_and_do_not_come_back_through_a_bent_lens(found):
    """A line from behind the camera to before it, and one far outside the image."""
    rig = found.epochs[0][2]
    view = View.of(rig, "cam1", rig["cam1"].size, mirrored=False)
    axis, side = rig["cam1"].rotation[2], rig["cam1"].rotation[0]
    centre = rig["cam1"].centre
    ahead = centre + 3 * axis
    (line,) = view.bend(np.array([[centre - 2 * axis + 0.3 * side, ahead]]))
    seen = line[np.isfinite(line).all(1)]
    assert len(seen) >= 2
    (expected,) = pixels_from_points(rig["cam1"], np.array([[0.0, 0.0, 3.0]]))
    np.testing.assert_allclose(seen[-1], expected, atol=1e-6)
    assert np.isnan(view.project(centre + 0.1 * axis + 5 * side)).all()
    assert np.isnan(view.bend(np.array([[centre - axis, centre - 2 * axis]]))).all()
    flipped = View.of(rig, "cam1", rig["cam1"].size, mirrored=True).project(ahead[None])
    assert flipped[0, 0] == pytest.approx(rig["cam1"].size[0] - 1 - expected[0])


def test_a_grid_lies_on_the_floor_a_metre_apart(found):
    ((_, _, rig),) = found.epochs
    poses = found.poses.poses
    assert camera_lines(rig, 0).shape == (8, 2, 3)
    unknown = replace(rig, world=World(kind="first camera"))
    assert floor_lines(unknown, poses).shape == (0, 2, 3)
    up, floor = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 0.5])
    longer = 8 / float(np.ptp(np.nanpercentile(poses.positions, [1, 99])))
    metric = replace(rig, world=World(kind="floor", up=up, floor=floor)).scale(longer, "m")
    lines = floor_lines(metric, poses.scale(longer, "m"))
    np.testing.assert_allclose(lines[..., 2], 0.5 * longer)
    along = np.unique(np.round(lines[np.ptp(lines[..., 0], 1) == 0][:, 0, 0], 6))
    np.testing.assert_allclose(np.diff(along), 1.0)


def test_colours_are_one_table():
    assert len(set(COLOURS)) == 7
    assert colour_of(-1) == UNASSIGNED
    assert (colour_of(7), rgb(colour_of(0))) == (COLOURS[0], (0, 114, 178))
