# Copyright 2026 The hnn_vi_ros Authors
# SPDX-License-Identifier: Apache-2.0
#
# Sets everything up on first use. `make` alone lists the targets.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
MAKEFLAGS += --no-print-directory

PYTHON ?= python3
TORCH ?=
ROS ?=
SCENE ?= harmonic_oscillator
DURATION ?= 20
ARGS ?=
NAME ?=
CASE ?=
OUT ?= docs/evidence
# By default, do not disturb the ROS graph of others.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
export PYTHON TORCH ROS

# These take milliseconds if the environment and the build are up to date.
VENV := @requirements/make_venv
INSTALL := @requirements/build_package
BUILD := @requirements/build_package scenes
ENVIRONMENT := . .venv/environment.sh
RUNNABLE := install/hnn_vi_ros/lib/hnn_vi_ros
# Every library to one thread.
ONE_THREAD := export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1 JAX_PLATFORMS=cpu \
	XLA_FLAGS='--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1'

.PHONY: help build run test test-long nightly messages keys bench accuracy hard-cases study docs clean distclean

help:
	@echo 'make run [SCENE=NAME|FILE] [DURATION=SECONDS]  simulate a scene (0: until Ctrl-C)'
	@echo 'make test [ARGS=...]                           run the short tests (ARGS go to pytest)'
	@echo 'make test-long                                 run the long tests; an hour'
	@echo 'make nightly                                   check what breaks seldom: Kilted, notebook, Pythons'
	@echo 'make messages [ARGS=...]                       regenerate the tables of error messages'
	@echo 'make keys                                      regenerate the schema and the key reference'
	@echo 'make bench [OUT=FOLDER] [ARGS=...]             measure the speed against other tools'
	@echo 'make accuracy [OUT=FOLDER] [ARGS=...]          measure the cost of accuracy; hours'
	@echo 'make hard-cases CASE=10                        run one hard case in short; a minute'
	@echo 'make hard-cases [OUT=FOLDER] [ARGS=...]        run the hard cases in full; hours'
	@echo 'make study [NAME=... ARGS=...]                 run another study; without NAME, list them'
	@echo 'make docs                                      build the site into docs/_build/html'
	@echo 'make build [TORCH=cpu|cuda|any|none]           set up .venv, build, compile all scenes'
	@echo '           [ROS=jazzy|kilted]                  with this ROS 2, if none is sourced'
	@echo 'make clean                                     remove all build results'
	@echo 'make distclean                                 remove .venv as well'

build:
	$(VENV) run
	$(BUILD)

# One scene compiles its code at the start, which takes seconds; all scenes take minutes.
# exec: a signal then reaches the node itself. The scene is quoted for YAML, which reads the value.
run: export SCENE := $(SCENE)
run:
	$(VENV) run
	$(INSTALL)
	@$(ENVIRONMENT); quote="'"; \
	exec $(RUNNABLE)/simulator --ros-args \
		-p "scene:='$${SCENE//$$quote/$$quote$$quote}'" -p 'duration:=$(DURATION)'

# Plugins by name: those of a sourced ROS 2 were written for an older pytest. Tests of one process
# share the cores; those of nodes come after: they mostly wait, so that a few run at once, each
# worker in a ROS domain of its own. test/conftest.py says which files come first.
PYTEST := PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 .venv/bin/pytest -p timeout
IN_PARALLEL := $(PYTEST) -p xdist --dist loadfile --no-loadscope-reorder --durations 15
TESTS = $(ENVIRONMENT); status=0; \
	$(IN_PARALLEL) -n auto -m '$(SELECTED)' --ignore test/ros || status=$$?; \
	$(IN_PARALLEL) -n 4 -m '$(SELECTED)' test/ros || status=$$?; exit $$status
test: SELECTED = not long
test-long: SELECTED = long
test test-long:
	$(VENV) run train test $(if $(filter test-long,$@),bench)
	$(BUILD)
ifdef ARGS
	@$(ENVIRONMENT); $(PYTEST) $(ARGS)
else
	@$(TESTS)
endif

nightly:
	$(VENV) run
	$(BUILD)
	@.ci/nightly

# Review the diff: each row is a mistake and the line that answers it.
messages:
	$(VENV) run train test
	$(BUILD)
	@$(ENVIRONMENT); $(PYTEST) -p xdist -n auto --dist loadfile --messages $(or $(ARGS),test)
	@git diff --stat -- '*/messages.txt'

keys:
	$(VENV) run train docs
	$(INSTALL)
	@$(ENVIRONMENT); .venv/bin/python -P -m hnn_vi_ros scene --schema > config/scene.schema.json; \
	.venv/bin/python docs/tools/generate.py

# -P: measure the installed build, not the sources.
bench:
	$(VENV) run train bench
	$(BUILD)
	@$(ENVIRONMENT); $(ONE_THREAD); \
	export PYTHONPATH="$(CURDIR)/docs$${PYTHONPATH:+:$$PYTHONPATH}"; \
	exec .venv/bin/python -P -m benchmarks.bench --out '$(OUT)' $(ARGS)

# The studies of docs/studies, of the package that was built. Hard cases keep what is measured in a
# folder of their name, and go on from there after an interruption; accuracy keeps each scene. One
# case is short and changes no page.
study: WORDS = $(NAME)
accuracy: WORDS = work_precision --peers --docs '$(OUT)'
hard-cases: WORDS = hard_cases $(if $(CASE),--quick --case $(CASE) --out hard_cases/quick,--out \
	hard_cases --docs '$(OUT)')
study accuracy hard-cases:
	$(VENV) run train $(if $(filter accuracy,$@),bench)
	$(if $(CASE),$(INSTALL),$(BUILD))
	@$(ENVIRONMENT); $(ONE_THREAD); \
	export PYTHONPATH="$(CURDIR)/docs$${PYTHONPATH:+:$$PYTHONPATH}"; \
	exec .venv/bin/python -P -m studies $(WORDS) $(ARGS)

# Warnings are errors, links within the site among them.
docs:
	$(VENV) run train docs
	$(BUILD)
	@$(ENVIRONMENT); $(ONE_THREAD); export MPLBACKEND=Agg; \
	.venv/bin/python -P -m sphinx -W --keep-going -q -d docs/_build/doctrees docs docs/_build/html; \
	echo "The site: $(CURDIR)/docs/_build/html/index.html"

clean:
	rm -rf build install log .pytest_cache .hypothesis docs/_build docs/gallery docs/generated

distclean: clean
	rm -rf .venv
