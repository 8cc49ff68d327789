"""A user's mistake: one line on stderr, exit 1, nothing on stdout, nothing written."""

import json
import shutil
from pathlib import Path

import pytest


@pytest.fixture
def folder(small, tmp_path) -> Path:
    """A copy of the small recording to spoil."""
    shutil.copytree(small, tmp_path / "in")
    return tmp_path / "in"


def edit(path: Path, change) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def no_such_file(folder: Path) -> None:
    shutil.rmtree(folder / "keypoints")


def unknown_format(folder: Path) -> None:
    (folder / "keypoints" / "cam1.json").write_text("this is no JSON at all")


def cut_file(folder: Path) -> None:
    path = folder / "keypoints" / "cam1.json"
    path.write_text(path.read_text()[:5000])


def no_common_joints(folder: Path) -> None:
    for k in (1, 2, 3):
        edit(
            folder / "keypoints" / f"cam{k}.json",
            lambda c, k=k: c["categories"][0].update(
                keypoints=[f"joint{j}of{k}" for j in range(17)]
            ),
        )


def unknown_joints(folder: Path) -> None:
    for k in (1, 2, 3):
        edit(
            folder / "keypoints" / f"cam{k}.json",
            lambda c: c["categories"][0].update(keypoints=[f"x{j}" for j in range(17)]),
        )


def intrinsics_missing(folder: Path) -> None:
    path = folder / "intrinsics.toml"
    path.write_text(path.read_text().replace('"cam2"', '"other"'))


def one_camera(folder: Path) -> None:
    for k in (2, 3):
        (folder / "keypoints" / f"cam{k}.json").unlink()


def no_overlap(folder: Path) -> None:
    for k in (1, 2, 3):
        edit(
            folder / "keypoints" / f"cam{k}.json",
            lambda c, k=k: [
                i.update(file_name=f"frame_{1000 * k + i['id']:06d}.jpg") for i in c["images"]
            ],
        )


def never_together(folder: Path) -> None:
    for k in (1, 2, 3):
        edit(
            folder / "keypoints" / f"cam{k}.json",
            lambda c, k=k: c.update(
                annotations=[a for a in c["annotations"] if a["image_id"] % 3 == k - 1]
            ),
        )


def other_image_size(folder: Path) -> None:
    edit(
        folder / "keypoints" / "cam1.json",
        lambda c: [i.update(width=1920, height=1080) for i in c["images"]],
    )


def intrinsics_no_toml(folder: Path) -> None:
    (folder / "intrinsics.toml").write_text("= = =")


def out_is_a_file(folder: Path) -> None:
    (folder / "out").write_text("mine")


MISTAKES = [
    (no_such_file, "keypoints"),
    (unknown_format, "cam1.json"),
    (cut_file, "cam1.json"),
    (no_common_joints, "joint"),
    (unknown_joints, "--skeleton"),
    (intrinsics_missing, "cam2"),
    (one_camera, "two"),
    (no_overlap, "1000"),
    (never_together, "co-visible"),
    (other_image_size, "1920"),
    (intrinsics_no_toml, "intrinsics.toml"),
    (out_is_a_file, "out"),
]


@pytest.mark.parametrize(("spoil", "names"), MISTAKES, ids=[m[0].__name__ for m in MISTAKES])
def test_mistake(spoil, names, folder, tool):
    spoil(folder)
    before = {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    said = tool(
        "run",
        folder / "keypoints",
        "--cameras",
        folder / "intrinsics.toml",
        "-o",
        folder / "out",
        "--quiet",
    )
    assert said.returncode == 1, said.stderr
    assert said.stdout == ""
    assert len(said.stderr.splitlines()) == 1, said.stderr
    assert said.stderr.startswith("mocap-calib: ")
    assert names in said.stderr
    assert "expected" in said.stderr
    assert before == {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_failing_run_leaves_earlier_results_alone(folder, tool):
    (folder / "out").mkdir()
    (folder / "out" / "cameras.yaml").write_text("earlier")
    cut_file(folder)
    assert (
        tool(
            "run",
            folder / "keypoints",
            "--cameras",
            folder / "intrinsics.toml",
            "-o",
            folder / "out",
        ).returncode
        == 1
    )
    assert [p.name for p in (folder / "out").iterdir()] == ["cameras.yaml"]
    assert (folder / "out" / "cameras.yaml").read_text() == "earlier"


def test_matches_of_another_recording(folder, tool):
    (folder / "m.csv").write_text("camera,frame,instance,individual\ncam9,0,0,0\n")
    said = tool(
        "triangulate",
        folder / "keypoints",
        "--rig",
        folder / "reference.toml",
        "--matches",
        folder / "m.csv",
        "-o",
        folder / "p.h5",
        "-q",
    )
    assert said.returncode == 1
    assert "cam9" in said.stderr
    assert not (folder / "p.h5").exists()


def test_names_of_ones_own(folder, tool, tmp_path):
    """--skeleton maps joints that nobody has heard of; without it the model knows none."""
    names: list[str] = []
    for k in (1, 2, 3):
        path = folder / "keypoints" / f"cam{k}.json"
        names = json.loads(path.read_text())["categories"][0]["keypoints"]
        edit(path, lambda c: c["categories"][0].update(keypoints=[f"p{j}" for j in range(17)]))
    (tmp_path / "mine.yaml").write_text(
        "aliases:\n" + "".join(f"  p{j}: {name}\n" for j, name in enumerate(names))
    )
    said = tool(
        "pairwise",
        folder / "keypoints",
        "--cameras",
        folder / "intrinsics.toml",
        "--skeleton",
        tmp_path / "mine.yaml",
        "-o",
        tmp_path / "pairs.json",
    )
    assert said.returncode == 0, said.stderr
    assert "the model of people knows 17" in said.stderr
    (tmp_path / "mine.yaml").write_text("aliases: {p0: proboscis}")
    said = tool(
        "pairwise",
        folder / "keypoints",
        "--cameras",
        folder / "intrinsics.toml",
        "--skeleton",
        tmp_path / "mine.yaml",
    )
    assert said.returncode == 1
    assert "proboscis" in said.stderr
