# make run    set up, then gate the shipped policy on the hurdles suite: the main job
# make test   set up, then every check and every test
# make check  formatting, lint, types, the imports between packages, and the words of code and pages
# make bench  the benchmark tables (minutes; on an idle machine)
# make leaderboard  pages of the shipped policies on hurdles, to publish (minutes)
# make docs   the docs site, in site/; `make docs-serve` shows it while you write
# make build  wheel and source archive, checked, and a smoke run of the wheel on its own

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
export OMP_NUM_THREADS := 1
# Every trial's process and some hundred of the tests import the package: compiled once, not each time.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: run test check lint types imports words warm bench leaderboard docs docs-serve build
.DEFAULT_GOAL := run

run: $(VENV)/.installed
	@$(BIN)/nw-eval run suites/hurdles.yaml; code=$$?; \
	echo "nw-eval is installed in $(VENV): \`source $(BIN)/activate\`, then \`nw-eval --help\`"; exit $$code

# Types are checked by one core while the other compiles the kernels: those of the splats by `warmup`, those of
# reconstruction and calibration, which few users need, by a test of each kind. Files of tests keep their order: xdist
# would run those of one long test last, when the other core has nothing left to do. Many tests wait, for a process or a
# limit of time: there is a worker more than cores, where memory allows it; a worker takes up to 4 GB.
WORKERS := import os; most = os.sysconf('SC_PHYS_PAGES') * os.sysconf('SC_PAGE_SIZE') // 4_000_000_000; \
  print(max(1, min(os.cpu_count() + 1, most)))
test: $(VENV)/.installed-dev
	$(MAKE) -j 2 --output-sync=target check warm
	$(BIN)/pytest -n $$($(BIN)/python -c "$(WORKERS)") --dist loadscope --no-loadscope-reorder $(PYTEST_ARGS)

check: types lint imports words

types: $(VENV)/.installed-dev
	$(BIN)/pyright --pythonpath $(BIN)/python

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check

imports: $(VENV)/.installed-dev
	$(BIN)/lint-imports

words: $(VENV)/.installed-dev
	$(BIN)/pytest -q -p no:cacheprovider tests/test_words.py

KERNEL_TESTS := tests/twin/calibrate/test_features.py::test_of_two_alike_neither_is_a_match \
  tests/twin/reconstruct/test_reconstruct.py::test_what_a_mask_hides_is_not_known

warm: $(VENV)/.installed-dev
	$(BIN)/nw-eval warmup
	$(BIN)/pytest -q $(KERNEL_TESTS)

bench: $(VENV)/.installed-dev
	$(BIN)/nw-eval warmup
	@missed=; for script in tests/bench/bench_*.py; do \
	  echo "== $$script"; $(BIN)/python $$script || missed="$$missed $$script"; \
	done; test -z "$$missed" || { echo "targets missed in:$$missed"; exit 1; }

# What has not changed since is taken over from the cache. The suite's own policy is the latest run: the badge shows it.
LEADERBOARD := build/leaderboard
BOARD_POLICIES := stand go1-parkour go1-act-depth go1-act-rgb-ray go1-act-rgb

leaderboard: $(VENV)/.installed
	for policy in $(BOARD_POLICIES); do \
	  rm -rf $(LEADERBOARD)-runs/$$policy; \
	  $(BIN)/nw-eval run suites/hurdles.yaml --policy $$policy --baseline none --trials 4 --record none \
	    --out $(LEADERBOARD)-runs/$$policy; code=$$?; \
	  case $$code in 0|1|3) ;; *) exit $$code;; esac; \
	done
	$(BIN)/nw-eval report --site $(LEADERBOARD) --title "Shipped policies on hurdles" $(LEADERBOARD)-runs/*

EXAMPLE := build/example
# A warning is an error (`strict` of mkdocs.yml). The variable silences the theme's note on its successor, Zensical.
docs docs-serve: export NO_MKDOCS_2_WARNING = 1
docs: $(VENV)/.installed-docs $(EXAMPLE)/report.html
	$(BIN)/mkdocs build

# Pages of real runs that the site shows. Their verdicts are no errors: 1 is REGRESSED, 3 INCONCLUSIVE.
EXAMPLE_POLICIES := go1-parkour go1-act-rgb stand
$(EXAMPLE)/report.html: $(VENV)/.installed
	rm -rf $(EXAMPLE) $(EXAMPLE)-runs
	$(BIN)/nw-eval run gaps --policy go1-act-rgb --baseline go1-parkour --out $(EXAMPLE)-runs/report; \
	  code=$$?; case $$code in 0|1|3) ;; *) exit $$code;; esac
	for policy in $(EXAMPLE_POLICIES); do \
	  $(BIN)/nw-eval run gaps --policy $$policy --baseline none --trials 2 --record none \
	    --out $(EXAMPLE)-runs/policies/$$policy; code=$$?; \
	  case $$code in 0|1|3) ;; *) exit $$code;; esac; \
	done
	$(BIN)/nw-eval report --site $(EXAMPLE)/leaderboard --title "Shipped policies on gaps" $(EXAMPLE)-runs/policies/*
	cp $(EXAMPLE)-runs/report/report.html $@

docs-serve: $(VENV)/.installed-docs $(EXAMPLE)/report.html
	$(BIN)/mkdocs serve --livereload --no-strict

build: $(VENV)/.installed-dev
	rm -rf dist
	$(BIN)/python -m build --no-isolation --sdist --wheel --outdir dist
	for package in $(patsubst %/pyproject.toml,%,$(wildcard harness/*/pyproject.toml)); do \
	  $(BIN)/python -m build --no-isolation --wheel --outdir dist $$package || exit; \
	done
	$(BIN)/twine check --strict dist/*
	$(BIN)/python tests/smoke_wheel.py dist

$(BIN)/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "nw-eval needs Python 3.11 or newer, this is " + sys.version.split()[0] + "; run make PYTHON=python3.12")'
	$(PYTHON) -m venv $(VENV)

# numba first: the kernels compile while pip brings the rest, since both take one core. Of what the tests need, torch
# first and alone: the pinned CPU build satisfies every later requirement. Python compiles what is imported, once; compiling all of it ahead takes
# ten seconds of a core. Kernels that could not be compiled here are at the first use, which says why.
PIP := $(BIN)/pip install -q --no-compile --disable-pip-version-check
# All packages in one call: pip takes a path that is given for what another one needs. Hatchling is there first, so
# that it is not installed anew for each of them.
PACKAGES := $(addprefix -e harness/nw_,base splat gate twin learn)
PIP_HERE := $(PIP) --no-build-isolation -c constraints.txt $(PACKAGES)
WARM_UP := from nw_sim.warmup import warmup; warmup()
$(VENV)/.installed: $(BIN)/python pyproject.toml $(wildcard harness/*/pyproject.toml) constraints.txt
	$(PIP) -c constraints.txt numba numpy pydantic hatchling
	PYTHONPATH=harness $(BIN)/python -c '$(WARM_UP)' >/dev/null 2>&1 & \
	  $(PIP_HERE) -e .; code=$$?; wait; exit $$code
	touch $@

$(VENV)/.installed-docs: $(VENV)/.installed
	$(PIP_HERE) -e '.[docs]'
	touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(PIP) torch==$(shell sed -n 's/^torch==//p' constraints.txt)
	$(PIP_HERE) -e '.[dev]'
	touch $@
