# Two ways in: `make demo` runs the main job on embedded data, `make test` checks everything. Both install what they need.
PYTHON ?= python3
VENV := .venv
INSTALL := $(VENV)/bin/python -m pip install -q --disable-pip-version-check -c constraints.txt

.PHONY: demo test lint docs vulkan chromium clean

demo: $(VENV)/.demo
	$(VENV)/bin/framecast demo -o demo-out

test: $(VENV)/.dev vulkan chromium lint
	$(VENV)/bin/python -m pytest -q

lint: $(VENV)/.dev
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy

docs: $(VENV)/.demo
	$(VENV)/bin/python docs/conventions.py

# The renderer needs a Vulkan driver; Mesa's runs on any processor. Installed where that is allowed, else its tests skip.
vulkan: $(VENV)/.dev
	@$(VENV)/bin/python -c "from framecast.render.device import open_device; open_device()" >/dev/null 2>&1 \
	|| { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && apt-get update -qq && apt-get install -y -qq mesa-vulkan-drivers libvulkan1 >/dev/null; } \
	|| echo "No Vulkan driver: the renderer's tests will be skipped. Install it with: apt install mesa-vulkan-drivers libvulkan1"

# The report's page is tested in a browser. Installed where that is allowed, else its tests skip.
chromium:
	@test -x /usr/bin/chromium \
	|| { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && apt-get update -qq && apt-get install -y -qq chromium >/dev/null; } \
	|| echo "No Chromium: the tests of the report's page will be skipped. Install it with: apt install chromium"

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

# torch first and alone, so that the pinned version is taken and not the newest one that its dependants allow.
$(VENV)/.torch: constraints.txt | $(VENV)/bin/python
	$(INSTALL) torch==$$(sed -n 's/^torch==//p' constraints.txt) numpy
	touch $@

$(VENV)/.demo: $(VENV)/.torch pyproject.toml
	$(INSTALL) -e .
	touch $@

$(VENV)/.dev: $(VENV)/.torch pyproject.toml
	$(INSTALL) -e '.[dev]'
	touch $@

clean:
	rm -rf $(VENV) demo-out
