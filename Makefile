# What people, hooks and continuous integration call. Each target does its own set-up; `make` alone lists them.
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.NOTPARALLEL:
MAKEFLAGS += --no-print-directory

VENV := .venv
PY := $(VENV)/bin/python
ARGS :=
# Compilers take up to 1 GB each: more than four at a time helps nobody.
export CMAKE_BUILD_PARALLEL_LEVEL ?= $(shell n=$$(nproc 2>/dev/null || echo 2); echo $$((n < 4 ? n : 4)))
export PYTHON

READY := $(VENV)/ready.stamp
NATIVE := $(VENV)/native.stamp
VALIDATOR := $(VENV)/validator.stamp
BROWSER := $(VENV)/browser.stamp
SAMPLES := sample_assets/made.stamp
CXX_SOURCES := $(wildcard lodpipe/kernel/src/* lodpipe/kernel/src/*/*) lodpipe/kernel/CMakeLists.txt
SITE = $(shell $(PY) -c 'import sysconfig; print(sysconfig.get_path("platlib"))')
SANITIZE_BUILD = build/sanitize-$(SANITIZE)
COMMA := ,

.PHONY: help demo demo-watch soak test test-all test-sanitize lint format stubs bench skeletons thesis all setup kernel clean distclean

help:  ## this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /\1\t/' | expand -t 16

demo: $(NATIVE) $(SAMPLES)  ## makes the sample models, then four levels and a report of one of them, in out/demo
	@$(VENV)/bin/lodpipe run sample_assets/animal.glb -c default -o out/demo --force
	@echo "demo: look into out/demo/animal (report.html, LOD0, LOD1 …)"

demo-watch: $(NATIVE) $(SAMPLES)  ## starts the daemon, drops three models into its folder, shows what it does, stops it
	@PATH="$(abspath $(VENV))/bin:$$PATH" setup/demo-watch.sh out/demo-watch

test: $(NATIVE) $(SAMPLES) $(VALIDATOR) $(BROWSER)  ## the everyday tests; ARGS='-k name' goes to pytest
	@$(PY) -m pytest $(ARGS)

test-all: $(NATIVE) $(SAMPLES) $(VALIDATOR) $(BROWSER)  ## all tests, the slow ones too (packaging, big models)
	@$(PY) -m pytest -m "slow or not slow" $(ARGS)

lint: $(NATIVE)  ## ruff, mypy (strict), import direction, freshness of the kernel's type stub
	@echo "lint: ruff" && $(VENV)/bin/ruff check --quiet . && $(VENV)/bin/ruff format --check --quiet .
	@echo "lint: mypy" && $(VENV)/bin/mypy --no-error-summary lodpipe plugins sample_assets $(wildcard docs/*.py)
	@echo "lint: imports" && $(PY) -m pytest -q tests/test_imports.py
	@echo "lint: stub of the kernel" && mkdir -p build && $(call stub,build/_native.pyi) && \
		diff -u lodpipe/kernel/_native.pyi build/_native.pyi || { echo "lint: stale; run: make stubs"; exit 1; }

format: $(READY)  ## rewrite the Python files as ruff wants them
	@$(VENV)/bin/ruff check --quiet --fix . && $(VENV)/bin/ruff format --quiet .

stubs: $(NATIVE)  ## write lodpipe/kernel/_native.pyi anew from the compiled kernel
	@$(call stub,lodpipe/kernel/_native.pyi)

bench: $(NATIVE)  ## time and quality beside the peers; ARGS go to tests/benchmarks/run.py
	@$(PY) tests/benchmarks/run.py $(ARGS)

soak: $(NATIVE)  ## the daemon's figures: 1,000 assets, 200 kills, 30 minutes of everything; ARGS='soak --seconds 300'
	@$(PY) tests/benchmarks/daemon.py $(ARGS)

skeletons: $(NATIVE) $(SAMPLES)  ## skeletons, segments and extreme levels as pictures and tables, in out/skeletons
	@$(PY) docs/make_skeletons.py -o out/skeletons $(ARGS)

thesis: $(NATIVE) $(SAMPLES)  ## tables and pictures of docs/thesis.md; ARGS: untextured models to stripe and measure, too
	@$(PY) docs/make_thesis.py $(ARGS)

all: lint test-all demo  ## lint, all tests, the demo

setup: $(NATIVE)  ## the environment alone, kernel included

kernel:  ## compile what changed in the kernel; SANITIZE=address or thread: with sanitizers, aside
ifdef SANITIZE
kernel: $(SANITIZE_BUILD)/build.ninja
	@$(VENV)/bin/cmake --build $(SANITIZE_BUILD) -- --quiet
else
kernel: $(READY)
	@$(compile)
endif

test-sanitize: SANITIZE := $(or $(SANITIZE),address)
test-sanitize:  ## the kernel's tests with the address and undefined-behaviour sanitizers; SANITIZE=thread: for races
	@$(MAKE) kernel SANITIZE=$(SANITIZE)
	@ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1 \
	LD_PRELOAD="$$($(CXX) -print-file-name=lib$(if $(filter thread,$(SANITIZE)),tsan,asan).so) $$($(CXX) -print-file-name=libstdc++.so)" \
	LODPIPE_TEST_KERNEL=$$(echo $(SANITIZE_BUILD)/_native.*.so) $(PY) -m pytest --capture=sys tests/kernel $(ARGS)

clean:  ## remove what was built and written, not the environment
	rm -rf build dist out .pytest_cache .mypy_cache .ruff_cache .hypothesis $(SAMPLES) sample_assets/*.glb $(READY)

distclean: clean  ## remove the environment too
	rm -rf $(VENV) tests/io/validator/node_modules

# --- how it is done

compile = $(VENV)/bin/cmake --build build/dev -- --quiet && \
	$(VENV)/bin/cmake --install build/dev --prefix $(SITE) >/dev/null && touch $(NATIVE)

stub = $(PY) -m nanobind.stubgen -q -m lodpipe.kernel._native -o $(1)

$(READY): pyproject.toml setup/environment.sh setup/debian.sh
	@setup/environment.sh $(VENV)
	@touch $@

$(NATIVE): $(READY) $(CXX_SOURCES)
	@$(compile)

$(SANITIZE_BUILD)/build.ninja: $(READY) lodpipe/kernel/CMakeLists.txt
	@$(VENV)/bin/cmake -S lodpipe/kernel -B $(SANITIZE_BUILD) -G Ninja -DCMAKE_MAKE_PROGRAM=$(abspath $(VENV))/bin/ninja \
		-DCMAKE_BUILD_TYPE=RelWithDebInfo -DLODPIPE_SANITIZE=$(SANITIZE:address=address$(COMMA)undefined) -DPython_EXECUTABLE=$(abspath $(PY)) \
		-Dnanobind_DIR=$$($(PY) -m nanobind --cmake_dir) >/dev/null

$(SAMPLES): $(wildcard sample_assets/*.py) | $(NATIVE)
	@echo "samples: making the models in sample_assets"
	@$(PY) sample_assets/make.py
	@touch $@

# The Khronos validator needs Node.js; without it the tests that use it say so and are skipped.
$(VALIDATOR): $(READY) $(wildcard tests/io/validator/package.json)
	@if command -v npm >/dev/null && [ -e tests/io/validator/package.json ]; then \
		echo "setup: installing the glTF validator (npm)"; \
		npm install --prefix tests/io/validator --no-package-lock --no-audit --no-fund --silent || echo "setup: npm failed; its tests are skipped"; \
	fi
	@touch $@

$(BROWSER): $(READY) setup/browser.sh setup/debian.sh
	@setup/browser.sh
	@touch $@
