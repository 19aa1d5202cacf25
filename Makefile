# Every target makes its own virtual environment: Python and pip are all that a machine needs.
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

demo: $(VENV)/.run  ## install, then calibrate the paper's robot from its sample log
	$(BIN)/mobilecal calibrate sample_logs/paper_robot.mcap --output $(DEMO) --force

test: $(VENV)/.dev  ## install, then run every test
	$(BIN)/python -m pytest -n 2 --dist loadfile -m 'not slow and not pages and not long'

long: $(VENV)/.dev  ## whole commands that take long
	$(BIN)/python -m pytest -n 2 -m long

pages: $(VENV)/.dev  ## every command of the tutorial and the how-to pages
	$(BIN)/python -m pytest -n 2 -m pages

slow: $(VENV)/.dev  ## long studies: Monte Carlo, fuzzing at length
	$(BIN)/python -m pytest -n 2 --dist loadfile -m slow

bench: $(VENV)/.dev  ## docs/explanation/performance.md, measured anew: 40 minutes or more
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	$(BIN)/python -m tests.bench

studies: $(VENV)/.dev  ## the tables of docs/explanation/results.md, made anew: hours
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	$(BIN)/python -m tests.bench.studies

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.dev
	$(BIN)/mypy

layers: $(VENV)/.dev
	$(BIN)/lint-imports

check: lint types layers test  ## what must be clean before a commit

logs: $(VENV)/.run  ## rebuild sample_logs/ from their seeds
	$(BIN)/python -m mobilecal_cli.simulate.samples sample_logs

docs: $(VENV)/.dev  ## the parts of docs/ that are made out of the code, then the pages; a warning is an error
	$(BIN)/python docs/generate/errors.py
	$(BIN)/python docs/generate/options.py
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build/html

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis $(DEMO)
