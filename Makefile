# Everything runs in .venv. The first `make` fills it; it is updated only if setup.py has changed. ROS
# comes from Python wheels, so no ROS installation is needed, and one that is sourced in the calling
# shell is ignored.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

HOME ?= $(CURDIR)/$(VENV)
export HOME
export AMENT_PREFIX_PATH := $(CURDIR)/$(VENV)
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
# The matrices of a plan are small: more threads of BLAS wait for each other (docs/faq.md).
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH PYTHONPATH PYTHONHOME
unexport PYTHONDONTWRITEBYTECODE
unexport RMW_IMPLEMENTATION ROS_DISTRO ROS_DOMAIN_ID

.DELETE_ON_ERROR:
.PHONY: help demo paper docs test slow lint benchmark endurance package release clean

help:
	@echo 'make demo       eight departures on real terrain; results in out/demo'
	@echo 'make paper      the tables and figures of the paper; results in out/paper'
	@echo 'make docs       all pages and the Python reference as a site; begin at out/docs/index.html'
	@echo 'make test       linters, type checker and the tests, but not the slow ones'
	@echo 'make slow       the slow tests: whole pages of the docs, demo, paper, examples, benchmarks'
	@echo 'make lint       linters and type checker only'
	@echo 'make benchmark  speed of solver and node, in an hour or more; benchmarks/results.md'
	@echo 'make endurance  recordings killed 300 times, random games, malformed messages'
	@echo 'make package    sdist and wheel of the last commit, checked, in dist'
	@echo 'make release    the same, if package.xml, setup.py and CITATION.cff name a maintainer'
	@echo 'make clean      remove .venv, out and all build results'
	@echo 'PYTHON=python3.12 make ... chooses the Python (3.10 or newer) when .venv is made'

demo: $(VENV)/.demo
	$(BIN)/python -m examples.demo

paper: $(VENV)/.demo
	$(BIN)/python -m paper

docs: $(VENV)/.docs
	rm -rf out/docs
	$(BIN)/python -m sphinx -q -n -W --keep-going -c docs/sphinx . out/docs
	cp out/docs/README.html out/docs/index.html

# Test files run in parallel; a run that loses a worker ends.
PARALLEL := -n auto --dist loadfile --max-worker-restart 0

# pytest fails with exit code 5 if it finds no test.
test: lint
	ROS_PYTHON_CHECK_FIELDS=1 $(BIN)/python -m pytest $(PARALLEL) -m 'not slow'

slow: $(VENV)/.test
	ROS_PYTHON_CHECK_FIELDS=1 $(BIN)/python -m pytest $(PARALLEL) --timeout 1500 \
		-o session_timeout=7200 -m slow

lint: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/mypy

# A missed target does not stop the benchmarks that follow.
benchmark: $(VENV)/.test
	$(BIN)/python benchmarks/solver.py --changes 50
	$(BIN)/python benchmarks/ground.py
	$(BIN)/python benchmarks/others.py
	$(BIN)/python benchmarks/random_games.py --count 200
	-$(BIN)/python benchmarks/limits.py
	-$(BIN)/python benchmarks/limits.py --crowd 20 --busy 8 --limits 60
	-$(BIN)/python benchmarks/node_latency.py
	-$(BIN)/python benchmarks/node_motion.py

endurance: $(VENV)/.test
	ROS_PYTHON_CHECK_FIELDS=1 $(BIN)/python -m pytest -k kill --kills 100 --timeout 3600 \
		-o session_timeout=3600 test/test_recorder.py
	HUNT=25 $(BIN)/python -m pytest $(PARALLEL) --timeout 3600 -o session_timeout=7200 \
		$$(grep -l -e '^@examples' -e HUNT test/test_*.py)
	$(BIN)/python benchmarks/random_games.py --count 1000 --first $$(date +%s)
	$(BIN)/python benchmarks/node_fuzz.py

package:
	.ci/package

release:
	@! grep -nE '\.invalid|ambush_planner maintainers' package.xml setup.py CITATION.cff || \
		{ echo 'make release: name a maintainer in these lines first; see CONTRIBUTING.md'; exit 1; }
	$(MAKE) package

clean:
	rm -rf $(VENV) out build install log dist *.egg-info
	rm -rf .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV)/.python:
	@$(PYTHON) -c 'import sys; sys.version_info < (3, 10) and sys.exit("Python 3.10 or newer \
	is needed, $(PYTHON) is " + sys.version.split()[0] + "; try: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)
	@touch $@

# The installation is editable: the commands in .venv/bin import the checkout. It lacks the resource
# index and share/, which only `ros2 run` needs; package data is read with importlib.resources.
$(VENV)/.demo: EXTRAS := jazzy,figures
$(VENV)/.test: EXTRAS := jazzy,figures,test,lint
$(VENV)/.docs: EXTRAS := docs
$(VENV)/.demo $(VENV)/.test $(VENV)/.docs: $(VENV)/.python setup.py
	@echo 'Installing ambush_planner[$(EXTRAS)] in $(VENV), which takes about a minute ...'
	@$(BIN)/python -m pip install -qq --disable-pip-version-check -e '.[$(EXTRAS)]'
	@touch $@
