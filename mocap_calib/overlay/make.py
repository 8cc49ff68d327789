"""Draw what a run found on the frames of its videos, and write videos or pictures of it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from mocap_calib.config import CORNER_OFFSET
from mocap_calib.errors import MismatchError, argument, suggest
from mocap_calib.io.atomic import replace_folder
from mocap_calib.notebook.colours import colour_of
from mocap_calib.notebook.shapes import camera_lines, floor_lines
from mocap_calib.overlay import drawing
from mocap_calib.overlay.drawing import Image, View
from mocap_calib.overlay.results import CameraResults, Results
from mocap_calib.overlay.video import Video, check_size, open_video, read_frames
from mocap_calib.results import NO_FRAME
from mocap_calib.types import CameraRig, Floats, Keypoints2D, Progress, silent

_GRID, _CAMERA = "#dddddd", "#ffffff"
_CODEC = "mp4v"  # what every build of OpenCV writes


@dataclass(frozen=True)
class _Shot:
    """The video of a camera, and what is drawn on it.

    shift: what the numbers of the camera's frames have more than the indices of the video's.
    chosen: indices in the video -> number that a picture of it is called by; None: all frames.
    """

    camera: CameraResults
    video: Video
    shift: int
    chosen: Mapping[int, int] | None


def make_overlays(
    results: Results,
    detections: Sequence[Keypoints2D],
    videos: Mapping[str, Path],
    output: Path,
    *,
    frames: Sequence[int] | None = None,
    shifts: Mapping[str, int] | None = None,
    mirrored: Sequence[str] = (),
    progress: Progress = silent,
) -> tuple[str, ...]:
    """Write the overlay of each video into a folder, all or none; return what a user should know.

    Each is a video CAM.mp4, or a picture CAM_NUMBER.png of each of `frames`. Videos are read frame
    by frame.

    detections: of the cameras, as their files have them. videos: by camera.
    frames: numbers of the common clock, which `poses3d.h5` has; None: all of each video.
    shifts: what was added to the frame numbers of a camera, which else are those of its video,
        counted from 0. mirrored: cameras whose images are, beside those that the run found.

    Raises FormatError, and MismatchError for unknown cameras, videos of another shape or of
    variable frame rate, and frames that they do not have.
    """
    shots, notes = [], []
    seen = {each.camera: each for each in detections}
    for name, path in videos.items():
        if name not in results.names:
            raise MismatchError(
                argument("video", name),
                f"one of the cameras {', '.join(results.names)}",
                name,
                suggest(name, results.names),
            )
        video, camera = open_video(path), CameraResults(name, results, seen.get(name))
        notes.append(check_size(video, results.epochs[0][2][name]))
        shift = (shifts or {}).get(name, 0)
        chosen = None if frames is None else _choose(camera, video, frames, shift)
        if frames is not None and chosen is not None and len(chosen) < len(frames):
            notes.append(f"{name}: shows {len(chosen)} of the {len(frames)} frames")
        shots.append(_Shot(camera, video, shift, chosen))
    with replace_folder(output) as work:
        for shot in shots:
            flipped = shot.camera.name in {*results.mirrored, *mirrored}
            _write(shot, work, mirrored=flipped, progress=progress)
    return tuple(filter(None, notes))


def _choose(
    camera: CameraResults, video: Video, frames: Sequence[int], shift: int
) -> dict[int, int]:
    """Return the indices in a video of frames, with their numbers. Raises MismatchError."""
    numbers = camera.own_numbers(frames)
    indices = numbers - shift
    shown = (numbers != NO_FRAME) & (indices >= 0) & (indices < (video.frames or np.inf))
    if not shown.any():
        raise MismatchError(
            argument("frames"),
            f"frames that {video.path} shows, {shift} to {shift + video.frames - 1} as "
            f"{camera.name} numbers them",
            f"{numbers.min()} to {numbers.max()}",
            "choose others",
        )
    return dict(zip(indices[shown].tolist(), np.asarray(frames)[shown].tolist(), strict=True))


def _write(shot: _Shot, folder: Path, *, mirrored: bool, progress: Progress) -> None:
    """Write the overlay of a video. Raises MismatchError where a chosen frame is not there."""
    name, chosen = shot.camera.name, shot.chosen
    total = shot.video.frames if chosen is None else len(chosen)
    writer = None
    if chosen is None:
        codec = cv2.VideoWriter.fourcc(*_CODEC)
        path = str(folder / f"{name}.mp4")
        writer = cv2.VideoWriter(path, codec, shot.video.rate, shot.video.size)
        if not writer.isOpened():
            raise MismatchError(
                name, f"OpenCV to write {_CODEC}", "that it cannot", f"say {argument('frames')}"
            )
    done = 0
    try:
        for index, image in _drawn(shot, mirrored=mirrored):
            if writer is not None:
                writer.write(image)
            elif chosen is not None:
                cv2.imwrite(str(folder / f"{name}_{chosen[index]:06d}.png"), image)
            done += 1
            progress(f"overlay {name}", done, max(total, done))
    finally:
        if writer is not None:
            writer.release()
    if chosen is not None and done < len(chosen):
        raise MismatchError(
            shot.video.path,
            f"{shot.video.frames} frames as it says",
            "fewer",
            "choose others, or convert it again",
        )


def _drawn(shot: _Shot, *, mirrored: bool) -> Iterator[tuple[int, Image]]:
    """Yield the index of each frame that is wanted, and its image with all that is drawn on it."""
    chosen = None if shot.chosen is None else frozenset(shot.chosen)
    camera = shot.camera
    stages: dict[int, _Stage] = {}
    for index, image in read_frames(shot.video, chosen):
        number = index + shot.shift
        (moment,) = camera.moments(np.array([number]))
        rig = camera.rig_at(moment)
        if id(rig) not in stages:
            view = View.of(rig, camera.name, shot.video.size, mirrored=mirrored)
            stages[id(rig)] = _Stage.of(view, rig, camera)
        stage = stages[id(rig)]
        stage.draw(image, number, moment)
        yield index, image


@dataclass(frozen=True)
class _Stage:
    """What stays the same from frame to frame of a camera that does not move.

    floor, cameras: pixels `[line, point, 2]`. labels: names of the other cameras and their pixels.
    unit: width of a line in pixels. scale: `[2]` of the video against the keypoints.
    """

    camera: CameraResults
    view: View
    floor: Floats
    cameras: Floats
    labels: tuple[tuple[str, Floats], ...]
    unit: int
    scale: Floats

    @classmethod
    def of(cls, view: View, rig: CameraRig, camera: CameraResults) -> "_Stage":
        """Return what a view shows of a rig and of the floor."""
        size, own = np.array(view.camera.size), np.array(rig[camera.name].size)
        others = [k for k, name in enumerate(rig.names) if name != camera.name]
        return cls(
            camera=camera,
            view=view,
            floor=view.bend(floor_lines(rig, camera.results.poses.poses)),
            cameras=view.bend(np.concatenate([camera_lines(rig, k) for k in others])),
            labels=tuple((rig.names[k], view.project(rig.centres[k])) for k in others),
            unit=max(1, round(float(size[1]) / 720)),
            scale=size / own if own.all() else np.ones(2),
        )

    def draw(self, image: Image, number: int, moment: float) -> None:
        """Draw it on the image of a frame, with the bodies and the detections of the moment."""
        camera, unit = self.camera, self.unit
        drawing.draw_lines(image, self.floor, _GRID, unit)
        drawing.draw_lines(image, self.cameras, _CAMERA, unit)
        for name, place in self.labels:
            drawing.draw_text(image, name, place, unit, _CAMERA)
        edges = camera.results.poses.edges
        for individual, body in enumerate(self.view.project(camera.bodies_at(moment))):
            drawing.draw_body(image, body, edges, individual, unit)
        for points, individual in zip(*camera.detected_at(number), strict=True):
            pixels = (points + CORNER_OFFSET) * self.scale - CORNER_OFFSET
            drawing.draw_points(image, pixels, colour_of(individual), 4 * unit, unit)
        corner = np.array([10.0, 24.0]) * unit
        drawing.draw_text(image, f"{camera.name}  frame {number}", corner, unit)
