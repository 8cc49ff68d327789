"""Write one made recording in every format that is read, as the other programs do.

After the code of their writers, not ours.
"""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
from keypoint_files import coco_bytes, dlc_columns, dlc_csv, dlc_h5_fixed, dlc_h5_table, dlc_values
from scipy.io import savemat

import mocap_calib as mc

NAMES = ("nose", "left_ear", "tail")
FRAMES = tuple(range(5))
SIZE = (640, 480)


def recording(individuals=1, missing=0.3, seed=0, scores=True):
    """Return positions and scores of individuals who all have a point in every frame.

    Positions are `[frame, individual, keypoint, 2]`, scores `[frame, individual, keypoint]`.
    """
    rng = np.random.default_rng(seed)
    positions = rng.uniform(2, 470, (len(FRAMES), individuals, len(NAMES), 2)).round(3)
    confidence = np.ones(positions.shape[:3])
    if scores:
        confidence = rng.uniform(0.1, 0.99, confidence.shape).round(3)
    gone = rng.random(confidence.shape) < missing
    gone[..., 0] = False
    positions[gone], confidence[gone] = np.nan, 0.0
    return positions, confidence


def triples(points, scores):
    """A flat list with zeros for missing points."""
    return np.nan_to_num(np.column_stack([points, scores])).ravel().tolist()


def _detections(positions, confidence):
    for k, frame in enumerate(FRAMES):
        for points, scores in zip(positions[k], confidence[k], strict=True):
            yield frame, points, scores


def _coco(folder, p, c):
    (folder / "cam.json").write_bytes(coco_bytes(FRAMES, NAMES, p, c, SIZE))


def _coco_results(folder, p, c):
    entries = [
        {"image_id": frame, "category_id": 1, "keypoints": triples(x, s), "score": 7.5}
        for frame, x, s in _detections(p, c)
    ]
    (folder / "cam.json").write_text(json.dumps(entries))


def _alphapose(folder, p, c):
    rows = [
        {"image_id": f"{f}.jpg", "category_id": 1, "keypoints": triples(x, s)}
        for f, x, s in _detections(p, c)
    ]
    same = {"score": 2.9, "box": [1, 2, 3, 4], "idx": [0.0]}
    (folder / "cam.json").write_text(json.dumps([row | same for row in rows]))


def _openpose(folder, p, c):
    (folder / "cam_json").mkdir()
    for k, frame in enumerate(FRAMES):
        people = [
            {"person_id": [-1], "pose_keypoints_2d": triples(x, s), "face_keypoints_2d": []}
            for x, s in zip(p[k], c[k], strict=True)
        ]
        (folder / "cam_json" / f"cam_{frame:012d}_keypoints.json").write_text(
            json.dumps({"version": 1.3, "people": people})
        )


def _instances(p, c):
    box = {"bbox": [[1.0, 2.0, 3.0, 4.0]], "bbox_score": 0.9}
    points = zip(np.nan_to_num(p).tolist(), c.tolist(), strict=True)
    return [{"keypoints": x, "keypoint_scores": s} | box for x, s in points]


def _mmpose(folder, p, c):
    frames = [
        {"frame_id": frame, "instances": _instances(p[k], c[k])} for k, frame in enumerate(FRAMES)
    ]
    names = {str(k): name for k, name in enumerate(NAMES)}
    (folder / "cam.json").write_text(
        json.dumps({"meta_info": {"keypoint_id2name": names}, "instance_info": frames})
    )


def _mmpose_images(folder, p, c):
    (folder / "cam").mkdir()
    for k, frame in enumerate(FRAMES):
        (folder / "cam" / f"{frame:06d}.json").write_text(json.dumps(_instances(p[k], c[k])))


def _superanimal(folder, p, c):
    padded = np.where(
        np.isnan(p[..., :1]), -1.0, np.concatenate([np.nan_to_num(p), c[..., None]], -1)
    )
    frames = [{"bodyparts": frame, "bboxes": [], "bbox_scores": []} for frame in padded.tolist()]
    (folder / "cam.json").write_text(json.dumps(frames))


def _who(p):
    return tuple(f"m{k}" for k in range(p.shape[1])) if p.shape[1] > 1 else ("",)


def _dlc_csv(folder, p, c):
    (folder / "cam.csv").write_text(dlc_csv(FRAMES, dlc_columns(NAMES, _who(p)), dlc_values(p, c)))


def _dlc_h5(folder, p, c):
    dlc_h5_table(folder / "cam.h5", list(FRAMES), dlc_columns(NAMES, _who(p)), dlc_values(p, c))


def _dlc_h5_fixed(folder, p, c):
    dlc_h5_fixed(folder / "cam.h5", list(FRAMES), dlc_columns(NAMES, _who(p)), dlc_values(p, c))


def _sleap(folder, p, c):
    with h5py.File(folder / "cam.analysis.h5", "w") as file:
        file["tracks"] = p.transpose(1, 3, 2, 0)
        file["point_scores"] = np.where(np.isnan(p[..., 0]), np.nan, c).transpose(1, 2, 0)
        file["node_names"] = np.array(NAMES, dtype="S")
        file["track_names"] = np.array([f"track_{k}" for k in range(p.shape[1])], dtype="S")
        file["track_occupancy"] = np.ones((len(FRAMES), p.shape[1]), dtype=np.uint8)


def _sleap_csv(folder, p, c):
    columns = [f"{name}.{part}" for name in NAMES for part in ("x", "y", "score")]
    lines = [",".join(["track,frame_idx,instance.score", *columns])]
    for k, i in np.ndindex(c.shape[:2]):
        values = np.column_stack([p[k, i], np.where(np.isnan(p[k, i, :, 0]), np.nan, c[k, i])])
        cells = ["" if np.isnan(v) else repr(v) for v in values.ravel().tolist()]
        lines.append(",".join([f"track_{i}", str(FRAMES[k]), "0.9", *cells]))
    (folder / "cam.analysis.csv").write_text("\n".join(lines) + "\n")


def write_slp(folder, p, c, videos=("cam",), path="cam.slp"):
    frames, individuals, keypoints = c.shape
    frame = {"frame_id": "<u8", "video": "<u4", "frame_idx": "<u8"}
    frame |= {"instance_id_start": "<u8", "instance_id_end": "<u8"}
    instance = {"instance_id": "<i8", "instance_type": "u1", "frame_id": "<u8", "skeleton": "<u4"}
    instance |= {"track": "<i4", "from_predicted": "<i8", "score": "<f4"}
    instance |= {"point_id_start": "<u8", "point_id_end": "<u8"}
    point = [("x", "<f8"), ("y", "<f8"), ("visible", "?"), ("complete", "?"), ("score", "<f8")]
    nodes = [{"id": k} for k in range(keypoints)[::-1]]
    metadata = {"skeletons": [{"graph": {}, "links": [], "nodes": nodes}]}
    metadata["nodes"] = [{"name": name, "weight": 1.0} for name in NAMES[::-1]]
    count = frames * individuals
    rows = [
        (k, 1, k // individuals, 0, k % individuals, -1, 0.9, k * keypoints, (k + 1) * keypoints)
        for k in range(count)
    ]
    seen = np.isfinite(p[..., 0]).ravel()
    points = [
        (x, y, bool(v), True, s)
        for (x, y), s, v in zip(p.reshape(-1, 2), c.ravel(), seen, strict=True)
    ]
    with h5py.File(folder / path, "w") as file:
        about = {"format_id": 1.2, "json": np.bytes_(json.dumps(metadata).encode())}
        file.create_group("metadata").attrs.update(about)
        made = [
            (v * frames + k, v, FRAMES[k], k * individuals, (k + 1) * individuals)
            for v in range(len(videos))
            for k in range(frames)
        ]
        file["frames"] = np.array(made, dtype=[*frame.items()])
        file["instances"] = np.array(rows, dtype=[*instance.items()])
        file["pred_points"] = np.array(points, dtype=point)
        file["points"] = np.zeros(0, dtype=point[:4])
        files = [{"backend": {"filename": f"D:\\data\\{name}.mp4"}} for name in videos]
        file["videos_json"] = np.array(list(map(json.dumps, files)), dtype="S")
        file["tracks_json"] = np.array([f'[0,"track_{k}"]' for k in range(individuals)], dtype="S")


def _movement(folder, p, c, plural=""):
    with h5py.File(folder / "cam.nc", "w") as file:
        file.attrs.update({"ds_type": "poses", "time_unit": "seconds", "fps": 25.0})
        scales = {
            "space": ["x", "y"],
            f"keypoint{plural}": list(NAMES),
            f"individual{plural}": [f"id_{k}" for k in range(p.shape[1])],
        }
        for name, labels in scales.items():
            file.create_dataset(name, data=np.array(labels, dtype=h5py.string_dtype()))
        file["time"] = np.array(FRAMES) / 25.0
        dims = ["time", "space", f"keypoint{plural}", f"individual{plural}"]
        for number, name in enumerate(dims):
            file[name].make_scale(name)
            file[name].attrs["_Netcdf4Dimid"] = np.int32(number)
        file["position"], file["confidence"] = p.transpose(0, 3, 2, 1), c.transpose(0, 2, 1)
        for name, own in (("position", dims), ("confidence", [dims[0], *dims[2:]])):
            file[name].attrs["_Netcdf4Coordinates"] = np.array(
                [dims.index(dim) for dim in own], dtype=np.int32
            )
            for axis, dim in enumerate(own):
                file[name].dims[axis].attach_scale(file[dim])


def _nwb(folder, p, c):
    with h5py.File(folder / "cam.nwb", "w") as file:
        file.attrs["nwb_version"] = "2.9.0"
        poses = file.create_group("processing/behavior/PoseEstimation")
        poses.attrs["neurodata_type"] = "PoseEstimation"
        poses["dimensions"] = np.array([SIZE], dtype=np.uint16)
        for k, name in enumerate(NAMES):
            series = poses.create_group(name)
            series.attrs["neurodata_type"] = "PoseEstimationSeries"
            series["data"], series["confidence"] = p[:, 0, k], c[:, 0, k]
            series["timestamps"] = np.array(FRAMES) / 30


def _label3d(folder, p, c):  # noqa: ARG001 - no scores
    label = {"data_2d": p[:, 0].reshape(len(FRAMES), -1)}
    label |= dict.fromkeys(("data_frame", "data_sampleID"), np.array([FRAMES]))
    labels, names = np.empty((1, 1), dtype=object), np.empty((1, 1), dtype=object)
    labels[0, 0], names[0, 0] = label, "cam"
    savemat(folder / "labels.mat", {"labelData": labels, "camnames": names})


def _caliscope(folder, p, c):  # noqa: ARG001 - no scores
    lines = ["sync_index,cam_id,frame_index,frame_time,object_id,keypoint_id"]
    lines[0] += ",img_loc_x,img_loc_y,obj_loc_x,obj_loc_y"
    for frame, i, j in np.argwhere(np.isfinite(p[..., 0])):
        x, y = p[frame, i, j]
        lines.append(f"{FRAMES[frame]},cam,{frame},0.5,{i},{j},{x},{y},,")
    (folder / "xy.csv").write_text("\n".join(lines) + "\n")


def _csv(folder, p, c):
    lines = ["camera,frame,individual,keypoint,x,y,score"]
    for frame, i, j in np.argwhere(np.isfinite(p[..., 0])):
        x, y = p[frame, i, j]
        lines.append(f"cam,{FRAMES[frame]},mouse {i},{NAMES[j]},{x},{y},{c[frame, i, j]}")
    (folder / "all.csv").write_text("\r\n".join(lines) + "\r\n")


def _ultralytics(folder, p, c):
    (folder / "cam" / "labels").mkdir(parents=True)
    for k, frame in enumerate(FRAMES):
        lines = ["# class box keypoints"]
        for i in range(p.shape[1]):
            points = " ".join(map(repr, triples(p[k, i] / SIZE, c[k, i])))
            lines.append(f"0 0.5 0.5 0.2 0.2 {points} 0.87")
        (folder / "cam" / "labels" / f"video_{frame}.txt").write_text("\n".join(lines))


LAYOUT = mc.ReadOptions(layout=NAMES)


class Sample(NamedTuple):
    """One program's files: how it writes them, and what they carry.

    write: of a folder, `[frame, individual, keypoint, 2]` positions and `[frame, individual,
        keypoint]` scores. most: individuals. scores, tracked, sized: whether files have scores,
        identities and the image size. written: whether we write the format too, and ordered:
        only where several individuals are followed.
    """

    format: str
    write: Callable[[Path, np.ndarray, np.ndarray], None]
    options: mc.ReadOptions = mc.ReadOptions()
    most: int = 2
    scores: bool = True
    tracked: bool = True
    sized: bool = False
    written: bool = False
    ordered: bool = False


SAMPLES = {
    "coco": Sample("coco", _coco, tracked=False, sized=True, written=True),
    "coco-results": Sample("coco-results", _coco_results, LAYOUT, tracked=False),
    "alphapose": Sample("alphapose", _alphapose, LAYOUT, tracked=False),
    "openpose": Sample("openpose", _openpose, LAYOUT, tracked=False, written=True),
    "mmpose": Sample("mmpose", _mmpose, tracked=False),
    "mmpose-images": Sample("mmpose-images", _mmpose_images, LAYOUT, tracked=False),
    "superanimal": Sample("superanimal", _superanimal, LAYOUT, tracked=False),
    "deeplabcut-csv": Sample("deeplabcut-csv", _dlc_csv, written=True, ordered=True),
    "deeplabcut-h5": Sample("deeplabcut-h5", _dlc_h5, written=True, ordered=True),
    "deeplabcut-h5 fixed": Sample("deeplabcut-h5", _dlc_h5_fixed),
    "sleap": Sample("sleap", _sleap, written=True),
    "sleap-csv": Sample("sleap-csv", _sleap_csv),
    "sleap-slp": Sample("sleap-slp", write_slp),
    "movement": Sample("movement", _movement, written=True, ordered=True),
    "movement old": Sample("movement", partial(_movement, plural="s")),
    "nwb": Sample("nwb", _nwb, most=1, sized=True),
    "label3d": Sample("label3d", _label3d, LAYOUT, most=1, scores=False),
    "caliscope": Sample("caliscope", _caliscope, LAYOUT, scores=False),
    "csv": Sample("csv", _csv, written=True),
    "ultralytics": Sample(
        *("ultralytics", _ultralytics, mc.ReadOptions(layout=NAMES, image_size=SIZE)),
        tracked=False,
        sized=True,
    ),
}


def write_sample(name: str, folder: Path, positions, confidence) -> list[Path]:
    """Write the recording as the format's own program does; return the paths to read."""
    folder.mkdir(parents=True, exist_ok=True)
    SAMPLES[name].write(folder, positions, confidence)
    return sorted(folder.iterdir())
