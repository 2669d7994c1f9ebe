# Every target sets up .venv first. ARGS are passed on: make train ARGS="seed=1 actor=gru_mog"
# PIP_ARGS go to the installation of torch: with the index of its CPU builds, no GPU libraries come.
PYTHON ?= python3.11
PIP_ARGS ?=
VENV := .venv
RUN := $(VENV)/bin/python
READY := $(VENV)/.ready
export RL_LOGGING_LEVEL ?= WARNING
export NO_MKDOCS_2_WARNING ?= 1

.PHONY: setup train test long-test slow-test lint docs bench playground clean

setup: $(READY)

$(READY): pyproject.toml setup.py constraints.txt
	@command -v $(PYTHON) >/dev/null || { echo "python 3.11 or 3.12 must be on the PATH, or say which: make PYTHON=..."; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(RUN) -m pip install --quiet --constraint constraints.txt $(PIP_ARGS) torch
	$(RUN) -m pip install --quiet --constraint constraints.txt --editable ".[dev]"
	@touch $@

train: $(READY)
	$(RUN) -m recipes.train $(ARGS)

test: $(READY)
	$(RUN) -m pytest --numprocesses auto --maxprocesses 4 --dist worksteal $(ARGS)

long-test: $(READY)
	$(RUN) -m pytest -m 'long and not slow' --numprocesses auto --maxprocesses 4 --dist worksteal $(ARGS)

slow-test: $(READY)
	$(RUN) -m pytest -m slow -s $(ARGS)

lint: $(READY)
	$(RUN) -m ruff check .
	$(RUN) -m ruff format --check .
	$(RUN) -m mypy
	$(VENV)/bin/lint-imports

docs: $(READY)
	$(RUN) -m mkdocs build --strict $(ARGS)
	@if [ -f build/playground/robot.json ]; then cp -r build/playground site/playground; fi

bench: $(READY)
	$(RUN) -m recipes.bench $(ARGS)

playground: $(READY)
	$(RUN) -m recipes.playground out=build/playground $(ARGS)

clean:
	rm -rf $(VENV) build dist site *.egg-info .pytest_cache .mypy_cache .ruff_cache
