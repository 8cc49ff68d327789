"""What `mutate.py` tried, as a table, and why what survived changes nothing that counts."""

import json
import tomllib
from collections import Counter
from pathlib import Path

from mutations import Mutation

ROOT = Path(__file__).parents[1]
KEYS = ("path", "function", "line", "kind", "before", "after")
SURVIVED = Path(__file__).with_name("mutations_survived.toml")


def read_log(path: Path) -> dict[str, dict]:
    """Return what was tried by name; the last line of a name counts."""
    if not path.exists():
        return {}
    entries = map(json.loads, path.read_text("utf-8").splitlines())
    return {entry["name"]: entry for entry in entries}


def read_reasons() -> dict[tuple[str, ...], str]:
    """Return why a mutation cannot be noticed, by its place and its change."""
    listed = tomllib.loads(SURVIVED.read_text("utf-8"))["survived"]
    return {tuple(entry[key] for key in KEYS): entry["why"] for entry in listed}


def place(mutation: Mutation) -> tuple[str, ...]:
    """Return what tells a mutation from others even where lines above it come and go."""
    line = (ROOT / mutation.path).read_text("utf-8").splitlines()[mutation.line - 1].strip()
    before, after = (" ".join(text.split()) for text in (mutation.before, mutation.after))
    return mutation.path, mutation.function, line, mutation.kind, before, after


def report(chosen: list[Mutation], known: dict[str, dict]) -> str:
    """Return the share that was noticed, and all that was neither noticed nor explained."""
    reasons = read_reasons()
    tried = [mutation for mutation in chosen if mutation.name in known]
    survived = [mutation for mutation in tried if not known[mutation.name]["killed"]]
    unexplained = [mutation for mutation in survived if place(mutation) not in reasons]
    of, alive = Counter(m.package for m in tried), Counter(m.package for m in survived)
    open_ = Counter(m.package for m in unexplained)
    rows = [(name, of[name], alive[name], open_[name]) for name in of]
    rows.append(("all", len(tried), len(survived), len(unexplained)))
    lines = ["| package | mutations | noticed | explained | neither |", "|---|---|---|---|---|"]
    for name, number, some, rest in rows:
        share = f"{number - some} ({100 * (number - some) / max(number, 1):.0f} %)"
        lines.append(f"| {name} | {number} | {share} | {some - rest} | {rest} |")
    lines.append("")
    for mutation in unexplained:
        entry = known[mutation.name]
        tests = f"{entry['tests']} tests, {entry['left_out']} not run"
        lines.append(f"* {mutation.describe()}: {tests}")
    return "\n".join(lines)
