# Two commands do everything: `make demo` and `make test`. Both make their own environment.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SOURCES := pyproject.toml CMakeLists.txt README.md LICENSE $(shell find core src -type f -not -name '*.pyc')

# The packages of an extra in pyproject.toml, without building the package.
define install_extra
	$(BIN)/python -c 'import tomllib; extras = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
	  print(*extras["optional-dependencies"]["$(1)"], sep="\n")' > $(VENV)/$(1).txt
	$(BIN)/pip install -q -r $(VENV)/$(1).txt
endef

.PHONY: demo test docs test-slow test-browser test-evo test-bridges lint format sanitize sanitize-threads compilers wheel benchmark clean

demo: $(VENV)/.masat
	$(BIN)/masat demo

test: $(VENV)/.test
	$(BIN)/python -m pytest -n auto

test-slow: $(VENV)/.test
	$(BIN)/python -m pytest -n auto -m "slow or not slow"

lint: $(VENV)/.lint $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	git ls-files '*.cpp' '*.hpp' | xargs $(BIN)/clang-format --dry-run --Werror

format: $(VENV)/.lint
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	git ls-files '*.cpp' '*.hpp' | xargs $(BIN)/clang-format -i

# The tests that enter the core, on a core with address and undefined-behavior sanitizers. Left out
# is what only takes long: large systems, which run the same code as small ones.
sanitize: $(VENV)/.test
	$(BIN)/pip install -q --no-deps --target build/sanitized --upgrade . \
	  -C cmake.define.MASAT_SANITIZE=address -C cmake.define.CMAKE_COMPILE_WARNING_AS_ERROR=ON
	ASAN_OPTIONS=detect_leaks=0 \
	LD_PRELOAD="$$($(CXX) -print-file-name=libasan.so) $$($(CXX) -print-file-name=libstdc++.so)" \
	PYTHONPATH=build/sanitized $(BIN)/python -m pytest -q -n auto \
	  tests/test_core.py tests/test_fuzz.py tests/test_cholesky.py tests/test_threads.py tests/test_structure.py \
	  tests/test_lie.py tests/test_toro.py tests/test_relaxation.py tests/test_covariance.py \
	  tests/test_online.py tests/test_online_stress.py tests/test_online_priors.py \
	  tests/test_online_landmarks.py tests/test_parts_elimination.py \
	  -k "not (same_bits and 3) and not long_calls and not robust_map_leaves_out_wrong"

# The tests that compute with several threads, on a core with the thread sanitizer.
sanitize-threads: $(VENV)/.test
	$(BIN)/pip install -q --no-deps --target build/sanitized-threads --upgrade . \
	  -C cmake.define.MASAT_SANITIZE=thread -C cmake.define.CMAKE_COMPILE_WARNING_AS_ERROR=ON
	TSAN_OPTIONS=exitcode=66 OPENBLAS_NUM_THREADS=1 \
	LD_PRELOAD="$$($(CXX) -print-file-name=libtsan.so) $$($(CXX) -print-file-name=libstdc++.so)" \
	PYTHONPATH=build/sanitized-threads $(BIN)/python -m pytest -q -n auto tests/test_cholesky.py \
	  tests/test_threads.py tests/test_covariance.py tests/test_online.py tests/test_online_stress.py -k "(same_bits and 2) or pivot or interrupted or no_more_threads or on_the_threads"

# The view in Chromium, which has to be installed: apt-get install chromium.
test-browser: $(VENV)/.test
	$(call install_extra,browser)
	$(BIN)/python -m pytest -q tests/test_view_browser.py

# The pages as a site in build/site. What is doubtful is an error: links, anchors, docstrings.
docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build -q

# evo is under the GPL, so no extra has it: it is installed in an environment of its own.
test-evo: $(VENV)/evo/.done
	$(VENV)/evo/bin/python -m pytest -q tests/test_evo.py

# The bridges with all other packages, which together take 2 GB, in an environment of their own.
# The pytest plugin of dash, which open3d installs, is older than our pytest.
test-bridges: $(VENV)/bridges/.done
	$(VENV)/bridges/bin/python -m pytest -q -p no:dash tests/test_bridges.py tests/test_gtsam.py \
	  tests/test_notebooks.py tests/test_docs.py

# With each supported compiler of this machine: builds the core and runs its tests.
compilers: $(VENV)/.test
	tools/compilers.sh $(BIN)

# A wheel as a release has it: built with each of $(PYTHON), repaired, and tried without a compiler.
wheel:
	tools/wheel.sh $(PYTHON)

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
	@echo "Compiling the core: two to four minutes."
	$(BIN)/pip install -q .
	@touch $@

$(VENV)/.test: $(VENV)/.masat
	$(call install_extra,test)
	@touch $@

$(VENV)/.lint: $(VENV)/bin/pip pyproject.toml
	$(call install_extra,lint)
	@touch $@

$(VENV)/.docs: $(VENV)/.masat
	$(call install_extra,docs)
	@touch $@

$(VENV)/evo/.done: $(VENV)/bin/pip $(SOURCES)
	$(PYTHON) -m venv $(VENV)/evo
	$(VENV)/evo/bin/pip install -q '.[test]' evo==1.38.1
	@touch $@

$(VENV)/bridges/.done: $(VENV)/bin/pip $(SOURCES)
	$(PYTHON) -m venv $(VENV)/bridges
	$(VENV)/bridges/bin/pip install -q '.[test,gtsam,networkx,pandas,open3d,rerun]'
	@touch $@

$(VENV)/bench/.done: $(VENV)/bin/pip $(SOURCES)
	$(PYTHON) -m venv $(VENV)/bench
	$(VENV)/bench/bin/pip install -q '.[bench]'
	@touch $@
