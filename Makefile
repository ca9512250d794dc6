# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
#
# Sets everything up on first use. `make` alone tells what there is.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory

PYTHON ?= python3
SCENE ?= harmonic_oscillator
DURATION ?= 20
ARGS ?=
OUT ?= docs
# Nobody else's graph is disturbed unless that is asked for.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
# A guard of the ROS 2 wheels: inherited from another environment's Python, it would stop ours from
# finding its libraries.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE

VENV := $(CURDIR)/.venv
RUNNABLE := install/hnn_vi_ros/lib/hnn_vi_ros
# ROS 2 comes from wheels, or from the ROS 2 Jazzy that is sourced; of another ROS 2, the name.
MODE := $(or $(ROS_DISTRO),wheels)
ENVIRONMENT := export VIRTUAL_ENV='$(VENV)'; \
	if [ '$(MODE)' = wheels ]; then unset COLCON_PREFIX_PATH; . '$(VENV)/local_setup.sh'; fi

COLCON := .venv/bin/python -m colcon --log-base log build --build-base build \
	--install-base install --base-paths . --packages-select hnn_vi_ros

INSTALLED := .venv/.installed
BUILT := install/.built
PEERS := .venv/.peers
# Renewed as well when it belongs to another ROS 2 or folder, or lost its Python.
ifneq ($(shell [ -x .venv/bin/python ] && cat $(INSTALLED) 2>/dev/null),$(MODE) $(CURDIR))
.PHONY: $(INSTALLED)
endif
# The sources' names are not listed as prerequisites: some may have spaces, some may be gone.
ifneq ($(shell find hnn_vi_ros config launch resource package.xml setup.py setup.cfg \
	-name __pycache__ -prune -o -newer $(BUILT) -print 2>/dev/null | head -n 1),)
.PHONY: $(BUILT)
endif

.PHONY: help build run test bench accuracy hard-cases clean distclean

help:
	@echo 'make run [SCENE=NAME|FILE] [DURATION=SECONDS]  simulate a scene (0: until Ctrl-C)'
	@echo 'make test [ARGS=...]                           run every test (ARGS go to pytest)'
	@echo 'make bench [OUT=FOLDER] [ARGS=...]             measure the speed against other tools'
	@echo 'make accuracy [OUT=FOLDER] [ARGS=...]          measure what accuracy costs; hours'
	@echo 'make hard-cases [OUT=FOLDER] [ARGS=...]        run the hard cases in full; hours'
	@echo 'make build                                     set up .venv and build the package'
	@echo 'make clean                                     remove what was built'
	@echo 'make distclean                                 remove .venv as well'

build: $(BUILT)
	@:

$(INSTALLED): $(wildcard requirements/*)
	@requirements/make_venv '$(VENV)' '$(MODE)' '$(PYTHON)'

# Built from nothing: neither a removed module nor a function compiled from older sources stays.
# colcon's setup scripts read unset variables: made fit to be sourced under `set -u` as well.
$(BUILT): $(INSTALLED)
	@echo 'Building hnn_vi_ros ...'
	@rm -rf build/hnn_vi_ros install/hnn_vi_ros
	@mkdir -p build install
	@touch build/.started
	@$(ENVIRONMENT); $(COLCON) > build/colcon.log 2>&1 || \
		{ tail -n 40 build/colcon.log >&2; echo 'error: colcon build failed' >&2; exit 1; }
	@sed -i -e '1i case $$- in *u*) _nounset=u; set +u;; *) _nounset=;; esac' \
		-e '$$a [ -z "$$_nounset" ] || set -u; unset _nounset' install/setup.*sh
	@echo 'Compiling its first kernel ...'
	@$(ENVIRONMENT); .venv/bin/python -P -c "from hnn_vi_ros import load_scene, simulate; \
		simulate(load_scene('harmonic_oscillator'), 0.0)"
	@mv build/.started $@

# exec: a signal then reaches the node itself. The scene is quoted for YAML, which reads the value.
run: export SCENE := $(SCENE)
run: $(BUILT)
	@$(ENVIRONMENT); quote="'"; \
	exec $(RUNNABLE)/simulator --ros-args \
		-p "scene:='$${SCENE//$$quote/$$quote$$quote}'" -p 'duration:=$(DURATION)'

# Plugins by name: those of a sourced ROS 2 were written for an older pytest. Tests of one process
# share the cores; those of processes that keep time come after, one at a time.
PYTEST := PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 .venv/bin/pytest -p timeout
test: $(BUILT)
ifdef ARGS
	@$(ENVIRONMENT); $(PYTEST) $(ARGS)
else
	@$(ENVIRONMENT); $(PYTEST) -p xdist -n auto --dist loadfile --durations 15 --ignore test/ros
	@$(ENVIRONMENT); $(PYTEST) --durations 15 test/ros
endif

$(PEERS): requirements/bench.txt $(INSTALLED)
	@echo 'Adding what `make bench` compares with to .venv, once ...'
	@cd requirements && ../.venv/bin/python -m pip install --progress-bar off --no-input \
		--disable-pip-version-check -r bench.txt > ../.venv/peers.log 2>&1 || \
		{ grep -E '^ *(ERROR|error)' ../.venv/peers.log | tail -n 5 >&2; \
		echo 'error: the packages could not be installed; see .venv/peers.log' >&2; exit 1; }
	@touch $@

# Every library to one thread.
ONE_THREAD := export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1 JAX_PLATFORMS=cpu \
	XLA_FLAGS='--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1'

# -P: the package that is measured is the one that was built.
bench: $(BUILT) $(PEERS)
	@$(ENVIRONMENT); $(ONE_THREAD); \
	export PYTHONPATH="$(CURDIR)/test$${PYTHONPATH:+:$$PYTHONPATH}"; \
	exec .venv/bin/python -P -m benchmarks.bench --out '$(OUT)' $(ARGS)

# What is measured already is kept in work_precision/, so that it can be interrupted.
accuracy: $(BUILT) $(PEERS)
	@$(ENVIRONMENT); $(ONE_THREAD); \
	exec $(RUNNABLE)/work_precision --all --peers --out work_precision --docs '$(OUT)' $(ARGS)

# What is there already is kept in hard_cases/, so that it can be interrupted.
hard-cases: $(BUILT)
	@$(ENVIRONMENT); $(ONE_THREAD); \
	exec $(RUNNABLE)/hard_cases --out hard_cases --docs '$(OUT)' $(ARGS)

clean:
	rm -rf build install log .pytest_cache .hypothesis

distclean: clean
	rm -rf .venv
