"""The files of `corpus/`, what is done with them through the command, and what comes of it.

`corpus/KIND/NAME` holds one small recording, rig or set of poses as the program NAME writes it.
Each is converted to the formats of its kind, and read again with each kind of damage to it.
`corpus/refused-KIND/NAME` holds files with one thing wrong, `corpus/details-KIND/NAME` files with
one thing that is unusual, which `convert` reads.
"""

import json
import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from conformance import CORPUS, KEYPOINTS, TARGETS
from golden.command import Outcome, call
from golden.damage import DAMAGES
from golden.digests import canonical, digest

HERE = Path(__file__).parent
EXPECTED, MESSAGES = HERE / "expected.json", HERE / "messages.txt"
PARTICULAR = ("refused", "details")
APART = 3  # files of a folder that have a digest each
# rigs that are converted to all formats; of the others it is enough that they are read
RIGS = {"anipose", "anipose-fisheye", "plain", "colmap"}
TIMED = ("--input-unit", "m", "--fps", "60")
# what has to be said of files that do not say it themselves
OPTIONS = {
    "cameras/colmap-binary": ("--input-unit", "m"),
    "poses/anipose-csv": TIMED,
    "poses/sleap-anipose": TIMED,
}


def options(entry: str) -> tuple[str, ...]:
    """Return the words of the command that say what the files of an entry do not."""
    kind, name = entry.split("/")
    said = KEYPOINTS[name].options if kind == "keypoints" else {}
    layout = ("--layout", ",".join(said["layout"])) if "layout" in said else ()
    size = ("--image-size", "{}x{}".format(*said["image_size"])) if "image_size" in said else ()
    return OPTIONS.get(entry, (*layout, *size))


@dataclass(frozen=True)
class Conversion:
    """One entry of the corpus, converted to one format, or read with one kind of damage.

    entry: `KIND/NAME`. damage: one of `DAMAGES`, "" for none.
    """

    entry: str
    target: str
    damage: str = ""

    @property
    def name(self) -> str:
        """What the case is called in the files of outcomes."""
        if self.entry.startswith(PARTICULAR):
            return self.entry
        return f"{self.entry} {self.damage}" if self.damage else f"{self.entry} -> {self.target}"

    def lay_out(self, folder: Path) -> str:
        """Copy the entry into a folder, damage it, and return the path to convert."""
        place = folder / Path(self.entry).name
        shutil.copytree(CORPUS / self.entry, place)
        files = sorted(path for path in place.rglob("*") if path.is_file())
        if self.damage:
            victim = max(files, key=lambda path: path.stat().st_size)
            victim.write_bytes(DAMAGES[self.damage](victim.read_bytes()))
        inside = sorted(place.iterdir())
        path = inside[0] if len(inside) == 1 else place
        return path.relative_to(folder).as_posix()

    def run(self, folder: Path) -> Outcome:
        """Convert the entry into `folder/out`."""
        path = self.lay_out(folder)
        (folder / "out").mkdir()
        words = ("--to", self.target, *options(self.entry))
        return call("convert", path, f"out/{self.target}", *words, folder=folder)

    def outcome(self, folder: Path) -> dict[str, Any]:
        """Return status, lines of stderr, and the digests of the files that were written."""
        done = self.run(folder)
        assert not done.stdout
        if self.target == "colmap-binary" and not done.status:  # the text says what is in it
            call("convert", f"out/{self.target}", "out/text", "--to", "colmap", folder=folder)
            shutil.rmtree(folder / "out" / self.target)
        return {
            "status": done.status,
            "stderr": list(done.stderr),
            "files": digests(folder / "out"),
        }

    def show(self, folder: Path) -> str:
        """Return what the digests are taken of, to be compared between two versions."""
        self.run(folder)
        files = written(folder / "out")
        return "\n".join(f"== {name}\n{canonical(content)}" for name, content in files.items())


def written(folder: Path) -> dict[str, bytes]:
    """Return the contents of the files in a folder by their paths."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def digests(folder: Path) -> dict[str, str]:
    """Return the digests of the files in a folder; a subfolder of more than `APART` has one."""
    of_folder: dict[str, dict[str, str]] = {}
    for name, content in written(folder).items():
        of_folder.setdefault(Path(name).parent.as_posix(), {})[name] = digest(content)
    found: dict[str, str] = {}
    for parent, each in of_folder.items():
        together = len(each) > APART
        found |= {f"{parent}/": digest(json.dumps(each).encode())} if together else each
    return found


def entries() -> list[str]:
    """Return the names of all entries of the corpus."""
    return [f"{kind}/{path.name}" for kind in TARGETS for path in sorted((CORPUS / kind).iterdir())]


def conversions() -> list[Conversion]:
    """Return all conversions of sound files."""
    found = []
    for entry in entries():
        kind, name = entry.split("/")
        targets = TARGETS[kind] if kind != "cameras" or name in RIGS else TARGETS[kind][:1]
        found += [Conversion(entry, target) for target in targets]
    return found


def damages() -> list[Conversion]:
    """Return the readings of damaged files, and of files with one thing wrong or unusual."""
    made = [
        Conversion(entry, TARGETS[entry.split("/")[0]][0], damage)
        for entry in entries()
        for damage in DAMAGES
    ]
    for kind in ("keypoints", "cameras"):
        for part in PARTICULAR:
            names = sorted(path.name for path in (CORPUS / f"{part}-{kind}").iterdir())
            made += [Conversion(f"{part}-{kind}/{name}", TARGETS[kind][0]) for name in names]
    return made


def as_block(name: str, outcome: dict[str, Any]) -> str:
    """Return the outcome of a damaged file as a paragraph of `messages.txt`."""
    files = [f"wrote {path} {found}" for path, found in outcome["files"].items()]
    lines = [f"exit {outcome['status']}", *map(_shorten, outcome["stderr"]), *files]
    return "\n".join([name, *(f"  {line}" for line in lines)])


def _shorten(line: str) -> str:
    """Return a line in which the list of all formats has its first, its number and its last."""

    def first_and_last(found: re.Match[str]) -> str:
        names = found.group(2).split(", ")
        return f"{found.group(1)}{names[0]}, ... ({len(names)}) ..., {names[-1]}{found.group(3)}"

    return re.sub(r"(one of: )((?:[\w.-]+, ){6,}[\w.-]+)(, found)", first_and_last, line)


def load_expected() -> dict[str, Any]:
    """Return the stored outcomes of conversions."""
    found: dict[str, Any] = json.loads(EXPECTED.read_text("utf-8"))
    return found


def load_messages() -> dict[str, str]:
    """Return the stored paragraphs by the names of their cases."""
    blocks = MESSAGES.read_text("utf-8").strip("\n").split("\n\n")
    return {block.splitlines()[0]: block for block in blocks}
