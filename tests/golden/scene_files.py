"""What goes wrong with the files of a simulated recording: each function changes files in place.

A scene is the folder that `mocap-calib simulate` writes: `keypoints/CAM.json` (COCO),
`intrinsics.toml` and `reference.toml`.
"""

import json
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

Points = Callable[[np.ndarray], np.ndarray]


def _change(scene: Path, camera: str, change: Callable[[dict[str, Any]], None]) -> None:
    path = scene / "keypoints" / f"{camera}.json"
    document = json.loads(path.read_text("utf-8"))
    change(document)
    path.write_text(json.dumps(document), "utf-8")


def _move_points(document: dict[str, Any], move: Points, first_frame: int = 0) -> None:
    """Change the positions, `[keypoint, 2]`, of all points that were found from a frame on."""
    frame_of = {image["id"]: _frame(image) for image in document["images"]}
    for found in document["annotations"]:
        if frame_of[found["image_id"]] >= first_frame:
            values = np.array(found["keypoints"], dtype=float).reshape(-1, 3)
            seen = values[:, 2] > 0
            values[seen, :2] = move(values[seen, :2]).round(3)
            found["keypoints"] = values.ravel().tolist()


def _cameras(scene: Path) -> list[str]:
    return sorted(path.stem for path in (scene / "keypoints").iterdir())


def _change_identities(scene: Path, change: Points) -> None:
    """Change the true identities, `[view, frame, instance]`."""
    with np.load(scene / "truth.npz") as truth:
        arrays = dict(truth)
    np.savez(scene / "truth.npz", **{**arrays, "ids": change(arrays["ids"])})


def _frame(image: dict[str, Any]) -> int:
    return int(re.findall(r"\d+", image["file_name"])[-1])


def _resize(document: dict[str, Any], width: int, height: int) -> None:
    for image in document["images"]:
        image.update(width=width, height=height)


def _size(document: dict[str, Any]) -> tuple[int, int]:
    return document["images"][0]["width"], document["images"][0]["height"]


def name_other_sides(scene: Path, camera: str) -> None:
    """Exchange left and right in the names of a camera's keypoints."""
    _change(scene, camera, _exchange_sides)


def _exchange_sides(document: dict[str, Any]) -> None:
    names = document["categories"][0]["keypoints"]
    turned = {"left": "right", "right": "left"}
    other = [re.sub("left|right", lambda hit: turned[hit.group()], name) for name in names]
    order = [names.index(name) for name in other]
    for found in document["annotations"]:
        found["keypoints"] = np.reshape(found["keypoints"], (-1, 3))[order].ravel().tolist()


def mirror(scene: Path, camera: str) -> None:
    """Mirror the video left for right: a detector takes left limbs for right ones too."""

    def change(document: dict[str, Any]) -> None:
        width, _ = _size(document)
        _move_points(document, lambda xy: np.stack([width - 1 - xy[:, 0], xy[:, 1]], -1))
        _exchange_sides(document)

    _change(scene, camera, change)


def delay(scene: Path, camera: str, frames: int) -> None:
    """Add to the frame numbers of a camera, also in the truth, and cut what goes beyond the end."""

    def change(document: dict[str, Any]) -> None:
        last = max(map(_frame, document["images"]))
        for image in document["images"]:
            image["file_name"] = f"frame_{_frame(image) + frames:06d}.jpg"
        images = [image for image in document["images"] if _frame(image) <= last]
        kept = {image["id"] for image in images}
        document["images"] = images
        document["annotations"] = [a for a in document["annotations"] if a["image_id"] in kept]

    _change(scene, camera, change)
    view = _cameras(scene).index(camera)

    def shift(ids: np.ndarray) -> np.ndarray:
        late = np.full_like(ids[view], -1)
        late[frames:] = ids[view, :-frames]
        return np.concatenate([ids[:view], late[None], ids[view + 1 :]])

    _change_identities(scene, shift)


def rotate(scene: Path, camera: str, stated: bool = False) -> None:
    """Rotate the images clockwise by 90 degrees; the file may state their new size."""

    def change(document: dict[str, Any]) -> None:
        width, height = _size(document)
        _move_points(document, lambda xy: np.stack([height - 1 - xy[:, 1], xy[:, 0]], -1))
        if stated:
            _resize(document, height, width)

    _change(scene, camera, change)


def halve(scene: Path, camera: str, stated: bool = False) -> None:
    """Make the images half as large; the file may state their new size."""

    def change(document: dict[str, Any]) -> None:
        width, height = _size(document)
        _move_points(document, lambda xy: (xy + 0.5) / 2 - 0.5)
        if stated:
            _resize(document, width // 2, height // 2)

    _change(scene, camera, change)


def exchange(scene: Path, a: str, b: str) -> None:
    """Exchange the keypoint files of two cameras; the truth calls the cameras as the files are."""
    first, second = (scene / "keypoints" / f"{name}.json" for name in (a, b))
    contents = first.read_bytes(), second.read_bytes()
    second.write_bytes(contents[0])
    first.write_bytes(contents[1])
    other = {a: b, b: a}
    names = _cameras(scene)
    order = [names.index(other.get(name, name)) for name in names]
    _change_identities(scene, lambda ids: ids[order])
    path = scene / "reference.toml"
    text = path.read_text("utf-8")
    path.write_text(re.sub(rf'"({a}|{b})"', lambda hit: f'"{other[hit.group(1)]}"', text), "utf-8")


def bump(scene: Path, camera: str, degrees: float, first_frame: int) -> None:
    """Turn a camera without distortion to the side, from a frame on."""
    known = tomllib.loads((scene / "intrinsics.toml").read_text("utf-8"))
    (matrix,) = (np.array(each["matrix"]) for each in known.values() if each["name"] == camera)
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    homography = matrix @ [[c, 0, s], [0, 1, 0], [-s, 0, c]] @ np.linalg.inv(matrix)

    def move(xy: np.ndarray) -> np.ndarray:
        moved = np.column_stack([xy, np.ones(len(xy))]) @ homography.T
        return moved[:, :2] / moved[:, 2:]

    _change(scene, camera, lambda document: _move_points(document, move, first_frame))


def scale_focal(scene: Path, camera: str, factor: float) -> None:
    """Scale the given focal length of a camera."""
    path = scene / "intrinsics.toml"
    known = tomllib.loads(path.read_text("utf-8"))
    lines = []
    for key, each in known.items():
        matrix = np.array(each["matrix"])
        if each["name"] == camera:
            matrix[[0, 1], [0, 1]] *= factor
        fields = {**each, "matrix": matrix.tolist()}
        lines += [f"[{key}]", *(f"{name} = {json.dumps(value)}" for name, value in fields.items())]
    path.write_text("\n".join(lines) + "\n", "utf-8")


def write_ros(scene: Path) -> None:
    """Write the intrinsics as ROS does, a file of YAML for each camera in `ros/`."""
    (scene / "ros").mkdir()
    for each in tomllib.loads((scene / "intrinsics.toml").read_text("utf-8")).values():
        width, height = each["size"]
        matrix = np.array(each["matrix"]).ravel().tolist()
        text = (
            f"image_width: {width}\nimage_height: {height}\ncamera_name: {each['name']}\n"
            f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {matrix}\n"
            "distortion_model: plumb_bob\n"
            f"distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: {each['distortions']}\n"
        )
        (scene / "ros" / f"{each['name']}.yaml").write_text(text, "utf-8")
