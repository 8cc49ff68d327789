"""truth.npz and reference.toml are for judging: no stage reads them."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
WRITERS = {"mocap_calib/io/results/scene.py"}  # what `simulate` writes
JUDGES = {
    "cli/mocap_calib_cli/main.py",
    "cli/mocap_calib_cli/commands/evaluate.py",
}  # examples in help texts

WATCHED = """
import sys
opened = []
sys.addaudithook(lambda event, args: opened.append(str(args[0])) if event == "open" else None)
sys.argv = ["mocap-calib", *sys.argv[1:]]
from mocap_calib_cli.main import main
try:
    main()
except SystemExit as end:
    print("\\n".join(opened))
    sys.exit(end.code)
"""


def test_no_module_names_them():
    for path in [*(ROOT / "mocap_calib").rglob("*.py"), *(ROOT / "cli").rglob("*.py")]:
        inside = str(path.relative_to(ROOT))
        text = path.read_text("utf-8")
        if inside not in WRITERS:
            assert "truth.npz" not in text, inside
            assert inside in JUDGES or "reference.toml" not in text, inside


@pytest.mark.slow
def test_a_run_opens_neither(small, tmp_path):
    """Watched by an audit hook: every file that Python opens during a run.

    Both files stand beside the keypoints.
    """
    assert (small / "truth.npz").exists()
    assert (small / "reference.toml").exists()
    command = [
        "run",
        small / "keypoints",
        "--cameras",
        small / "intrinsics.toml",
        "-o",
        tmp_path / "out",
        "--quiet",
    ]
    said = subprocess.run(
        [sys.executable, "-c", WATCHED, *map(str, command)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert said.returncode == 0, said.stderr
    opened = said.stdout.splitlines()
    assert any("cam1.json" in name for name in opened)  # the hook does see
    assert not [name for name in opened if name.endswith(("truth.npz", "reference.toml"))]
