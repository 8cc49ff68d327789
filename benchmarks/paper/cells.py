"""The cells of the paper's tables: what is measured of which method, and how.

A cell is one measurement, the smallest thing that is kept and not made again. What was measured of
it is a dict that goes into a line of JSON.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mocap_calib.config import Config
from mocap_calib.errors import DegenerateError
from mocap_calib.lift.lifter import shipped_weights
from mocap_calib.pipeline import calibrate
from mocap_calib.rig.triangulate import triangulate
from mocap_calib.types import Bools, Sample, silent

from ..common import describe_machine, describe_moment
from .judge import FAILED, judge, rig_errors
from .methods import METHODS, Problem, load_models
from .networks import displacements
from .recordings import RECORDINGS, real_pairs
from .scenes import KINDS, Truth, load_subjects, misplace, scene

Line = dict[str, Any]
Group = Literal["pairs", "detections", "networks", "rigs"]

NOISE_PX = 3.0
SEED = 0
RIG_VIEWS, RIG_FRAMES = 4, 20
EVERYWHERE = ("4x1", "1x1")  # subjects x frames
FIVE_FRAMES = {"people": ("4x5", "1x5"), "dog": ("4x5", "1x5")}
WRONG = "1x5 30 % misplaced"
WRONG_SHARE = 0.3
SPECIES = ("dog", "cheetah")  # with which networks are trained
RIGS = {kind: (1, 4) if kind == "people" else (4,) for kind in KINDS}
ABLATED, ABLATED_SCENARIO = ("people", "dog"), "4x1"


@dataclass(frozen=True)
class Sizes:
    """How much is measured: pairs of views, of methods that take long, of rotation tokens.

    scenes: of four views; steps: of the training of a species' own network.
    """

    pairs: int
    slow_pairs: int
    token_pairs: int
    scenes: int
    steps: int

    def of_method(self, method: str) -> int:
        """Return how many pairs of views a method gets: some take seconds for each."""
        if not is_paper(method):
            return self.pairs
        return self.token_pairs if "token" in method else self.slow_pairs


WHOLE = Sizes(pairs=100, slow_pairs=10, token_pairs=5, scenes=10, steps=400)
QUICK = Sizes(pairs=5, slow_pairs=1, token_pairs=1, scenes=1, steps=20)


@dataclass(frozen=True)
class Cell:
    """One measurement.

    what: a kind of subjects, or a recording. scenario: subjects x frames, "" of a recording.
    method: "" where only ours is measured. size: pairs of views, scenes or steps of training.
    """

    group: Group
    what: str
    scenario: str
    method: str
    size: int

    @property
    def name(self) -> str:
        """Return what it is called, without its size."""
        parts = (self.group, self.what, self.scenario, self.method)
        return "/".join(part for part in parts if part)


@dataclass(frozen=True)
class Data:
    """Where the sets of 3D poses and the recordings are."""

    poses: Path
    recordings: Path

    def of(self, cell: Cell) -> Path:
        """Return what a cell needs, which may not be there."""
        if cell.group == "detections":
            return self.recordings / cell.what
        return self.poses / KINDS[cell.what].file


def plan(sizes: Sizes, *, quick: bool) -> list[Cell]:
    """Return all cells, the short ones first.

    quick: the paper's solver takes part in the ablation alone.
    """
    cells = [*_pairs(sizes), *_detections(sizes)]
    if quick:
        cells = [cell for cell in cells if not is_paper(cell.method) or _ablated(cell)]
    cells += [Cell("networks", kind, "", "", sizes.steps) for kind in SPECIES]
    cells += [
        Cell("rigs", kind, f"{count}x{RIG_FRAMES}", "", sizes.scenes)
        for kind, counts in RIGS.items()
        for count in counts
    ]
    # rotation tokens pass a network each step
    return sorted(cells, key=lambda each: is_paper(each.method) + ("token" in each.method))


def _ablated(cell: Cell) -> bool:
    """Return whether a cell is one of the ablation's scenes."""
    return cell.what in ABLATED and cell.scenario == ABLATED_SCENARIO


def _pairs(sizes: Sizes) -> list[Cell]:
    cells = [
        Cell("pairs", kind, scenario, method, sizes.of_method(method))
        for kind in KINDS
        for scenario in (*EVERYWHERE, *FIVE_FRAMES.get(kind, ()))
        for method in METHODS
        if has_networks(method, KINDS[kind].model)
        and (scenario in EVERYWHERE or not (is_paper(method) or is_informed(method)))
    ]
    cells = [cell for cell in cells if not is_variant(cell.method) or _ablated(cell)]
    others = [name for name in METHODS if not (is_paper(name) or is_informed(name))]
    tried = [name for name in others if not is_variant(name)]
    return cells + [Cell("pairs", "people", WRONG, method, sizes.pairs) for method in tried]


def _detections(sizes: Sizes) -> list[Cell]:
    return [
        Cell("detections", name, "", method, sizes.of_method(method))
        for name, model in RECORDINGS.items()
        for method in METHODS
        if not (is_variant(method) or is_informed(method)) and has_networks(method, model)
    ]


def is_paper(method: str) -> bool:
    """Return whether a method is the paper's solver, which takes seconds a pair."""
    return method.startswith("paper")


def is_solver(method: str) -> bool:
    """Return whether a method steers poses: ours and the paper's, and their variants."""
    return method.startswith("ours") or is_paper(method)


def is_informed(method: str) -> bool:
    """Return whether a method is given the identities."""
    return method.endswith("-informed")


def is_variant(method: str) -> bool:
    """Return whether a method is another with something changed: `ours-norays` is of `ours`."""
    return is_solver(method) and any(method.startswith(f"{other}-") for other in METHODS)


def has_networks(method: str, model: str) -> bool:
    """Return whether the networks that a method takes are shipped for a skeleton."""
    return "token" not in method or shipped_weights(f"{model}_token").is_file()


# --- measuring


def measure(cell: Cell, data: Data) -> Line:
    """Measure a cell: its fields, what was found, the processor's seconds, where and when."""
    start = time.process_time()
    work: dict[Group, Callable[[Cell, Data], Line]] = {
        "pairs": _measure_pairs,
        "detections": _measure_pairs,
        "networks": _measure_networks,
        "rigs": _measure_rigs,
    }
    found = work[cell.group](cell, data)
    seconds = round(time.process_time() - start, 1)
    cost = {"processor_s": seconds, "machine": describe_machine()}
    return asdict(cell) | found | cost | describe_moment()


def problems_of(cell: Cell, data: Data) -> tuple[list[Problem], list[Truth]]:
    """Return the pairs of views of a cell, and their truth."""
    if cell.group == "detections":
        return real_pairs(data.of(cell), RECORDINGS[cell.what], cell.size, seed=SEED)
    count, frames = (int(part) for part in cell.scenario.split()[0].split("x"))
    made = scenes(data.poses, cell.what, count, frames, views=2, size=cell.size)
    if cell.scenario == WRONG:
        made = [(misplace(sample, WRONG_SHARE), truth) for sample, truth in made]
    problems = [Problem(sample, 0, 1, identities_of(truth)) for sample, truth in made]
    return problems, [truth for _, truth in made]


def identities_of(truth: Truth) -> Bools:
    """Return which detections of two views are of one subject, `[frame, I, J]`."""
    first, second = truth.ids[0][:, :, None], truth.ids[1][:, None]
    return np.asarray((first == second) & (first >= 0))


def scenes(
    poses: Path, kind: str, count: int, frames: int, *, views: int, size: int
) -> list[tuple[Sample, Truth]]:
    """Return so many scenes of `count` subjects, always the same."""
    subjects = load_subjects(poses, KINDS[kind])
    return [
        scene(
            subjects,
            np.random.default_rng([SEED, count, frames, views, k]),
            count=count,
            frames=frames,
            views=views,
            noise_px=NOISE_PX,
        )
        for k in range(size)
    ]


def _measure_pairs(cell: Cell, data: Data) -> Line:
    model = RECORDINGS.get(cell.what) or KINDS[cell.what].model
    problems, truths = problems_of(cell, data)
    models = load_models([cell.method], model)
    wall, processor = time.perf_counter(), time.process_time()
    found, seconds = METHODS[cell.method](problems, models)
    # a method tells wall time; of it, the share that the processor worked for this process
    share = (time.process_time() - processor) / (time.perf_counter() - wall)
    errors, matched, right = judge(found, problems, truths)
    rotation, translation = ([_brief(error) for error in column] for column in errors.T)
    counts = {"matched": matched, "right": right, "seconds": _brief(seconds * share)}
    return {"rotation": rotation, "translation": translation, **counts}


def _measure_networks(cell: Cell, data: Data) -> Line:
    found = displacements(data.poses, KINDS[cell.what], cell.size)
    return dict(zip(("own", "shared", "completed"), map(_brief, found), strict=True))


def _measure_rigs(cell: Cell, data: Data) -> Line:
    """Calibrate four views: the medians of E_R, E_t and E_2D after averaging and adjustment."""
    count, frames = (int(part) for part in cell.scenario.split("x"))
    config = Config()
    stages: dict[str, list[Sequence[float]]] = {"averaging": [], "adjustment": []}
    made = scenes(data.poses, cell.what, count, frames, views=RIG_VIEWS, size=cell.size)
    for sample, truth in made:
        try:
            done = calibrate(sample, KINDS[cell.what].model, config, seed=SEED).groups[0]
        except DegenerateError:
            for found in stages.values():
                found.append((FAILED, FAILED, np.nan))
            continue
        rig = done.averaged.rig
        before = triangulate(done.recording, rig, done.matches, config.triangulate, progress=silent)
        reference = truth.rig.select(done.rig.names)
        for found, own, error in (
            (stages["averaging"], rig, before.error),
            (stages["adjustment"], done.rig, done.poses.error),
        ):
            found.append((*rig_errors(own, reference), float(np.nanmedian(error))))
    return {name: [_brief(x) for x in np.nanmedian(found, 0)] for name, found in stages.items()}


def _brief(value: float) -> float:
    """Return a number to four digits, as it is kept."""
    return float(f"{value:.4g}")
