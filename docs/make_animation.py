"""Draw the picture that moves on the first page: three people whom four cameras saw.

    .venv/bin/python docs/make_animation.py [OUT]

OUT is the folder that `make demo` fills (out/demo). The picture is docs/moving.svg: an SVG that
moves by itself (SMIL), in browsers and on the pages of repositories.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from make_picture import (
    COLOURS,
    HEIGHT,
    ROOT,
    WIDTH,
    depth,
    draw_camera,
    draw_floor,
    of_human_size,
    project,
    text,
)

from mocap_calib.io.camera_files import read_rig
from mocap_calib.io.pose_files import load_poses
from mocap_calib.types import CameraRig, Floats

PICTURE = Path(__file__).with_name("moving.svg")
FIRST, LAST, STEP = 80, 196, 4  # frames of the recording; there and back again
SECONDS = 8
LEFT, TOP, RIGHT, BOTTOM = 250, 40, WIDTH, HEIGHT  # the part of the scene that is shown


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", nargs="?", type=Path, default=ROOT / "out" / "demo")
    folder = parser.parse_args().out
    rig, poses = read_rig(folder / "cameras.yaml"), load_poses(folder / "poses3d.h5")
    rig, positions = of_human_size(rig, poses.poses)
    marks = [*draw_floor(rig), *draw_cameras(rig)]
    moments = [*range(FIRST, LAST, STEP), *range(LAST, FIRST, -STEP), FIRST]
    for individual in range(positions.shape[1]):
        marks += draw_moving(positions[moments, individual], poses.edges, individual)
    style = 'font-family="sans-serif" stroke-linecap="round" stroke-linejoin="round"'
    box = f"{LEFT} {TOP} {RIGHT - LEFT} {BOTTOM - TOP}"
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" {style}>'
    ground = f'<rect x="{LEFT}" y="{TOP}" width="100%" height="100%" fill="#ffffff"/>'
    PICTURE.write_text("\n".join([head, ground, *marks, "</svg>", ""]), "utf-8", newline="\n")


def draw_cameras(rig: CameraRig) -> list[str]:
    """Return all cameras, those behind first."""
    order = sorted(range(len(rig.cameras)), key=lambda view: -depth(rig.centres[view]))
    return [mark for view in order for mark in draw_camera(rig, view)]


def draw_moving(body: Floats, edges: Sequence[tuple[int, int]], individual: int) -> list[str]:
    """Return a body whose lines move, and its number. body: `[moment, keypoint, 3]`."""
    colour = COLOURS[individual]
    points = project(hold(body))  # [moment, keypoint, 2]
    shapes = ["".join(line(moment[a], moment[b]) for a, b in edges) for moment in points]
    lines = (
        f'<path fill="none" stroke="{colour}" stroke-width="3" d="{shapes[0]}">'
        f"{animate('d', shapes)}</path>"
    )
    x, y = points[..., 0].mean(axis=1), points[..., 1].min(axis=1) - 9
    places = [f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True)]
    name = text(0, 0, f"individual {individual}", size=14, colour=colour, anchor="middle")
    moving = animate("transform", places, tag='animateTransform type="translate"')
    return [lines, f'<g transform="translate({places[0]})">{name}{moving}</g>']


def hold(body: Floats) -> Floats:
    """Return a body whose missing joints stay where they were last, or come first."""
    known = np.isfinite(body[..., 0])
    moments = np.arange(len(body))[:, None]
    last = np.maximum.accumulate(np.where(known, moments, -1), axis=0)
    first = known.argmax(axis=0)
    return np.take_along_axis(body, np.where(last < 0, first, last)[..., None], axis=0)


def line(start: Floats, end: Floats) -> str:
    """Return one bone as a part of a path."""
    return f"M{start[0]:.0f} {start[1]:.0f}L{end[0]:.0f} {end[1]:.0f}"


def animate(attribute: str, values: Sequence[str], *, tag: str = "animate") -> str:
    """Return the element that takes an attribute through its values, for ever."""
    timing = f'dur="{SECONDS}s" repeatCount="indefinite"'
    return f'<{tag} attributeName="{attribute}" {timing} values="{";".join(values)}"/>'


if __name__ == "__main__":
    main()
