"""The paper's qualitative figures: steered bodies, matches across views, cameras and bodies."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

from mocap_calib.geometry.rotation import align_by_similarity
from mocap_calib.pipeline import calibrate
from mocap_calib.recording.joints import edges_of_keypoints, load_skeleton
from mocap_calib.training.model import load_steerer, steer
from mocap_calib.training.poses import load_poses
from mocap_calib.training.synthesis import Synthesiser
from mocap_calib.types import Floats
from mocap_calib.verdict.evaluation import with_axes

from .cells import RIG_FRAMES, RIG_VIEWS, SEED, Data, scenes
from .methods import METHODS, Problem, load_models
from .networks import conditions, turned
from .scenes import KINDS

SHOWN = ("people", "dog", "mouse")
TURNS_DEG = (0, 45, 90, 135, 180)
SUBJECTS = 4
INCH = 2.2  # of a small picture
TRUE, FIRST, FINAL = "black", "tab:blue", "tab:red"  # the paper's colours of cameras
DPI = 120


def draw_all(data: Data, folder: Path) -> Iterator[Path]:
    """Draw the figures of kinds whose poses are there; yield the files."""
    folder.mkdir(parents=True, exist_ok=True)
    kinds = [kind for kind in SHOWN if (data.poses / KINDS[kind].file).exists()]
    if kinds:
        yield _save(draw_steered(data.poses, kinds), folder / "steered.png")
    for kind in kinds:
        yield _save(draw_matches(data.poses, kind), folder / f"matches_{kind}.png")
        yield _save(draw_rig(data.poses, kind), folder / f"rig_{kind}.png")


def _save(figure: Figure, path: Path) -> Path:
    figure.savefig(path, dpi=DPI, bbox_inches="tight")
    return path


def draw_steered(poses: Path, kinds: list[str]) -> Figure:
    """Draw a body of each kind, and what the network says of it from other sides.

    Of each the truth is grey.
    """
    figure = Figure(figsize=(INCH * len(TURNS_DEG), INCH * len(kinds)))
    grid = figure.subplots(len(kinds), len(TURNS_DEG), squeeze=False)
    for row, name in zip(grid, kinds, strict=True):
        kind = KINDS[name]
        skeleton = load_skeleton(kind.model)
        config = replace(conditions(kind, 0), noise=(1e-6, 1e-6), occlusion=0.0)
        bodies = load_poses(poses / kind.file, skeleton, "test", up=kind.up)
        batch = Synthesiser(bodies, skeleton, config, seed=SEED).batch(1)
        model, _ = load_steerer(kind.model)
        for axes, degrees in zip(row, TURNS_DEG, strict=True):
            angle = torch.full((1, 1), float(np.radians(degrees)))
            with torch.no_grad():
                vector = angle * torch.tensor([0.0, 1.0, 0.0])
                found = steer(model, batch.pose, batch.seen, vector)[0].numpy()
            true = turned(batch, angle)[0].numpy()
            known = np.isfinite(true).all(1)
            for points, colour in ((true, "0.7"), (found, FINAL)):
                drawn = np.where(known[:, None], points, np.nan)
                _draw_bodies(axes, drawn[None], skeleton.edges, [colour])
            _set_image(axes)
            axes.set_title(f"{name}, {degrees} deg", fontsize=8)
    return figure


def draw_matches(poses: Path, kind: str) -> Figure:
    """Draw two views of a scene, and lines between what ours matches: red where that is wrong."""
    ((sample, truth),) = scenes(poses, kind, SUBJECTS, 1, views=2, size=1)
    (found,), _ = METHODS["ours"]([Problem(sample, 0, 1)], load_models(["ours"], KINDS[kind].model))
    skeleton = load_skeleton(KINDS[kind].model)
    edges = edges_of_keypoints(skeleton, sample.vocabulary)
    figure = Figure(figsize=(4 * INCH, 1.3 * INCH))
    axes = figure.subplots()
    width, height = sample.cameras[0].size
    shift = np.array([1.05 * width, 0.0])
    for view in range(2):
        bodies = sample.positions[view, 0] + view * shift
        colours = [f"C{who}" for who in truth.ids[view, 0]]
        _draw_bodies(axes, bodies, edges, colours)
        corner = view * shift
        frame = np.array([[0, 0], [width, 0], [width, height], [0, height], [0, 0]]) + corner
        axes.plot(*frame.T, color="0.5", linewidth=0.8)
    for _, i, j in found.matches if found is not None else ():
        ends = [np.nanmean(sample.positions[0, 0, i], 0)]
        ends.append(np.nanmean(sample.positions[1, 0, j], 0) + shift)
        right = truth.ids[0, 0, i] == truth.ids[1, 0, j]
        axes.plot(*np.array(ends).T, color="tab:green" if right else "tab:red", linewidth=1)
    _set_image(axes)
    return figure


def draw_rig(poses: Path, kind: str) -> Figure:
    """Draw four cameras and the bodies of one frame.

    Cameras are black where they are, blue after averaging and red after adjustment.
    """
    ((sample, truth),) = scenes(poses, kind, SUBJECTS, RIG_FRAMES, views=RIG_VIEWS, size=1)
    skeleton = load_skeleton(KINDS[kind].model)
    group = calibrate(sample, KINDS[kind].model, seed=SEED).groups[0]
    reference = truth.rig.select(group.rig.names)
    figure = Figure(figsize=(3 * INCH, 3 * INCH))
    axes = figure.add_subplot(projection="3d")
    _draw_cameras(axes, reference.centres, reference.rotation, TRUE)
    for rig, colour in ((group.averaged.rig, FIRST), (group.rig, FINAL)):
        points, targets = (with_axes(each).reshape(-1, 3) for each in (rig, reference))
        scale, rotation, translation = align_by_similarity(points, targets)
        centres = scale * rig.centres @ rotation.T + translation
        _draw_cameras(axes, centres, rig.rotation @ rotation.T, colour)
    edges = edges_of_keypoints(skeleton, sample.vocabulary)
    bodies = scale * group.poses.positions[0] @ rotation.T + translation
    _draw_bodies(axes, bodies, edges, [f"C{who}" for who in range(len(bodies))])
    axes.set_aspect("equal")
    axes.set_axis_off()
    return figure


def _draw_bodies(axes: Axes, bodies: Floats, edges: object, colours: list[str]) -> None:
    """Draw bodies `[N, keypoint, 2 | 3]` with their bones; NaN is left out."""
    for body, colour in zip(bodies, colours, strict=True):
        axes.plot(*body.T, ".", color=colour, markersize=2)
        for a, b in edges:
            axes.plot(*body[[a, b]].T, color=colour, linewidth=1)


def _draw_cameras(axes: Axes3D, centres: Floats, rotation: Floats, colour: str) -> None:
    """Draw a pyramid for each camera: centres `[view, 3]`, cam_from_world `[view, 3, 3]`."""
    corners = 0.5 * np.array([[-0.8, -0.5, 1], [0.8, -0.5, 1], [0.8, 0.5, 1], [-0.8, 0.5, 1]])
    for centre, turn in zip(centres, rotation, strict=True):
        base = corners @ turn + centre
        for a, b in [*pairwise([*base, base[0]]), *((centre, corner) for corner in base)]:
            axes.plot(*np.array([a, b]).T, color=colour, linewidth=0.8)


def _set_image(axes: Axes) -> None:
    """Make it an image: y is down."""
    axes.set_aspect("equal")
    axes.invert_yaxis()
    axes.set_axis_off()
