"""Write COCO keypoint annotations: one JSON file a camera, one line an annotation.

The confidence of a point stands in the place of COCO's visibility, as the reader takes it.
"""

import json

import numpy as np

from mocap_calib.types import Bools, Ints, Keypoints2D, Reals

_LOSSLESS = (9, 9)  # decimals of positions and confidences, to the last digit that matters


def write(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """Write a file per camera: file name -> content."""
    return {f"{view.camera}.json": format_coco(view, decimals=_LOSSLESS).encode() for view in views}


def format_coco(view: Keypoints2D, *, decimals: tuple[int, int] = (1, 2)) -> str:
    """Return the detections of one camera as COCO annotations.

    decimals: of positions and confidences, by default those that a detector has.

    The frame numbers are the image ids, and stand in the file names. Instances without any
    keypoint keep their place with zeros; those behind the last of a frame are left out.
    """
    info = {"description": f"mocap-calib keypoints of {view.camera}"}
    category = {"id": 1, "name": "person", "keypoints": list(view.keypoints)}
    images = [_image(int(number), view.image_size) for number in view.frames]
    annotations = [
        _annotation(
            number,
            int(view.frames[frame]),
            view.positions[frame, instance],
            view.confidence[frame, instance],
            decimals=decimals,
        )
        for number, (frame, instance) in enumerate(_instances_to_write(view.positions), start=1)
    ]
    lists = [
        f'"info":{_compact(info)}',
        f'"categories":{_compact([category])}',
        f'"images":{_one_per_line(images)}',
        f'"annotations":{_one_per_line(annotations)}',
    ]
    return "{" + ",\n".join(lists) + "}\n"


def _instances_to_write(positions: Reals) -> Ints:
    """Return `[annotation, 2]` frame and instance indices, up to the last seen of each frame.

    positions: `[frame, instance, keypoint, 2]`.
    """
    seen: Bools = np.asarray(np.isfinite(positions[..., 0]).any(-1))
    seen_from_here_on = np.logical_or.accumulate(seen[:, ::-1], axis=1)[:, ::-1]
    return np.argwhere(seen_from_here_on)


def _image(frame: int, size: tuple[int, int]) -> dict[str, object]:
    width, height = size
    return {"id": frame, "file_name": f"frame_{frame:06d}.jpg", "width": width, "height": height}


def _annotation(
    number: int, image: int, positions: Reals, confidence: Reals, *, decimals: tuple[int, int]
) -> dict[str, object]:
    """Return one detection of `[keypoint, 2]` positions and `[keypoint]` confidences.

    The confidence of what is there is at least one of its last digit, since 0 means missing.
    """
    position_decimals, confidence_decimals = decimals
    seen: Bools = np.asarray(np.isfinite(positions).all(-1))
    least = 0.1**confidence_decimals
    third = np.where(seen, np.clip(confidence, least, None), 0.0).astype(np.float64)
    pixels = np.where(seen[:, None], positions, 0.0).astype(np.float64)
    points = np.concatenate(
        [pixels.round(position_decimals), third[:, None].round(confidence_decimals)], axis=1
    )
    return {
        "id": number,
        "image_id": image,
        "category_id": 1,
        "num_keypoints": int(seen.sum()),
        "keypoints": [_shorten(value) for value in points.ravel().tolist()],
    }


def _shorten(value: float) -> float:
    """Return a whole number as an int, which is written without its decimal point."""
    return int(value) if value == int(value) else value


def _one_per_line(entries: list[dict[str, object]]) -> str:
    return "[\n" + ",\n".join(_compact(entry) for entry in entries) + "\n]"


def _compact(value: object) -> str:
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False)
