"""The paper's tables as Markdown, made of the results of their cells.

Pages show AUC@20 alone; `full_table` has all figures with their intervals.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache

import numpy as np

from mocap_calib.types import Floats
from mocap_calib.verdict.evaluation import area_under_curve

from .cells import (
    ABLATED,
    ABLATED_SCENARIO,
    RIG_FRAMES,
    RIGS,
    SPECIES,
    WRONG,
    Line,
    is_informed,
    is_paper,
)
from .methods import METHODS
from .recordings import RECORDINGS
from .scenes import KINDS

Place = tuple[str, str, str]  # group, kind of subjects or recording, scenario

PLURALS = {"people": "people", "mouse": "mice"}  # others take an s
RESAMPLES = 2000
LEAST_PAIRS = 5  # of an interval
INTERVAL = (2.5, 97.5)  # percent
SHOWN = (  # methods of the pages
    *("five-point", "five-point-magsac", "all-pairs", "magsac", "procrustes-adjusted"),
    *("procrustes-adjusted-informed", "sphere", "sphere-adjusted", "sphere-adjusted-informed"),
    *("paper-token", "paper-factorised", "ours"),
)
VARIANTS = tuple(name for name in METHODS if name.startswith(("paper", "ours")))
FULL_HEADER = (
    *("cell", "pairs", "RRA@20", "RTA@20", "AUC@20", "RRA@30", "RTA@30", "AUC@30"),
    *("median E_R", "median E_t", "precision", "s / pair"),
)
MARKED = re.compile(r"(<!-- table: ([\w-]+) -->\n).*?(<!-- end of table -->)", re.DOTALL)


class Results:
    """The largest measurement of each cell; cells of methods that are gone are left out."""

    def __init__(self, lines: Iterable[Line]) -> None:
        self.lines: dict[Place, dict[str, Line]] = {}
        for line in lines:
            if line["method"] and line["method"] not in METHODS:
                continue
            place = self.lines.setdefault((line["group"], line["what"], line["scenario"]), {})
            if line["size"] >= place.get(line["method"], line)["size"]:
                place[line["method"]] = line

    def of(self, place: Place) -> dict[str, Line]:
        """Return the lines of a place by method."""
        return self.lines.get(place, {})


def insert_tables(text: str, lines: Iterable[Line]) -> str:
    """Return a page with the tables between its markers made anew. Raises KeyError."""
    results = Results(lines)
    return MARKED.sub(lambda found: found[1] + TABLES[found[2]](results) + found[3], text)


def all_tables(lines: Iterable[Line]) -> str:
    """Return all tables of the pages, each below its name, and the full table."""
    results = Results(lines)
    tables = {name: make(results) for name, make in TABLES.items()} | {"full": full_table(results)}
    return "\n".join(f"## {name}\n\n{table}" for name, table in tables.items())


# --- two views


def matrix(
    columns: Mapping[str, Place], methods: Sequence[str] = SHOWN
) -> Callable[[Results], str]:
    """Return what makes a table of AUC@20: a row a method, a column a place, the best bold.

    Slow methods, which have fewer pairs, and those that are given identities do not compete.
    """

    def make(results: Results) -> str:
        places = {label: results.of(place) for label, place in columns.items()}
        best = {}
        for label, found in places.items():
            rivals = {m: x for m, x in found.items() if not (is_paper(m) or is_informed(m))}
            if len({line["size"] for line in rivals.values()}) == 1:
                best[label] = max(rivals, key=lambda method: auc(*errors(rivals[method]), 20))
        rows = []
        for method in methods:
            cells = []
            for label, found in places.items():
                score = f"{auc(*errors(found[method]), 20):.3f}" if method in found else "-"
                cells.append(f"**{score}**" if best.get(label) == method else score)
            if set(cells) != {"-"}:
                rows.append([method, *cells])
        return table(("AUC@20", *columns), rows)

    return make


def plural(kind: str) -> str:
    """Return the plural of a kind of subjects."""
    return PLURALS.get(kind, f"{kind}s")


def full_table(results: Results) -> str:
    """Return all figures of two views: a row for each cell of each method."""
    rows = []
    for place, found in results.lines.items():
        if place[0] in ("pairs", "detections"):
            for method in filter(found.get, METHODS):
                name = "/".join(part for part in (*place, method) if part)
                rows.append([name, *figures(found[method])])
    return table(FULL_HEADER, rows)


def figures(line: Line) -> list[str]:
    """Return the cells of a line in the full table, after its name."""
    rotation, translation = errors(line)
    cells = [str(len(rotation))]
    for most in (20, 30):
        cells += [f"{(each < most).mean():.2f}" for each in (rotation, translation)]
        score = f"{auc(rotation, translation, most):.3f}"
        if len(rotation) >= LEAST_PAIRS:
            score += " [{:.2f}, {:.2f}]".format(*auc_interval(rotation, translation, most))
        cells.append(score)
    cells += [f"{np.median(each):.3g}" for each in (rotation, translation)]
    precision = f"{line['right'] / line['matched']:.3f}" if line["matched"] else "-"
    return [*cells, precision, f"{line['seconds']:.2g}"]


def errors(line: Line) -> tuple[Floats, Floats]:
    """Return E_R and E_t `[pair]` in degrees."""
    return np.array(line["rotation"], dtype=float), np.array(line["translation"], dtype=float)


def auc(rotation: Floats, translation: Floats, most: int) -> float:
    """Return AUC@most of errors `[pair]` in degrees."""
    return area_under_curve(np.radians(rotation), np.radians(translation), most)


def auc_interval(rotation: Floats, translation: Floats, most: int) -> tuple[float, float]:
    """Return the 95 % interval of AUC@most, by resampling the pairs."""
    thresholds, counts = np.arange(1, most + 1), _resamples(len(rotation))
    shares = [counts @ (each[:, None] < thresholds) for each in (rotation, translation)]
    areas = np.minimum(*shares).mean(1) / len(rotation)
    low, high = np.percentile(areas, INTERVAL)
    return float(low), float(high)


@cache
def _resamples(pairs: int) -> Floats:
    """Return `[resample, pair]` how often each pair is drawn, always the same."""
    rng = np.random.default_rng(0)
    return rng.multinomial(pairs, np.full(pairs, 1 / pairs), RESAMPLES).astype(float)


# --- networks and rigs


def _networks(results: Results) -> str:
    header = ("target", "own network", "shipped", "shipped, with completion", "training steps")
    rows = []
    for kind in SPECIES:
        for line in results.of(("networks", kind, "")).values():
            scores = [f"{line[name]:.3f}" for name in ("own", "shared", "completed")]
            rows.append([kind, *scores, str(line["size"])])
    return table(header, rows)


def _rigs(results: Results) -> str:
    stages = ("averaging", "adjustment")
    header = ["subjects", *(f"{stage}: E_R / E_t / E_2D" for stage in stages), "s / scene"]
    rows = []
    for kind, count in ((kind, count) for kind, counts in RIGS.items() for count in counts):
        name = "person" if kind == "people" else kind
        for line in results.of(("rigs", kind, f"{count}x{RIG_FRAMES}")).values():
            cells = [" / ".join(f"{x:.2f}" for x in line[stage]) for stage in stages]
            seconds = f"{line['processor_s'] / line['size']:.2g}"
            rows.append([f"{count} {plural(kind) if count > 1 else name}", *cells, seconds])
    return table(header, rows)


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


_SEVERAL_FRAMES = {
    "1 person": ("pairs", "people", "1x5"),
    "4 people": ("pairs", "people", "4x5"),
    "1 dog": ("pairs", "dog", "1x5"),
    "4 dogs": ("pairs", "dog", "4x5"),
    "1 person, 30 % misplaced": ("pairs", "people", WRONG),
}
TABLES: dict[str, Callable[[Results], str]] = {
    "four": matrix({plural(kind): ("pairs", kind, "4x1") for kind in KINDS}),
    "one": matrix({kind: ("pairs", kind, "1x1") for kind in KINDS}),
    "five-frames": matrix(_SEVERAL_FRAMES),
    "detections": matrix({name: ("detections", name, "") for name in RECORDINGS}),
    "ablation": matrix(
        {plural(kind): ("pairs", kind, ABLATED_SCENARIO) for kind in ABLATED}, VARIANTS
    ),
    "generalisation": _networks,
    "rigs": _rigs,
}
