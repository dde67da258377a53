# `make reports` and `make test` are the whole set-up: both build .venv from environment.lock first.
.DEFAULT_GOAL := help
.PHONY: environment robot reports session test test-long coverage lock bench lab study data calibration simulated digest clean help

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
UV := $(shell command -v uv 2>/dev/null)
PARAMS ?=
ONLY ?=
DIR ?=
FILE ?=
RECIPE ?=
JOBS ?= auto
CORES = $(shell getconf _NPROCESSORS_ONLN)

# Containers set it to stay small; then every process that starts would compile the package's sources anew.
unexport PYTHONDONTWRITEBYTECODE

# One at a time: the second of two commands in a fresh clone waits, and finds it built.
$(VENV)/.stamp: environment.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "trustlab needs Python 3.11 or newer; say which with: make PYTHON=python3.12 ..."; exit 1; }
	@exec 9>.venv.lock; $(PYTHON) -c 'import fcntl; fcntl.flock(9, fcntl.LOCK_EX)'; \
	  { [ $@ -nt environment.lock ] && [ $@ -nt pyproject.toml ]; } || $(MAKE) --no-print-directory environment

# Bytecode is compiled once, as pip does it, and not by several processes at once that import the same packages.
environment:  ## build .venv again from environment.lock
	rm -rf $(VENV)
ifneq ($(UV),)
	$(UV) venv --quiet --python $(PYTHON) $(VENV)
	$(UV) pip install --quiet --compile-bytecode --python $(BIN)/python --no-deps --require-hashes -r environment.lock
	$(UV) pip install --quiet --python $(BIN)/python --no-deps --no-build-isolation -e .
else
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes -r environment.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
endif
	@touch $(VENV)/.stamp

# A chapter is run where its notebook, the package, data or the lock is younger, or parameters are others.
NOTEBOOKS := $(wildcard notebooks/[0-9p][0-9]*_*.ipynb)
CHAPTERS := $(NOTEBOOKS:notebooks/%=docs/%)
SOURCES := $(shell find trustlab data -type f ! -path '*/__pycache__/*' ! -path 'data/external/*')
SOURCES += $(wildcard notebooks/*.py) environment.lock

docs/.parameters: FORCE
	@echo '$(PARAMS)' | cmp -s - $@ || echo '$(PARAMS)' > $@

docs/%.ipynb: notebooks/%.ipynb $(SOURCES) docs/.parameters
	@$(BIN)/python -m trustlab.publishing $< $@ $(PARAMS)

FORCE:

reports: $(VENV)/.stamp  ## run what changed of the notebooks and write the book, reports/index.html (PARAMS="-p name value" passes parameters on)
	$(BIN)/python notebooks/compile_kernels.py
	@rm -f $(filter-out $(CHAPTERS),$(wildcard docs/*.ipynb))
	@$(MAKE) --no-print-directory -k -j $(if $(filter auto,$(JOBS)),$(CORES),$(JOBS)) $(CHAPTERS); done=$$?; \
	  $(BIN)/python -m sphinx -q -W --keep-going -j auto -d reports/.build docs reports && exit $$done
	@echo "the book: reports/index.html"

# A path, spaces and all, as seen from any folder; make's own functions split it.
absolute = "$(if $(filter /%,$(firstword $(1))),,$(CURDIR)/)$(1)"

session: $(VENV)/.stamp  ## a page on a log of your own: make session FILE=run.csv RECIPE=my.toml (PARAMS="-p window 100")
	@[ -n "$(FILE)" ] || { echo "which log? make session FILE=run.csv RECIPE=my.toml"; exit 1; }
	@rm -f reports/my_session.html
	$(BIN)/papermill --cwd notebooks notebooks/00_my_session.ipynb reports/my_session.ipynb \
	  -p session_file $(call absolute,$(FILE)) $(if $(RECIPE),-p recipe $(call absolute,$(RECIPE))) $(PARAMS)
	$(BIN)/jupyter nbconvert --to html --template classic --no-input --embed-images --output my_session.html \
	  --HTMLExporter.jquery_url= --HTMLExporter.require_js_url= --HTMLExporter.mathjax_url= reports/my_session.ipynb
	@echo "the page: reports/my_session.html"

test: $(VENV)/.stamp  ## formatting, linting, types and every test but the long ones
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/python notebooks/compile_kernels.py
	@$(MAKE) --no-print-directory tests/ros/.venv/.stamp || echo "ROS 2 could not be installed; its tests are skipped"
	@npm ci --silent --prefix tests/live/javascript || echo "no npm: the browser's modules are not linted"
	$(BIN)/python -m pytest -n $(JOBS) --dist loadgroup -m "not long"

test-long: $(VENV)/.stamp  ## the tests that take too long for every time
	$(BIN)/python -m pytest -n $(JOBS) --dist loadgroup -m long

coverage: $(VENV)/.stamp  ## the same tests, and which lines of the package they run; fails below the floor in pyproject.toml
	$(BIN)/python notebooks/compile_kernels.py
	$(BIN)/python -m pytest -n $(JOBS) --dist loadgroup -m "not long" --cov --cov-report=term-missing:skip-covered

bench: $(VENV)/.stamp  ## benchmarks beside the peers, and their page in the book (ONLY=campaign runs one)
	@$(MAKE) --no-print-directory benchmarks/.venv/.stamp || echo "peers could not be installed; see above"
	$(BIN)/python -m benchmarks $(ONLY)

# Environments beside the package's: the peers of benchmarks, and ROS 2 for its tests.
%/.venv/.stamp: %/environment.lock
	rm -rf $*/.venv
ifneq ($(UV),)
	$(UV) venv --quiet --python $(PYTHON) $*/.venv
	$(UV) pip install --quiet --python $*/.venv/bin/python --no-deps --require-hashes -r $*/environment.lock
else
	$(PYTHON) -m venv $*/.venv
	$*/.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes -r $*/environment.lock
endif
	@touch $@

robot: $(VENV)/.stamp tests/ros/.venv/.stamp  ## drive a simulated robot over ROS 2 for two minutes and draw its chapter (DIR=runs says where)
	$(BIN)/python -m tests.ros.driving $(DIR)

lab: $(VENV)/.stamp  ## JupyterLab in notebooks/
	$(BIN)/jupyter lab --notebook-dir=notebooks

study: $(VENV)/.stamp  ## serve the live study in a folder: make study DIR=mystudy (PARAMS="--enrol" passes options on)
	@[ -n "$(DIR)" ] || { echo "which study? make study DIR=mystudy"; exit 1; }
	$(BIN)/python -m trustlab.live.study "$(DIR)" $(PARAMS)

data: $(VENV)/.stamp  ## write data/sessions/ again from its seeds
	$(BIN)/python data/sessions/make_sessions.py

calibration: $(VENV)/.stamp  ## simulate the studies behind data/calibration/ again; goes on where it was stopped
	$(BIN)/python data/calibration/make_calibration.py

simulated: $(VENV)/.stamp  ## make the simulations again that the reports only read, data/simulated/
	$(BIN)/python data/simulated/make_simulated.py

digest: $(VENV)/.stamp  ## compare results of public functions on this machine with the stored ones
	$(BIN)/python data/digests/make_digests.py

lock:  ## resolve environment.lock again (needs uv)
	uv pip compile pyproject.toml --all-extras --group dev --universal --python-version 3.11 \
	  --generate-hashes --no-annotate --no-header --no-emit-index-url -o environment.lock

clean:  ## remove the environment, the caches and what was generated
	rm -rf $(VENV) benchmarks/.venv tests/ros/.venv .pytest_cache .ruff_cache .mypy_cache .hypothesis
	find reports -mindepth 1 -maxdepth 1 ! -name README.md ! -name figures -exec rm -rf {} +
	rm -rf docs/api docs/.parameters docs/*.ipynb
	find trustlab tests benchmarks data notebooks docs -name __pycache__ -prune -exec rm -rf {} +

help:  ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-12s %s\n", $$1, $$2 }' Makefile
