"""Writing COCO keypoint annotations: one JSON file a camera, one line an annotation."""

import json

import numpy as np

from mocap_calib.types import Bools, Ints, Keypoints2D, Reals, check_shape


def format_coco(
    camera: str,
    size: tuple[int, int],
    frames: Ints,
    keypoints: tuple[str, ...],
    positions: Reals,
    confidence: Reals,
    *,
    decimals: tuple[int, int] = (1, 2),
) -> str:
    """The detections of one camera as COCO annotations.

    size: (width, height) of the images. frames: `[frame]` numbers; they are the image ids, and in the file names.
    positions: `[frame, instance, keypoint, 2]` pixels, NaN = missing; confidence: `[frame, instance, keypoint]`, which
    stands in the place of COCO's visibility, 0 = missing. Instances without any keypoint keep their place with zeros,
    those behind the last of a frame are left out. decimals: of positions and confidences, by default those that a detector has.
    """
    check_shape(f"{camera}: positions", positions, len(frames), None, len(keypoints), 2)
    check_shape(f"{camera}: confidence", confidence, *positions.shape[:3])
    width, height = size
    images = [
        {"id": int(n), "file_name": f"frame_{n:06d}.jpg", "width": width, "height": height}
        for n in frames
    ]
    seen: Bools = np.asarray(np.isfinite(positions[..., 0]).any(-1))
    row, instance = np.nonzero(np.asarray(np.logical_or.accumulate(seen[:, ::-1], axis=1))[:, ::-1])
    annotations = [
        _annotation(k + 1, int(frames[f]), positions[f, i], confidence[f, i], decimals)
        for k, (f, i) in enumerate(zip(row, instance, strict=True))
    ]
    category = {"id": 1, "name": "person", "keypoints": list(keypoints)}
    info = {"description": f"mocap-calib keypoints of {camera}"}
    lists = [
        f'"info":{_compact(info)}',
        f'"categories":{_compact([category])}',
        f'"images":{_lines(images)}',
        f'"annotations":{_lines(annotations)}',
    ]
    return "{" + ",\n".join(lists) + "}\n"


def _annotation(
    number: int, image: int, positions: Reals, confidence: Reals, decimals: tuple[int, int]
) -> dict[str, object]:
    """One detection. The confidence of what is there is at least one of its last digit, since 0 means missing."""
    seen: Bools = np.asarray(np.isfinite(positions).all(-1))
    third = np.where(seen, np.clip(confidence, 0.1 ** decimals[1], None), 0.0).astype(np.float64)
    pixels = np.where(seen[:, None], positions, 0.0).astype(np.float64)
    values = np.concatenate(
        [pixels.round(decimals[0]), third[:, None].round(decimals[1])], axis=1
    ).ravel()
    whole = [int(value) if value == int(value) else value for value in values.tolist()]
    return {
        "id": number,
        "image_id": image,
        "category_id": 1,
        "num_keypoints": int(seen.sum()),
        "keypoints": whole,
    }


def _lines(entries: list[dict[str, object]]) -> str:
    return "[\n" + ",\n".join(_compact(entry) for entry in entries) + "\n]"


def _compact(value: object) -> str:
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False)


def write(views: tuple[Keypoints2D, ...]) -> dict[str, bytes]:
    """A file per camera, to the last digit that matters."""
    return {
        f"{v.camera}.json": format_coco(
            v.camera,
            v.image_size,
            v.frames,
            v.keypoints,
            v.positions,
            v.confidence,
            decimals=(9, 9),
        ).encode()
        for v in views
    }
