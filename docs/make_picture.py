"""Draw the README's picture: what goes into a run, and what comes out of it.

    .venv/bin/python docs/make_picture.py [OUT]

OUT is the folder that `make demo` fills (out/demo). The picture is docs/three_people.svg: at the
left the keypoints of each camera, whose people nobody knows, at the right the cameras, and the
people told apart.
"""

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from mocap_calib.io.camera_files import read_rig
from mocap_calib.io.keypoints import read_keypoints
from mocap_calib.io.pose_files import load_poses
from mocap_calib.notebook.colours import COLOURS
from mocap_calib.types import CameraRig, Floats, Keypoints2D, Poses3D

ROOT = Path(__file__).parents[1]
PICTURE = Path(__file__).with_name("three_people.svg")
FRAME = 196  # of the recording
TRAIL = 100  # frames before it whose paths are drawn
WIDTH, HEIGHT = 960, 500
PANEL = (187, 105)  # width and height of an image at the left
SCENE = (592, 312)  # where the middle of the floor is
METRE = 50  # pixels of the picture
AZIMUTH, ELEVATION = np.radians(-35), np.radians(24)
GREY, PALE, DARK = "#7a7a7a", "#e4e4e4", "#333333"


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", nargs="?", type=Path, default=ROOT / "out" / "demo")
    folder = parser.parse_args().out
    rig, poses = read_rig(folder / "cameras.yaml"), load_poses(folder / "poses3d.h5")
    views = read_keypoints([ROOT / "examples" / "three_people" / "keypoints"])
    marks = [
        *draw_views(views, poses.edges),
        *draw_scene(*of_human_size(rig, poses.poses), poses.edges),
    ]
    style = 'font-family="sans-serif" stroke-linecap="round" stroke-linejoin="round"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" {style}>'
    background = f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>'
    PICTURE.write_text("\n".join([head, background, *marks, "</svg>", ""]), "utf-8")


def of_human_size(rig: CameraRig, poses: Poses3D) -> tuple[CameraRig, Floats]:
    """Return the cameras and `[frame, individual, keypoint, 3]` positions, people of 1.7 high.

    The run found the floor: z is up, and the floor is at 0.
    """
    scale = 1.7 / np.nanpercentile(poses.positions[..., 2], 99)
    return rig.scale(scale, "m"), scale * poses.positions


# --- the left: what goes in


def draw_views(views: Sequence[Keypoints2D], edges: Iterable[tuple[int, int]]) -> list[str]:
    """Return marks of the keypoints of each camera, all in grey."""
    marks = [text(20, 30, "In: 2D keypoints of each camera", size=17)]
    width, height = PANEL
    for number, view in enumerate(views):
        marks.append(f'<g transform="translate(20 {46 + number * (height + 7)})">')
        marks.append(f'<rect width="{width}" height="{height}" fill="#f7f7f7" stroke="{GREY}"/>')
        scale = width / view.image_size[0]
        for body in view.positions[np.searchsorted(view.frames, FRAME)] * scale:
            marks += draw_body(body, edges, colour=GREY, width=1.3)
        marks += [text(7, 17, view.camera, size=13, colour=GREY), "</g>"]
    return marks


# --- the right: what comes out


def draw_scene(rig: CameraRig, positions: Floats, edges: Iterable[tuple[int, int]]) -> list[str]:
    """Return marks of the floor, the cameras and the people, those behind first.

    positions: `[frame, individual, keypoint, 3]`, z up, as `of_human_size` gives them.
    """
    marks = [text(330, 30, "Out: cameras, identities, 3D poses", size=17), *draw_floor(rig)]
    now = positions[FRAME]
    things = [
        (depth(rig.centres[view]), draw_camera(rig, view)) for view in range(len(rig.cameras))
    ]
    for individual, body in enumerate(now):
        colour = COLOURS[individual]
        path = np.nanmean(positions[FRAME - TRAIL : FRAME + 1, individual], axis=1) * [1, 1, 0]
        marks.append(polyline(project(path), colour, width=2, opacity=0.45))
        things.append((depth(np.nanmean(body, 0)), draw_person(body, edges, colour, individual)))
    for _, thing in sorted(things, key=lambda pair: -pair[0]):
        marks += thing
    return marks


def draw_floor(rig: CameraRig) -> list[str]:
    """Return a grid of squares of 1 m below the cameras."""
    reach = round(np.abs(rig.centres[:, :2]).max())
    lines = []
    for k in range(-reach, reach + 1):
        for ends in ([[-reach, k, 0], [reach, k, 0]], [[k, -reach, 0], [k, reach, 0]]):
            lines.append(polyline(project(np.array(ends, float)), PALE, width=1))
    return lines


def draw_camera(rig: CameraRig, view: int) -> list[str]:
    """Return a camera as the pyramid of what it sees, on a thin stand, with its name."""
    camera, centre = rig.cameras[view], rig.centres[view]
    half = np.array(camera.size) / 2 / camera.focal
    corners = np.array([[x, y, 1.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    corners[:, :2] *= half
    corners = project(0.7 * corners @ rig.rotation[view] + centre)
    apex, foot = project(np.array([centre, centre * [1, 1, 0]]))
    sides = [polyline(np.array([apex, corner]), DARK, width=1.2) for corner in corners]
    frame = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
    return [
        polyline(np.array([apex, foot]), GREY, width=1, opacity=0.5),
        f'<polygon points="{frame}" fill="#ffd966" fill-opacity="0.6" stroke="{DARK}"/>',
        *sides,
        text(apex[0], min(apex[1], corners[:, 1].min()) - 8, camera.name, size=14, anchor="middle"),
    ]


def draw_person(
    body: Floats, edges: Iterable[tuple[int, int]], colour: str, individual: int
) -> list[str]:
    """Return a person with their number. body: `[keypoint, 3]`."""
    points = project(body)
    x, y = np.nanmean(points[:, 0]), np.nanmin(points[:, 1])
    name = text(x, y - 9, f"individual {individual}", size=14, colour=colour, anchor="middle")
    return [*draw_body(points, edges, colour=colour, width=3), name]


# --- what both share


def draw_body(
    points: Floats, edges: Iterable[tuple[int, int]], *, colour: str, width: float
) -> list[str]:
    """Return lines between the keypoints `[keypoint, 2]` that are there, and dots on them."""
    lines = [
        polyline(points[[a, b]], colour, width=width)
        for a, b in edges
        if np.isfinite(points[[a, b]]).all()
    ]
    dots = [
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{width * 0.9:.1f}" fill="{colour}"/>'
        for x, y in points[np.isfinite(points).all(1)]
    ]
    return lines + dots


def project(points: Floats) -> Floats:
    """Return where `[..., 3]` points of the scene are in the picture, seen obliquely from above."""
    x, y, z = np.moveaxis(points, -1, 0)
    right = x * np.cos(AZIMUTH) - y * np.sin(AZIMUTH)
    up = z * np.cos(ELEVATION) + depth(points, level=True) * np.sin(ELEVATION)
    return np.stack([SCENE[0] + METRE * right, SCENE[1] - METRE * up], axis=-1)


def depth(point: Floats, *, level: bool = False) -> Floats:
    """Return how far `[..., 3]` points are from who looks; level: along the floor."""
    x, y, z = np.moveaxis(point, -1, 0)
    along = x * np.sin(AZIMUTH) + y * np.cos(AZIMUTH)
    return along if level else along * np.cos(ELEVATION) - z * np.sin(ELEVATION)


def polyline(points: Floats, colour: str, *, width: float, opacity: float = 1) -> str:
    """Return a line through `[point, 2]` points."""
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    style = f'fill="none" stroke="{colour}" stroke-width="{width}" stroke-opacity="{opacity}"'
    return f'<polyline points="{path}" {style}/>'


def text(
    x: float, y: float, words: str, *, size: int, colour: str = DARK, anchor: str = "start"
) -> str:
    """Return words that begin, or have their middle, at a place."""
    place = f'x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"'
    return f'<text {place} font-size="{size}" fill="{colour}">{words}</text>'


if __name__ == "__main__":
    main()
