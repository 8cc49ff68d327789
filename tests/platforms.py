"""What tests need of the system they run on; where it is not there they say so and are skipped."""

import os
import sys

import pytest

posix = pytest.mark.skipif(os.name != "posix", reason="needs the signals and processes of POSIX")
linux = pytest.mark.skipif(sys.platform != "linux", reason="needs limits of memory, as Linux has")
