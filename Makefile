PYTHON ?= python3
VENV := $(CURDIR)/.venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.setup
QUIET := --quiet --disable-pip-version-check
# `make run ARGS='--duration 10'`; so too for test and bench.
ARGS ?=

# Without a sourced ROS 2 the pinned wheels are ROS; beside one they would shadow its rclpy.
ROS := $(and $(ROS_DISTRO),$(shell $(PYTHON) -c 'import rclpy' 2>/dev/null && echo sourced))
export AMENT_PREFIX_PATH := $(VENV)$(if $(ROS),:$(AMENT_PREFIX_PATH))
ifndef ROS
unexport RMW_IMPLEMENTATION
endif

# A node starts in half the time where its modules are kept compiled.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup run test quick docs lint bench lock clean

setup: $(STAMP)

# Two workers; tests/conftest.py says what must not run at the same time.
PYTEST = $(BIN)/pytest --numprocesses 2

run: setup
	$(BIN)/gtmr demo $(ARGS)

# rclpy turns a field of the wrong type into garbage unless told to check.
test quick: export ROS_PYTHON_CHECK_FIELDS := 1
test: setup
	$(PYTEST) $(ARGS)

# All but whole ROS graphs and what is marked slow, in a minute.
quick: setup
	$(PYTEST) --ignore tests/graph -m 'not slow' $(ARGS)

# Read anew each time, since pages come from the code too. A link to nothing ends it.
docs: setup
	rm -rf site
	$(BIN)/sphinx-build --builder html --fail-on-warning --keep-going --quiet \
	  --fresh-env --doctree-dir build/doctrees docs site

lint: setup
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: setup
	$(BIN)/gtmr bench $(ARGS)

# Keeps every pin that setup.py still allows; delete requirements.txt first to upgrade them all.
lock: setup
	$(BIN)/pip install $(QUIET) uv
	$(BIN)/uv --no-config pip compile setup.py --all-extras --universal --python-version 3.10 \
	  --custom-compile-command 'make lock' --quiet --output-file requirements.txt

clean:
	rm -rf $(VENV) build install log dist site src/*.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(STAMP): requirements.txt setup.py pyproject.toml package.xml scripts
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' || \
	  { echo "gtmr needs Python 3.10 to 3.13, but '$(PYTHON)' is not: try make PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
	  { echo "'$(PYTHON)' cannot make a venv: on Debian or Ubuntu, apt install python3-venv" >&2; exit 1; }
	@test -z '$(ROS_DISTRO)' -o -n '$(ROS)' || \
	  { echo "ROS $(ROS_DISTRO) is sourced, but '$(PYTHON)' cannot import its rclpy: try make PYTHON=/usr/bin/python3" >&2; exit 1; }
	@echo 'Installing the pinned dependencies into .venv, once; this takes about a minute.'
	$(PYTHON) -m venv $(if $(ROS),--system-site-packages) $(VENV)
	grep -v '^$(if $(ROS),ros-,$$)' requirements.txt > $(VENV)/requirements.txt
# The pip that comes with an older Python takes half as long again.
	$(BIN)/pip install $(QUIET) pip==26.3
	$(BIN)/pip install $(QUIET) --no-deps --no-compile -r $(VENV)/requirements.txt
	$(BIN)/pip install $(QUIET) --no-deps --no-build-isolation --editable .
# An editable install has no data files; links keep these live as well.
	mkdir -p $(VENV)/lib/gtmr $(VENV)/share/gtmr/launch $(VENV)/share/ament_index/resource_index/packages
	ln -sf $(CURDIR)/scripts/* $(VENV)/lib/gtmr
	ln -sf $(CURDIR)/resource/gtmr $(VENV)/share/ament_index/resource_index/packages
	ln -sfn $(addprefix $(CURDIR)/,package.xml config rviz) $(VENV)/share/gtmr
# One by one: ros2 launch looks for its files without following a link to their folder.
	ln -sf $(CURDIR)/launch/*.launch.py $(VENV)/share/gtmr/launch
	@touch $@
