"""What the command says of mistakes: one line, the same as in `messages.txt`, and no file."""

import pytest
from golden.cases import as_block, load_messages
from golden.refusals import REFUSALS, lay_out, outcome

MESSAGES = load_messages()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The files that the commands name."""
    place = tmp_path_factory.mktemp("refusals")
    lay_out(place)
    return place


@pytest.mark.parametrize("name", REFUSALS)
def test_a_mistake_is_refused_as_before(name, folder):
    found = outcome(name, folder)
    assert found["status"] in (1, 2), "a mistake of the data, or of the command line"
    assert len(found["stderr"]) == 1, "a refusal is one line"
    assert found["stderr"][0].startswith(("mocap-calib: ", "Error: "))
    assert not found["files"], "nothing is written"
    assert as_block(name, found) == MESSAGES[name], "see tests/golden/make.py"
