# Two commands for a fresh machine: `make demo` and `make test`. Both make the environment in .venv first.
# Everything is installed in the versions of constraints.txt, and torch without CUDA (.ci/check_torch.py).

PYTHON ?= python3
BIN := .venv/bin
WORKERS := -n 2 --dist loadfile --no-loadscope-reorder  # the scenes of a file are made once
# what is used is compiled when it is used: that is a small part of what is installed. It is kept also
# where the environment says otherwise: compiling takes several seconds of every process
export PYTHONDONTWRITEBYTECODE :=
INSTALL := $(BIN)/pip install --disable-pip-version-check --no-compile -c constraints.txt

.PHONY: demo test test-quick coverage fuzz lint benchmark docs cli-docs web clean

demo: .venv/installed
	@echo "== three people, four cameras, nobody knows who is who =="
	$(BIN)/mocap-calib run examples/three_people/keypoints --cameras examples/three_people/intrinsics.toml -o out/demo
	@echo "== compared with the truth of the simulation =="
	$(BIN)/mocap-calib evaluate out/demo/cameras.yaml --reference examples/three_people/reference.toml
	@echo "== the results are in out/demo =="
	@ls out/demo

test: .venv/tested
	$(BIN)/python -m pytest $(WORKERS) --durations=10

test-quick: .venv/tested
	$(BIN)/python -m pytest $(WORKERS) -m "not slow"

# lines and branches that the tests reach; kernels do not count (pyproject.toml)
coverage: .venv/tested
	$(BIN)/python -m coverage erase
	$(BIN)/python -m coverage run -m pytest $(WORKERS)
	$(BIN)/python -m coverage combine -q
	$(BIN)/python -m coverage report

# damaged files of each of the formats
FUZZ_FILES ?= 50000
FUZZ_LOG ?= /tmp/mocap-calib-fuzz
fuzz: .venv/tested
	$(BIN)/python benchmarks/fuzz.py $(FUZZ_LOG) --files $(FUZZ_FILES)

lint: .venv/tested
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# MOCAP_CALIB_RECORDINGS says where the recordings are
benchmark: .venv/installed
	$(BIN)/python benchmarks/recordings.py

# the pages of docs/ as a site; warnings are errors
docs: .venv/tested
	$(BIN)/zensical build --clean --strict

cli-docs: .venv/installed
	$(BIN)/python docs/make_cli.py

# the program of report.html; node is needed for this alone, since what it makes is committed
web:
	cd web && npm ci --silent --no-audit --no-fund && npm run --silent check && npm run --silent build

.venv/installed: setup.cfg constraints.txt
	@echo "== making the environment in .venv (a minute or two) =="
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@$(BIN)/python .ci/check_torch.py
	$(INSTALL) -e .
	@$(BIN)/python -c "from mocap_calib.kernels.jit import compile_ahead; compile_ahead()"
	@touch $@

.venv/tested: .venv/installed
	$(INSTALL) -e ".[test]"
	@touch $@

clean:
	rm -rf .venv out build dist site *.egg-info
