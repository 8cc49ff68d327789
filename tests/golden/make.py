"""Write the golden files anew.

    python tests/golden/make.py                 the outcomes: expected.json and messages.txt
    python tests/golden/make.py show CASE       what the digests of a conversion are taken of

Look at `git diff tests/golden` afterwards: each changed line is a change that users see. Where a
digest changed, compare what `show` prints of the two versions of the program.
"""

import json
import sys
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "cli"), str(ROOT / "tests")]

from golden import refusals  # noqa: E402 - of the folders above
from golden.cases import (  # noqa: E402
    EXPECTED,
    MESSAGES,
    Conversion,
    as_block,
    conversions,
    damages,
)


def outcome(case: Conversion) -> dict:
    """Return what comes of a case."""
    with TemporaryDirectory() as folder:
        return case.outcome(Path(folder))


def make_outcomes() -> None:
    """Write what comes of all cases."""
    found = {case.name: outcome(case) for case in conversions()}
    rows = (f" {json.dumps(name)}: {json.dumps(each)}" for name, each in found.items())
    blocks = [as_block(case.name, outcome(case)) for case in damages()]
    with TemporaryDirectory() as name:
        folder = Path(name)
        refusals.lay_out(folder)
        blocks += [as_block(name, refusals.outcome(name, folder)) for name in refusals.REFUSALS]
    # both or, where a case fails, neither
    EXPECTED.write_text("{\n" + ",\n".join(rows) + "\n}\n", "utf-8", newline="\n")
    MESSAGES.write_text("\n\n".join(blocks) + "\n", "utf-8", newline="\n")


def show(name: str) -> None:
    """Print what the digests of a case are taken of."""
    (case,) = (each for each in (*conversions(), *damages()) if each.name == name)
    with TemporaryDirectory() as folder:
        print(case.show(Path(folder)))


if __name__ == "__main__":
    warnings.simplefilter("error")
    if sys.argv[1:2] == ["show"]:
        show(" ".join(sys.argv[2:]))
    else:
        make_outcomes()
