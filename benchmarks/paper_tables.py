"""The paper's tables as Markdown, made of what was measured of their cells."""

import re
from collections.abc import Callable, Iterable, Sequence
from functools import cache

import numpy as np
from paper_cells import (
    ABLATED,
    ABLATED_SCENARIO,
    EVERYWHERE,
    FIVE_FRAMES,
    RIG_FRAMES,
    RIGS,
    SPECIES,
    WRONG,
    Line,
    is_informed,
    is_slow,
    is_variant,
)
from protocol_methods import METHODS
from protocol_recordings import RECORDINGS

from mocap_calib.types import Floats
from mocap_calib.verdict.evaluation import area_under_curve

NOUNS = {
    "people": ("person", "people"),
    "dog": ("dog", "dogs"),
    "cheetah": ("cheetah", "cheetahs"),
    "mouse": ("mouse", "mice"),
    "rat": ("rat", "rats"),
    "hawk": ("hawk", "hawks"),
    "chickadee": ("chickadee", "chickadees"),
}
OF_POINTS = ("five-point", "all-pairs", "magsac")  # methods that know nothing of bodies
RESAMPLES = 2000
LEAST_PAIRS = 5  # of an interval
INTERVAL = (2.5, 97.5)  # percent
PAIR_HEADER = (
    *("method", "pairs", "RRA@20", "RTA@20", "AUC@20", "RRA@30", "RTA@30", "AUC@30"),
    *("median E_R", "median E_t", "P", "s / pair", "on"),
)
RIVALS = {  # of the page that compares tools: its rows, and what methods are called there
    "five-point": "five-point over matches, LO-RANSAC",
    "five-point-magsac": "the same, OpenCV's MAGSAC++",
    "magsac": "MAGSAC++ of all pairs of detections",
    "procrustes": "Procrustes of lifted bodies",
    "procrustes-adjusted": "the same, adjusted",
    "sphere": "registration on the sphere",
    "sphere-adjusted": "the same, adjusted",
    "procrustes-informed": "Procrustes, told who is who",
    "procrustes-adjusted-informed": "the same, adjusted",
    "sphere-informed": "on the sphere, told who is who",
    "sphere-adjusted-informed": "the same, adjusted",
    "ours-norays": "ours, without refinement on rays",
    "ours": "**ours**",
}
COMPARED = {  # and its columns
    "1 person": ("pairs", "people", "1x1"),
    "4 people": ("pairs", "people", "4x1"),
    "1 dog": ("pairs", "dog", "1x1"),
    "4 dogs": ("pairs", "dog", "4x1"),
    "1 cheetah": ("pairs", "cheetah", "1x1"),
    "4 cheetahs": ("pairs", "cheetah", "4x1"),
    "Shelf": ("detections", "shelf", ""),
}
MARKED = re.compile(r"(<!-- table: ([\w-]+) -->\n).*?(<!-- end of table -->)", re.DOTALL)


class Results:
    """What was measured of methods that there are, by cell: of each the largest measurement."""

    def __init__(self, lines: Iterable[Line]) -> None:
        self.lines: dict[tuple[str, str, str], list[Line]] = {}
        largest: dict[tuple[str, ...], Line] = {}
        for line in lines:
            cell = tuple(line[part] for part in ("group", "what", "scenario", "method"))
            if line["method"] and line["method"] not in METHODS:
                continue
            if cell not in largest or line["size"] >= largest[cell]["size"]:
                largest[cell] = line
        for (group, what, scenario, _), line in largest.items():
            self.lines.setdefault((group, what, scenario), []).append(line)
        self.machines = sorted({line["machine"] for line in largest.values()})

    def of(self, group: str, what: str, scenario: str = "") -> list[Line]:
        """Return those of one scenario, in the order of the methods."""
        found = self.lines.get((group, what, scenario), [])
        order = ["", *METHODS]
        return sorted(found, key=lambda line: order.index(line["method"]))

    def letter(self, line: Line) -> str:
        """Return the letter of the machine of a measurement."""
        return chr(ord("A") + self.machines.index(line["machine"]))


def insert_tables(text: str, lines: Iterable[Line]) -> str:
    """Return a page with the tables between its markers as they follow from what was measured.

    Raises KeyError for a marker of no table.
    """
    results = Results(lines)
    return MARKED.sub(lambda found: found[1] + TABLES[found[2]](results) + found[3], text)


def all_tables(lines: Iterable[Line]) -> str:
    """Return all tables, each below its name."""
    results = Results(lines)
    return "\n".join(f"## {name}\n\n{make(results)}" for name, make in TABLES.items())


# --- of two views


def _scenario(name: str, scenarios: Sequence[str]) -> Callable[[Results], str]:
    """Return what makes a table of all kinds in some scenarios, by each method."""

    def make(results: Results) -> str:
        rows = []
        for kind, nouns in NOUNS.items():
            for scenario in scenarios:
                lines = [x for x in results.of("pairs", kind, scenario) if not _ablated(x)]
                rows += _rows(nouns[scenario[0] != "1"], lines, results)
        return _table((name, *PAIR_HEADER), rows)

    return make


def _ablated(line: Line) -> bool:
    return is_variant(line["method"])


def _detections(results: Results) -> str:
    rows = [
        row for name in RECORDINGS for row in _rows(name, results.of("detections", name), results)
    ]
    return _table(("recording", *PAIR_HEADER), rows)


def _ablation(results: Results) -> str:
    rows = []
    for kind in ABLATED:
        lines = results.of("pairs", kind, ABLATED_SCENARIO)
        names = {line["method"] for line in lines if _ablated(line)}
        pairs = [
            line
            for line in lines
            if any(
                line["method"] == name or name.startswith(f"{line['method']}-") for name in names
            )
        ]
        rows += _rows(NOUNS[kind][1], pairs, results, plain=True)
    return _table(("4 in one frame", *PAIR_HEADER), rows)


def _rows(
    label: str, lines: Sequence[Line], results: Results, *, plain: bool = False
) -> list[Sequence[str]]:
    """Return a row a method: the best AUC@20 is bold, and the best of points alone the baseline.

    Slow methods, measured on fewer pairs, do not compete, nor do those that are told who is who.

    plain: without such marks.
    """
    competing = [x for x in lines if not (is_slow(x["method"]) or is_informed(x["method"]))]
    best = "" if plain else _best(competing)
    baseline = "" if plain else _best(x for x in competing if x["method"].startswith(OF_POINTS))
    rows = []
    for line in lines:
        name, cells = line["method"], _figures(line)
        if name == best:
            cells[3] = f"**{cells[3]}**"
        if name == baseline:
            name += " (baseline)"
        rows.append([label, name, *cells, f"{line['seconds']:.2g}", results.letter(line)])
        label = ""
    return rows


def _best(lines: Iterable[Line]) -> str:
    """Return the method with the best AUC@20, "" where not all were measured on as many pairs."""
    compared = list(lines)
    if len({line["size"] for line in compared}) != 1:
        return ""
    return max(compared, key=lambda line: auc(*_errors(line), 20))["method"]


def _errors(line: Line) -> tuple[Floats, Floats]:
    return np.array(line["rotation"], dtype=float), np.array(line["translation"], dtype=float)


def _figures(line: Line) -> list[str]:
    rotation, translation = _errors(line)
    cells = [str(len(rotation))]
    for most in (20, 30):
        cells += [f"{(each < most).mean():.2f}" for each in (rotation, translation)]
        cells.append(_score(line, most))
    cells += [f"{np.median(each):.3g}" for each in (rotation, translation)]
    return [*cells, f"{line['right'] / line['matched']:.3f}" if line["matched"] else "-"]


def _score(line: Line, most: int) -> str:
    """Return AUC@most with its interval, of enough pairs."""
    rotation, translation = _errors(line)
    score = f"{auc(rotation, translation, most):.3f}"
    if len(rotation) < LEAST_PAIRS:
        return score
    low, high = auc_interval(rotation, translation, most)
    return f"{score} [{low:.2f}, {high:.2f}]"


def auc(rotation: Floats, translation: Floats, most: int) -> float:
    """Return AUC@most of errors `[pair]` in degrees."""
    return area_under_curve(np.radians(rotation), np.radians(translation), most)


def auc_interval(rotation: Floats, translation: Floats, most: int) -> tuple[float, float]:
    """Return the 95 % interval of the AUC, by resampling the pairs."""
    areas = _areas(rotation, translation, most, _resamples(len(rotation)))
    low, high = np.percentile(areas, INTERVAL)
    return float(low), float(high)


def _areas(rotation: Floats, translation: Floats, most: int, counts: Floats) -> Floats:
    """Return the AUC `[resample]` where each pair counts so often: `[resample, pair]`."""
    thresholds = np.arange(1, most + 1)
    shares = [counts @ (each[:, None] < thresholds) for each in (rotation, translation)]
    return np.minimum(*shares).mean(1) / len(rotation)


@cache
def _resamples(pairs: int) -> Floats:
    """Return `[resample, pair]` how often each pair is drawn, always the same."""
    rng = np.random.default_rng(0)
    return rng.multinomial(pairs, np.full(pairs, 1 / pairs), RESAMPLES).astype(float)


def _rivals(results: Results) -> str:
    """Return AUC@20 of each method in each scenario, the best of a column in bold."""
    columns = [{x["method"]: x for x in results.of(*where)} for where in COMPARED.values()]
    best = [
        _best(line for line in column.values() if line["method"] in RIVALS) for column in columns
    ]
    rows = []
    for method, label in RIVALS.items():
        scores = [_score(x[method], 20) if method in x else "-" for x in columns]
        marked = zip(scores, best, strict=True)
        rows.append([label, *(f"**{s}**" if method == b else s for s, b in marked)])
    return _table(("method", *COMPARED), rows)


# --- of networks and rigs


def _generalisation(results: Results) -> str:
    header = ("target", "class-specific", "class-agnostic, no completion")
    header += ("class-agnostic, with completion", "steps of training", "s", "on")
    rows = []
    for kind in SPECIES:
        for line in results.of("networks", kind):
            figures = [f"{line[name]:.3f}" for name in ("own", "shared", "completed")]
            cost = [f"{line['size']:,}", f"{line['processor_s']:.0f}", results.letter(line)]
            rows.append([kind, *figures, *cost])
    return _table(header, rows)


def _rigs(results: Results) -> str:
    header = ("subjects", "scenes", "stage", "E_R", "E_t", "E_2D (px)", "s / scene", "on")
    rows = []
    cells = [(kind, count) for kind, counts in RIGS.items() for count in counts]
    for kind, count in cells:
        for line in results.of("rigs", kind, f"{count}x{RIG_FRAMES}"):
            label = [f"{count} {NOUNS[kind][count > 1]}", str(line["size"])]
            cost = [f"{line['processor_s'] / line['size']:.2g}", results.letter(line)]
            for stage in ("averaging", "adjustment"):
                rows.append([*label, stage, *(f"{x:.2f}" for x in line[stage]), *cost])
    return _table(header, rows)


def _machines(results: Results) -> str:
    return "".join(f"* {chr(ord('A') + k)}: {name}\n" for k, name in enumerate(results.machines))


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


TABLES: dict[str, Callable[[Results], str]] = {
    "four": _scenario("4, 1 frame", EVERYWHERE[:1]),
    "one": _scenario("1, 1 frame", EVERYWHERE[1:]),
    "five-frames": _scenario("5 frames", FIVE_FRAMES["people"]),
    "misplaced": _scenario("1, 5 frames", (WRONG,)),
    "detections": _detections,
    "ablation": _ablation,
    "generalisation": _generalisation,
    "rigs": _rigs,
    "machines": _machines,
    "rivals": _rivals,
}
