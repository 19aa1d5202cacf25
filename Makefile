# Each target creates the virtual environment it needs; only Python and pip are required.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
DEMO := demo_calibration

.PHONY: demo test long pages check lint types layers logs docs slow bench studies clean

$(VENV)/.run: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	touch $@

$(VENV)/.dev: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@ $(VENV)/.run

demo: $(VENV)/.run  ## install, then calibrate the robot of the paper from its sample recording
	$(BIN)/mobilecal calibrate sample_logs/paper_robot.mcap --output $(DEMO) --force

test: $(VENV)/.dev  ## install, then run the tests
	$(BIN)/python -m pytest -n 2 --dist loadfile -m 'not slow and not pages and not long'

long: $(VENV)/.dev  ## tests that take long
	$(BIN)/python -m pytest -n 2 -m long

pages: $(VENV)/.dev  ## run all commands of the tutorial and the how-to pages
	$(BIN)/python -m pytest -n 2 -m pages

slow: $(VENV)/.dev  ## long studies: Monte Carlo, fuzzing
	$(BIN)/python -m pytest -n 2 --dist loadfile -m slow

bench: $(VENV)/.dev  ## measure docs/validation/performance.md again: 40 minutes or more
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	$(BIN)/python -m tests.bench

studies: $(VENV)/.dev  ## compute the tables of docs/validation/results.md again: hours
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	$(BIN)/python -m tests.bench.studies

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python -m tests.words

types: $(VENV)/.dev
	$(BIN)/mypy

layers: $(VENV)/.dev
	$(BIN)/lint-imports

check: lint types layers test  ## checks that must pass before a commit

logs: $(VENV)/.run  ## generate sample_logs/ again from their seeds
	$(BIN)/python -m tests.samples sample_logs

docs: $(VENV)/.dev  ## generate the pages made from the code, then build all pages; warnings are errors
	$(BIN)/python docs/generate/errors.py
	$(BIN)/python docs/generate/options.py
	$(BIN)/python docs/generate/refusals.py
	$(BIN)/python docs/generate/schema.py
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build/html

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis $(DEMO)
