# `make demo`, `make test`, and `make bench`, a scanner without hardware. Each makes the environment if it is not there.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
# What Open3D, with which tests compare, loads from the system; the same list is in jaxscan/surface/open3d_loader.py.
LIBRARIES := libusb-1.0-0 libegl1 libgl1 libx11-6 libgomp1 libudev1 libidn2-0
# What firmware and bench are built and run with: hardware/bench/README.md.
# The browser in which pages are tested.
BROWSER_PACKAGES := chromium chromium-driver
# What a person gives the mount: `make mount MOUNT="-D baseline=200 -D laser_angle=4.3"`.
MOUNT ?=
BENCH_PACKAGES := gcc make gcc-avr avr-libc binutils-avr simavr libsimavr-dev libaravis-0.8-0 aravis-tools strace
SHARED := -n 2 --dist loadfile --no-loadscope-reorder
PART ?= 1/1
TYPES := --jaxtyping-packages=jaxscan,beartype.beartype
QUICKLY := --xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1

.PHONY: demo test test-rig test-more test-slow test-all docs experiments lint format libraries firmware bench bench-deps browser-deps programs wiring mount \
  mount-deps clean

demo: $(INSTALLED)
	$(BIN)/jaxscan demo -o demo

# Four tiers; pyproject.toml names their markers. `.ci/run` runs the first three, and a 24th of the last:
#   test       what a person runs: minutes. Nothing is built, no program is started but Python.
#   test-rig   with other programs beside it: the firmware in a simulated processor, cameras on loopback, browsers.
#   test-more  whole loops and further cameras, boards and seeds, with the types of all arguments and results checked.
#   test-slow  Monte Carlo, fuzzing and verbs killed at many moments: hours. PART=3/24 runs the third
#              24th of them.
# TESTS=tests/stripes runs those of a folder or a file, in each of them. test-all is everything, compiled as the package
# is in use.
#
# Two processes: compiling, which is much of the time, keeps one core busy at a time. Whole files, because the tests of
# a file share what is compiled, in the order of tests/conftest.py. Compiled code that runs a few times need not be
# fast, and costs half as much to make.
test: $(INSTALLED)
	XLA_FLAGS="$(QUICKLY) $$XLA_FLAGS" $(BIN)/python -m pytest -q $(SHARED) $(TESTS)

test-rig: $(INSTALLED)
	XLA_FLAGS="$(QUICKLY) $$XLA_FLAGS" $(BIN)/python -m pytest -q $(SHARED) -m "rig and not (more or slow)" $(TESTS)

test-more: $(INSTALLED)
	XLA_FLAGS="$(QUICKLY) $$XLA_FLAGS" $(BIN)/python -m pytest -q $(SHARED) $(TYPES) -m "more and not slow" $(TESTS)

test-slow: $(INSTALLED)
	XLA_FLAGS="$(QUICKLY) $$XLA_FLAGS" $(BIN)/python -m pytest -q $(SHARED) -m slow --part $(PART) $(TESTS)

test-all: $(INSTALLED)
	$(BIN)/python -m pytest -q $(SHARED) $(TYPES) -m "" $(TESTS)

# The tables and figures of the paper, in both worlds, to paper-figures/: an hour on two cores.
# `make experiments QUICK=--quick` shows in some minutes that all of it works.
experiments: $(INSTALLED) libraries
	$(BIN)/python -m experiments.paper $(QUICK) --out paper-figures

# Into site/, without a network; a link that leads nowhere is an error.
docs: $(INSTALLED)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build -q --strict

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(INSTALLED)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# Installs Open3D's system libraries where it may, and says what to type where it may not.
libraries: $(INSTALLED)
	@if ! $(BIN)/python -c "from jaxscan.surface import load_open3d; load_open3d()" 2>/dev/null; then \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    apt-get update -q && DEBIAN_FRONTEND=noninteractive apt-get install -qy --no-install-recommends $(LIBRARIES); \
	  else \
	    echo "Open3D needs system libraries. Type: sudo apt-get install $(LIBRARIES)"; exit 1; \
	  fi; \
	fi

firmware:
	$(MAKE) -C hardware/firmware

# The rig on a desk: the firmware in a simulated processor, a camera that sees a simulated room.
bench: $(INSTALLED)
	@$(BIN)/python -m bench

# The wiring drawing, from its list of pins.
wiring:
	$(PYTHON) hardware/wiring/draw.py docs/hardware/wiring.svg

# The printable parts of the mount, to hardware/mount/build/.
mount:
	@command -v openscad >/dev/null || { echo "The mount is built by OpenSCAD. Type: sudo apt-get install openscad"; exit 1; }
	@mkdir -p hardware/mount/build
	@for part in whole camera laser; do \
	  openscad -q -o hardware/mount/build/$$part.stl -D "part=\"$$part\"" $(MOUNT) hardware/mount/mount.scad || exit 1; \
	  echo "hardware/mount/build/$$part.stl"; \
	done

# Installs what the mount is built with where it may, and says what to type where it may not.
mount-deps:
	@if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	  apt-get update -q && DEBIAN_FRONTEND=noninteractive apt-get install -qy --no-install-recommends openscad; \
	else \
	  echo "Type: sudo apt-get install openscad"; exit 1; \
	fi

# Installs what the bench needs where it may, and says what to type where it may not. No other target does.
bench-deps:
	@if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	  apt-get update -q && DEBIAN_FRONTEND=noninteractive apt-get install -qy --no-install-recommends $(BENCH_PACKAGES); \
	else \
	  echo "Type: sudo apt-get install $(BENCH_PACKAGES)"; exit 1; \
	fi

# Installs the browser in which pages are tested, where it may, and says what to type where it may not.
browser-deps:
	@if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	  apt-get update -q && DEBIAN_FRONTEND=noninteractive apt-get install -qy --no-install-recommends $(BROWSER_PACKAGES); \
	else \
	  echo "Type: sudo apt-get install $(BROWSER_PACKAGES)"; exit 1; \
	fi

# Installs the programs in which tests/programs opens clouds, where it may, and says what to type where it may not.
programs: $(INSTALLED)
	@if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	  apt-get update -q && DEBIAN_FRONTEND=noninteractive apt-get install -qy --no-install-recommends cloudcompare pcl-tools; \
	else \
	  echo "Type: sudo apt-get install cloudcompare pcl-tools"; exit 1; \
	fi
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e ".[programs]"

$(INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit("jaxscan needs Python 3.11 or newer; try: make PYTHON=python3.12" if sys.version_info < (3, 11) else 0)'
	@$(PYTHON) -c "import ensurepip" 2>/dev/null || \
	  { echo "Python's venv module is missing. Type: sudo apt-get install python3-venv"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e ".[test,docs,console,export,plan,ifc,simulate,rig]"
	@touch $@

clean:
	rm -rf $(VENV) demo site paper-figures build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	rm -rf hardware/bench/build hardware/firmware/build hardware/mount/build
