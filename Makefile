# Three commands: `make demo`, `make test` and `make test-slow`; `make docs` builds the documentation.
# All set up .venv first, once.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# on all cores, tests of one file together, since they share what takes long to make
PYTEST := $(BIN)/pytest -n auto --dist loadfile
INSTALLED := $(VENV)/.installed
KERNELS := src/fascicle/kernels
COMPILED := $(VENV)/.compiled

.PHONY: demo test test-slow docs clean

demo: $(INSTALLED) $(COMPILED)
	$(BIN)/fascicle demo

test: $(INSTALLED) $(COMPILED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python tools/plain_names.py
	$(BIN)/python tools/readability.py
	$(PYTEST) -m "not slow"

test-slow: $(INSTALLED) $(COMPILED)
	$(PYTEST) -m slow

docs: $(INSTALLED)
	$(BIN)/sphinx-build -W --keep-going -q -b html docs build/docs
	@echo "file://$(CURDIR)/build/docs/index.html"

# The stamp is made last, so an interrupted set-up starts again.
$(INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "fascicle needs Python 3.11 or newer; try: make $(MAKECMDGOALS) PYTHON=python3.11"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@

# Numba does not see that what a kernel imports has changed: all are compiled anew if any has.
$(COMPILED): $(INSTALLED) $(wildcard $(KERNELS)/*.py)
	rm -f $(KERNELS)/__pycache__/*.nb[ic]
	@touch $@

clean:
	rm -rf $(VENV) build .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
