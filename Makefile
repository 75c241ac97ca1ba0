# Two commands do everything: `make demo` and `make test`. Both make their own environment.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SOURCES := pyproject.toml CMakeLists.txt README.md LICENSE $(shell find core src -type f -not -name '*.pyc')

.PHONY: demo test test-slow lint format sanitize benchmark clean

demo: $(VENV)/.masat
	$(BIN)/masat demo

test: $(VENV)/.test
	$(BIN)/python -m pytest

test-slow: $(VENV)/.test
	$(BIN)/python -m pytest -m "slow or not slow"

lint: $(VENV)/.lint $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	git ls-files '*.cpp' '*.hpp' | xargs $(BIN)/clang-format --dry-run --Werror

format: $(VENV)/.lint
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	git ls-files '*.cpp' '*.hpp' | xargs $(BIN)/clang-format -i

# The readers' fuzz test on a core with address and undefined-behavior sanitizers.
sanitize: $(VENV)/.test
	$(BIN)/pip install -q --no-deps --target build/sanitized --upgrade . -C cmake.define.MASAT_SANITIZE=ON \
	  -C cmake.define.CMAKE_COMPILE_WARNING_AS_ERROR=ON
	ASAN_OPTIONS=detect_leaks=0 \
	LD_PRELOAD="$$($(CXX) -print-file-name=libasan.so) $$($(CXX) -print-file-name=libstdc++.so)" \
	PYTHONPATH=build/sanitized $(BIN)/python -m pytest -q tests/test_fuzz.py tests/test_core.py

# In an environment of its own: one of the peers needs an old NumPy.
benchmark: $(VENV)/bench/.done
	for table in start factor solvers guesses process scaling; do \
	  $(VENV)/bench/bin/python -m benchmarks.$$table && echo || exit 1; \
	done

clean:
	rm -rf $(VENV) build dist

$(VENV)/bin/pip:
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install -q --upgrade pip

$(VENV)/.masat: $(VENV)/bin/pip $(SOURCES)
	@echo "Compiling the core: a minute or two."
	$(BIN)/pip install -q .
	@touch $@

$(VENV)/.test: $(VENV)/.masat
	$(BIN)/pip install -q '.[test]'
	@touch $@

$(VENV)/.lint: $(VENV)/bin/pip pyproject.toml
	$(BIN)/pip install -q ruff mypy clang-format
	@touch $@

$(VENV)/bench/.done: $(VENV)/bin/pip $(SOURCES)
	$(PYTHON) -m venv $(VENV)/bench
	$(VENV)/bench/bin/pip install -q '.[bench]'
	@touch $@
