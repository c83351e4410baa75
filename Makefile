# Two commands for a new machine: `make demo` and `make test`. Each creates .venv, installs the pinned
# versions and runs; neither needs root.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/installed
PYTEST_ARGS ?=
# Many tests wait for a board or a camera: four workers keep two cores busy.
WORKERS ?= 4
# The long tests load the processor more, but a third of their time they wait for boards, too.
SLOW_WORKERS ?= 4

# The programs that tests start must not compile the modules again each time.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test quick slow lint docs install clean genicam-1.5

demo: $(STAMP)
	$(BIN)/sgp demo --out demo

# Without its cache mypy takes a minute on one core, so the tests run beside it.
test: $(STAMP)
	@$(MAKE) --no-print-directory --jobs=2 --keep-going lint quick

# All but the long tests. A file stays with one worker: its tests share fixtures.
quick: $(STAMP)
	$(BIN)/pytest -m "not slow" -n $(WORKERS) --dist loadfile $(PYTEST_ARGS)

# The long tests: mutants, random command series, whole tables, faults of rig and disk.
slow: $(STAMP)
	$(BIN)/pytest -m slow -n $(SLOW_WORKERS) --dist worksteal $(PYTEST_ARGS)

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The site of the documents; open docs/_build/html/index.html.
docs: $(VENV)/docs-installed
	$(BIN)/python -m sphinx -W --keep-going -q docs docs/_build/html

$(VENV)/docs-installed: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[docs]"
	touch $@

install: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev]"
	touch $@

# A GenTL producer from another project, for the camera tests, which find it through SGP_GENICAM_1_5.
genicam-1.5: $(STAMP)
	$(BIN)/python -m pip download --quiet --disable-pip-version-check --no-deps --dest $(VENV)/wheels genicam==1.5.0

clean:
	rm -rf $(VENV) demo docs/_build docs/generated .mypy_cache .ruff_cache .pytest_cache .hypothesis
