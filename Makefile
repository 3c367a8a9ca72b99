# make run    reproduces the paper's tables, then simulates a recording and identifies it
# make test   runs the tests, compiled quickly
# make nightly  runs all of them, slow ones too, compiled as for users
# Each builds .venv first. PYTHON=python3.12 picks another interpreter.

PYTHON ?= python3
BIN := .venv/bin
OUT := out

.DELETE_ON_ERROR:
.PHONY: run test nightly setup lint format docs notebooks bench bench-check bench-check-motion bench-check-estimates calibrate clean

run: .venv/installed
	$(BIN)/riecjax reproduce --out $(OUT)/reproduce
	$(BIN)/riecjax simulate quarter-car-source --input white-noise --seed 1 --out $(OUT)/drive.csv
	$(BIN)/riecjax identify $(OUT)/drive.csv --model quarter-car --out $(OUT)/identify

test: .venv/installed
	$(BIN)/python -m pytest -n 2 --dist worksteal --durations=10

nightly: .venv/installed
	RIECJAX_TESTS=production $(BIN)/python -m pytest -n 2 --dist worksteal --durations=10 -m "slow or not slow"

setup: .venv/installed

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'riecjax needs Python 3.11 or newer; try make PYTHON=python3.12')"
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --constraint constraints.txt --editable '.[dev]'
	-$(BIN)/python -m compileall -qq -j 0 .venv/lib
	touch $@

lint: .venv/installed
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright

format: .venv/installed
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

docs: .venv/installed
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

notebooks: .venv/installed
	$(BIN)/python notebooks/run.py

bench: .venv/bench
	$(BIN)/python -m benchmarks.speed
	$(BIN)/python -m benchmarks.speed --page

# With `make -j 2` what uses one core beside each other; all windows, which use both, alone after it.
bench-check: bench-check-motion bench-check-estimates
	$(BIN)/python -m benchmarks.speed --small --check --only all_windows
	$(BIN)/python -m benchmarks.speed instant --check

bench-check-motion: .venv/bench
	$(BIN)/python -m benchmarks.speed --small --check --only simulation

bench-check-estimates: .venv/bench
	$(BIN)/python -m benchmarks.speed --small --check --only estimation

.venv/bench: .venv/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev,bench]'
	touch $@

calibrate: .venv/installed
	$(BIN)/python -m benchmarks.paper reconstruct_curves

clean:
	rm -rf .venv .cache $(OUT) site
