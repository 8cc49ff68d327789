"""A result in three dimensions, as a figure of plotly: cameras, floor, and bodies that move."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mocap_calib.errors import MismatchError
from mocap_calib.lift.lifter import load_vocabulary
from mocap_calib.notebook.colours import colour_of
from mocap_calib.notebook.shapes import camera_lines, floor_lines
from mocap_calib.recording.joints import edges_of_keypoints
from mocap_calib.results import GroupResult
from mocap_calib.types import ARBITRARY, CameraRig, Floats, Ints

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

Lines = NDArray[np.float32]  # `[point, 3]`, NaN between pieces; 32 bits are a tenth of a hair

_CAMERA_COLOUR, _FLOOR_COLOUR = "#555555", "#bbbbbb"
_MOMENT_MS = 50  # how long a moment is shown when the figure plays


def draw_group(group: GroupResult, moments: int) -> "Figure":
    """Return a figure of the cameras of a group, the floor, and the bodies, with a slider of time.

    moments: how many frames the slider has at most.

    Raises MismatchError where plotly is not installed, and ValueError where there is no moment.
    """
    if moments < 1:
        raise ValueError(f"plot: moments: expected 1 or more, got {moments}")
    try:
        from plotly import graph_objects  # noqa: PLC0415 - an extra
    except ImportError:
        raise MismatchError(
            "plot",
            "the package plotly",
            "none",
            "install it with `pip install mocap-calib[notebook]`",
        ) from None
    poses = group.poses
    pieces = _bones(group)
    shown = _choose_moments(len(poses.frames), moments)
    bodies = [_bodies(poses.positions[frame], pieces) for frame in shown]
    still = [*_draw_cameras(group.rig), *_draw_floor(group)]
    names = [*map(_escape, poses.keypoints), ""]  # -1 is the last
    moving = [
        _trace(
            body,
            mode="lines+markers",
            name=f"individual {individual}",
            marker={"size": 2},
            line={"width": 4, "color": colour_of(individual)},
            hovertext=[names[keypoint] for keypoint in pieces],
        )
        for individual, body in enumerate(bodies[0] if bodies else ())
    ]
    places = list(range(len(still), len(still) + len(moving)))
    numbers = [str(number) for number in poses.frames[shown]]
    frames = [
        {"name": number, "traces": places, "data": [_trace(body) for body in at]}
        for number, at in zip(numbers, bodies, strict=True)
    ]
    return graph_objects.Figure(
        {
            "data": [*still, *moving],
            "frames": frames,
            "layout": _layout(group, numbers),
        }
    )


def _choose_moments(frames: int, moments: int) -> Ints:
    """Return the indices of frames that are shown, evenly spread."""
    return np.rint(np.linspace(0, max(frames - 1, 0), min(moments, frames))).astype(np.int64)


# --- bodies


def _bones(group: GroupResult) -> Ints:
    """Return indices of keypoints, in the order in which lines join them; -1 ends a line.

    Keypoints that no bone has are there by themselves.
    """
    recording = group.recording
    edges = edges_of_keypoints(load_vocabulary(recording.model), recording.vocabulary)
    joined = {keypoint for edge in edges for keypoint in edge}
    alone = [(k,) for k in range(len(recording.keypoints)) if k not in joined]
    return np.array([k for piece in (*edges, *alone) for k in (*piece, -1)], dtype=np.int64)


def _bodies(positions: Floats, pieces: Ints) -> list[Lines]:
    """Return the lines of each body of a moment, `[individual, keypoint, 3]`."""
    ended = np.pad(positions, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan)  # -1 is the last
    return list(ended[:, pieces].astype(np.float32))


# --- what stands still


def _draw_cameras(rig: CameraRig) -> list[dict[str, Any]]:
    """Return the frusta of the cameras, and their names."""
    lines = np.concatenate([camera_lines(rig, view) for view in range(len(rig))])
    frusta = _draw_lines(lines, "cameras", {"width": 2, "color": _CAMERA_COLOUR})
    names = _trace(
        rig.centres.astype(np.float32),
        mode="markers+text",
        text=[_escape(name) for name in rig.names],
        marker={"size": 3, "color": _CAMERA_COLOUR},
        showlegend=False,
    )
    return [frusta, names]


def _draw_floor(group: GroupResult) -> list[dict[str, Any]]:
    """Return a grid on the floor where bodies are, nothing where it is not known."""
    lines = floor_lines(group.rig, group.poses)
    return [_draw_lines(lines, "floor", {"width": 1, "color": _FLOOR_COLOUR})] if len(lines) else []


def _draw_lines(lines: Floats, name: str, line: dict[str, Any]) -> dict[str, Any]:
    """Return lines `[line, 2, 3]` as one trace."""
    ended = np.pad(lines, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan).reshape(-1, 3)
    return _trace(ended.astype(np.float32), mode="lines", name=name, line=line, hoverinfo="skip")


# --- how it is laid out


def _trace(points: Lines, **said: Any) -> dict[str, Any]:
    """Return points `[point, 3]` as plotly takes them."""
    x, y, z = np.ascontiguousarray(points.T)
    return {"type": "scatter3d", "x": x, "y": y, "z": z, **said}


def _layout(group: GroupResult, names: Sequence[str]) -> dict[str, Any]:
    """Return the axes, the slider and the buttons. names: of the frames."""
    world, unit = group.rig.world, group.rig.unit
    up = world.up if np.isfinite(world.up).all() else -group.rig.rotation[:, 1].mean(0)
    suffix = "" if unit == ARBITRARY else f" ({unit})"
    axes = {f"{axis}axis": {"title": {"text": axis + suffix}} for axis in "xyz"}
    turn = {"up": dict(zip("xyz", up.tolist(), strict=True))}
    at_once = {"frame": {"duration": 0}, "mode": "immediate", "transition": {"duration": 0}}
    steps = [{"label": name, "method": "animate", "args": [[name], at_once]} for name in names]
    play = at_once | {"frame": {"duration": _MOMENT_MS}, "fromcurrent": True}
    buttons = [
        {"label": "play", "method": "animate", "args": [None, play]},
        {"label": "stop", "method": "animate", "args": [[None], at_once]},
    ]
    return {
        "title": {"text": f"rig {group.verdict}"},
        "scene": {"aspectmode": "data", "camera": turn, **axes},
        "margin": {"l": 0, "r": 0, "b": 0, "t": 40},
        "height": 600,
        "template": None,  # a tenth of the size of the figure
        "sliders": [{"steps": steps, "currentvalue": {"prefix": "frame "}, "x": 0.1, "len": 0.9}],
        "updatemenus": [{"type": "buttons", "buttons": buttons, "x": 0.08, "y": 0}],
    }


def _escape(name: str) -> str:
    """Return a name in which plotly, which reads texts as HTML, finds no tag."""
    return name.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
