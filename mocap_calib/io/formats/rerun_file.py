"""An .rrd recording for the viewer of rerun, by the package rerun-sdk: an extra.

Time lines are `frame`, and `time` in seconds where the rate is known. Below `poses` stand the
individuals, whose points are joined as the skeleton joins them; below `cameras` the pinhole parts
of the cameras. A recording has a random mark: its bytes differ from one time to the next.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from mocap_calib.io.format import Format
from mocap_calib.io.poses import (
    LENSES,
    QUALITY,
    UNIT,
    PoseFile,
    known_edges,
    up_axis,
)


def write(file: PoseFile, title: str) -> bytes:
    """Write a recording."""
    import rerun  # noqa: PLC0415  # an extra

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "poses.rrd"
        stream = rerun.RecordingStream(title or "mocap-calib")
        stream.save(path)
        _log_scene(rerun, stream, file)
        for number, name in enumerate(file.individuals):
            _log_individual(rerun, stream, file, number, rerun.new_entity_path(["poses", name]))
        stream.disconnect()
        return path.read_bytes()


def _log_scene(rerun: Any, stream: Any, file: PoseFile) -> None:
    """Log what does not move: what is up, how points are joined, the cameras."""
    if up := up_axis(file):
        way = "DOWN" if up.startswith("-") else "UP"
        axes = getattr(rerun.ViewCoordinates, f"RIGHT_HAND_{up[-1].upper()}_{way}")
        stream.log("/", axes, static=True)
    joints = [rerun.AnnotationInfo(id=k, label=name) for k, name in enumerate(file.poses.keypoints)]
    classes = [
        rerun.ClassDescription(
            info=rerun.AnnotationInfo(id=number, label=name),
            keypoint_annotations=joints,
            keypoint_connections=list(known_edges(file)),
        )
        for number, name in enumerate(file.individuals)
    ]
    stream.log("/", rerun.AnnotationContext(classes), static=True)
    for camera in file.rig or ():
        place = rerun.new_entity_path(["cameras", camera.name])
        turn = camera.rotation.T
        stream.log(place, rerun.Transform3D(translation=camera.centre, mat3x3=turn), static=True)
        sizes = {"resolution": camera.size} if all(camera.size) else {}
        lens = rerun.Pinhole(image_from_camera=camera.matrix, **sizes)
        stream.log(place, lens, static=True)


def _log_individual(rerun: Any, stream: Any, file: PoseFile, number: int, place: str) -> None:
    """Log the points of an individual in all frames; what is missing is left out."""
    positions = file.poses.positions[:, number]
    there = np.asarray(np.isfinite(positions).all(-1))
    counts = there.sum(1)
    keypoints = np.nonzero(there)[1]
    times = [rerun.TimeColumn("frame", sequence=file.poses.frames)]
    if np.isfinite(file.rate):
        times.append(rerun.TimeColumn("time", duration=file.poses.frames / file.rate))
    columns = rerun.Points3D.columns(
        positions=positions[there],
        keypoint_ids=keypoints,
        class_ids=np.full(len(keypoints), number),
    )
    stream.send_columns(place, indexes=times, columns=columns.partition(counts))


POSES = Format(
    name="rerun",
    title="rerun recording",
    write=write,
    endings=(".rrd",),
    rig=True,
    packages=("rerun",),
    extra="rerun",
    loses=(LENSES, UNIT, *QUALITY),
)
