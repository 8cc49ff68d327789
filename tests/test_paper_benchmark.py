"""benchmarks/paper: every table from the data to the page, which is never stale."""

import json
import subprocess
import sys
from datetime import UTC, date, datetime
from pathlib import Path

import numpy as np
import pytest

from benchmarks import machines
from benchmarks.paper import __main__ as paper
from benchmarks.paper import cells, networks, tables

ROOT = Path(__file__).parents[1]
SHARED = ROOT.parent / "shared"
needs_data = pytest.mark.skipif(not SHARED.is_dir(), reason="recordings are not there")


def committed():
    text = paper.RESULTS.read_text("utf-8")
    return [json.loads(line) for line in text.splitlines()]


def test_the_page_has_the_tables_of_the_committed_results():
    text = paper.PAGE.read_text("utf-8")
    assert tables.insert_tables(text, committed()) == text
    marked = [found[2] for found in tables.MARKED.finditer(text)]
    assert sorted(marked) == sorted(tables.TABLES)


def test_the_auc_and_its_interval():
    """Half of the pairs perfect and half wrong: 0.5, and 1.96 sqrt(1/4 / 400) on both sides."""
    errors = np.repeat([0.0, 180.0], 200)
    assert tables.auc(errors, 0 * errors, 20) == pytest.approx(0.5)
    assert tables.auc_interval(errors, errors, 20) == pytest.approx((0.451, 0.549), abs=0.006)
    assert tables.auc(np.full(3, 9.5), np.zeros(3), 20) == pytest.approx(11 / 20)


def line(size, error, **changes):
    cell = {"group": "pairs", "what": "dog", "scenario": "4x1", "method": "ours", "size": size}
    found = {"rotation": [error] * size, "translation": [error] * size, "matched": 4, "right": 3}
    return cell | found | {"seconds": 0.25, "processor_s": 1.0, "machine": "one"} | changes


def test_a_cell_has_the_largest_measurement_and_slow_methods_do_not_compete():
    lines = [line(9, 1.5), line(7, 90.0), line(9, 0.5, method="gone"), line(5, 3.0, what="rat")]
    lines += [line(9, 9.5, method="magsac"), line(6, 0.5, method="paper-factorised")]
    magsac, slow, ours = (
        [cell.strip() for cell in row.strip("| ").split("|")]
        for row in tables.TABLES["four"](tables.Results(lines)).splitlines()[2:]
    )
    assert (magsac[0], magsac[2]) == ("magsac", "0.550")
    assert (slow[0], slow[2]) == ("paper-factorised", "1.000")
    assert (ours[0], ours[2], ours[5]) == ("ours", "**0.950**", "**0.850**")
    full = tables.full_table(tables.Results(lines))
    assert "| pairs/dog/4x1/ours | 9 | 1.00 | 1.00 | 0.950 [0.95, 0.95] |" in full


def test_the_costs_follow_from_the_largest_measurement(capsys):
    asked = [cells.Cell("pairs", "dog", "4x1", name, 30) for name in ("ours", "magsac")]
    paper.print_costs(asked, [line(10, 1.0, processor_s=4.0), line(2, 1.0, processor_s=9.0)])
    said = capsys.readouterr()
    assert said.out == "pairs/dog/4x1/ours 30 12\npairs/dog/4x1/magsac 30 -\n"
    assert said.err == "12 s of the processor for 1 of 2 cells\n"


def test_cells_and_tables_need_no_data(monkeypatch, capsys, tmp_path):
    """All else does, and says so before anything is measured."""
    monkeypatch.delenv("MOCAP_CALIB_RECORDINGS", raising=False)
    results, page = tmp_path / "results.jsonl", tmp_path / "page.md"
    results.write_text(json.dumps(line(9, 1.5)) + "\n")
    page.write_text("<!-- table: four -->\nstale\n<!-- end of table -->\n")
    given = ["paper.py", "dog/4x1/ours", "--results", str(results), "--page", str(page)]
    monkeypatch.setattr(sys, "argv", [*given, "--list"])
    paper.main()
    assert capsys.readouterr().out.startswith("pairs/dog/4x1/ours 100 11\n")
    for options, status in ((["--tables"], 0), ([], 2)):
        monkeypatch.setattr(sys, "argv", [*given, *options])
        with pytest.raises(SystemExit) as ended:
            paper.main()
        assert ended.value.code == status
    assert "expected --poses and --recordings" in capsys.readouterr().err
    assert "stale" not in page.read_text()
    assert "| ours | - | **0.950** |" in page.read_text()


def test_ours_is_measured_wherever_the_others_are():
    """Also where it is behind: among misplaced points."""
    measured = cells.plan(cells.WHOLE, quick=False)
    scenarios = {(each.what, each.scenario) for each in measured if each.method}
    ours = {(each.what, each.scenario) for each in measured if each.method == "ours"}
    assert ours == scenarios
    assert ("people", cells.WRONG) in ours


def test_a_line_says_when_and_of_which_commit(monkeypatch, tmp_path):
    """When alone, where there is no git."""
    moment = machines.describe_moment.__wrapped__
    assert set(moment()) <= {"commit", "date"}
    assert date.fromisoformat(moment()["date"]) <= datetime.now(UTC).date()
    monkeypatch.setenv("PATH", str(tmp_path))
    assert set(moment()) == {"date"}


@pytest.mark.slow
@needs_data
def test_two_pairs_of_every_table(monkeypatch):
    """A cell of each group; the rows of the first pairs are those that are committed."""
    data = cells.Data(SHARED / "poses3d", SHARED / "recordings")
    monkeypatch.setattr(networks, "EXAMPLES", 16)
    lines = [
        cells.measure(cells.Cell(*cell), data)
        for cell in (
            ("pairs", "people", "4x1", "ours", 2),
            ("pairs", "dog", "1x5", "magsac", 2),
            ("pairs", "people", cells.WRONG, "magsac", 2),
            ("detections", "shelf", "", "ours", 2),
            ("networks", "dog", "", "", 1),
            ("rigs", "dog", "4x20", "", 1),
        )
    ]
    page = tables.all_tables(lines)
    for label in ("| 4 dogs | ", "detections/shelf/ours | 2", "misplaced/magsac | 2", "| dog | "):
        assert label in page
    assert lines[-1]["adjustment"][0] < 1.0  # degrees: measured 0.1
    first = next(
        each
        for each in committed()
        if [each[part] for part in ("what", "scenario", "method", "size")]
        == ["people", "4x1", "ours", 100]
    )
    np.testing.assert_allclose(lines[0]["rotation"], first["rotation"][:2], atol=0.5)


@pytest.mark.slow
@needs_data
def test_what_is_there_is_not_measured_again(tmp_path):
    """A run, the same again, and one without data: files of results, tables, one line on stderr."""
    results, page = tmp_path / "results.jsonl", tmp_path / "page.md"
    page.write_text("<!-- table: four -->\nstale\n<!-- end of table -->\n")
    results.write_text(json.dumps(line(2, 1.5, method="magsac")) + "\n")
    command = [sys.executable, "-m", "benchmarks.paper", "dog/4x1/magsac", "--pairs", "2"]
    command += ["--results", results, "--page", page, "--out", tmp_path / "figures"]
    command += ["--poses", tmp_path / "nowhere", "--recordings", tmp_path, "--workers", "1"]
    said = subprocess.run(
        [str(word) for word in command],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env={"PYTHONPATH": f"{ROOT}:{ROOT / 'cli'}"},
    )
    assert said.returncode == 1
    assert f"{tmp_path / 'nowhere' / 'train_dog_mocap'}: expected data there" in said.stderr
    assert len(results.read_text().splitlines()) == 1
    assert "| magsac | - | **" in page.read_text()
    assert "stale" not in page.read_text()
