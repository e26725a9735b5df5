# Set-up, demo, tests and checks, from a bare Debian 12 or Ubuntu 24.04 with python3, make and git.

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.ONESHELL:
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help
.PHONY: help setup system demo test check bench figures fuzz docs wheel clean

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Written last, so that a set-up that was cut short starts again: what the demo needs is there; and everything else.
TRY := $(VENV)/.try
READY := $(VENV)/.ready
TRIED := synth,report
EXTRAS := $(TRIED),bodies,rig,clouds,train,gui,benchmark,colour,cluster,exchange,foxglove,realsense,kinect,orbbec,docs,dev

# Python keeps what it has compiled, whatever the caller's environment wants: it saves every process of a test that.
export PYTHONDONTWRITEBYTECODE :=

# PCL and a compiler for the extension.
PACKAGES := python3-venv python3-dev g++ cmake ninja-build pkg-config libpcl-dev libgomp1
# Mesa for rendering without a screen; what Qt asks of X.
WINDOW := libgl1 libegl1 libxcb-cursor0 libxkbcommon-x11-0 libxcb-icccm4 libxcb-keysyms1 libxcb-image0 \
	libxcb-render-util0 libxcb-xinerama0 libxcb-shape0
# A screen for the window's tests, and a browser for the report's; the last is skipped where there is none
# (Ubuntu has it only as a snap). libturbojpeg0 mirrors the colour of a Kinect v2 without loss.
OPTIONAL := xvfb chromium libturbojpeg0

help:
	@echo "make demo    set up what it needs, then run the whole path on the virtual rig into demo-out/"
	echo "make test    set up, then run the tests"
	echo "make check   set up, then run the linters, the types and the import contracts"
	echo "make bench   set up, then run the benchmarks"
	echo "make figures measure what the documentation claims on the seed of the commit, and write it there (ONLY=, AGAIN=1, SEED=)"
	echo "make fuzz    set up, then fuzz every reader of files for SECONDS (60)"
	echo "make docs    set up, then build the documentation into docs/_build"
	echo "make wheel   set up, then build a wheel that carries its libraries, into dist/"
	echo "make setup   system packages, .venv, pinned Python packages, the native extension, compiled kernels"
	echo "make clean   remove what was built and cached, but not .venv"

setup: $(READY)

SOURCES := Makefile pyproject.toml constraints.txt CMakeLists.txt annotate/cpp/pcl.cpp

# The packages of these extras, the extension and its kernels.
define set-up
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
		echo "$$($(PYTHON) --version) is too old; annotate-cloud needs 3.11 or newer:" \
			"name one, as in 'make setup PYTHON=python3.12'" >&2
		exit 1
	}
	[ -x $(BIN)/pip ] || $(PYTHON) -m venv $(VENV)
	echo "installing Python packages into $(VENV)"
	$(BIN)/pip install --quiet --constraint constraints.txt scikit-build-core nanobind
	$(BIN)/pip install --quiet --constraint constraints.txt --no-build-isolation --editable '.[$(1)]'
	$(BIN)/annotate-cloud compile
endef

# Gigabytes less than the rest, so that the first try does not wait for them.
$(TRY): $(SOURCES)
	@$(MAKE) --no-print-directory system
	$(call set-up,$(TRIED))
	touch $@

$(READY): $(SOURCES)
	@$(MAKE) --no-print-directory system WANTED="$(WINDOW)"
	$(call set-up,$(EXTRAS))
	touch $(TRY) $@

# Asks apt for nothing, and needs no network, where everything is there already.
system:
	@installed() { [ "$$(dpkg-query -Wf '$${db:Status-Status}' "$$1" 2>/dev/null)" = installed ]; }
	command -v apt-get >/dev/null || { echo "no apt-get here; needed: $(PACKAGES)" >&2; exit 0; }
	missing=(); for package in $(PACKAGES) $(WANTED); do
		installed $$package || missing+=($$package)
	done
	[ $${#missing[@]} -gt 0 ] || exit 0
	root=(env DEBIAN_FRONTEND=noninteractive); [ "$$(id -u)" = 0 ] || root=(sudo "$${root[@]}")
	echo "installing system packages: $${missing[*]}"
	"$${root[@]}" apt-get update -qq
	found=(); for package in "$${missing[@]}"; do
		[[ " $(OPTIONAL) " == *" $$package "* && -z "$$(apt-cache search --names-only "^$$package$$")" ]] ||
			found+=($$package)
	done
	[ $${#found[@]} -gt 0 ] || exit 0
	# Hundreds of small packages: without a flush after every file it takes half the time.
	"$${root[@]}" apt-get install -qq --yes --no-install-recommends \
		-o Dpkg::Options::=--force-unsafe-io "$${found[@]}" >/dev/null

demo: $(TRY)
	$(BIN)/annotate-cloud demo --out demo-out --overwrite

test: $(READY)
	@$(MAKE) --no-print-directory system WANTED="$(WINDOW) $(OPTIONAL)"
	# The tests fill the cores by processes: BLAS threads beside them cost several times the work.
	# Each starts with one half, in order, so that tests that share something follow each other; the one that
	# is done first takes over from the other's end.
	OMP_NUM_THREADS=1 $(BIN)/pytest -n 2 --dist worksteal

check: $(READY)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m tools.style
	$(MAKE) --no-print-directory docs

docs: $(READY)
	$(BIN)/sphinx-build --quiet --fail-on-warning --jobs auto docs docs/_build

bench: $(READY)
	$(BIN)/python -m bench.all

# Tables by name, and the seed; both optional. An interrupted run goes on.
figures: $(READY)
	$(BIN)/python -m tools.figures.run $(if $(SEED),--seed $(SEED)) $(if $(AGAIN),--again) $(if $(ONLY),--only $(ONLY))

SECONDS ?= 60
fuzz: $(READY)
	$(BIN)/pip install --quiet --constraint constraints.txt 'atheris>=3'
	$(BIN)/python -m tools.fuzz.run "" $(SECONDS)

wheel: $(READY)
	rm -rf build/wheel
	$(BIN)/pip wheel --quiet --no-deps --no-build-isolation --wheel-dir build/wheel .
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/auditwheel repair --wheel-dir dist build/wheel/*.whl

clean:
	rm -rf build dist docs/_build docs/api docs/command.md .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -not -path './$(VENV)/*' -prune -exec rm -rf {} +
