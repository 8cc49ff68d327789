"""What a run writes: files whole or not at all, tables that are read again, and what is refused."""

import json
import os
import re
import shutil
import stat
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from damaged_kinds import make_results
from golden.command import call
from platforms import linux, posix

import mocap_calib as mc

TRIANGULATE = ("triangulate", "scene/keypoints", "--rig", "cameras.yaml", "-q", "--matches")
RUN = ("run", "scene/keypoints", "--cameras", "scene/intrinsics.toml", "--no-report", "-q", "-o")
HEAD = "camera,frame,instance,individual\n"


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A small scene, and what `run` and `pairwise` made of it."""
    return make_results(tmp_path_factory.mktemp("made"))


@pytest.fixture
def folder(made, tmp_path) -> Path:
    """A copy of it."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    return tmp_path


def rig(names=("a", "b")) -> mc.CameraRig:
    matrix = np.array([[900.0, 0, 640], [0, 900, 360], [0, 0, 1]])
    cameras = tuple(mc.Camera(name, (1280, 720), matrix, np.zeros(5)) for name in names)
    return mc.CameraRig(cameras, np.stack([np.eye(3)] * 2), np.array([[0.0, 0, 2], [1, 0, 2]]), "m")


# --- whole or not at all


def contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def fail_at(monkeypatch, number: int) -> None:
    """Let the n-th renaming of a file fail, as on a full or failing disk."""
    calls, plain = [], os.replace

    def rename(source, target):
        calls.append(source)
        if len(calls) == number:
            raise OSError(28, "No space left on device")
        plain(source, target)

    monkeypatch.setattr(os, "replace", rename)


@pytest.mark.parametrize("number", range(1, 3))
def test_a_failed_write_leaves_the_files_that_were_there(number, tmp_path, monkeypatch):
    """Each of two files is replaced by one renaming."""
    mc.write(rig(), tmp_path / "out", "opencv")
    (tmp_path / "out" / "notes").write_text("mine")
    before = contents(tmp_path)
    other = replace(rig(), translation=-rig().translation)
    with monkeypatch.context() as patch:
        fail_at(patch, number)
        with pytest.raises(OSError, match="No space"):
            mc.write(other, tmp_path / "out", "opencv")
    assert contents(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    mc.write(other, tmp_path / "out", "opencv")
    np.testing.assert_array_equal(mc.read_rig(tmp_path / "out").translation, other.translation)


def in_child(work) -> int:
    """Return the exit status of a process that does some work, and leaves nothing undone."""
    child = os.fork()
    if child == 0:
        try:
            os._exit(work() or 0)
        finally:
            os._exit(99)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def killed_at(patched: str, number: int, work) -> int:
    """Return the status of a process that ends as if killed when it renames for the n-th time."""
    calls, plain = [], getattr(os, patched)

    def rename(*names):
        calls.append(names)
        if len(calls) == number:
            os._exit(9)
        plain(*names)

    def child() -> None:
        setattr(os, patched, rename)
        work()

    return in_child(child)


@posix
@pytest.mark.parametrize(("patched", "number"), [("rename", 1), ("replace", 1), ("replace", 2)])
def test_a_killed_write_loses_nothing_and_its_files_are_all_old_or_all_new(
    patched, number, tmp_path
):
    """Of two files; what the killed one left goes with the next write, also of single files."""
    out, other = tmp_path / "out", replace(rig(), translation=-rig().translation)
    mc.write(rig(), out, "opencv")
    (out / "notes").write_text("mine")
    before = set(contents(out))
    assert killed_at(patched, number, lambda: mc.write(other, out, "opencv")) == 9
    assert before <= set(contents(out)), "no file is lost"
    found = other if patched == "replace" else rig()
    np.testing.assert_array_equal(mc.read_rig(out).translation, found.translation)
    mc.write(rig(), out, "opencv")
    assert set(contents(out)) == before
    assert killed_at("replace", 1, lambda: mc.write(other, tmp_path / "a.toml")) == 9
    mc.write(rig(), tmp_path / "a.toml")
    assert {path.name for path in tmp_path.iterdir()} == {"out", "a.toml"}


@posix
@pytest.mark.parametrize(("name", "form"), [("out", "opencv"), ("out.toml", "anipose")])
def test_what_another_process_is_writing_is_waited_for(name, form, tmp_path, monkeypatch):
    """Its hidden files are not those of a killed one."""
    begun, go, plain = threading.Event(), threading.Event(), os.replace

    def rename(*names):
        begun.set()
        go.wait(60)
        plain(*names)

    monkeypatch.setattr(os, "replace", rename)
    rigs = (rig(), replace(rig(), translation=-rig().translation))
    first, second = (
        threading.Thread(target=mc.write, args=(each, tmp_path / name, form)) for each in rigs
    )
    first.start()
    assert begun.wait(60)
    second.start()
    second.join(0.2)
    assert second.is_alive()
    go.set()
    for thread in (first, second):
        thread.join(60)
    found = mc.read_rig(tmp_path / name)
    np.testing.assert_array_equal(found.translation, rigs[1].translation)
    assert not [path for path in contents(tmp_path) if "/." in f"/{path}"]


@posix
@pytest.mark.parametrize("room", [0, 3_000, 8_000, 20_000])
def test_a_full_disk_is_one_line_that_names_the_place(room, folder):
    """HDF5 raises what hides it, or ends the process, where it cannot write (limit: 26 kB)."""
    before = contents(folder)

    def scale() -> int:
        import resource

        resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
        for words in (("scale", ".", "--height", 1.7), ("convert", "poses3d.h5", "new.npz")):
            done = call(*words, "-q", folder=folder)
            place = {"scale": ".", "convert": "new.npz"}[words[0]]
            expected = f"mocap-calib: {place}: expected room to write, found file too large; "
            if done.status != 1 or not done.stderr[-1].startswith(expected):
                return 1
        return 0

    assert (folder / "poses3d.h5").stat().st_size > 20_000
    assert in_child(scale) == 0
    assert contents(folder) == before


def test_a_failed_first_write_leaves_nothing(tmp_path, monkeypatch):
    for name, number in (("anipose", 1), ("opencv", 2)):
        with monkeypatch.context() as patch:
            fail_at(patch, number)
            with pytest.raises(OSError, match="No space"):
                mc.write(rig(), tmp_path / "deep" / name, name)
    assert not contents(tmp_path)


def test_a_file_where_a_folder_is_is_refused_by_its_name(tmp_path):
    (tmp_path / "there").mkdir()
    with pytest.raises(IsADirectoryError) as caught:
        mc.write(rig(), tmp_path / "there", "anipose")
    assert caught.value.filename == str(tmp_path / "there")
    assert [path.name for path in tmp_path.iterdir()] == ["there"]


@posix
@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_files_have_the_mode_of_new_files(mask, tmp_path, made):
    """A lab group reads results where the umask lets it."""
    (view,) = mc.read_keypoints(made / "scene" / "keypoints" / "cam1.json")
    before = os.umask(mask)
    try:
        mc.write(rig(), tmp_path / "a.toml")
        mc.write(rig(), tmp_path / "b", "opencv")
        mc.write(mc.read_poses(made / "poses3d.h5"), tmp_path / "c.npz")
        mc.write(view, tmp_path / "d.csv", "csv")
    finally:
        os.umask(before)
    modes = {stat.S_IMODE(path.stat().st_mode) for path in tmp_path.rglob("*") if path.is_file()}
    assert modes == {0o666 & ~mask}


@posix
def test_a_reader_that_goes_ends_the_command_quietly_with_status_1(made):
    words = ["inspect", "scene/keypoints", "--json"]
    command = [sys.executable, "-m", "mocap_calib_cli", *words]
    with subprocess.Popen(command, cwd=made, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as run:
        run.stdout.close()
        assert run.stderr.read() == b""
        assert run.wait(timeout=120) == 1


def test_what_an_earlier_run_wrote_is_removed_unless_it_was_changed(folder):
    """Other files stay, whatever their names; a damaged report lists no files."""
    report = json.loads((folder / "run.json").read_text())
    earlier = report["outputs"]
    assert earlier["matches.csv"]
    (folder / "old").mkdir()
    for name in ("old/a.csv", "b.csv", "mine.csv"):
        (folder / name).write_text("1")
    same = dict.fromkeys(("old/a.csv", "b.csv"), earlier["matches.csv"])
    for name in same:
        shutil.copy(folder / "matches.csv", folder / name)
    (folder / "b.csv").write_text("edited")
    listed = earlier | same | {"../outside.csv": "0", "gone.csv": "0"}
    (folder / "run.json").write_text(json.dumps(report | {"outputs": listed}))
    assert call(*RUN, ".", folder=folder).status == 0
    assert not (folder / "old").exists()
    assert {"b.csv", "mine.csv", "matches.csv"} <= set(contents(folder))
    for damage in ("", "[]", '{"outputs": 3}'):
        (folder / "run.json").write_text(damage)
        assert call(*RUN, ".", folder=folder).status == 0
    assert (folder / "b.csv").read_text() == "edited"


def test_the_date_is_that_of_a_reproducible_build(folder, monkeypatch):
    """And one that is none is refused before anything is read."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "86400")
    assert call(*RUN, "new", folder=folder).status == 0
    assert "1970-01-02T00:00:00Z" in (folder / "new" / "run.json").read_text()
    for said in ("today", "1e9", "9" * 30):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", said)
        done = call("run", "nothing", "-o", "other", folder=folder)
        assert done.status == 1
        assert "SOURCE_DATE_EPOCH: expected whole seconds" in done.stderr[-1]


# --- matches.csv and pairs.json


def test_matches_have_a_row_per_detection(made):
    head, *rows = (made / "matches.csv").read_text().splitlines()
    views = mc.read_keypoints(made / "scene" / "keypoints")
    seen = sum(int(np.isfinite(view.positions).any((2, 3)).sum()) for view in views)
    named = {row.rpartition(",")[0] for row in rows}
    assert (f"{head}\n", len(rows), len(named)) == (HEAD, seen, seen)


def test_matches_are_read_in_any_order_with_any_line_end_and_gaps(folder):
    head, *rows = (folder / "matches.csv").read_text().splitlines()
    text = "\r\n".join([head, *rows[::-1], ""])
    (folder / "m.csv").write_bytes(b"\xef\xbb\xbf" + text.encode())
    for name in ("matches", "m"):
        assert call(*TRIANGULATE, f"{name}.csv", "-o", f"{name}.npz.h5", folder=folder).status == 0
    one, other = (mc.read_poses(folder / f"{name}.npz.h5") for name in ("matches", "m"))
    assert one == other
    gone = [row for row in rows if not row.startswith("cam1,3,")]
    (folder / "m.csv").write_text("\n".join([head, *gone]))
    assert call(*TRIANGULATE, "m.csv", "-o", "m.h5", folder=folder).status == 0
    fewer = mc.read_poses(folder / "m.h5")
    row = one.frames.tolist().index(3)
    same = np.delete(fewer.views == one.views, row, 0)
    assert same.mean() > 0.99, "all but a point or two, whose weights change"
    assert fewer.views[row].max() == one.views[row].max() - 1


@pytest.mark.parametrize(
    "rows",
    [
        *("middle,2,0,0", "cam1,2,9,0", "cam1,2,-1,0"),
        *("cam1,2,0", "cam1,2,0,x", "cam1,2,0,-2", "cam1,2,0,9999", "cam1,2,0,1,2"),
        *("cam1,2,0," + "9" * 40, "cam1,2,0,0\ncam1,2,0,1", "cam1,2,0,0\ncam1,2,1,0"),
    ],
)
def test_matches_that_are_wrong_are_refused_in_a_line(rows, folder):
    (folder / "m.csv").write_text(HEAD + rows + "\n")
    done = call(*TRIANGULATE, "m.csv", "-o", "new.h5", folder=folder)
    (line,) = done.stderr
    assert done.status == 1
    assert re.search(r"expected .+, found .+; .+", line), line
    assert not (folder / "new.h5").exists()


WRONG = [("(?s).*", text) for text in ("", "[]", "{}", "[" * 1000)]
WRONG += [(r"(?s).{40}$", ""), ('"version": 1', '"version": 2'), ('"a": "cam1"', '"a": "nobody"')]
WRONG += [
    ('"score"', '"skore"'),
    (r'"rotation": \[\[', '"rotation": [[['),
    ('"frames": ', '"frames": "x", "o": '),
]
WRONG += [(rf'"{key}": \[', f'"{key}": [3, ') for key in ("translation", "pairs", "cameras")]


@pytest.mark.parametrize(("old", "new"), WRONG)
def test_pairs_that_are_wrong_are_refused_in_a_line(old, new, folder):
    text = (folder / "pairs.json").read_text()
    (folder / "p.json").write_text(re.sub(old, new, text, count=1))
    done = call("average", "p.json", "-o", "new.yaml", "-q", folder=folder)
    (line,) = done.stderr
    assert done.status == 1
    assert line.startswith("mocap-calib: p.json: expected "), line
    assert not (folder / "new.yaml").exists()


def test_pairs_are_strict_json_and_read_without_alternatives(folder):
    """They come back: `average` makes the same rig of what it is given in any spelling."""
    text = (folder / "pairs.json").read_text()
    tree = json.loads(text, parse_constant=pytest.fail)  # no NaN
    assert not re.search(r"(?<![\d.])-0\.0\b(?!\d)", text)
    for pair in tree["pairs"]:
        pair.pop("alternatives")
    for name, content in (("all", text), ("few", json.dumps(tree)), ("again", json.dumps(tree))):
        (folder / f"{name}.json").write_text(content)
        done = call("average", f"{name}.json", "-o", f"{name}.yaml", "-q", folder=folder)
        assert done.status == 0, done.stderr
    few, again = (mc.read_rig(folder / f"{name}.yaml") for name in ("few", "again"))
    np.testing.assert_array_equal(few.rotation, again.rotation)
    assert len(mc.read_rig(folder / "all.yaml").cameras) == 3


# --- poses and further formats


def test_what_a_format_cannot_hold_is_refused_before_a_run(folder):
    path = folder / "scene" / "intrinsics.toml"
    given = re.sub(r"distortions = \[[^\]]*\]", f"distortions = {[0.1] * 8}", path.read_text())
    path.write_text(given)
    done = call(*RUN, "new", "--write", "nerfstudio", folder=folder)
    assert (done.status, "5 dist" in done.stderr[-1]) == (1, True)
    assert not (folder / "new").exists()


def test_further_formats_are_written_beside_and_what_they_lose_is_reported(folder):
    done = call(
        *RUN[:-2], "-o", "new", "--write", "sleap-anipose", "--write", "opencv", folder=folder
    )
    assert done.status == 0
    assert {"points3d.h5", "opencv/cam1.yml"} <= set(contents(folder / "new"))
    assert any("sleap-anipose does not hold" in line for line in done.stderr)


def test_what_was_filled_in_is_listed_beside_and_remarked(folder):
    data = json.loads((folder / "scene" / "keypoints" / "cam1.json").read_text())
    for annotation in data["annotations"][:4]:
        annotation["keypoints"][:3] = [0, 0, 0]
    (folder / "scene" / "keypoints" / "cam1.json").write_text(json.dumps(data))
    cameras = ("--cameras", "scene/intrinsics.toml", "-q")
    done = call("complete", "scene/keypoints", *cameras, "-o", "filled", folder=folder)
    assert done.status == 0
    listed = (folder / "filled" / "filled_in.tsv").read_text().splitlines()
    assert listed[0] == "camera\tframe\tinstance\tkeypoint"
    mine = sum(row.startswith("cam1\t") for row in listed)
    assert mine >= 4
    paths = ("left=filled/cam1.json", "filled/cam2.json", "filled/cam3.json")
    done = call("run", *paths, "--no-report", "-o", "new", folder=folder)
    said = f"left: {mine} keypoints filled in by `complete`, not measured"
    assert said in "\n".join(done.stderr)
    (folder / "filled" / "filled_in.tsv").write_bytes(b'camera\na\n"\0\xff')
    assert call("inspect", "filled", folder=folder).status == 0


CONTROL = "\x1b]0;PWN\x07=HYPERLINK(1)"


@posix
def test_control_characters_in_names_are_escaped_in_tables_and_on_the_screen(folder):
    """Formulas of spreadsheets stay the names that they are: others read them back."""
    keypoints = folder / "scene" / "keypoints"
    for path in list(keypoints.iterdir()):
        text = path.read_text().replace('"left_ankle"', json.dumps(CONTROL))
        path.write_text(text)
        path.rename(path.with_name(path.name.replace("cam1", CONTROL)))
    intrinsics = folder / "scene" / "intrinsics.toml"
    intrinsics.write_text(intrinsics.read_text().replace('"cam1"', json.dumps(CONTROL)))
    shown = []
    for words in (
        ("inspect", "scene/keypoints"),
        ("inspect", "\x1b[2J"),
        ("\x1b[2J",),
        (*RUN[:4], "--no-report", "--json", "-o", "."),
        (*TRIANGULATE, "matches.csv", "-o", "p.csv"),
    ):
        done = call(*words, folder=folder)
        shown += [done.stdout.decode(), *done.stderr]
    texts = [path.read_text() for path in folder.glob("*.csv")]
    assert {each for text in [*texts, *shown] for each in text if not each.isprintable()} == {"\n"}
    escaped = CONTROL.encode("unicode_escape").decode()
    assert all(any(each in text for text in [*texts, *shown]) for each in (escaped, f"{escaped}_x"))
    assert f"\n{escaped},0,0," in (folder / "matches.csv").read_text()
    assert (folder / "p_0.csv").exists(), "matches are read back"


@linux
def test_a_path_that_is_not_utf8_is_escaped_where_results_name_it(folder):
    keypoints = folder / "scene" / "keypoints"
    path = (keypoints / "cam1.json").rename(keypoints / os.fsdecode(b"c\xff4.json"))
    paths = (f"cam1={path}", keypoints / "cam2.json", keypoints / "cam3.json")
    cameras = ("--cameras", "scene/intrinsics.toml", "--no-report", "-q")
    assert call("run", *paths, *cameras, "-o", "new", folder=folder).status == 0
    assert "c\\\\udcff4.json" in (folder / "new" / "run.json").read_text("utf-8")
