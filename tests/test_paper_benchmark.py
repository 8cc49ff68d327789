"""benchmarks/paper.py: every table from the data to the page, which is never stale."""

import json
import subprocess
import sys
from datetime import UTC, date, datetime
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
BENCHMARKS = ROOT / "benchmarks"
SHARED = ROOT.parent / "shared"
needs_data = pytest.mark.skipif(not SHARED.is_dir(), reason="recordings are not there")


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return import_module


def committed():
    text = (BENCHMARKS / "paper_results.jsonl").read_text("utf-8")
    return [json.loads(line) for line in text.splitlines()]


def test_the_pages_have_the_tables_of_the_committed_results(benchmark):
    tables, pages = benchmark("paper_tables"), benchmark("paper").PAGES
    texts = [page.read_text("utf-8") for page in pages]
    for text in texts:
        assert tables.insert_tables(text, committed()) == text
    marked = [found[2] for text in texts for found in tables.MARKED.finditer(text)]
    assert sorted(marked) == sorted(tables.TABLES)


def test_the_page_of_other_tools_repeats_what_was_measured():
    """The seconds and median errors of adjustments, and of poses the errors."""
    pages = {p.stem: " ".join(p.read_text("utf-8").split()) for p in (ROOT / "docs").glob("*.md")}
    rows = [
        row.split(" | ")
        for start in ("| ours (20,000 points", "| Ceres by pycolmap", "| aniposelib 0.8.0")
        for row in [pages["benchmarks"].split(start)[1]]
    ]
    ours, ceres, anipose = ((row[1], row[3].split(" / ")[0]) for row in rows)
    said = (
        f"ours {ours[0]} s, Ceres by pycolmap {ceres[0]} s, aniposelib {anipose[0]} s, with median "
    )
    said += f"errors of {ours[1]}, {ceres[1]} and {anipose[1]} deg"
    assert said in pages["comparison"]
    walker = pages["poses"].split("| Human3.6M, S1 walks | ")[2].split(" | ")
    seconds = float(walker[5].split()[0])
    said = f"{walker[1]} mm in {seconds:.0f} s, ours {walker[0]} mm in less than 0.5 s"
    assert said in pages["comparison"]


def test_the_auc_and_its_interval(benchmark):
    """Half of the pairs perfect and half wrong: 0.5, and 1.96 sqrt(1/4 / 400) on both sides."""
    tables = benchmark("paper_tables")
    errors = np.repeat([0.0, 180.0], 200)
    assert tables.auc(errors, 0 * errors, 20) == pytest.approx(0.5)
    assert tables.auc_interval(errors, errors, 20) == pytest.approx((0.451, 0.549), abs=0.006)
    assert tables.auc(np.full(3, 9.5), np.zeros(3), 20) == pytest.approx(11 / 20)


def line(size, error, **changes):
    cell = {"group": "pairs", "what": "dog", "scenario": "4x1", "method": "ours", "size": size}
    found = {"rotation": [error] * size, "translation": [error] * size, "matched": 4, "right": 3}
    return cell | found | {"seconds": 0.25, "processor_s": 1.0, "machine": "one"} | changes


def test_a_row_has_the_largest_measurement_and_says_how_many_pairs_and_where(benchmark):
    lines = [line(9, 1.5), line(7, 90.0), line(9, 0.5, method="gone"), line(5, 3.0, what="rat")]
    lines += [line(9, 9.5, method="magsac", machine="two"), line(6, 0.5, method="paper-factorised")]
    rows = benchmark("paper_tables").TABLES["four"](benchmark("paper_tables").Results(lines))
    magsac, paper, ours, rat = (row.strip("| ").split(" | ") for row in rows.splitlines()[2:])
    assert magsac[:3] == ["dogs", "magsac (baseline)", "9"]
    assert paper[:2] == ["paper-factorised", "6"]
    assert ours[:5] == ["ours", "9", "1.00", "1.00", "**0.950 [0.95, 0.95]**"]
    assert (magsac[-1], ours[-2:]) == ("B", ["0.25", "A"])
    assert rat[:3] == ["rats", "ours", "5"]


def test_the_costs_follow_from_the_largest_measurement(benchmark, capsys):
    cells, paper = benchmark("paper_cells"), benchmark("paper")
    asked = [cells.Cell("pairs", "dog", "4x1", name, 30) for name in ("ours", "magsac")]
    paper.print_costs(asked, [line(10, 1.0, processor_s=4.0), line(2, 1.0, processor_s=9.0)])
    said = capsys.readouterr()
    assert said.out == "pairs/dog/4x1/ours 30 12\npairs/dog/4x1/magsac 30 -\n"
    assert said.err == "12 s of the processor for 1 of 2 cells\n"


def test_cells_and_tables_need_no_data(benchmark, monkeypatch, capsys, tmp_path):
    """All else does, and says so before anything is measured."""
    paper = benchmark("paper")
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
    assert "| dogs | ours | 9 |" in page.read_text()


def test_ours_is_measured_wherever_the_others_are(benchmark):
    """Also where it is behind: among misplaced points."""
    cells = benchmark("paper_cells")
    measured = cells.plan(cells.WHOLE, quick=False)
    scenarios = {(each.what, each.scenario) for each in measured if each.method}
    ours = {(each.what, each.scenario) for each in measured if each.method == "ours"}
    assert ours == scenarios
    assert ("people", cells.WRONG) in ours


def test_a_line_says_when_and_of_which_commit(benchmark, monkeypatch, tmp_path):
    """When alone, where there is no git."""
    moment = benchmark("machines").describe_moment.__wrapped__
    assert set(moment()) <= {"commit", "date"}
    assert date.fromisoformat(moment()["date"]) <= datetime.now(UTC).date()
    monkeypatch.setenv("PATH", str(tmp_path))
    assert set(moment()) == {"date"}


@pytest.mark.slow
@needs_data
def test_two_pairs_of_every_table(benchmark, monkeypatch):
    """A cell of each group; the rows of the first pairs are those that are committed."""
    cells = benchmark("paper_cells")
    data = cells.Data(SHARED / "poses3d", SHARED / "recordings")
    monkeypatch.setattr(benchmark("generalisation"), "EXAMPLES", 16)
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
    tables = benchmark("paper_tables").all_tables(lines)
    assert tables.count("\n| people |") == 1  # a name, of the pairs of four
    for label in ("4 dogs | 1 | adjustment", "| shelf | ours", "| person | magsac", "| dog | "):
        assert label in tables
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
    command = [sys.executable, BENCHMARKS / "paper.py", "dog/4x1/magsac", "--pairs", "2"]
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
    assert "| dogs | magsac (baseline) | 2 |" in page.read_text()
    assert "stale" not in page.read_text()
