# Every target is enough on its own: from a fresh clone with only Python (>= 3.11) and make.
PYTHON ?= python3
BIN := .venv/bin
TFLITE := .venv/tflite-runtime

UAV := graphs/emulated_uav.yaml
# Rows of the paper's Table 2, each with more of the graph than the one before.
TABLE2 := graphs/profile/segmentation.yaml,graphs/profile/segmentation_detection.yaml,graphs/profile/image_networks.yaml,graphs/profile/image_fusion.yaml,graphs/profile/everything.yaml

# On every core; what runs on the real clock comes after, beside its like, which mostly wait: what
# computes would make it late.
PYTEST := $(BIN)/python -m pytest
ON_ALL_CORES := -n logical --maxprocesses 4 --dist worksteal

.DEFAULT_GOAL := help
.PHONY: help venv demo demo-emulated demo-truth real-propagation test test-fast check types check-tflite-runtime bench soak profile clean

help:  ## Say what each target does
	@sed -n 's/^\([a-z-]*\):[^#]*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 24

venv: .venv/installed  ## Make the virtual environment .venv with everything in it

.venv/installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit("Overflight needs Python 3.11 or newer: make PYTHON=python3.11 ..." if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

# The flight is the same for demo and demo-truth: the command finds it made and says so.
FLIGHT := $(BIN)/overflight simulate demo -o out/flight.mcap

demo: venv  ## Simulate a flight and run the paper's whole graph with its networks on it (3 to 11 minutes)
	@echo "1 of 4: simulating 10 s of flight, 1 to 5 minutes (once: it is kept in out/flight.mcap)"
	$(FLIGHT)
	@echo "2 of 4: the whole graph offline, so that every frame counts, 1 to 2 minutes"
	$(BIN)/overflight run graphs/uav.yaml --speed max --out out/demo --report out/demo/report.json
	@echo "3 of 4: judging its map by the true one, some seconds"
	$(BIN)/overflight evaluate out/demo/map.ply --truth out/flight.mcap
	@echo "4 of 4: the same graph live for 10 s; the table at the end says what it could not keep up with"
	$(BIN)/overflight run graphs/uav.yaml --out out/demo/live --report out/demo/live/report.json
	@echo "Look at out/demo/oblique_view.png, top_view.png, image/, image_lower/, thermal/, cloud/ and map.ply."

demo-emulated: venv  ## Run the paper's graph on emulated sensors and devices for 15 s
	$(BIN)/overflight run graphs/emulated_uav.yaml --duration 15 --out out/emulated --report out/emulated/report.json

demo-truth: venv  ## Simulate a flight and map it, what is true in place of the networks (4 minutes)
	@echo "1 of 3: simulating 10 s of flight, 1 to 5 minutes (once: it is kept in out/flight.mcap)"
	$(FLIGHT)
	@echo "2 of 3: fusing and mapping it, half a minute to one"
	$(BIN)/overflight run graphs/uav_truth.yaml --speed max --out out/truth --report out/truth/report.json
	@echo "3 of 3: judging the map by the true one"
	$(BIN)/overflight evaluate out/truth/map.ply --truth out/flight.mcap
	@echo "Look at out/truth/oblique_view.png, top_view.png, image/, image_lower/, thermal/ and map.ply."

test: venv  ## Run all tests
	$(PYTEST) $(ON_ALL_CORES) -m "not realtime"
	$(PYTEST) $(ON_ALL_CORES) -m realtime

test-fast: venv  ## Run the tests that take under a minute together
	$(PYTEST) $(ON_ALL_CORES) -m "not realtime and not slow"
	$(PYTEST) $(ON_ALL_CORES) -m "realtime and not slow"

check: venv  ## Check formatting, lint, types and tests; changes no file (what CI runs)
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(MAKE) --no-print-directory -j2 --output-sync types check-tflite-runtime
	$(MAKE) --no-print-directory test

types: venv  ## Check the types alone
	$(BIN)/mypy

# What its wheels need, Python 3.11 and numpy below 2, the rest of the project does not want: so it
# gets an environment of its own.
check-tflite-runtime: venv  ## Test the accelerators once more on tflite-runtime (Python 3.11 only)
	@if $(BIN)/python -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))'; then \
		$(MAKE) --no-print-directory $(TFLITE)/installed && \
		$(TFLITE)/bin/python -m pytest tests/accelerators; \
	else echo "check-tflite-runtime: skipped, tflite-runtime has wheels up to Python 3.11 and this is another"; fi

$(TFLITE)/installed: pyproject.toml
	$(BIN)/python -m venv $(TFLITE)
	$(TFLITE)/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[tflite-runtime]' hypothesis pytest pytest-timeout
	@$(TFLITE)/bin/python -c 'import sys; from accelerators.litert import TfliteCpu; sys.exit(TfliteCpu(tflite_backend="tflite_runtime").probe().reason or 0)'
	@touch $@

bench: venv  ## Measure the figures of BENCHMARK.md on this machine
	$(BIN)/python -m tools.bench

# The map forgets what is 60 m behind: one that grows with the way flown would hide what else grows.
soak: venv  ## Kill the processes of a graph at random for 20 minutes; say what grew (MINUTES=5 for less)
	$(BIN)/python -m tools.soaking --minutes $(or $(MINUTES),20) --set stages.semantic_map.options.max_distance_m=60

profile: venv  ## Measure the paper's Fig 9, Table 1 and Table 2 on emulated devices (8 minutes)
	$(BIN)/overflight profile $(UAV) --overlay graphs/profile/table1.yaml --sweep executor --html out/profile/table1.html
	$(BIN)/overflight profile $(UAV) --sweep overlay=$(TABLE2) --duration 10 --html out/profile/table2.html
	$(BIN)/overflight profile $(UAV) --overlay graphs/profile/table1.yaml --sweep executor --sweep rate_hz=1,2,5,10,15 \
		--html out/profile/figure9.html --plot out/profile/figure9.svg

real-propagation: venv  ## Label propagation on real data of ../shared, judged by human labels (hours; goes on where it stopped)
	$(BIN)/overflight evaluate --table real --shared ../shared --out out/real-propagation

clean:  ## Remove what the other targets made
	rm -rf .venv out/demo out/emulated out/profile out/truth out/flight.mcap build dist .mypy_cache .pytest_cache .ruff_cache .hypothesis *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
